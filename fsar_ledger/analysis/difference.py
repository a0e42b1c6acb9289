"""The differences of two runs, event by event, and of their metrics, tasks, violations and conflicts.

Events are aligned by cause and content, not by seq.

The events of a run form a tree: each is caused by an earlier one, ultimately by event 0, which also causes the facts of
the world. Two trees are aligned from their roots down: under paired causes, effects with the same content, times aside,
are paired. Of several with the same content, those with the same delay after their cause are paired first. The
remaining events are paired if they have the same type and subject (changed), or the same content under another cause.
The rest happens on one side only. So an insertion does not make later events differ.
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
    """One event that differs between the runs.

    `first_seq`, `second_seq`: its seq in each; None: it is not there. `shift_us`: how much later it is in the second;
    None on one side alone. `fields`: those that differ. `is_consequence`: it is on one side alone, and so is its
    cause.
    """

    kind: Kind
    first_seq: int | None
    second_seq: int | None
    shift_us: int | None = None
    fields: tuple[str, ...] = ()
    is_consequence: bool = False


class Alignment(NamedTuple):
    """The seqs of paired events, first run to second, all differences in order, and the number of equal pairs."""

    pairs: dict[int, int]
    differences: list[Difference]
    same: int


def align(first: LedgerRun, second: LedgerRun) -> Alignment:
    """Align two runs. Their events 0 are always paired; any fields in which they differ are a difference."""
    aligning = _Aligning(_Side(first), _Side(second))
    aligning.pair(0, 0)
    aligning.pair_elsewhere(is_timed=True)
    aligning.pair_elsewhere(is_timed=False)
    return _alignment(first, second, aligning.pairs, aligning.taken)


class _Side:
    """A run with the content and the effects of each event."""

    def __init__(self, run: LedgerRun) -> None:
        self.times_us = run.times_us
        self.events = run.events
        self.says = [_content(event) for event in run.events]
        self.effects: defaultdict[int, list[int]] = defaultdict(list)
        for seq, cause in enumerate(run.caused_by):
            if cause is not None:
                self.effects[cause].append(seq)


class _Aligning:
    """The pairs found so far, by seq, and the events of the second run that they use."""

    def __init__(self, first: _Side, second: _Side) -> None:
        self.pairs: dict[int, int] = {}
        self.taken: set[int] = set()
        self._first, self._second = first, second

    def pair(self, one: int, other: int) -> None:
        """Pair these two events, and align their effects."""
        waiting = [(one, other)]
        while waiting:
            one, other = waiting.pop()
            self.pairs[one] = other
            self.taken.add(other)
            effects = self._effects(one, other)
            self.taken.update(second for _, second in effects)
            waiting += effects

    def pair_elsewhere(self, *, is_timed: bool) -> None:
        """Pair the rest by content under other causes, in order; with `is_timed`, only at the same time."""

        def key(side: _Side, seq: int) -> Hashable:
            return side.says[seq], side.times_us[seq] if is_timed else None

        waiting: defaultdict[Hashable, list[int]] = defaultdict(list)
        for seq in reversed(range(len(self._second.events))):
            if seq not in self.taken:
                waiting[key(self._second, seq)].append(seq)
        for seq in range(len(self._first.events)):
            if seq not in self.pairs and (candidates := waiting.get(key(self._first, seq))):
                other = next((seq for seq in reversed(candidates) if seq not in self.taken), None)
                if other is not None:
                    self.pair(seq, other)

    def _effects(self, first_cause: int, second_cause: int) -> list[tuple[int, int]]:
        """Return the pairs among the effects of two paired events."""
        first, second = self._first, self._second
        firsts = [seq for seq in first.effects[first_cause] if seq not in self.pairs]
        seconds = [seq for seq in second.effects[second_cause] if seq not in self.taken]
        since_us = first.times_us[first_cause], second.times_us[second_cause]
        keys: tuple[Callable[[_Side, int, int], Hashable], ...] = (
            lambda side, seq, since: (side.says[seq], side.times_us[seq] - since),
            lambda side, seq, _: side.says[seq],
            lambda side, seq, _: _about(side.events[seq]),
        )
        pairs: list[tuple[int, int]] = []
        for key in keys:
            if not firsts or not seconds:
                break
            waiting: defaultdict[Hashable, list[int]] = defaultdict(list)
            for seq in reversed(seconds):
                waiting[key(second, seq, since_us[1])].append(seq)
            unpaired: list[int] = []
            for seq in firsts:
                candidates = waiting.get(key(first, seq, since_us[0]))
                if candidates:
                    pairs.append((seq, candidates.pop()))
                else:
                    unpaired.append(seq)
            firsts, seconds = unpaired, sorted(seq for seqs in waiting.values() for seq in seqs)
        return pairs


@cache
def _getters(kind: type[Event]) -> tuple[Callable[[Event], Any], Callable[[Event], Any]]:
    """Return the getters of a type's content, times aside, and of the part that identifies its subject."""
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
    values = _getters(type(event))[0](event)
    return type(event), _hashable(values)


