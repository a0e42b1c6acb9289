"""Explain what can be compared in a ledger, what cannot, and why."""

from collections.abc import Iterable, Sequence

import msgspec

from fsar_ledger.base.printable import NAMED, counted, every, list_few, number

from .database import Database
from .results import StatisticRow, setting_of, typed

MIN_WILCOXON = 6
"""The least number of differing pairs for which Wilcoxon's test has a p (`statistics/wilcoxon_tests`)."""

DIFFERS = {
    "setting": "were made under other constants, by another model, or as forks by other changes",
    "facts": "did not meet the same facts of the world",
    "repeated": "cannot be told apart: one architecture has several runs of one seed, scenario and number",
    "unobserved": "are not known to have met the same world, because one of them does not observe it",
}
# See docs/decisions/pairs-met-the-same-world.md.
FAULTS = ("facts", "repeated")
"""Reasons that no experiment of ours leads to: such runs were made or changed elsewhere."""

SOMEWHERE = "under some seeds or settings "
"""Precedes what other rows of the same comparison do have."""

WORLDS = """
    SELECT
        comparison,
        configuration,
        differs,
        count(*) AS pairs,
        arg_min(
            {
                'seed': seed, 'scenario': scenario, 'fleet_size': fleet_size, 'run': run,
                'first_run_id': first_run_id, 'second_run_id': second_run_id, 'first_found': first_found,
                    'second_found': second_found
            },
            (seed, scenario, run, first_run_id, second_run_id)
        ) AS first
    FROM differing_worlds
    GROUP BY comparison, configuration, differs
    ORDER BY differs NOT IN ('facts', 'repeated'), configuration <> 'full', configuration, list_position(['fsar-cfc',
        'fsar-dhma'], comparison), comparison
"""

KINDS = """
    SELECT kind, architecture, count(*) AS runs, count(*)
        FILTER (WHERE seed IS NULL OR scenario IS NULL OR run IS NULL OR fleet_size IS NULL) AS nameless
    FROM runs
    GROUP BY kind, architecture
    ORDER BY kind, architecture
"""


GROUNDS = """
    WITH forked AS (
        SELECT runs.architecture, runs.configuration, count(*) AS forks
        FROM compared_runs AS runs
        INNER JOIN run_settings AS settings ON runs.run_id = settings.run_id
        WHERE settings.kind = 'fork'
        GROUP BY ALL
    )
    SELECT
        grounds.*, coalesce(firsts.forks, 0) AS first_forks, coalesce(seconds.forks, 0) AS second_forks
    FROM comparable_runs AS grounds
    LEFT JOIN forked AS firsts ON grounds.first_architecture = firsts.architecture
        AND grounds.first_configuration = firsts.configuration
    LEFT JOIN forked AS seconds ON grounds.second_architecture = seconds.architecture
        AND grounds.second_configuration = seconds.configuration
    ORDER BY family NOT LIKE 'architectures%', family, list_position(['fsar-cfc', 'fsar-dhma'], comparison), comparison
"""


UNPAIRED = """
    WITH sides AS (
        SELECT comparison, configuration, first_architecture AS architecture, first_configuration AS its
            FROM comparable_runs WHERE pair_count > 0
        UNION ALL
        SELECT comparison, configuration, second_architecture AS architecture, second_configuration AS its
            FROM comparable_runs WHERE pair_count > 0
    ),
    partners AS (
        SELECT comparison, configuration, first_run_id AS run_id FROM run_pairs
        UNION
        SELECT comparison, configuration, second_run_id AS run_id FROM run_pairs
    )
    SELECT sides.comparison, runs.architecture, sides.its AS configuration, runs.seed, count(*) AS runs,
        count(*) FILTER (WHERE settings.kind = 'fork') AS forks
    FROM sides
    INNER JOIN compared_runs AS runs ON sides.architecture = runs.architecture AND sides.its = runs.configuration
    INNER JOIN run_settings AS settings ON runs.run_id = settings.run_id
    ANTI JOIN partners ON sides.comparison = partners.comparison AND sides.configuration = partners.configuration
        AND runs.run_id = partners.run_id
    GROUP BY ALL
    ORDER BY ALL
"""

IMPUTED = """
    WITH paired AS (
        SELECT unnest([first_run_id, second_run_id]) AS run_id FROM run_pairs WHERE differs IS NULL
    )
    SELECT measured.metric, definitions.published_value, definitions.scale, count(*) AS runs,
        count(*) FILTER (WHERE measured.run_id IN (
            SELECT run_id FROM run_metrics WHERE metric = 'recovery_containment' AND denominator > 0
        )) AS failed
    FROM run_metrics AS measured
    INNER JOIN metric_definitions AS definitions ON measured.metric = definitions.metric
    WHERE measured.value IS NULL AND measured.published_convention_value IS NOT NULL
        AND measured.run_id IN (SELECT run_id FROM paired)
    GROUP BY ALL
    ORDER BY min(definitions.position)
"""


