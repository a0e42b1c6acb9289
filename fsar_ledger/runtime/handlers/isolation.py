"""A robot without the federation: what it continues alone, and which results count once the federation is back.

Paper: sec:architecture:overview, sec:architecture:invariants (A1).
"""

from collections.abc import Iterator, Sequence
from typing import get_args

from msgspec.structs import replace

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Robot, Subject
from fsar_ledger.events.execution import ExecutionFinished, ExecutionWithdrawn
from fsar_ledger.events.fleet import (
    IsolatedResult,
    IsolatedResultAccepted,
    IsolatedResultOvertaken,
    IsolationBegan,
    IsolationEnded,
    RobotJoined,
)
from fsar_ledger.events.knowledge import FleetRuleLearned
from fsar_ledger.events.policy import PolicyRuleSet, RolePolicyRuleSet
from fsar_ledger.events.recovery import RecoveryBudgetSet
from fsar_ledger.events.registry import (
    CapabilityAdvertised,
    CapabilityInstalled,
    CapabilityRemoved,
    CapabilityWithdrawn,
)
from fsar_ledger.events.supervision import ActuatorServiced, SupervisionDensitySet, SupervisorCalled
from fsar_ledger.events.task import StepCompleted
from fsar_ledger.events.trust import InitialTrustSet, RoleTrustSet, TrustSet, TrustThresholdsSet
from fsar_ledger.events.world import (
    ActuatorDegraded,
    PolicyWindowClosed,
    PolicyWindowOpened,
    RobotCameBack,
    RobotWentOff,
    SupervisorLeft,
    SupervisorReturned,
    TaskArrived,
)
from fsar_ledger.projections.execution import Action
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.recovery import Recovery
from fsar_ledger.projections.task import given_up_us

from .attribution import parties
from .authority import release
from .commands import BeginStep, ExpireTask, Handlers, Scheduled
from .public import RobotReport, carried_out, made_from, outdated
from .recovery import escalated
from .supervision import supervisor_for
from .task import has_not_begun, is_own_step

ALONE = "isolated"
"""The reason why recovery passes the levels that cannot be reached."""
RESTATED = (
    RobotJoined,
    CapabilityInstalled,
    CapabilityRemoved,
    CapabilityAdvertised,
    CapabilityWithdrawn,
    InitialTrustSet,
    TrustSet,
    RoleTrustSet,
    TrustThresholdsSet,
    PolicyRuleSet,
    RolePolicyRuleSet,
    FleetRuleLearned,
    PolicyWindowOpened,
    PolicyWindowClosed,
    ActuatorDegraded,
    ActuatorServiced,
    RobotWentOff,
    RobotCameBack,
    SupervisorLeft,
    SupervisorReturned,
    SupervisionDensitySet,
    RecoveryBudgetSet,
)
"""The types of the events that define a robot. Those that name a robot or a supervisor are its own, or hold for all."""

HANDLERS = Handlers()
MOST_DIGITS = 9
"""The most digits of the number of a step in a result."""


class HandOver(RobotReport):
    """Hand over the work that the robot did in isolation, in a run of its own, now that it has its federation again.

    The run, the number of its last event and the root of its ledger are as in `IsolationEnded`. `since_fence` is the
    number under which the robot reported when it began. Each of `results` is a step and how it ended, as
    `t1/2 success`, or `failure`, in the order in which they ended. Units: `since_us` run time.
    """

    robot: Robot
    isolated_run: str
    isolated_seq: int
    isolated_root: str
    since_us: int
    since_fence: int | None = None
    results: tuple[str, ...] = ()


def restated(events: Sequence[Event], state: State, robot: Robot) -> tuple[Event, ...]:
    """Return the events that found the run of the robot alone; `state` is what all of them lead to.

    These define the robot, and its tasks that wait for a step of its own, with the steps done.
    """
    own_supervisor = state.fleet.robots[robot].supervisor
    tasks = {task.task_id for task in state.task.values() if is_own_step(task, task.step, robot)}
    return tuple(event for event in events if _is_restated(event, robot, own_supervisor, tasks))


def _is_restated(event: Event, robot: Robot, supervisor: str | None, tasks: set[str]) -> bool:
    match event:
        case TaskArrived():
            return event.task_id in tasks
        case StepCompleted():
            return event.subject.task_id in tasks
        case SupervisorLeft() | SupervisorReturned():
            return event.supervisor == supervisor
        case TrustSet():
            return robot in (event.robot, event.peer)
    return isinstance(event, RESTATED) and getattr(event, "robot", None) in (None, robot)


def founded_alone(events: Sequence[Event]) -> tuple[Event, ...]:
    """Return the founding after event 0 of a run of a robot alone; empty for any other run."""
    end = next((seq for seq, event in enumerate(events) if isinstance(event, IsolationBegan)), 1)
    return tuple(events[1:end])


