"""Open-RMF: task states, task logs, fleet states and requests, as its API server gets them.

One message of rmf_api_msgs a line: `{"type": "task_state_update", "data": {...}}`, or the bare object, which is known
by its fields. Beside `type` a line may have `received` (ISO 8601 or a number), the time at which the recorder got it.
The schemas are those of https://github.com/open-rmf/rmf_api_msgs, version 0.3; no message names a version.

A task state is sent from time to time, so what follows from it is what has changed since the last one of that task. A
state that comes after the end of its task is only an observation; one of another task with the same name, as after a
restart of the dispatcher, is not understood.

| message | becomes |
|---|---|
| the first state of a task | `TaskArrived` |
| `dispatch` selected or dispatched, with an assignment | `RequestIssued` by the coordinator, which is the dispatcher |
| a state that is under way, with `assigned_to` | `ExecutionStarted` by that robot |
| an interruption of it; the end of the last one | `ExecutionPaused`; `ExecutionResumed` |
| another robot in `assigned_to` | `ExecutionWithdrawn` of the first |
| completed | `ExecutionFinished`, `TaskCompleted` |
| failed | `ExecutionFailed`, with the last error on record; `ExecutionWithdrawn`, `TaskAbandoned` |
| canceled, killed | `ExecutionWithdrawn`, `TaskAbandoned` |
| anything else | an observation |

People and systems outside of the fleet that request, cancel or interrupt are objects of the observation. RMF says which
robot a task is assigned to, and never that the robot itself has accepted it.
"""

from collections.abc import Iterable, Iterator, Mapping
from itertools import chain
from typing import Any, Literal

import msgspec

from fsar_ledger.base.errors import UsageError
from fsar_ledger.base.printable import counted, escaped, value
from fsar_ledger.events import Event
from fsar_ledger.events.envelope import COORDINATOR, Parties, RequestSubject, Robot, Subject, recorded_robot
from fsar_ledger.events.execution import (
    ExecutionFailed,
    ExecutionFinished,
    ExecutionPaused,
    ExecutionResumed,
    ExecutionStarted,
    ExecutionWithdrawn,
)
from fsar_ledger.events.request import RequestIssued
from fsar_ledger.events.task import TaskAbandoned, TaskCompleted
from fsar_ledger.events.world import TaskArrived

from .adapter import Derived, Input, Record, json_text, objects
from .rmf_messages import BEGUN, RESPONSE, assigned_robot, entries, record_of, table, tables, task_id, text

GIVEN_UP = frozenset(("failed", "canceled", "killed"))
NOT_DISPATCHED = {"failed_to_assign": "failed", "canceled_in_flight": "canceled"}
"""How a task ends that is assigned to no robot, if its state has no status of its own."""
SEARCHED = 1_000
"""The records at the beginning of a recording of which at least one must be a message of RMF."""


class Task(msgspec.Struct):
    """The state of a task by its last messages.

    `robot` executes it, `asked` are the fleets and robots that the dispatcher chose, `interruptions` counts its pauses.
    """

    is_known: bool = False
    has_ended: bool = False
    is_paused: bool = False
    robot: Robot | None = None
    asked: tuple[str, ...] = ()
    interruptions: int = 0
    error: str = ""


class Rmf:
    """A reader of recordings of Open-RMF messages."""

    name = "rmf"
    version = "1"
    format = "rmf_api_msgs/0.3"
    clock: Literal["arrival", "source"] = "arrival"
    is_sampled = True

    def __init__(self) -> None:
        self._tasks: dict[str, Task] = {}
        self._ended: dict[str, object] = {}  # the booking time of each task that has ended: all that is kept of it

    def declares(self) -> Iterable[str]:
        """Name what a complete recording has: a state once reached is seen in the next one, or its end is."""
        named = ("task_id", "action_id", "decided_by", "requested_by")
        return (
            *("TaskArrived", "TaskCompleted", "TaskAbandoned"),
            *("RequestIssued", *(f"RequestIssued.{name}" for name in named)),
            *("ExecutionStarted", "ExecutionStarted.executed_by"),
            *("ExecutionFinished", "ExecutionFinished.executed_by"),
            *("ExecutionFailed", "ExecutionWithdrawn", "ExecutionPaused", "ExecutionResumed"),
        )

    def read(self, inputs: Iterable[Input]) -> Iterator[Record]:
        """Yield every message. Raises: UsageError if there is none among the first `SEARCHED` records."""
        files = list(inputs)
        records = (item if isinstance(item, Record) else record_of(*item) for item in objects(files))
        first: list[Record] = []
        for record in records:
            first.append(record)
            if record.data is not None or len(first) == SEARCHED:
                break
        if first and first[-1].data is None:
            names, begins = ", ".join(value(item.name) for item in files), first[0].raw[:80].decode("utf-8", "replace")
            raise UsageError(
                f"{names}: found {counted(len(first), 'record')}, the first of them {value(begins)}, and none is a "
                'message of rmf_api_msgs; expected one message per line, such as {"type": "task_state_update", "data": '
                "{...}}; if it is another format, name that (--as)"
            )
        yield from chain(first, records)

    def derive(self, record: Record) -> Iterable[Derived] | None:
        """Return what has changed since the last state of the task; None if another task of its name has ended."""
        if record.data is None:
            return None
        kind, data = record.data
        if kind == "task_log":
            self._logged(data)
            return ()
        if kind == RESPONSE:
            data = table(data, "state")
        elif kind != "task_state":
            return ()
        if not (name := task_id(data)):
            return ()
        booked = table(data, "booking").get("unix_millis_request_time")
        if name in self._ended:
            return () if booked is None or booked == self._ended[name] else None
        task = self._tasks.setdefault(name, Task())
        events = [Derived(event) for event in _changed(task, name, data)]
        if task.has_ended:
            del self._tasks[name]
            self._ended[name] = booked
        return events

    def _logged(self, log: Mapping[str, Any]) -> None:
        """Keep the last error of the log of a task: it is the cause if the task fails."""
        name = text(log, "task_id")
        errors = [str(entry.get("text")) for _, entry in entries(log) if entry.get("tier") == "error"]
        if errors and name not in self._ended:
            self._tasks.setdefault(name, Task()).error = escaped(errors[-1])


