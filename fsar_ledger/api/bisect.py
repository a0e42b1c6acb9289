"""The first run in which two sides disagree on an outcome, and the first event at which they part there."""

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from itertools import islice
from typing import TYPE_CHECKING

import msgspec

from fsar_ledger.analysis.outcomes import Outcome, outcome_of
from fsar_ledger.errors import QueryFailed, UsageError
from fsar_ledger.ledger.chain.read import View
from fsar_ledger.metrics.sides import Side, chosen, sides

from .difference import Diff, difference_of
from .provenance import Provenance
from .whatif import Asked, changes_of, fork_pairs, runs_of

if TYPE_CHECKING:
    from fsar_ledger.metrics.database import Database

    from .ledger import Ledger

PAIRS = """
    SELECT run_id, run_number, seed, scenario, run FROM (
        SELECT DISTINCT found.run_id, numbers.number AS run_number, found.seed, found.scenario, found.run
        FROM side_runs AS found
        INNER JOIN run_numbers AS numbers ON found.run_id = numbers.run_id
        WHERE found.side = $side
    )
    ORDER BY run_number
"""
PAIRS_AT_ONCE = 100
"""Pairs of runs and forks that are judged together."""
World = tuple[object, object, object]


class Bisected(msgspec.Struct, frozen=True, kw_only=True):
    """The pairs of two sides that met the same seed, scenario and number, by whether they have the outcome.

    `undefined` pairs more have a run in which there is no value to compare; they neither agree nor disagree. `diff` are
    the differences of the first pair that disagrees, in the order of the ledger; None: none does.
    """

    outcome: str
    first: str
    second: str
    pairs: int
    both: int
    neither: int
    first_only: int
    second_only: int
    undefined: int
    diff: Diff | None
    provenances: tuple[Provenance, ...]


def bisect_sides(
    ledgers: "Sequence[Ledger]",
    provenances: tuple[Provenance, ...],
    names: tuple[str | None, str | None],
    outcome: str,
) -> Bisected:
    """Compare two sides of one ledger, or of two, by an outcome.

    Raises:
        UsageError: There is no such side, metric or invariant, or the sides have no pair.
        QueryFailed: The SELECT of the outcome fails.
    """
    asked = outcome_of(outcome)
    with ExitStack() as stack:
        held = [stack.enter_context(ledger.database()) for ledger in ledgers]
        both = chosen([sides(database) for database in held], names, [str(one.path) for one in ledgers])
        firsts, seconds = _runs(held[0], both[0]), _runs(held[-1], both[1])
        having = [_having(ledger, database, asked) for ledger, database in zip(ledgers, held, strict=True)]
    pairs = [(run, seconds[world]) for world, run in firsts.items() if world in seconds]
    if not pairs:
        raise UsageError(
            f"{both[0]} and {both[1]}: found no run of both with the same seed, scenario and number; simulate one as "
            "the other"
        )
    has = [(having[0](first), having[-1](second)) for first, second in pairs]
    at = next((at for at, found in enumerate(has) if disagree(*found)), None)
    diff = None
    if at is not None:
        one, other = pairs[at]
        diff = difference_of(ledgers[0].record(one), ledgers[-1].record(other), provenances)
    return _bisected(asked, (str(both[0]), str(both[1])), has, diff, provenances)


def bisect_changes(
    view: View, provenance: Provenance, changes: Asked, architectures: Sequence[str], outcome: str
) -> Bisected:
    """Compare the runs of a ledger with their forks by an outcome. Raises: as `bisect_sides` and `Ledger.whatif`."""
    asked = outcome_of(outcome)
    runs, parsed = runs_of(view, architectures), changes_of(changes)
    has: list[tuple[bool | None, bool | None]] = []
    diff: Diff | None = None
    pairs = fork_pairs(view, runs, parsed)
    while batch := list(islice(pairs, PAIRS_AT_ONCE)):
        both = [
            (one.times_us, one.caused_by, one.events) for pair in batch for one in (pair.base.record, pair.fork.record)
        ]
        held = asked.of(both)
        for pair, first, second in zip(batch, held[::2], held[1::2], strict=True):
            has.append((first, second))
            if disagree(first, second) and diff is None:
                diff = difference_of(pair.base.record, pair.fork.record, (provenance,))
    return _bisected(asked, ("as recorded", "changed"), has, diff, (provenance,))


def _bisected(
    asked: Outcome,
    names: tuple[str, str],
    has: list[tuple[bool | None, bool | None]],
    diff: Diff | None,
    provenances: tuple[Provenance, ...],
) -> Bisected:
    return Bisected(
        outcome=asked.text,
        first=names[0],
        second=names[1],
        pairs=sum(None not in found for found in has),
        both=has.count((True, True)),
        neither=has.count((False, False)),
        first_only=has.count((True, False)),
        second_only=has.count((False, True)),
        undefined=sum(None in found for found in has),
        diff=diff,
        provenances=provenances,
    )


def _runs(database: "Database", side: Side) -> dict[World, str]:
    """Return the runs of a side that can be paired, by seed, scenario and number, in the order of the ledger."""
    rows = database.rows(PAIRS, {"side": side.side})
    return {(row["seed"], row["scenario"], row["run"]): row["run_id"] for row in rows}


def disagree(first: bool | None, second: bool | None) -> bool:
    """Tell whether one has the outcome and the other lacks it; without a value, a run does neither."""
    return {first, second} == {True, False}


def _having(ledger: "Ledger", database: "Database", outcome: Outcome) -> Callable[[object], bool | None]:
    """Return what tells of a run of the ledger whether it has the outcome, None if undefined. Raises: QueryFailed."""
    valued = {row["run_id"] for row in database.rows(outcome.defined)} if outcome.defined else None
    if outcome.is_own:
        own = ledger.sql(outcome.sql)
        if "run_id" not in own.columns:
            raise QueryFailed(f"outcome: found the columns {', '.join(own.columns)}, expected run_id")
        held = {row["run_id"] for row in own}
    else:
        held = {row["run_id"] for row in database.rows(outcome.sql)}
    return lambda run: None if valued is not None and run not in valued else run in held
