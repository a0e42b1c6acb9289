"""The verb `bisect`: the first run, and in it the first event, at which two sides disagree on an outcome."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from itertools import islice
from typing import TYPE_CHECKING

import msgspec

from fsar_ledger.base import printable
from fsar_ledger.base.errors import UsageError, option
from fsar_ledger.base.printable import SafeText, counted
from fsar_ledger.metrics.comparison_sides import Side, chosen, sides

from .answers import Answer, Screen
from .compare import LEFT_OUT, no_partner
from .diff import Diff, diff_text, difference_of
from .names import Names, names_of
from .verbs import ArchitectureOption, FirstOption, OtherArgument, SecondOption, declare, verb
from .whatif import refusals, without_effect

if TYPE_CHECKING:
    from fsar_ledger.analysis.causes import Outcome
    from fsar_ledger.analysis.whatif import RefusedChange
    from fsar_ledger.metrics.database import Database
    from fsar_ledger.metrics.provenance import Provenance

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


class BisectResult(Answer, msgspec.Struct, frozen=True, kw_only=True):
    """The pairs of two sides that met the same seed, scenario and number, by whether they have the outcome.

    `undefined` counts further pairs with a run that has no value to compare, or with the fork of a live run that ends
    before everything has happened; they neither agree nor disagree. `repeated` counts further pairs that cannot be told
    from others, as in `compare`; `first_alone` and `second_alone` count the runs in no pair. `diff` has the differences
    of the first pair that disagrees, in the order of the ledger; None: none does. `refused`: in how many pairs a change
    is refused, and why.
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
    repeated: int = 0
    first_alone: int = 0
    second_alone: int = 0
    refused: tuple["RefusedChange", ...] = ()
    diff: Diff | None
    provenances: tuple["Provenance", ...]

    def document(self, screen: Screen) -> Mapping[str, object]:
        """Return the counts, and the differences of the first pair that disagrees."""
        return {**Answer.document(self, screen), "diff": None if self.diff is None else self.diff.document(screen)}

    def text(self, screen: Screen) -> Iterator[SafeText]:
        """Yield the counts, and how the first pair that disagrees diverges."""
        head = [
            f"outcome: {self.outcome}",
            f"first: {self.first}",
            f"second: {self.second}",
            f"{counted(self.pairs, 'pair')}: {self.both:,} have the outcome on both sides, {self.neither:,} on "
            f"neither, {self.first_only:,} only on the first, {self.second_only:,} only on the second",
        ]
        if self.undefined:
            head.append(f"in {counted(self.undefined, 'more pair')}, a run has no value to compare")
        if self.repeated:
            head.append(f"left out: {counted(self.repeated, 'pair')} that {LEFT_OUT['repeated']}")
        alone = (self.first_alone, "first"), (self.second_alone, "second")
        head += [no_partner(runs, side) for runs, side in alone if runs]
        head += refusals(self.refused, self.pairs + self.undefined)
        if self.diff is None:
            yield printable.lines(*head, "no pair disagrees")
            return
        pair = f"the first pair that disagrees: {screen.run_text(self.diff.first)}"
        yield printable.lines(*head, "", pair, f"and {printable.value(self.diff.second)}", "")
        yield from diff_text(self.diff, ("first", "second"), screen)


