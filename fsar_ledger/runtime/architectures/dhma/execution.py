"""DHMA: the robot's agents plan, start and repair execution among themselves. Paper: sec:evaluation:baselines."""

from typing import Any

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import FLEET_SUPERVISOR
from fsar_ledger.events.execution import (
    ExecutionPaused,
    ExecutionQueued,
    ExecutionWithdrawn,
    OwnStepDecided,
    RoutinePerformed,
    RoutineReported,
    RoutineWithheld,
)
from fsar_ledger.events.knowledge import PlannerEngaged
from fsar_ledger.events.request import ContractVoided, RequestDenied
from fsar_ledger.events.supervision import SupervisorCalled, SupervisorResponded
from fsar_ledger.events.task import StepBegan
from fsar_ledger.projections.fold import State
from fsar_ledger.runtime.handlers.actors import body, requester
from fsar_ledger.runtime.handlers.attribution import on_shift
from fsar_ledger.runtime.handlers.commands import (
    Actors,
    BeginStep,
    Command,
    DecideRoutine,
    Decides,
    Reacts,
    ResumeAction,
    Scheduled,
    StartAction,
    TakeTurn,
    at_once,
    hop,
    hops,
    message,
)
from fsar_ledger.runtime.handlers.execution import approach, started

from .agents import handoff, path, released, round_trip, snapshot


class PlanOwnStep(Command):
    """A step of the robot's own is due."""

    action_id: str


class QueueOwnStep(Command):
    """The execution agent has the plan."""

    action_id: str


class TalkReplan(Command):
    """A paused action needs a new plan."""

    action_id: str


def plan_own_step(state: State, command: PlanOwnStep) -> tuple[Event, ...]:
    """The planner has handed the step to the execution agent, or its snapshot forbids it for now."""
    request = state.request.get(command.action_id)
    if request is None:
        return ()
    robot, outcome = request.requester, snapshot(state, request.requester)
    supervisor = on_shift(state, robot)
    context: dict[str, Any] = {"task_id": request.task_id, "action_id": request.action_id}
    context |= {"requested_by": robot, "executed_by": robot, "supervised_by": supervisor, **path(robot, "planning", "execution")}
    if command.action_id not in state.supervision.approved:
        if outcome == "deny":
            return (RequestDenied(**context, request_id=None, reason="own step"),)
        if outcome == "review":
            return (SupervisorCalled(request.task_id, request.action_id, FLEET_SUPERVISOR, "review"),)
    return (OwnStepDecided(**context, capability=request.capability), handoff(state, robot, "planning", "execution"))


def queue_own_step(state: State, command: QueueOwnStep) -> tuple[Event, ...]:
    """The step waits for the robot."""
    request = state.request.get(command.action_id)
    if request is None:
        return ()
    robot = request.requester
    queued = (robot, robot, request.capability, request.step, request.attempt, False, False, True)
    return (ExecutionQueued(request.task_id, request.action_id, robot, robot, on_shift(state, robot), *queued),)


def start(state: State, command: StartAction) -> tuple[Event, ...]:
    """The robot executes, unless a party's context has changed since the award: then the contract is void."""
    action = state.execution.actions.get(command.action_id)
    if action is None or action.stage not in ("queued", "approaching"):
        return ()
    request = state.request.get(command.action_id)
    if request is not None and request.is_questioned and command.action_id not in state.supervision.approved:
        about = (action.task_id, action.action_id, action.robot)
        talk = round_trip(state, action.robot, "execution", "communication", 3)
        back = handoff(state, action.on_behalf_of, "communication", "planning")
        return (*released(state, action.action_id), ContractVoided(*about), ExecutionWithdrawn(*about), *talk, back)
    return (started(state, action, command),)


def talk_replan(state: State, command: TalkReplan) -> tuple[Event, ...]:
    """The agents have passed the new plan on: three hops in the robot, four more in the other where the action is delegated."""
    action = state.execution.actions.get(command.action_id)
    if action is None:
        return ()
    own = (*round_trip(state, action.robot, "execution", "planning", 2), handoff(state, action.robot, "planning", "execution"))
    return (*own, *round_trip(state, action.on_behalf_of, "communication", "planning", 4)) if action.is_delegated else own


def decide_routine(state: State, command: DecideRoutine) -> tuple[Event, ...]:
    """Sensing is one agent's; a motion crosses two, each of which records its half, and engages the planner."""
    robot, supervisor = command.robot, on_shift(state, command.robot)
    if command.operation == "sensing":
        return (RoutinePerformed(robot, robot, robot, supervisor, (robot,), robot, "sensing"),)
    decided = {**path(robot, "planning", "execution"), "requested_by": robot, "executed_by": None, "supervised_by": supervisor}
    kind = RoutinePerformed if snapshot(state, robot) == "allow" else RoutineWithheld
    return (
        kind(**decided, robot=robot, operation="motion"),
        RoutineReported(None, robot, None, robot),
        PlannerEngaged(robot, command.now_us + state.fleet.structure.engagement_us),
    )


def _on_step(_state: State, event: StepBegan, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(PlanOwnStep(event.action_id)),) if event.target_role is None else ()


def _on_denial(state: State, event: RequestDenied, _now_us: int) -> tuple[Scheduled, ...]:
    if event.reason != "own step" or event.task_id is None or event.action_id is None:
        return ()
    return (Scheduled(BeginStep(event.task_id, event.action_id), state.fleet.structure.back_off_us),)


def _on_response(state: State, event: SupervisorResponded, _now_us: int) -> tuple[Scheduled, ...]:
    request = state.request.get(event.action_id)
    if event.purpose != "review" or request is None or request.is_delegated:
        return ()
    return (Scheduled(PlanOwnStep(event.action_id), 1, (at_once(event.decided_by),)),)


def _on_own_step(state: State, event: OwnStepDecided, _now_us: int) -> tuple[Scheduled, ...]:
    assert event.action_id is not None
    return (Scheduled(QueueOwnStep(event.action_id), 0, (hop(state, event.action_id, "own"),)),)


def _on_pause(state: State, event: ExecutionPaused, _now_us: int) -> tuple[Scheduled, ...]:
    """Replanning goes through the robot's agents, and for a delegated action through the other robot's too."""
    structure = state.fleet.structure
    action = state.execution.actions[event.action_id]
    key = f"{event.action_id}/replan{action.segments}"
    talk = Scheduled(TalkReplan(event.action_id))
    if not action.is_delegated:
        return (talk, Scheduled(ResumeAction(event.action_id), structure.replan_us, hops(state, key, "own", 3)))
    way = (*hops(state, key, "own", 3), message(event.robot, key, 0), message(action.on_behalf_of, key, 1), *hops(state, key, "other", 4))
    return (talk, Scheduled(ResumeAction(event.action_id), structure.replan_us + structure.renegotiation_us, way))


DECIDES: Decides = {
    PlanOwnStep: plan_own_step,
    QueueOwnStep: queue_own_step,
    TakeTurn: approach,
    StartAction: start,
    TalkReplan: talk_replan,
    DecideRoutine: decide_routine,
}
ACTORS: Actors = {
    PlanOwnStep: requester,
    QueueOwnStep: requester,
    TalkReplan: body,
}
REACTS: Reacts = {
    StepBegan: _on_step,
    RequestDenied: _on_denial,
    SupervisorResponded: _on_response,
    OwnStepDecided: _on_own_step,
    ExecutionPaused: _on_pause,
}
