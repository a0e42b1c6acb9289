"""What supervisors decide, and how often they are asked: H_i for its robot, H_F for the fleet.

Paper: eq:supervision.
"""

from collections.abc import Callable

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import FLEET_SUPERVISOR, Parties, Principal, Robot, Supervisor
from fsar_ledger.events.recovery import FailureResolved
from fsar_ledger.events.supervision import (
    ActuatorServiced,
    SupervisionDensitySet,
    SupervisorCalled,
    SupervisorResponded,
)
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.request import Request
from fsar_ledger.projections.supervision import Supervision, density
from fsar_ledger.runtime.ports import DISAPPROVES, PREFERS_OTHER, Ask

from .commands import Handlers, Respond, Scheduled, at_once, nobody, present
from .public import PublicCommand, carried_out, made_from, not_in_charge, rejected, unknown_robot
from .task import first_in_order

HANDLERS = Handlers()


class RespondToCall(PublicCommand):
    """Answer a call: approve the review or not, order two commands, or resolve the failure.

    `preferred` goes first.
    """

    supervisor: Supervisor
    action_id: str
    approves: bool
    preferred: str | None = None


class SetSupervisionDensity(PublicCommand):
    """Review one in so many admissions by the robot (None: by every robot); 0 means none."""

    issued_by: Supervisor
    robot: Robot | None
    review_every: int
    reason: str


def supervisor_for(state: State, robot: Robot, is_cross_robot: bool) -> Supervisor:
    """Return the supervisor to call about the robot: its own H_i if on shift for that robot alone, else H_F.

    Paper: sec:model:supervision.
    """
    supervisor = state.fleet.robots[robot].supervisor
    if state.fleet.isolated == robot and supervisor is not None:
        return supervisor  # no other can be reached
    if is_cross_robot or supervisor is None or supervisor in state.world.off_shift:
        return FLEET_SUPERVISOR
    return supervisor


def is_due_for_review(supervision: Supervision, executor: Robot) -> bool:
    """Return whether supervision density submits the executor's next admission to a supervisor.

    Paper: sec:model:supervision.
    """
    every = density(supervision, executor)
    return every > 0 and (supervision.admissions.get(executor, 0) + 1) % every == 0


def requester_of(request: Request) -> Robot | None:
    """Return the requester, for the record of the answer."""
    return request.requester


NameRequester = Callable[[Request], Principal | None]
"""The requester that an architecture has on record before anything is executed."""


@HANDLERS.decide(Respond, nobody)
def respond(state: State, command: Respond, name_requester: NameRequester = requester_of) -> tuple[Event, ...]:
    """Approve the review or not, order the commands or resolve the failure, as the human answers.

    Nothing if the subject of the call is settled.
    """
    call = state.supervision.calls.get(command.call)
    if call is None or is_settled(state, call):
        return ()
    approves = not (call.purpose == "review" and command.answer == DISAPPROVES)
    preferred = first_in_order(state.request, state.task, call)
    if call.purpose == "ordering" and command.answer == PREFERS_OTHER:
        preferred = call.competing if preferred == call.subject.action_id else call.subject.action_id
    return _responded(state, call, approves, preferred, name_requester)


@HANDLERS.decide(RespondToCall)
def respond_to_call(
    state: State, command: RespondToCall, name_requester: NameRequester = requester_of
) -> tuple[Event, ...]:
    """Answer the open call as the supervisor who was called."""
    unknown = not_in_charge(state.fleet, command.supervisor, None)
    if unknown is not None:
        return rejected(command, command.action_id, unknown, command.supervisor)
    calls = [call for call in state.supervision.calls.values() if call.subject.action_id == command.action_id]
    call = next((call for call in calls if call.supervisor == command.supervisor), None)
    if call is None:
        finding = f"the call went to {calls[0].supervisor}" if calls else "no open call"
        return rejected(
            command, command.action_id, f"{finding}, expected one to {command.supervisor}", command.supervisor
        )
    refused = _unfit(call, command)
    if is_settled(state, call):
        refused = "what the call was about has ended, expected an action or a request under way"
    if refused is not None:
        return rejected(command, command.action_id, refused, command.supervisor)
    return _responded(state, call, command.approves, command.preferred, name_requester)