def _changed(task: Task, name: str, state: Mapping[str, Any]) -> Iterator[Event]:
    """Yield the events of what has changed in a task state."""
    dispatch, robot, category = table(state, "dispatch"), assigned_robot(state), text(state, "category") or "task"
    status = text(state, "status") or NOT_DISPATCHED.get(text(dispatch, "status"), "")
    subject = Subject(escaped(name), escaped(name))
    if not task.is_known:
        task.is_known = True
        yield TaskArrived(task_id=subject.task_id, robot=robot)
    yield from _request_events(task, subject, dispatch, category)
    if task.robot is not None and robot is not None and robot != task.robot:
        yield ExecutionWithdrawn(subject, task.robot)
        task.robot, task.is_paused = None, False
    has_begun = status in BEGUN or (
        status in GIVEN_UP and (bool(state.get("completed")) or state.get("active") is not None)
    )
    if has_begun and task.robot is None and robot is not None:
        task.robot = robot
        yield ExecutionStarted(subject=subject, principals=_by(robot), robot=robot, capability=escaped(category))
    yield from _interrupted(task, subject, state)
    if status == "completed" or status in GIVEN_UP:
        task.has_ended = True
        yield from _end_events(task, subject, status, state)


def _request_events(
    task: Task, subject: Subject[str, str], dispatch: Mapping[str, Any], category: str
) -> Iterator[Event]:
    """Yield the dispatcher's request to a fleet, and to the robot that it expects, if it names one."""
    assignment = table(dispatch, "assignment")
    fleet, expected = text(assignment, "fleet_name"), text(assignment, "expected_robot_name")
    if dispatch.get("status") not in ("selected", "dispatched") or not fleet:
        return
    if f"{fleet}/{expected}" in task.asked:
        return
    task.asked = (*task.asked, f"{fleet}/{expected}")
    robot = recorded_robot(escaped(f"robot/{fleet}.{expected}")) if expected else None
    parties = Parties(requested_by=COORDINATOR, executed_by=robot, supervised_by=None)
    yield RequestIssued(
        subject=RequestSubject(subject.task_id, subject.action_id, None),
        principals=parties.decided(COORDINATOR),
        capability=escaped(category),
    )


def _interrupted(task: Task, subject: Subject[str, str], state: Mapping[str, Any]) -> Iterator[Event]:
    """Yield the pause of the robot by a request, and its resumption after the last one; a state keeps all of them."""
    interruptions = tables(table(state, "interruptions")).values()
    if task.robot is None:
        return
    if len(interruptions) > task.interruptions and not task.is_paused:
        task.is_paused = True
        yield ExecutionPaused(subject, task.robot)
    task.interruptions = max(task.interruptions, len(interruptions))
    if task.is_paused and interruptions and all("resumed_by" in interruption for interruption in interruptions):
        task.is_paused = False
        yield ExecutionResumed(subject, task.robot)


def _end_events(task: Task, subject: Subject[str, str], status: str, state: Mapping[str, Any]) -> Iterator[Event]:
    """Yield the end of the task, and the release of its robot."""
    if status == "completed":
        if task.robot is not None:
            yield ExecutionFinished(subject, _by(task.robot), task.robot)
        yield TaskCompleted(subject.task_id)
        return
    failure = 1 if status == "failed" else None
    if task.robot is not None:
        if status == "failed":
            yield ExecutionFailed(subject=subject, robot=task.robot, failure=1, cause=_cause(task, state))
        yield ExecutionWithdrawn(subject, task.robot, failure)
    yield TaskAbandoned(subject.task_id)


def _cause(task: Task, state: Mapping[str, Any]) -> str:
    """Return why a task failed: the last error of its log, else the event that failed, else its status."""
    if task.error:
        return task.error
    for phase in tables(table(state, "phases")).values():
        for event in tables(table(phase, "events")).values():
            if event.get("status") in ("failed", "error"):
                details = [json_text(event[name]) for name in ("name", "detail") if event.get(name)]
                return escaped(": ".join(details) or "failed")
    return "failed"


def _by(robot: Robot) -> Parties:
    return Parties(requested_by=None, executed_by=robot, supervised_by=None)
