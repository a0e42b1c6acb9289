"""The verb `metrics`."""

from typing import TYPE_CHECKING

from .names import by_scenario, pools_seeds
from .verbs import ROWS, ByOption, PoolOption, verb

if TYPE_CHECKING:
    from .ledger import Ledger
    from .table import Table


@verb(
    "metrics out/ledger",
    "metrics out/ledger --by scenario",
    "metrics out/ledger --pool seeds",
    "metrics out/ledger --verified --json",
    takes=ROWS,
)
def metrics(ledger: "Ledger", by: ByOption = None, pool: PoolOption = None) -> "Table":
    """Judge a ledger by the metrics: the eight of the paper, then any that were added.

    Shows mean, SD, 95 % interval and denominator for each architecture, configuration and fleet size; runs of different
    seeds, constants, models or kinds have rows of their own. Shares are in [0,1], latency is in seconds. Where a metric
    is not defined, a table shows `-` and JSON null.
    """
    from fsar_ledger.metrics.provenance import of_judgement
    from fsar_ledger.metrics.results import MetricRow, metric_rows

    from .table import MetricTable, of_structs

    per_scenario, pooled = by_scenario(by), pools_seeds(pool)
    with ledger.database() as database:
        rows = of_structs(metric_rows(database, by_scenario=per_scenario, pools_seeds=pooled), MetricRow)
        return MetricTable(rows if per_scenario else rows.drop_columns(["scenario"]), of_judgement(database))
