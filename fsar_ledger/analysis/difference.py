"""The differences of two runs, event by event, and of their metrics, tasks, violations and conflicts.

Events are aligned by cause and content, not by seq.

The events of a run form a tree: each is caused by an earlier one, all of them in the end by event 0, which also causes
the facts of the world. Two trees are aligned from their roots down: under two causes that are the same event, an effect
is the same if it says the same, times aside. Of several that say the same, those as long after their cause are paired
first. What is left is paired if it is about the same and of one type (it changed), or if it says the same under another
cause. The rest happens on one side alone. So an insertion makes nothing different that does not differ.
"""

from collections import defaultdict
from collections.abc import Callable, Hashable, Sequence
from functools import cache
from operator import attrgetter
from typing import Any, Literal, NamedTuple

import msgspec

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import flat
from fsar_ledger.events.task import TaskAbandoned, TaskCompleted
from fsar_ledger.events.world import TaskArrived
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.metrics.database import Database
from fsar_ledger.metrics.results import typed

Kind = Literal["moved", "changed", "caused otherwise", "only first", "only second"]
KINDS: tuple[Kind, ...] = ("only first", "only second", "changed", "caused otherwise", "moved")
_TIME = "_us"


class Difference(msgspec.Struct, frozen=True):
    """One event that is not the same in both runs.

    `first_seq`, `second_seq`: where it is in each; None: it is not there. `shift_us`: how much later it is in the
    second; None on one side alone. `fields`: in which it differs. `is_consequence`: it is on one side alone, as what
    caused it is.
    """

    kind: Kind
    first_seq: int | None
    second_seq: int | None
    shift_us: int | None = None
    fields: tuple[str, ...] = ()
    is_consequence: bool = False


class Alignment(NamedTuple):
    """Which event of the second run each event of the first is, by seq, and all differences in order."""

    pairs: dict[int, int]
    differences: list[Difference]
    same: int


def align(first: LedgerRun, second: LedgerRun) -> Alignment:
    """Align two runs. Event 0 of one is always that of the other; the fields in which it differs are a difference."""
    one = _Aligning(_Side(first), _Side(second))
    one.pair(0, 0)
    one.pair_elsewhere(is_timed=True)
    one.pair_elsewhere(is_timed=False)
    return _alignment(first, second, one.pairs, one.taken)


class _Side:
    """A run with what each event says, and what it causes."""

    def __init__(self, run: LedgerRun) -> None:
        self.times_us = run.times_us
        self.events = run.events
        self.says = [_content(event) for event in run.events]
        self.effects: defaultdict[int, list[int]] = defaultdict(list)
        for seq, cause in enumerate(run.caused_by):
            if cause is not None:
                self.effects[cause].append(seq)


class _Aligning:
    """The pairs found so far, by seq, and which events of the second run they take."""

    def __init__(self, first: _Side, second: _Side) -> None:
        self.pairs: dict[int, int] = {}
        self.taken: set[int] = set()
        self._first, self._second = first, second

    def pair(self, one: int, other: int) -> None:
        """Take these two as the same event, and align what follows from them."""
        waiting = [(one, other)]
        while waiting:
            one, other = waiting.pop()
            self.pairs[one] = other
            self.taken.add(other)
            found = self._effects(one, other)
            self.taken.update(second for _, second in found)
            waiting += found

    def pair_elsewhere(self, *, is_timed: bool) -> None:
        """Pair what is left and says the same under other causes, in order; with `is_timed`, at the same time."""

        def key(side: _Side, seq: int) -> Hashable:
            return side.says[seq], side.times_us[seq] if is_timed else None

        waiting: defaultdict[Hashable, list[int]] = defaultdict(list)
        for seq in reversed(range(len(self._second.events))):
            if seq not in self.taken:
                waiting[key(self._second, seq)].append(seq)
        for seq in range(len(self._first.events)):
            if seq not in self.pairs and (of_key := waiting.get(key(self._first, seq))):
                other = next((one for one in reversed(of_key) if one not in self.taken), None)
                if other is not None:
                    self.pair(seq, other)

    def _effects(self, one: int, other: int) -> list[tuple[int, int]]:
        """Return the pairs among the effects of two events that are the same."""
        first, second = self._first, self._second
        firsts = [seq for seq in first.effects[one] if seq not in self.pairs]
        seconds = [seq for seq in second.effects[other] if seq not in self.taken]
        since_us = first.times_us[one], second.times_us[other]
        keys: tuple[Callable[[_Side, int, int], Hashable], ...] = (
            lambda side, seq, since: (side.says[seq], side.times_us[seq] - since),
            lambda side, seq, _: side.says[seq],
            lambda side, seq, _: _about(side.events[seq]),
        )
        found: list[tuple[int, int]] = []
        for key in keys:
            if not firsts or not seconds:
                break
            waiting: defaultdict[Hashable, list[int]] = defaultdict(list)
            for seq in reversed(seconds):
                waiting[key(second, seq, since_us[1])].append(seq)
            rest: list[int] = []
            for seq in firsts:
                of_key = waiting.get(key(first, seq, since_us[0]))
                if of_key:
                    found.append((seq, of_key.pop()))
                else:
                    rest.append(seq)
            firsts, seconds = rest, sorted(seq for seqs in waiting.values() for seq in seqs)
        return found