def _hashable(value: Any) -> Hashable:
    return tuple(map(_hashable, value)) if isinstance(value, list) else value


def _about(event: Event) -> Hashable:
    values = _getters(type(event))[1](event)
    return values if isinstance(values, tuple) else (values,)


def _alignment(first: LedgerRun, second: LedgerRun, pairs: dict[int, int], taken: set[int]) -> Alignment:
    """Return the alignment with all differences, in the order of time."""
    differences: list[Difference] = []
    same = 0
    for first_seq, second_seq in pairs.items():
        shift_us = second.times_us[second_seq] - first.times_us[first_seq]
        fields = _differing(first.events[first_seq], second.events[second_seq], shift_us)
        if pairs.get(_cause(first, first_seq)) != _cause(second, second_seq):
            differences.append(Difference("caused otherwise", first_seq, second_seq, shift_us, fields))
        elif fields:
            differences.append(Difference("changed", first_seq, second_seq, shift_us, fields))
        elif shift_us:
            differences.append(Difference("moved", first_seq, second_seq, shift_us))
        else:
            same += 1
    differences += [
        Difference("only first", seq, None, is_consequence=first.caused_by[seq] not in pairs)
        for seq in range(len(first.events))
        if seq not in pairs
    ]
    differences += [
        Difference("only second", None, seq, is_consequence=second.caused_by[seq] not in taken)
        for seq in range(len(second.events))
        if seq not in taken
    ]

    def when(one: Difference) -> tuple[int, int]:
        times = [first.times_us[one.first_seq]] if one.first_seq is not None else []
        times += [second.times_us[one.second_seq]] if one.second_seq is not None else []
        return min(times), one.first_seq if one.first_seq is not None else one.second_seq or 0

    return Alignment(pairs, sorted(differences, key=when), same)


def _cause(run: LedgerRun, seq: int) -> int:
    """Return the cause of an event; of event 0, itself."""
    return run.caused_by[seq] or 0


def _differing(first: Event, second: Event, shift_us: int) -> tuple[str, ...]:
    """Return the fields in which two events differ, except times that moved as the event did."""
    if first == second:
        return ()
    firsts, seconds = flat(first), flat(second)
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
    seqs = [seq]
    while (cause := run.caused_by[seqs[-1]]) is not None and cause != 0:
        seqs.append(cause)
    return seqs


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
"""The metric that counts each verdict: a run in which it is undefined does not observe the evidence."""


class MetricPair(msgspec.Struct, frozen=True):
    """A metric of both runs, in its unit; None: undefined."""

    metric: str
    first: float | None
    second: float | None


class TaskPair(msgspec.Struct, frozen=True):
    """A task in both runs: `completed`, `abandoned`, `open`, or None where it did not arrive, and when it ended.

    Also None: a task still open where a run ends before all has happened.

    Units: seconds of run time. `due_s`: when it is due in the first run, `second_due_s` in the second; None where no
    budget is on record, or it did not arrive. A task that is completed later than that is late.
    """

    task_id: str
    due_s: float | None
    first: str | None
    first_s: float | None
    second_due_s: float | None
    second: str | None
    second_s: float | None


