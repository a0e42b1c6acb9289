"""Typed rows of the metric and statistics queries, and the models under which runs were made."""

from collections.abc import Iterable, Iterator, Sequence
from hashlib import sha256
from itertools import count, product
from operator import attrgetter
from string import ascii_uppercase
from typing import Any, TypeVar

import msgspec

from fsar_ledger.base.errors import LedgerCorrupted
from fsar_ledger.base.parameters import BadParameters, read_parameters
from fsar_ledger.metrics.database import Database
from fsar_ledger.metrics.definitions import measured_sql, published_metrics

_Row = TypeVar("_Row", bound=msgspec.Struct)

CONDITIONS = ("configuration", "fleet_size", "seed", "kind", "source", "model_version", "constants")
"""Columns that separate runs that are never ranked together, nor share a table."""

setting_of = attrgetter(*CONDITIONS)
"""Returns the values of these columns of a row."""


def named_setting(row: Any) -> dict[str, Any]:
    """Return the values of these columns of a row, by name."""
    return {name: getattr(row, name) for name in CONDITIONS}


def of_all_seeds(setting: Sequence[Any]) -> dict[str, Any]:
    """Return a setting by name, as parameters of a query that takes the runs of all seeds together."""
    return {name: value for name, value in zip(CONDITIONS, setting, strict=True) if name != "seed"}


def measure_the_printed(database: Database) -> None:
    """Restrict every query to the metrics that the paper prints, since others would take time.

    Call it before any query, and after `take_seeds_together`.
    """
    sql = measured_sql(published_metrics())
    database.prepare(sql)
    database.define("metric_measurements", sql)


def take_seeds_together(database: Database, chosen_sql: str = "TRUE") -> None:
    """Make every query pool the runs that meet the condition: none of them has a seed any more.

    Call it before any query.
    """
    database.hold_rows_of_slices(["metric_measurements", "compared_runs", "unobservable"])  # the same without seeds
    database.prepare("SELECT * FROM run_started")
    runs = database.library.find("staging/runs").sql
    database.define("runs", f"SELECT * REPLACE (NULL::BIGINT AS seed) FROM ({runs}) WHERE {chosen_sql}")


def same_setting(of: str = "") -> str:
    """Return the condition that rows of a relation, given as `NAME.`, are of the setting in `of_all_seeds`."""
    return " AND ".join(f"{of}{name} IS NOT DISTINCT FROM ${name}" for name in CONDITIONS if name != "seed")


SETTINGS = (
    "configuration <> 'full', configuration, fleet_size, kind <> 'simulated', kind, source, model_version, constants, "
    "seed"
)
"""The order of rows of different settings: those of the paper's table first."""


class MetricRow(msgspec.Struct, frozen=True, kw_only=True):
    """One metric over the runs of one architecture under the same constants, with one seed or with all.

    `constants` names those that differ between runs of the same model in this ledger, None if none do.
    Units: `mean`, `sd` (per run) and the 95 % interval in the metric's unit (share, count, seconds); `n` runs of
        `seeds` seeds; `denominator` what the metric counts, summed over runs; `mean_without_routine` if it also counts
        routine operations; `runs_not_observed` runs whose source does not record what the metric rests on, which count
        nowhere else. Reading: R42.
    None: undefined, not observable, not recorded in the runs, or `scenario` (`seed`) for all of them together.
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


def statistic_rows(database: Database, *, pools_seeds: bool = False) -> list[StatisticRow]:
    """Return the pairwise tests by the published convention (n is all pairs), of each seed or of all together.

    Raises: as `Database.rows`.
    """
    pooled = """(
        SELECT * EXCLUDE (basis, pools_seeds) FROM all_pairwise_tests WHERE basis = 'published' AND pools_seeds
    )"""
    rows = database.rows(f"""
        SELECT * EXCLUDE (position)
        FROM {pooled if pools_seeds else "pairwise_tests"}
        ORDER BY
            family NOT LIKE 'architectures%', {SETTINGS},
            position, metric, list_position(['fsar-cfc', 'fsar-dhma', 'cfc-dhma'], comparison), comparison
    """)
    return typed(rows, StatisticRow)


PAPER_PAIRS = 100
"""Pairs of runs in each of the paper's tests."""


