"""What two runs came to: their metrics, tasks, violations and conflicts, beside each other."""

from collections.abc import Sequence

import msgspec

from fsar_ledger.events.task import TaskAbandoned, TaskCompleted
from fsar_ledger.events.world import TaskArrived
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.metrics.database import Database
from fsar_ledger.metrics.results import typed

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


class Value(msgspec.Struct, frozen=True):
    """A metric of both runs, in its unit; None: undefined."""

    metric: str
    first: float | None
    second: float | None


class TaskPair(msgspec.Struct, frozen=True):
    """A task in both runs: `completed`, `abandoned`, `open`, or None where it did not arrive, and when that was.

    Units: seconds of run time; `due_s` of the first run that has it. A task that is completed later than that is late.
    """

    task_id: str
    due_s: float
    first: str | None
    first_s: float | None
    second: str | None
    second_s: float | None


class Verdict(msgspec.Struct, frozen=True):
    """What SQL finds in one of the runs alone: a policy violation (at the event `seq`) or an authority conflict."""

    run: str
    verdict: str
    seq: int | None
    time_s: float
    what: str


class Consequences(msgspec.Struct, frozen=True):
    """What the runs came to. `verdicts` are those that only one of them has. Units: ends in seconds of run time."""

    metrics: list[Value]
    tasks: list[TaskPair]
    verdicts: list[Verdict]
    first_ends_s: float
    second_ends_s: float


def consequences(database: Database, first: LedgerRun, second: LedgerRun, pairs: dict[int, int]) -> Consequences:
    """Return what the two runs, held as `first` and `second`, came to; `pairs` are the events that are the same.

    Raises: as `Database.rows`.
    """
    found = typed(database.rows(VERDICTS), Verdict)
    return Consequences(
        typed(database.rows(METRICS), Value),
        _tasks(first, second),
        _alone(found, pairs),
        first.times_us[-1] / 1e6,
        second.times_us[-1] / 1e6,
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
    return [one for one in found if place(one) not in sides[SECOND if one.run == FIRST else FIRST]]


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


def _ends(run: LedgerRun) -> dict[str, tuple[float, str, float | None]]:
    """Return by task when it is due, what became of it, and when."""
    found: dict[str, tuple[float, str, float | None]] = {}
    for time_us, event in zip(run.times_us, run.events, strict=True):
        match event:
            case TaskArrived():
                found[event.task_id] = (event.due_us / 1e6, "open", None)
            case TaskCompleted() | TaskAbandoned() if event.task_id in found:
                word = "completed" if isinstance(event, TaskCompleted) else "abandoned"
                found[event.task_id] = (found[event.task_id][0], word, time_us / 1e6)
            case _:
                pass
    return found