class Verdict(msgspec.Struct, frozen=True):
    """A finding in only one of the runs: a policy violation (at the event `seq`) or an authority conflict.

    `is_judged_in_both`: False where the other run does not observe the evidence, so that it may have it, too.
    """

    run: str
    verdict: str
    seq: int | None
    time_s: float
    what: str
    is_judged_in_both: bool = True


class OutcomesDiff(msgspec.Struct, frozen=True):
    """The outcomes of two runs. `verdicts` are those that only one of them has. Units: ends in seconds of run time."""

    metrics: list[MetricPair]
    tasks: list[TaskPair]
    verdicts: list[Verdict]
    first_ends_s: float
    second_ends_s: float


def outcomes_diff(database: Database, first: LedgerRun, second: LedgerRun, pairs: dict[int, int]) -> OutcomesDiff:
    """Return the outcomes of the runs stored as `first` and `second`; `pairs` are the paired events, by seq.

    Raises: as `Database.rows`.
    """
    verdicts, measured = typed(database.rows(VERDICTS), Verdict), typed(database.rows(METRICS), MetricPair)
    undefined = {(FIRST, pair.metric) for pair in measured if pair.first is None}
    undefined |= {(SECOND, pair.metric) for pair in measured if pair.second is None}
    alone = [
        msgspec.structs.replace(row, is_judged_in_both=(_other(row.run), COUNTED_BY[row.verdict]) not in undefined)
        for row in _alone(verdicts, pairs)
    ]
    return OutcomesDiff(
        measured,
        _tasks(first, second),
        alone,
        first.times_us[-1] / 1e6,
        second.times_us[-1] / 1e6,
    )


def until_the_end(found: OutcomesDiff, ends_us: int) -> OutcomesDiff:
    """Return the outcomes where the second run ends at `ends_us`, before all has happened.

    It has no metrics yet, the ends of its open tasks are unknown, and later verdicts on the first are meaningless.
    """
    return msgspec.structs.replace(
        found,
        metrics=[msgspec.structs.replace(pair, second=None) for pair in found.metrics],
        tasks=[msgspec.structs.replace(task, second=None) if task.second == "open" else task for task in found.tasks],
        verdicts=[verdict for verdict in found.verdicts if verdict.time_s <= ends_us / 1e6],
    )


def _alone(all_verdicts: Sequence[Verdict], pairs: dict[int, int]) -> list[Verdict]:
    """Return the verdicts that only one run has: violations matched by event, conflicts by subject."""
    first_seq_of = {second: first for first, second in pairs.items()}

    def verdict_key(one: Verdict) -> object:
        if one.seq is None:
            return one.verdict, one.what
        seq = one.seq if one.run == FIRST else first_seq_of.get(one.seq, -1 - one.seq)
        return one.verdict, seq

    sides = {run: {verdict_key(verdict) for verdict in all_verdicts if verdict.run == run} for run in (FIRST, SECOND)}
    return [verdict for verdict in all_verdicts if verdict_key(verdict) not in sides[_other(verdict.run)]]


def _other(run: str) -> str:
    return SECOND if run == FIRST else FIRST


def _tasks(first: LedgerRun, second: LedgerRun) -> list[TaskPair]:
    sides = [_ends(run) for run in (first, second)]
    absent = (None, None, None)
    names = dict.fromkeys((*sides[0], *sides[1]))
    return [TaskPair(name, *sides[0].get(name, absent), *sides[1].get(name, absent)) for name in names]


def _ends(run: LedgerRun) -> dict[str, tuple[float | None, str, float | None]]:
    """Return the due time, the end and the time of the end, by task."""
    ends: dict[str, tuple[float | None, str, float | None]] = {}
    for time_us, event in zip(run.times_us, run.events, strict=True):
        match event:
            case TaskArrived():
                budgeted_us = None if event.budget_us is None else time_us + event.budget_us
                due_us = event.due_us if budgeted_us is None else budgeted_us
                ends[event.task_id] = (None if due_us is None else due_us / 1e6, "open", None)
            case TaskCompleted() | TaskAbandoned() if event.task_id in ends:
                word = "completed" if isinstance(event, TaskCompleted) else "abandoned"
                ends[event.task_id] = (ends[event.task_id][0], word, time_us / 1e6)
    return ends