@cache
def _getters(kind: type[Event]) -> tuple[Callable[[Event], Any], Callable[[Event], Any]]:
    """Return what an event of a type says, times aside, and the part of it that says what it is about."""
    names, about = [], ["__class__"]
    for field in msgspec.structs.fields(kind):
        if field.name.endswith(_TIME):
            continue
        names.append(field.name)
        if field.name in ("subject", "task_id", "robot", "failed_action", "window", "obstruction"):
            about.append(field.name)
    if len(about) == 1:  # of no robot and no task
        about += [name for name in names if name in ("supervisor", "holder", "command", "issued_by")]
    elif about[1:] == ["robot"]:
        about += [name for name in names if name == "peer"]
    return _tuple_of(names), _tuple_of(about)


def _tuple_of(names: Sequence[str]) -> Callable[[Event], Any]:
    if not names:
        return lambda _: ()
    return attrgetter(*names)


def _content(event: Event) -> Hashable:
    said = _getters(type(event))[0](event)
    return type(event), _hashable(said)


def _hashable(said: Any) -> Hashable:
    return tuple(map(_hashable, said)) if isinstance(said, list) else said


def _about(event: Event) -> Hashable:
    found = _getters(type(event))[1](event)
    return found if isinstance(found, tuple) else (found,)


def _alignment(first: LedgerRun, second: LedgerRun, pairs: dict[int, int], taken: set[int]) -> Alignment:
    """Return the alignment with all differences, in the order of time."""
    found: list[Difference] = []
    same = 0
    for one, other in pairs.items():
        shift_us = second.times_us[other] - first.times_us[one]
        fields = _differing(first.events[one], second.events[other], shift_us)
        if pairs.get(_cause(first, one)) != _cause(second, other):
            found.append(Difference("caused otherwise", one, other, shift_us, fields))
        elif fields:
            found.append(Difference("changed", one, other, shift_us, fields))
        elif shift_us:
            found.append(Difference("moved", one, other, shift_us))
        else:
            same += 1
    found += [
        Difference("only first", seq, None, is_consequence=first.caused_by[seq] not in pairs)
        for seq in range(len(first.events))
        if seq not in pairs
    ]
    found += [
        Difference("only second", None, seq, is_consequence=second.caused_by[seq] not in taken)
        for seq in range(len(second.events))
        if seq not in taken
    ]

    def when(one: Difference) -> tuple[int, int]:
        times = [first.times_us[one.first_seq]] if one.first_seq is not None else []
        times += [second.times_us[one.second_seq]] if one.second_seq is not None else []
        return min(times), one.first_seq if one.first_seq is not None else one.second_seq or 0

    return Alignment(pairs, sorted(found, key=when), same)


def _cause(run: LedgerRun, seq: int) -> int:
    """Return the cause of an event; of event 0, itself."""
    return run.caused_by[seq] or 0


def _differing(one: Event, other: Event, shift_us: int) -> tuple[str, ...]:
    """Return the fields in which two events differ; times that moved as the event did do not."""
    if one == other:
        return ()
    firsts, seconds = flat(one), flat(other)
    return tuple(
        name
        for name, value in firsts.items()
        if value != seconds[name]
        and not (
            shift_us
            and name.endswith(_TIME)
            and value is not None
            and seconds[name] is not None
            and seconds[name] - value == shift_us
        )
    )


def chain(run: LedgerRun, seq: int) -> list[int]:
    """Return the seqs of an event, of what caused it, and so on, back to a fact of the world or to event 0."""
    found = [seq]
    while (cause := run.caused_by[found[-1]]) is not None and cause != 0:
        found.append(cause)
    return found


FIRST, SECOND = "first", "second"
"""The names under which the two runs are judged."""
METRICS = """
    SELECT firsts.metric, firsts.value AS first, seconds.value AS second
    FROM run_metrics AS firsts
    INNER JOIN run_metrics AS seconds ON firsts.metric = seconds.metric
    WHERE firsts.run_id = 'first' AND seconds.run_id = 'second'
    ORDER BY firsts.position
"""
VERDICTS = """
    SELECT run_id AS run, 'policy violation' AS verdict, seq, started_us / 1e6 AS time_s,
        coalesce(action_id, 'motion') AS what
    FROM governed_starts
    WHERE is_violation
    UNION ALL
    SELECT run_id AS run, 'authority conflict' AS verdict, NULL AS seq, began_us / 1e6 AS time_s,
        concat_ws(', ', action_id, dimension) AS what
    FROM conflicts
    ORDER BY time_s, verdict, what, run
"""


