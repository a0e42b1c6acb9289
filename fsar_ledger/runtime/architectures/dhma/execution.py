"""DHMA: agents pass execution authority on, and plan, start and repair execution among themselves.

Each agent keeps authority until the next acknowledges. Paper: sec:evaluation:baselines.
"""

from fsar_ledger.events import Event
from fsar_ledger.events.authority import AuthorityClaimed, AuthorityReleased
from fsar_ledger.events.envelope import FLEET_SUPERVISOR, AgentKind, Parties, RequestSubject, agent
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
from fsar_ledger.events.request import ContractVoided, RequestAdmitted, RequestDenied, RequestIssued
from fsar_ledger.events.supervision import SupervisorCalled, SupervisorResponded
from fsar_ledger.events.task import StepBegan
from fsar_ledger.events.world import OutsiderRequestInjected
from fsar_ledger.projections.execution import Action, Execution
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.policy import standing
from fsar_ledger.projections.request import Request, Requests
from fsar_ledger.runtime.handlers.attribution import recorded_by
from fsar_ledger.runtime.handlers.authority import release
from fsar_ledger.runtime.handlers.commands import (
    ActionCommand,
    DecideRoutine,
    Handlers,
    ResumeAction,
    Scheduled,
    StartAction,
    TakeTurn,
    at_once,
    begin_again,
    body,
    commanded_robot,
    message,
    open_request,
    requester,
    target,
)
from fsar_ledger.runtime.handlers.execution import approach, queued, started, waiting
from fsar_ledger.runtime.handlers.supervision import supervisor_for

from .agents import (
    CALL,
    FROM_EXECUTION,
    FROM_PLANNING,
    OWN_STEP,
    RENEGOTIATION,
    REPLANNING,
    SETTLEMENT,
    TO_EXECUTION,
    TO_PLANNING,
    handed_over,
    path,
    snapshot,
    talk,
)

HANDLERS = Handlers()


class PassExecution(ActionCommand):
    """Deliver the work to the executor's next agent."""

    round: int
    sender: AgentKind
    receiver: AgentKind


class AcknowledgeExecution(ActionCommand):
    """Deliver the receiver's acknowledgement to the sender."""

    round: int
    sender: AgentKind


class SettleBooking(ActionCommand):
    """Settle the double booking that the two agents have agreed on."""


class RunOutsider(ActionCommand):
    """Run an out-of-trust request that a nested query has carried past visibility."""


def _under_contract(execution: Execution, requests: Requests, action_id: str, round_number: int) -> Action | None:
    """Return the action while this round's contract holds it."""
    action, request = execution.actions.get(action_id), requests.open.get(action_id)
    if action is None or request is None or request.round != round_number or action.stage == "withdrawn":
        return None
    return action


@HANDLERS.decide(PassExecution, body)
def pass_execution(state: State, command: PassExecution) -> tuple[Event, ...]:
    """Let the receiver claim execution as well."""
    action = _under_contract(state.execution, state.request, command.action_id, command.round)
    if action is None:
        return ()
    receiver = agent(action.robot, command.receiver)
    return (
        AuthorityClaimed(subject=action.subject, dimension="execution", claimant=receiver, reason=command.receiver),
    )


@HANDLERS.decide(AcknowledgeExecution, body)
def acknowledge_execution(state: State, command: AcknowledgeExecution) -> tuple[Event, ...]:
    """Release the sender's claim on execution."""
    action = _under_contract(state.execution, state.request, command.action_id, command.round)
    if action is None:
        return ()
    sender = agent(action.robot, command.sender)
    return tuple(
        AuthorityReleased(claim.subject, "execution", sender, claim.reason)
        for claim in state.authority.claims.get(command.action_id, ())
        if (claim.dimension, claim.claimant) == ("execution", sender)
    )


@HANDLERS.decide(SettleBooking, body)
def settle_booking(state: State, command: SettleBooking) -> tuple[Event, ...]:
    """Resolve the double booking."""
    return release(state.authority, command.action_id, "double booking")


@HANDLERS.decide_on(open_request, RunOutsider, target)
def run_outsider(_state: State, _command: RunOutsider, request: Request) -> tuple[Event, ...]:
    """Run the request unchecked, without an executor or a supervisor on record."""
    if request.target is None:
        return ()
    robot, peer, subject = request.requester, request.target, request.request_subject
    unnamed = Parties(requested_by=robot, executed_by=None, supervised_by=None)
    return (
        RequestIssued(subject=subject, principals=unnamed.decided(*path(robot, CALL)), capability=request.capability),
        RequestAdmitted(subject=subject, principals=unnamed.decided(*path(peer, ("communication",))), outcome="allow"),
        ExecutionQueued(
            subject=request.subject,
            principals=unnamed,
            robot=peer,
            on_behalf_of=robot,
            capability=request.capability,
            step=0,
            attempt=1,
            is_delegated=False,
            has_approach=False,
            is_supervised=False,
        ),
    )


