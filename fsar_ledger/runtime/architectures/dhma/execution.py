"""DHMA: the robot's agents plan, start and repair execution among themselves. Paper: sec:evaluation:baselines."""

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import FLEET_SUPERVISOR, Parties, RequestSubject
from fsar_ledger.events.execution import (
    ExecutionPaused,
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
from fsar_ledger.runtime.handlers.attribution import recorded_by
from fsar_ledger.runtime.handlers.authority import release
from fsar_ledger.runtime.handlers.commands import (
    Command,
    DecideRoutine,
    Handlers,
    ResumeAction,
    Scheduled,
    StartAction,
    TakeTurn,
    at_once,
    begin_again,
    body,
    message,
    named,
    requester,
)
from fsar_ledger.runtime.handlers.execution import approach, queued, started, waiting

from .agents import OWN_STEP, RENEGOTIATION, REPLANNING, path, snapshot, talk

HANDLERS = Handlers()


class PlanOwnStep(Command):
    """Plan a step of the robot's own."""

    action_id: str


class QueueOwnStep(Command):
    """Deliver the plan to the execution agent."""

    action_id: str


@HANDLERS.decide(PlanOwnStep, requester)
def plan_own_step(state: State, command: PlanOwnStep) -> tuple[Event, ...]:
    """Decide to do the step, unless the planner's snapshot forbids it for now."""
    request = state.request.open.get(command.action_id)
    if request is None:
        return ()
    robot, outcome = request.requester, snapshot(state.knowledge, request.requester)
    parties = recorded_by(state.fleet, state.world, robot, requested_by=robot, executed_by=robot)
    principals = parties.decided(*path(robot, ("planning",)))
    if command.action_id not in state.supervision.approved:
        if outcome == "deny":
            return (RequestDenied(RequestSubject(request.task_id, request.action_id, None), principals, "own step"),)
        if outcome == "review":
            return (SupervisorCalled(subject=request.subject, supervisor=FLEET_SUPERVISOR, purpose="review"),)
    return (OwnStepDecided(request.subject, principals, request.capability),)


@HANDLERS.decide(QueueOwnStep, requester)
def queue_own_step(state: State, command: QueueOwnStep) -> tuple[Event, ...]:
    """Queue the step for the robot."""
    request = state.request.open.get(command.action_id)
    if request is None:
        return ()
    robot = request.requester
    parties = recorded_by(state.fleet, state.world, robot, requested_by=robot, executed_by=robot)
    return (queued(request, parties, robot),)


@HANDLERS.decide(StartAction, body)
def start(state: State, command: StartAction) -> tuple[Event, ...]:
    """Start the execution, or void the contract if a party's context has changed since the award."""
    action = waiting(state.execution, command.action_id)
    if action is None:
        return ()
    request = state.request.open.get(command.action_id)
    if request is not None and request.is_questioned and command.action_id not in state.supervision.approved:
        return (
            *release(state.authority, action.action_id),
            ContractVoided(action.subject, action.robot),
            ExecutionWithdrawn(action.subject, action.robot),
        )
    return (started(state.fleet, state.world, action, command),)


@HANDLERS.decide(DecideRoutine, named)
def decide_routine(state: State, command: DecideRoutine) -> tuple[Event, ...]:
    """Perform the routine operation: sensing by one agent, a motion by the planner.

    A motion engages the planner; the planner and the execution agent each record a half of it.
    """
    robot = command.robot
    if command.operation == "sensing":
        own = recorded_by(state.fleet, state.world, robot, requested_by=robot, executed_by=robot)
        return (RoutinePerformed(own.decided(robot), robot, "sensing"),)
    parties = recorded_by(state.fleet, state.world, robot, requested_by=robot, executed_by=None)
    kind = RoutinePerformed if snapshot(state.knowledge, robot) == "allow" else RoutineWithheld
    return (
        kind(parties.decided(*path(robot, ("planning",))), robot, "motion"),
        RoutineReported(Parties(requested_by=None, executed_by=robot, supervised_by=None), robot),
        PlannerEngaged(robot, command.now_us + state.fleet.structure.engagement_us),
    )


@HANDLERS.react(StepBegan)
def _on_step(_state: State, event: StepBegan, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(PlanOwnStep(event.subject.action_id)),) if event.target_role is None else ()


@HANDLERS.react(RequestDenied)
def _on_denial(state: State, event: RequestDenied, _now_us: int) -> tuple[Scheduled, ...]:
    if event.reason != "own step" or event.subject.task_id is None or event.subject.action_id is None:
        return ()
    return (begin_again(state.fleet, event.subject.task_id, event.subject.action_id),)


@HANDLERS.react(SupervisorResponded)
def _on_response(state: State, event: SupervisorResponded, _now_us: int) -> tuple[Scheduled, ...]:
    request = state.request.open.get(event.subject.action_id)
    if event.purpose != "review" or request is None or request.is_delegated:
        return ()
    return (Scheduled(PlanOwnStep(event.subject.action_id), 1, (at_once(event.principals.decided_by),)),)


@HANDLERS.react(OwnStepDecided)
def _on_own_step(state: State, event: OwnStepDecided, _now_us: int) -> tuple[Scheduled, ...]:
    assert event.subject.action_id is not None
    said, record = talk(
        state.fleet,
        state.request.open[event.subject.action_id].requester,
        OWN_STEP,
        event.subject.action_id,
        "own",
    )
    return (Scheduled(QueueOwnStep(event.subject.action_id), 0, said), record)


@HANDLERS.react(ExecutionPaused)
def _on_pause(state: State, event: ExecutionPaused, _now_us: int) -> tuple[Scheduled, ...]:
    """Replan through the robot's agents; a delegated action also needs the other robot's agents."""
    structure = state.fleet.structure
    action = state.execution.actions[event.subject.action_id]
    key = f"{event.subject.action_id}/replan{action.segments}"
    said, record = talk(state.fleet, action.robot, REPLANNING, key, "own")
    if not action.is_delegated:
        return (Scheduled(ResumeAction(event.subject.action_id), structure.replan_us, said), record)
    agreed, other = talk(
        state.fleet,
        action.on_behalf_of,
        RENEGOTIATION,
        key,
        "other",
        (*said, message(event.robot, key, 0), message(action.on_behalf_of, key, 1)),
    )
    return (
        Scheduled(ResumeAction(event.subject.action_id), structure.replan_us + structure.renegotiation_us, agreed),
        record,
        other,
    )


HANDLERS.decide(TakeTurn, body)(approach)