class Pair(msgspec.Struct, frozen=True, kw_only=True):
    """Two runs that met different worlds, and the first difference in each; None if there is nothing more to show."""

    seed: int
    scenario: str
    fleet_size: int
    run: int
    first_run_id: str
    second_run_id: str
    first_found: str | None
    second_found: str | None


class DifferingWorlds(msgspec.Struct, frozen=True, kw_only=True):
    """How many pairs of one comparison are left out for one reason, and the first of them."""

    comparison: str
    configuration: str
    differs: str
    pairs: int
    first: Pair

    @property
    def is_fault(self) -> bool:
        """Return whether no experiment of ours leads to this."""
        return self.differs in FAULTS

    def __str__(self) -> str:
        pair = self.first
        count = f"{counted(self.pairs, 'pair')} of runs {'is' if self.pairs == 1 else 'are'} left out: they"
        world = f"seed {pair.seed}, {pair.scenario}, {pair.fleet_size} robots, run {pair.run}"
        difference = (
            f" has {pair.first_found or 'nothing more'}, {pair.second_run_id} has {pair.second_found or 'nothing more'}"
        )
        second = difference if self.differs in ("setting", "facts") else f" and {pair.second_run_id}"
        return f"{self.comparison}: {count} {DIFFERS[self.differs]}; first under {world}: {pair.first_run_id}{second}"


class Ground(msgspec.Struct, frozen=True, kw_only=True):
    """What the ledger holds of the two sides of a comparison.

    Units: counts of runs, of the forks among them, of worlds (seed, scenario, fleet size, run) and of pairs.
    """

    comparison: str
    family: str
    configuration: str
    first_architecture: str
    first_configuration: str
    second_architecture: str
    second_configuration: str
    first_count: int
    second_count: int
    first_forks: int
    second_forks: int
    shared_worlds: int
    first_seeds: list[int] | None
    second_seeds: list[int] | None
    first_fleet_sizes: list[int] | None
    second_fleet_sizes: list[int] | None
    first_scenarios: list[str] | None
    second_scenarios: list[str] | None
    pair_count: int
    left_out: int

    def why_not(self) -> str | None:
        """Return why nothing is compared here, and what to do about it; None if there are pairs."""
        if self.pair_count:
            return None
        first, second = (
            f"{self.first_architecture} ({self.first_configuration})",
            f"{self.second_architecture} ({self.second_configuration})",
        )
        if not self.first_count or not self.second_count:
            missing, present, count, forks = (
                (first, second, self.second_count, self.second_forks)
                if not self.first_count
                else (second, first, self.first_count, self.first_forks)
            )
            return (
                f"{self.comparison}: found {_runs(count, forks)} of {present} and none of {missing}; "
                "simulate it with the same seed, scenarios, runs and fleet size"
            )
        if not self.shared_worlds:
            sides = (
                (first, self.first_seeds, self.first_fleet_sizes, self.first_scenarios),
                (second, self.second_seeds, self.second_fleet_sizes, self.second_scenarios),
            )
            both = "; ".join(
                f"{name} under seeds {_list_values(seeds)}, {_list_values(sizes)} robots, {_list_values(scenarios)}"
                for name, seeds, sizes, scenarios in sides
            )
            return (
                f"{self.comparison}: no runs of both have the same seed, scenario, fleet size and number: found "
                f"{both}; simulate both alike"
            )
        return (
            f"{self.comparison}: every pair of runs ({self.left_out:,}) is left out, as said above; simulate both "
            "under one world and the same constants"
        )


def _runs(count: int, forks: int) -> str:
    """Return the counts of runs and forks, in words; `count` includes the forks."""
    parts = [counted(number, noun) for number, noun in ((count - forks, "run"), (forks, "fork")) if number]
    return every(parts)


def _list_values(values: Sequence[object] | None) -> str:
    """Return all of a few values, else the first and how many more there are."""
    names = [str(value) for value in values or ()]
    return list_few(names) if len(names) > NAMED else every(names, "")


ANY_DIFFERS = "SELECT differs FROM run_pairs WHERE differs IS NOT NULL LIMIT 1"


def differing_worlds(database: Database) -> list[DifferingWorlds]:
    """Return the pairs left out because their worlds differ, by comparison and reason, faults first.

    Raises: as `Database.rows`.
    """
    if not database.rows(ANY_DIFFERS):  # finding the first facts that differ reads all facts
        return []
    return typed(database.rows(WORLDS), DifferingWorlds)