@HANDLERS.react(IsolationBegan)
def _on_isolation(state: State, _event: IsolationBegan, now_us: int) -> tuple[Scheduled, ...]:
    """Schedule the current step of each of the robot's tasks, and when the task is given up."""
    tasks = state.task.values()
    begun = [Scheduled(BeginStep(task.task_id)) for task in tasks]
    ends = [max(1, given_up_us(task, state.fleet) - now_us) + 1 for task in tasks]
    return (*begun, *(Scheduled(ExpireTask(task.task_id), end) for task, end in zip(tasks, ends, strict=True)))


def outward_alone(state: State, action: Action, recovery: Recovery) -> tuple[Event, ...]:
    """Escalate past the levels that the robot alone cannot reach, from peers on, and call its supervisor."""
    escalation = escalated(action, recovery, parties(state, action).decided(action.robot), "fleet", ALONE)
    supervisor = supervisor_for(state, action.robot, is_cross_robot=False)
    return (
        escalation,
        replace(escalation, level="fleet", to_level="human"),
        SupervisorCalled(subject=action.subject, supervisor=supervisor, purpose="recovery"),
    )


@HANDLERS.decide(HandOver)
def hand_over(state: State, command: HandOver) -> tuple[Event, ...]:
    """Accept each result the fleet still waits for, or record what has overtaken it. Only the robot hands it over."""
    refused = outdated(state.fleet, command.robot, command.fence)
    if refused is None and state.fleet.isolated is not None:
        refused = f"{command.robot} is alone, expected the fleet's run"
    if refused is None and not command.isolated_run:
        refused = "the run has no name, expected that of the robot's own"
    if refused is None and state.fleet.handed_over.get(command.robot) == command.isolated_run:
        refused = f"{command.isolated_run} was handed over before, expected a run that was not"
    unread = next((result for result in command.results if _read(result) is None), None)
    if refused is None and unread is not None:
        refused = f"result {unread!r}, expected a step and success or failure, as t1/2 success"
    ended = made_from(IsolationEnded, command)
    return carried_out(command, command.isolated_run, refused, command.robot, ended, *_judged(state, command))


def _read(result: str) -> tuple[str, int, IsolatedResult] | None:
    """Return the task, the step counted from 1 and the result, or None if it cannot be read."""
    step, _, word = result.partition(" ")
    task_id, _, number = step.partition("/")
    outcome = next((kind for kind in get_args(IsolatedResult) if kind == word), None)
    is_number = number.isdecimal() and len(number) <= MOST_DIGITS
    return (task_id, int(number), outcome) if outcome and task_id and is_number else None


def _judged(state: State, command: HandOver) -> Iterator[Event]:
    """Yield the outcome of each result, in their order; results of one task depend on each other."""
    done: dict[str, int] = {}
    for task_id, number, result in filter(None, map(_read, command.results)):
        task, step = state.task.get(task_id), done.get(task_id, 0)
        step += 0 if task is None else task.step
        is_begun = task is not None and step == number - 1 and task_id not in done
        action_id = (task.action_id if task is not None and is_begun else "") or f"{task_id}/{number}.1"
        subject, action = Subject(task_id, action_id), state.execution.actions.get(action_id)
        if command.since_fence != state.fleet.fences.get(command.robot):
            reason = "the robot has departed since, so its claims are old"
        elif task is None:
            reason = _over(state, task_id)
        elif number <= step:
            reason = "the step is done"
        elif number > step + 1:
            reason = "the steps before it are not done"
        elif not is_own_step(task, step, command.robot):
            reason = "the step is not its own"
        elif action is not None and action.robot != command.robot:
            reason = f"{action.robot} has the step"
        elif action is not None and action.stage not in ("running", "paused") and not has_not_begun(action):
            reason = "the fleet recovers the step"
        else:
            yield made_from(IsolatedResultAccepted, command, subject=subject, result=result)
            if result == "success":
                done[task_id] = done.get(task_id, 0) + 1
                yield from _completed(state, subject, action)
            continue
        yield made_from(IsolatedResultOvertaken, command, subject=subject, result=result, reason=reason)


def _over(state: State, task_id: str) -> str:
    """Return why a task that is not open takes no result."""
    if task_id not in state.context:
        return "the fleet does not know the task"
    return "the task is completed" if state.context[task_id] else "the task is given up"


def _completed(state: State, subject: Subject[str, str], action: Action | None) -> Iterator[Event]:
    """Yield the end of the step, and of the robot's action on it that the fleet knew of."""
    if action is not None:
        yield from release(state.authority, action.action_id)
        if has_not_begun(action):
            yield ExecutionWithdrawn(action.subject, action.robot)
        else:
            yield ExecutionFinished(action.subject, parties(state, action), robot=action.robot, result="success")
    yield StepCompleted(subject)
