"""Compare two sides: list those of one ledger or two, choose the requested ones, and pair their runs.

A side is an architecture and configuration under one setting (kind, source, model version, constants, fleet size). Runs
of two sides are paired by seed, scenario and number. The compared runs are read from their ledgers run by run into a
separate database (`paired`).
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import product
from typing import TYPE_CHECKING

import msgspec

from fsar_ledger.base import printable
from fsar_ledger.base.errors import UsageError
from fsar_ledger.base.printable import counted
from fsar_ledger.events.configuration import FULL

if TYPE_CHECKING:  # the verb `compare` imports this module for its help text, so functions import these
    import pyarrow as pa

    from .database import Database

SIDES = """
    SELECT *
    FROM sides
    ORDER BY list_position(['fsar', 'cfc', 'dhma'], architecture), architecture, configuration <> 'full',
        configuration, fleet_size, run_count DESC, side
"""
FORKS = """
    SELECT settings.setting, array_to_string(runs.changes, '; ') AS changes
    FROM run_started AS runs
    INNER JOIN run_settings AS settings ON runs.run_id = settings.run_id
    LEFT JOIN run_numbers AS numbers ON runs.run_id = numbers.run_id
    WHERE runs.changes IS NOT NULL
    GROUP BY ALL
    ORDER BY min(numbers.number)
"""
RUNS = "SELECT * FROM side_runs WHERE side = $side ORDER BY run_id, metric"
CONSTANTS = """
    SELECT name, value FROM constants
    WHERE model = to_json([$kind, $source, $model_version])::VARCHAR AND parameter_set = $parameter_set
"""
DIFFERING = """
    WITH beside AS (
        SELECT
            coalesce(firsts.name, seconds.name) AS name,
            coalesce(firsts.value, if($first_simulated, default_of(coalesce(firsts.name, seconds.name)), NULL),
                'absent') AS first_value,
            coalesce(seconds.value, if($second_simulated, default_of(coalesce(firsts.name, seconds.name)), NULL),
                'absent') AS second_value
        FROM first_constants AS firsts
        FULL JOIN second_constants AS seconds ON firsts.name = seconds.name
    )
    SELECT * FROM beside WHERE first_value <> second_value ORDER BY name
"""
COUNTS = """
    SELECT
        count(*) FILTER (WHERE shares = 'facts') AS same_facts,
        count(*) FILTER (WHERE shares = 'draws') AS same_draws,
        count(*) FILTER (WHERE shares = 'seed') AS same_seed,
        count(DISTINCT seed) FILTER (WHERE differs IS NULL) AS seeds,
        (SELECT count(DISTINCT run_id) FROM side_runs WHERE side = 'first' AND run_id NOT IN (SELECT first_run_id
            FROM side_pairs)) AS first_alone,
        (SELECT count(DISTINCT run_id) FROM side_runs WHERE side = 'second'
            AND run_id NOT IN (SELECT second_run_id FROM side_pairs)) AS second_alone
    FROM side_pairs
"""
ABSENT = "SELECT metric FROM metric_definitions WHERE metric NOT IN (SELECT metric FROM side_moments) ORDER BY position"
LEFT_OUT = """
    SELECT
        differs,
        count(*) AS pairs,
        arg_min({'seed': seed, 'scenario': scenario, 'run': run, 'first': first_run_id, 'second': second_run_id},
            (seed, scenario, run, first_run_id)) AS one
    FROM side_pairs
    WHERE differs IS NOT NULL
    GROUP BY differs
    ORDER BY differs