def is_settled(state: State, call: SupervisorCalled) -> bool:
    """Return whether the request and the action that the call was about are over."""
    return call.subject.action_id not in state.request.open and call.subject.action_id not in state.execution.actions


def is_too_late(state: State, call: SupervisorCalled) -> bool:
    """Return whether the review is of a request that was closed or given up meanwhile.

    It is kept until its task goes on.
    """
    request = state.request.open.get(call.subject.action_id)
    is_over = request is not None and request.is_over and call.subject.action_id not in state.execution.actions
    return call.purpose == "review" and is_over


def is_open(state: State, call: SupervisorCalled) -> bool:
    """Return whether the call can still be answered.

    Where the run is of another system, what it is about may be on no record.
    """
    return not (is_too_late(state, call) or (state.fleet.is_live and is_settled(state, call)))


def _unfit(call: SupervisorCalled, command: RespondToCall) -> str | None:
    """Return why the answer does not fit the call, or None."""
    if not command.approves and call.purpose != "review":
        return f"found a disapproval of {call.purpose}, expected one of a review"
    contenders = (call.subject.action_id, call.competing) if call.purpose == "ordering" else ()
    if command.preferred is not None and command.preferred not in contenders:
        return f"{command.preferred} does not compete, expected one of {', '.join(filter(None, contenders)) or 'none'}"
    return None


def _responded(
    state: State, call: SupervisorCalled, approves: bool, preferred: str | None, name_requester: NameRequester
) -> tuple[Event, ...]:
    """Record the answer.

    A failure that was submitted to the supervisor is over, and a degraded robot is serviced.
    """
    action = state.execution.actions.get(call.subject.action_id)
    request = state.request.open.get(call.subject.action_id)
    requested_by = executed_by = None
    if action is not None:
        requested_by, executed_by = action.requested_by, action.executed_by
    elif request is not None:
        requested_by, executed_by = name_requester(request), request.target
    supervisor = call.supervisor
    response = SupervisorResponded(
        call.subject,
        Parties(requested_by=requested_by, executed_by=executed_by, supervised_by=supervisor).decided(supervisor),
        call.purpose,
        approves,
        preferred,
    )
    recovery = state.recovery.get(call.subject.action_id)
    if call.purpose != "recovery" or recovery is None:
        return (response,)
    resolved = FailureResolved(call.subject, recovery.robot, recovery.failure, "human")
    if recovery.robot in state.world.degraded:
        return (response, ActuatorServiced(recovery.robot), resolved)
    return (response, resolved)


@HANDLERS.decide(SetSupervisionDensity)
def set_supervision_density(state: State, command: SetSupervisionDensity) -> tuple[Event, ...]:
    """Set the density: of a robot by its own supervisor or H_F, of every robot by H_F. Paper: sec:model:supervision."""
    subject = command.robot or "every robot"
    refused = unknown_robot(state.fleet, command.robot) or not_in_charge(
        state.fleet, command.issued_by, command.robot, is_fleet_matter=command.robot is None
    )
    if refused is None and command.review_every < 0:
        refused = f"density {command.review_every}, expected 0 (none) or one in so many"
    event = made_from(SupervisionDensitySet, command, decided_by=command.issued_by)
    return carried_out(command, subject, refused, command.issued_by, event)


@HANDLERS.react(SupervisorCalled)
def on_call(state: State, event: SupervisorCalled, _now_us: int) -> tuple[Scheduled, ...]:
    """Schedule the response to the executor's call; before there is an executor, the requester calls."""
    action = state.execution.actions.get(event.subject.action_id)
    request = state.request.open.get(event.subject.action_id)
    if action is not None:
        return awaiting(state, event, present(state.fleet, action.robot))
    return awaiting(state, event, None if request is None else request.target or request.requester)


def awaiting(state: State, event: SupervisorCalled, caller: str | None) -> tuple[Scheduled, ...]:
    """Schedule the response to the call; there is none while the caller is not linked."""
    action = state.execution.actions.get(event.subject.action_id)
    ordinal = action.failures if action is not None else 0
    share = state.fleet.structure.ordering_response_ppm if event.purpose == "ordering" else 1_000_000
    key = f"{event.subject.action_id}/{event.purpose}/{ordinal}"
    response, verdict = Ask("human", "response", key, share), Ask("human", "verdict", key)
    return (Scheduled(Respond(state.supervision.called), 0, (response, at_once(caller)), verdict),)
