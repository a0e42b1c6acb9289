"""Return the answers of the metric and statistics queries as typed rows, in the order of the paper's tables."""

from typing import Any, TypeVar

import msgspec

from fsar_ledger.errors import LedgerCorrupted

from .database import Database

_Row = TypeVar("_Row", bound=msgspec.Struct)

SETTINGS = (
    "configuration <> 'full', configuration, fleet_size, kind <> 'simulated', kind, source, model_version, constants, "
    "seed"
)
"""In which order rows of different settings stand: those of the paper's table first."""


class MetricRow(msgspec.Struct, frozen=True, kw_only=True):
    """One metric over the runs of one architecture under the same constants, with one seed or with all.

    `constants` names those that differ between runs of the same model in this ledger, None if none do.
    Units: `mean`, `sd` (per run) and the 95 % interval in the metric's unit (share, count, seconds); `n` runs of
        `seeds` seeds; `denominator` what the metric counts, summed over runs; `mean_without_routine` if it also counts
        routine operations; `runs_not_observed` runs whose source does not record what the metric rests on, which count
        nowhere else. Reading: R42.
    None: undefined, not observable, what the runs do not have, or `scenario` (`seed`) for all of them together.
    """

    architecture: str | None
    configuration: str | None
    fleet_size: int | None
    seed: int | None
    kind: str
    source: str | None
    model_version: str | None
    constants: str | None
    scenario: str | None
    metric: str
    seeds: int
    mean: float | None
    mean_without_routine: float | None
    sd: float | None
    n: int
    ci_low: float | None
    ci_high: float | None
    denominator: int | None
    published_convention_mean: float | None
    runs_not_observed: int = 0


class DialledRow(MetricRow, frozen=True, kw_only=True):
    """A metric's summary with the dials that the paper leaves open.

    They are the mean time between encounters of two robots, in seconds, and the number of working teams. `setting` is
    as in `run_settings`; `made_alike_but` is the same text for runs of one model that differ only in fleet size and
    these dials.
    """

    setting: str
    encounter_mean_s: float | None
    teams_working: int | None
    made_alike_but: str


class CostRow(msgspec.Struct, frozen=True, kw_only=True):
    """What coordination costs the runs of one architecture and setting, for each request.

    A request is a step for which a robot lacks a capability; `completed` is the share of tasks completed within their
    budget. The dials are as in `DialledRow`.
    None: what there is none of, or what the runs do not have. Paper: sec:evaluation:scaling.
    """

    architecture: str | None
    configuration: str | None
    fleet_size: int | None
    kind: str
    source: str | None
    model_version: str | None
    setting: str
    teams_working: int | None
    encounter_mean_s: float | None
    made_alike_but: str
    runs: int
    tasks: int | None
    completed: float | None
    requests: int
    messages: float | None
    decisions: float | None
    hops: float | None
    look_ups: float | None
    robots_named: float | None
    checks: float | None


class StatisticRow(msgspec.Struct, frozen=True, kw_only=True):
    """One comparison of two architectures, or of one with itself without a mechanism, by one metric over paired runs.

    `comparison` is `first-second`; differences are first minus second, in the metric's unit. `configuration` is that of
    both architectures, or the ablated one; `seed` None: all seeds together; `constants` as in `MetricRow`. Holm adjusts
    the `family_tests` tests of one `family` together. The pooled columns are of the number that the results table
    prints, a ratio over all pairs (`statistics/pooled_tests`). Paper: tab:significance.
    None: undefined (no variance, fewer than two pairs), McNemar's test of a metric that is not 0/1, or pooled columns
        of one that is not pooled.
    """

    family: str
    configuration: str | None
    fleet_size: int | None
    seed: int | None
    kind: str
    source: str | None
    model_version: str | None
    constants: str | None
    metric: str
    comparison: str
    n: int
    first_mean: float | None
    second_mean: float | None
    mean_difference: float | None
    t: float | None
    df: int | None
    p: float | None
    # See docs/decisions/holm-has-two-families.md.
    p_holm: float | None
    family_tests: int | None
    cohens_d: float | None
    d_ci_low: float | None
    d_ci_high: float | None
    d_z: float | None
    hedges_g: float | None
    g_ci_low: float | None
    g_ci_high: float | None
    wilcoxon_n: int
    wilcoxon_w: float | None
    wilcoxon_z: float | None
    wilcoxon_p: float | None
    mcnemar_first_only: int | None
    mcnemar_second_only: int | None
    mcnemar_p: float | None
    pooled_first_mean: float | None
    pooled_second_mean: float | None
    pooled_difference: float | None
    pooled_ci_low: float | None
    pooled_ci_high: float | None
    pooled_test: str | None
    pooled_p: float | None
    pooled_p_holm: float | None


