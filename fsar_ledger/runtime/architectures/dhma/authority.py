"""DHMA: agents pass execution authority on, and each keeps it until the next acknowledges.

Paper: sec:evaluation:baselines.
"""

from fsar_ledger.events import Event
from fsar_ledger.events.authority import AuthorityClaimed, AuthorityReleased
from fsar_ledger.events.envelope import AgentKind, Parties, agent
from fsar_ledger.events.execution import ExecutionQueued
from fsar_ledger.events.request import RequestAdmitted, RequestIssued
from fsar_ledger.events.world import OutsiderRequestInjected
from fsar_ledger.projections.execution import Action, Execution
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.request import Requests
from fsar_ledger.runtime.handlers.authority import release
from fsar_ledger.runtime.handlers.commands import Command, Handlers, Scheduled, body, message, target

from .agents import CALL, FROM_EXECUTION, FROM_PLANNING, SETTLEMENT, TO_EXECUTION, TO_PLANNING, TalkPlan, path, talk

HANDLERS = Handlers()


class PassExecution(Command):
    """Deliver the work to the executor's next agent."""

    action_id: str
    round: int
    sender: AgentKind
    receiver: AgentKind


class AcknowledgeExecution(Command):
    """Deliver the receiver's acknowledgement to the sender."""

    action_id: str
    round: int
    sender: AgentKind


class SettleBooking(Command):
    """Settle the double booking that the two agents have agreed about."""

    action_id: str


class RunOutsider(Command):
    """Run an out-of-trust request that a nested query has carried past visibility."""

    action_id: str


def _under_contract(execution: Execution, requests: Requests, action_id: str, contract: int) -> Action | None:
    """Return the action while this round's contract holds it."""
    action, request = execution.actions.get(action_id), requests.open.get(action_id)
    if action is None or request is None or request.round != contract or action.stage == "withdrawn":
        return None
    return action


@HANDLERS.decide(PassExecution, body)
def pass_execution(state: State, command: PassExecution) -> tuple[Event, ...]:
    """Let the receiver claim execution as well."""
    action = _under_contract(state.execution, state.request, command.action_id, command.round)
    if action is None:
        return ()
    receiver = agent(action.robot, command.receiver)
    return (AuthorityClaimed(action.subject, "execution", receiver, command.receiver),)


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


@HANDLERS.decide(RunOutsider, target)
def run_outsider(state: State, command: RunOutsider) -> tuple[Event, ...]:
    """Run the request unchecked, without an executor or a supervisor on record."""
    request = state.request.open.get(command.action_id)
    if request is None or request.target is None:
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
            said, record = talk(state.fleet, robot, SETTLEMENT, key, "settle")
            return (
                Scheduled(
                    SettleBooking(event.subject.action_id),
                    0,
                    (*said, message(robot, key, "settle"), message(request.requester, key, "settled")),
                ),
                record,
            )
        case "acceptance":
            return _heard(
                talk(state.fleet, robot, TO_PLANNING, key, "planning"), PassExecution(*contract, *TO_PLANNING)
            )
        case "planning":
            acknowledged = _heard(
                talk(state.fleet, robot, FROM_PLANNING, key, "acknowledged"),
                AcknowledgeExecution(*contract, "communication"),
            )
            return (
                *acknowledged,
                *_heard(
                    talk(state.fleet, robot, TO_EXECUTION, key, "execution"), PassExecution(*contract, *TO_EXECUTION)
                ),
            )
        case "execution":
            return _heard(
                talk(state.fleet, robot, FROM_EXECUTION, key, "confirmed"), AcknowledgeExecution(*contract, "planning")
            )
        case _:
            return ()


def _heard(said: TalkPlan, command: Command) -> tuple[Scheduled, ...]:
    """Schedule what follows once the agents have talked, and the record of their talk."""
    lengths, record = said
    return (Scheduled(command, 0, lengths), record)


@HANDLERS.react(OutsiderRequestInjected)
def _on_outsider(state: State, event: OutsiderRequestInjected, _now_us: int) -> tuple[Scheduled, ...]:
    said, record = talk(state.fleet, event.robot, CALL, event.task_id, "query")
    return (Scheduled(RunOutsider(event.task_id), 0, (*said, message(event.robot, event.task_id, 0))), record)