COUNTED_BY = {"policy violation": "policy_violations", "authority conflict": "authority_conflicts"}
"""The metric that counts each verdict: a run in which it is undefined does not observe what tells."""


class MetricPair(msgspec.Struct, frozen=True):
    """A metric of both runs, in its unit; None: undefined."""

    metric: str
    first: float | None
    second: float | None


class TaskPair(msgspec.Struct, frozen=True):
    """A task in both runs: `completed`, `abandoned`, `open`, or None where it did not arrive, and when that was.

    None, too: what becomes of it after a run that ends before all has happened.

    Units: seconds of run time; `due_s` of the first run that has it, None where no budget is on record. A task that is
    completed later than that is late.
    """

    task_id: str
    due_s: float | None
    first: str | None
    first_s: float | None
    second: str | None
    second_s: float | None


class Verdict(msgspec.Struct, frozen=True):
    """What SQL finds in one of the runs alone: a policy violation (at the event `seq`) or an authority conflict.

    `is_judged_in_both`: False where the other run does not observe what tells, so that it may have it, too.
    """

    run: str
    verdict: str
    seq: int | None
    time_s: float
    what: str
    is_judged_in_both: bool = True


class OutcomesDiff(msgspec.Struct, frozen=True):
    """What the runs came to. `verdicts` are those that only one of them has. Units: ends in seconds of run time."""

    metrics: list[MetricPair]
    tasks: list[TaskPair]
    verdicts: list[Verdict]
    first_ends_s: float
    second_ends_s: float


def outcomes_diff(database: Database, first: LedgerRun, second: LedgerRun, pairs: dict[int, int]) -> OutcomesDiff:
    """Return what the two runs, held as `first` and `second`, came to; `pairs` are the events that are the same.

    Raises: as `Database.rows`.
    """
    found, measured = typed(database.rows(VERDICTS), Verdict), typed(database.rows(METRICS), MetricPair)
    undefined = {(FIRST, one.metric) for one in measured if one.first is None}
    undefined |= {(SECOND, one.metric) for one in measured if one.second is None}
    alone = [
        msgspec.structs.replace(one, is_judged_in_both=(_other(one.run), COUNTED_BY[one.verdict]) not in undefined)
        for one in _alone(found, pairs)
    ]
    return OutcomesDiff(
        measured,
        _tasks(first, second),
        alone,
        first.times_us[-1] / 1e6,
        second.times_us[-1] / 1e6,
    )


def until_the_end(found: OutcomesDiff, ends_us: int) -> OutcomesDiff:
    """Return what the runs came to where the second ends then, before all has happened.

    It has no metrics yet, nobody knows what becomes of its open tasks, and later verdicts on the first say nothing.
    """
    return msgspec.structs.replace(
        found,
        metrics=[msgspec.structs.replace(one, second=None) for one in found.metrics],
        tasks=[msgspec.structs.replace(one, second=None) if one.second == "open" else one for one in found.tasks],
        verdicts=[one for one in found.verdicts if one.time_s <= ends_us / 1e6],
    )


def _alone(found: Sequence[Verdict], pairs: dict[int, int]) -> list[Verdict]:
    """Return the verdicts that only one run has: violations by the event, conflicts by what they are about."""
    other = {second: first for first, second in pairs.items()}

    def place(one: Verdict) -> object:
        if one.seq is None:
            return one.verdict, one.what
        seq = one.seq if one.run == FIRST else other.get(one.seq, -1 - one.seq)
        return one.verdict, seq

    sides = {run: {place(one) for one in found if one.run == run} for run in (FIRST, SECOND)}
    return [one for one in found if place(one) not in sides[_other(one.run)]]


def _other(run: str) -> str:
    return SECOND if run == FIRST else FIRST


def _tasks(first: LedgerRun, second: LedgerRun) -> list[TaskPair]:
    sides = [_ends(run) for run in (first, second)]
    names = dict.fromkeys((*sides[0], *sides[1]))
    return [
        TaskPair(
            name,
            (sides[0].get(name) or sides[1][name])[0],
            *(sides[0][name][1:] if name in sides[0] else (None, None)),
            *(sides[1][name][1:] if name in sides[1] else (None, None)),
        )
        for name in names
    ]


def _ends(run: LedgerRun) -> dict[str, tuple[float | None, str, float | None]]:
    """Return by task when it is due, what became of it, and when."""
    found: dict[str, tuple[float | None, str, float | None]] = {}
    for time_us, event in zip(run.times_us, run.events, strict=True):
        match event:
            case TaskArrived():
                budgeted_us = None if event.budget_us is None else time_us + event.budget_us
                due_us = budgeted_us if event.due_us is None else event.due_us
                found[event.task_id] = (None if due_us is None else due_us / 1e6, "open", None)
            case TaskCompleted() | TaskAbandoned() if event.task_id in found:
                word = "completed" if isinstance(event, TaskCompleted) else "abandoned"
                found[event.task_id] = (found[event.task_id][0], word, time_us / 1e6)
    return found