def metric_rows(database: Database, by_scenario: bool = False, *, pools_seeds: bool = False) -> list[MetricRow]:
    """Return the summary of every metric over all scenarios, or by scenario; of each seed, or of all together.

    Raises: as `Database.rows`.
    """
    of_all_seeds = "(SELECT * EXCLUDE (pools_seeds) FROM metric_summaries WHERE pools_seeds)"
    rows = database.rows(f"""
        SELECT * EXCLUDE (position)
        FROM {of_all_seeds if pools_seeds else "metric_summary"}
        WHERE {"scenario IS NOT NULL" if by_scenario else "scenario IS NULL"}
        ORDER BY {SETTINGS}, position, scenario, list_position(['fsar', 'cfc', 'dhma'], architecture), architecture
    """)
    return typed(rows, MetricRow)


def cost_rows(database: Database) -> list[CostRow]:
    """Return what coordination costs, by architecture, fleet size and setting. Raises: as `Database.rows`."""
    rows = database.rows("""
        SELECT *
        FROM coordination_cost
        ORDER BY fleet_size, list_position(['fsar', 'cfc', 'dhma'], architecture), architecture, setting
    """)
    return typed(rows, CostRow)


def dialled_rows(database: Database, *, pools_seeds: bool = False) -> list[DialledRow]:
    """Return the summaries over all scenarios and of each, with their dials; of each seed, or of all together.

    Raises: as `Database.rows`.
    """
    rows = database.rows(f"""
        SELECT * EXCLUDE (position, pools_seeds)
        FROM metrics_by_dial
        WHERE {"pools_seeds" if pools_seeds else "NOT pools_seeds"}
        ORDER BY {SETTINGS}, scenario IS NOT NULL, scenario, position, list_position(['fsar', 'cfc', 'dhma'],
            architecture), architecture
    """)
    return typed(rows, DialledRow)


def statistic_rows(database: Database, defined_only: bool = False, *, pools_seeds: bool = False) -> list[StatisticRow]:
    """Return the pairwise tests of each seed, or of all together.

    They follow the published convention (n is all pairs), or with `defined_only` take only pairs where the metric is
    defined in both runs. Raises: as `Database.rows`.
    """
    basis = "defined" if defined_only else "published"
    others = f"""(
        SELECT * EXCLUDE (basis, pools_seeds) FROM all_pairwise_tests
        WHERE basis = '{basis}' AND pools_seeds = {pools_seeds}
    )"""
    rows = database.rows(f"""
        SELECT * EXCLUDE (position)
        FROM {others if defined_only or pools_seeds else "pairwise_tests"}
        ORDER BY
            family NOT LIKE 'architectures%', {SETTINGS},
            position, metric, list_position(['fsar-cfc', 'fsar-dhma', 'cfc-dhma'], comparison), comparison
    """)
    return typed(rows, StatisticRow)


def typed(rows: list[dict[str, Any]], kind: type[_Row]) -> list[_Row]:
    """Return the rows as structs.

    Raises: LedgerCorrupted for a value that no valid event leads to.
    """
    try:
        return msgspec.convert(rows, list[kind])  # type: ignore[valid-type]
    except msgspec.ValidationError as error:
        raise LedgerCorrupted(
            f"the answer: found a row that no events give ({error}), expected what {kind.__name__} holds; run "
            "fsar-ledger verify"
        ) from error