"""


class Side(msgspec.Struct, frozen=True, kw_only=True):
    """Runs that differ only in seed, scenario and number.

    `letter` is that of their constants, as in `info`; None where no constants are on record. `changes` are those of
    forks, and `fork` the number of these changes in a ledger with forks by several.
    """

    side: str
    architecture: str | None
    configuration: str | None
    fleet_size: int | None
    kind: str
    made_as: str
    source: str | None
    model_version: str | None
    setting: str
    parameter_set: str | None
    run_count: int
    named_count: int
    seeds: list[int] | None
    scenarios: list[str] | None
    letter: str | None = None
    changes: str | None = None
    fork: int | None = None

    @property
    def name(self) -> str:
        """Return its full name, `fsar:full@A/4`, without what is not on record."""
        return "".join(self._parts) + self._end

    @property
    def names(self) -> set[str]:
        """Return all names that select it.

        The configuration `full`, the constants and the fleet size may be left out.
        """
        name, configuration, constants, robots = self._parts
        configurations = {configuration, ""} if self.configuration == FULL else {configuration}
        ends = {self._end, self._end.rstrip("0123456789")}
        return {"".join(parts) for parts in product((name,), configurations, (constants, ""), (robots, ""), ends)}

    @property
    def _parts(self) -> tuple[str, str, str, str]:
        """Return the parts of its name. Without an architecture on record, the source or the kind replaces it."""
        return (
            self.architecture or self.source or self.kind,
            f":{self.configuration}" if self.configuration else "",
            f"@{self.letter}" if self.letter else "",
            "" if self.fleet_size is None else f"/{self.fleet_size}",
        )

    @property
    def _end(self) -> str:
        """Return the suffix that distinguishes workflows and forks from runs of scenarios under the same constants."""
        return f"+{self.made_as}{self.fork or ''}" if self.made_as in ("workflow", "fork") else ""

    def __str__(self) -> str:
        changes = f" with {printable.value(self.changes)}" if self.fork and self.changes else ""
        return f"{printable.value(self.name)} ({counted(self.run_count, 'run')}{changes})"

    def coverage_text(self) -> str:
        """Return in words which seeds, scenarios and numbers its runs have."""
        unnamed = (
            ""
            if self.named_count == self.run_count
            else f", {self.run_count - self.named_count:,} of them without seed, scenario, number or size"
        )
        seeds = (
            f"seed{'' if len(self.seeds) == 1 else 's'} {printable.list_few(map(str, self.seeds))}"
            if self.seeds
            else "no seed"
        )
        return (
            f"{self}{unnamed} under {seeds}, "
            f"{printable.list_few(map(printable.value, self.scenarios or ())) or 'no scenario'}"
        )


class LeftOut(msgspec.Struct, frozen=True, kw_only=True):
    """The number of pairs left out for one reason (`side_pairs`), and the first of them."""

    differs: str
    pairs: int
    one: dict[str, str | int]


class SideRow(msgspec.Struct, frozen=True, kw_only=True):
    """The paired difference of one metric, first minus second, in the metric's unit (`statistics/side_differences`).

    `seed` None: all seeds together; `scenario` None: all scenarios. In `differing_pairs` of the `n` pairs the runs
    differ.
    """

    seed: int | None
    scenario: str | None
    metric: str
    n: int
    differing_pairs: int
    first_mean: float | None
    second_mean: float | None
    mean_difference: float | None
    ci_low: float | None
    ci_high: float | None
    test: str | None
    p: float | None
    p_holm: float | None
    family_tests: int
    d_z: float | None


class Differing(msgspec.Struct, frozen=True, kw_only=True):
    """A constant in which the two sides differ; a value is JSON, or `absent`."""

    name: str
    first_value: str
    second_value: str


class Paired(msgspec.Struct, frozen=True, kw_only=True):
    """The comparison of two sides: how many pairs share facts, draws or seed, which runs are left out, and the rows."""

    same_facts: int
    same_draws: int
    same_seed: int
    seeds: int
    first_alone: int
    second_alone: int
    left_out: list[LeftOut]
    constants: list[Differing]
    absent: list[str]
    """Metrics that no pair defines on both sides."""

    rows: list[SideRow]

    @property
    def pairs(self) -> int:
        """Return how many pairs are compared."""
        return self.same_facts + self.same_draws + self.same_seed


def sides(database: "Database") -> list[Side]:
    """Return all sides of a ledger, in the order of the paper. Raises: as `Database.rows` and `models`."""
    from .results import lettered, models, typed

    letters = {
        (model.kind, model.source, model.model_version, model.parameter_set): letter
        for model, letter in lettered(models(database))
    }
    changes = {str(row["setting"]): str(row["changes"]) for row in database.rows(FORKS)}
    several = [*dict.fromkeys(changes.values())]
    listed = []
    for side in typed(database.rows(SIDES), Side):
        letter = letters.get((side.kind, side.source, side.model_version, side.parameter_set))
        change = changes.get(side.setting)
        number = several.index(change) + 1 if change is not None and len(several) > 1 else None
        listed.append(msgspec.structs.replace(side, letter=letter, changes=change, fork=number))
    return listed


def chosen(
    held: Sequence[Sequence[Side]], asked: tuple[str | None, str | None], places: Sequence[str]
) -> tuple[Side, Side]:
    """Return the two requested sides.

    Args:
        held: The sides of the ledger, or of each of two.
        asked: The names given as `--first` and `--second`; None where not given.
        places: The ledgers, for messages.

    Raises:
        UsageError: A name matches no side or several, or a missing name leaves several to choose from.
    """
    firsts, seconds = held[0], held[-1]
    first = _requested_side("--first", asked[0], firsts, places[0])
    second = _requested_side("--second", asked[1], seconds, places[-1])
    if len(held) == 1:
        first, second = _of_one(firsts, first, second, places[0])
        if first.side == second.side:
            raise UsageError(
                f"{places[0]}: found {first} as both sides, expected two different ones; it holds {_listed(firsts)}"
            )
        return first, second
    if first is None and second is None:
        alike = [(first_side, second_side) for first_side in firsts for second_side in _alike(first_side, seconds)]
        only = [(firsts[0], seconds[0])] if len(firsts) == len(seconds) == 1 else alike
        if len(only) != 1:
            found = f"found {counted(len(alike), 'side')} in common" if alike else "found no side in common"
            raise UsageError(
                f"{found}, expected --first NAME, or one: {places[0]} holds {_listed(firsts)}; {places[1]} holds "
                f"{_listed(seconds)}"
            )
        return only[0]
    return first or _like(second, firsts, "--first", places[0]), second or _like(first, seconds, "--second", places[1])


def _alike(one: Side | None, held: Sequence[Side]) -> list[Side]:
    """Return the sides that equal this one except for constants, model and kind of runs.

    If there is none, return those that also differ in fleet size.
    """
    named = [
        side
        for side in held
        if one
        and (side.architecture, side.configuration, side.made_as) == (one.architecture, one.configuration, one.made_as)
    ]
    return [side for side in named if one and side.fleet_size == one.fleet_size] or named


def _requested_side(option: str, text: str | None, held: Sequence[Side], place: str) -> Side | None:
    if text is None:
        return None
    hits = [side for side in held if text in side.names]
    if len(hits) == 1:
        return hits[0]
    name = printable.value(text)
    if hits:
        raise UsageError(f"{option} {name}: found {len(hits):,} sides in {place}: {_listed(hits)}; name one of them")
    raise UsageError(
        f"{option} {name}: found no such runs in {place}, expected ARCHITECTURE[:CONFIGURATION][@CONSTANTS][/ROBOTS]: "
        f"it holds {_listed(held)}"
    )


def _of_one(held: Sequence[Side], first: Side | None, second: Side | None, place: str) -> tuple[Side, Side]:
    """Return both sides of one ledger, if it leaves no choice."""
    if first is not None and second is not None:
        return first, second
    side = first or second
    others = [other for other in held if side is None or other.side != side.side]
    if len(others) != (1 if side else 2):
        missing = (
            "--first NAME and --second NAME" if side is None else "--second NAME" if second is None else "--first NAME"
        )
        if len(held) < 2:
            only = f"1 side, {held[0]}" if held else "no runs"
            raise UsageError(f"{place}: found {only}, expected two sides to compare; give a second ledger")
        raise UsageError(
            f"{place}: found {len(held):,} sides, expected two, or {missing} to say which; it holds {_listed(held)}"
        )
    return (others[0], others[1]) if side is None else (side, others[0]) if first is not None else (others[0], side)


def _like(side: Side | None, others: Sequence[Side], option: str, ledger: str) -> Side:
    """Return the side of the other ledger that is like this one, or its only side."""
    alike = _alike(side, others) or list(others)
    if len(alike) != 1:
        raise UsageError(
            f"{option} is missing: found {len(alike):,} possible sides in {ledger}: {_listed(alike)}; name one"
        )
    return alike[0]


def _listed(sides: Sequence[Side]) -> str:
    return printable.list_few(map(str, sides), "more, which `fsar-ledger info` lists") or "no runs"


@contextmanager
def beside(first: "pa.Table", second: "pa.Table") -> "Iterator[Database]":
    """Yield a database that compares two sides, given as rows of `side_runs`, under the names `first` and `second`."""
    import pyarrow as pa

    from .database import Database

    comparison = {
        "comparison": "first-second",
        "family": "first-second",
        "configuration": None,
        "setting": None,
        "first_side": "first",
        "second_side": "second",
    }
    named = [
        rows.set_column(rows.column_names.index("side"), "side", pa.array([name] * len(rows), pa.string()))
        for name, rows in (("first", first), ("second", second))
    ]
    with Database(None, ()) as database:
        database.hold("side_runs", pa.concat_tables(named))
        database.hold("side_comparisons", pa.Table.from_pylist([comparison]))
        yield database


def paired(
    held: "Sequence[Database]", both: tuple[Side, Side], *, pools_seeds: bool = False, by_scenario: bool = False
) -> Paired:
    """Compare the runs of the two sides, each from its own ledger, in pairs. Raises: as `Database.rows`."""
    from .results import typed

    tables = [
        database.table(RUNS, {"side": side.side}) for database, side in zip((held[0], held[-1]), both, strict=True)
    ]
    with beside(*tables) as database:
        for name, source, side in zip(("first_constants", "second_constants"), (held[0], held[-1]), both, strict=True):
            database.hold(
                name,
                source.table(
                    CONSTANTS, {key: getattr(side, key) for key in ("kind", "source", "model_version", "parameter_set")}
                ),
            )
        [counts] = database.rows(COUNTS)
        simulated = {"first_simulated": both[0].kind == "simulated", "second_simulated": both[1].kind == "simulated"}
        rows = database.rows(
            """
            SELECT * EXCLUDE (first_side, second_side, pools_seeds, position)
            FROM side_differences
            WHERE pools_seeds = $pooled AND (scenario IS NOT NULL) = $by_scenario
            ORDER BY seed, position, scenario
            """,
            {"pooled": pools_seeds, "by_scenario": by_scenario},
        )
        return Paired(
            **counts,
            left_out=typed(database.rows(LEFT_OUT), LeftOut),
            constants=typed(database.rows(DIFFERING, simulated), Differing),
            absent=[row["metric"] for row in database.rows(ABSENT)],
            rows=typed(rows, SideRow),
        )
