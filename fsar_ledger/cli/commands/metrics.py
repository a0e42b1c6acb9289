"""The command `metrics`."""

from typing import Annotated

import typer

from fsar_ledger.cli.options import (
    CsvOption,
    JsonOption,
    LedgerArgument,
    PoolOption,
    RawOption,
    VerifiedOption,
    WideOption,
    examples,
)
from fsar_ledger.cli.terminal import show

EXAMPLES = examples(
    "fsar-ledger metrics out/ledger",
    "fsar-ledger metrics out/ledger --by scenario",
    "fsar-ledger metrics out/ledger --pool seeds",
    "fsar-ledger metrics out/ledger --verified --json",
)


def metrics(
    ledger: LedgerArgument,
    by: Annotated[
        str | None, typer.Option(metavar="scenario", help="One row for each scenario.", show_default=False)
    ] = None,
    pool: PoolOption = None,
    verified: VerifiedOption = False,
    as_json: JsonOption = False,
    as_csv: CsvOption = False,
    raw: RawOption = False,
    wide: WideOption = False,
) -> None:
    """Judge a ledger by the metrics: the eight of the paper, then any that were added.

    Shows mean, SD, 95 % interval and denominator for each architecture, configuration and fleet size; runs of different
    seeds, constants, models or kinds have rows of their own. Shares are in [0,1], latency is in seconds. Where a metric
    is not defined, a table shows `-` and JSON null.
    """
    from fsar_ledger.cli.answering import opened, warn
    from fsar_ledger.cli.output import telling, unit_of_interventions
    from fsar_ledger.cli.streaming import Form
    from fsar_ledger.cli.tables import is_fitted

    form = Form(as_json=as_json, as_csv=as_csv, raw=raw, wide=wide)
    found = opened(ledger, verified=verified).metrics(by, pool)  # type: ignore[arg-type]  # it refuses any other text
    rows = found.rows()
    columns = found.columns if rows and (as_json or as_csv) else telling(rows)
    form.show(form.pieces(found.provenance, columns, found.batches()))
    if is_fitted(wide=wide) and not (as_json or as_csv):
        show(unit_of_interventions(ledger))
    warn(ledger, found.provenance)