@verb(
    'bisect out/ledger --first fsar --second cfc --outcome "policy_violations > 0"',
    'bisect out/ledger --change "without shared-registry" --architecture fsar --outcome "coordination_success < 1"',
    'bisect out/ledger --first fsar --second dhma --outcome "authority_conflicts > 3" --json',
)
def bisect(
    ledger: "Ledger",
    outcome: str = declare(
        "CONDITION",
        "The outcome on which they disagree: METRIC > NUMBER, INVARIANT > NUMBER, or a SELECT of run_id.",
        value="",
    ),
    first: FirstOption = None,
    second: SecondOption = None,
    other: OtherArgument = None,
    *,
    changes: Names = declare(
        "TEXT", "Compare the recorded runs with forks that have this change, instead of two sides.", flag="--change"
    ),
    architecture: ArchitectureOption = None,
) -> BisectResult:
    """Find the first run in which two sides disagree on an outcome, and the event at which they diverge.

    The sides are architectures, configurations, constants or models, as in `compare`, from one ledger or two: two
    releases that made the same experiment, too. Or they are the runs as recorded and their forks with --change. Runs
    are paired by seed, scenario and number, in the order of the ledger.

    Raises:
        UsageError: There is no such side or outcome, or nothing to pair, or no run does anything else with the changes.
        QueryFailed: The SELECT of the outcome fails.
    """
    from .lookup import ledgers_of

    if not outcome:
        example = option("outcome", '"policy_violations > 0"')
        raise UsageError(f"{option('outcome')}: found none, expected one, as in {example}")
    if changes is not None:
        if first is not None or second is not None or other is not None:
            raise UsageError("bisect: found changes and two sides, expected one or the other")
        return _changes(ledger, changes, names_of(architecture) or (), outcome)
    if architecture is not None:
        raise UsageError("bisect: found an architecture without changes, expected it in the names of the sides")
    return _sides(ledgers_of(ledger, other), (first, second), outcome)


def _sides(ledgers: "Sequence[Ledger]", names: tuple[str | None, str | None], outcome: str) -> BisectResult:
    """Compare two sides of one ledger, or of two, by an outcome."""
    from fsar_ledger.analysis.causes import outcome_of
    from fsar_ledger.metrics.provenance import of_outcomes

    condition = outcome_of(outcome)
    with ExitStack() as stack:
        databases = [stack.enter_context(ledger.database()) for ledger in ledgers]
        both = chosen([sides(database) for database in databases], names, [str(ledger.path) for ledger in ledgers])
        firsts, seconds = _runs(databases[0], both[0]), _runs(databases[-1], both[1])
        has_outcome = [
            _having(ledger, database, condition) for ledger, database in zip(ledgers, databases, strict=True)
        ]
        provenances = tuple(map(of_outcomes, databases))
    alone = [
        side.run_count - sum(len(runs) for world, runs in worlds.items() if world in others)
        for side, worlds, others in zip(both, (firsts, seconds), (seconds, firsts), strict=True)
    ]
    matched = [(runs, seconds[world]) for world, runs in firsts.items() if world in seconds]
    pairs = [(*runs, *others) for runs, others in matched if len(runs) == len(others) == 1]
    repeated = sum(len(runs) * len(others) for runs, others in matched) - len(pairs)
    if not pairs:
        raise _unpaired(both, repeated)
    outcomes = [(has_outcome[0](first), has_outcome[-1](second)) for first, second in pairs]
    index = next((index for index, pair in enumerate(outcomes) if disagree(*pair)), None)
    diff = None
    if index is not None:
        first_run, second_run = pairs[index]
        diff = difference_of(ledgers[0].record(first_run), ledgers[-1].record(second_run), provenances)
    return _bisected(condition, (str(both[0]), str(both[1])), outcomes, diff, provenances, repeated, alone)


def _unpaired(both: tuple[Side, Side], repeated: int) -> UsageError:
    """Return an error that says why no run of one side is the counterpart of one of the other."""
    if repeated:
        return UsageError(
            f"{both[0]} and {both[1]}: found {counted(repeated, 'pair')} in which one side has several runs of one "
            "seed, scenario and number, expected one run on each side; `fsar-ledger diff` compares any two runs"
        )
    instead = (
        "simulate both sides alike"
        if both[0].named_count and both[1].named_count
        else "runs of a real fleet have none; `fsar-ledger diff` compares any two runs"
    )
    return UsageError(
        f"{both[0]} and {both[1]}: found no runs of both sides with the same seed, scenario and number; {instead}"
    )