def drawn_effects(database: Database, setting: Sequence[Any]) -> dict[tuple[str, str], list[float | None]]:
    """Return Cohen's d in each drawn experiment of the paper's size, by metric and comparison, in one setting.

    The setting is as `setting_of` returns it; the runs of all seeds are drawn from together. `verdicts.odds` compares
    them with `definitions.printed_tests`.

    Raises: as `Database.rows`.
    """
    rows = database.rows(
        f"""
        SELECT metric, comparison, list(cohens_d ORDER BY draw) AS numbers
        FROM drawn_effects
        WHERE n = {PAPER_PAIRS} AND {same_setting()}
        GROUP BY metric, comparison
        """,
        of_all_seeds(setting),
    )
    return {(row["metric"], row["comparison"]): row["numbers"] for row in rows}


def typed(rows: list[dict[str, Any]], kind: type[_Row]) -> list[_Row]:
    """Return the rows as structs.

    Raises: LedgerCorrupted for a value that valid events cannot give.
    """
    try:
        return msgspec.convert(rows, list[kind])  # type: ignore[valid-type]
    except msgspec.ValidationError as error:
        raise LedgerCorrupted(
            f"the answer: found a row that no events can give ({error}), expected what {kind.__name__} holds; run "
            "fsar-ledger verify"
        ) from error


MODELS = """
    SELECT
        started.kind,
        started.source,
        started.model_version,
        settings.parameter_set,
        any_value(settings.constants) AS constants,
        arg_min(started.parameters, started.run_id) AS text,
        count(*) AS runs,
        min(started.run_id) AS first
    FROM run_started AS started
    INNER JOIN run_settings AS settings ON started.run_id = settings.run_id
    GROUP BY started.kind, started.source, started.model_version, settings.parameter_set
    ORDER BY first
"""


class Model(msgspec.Struct, frozen=True):
    """The runs of one kind, source and model version under the same constants, by value.

    `text` is the record of these in the first run. `constants` names those that differ between runs of the model, None
    if none do. Runs that were not simulated may have neither a model nor readable parameters: then `parameters` is
    None.
    """

    kind: str
    source: str | None
    model_version: str | None
    parameter_set: str | None
    constants: str | None
    text: str | None
    parameters: dict[str, Any] | None
    runs: int
    first: str

    @property
    def sha256(self) -> str | None:
        """Return the digest of the constants: `runs.parameters_sha256` of the first of the runs."""
        return None if self.text is None else sha256(self.text.encode()).hexdigest()


def models(database: Database) -> tuple[Model, ...]:
    """Return all models, in the order of the names of their first runs.

    Raises: LedgerCorrupted if a simulated run records something else as its parameters.
    """
    return tuple(
        Model(**row, parameters=_read(row["kind"], row["first"], row["text"])) for row in database.rows(MODELS)
    )


def lettered(found: Iterable[Model]) -> list[tuple[Model, str | None]]:
    """Return the models, those with most runs first, with the letter of their constants in commands.

    The letter is None where no constants are on record.
    """
    letters = _letters()
    return [
        (model, None if model.text is None else next(letters))
        for model in sorted(found, key=lambda model: (-model.runs, model.model_version or "", model.text or ""))
    ]


def _letters() -> Iterator[str]:
    """Yield A to Z, AA, AB and so on."""
    return ("".join(letters) for length in count(1) for letters in product(ascii_uppercase, repeat=length))


def _read(kind: str, run: str, parameters: str | None) -> dict[str, Any] | None:
    if parameters is None:
        return {}
    try:
        return read_parameters(parameters)
    except BadParameters as error:
        if kind != "simulated":  # 0.1.0 and 0.2.0 stored any text for other kinds
            return None
        raise LedgerCorrupted(
            f"run {run!r:.300}, seq 0, field parameters: {error}; do not rely on this ledger, run fsar-ledger verify "
            "--replay"
        ) from error