@HANDLERS.react(AuthorityClaimed)
def _on_acceptance(state: State, event: AuthorityClaimed, _now_us: int) -> tuple[Scheduled, ...]:
    """Pass execution from communication to planning to the execution agent.

    Each link takes one hop, and so does each acknowledgement.
    """
    request = state.request.open.get(event.subject.action_id)
    if request is None or request.target is None:
        return ()
    key, robot = f"{event.subject.action_id}/{request.round}", request.target
    contract = (event.subject.action_id, request.round)
    match event.reason:
        case "double booking" if event.claimant == agent(robot, "execution"):
            waits = talk(state.fleet, SETTLEMENT, key, "settle")
            messages = (message(robot, key, "settle"), message(request.requester, key, "settled"))
            return (Scheduled(SettleBooking(event.subject.action_id), 0, (*waits, *messages)),)
        case "acceptance":
            handoff = PassExecution(*contract, *TO_PLANNING)
            return handed_over(state.fleet, robot, TO_PLANNING, key, "planning", handoff)
        case "planning":
            acknowledgement = AcknowledgeExecution(*contract, "communication")
            handoff = PassExecution(*contract, *TO_EXECUTION)
            return (
                *handed_over(state.fleet, robot, FROM_PLANNING, key, "acknowledged", acknowledgement),
                *handed_over(state.fleet, robot, TO_EXECUTION, key, "execution", handoff),
            )
        case "execution":
            acknowledgement = AcknowledgeExecution(*contract, "planning")
            return handed_over(state.fleet, robot, FROM_EXECUTION, key, "confirmed", acknowledgement)
        case _:
            return ()


@HANDLERS.react(OutsiderRequestInjected)
def _on_outsider(state: State, event: OutsiderRequestInjected, _now_us: int) -> tuple[Scheduled, ...]:
    waits = (*talk(state.fleet, CALL, event.task_id, "query"), message(event.robot, event.task_id, 0))
    return (Scheduled(RunOutsider(event.task_id), 0, waits),)


class PlanOwnStep(ActionCommand):
    """Plan a step of the robot's own."""


class QueueOwnStep(ActionCommand):
    """Deliver the plan to the execution agent."""


@HANDLERS.decide_on(open_request, PlanOwnStep, requester)
def plan_own_step(state: State, command: PlanOwnStep, request: Request) -> tuple[Event, ...]:
    """Decide to do the step, unless the planner's snapshot forbids it for now.

    A review demanded by a rule goes to H_i if on shift, else to H_F; an approval lifts no denial.
    """
    robot = request.requester
    outcome = snapshot(state, robot, request.capability, request.task_id)
    parties = recorded_by(state, robot, requested_by=robot, executed_by=robot)
    principals = parties.decided(*path(robot, ("planning",)))
    if outcome == "deny":
        return (RequestDenied(RequestSubject(request.task_id, request.action_id, None), principals, "own step"),)
    if outcome == "review" and command.action_id not in state.supervision.approved:
        is_rule = standing(state.policy, "local", robot, request.capability, request.task_id) == "review"
        reviewer = supervisor_for(state, robot, is_cross_robot=False) if is_rule else FLEET_SUPERVISOR
        return (SupervisorCalled(subject=request.subject, supervisor=reviewer, purpose="review"),)
    return (OwnStepDecided(request.subject, principals, request.capability),)


@HANDLERS.decide_on(open_request, QueueOwnStep, requester)
def queue_own_step(state: State, _command: QueueOwnStep, request: Request) -> tuple[Event, ...]:
    """Queue the step for the robot."""
    robot = request.requester
    parties = recorded_by(state, robot, requested_by=robot, executed_by=robot)
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
    return (started(state, action, command),)


@HANDLERS.decide(DecideRoutine, commanded_robot)
def decide_routine(state: State, command: DecideRoutine) -> tuple[Event, ...]:
    """Perform the routine operation: sensing by one agent, a motion by the planner.

    A motion engages the planner; the planner and the execution agent each record half of it.
    """
    robot = command.robot
    if command.operation == "sensing":
        sensing_parties = recorded_by(state, robot, requested_by=robot, executed_by=robot)
        return (RoutinePerformed(sensing_parties.decided(robot), robot, "sensing"),)
    parties = recorded_by(state, robot, requested_by=robot, executed_by=None)
    kind = RoutinePerformed if snapshot(state, robot, None, None) == "allow" else RoutineWithheld
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
    delay_us = 1 if event.approves else state.fleet.structure.back_off_us
    return (Scheduled(PlanOwnStep(event.subject.action_id), delay_us, (at_once(event.principals.decided_by),)),)


@HANDLERS.react(OwnStepDecided)
def _on_own_step(state: State, event: OwnStepDecided, _now_us: int) -> tuple[Scheduled, ...]:
    assert event.subject.action_id is not None
    waits = talk(state.fleet, OWN_STEP, event.subject.action_id, "own")
    return (Scheduled(QueueOwnStep(event.subject.action_id), 0, waits),)


@HANDLERS.react(ExecutionPaused)
def _on_pause(state: State, event: ExecutionPaused, _now_us: int) -> tuple[Scheduled, ...]:
    """Replan through the robot's agents; a delegated action also needs the other robot's agents."""
    structure = state.fleet.structure
    action = state.execution.actions[event.subject.action_id]
    key = f"{event.subject.action_id}/replan{action.segments}"
    resume = ResumeAction(event.subject.action_id)
    replanning = talk(state.fleet, REPLANNING, key, "own")
    if not action.is_delegated:
        return (Scheduled(resume, structure.replan_us, replanning),)
    delivered = (*replanning, message(event.robot, key, 0), message(action.on_behalf_of, key, 1))
    renegotiation = (*delivered, *talk(state.fleet, RENEGOTIATION, key, "other"))
    return (Scheduled(resume, structure.replan_us + structure.renegotiation_us, renegotiation),)


HANDLERS.decide(TakeTurn, body)(approach)