def _changes(
    ledger: "Ledger", changes: str | Sequence[str], architectures: Sequence[str], outcome: str
) -> BisectResult:
    """Compare the runs of a ledger with their forks by an outcome."""
    from fsar_ledger.analysis.causes import outcome_of
    from fsar_ledger.analysis.whatif import changes_of, fork_pairs, refused_in, refused_in_all, runs_of
    from fsar_ledger.ledger.opening import open_for_answers
    from fsar_ledger.metrics.database import connect_view
    from fsar_ledger.metrics.provenance import of_outcomes

    view = open_for_answers(ledger.path)
    with connect_view(view, demanded=ledger.demanded) as database:
        provenance = of_outcomes(database)
    condition = outcome_of(outcome)
    runs, parsed = runs_of(view, architectures, ("simulated", "live")), changes_of(changes)
    outcomes: list[tuple[bool | None, bool | None]] = []
    diff: Diff | None = None
    differs = False
    refused: list[tuple[str, str]] = []
    pairs = fork_pairs(view, runs, parsed)
    while batch := list(islice(pairs, PAIRS_AT_ONCE)):
        records = [
            (record.times_us, record.caused_by, record.events)
            for pair in batch
            for record in (pair.base.record, pair.fork.record)
        ]
        values = condition.of(records)
        refused += ((pair.base.record.run_id, pair.refused.why) for pair in batch if pair.refused is not None)
        for pair, first, value in zip(batch, values[::2], values[1::2], strict=True):
            second = value if pair.fork.end is None else None  # how such a fork would continue is unknown
            differs |= pair.fork.parts_at is not None or pair.fork.end is not None
            outcomes.append((first, second))
            if disagree(first, second) and diff is None:
                diff = difference_of(pair.base.record, pair.fork.record, (provenance,))
    if len(refused) == len(outcomes):
        raise refused_in_all(refused)
    if not differs:
        raise without_effect(view, runs, parsed)
    reasons = refused_in(why for _, why in refused)
    return _bisected(condition, ("as recorded", "changed"), outcomes, diff, (provenance,), refused=reasons)


def _bisected(
    condition: "Outcome",
    names: tuple[str, str],
    outcomes: list[tuple[bool | None, bool | None]],
    diff: Diff | None,
    provenances: "tuple[Provenance, ...]",
    repeated: int = 0,
    alone: Sequence[int] = (0, 0),
    refused: "Sequence[RefusedChange]" = (),
) -> BisectResult:
    return BisectResult(
        outcome=condition.text,
        first=names[0],
        second=names[1],
        pairs=sum(None not in pair for pair in outcomes),
        both=outcomes.count((True, True)),
        neither=outcomes.count((False, False)),
        first_only=outcomes.count((True, False)),
        second_only=outcomes.count((False, True)),
        undefined=sum(None in pair for pair in outcomes),
        repeated=repeated,
        first_alone=alone[0],
        second_alone=alone[1],
        refused=tuple(refused),
        diff=diff,
        provenances=provenances,
    )


def _runs(database: "Database", side: Side) -> dict[World, list[str]]:
    """Return the runs of a side that can be paired, by seed, scenario and number, in the order of the ledger."""
    runs: dict[World, list[str]] = {}
    for row in database.rows(PAIRS, {"side": side.side}):
        runs.setdefault((row["seed"], row["scenario"], row["run"]), []).append(row["run_id"])
    return runs


def disagree(first: bool | None, second: bool | None) -> bool:
    """Return whether one has the outcome and the other lacks it; a run without a value does neither."""
    return {first, second} == {True, False}


def _having(ledger: "Ledger", database: "Database", outcome: "Outcome") -> Callable[[object], bool | None]:
    """Return a function that returns whether a run has the outcome, None if undefined. Raises: QueryFailed."""
    from fsar_ledger.analysis.causes import runs_named

    valued = {row["run_id"] for row in database.rows(outcome.defined)} if outcome.defined else None
    rows = ledger.sql(outcome.sql).arrow() if outcome.is_own else database.table(outcome.sql)
    having = runs_named(rows, {row["run_id"] for row in database.rows("SELECT run_id FROM runs")})
    return lambda run: None if valued is not None and run not in valued else run in having