def not_compared(database: Database) -> list[str]:
    """Return why each comparison without a pair has none.

    For a ledger that holds neither side of any, return why. Raises: as `Database.rows`.
    """
    grounds = typed(database.rows(GROUNDS), Ground)
    if grounds:
        return [why for ground in grounds if (why := ground.why_not())]
    kinds = database.rows(KINDS)
    if not kinds:
        return ["found no runs; `fsar-ledger simulate` makes some"]
    names = [
        f"{counted(row['runs'], 'run')} ({row['kind']}) of {row['architecture'] or 'no named architecture'}"
        for row in kinds
    ]
    named = list_few(names, "kinds more")
    if all(row["nameless"] == row["runs"] for row in kinds):
        return [
            f"found {named}, all without seed, scenario, fleet size or number; runs that are not known to have met one "
            "world are not paired"
        ]
    return [f"found {named}; expected two architectures, or the configurations of one"]


def left_over(database: Database) -> list[str]:
    """Return which runs have no partner in a comparison that has pairs. Raises: as `Database.rows`."""
    lines = []
    for row in database.rows(UNPAIRED):
        name = (
            row["architecture"] if row["configuration"] == "full" else f"{row['architecture']} ({row['configuration']})"
        )
        remark = "has no partner and is left out" if row["runs"] == 1 else "have no partner and are left out"
        lines.append(
            f"{row['comparison']}: {_runs(row['runs'], row['forks'])} of {name} under seed {row['seed']} {remark}"
        )
    return lines


def imputed(database: Database, rows: Iterable[StatisticRow]) -> list[str]:
    """Return which of the rows count runs without a value, how many, and as what. Raises: as `Database.rows`."""
    metrics_shown = {row.metric for row in rows}
    return [
        f"{row['metric']}: {_without_value(row['runs'], row['failed'])}, as {number(row['published_value'])}"
        f"{' s' if row['scale'] == 'seconds' else ''} (basis published); "
        "`fsar-ledger query statistics/all_pairwise_tests` also has the tests without such pairs (basis defined)"
        for row in database.rows(IMPUTED)
        if row["metric"] in metrics_shown
    ]


def _without_value(runs: int, failed: int) -> str:
    """Return that `runs` runs without a value count; in `failed` of them something failed, which gives no value."""
    parts = [f"{counted(runs - failed, 'run')} without a failure"] if runs > failed else []
    parts += [f"{counted(failed, 'run')} with failures that give no value"] if failed else []
    alike = "as the paper counts those without a failure" if failed else "as in the paper"
    return f"{every(parts)} {'counts' if runs == 1 else 'count'} {alike}"


def too_few(rows: Sequence[StatisticRow]) -> list[str]:
    """Return which metrics have no Wilcoxon test, anywhere or in some rows, because too few pairs differ."""
    tested = {(row.comparison, row.metric) for row in rows if row.wilcoxon_n >= MIN_WILCOXON}
    untested: dict[tuple[str, bool], dict[str, None]] = {}
    for row in rows:
        if 0 < row.wilcoxon_n < MIN_WILCOXON:
            untested.setdefault((row.comparison, (row.comparison, row.metric) in tested), {})[row.metric] = None
    return [
        f"{comparison}: {SOMEWHERE if is_tested else ''}no Wilcoxon test of {', '.join(names)}: fewer than "
        f"{MIN_WILCOXON} pairs differ"
        for (comparison, is_tested), names in untested.items()
    ]


def remarks_on(rows: Sequence[StatisticRow], metrics: Sequence[str]) -> list[str]:
    """Return what the rows leave out.

    These are metrics that no pair defines for both runs, and comparisons of a single pair.
    """
    defined = {(row.comparison, row.metric) for row in rows}
    counts: dict[tuple[str, object], dict[str, int]] = {}
    for row in rows:
        counts.setdefault((row.comparison, setting_of(row)), {})[row.metric] = row.n
    lines: dict[str, None] = {}
    for (comparison, _), pairs in counts.items():
        for where, elsewhere in (("", False), (SOMEWHERE, True)):
            missing = [
                metric for metric in metrics if metric not in pairs and ((comparison, metric) in defined) == elsewhere
            ]
            if missing:
                lines[
                    f"{comparison}: {where}no pair of runs has a value of {', '.join(missing)} on both sides: "
                    "undefined, or not observed"
                ] = None
        if max(pairs.values()) == 1:
            lines[f"{comparison}: one pair of runs has a difference but no test; simulate more runs"] = None
    return list(lines)
