"""DHMA: what follows when something happens in a contract net."""

from fsar_ledger.events.envelope import Robot
from fsar_ledger.events.execution import ExecutionFinished
from fsar_ledger.events.knowledge import BidReceived
from fsar_ledger.events.registry import RegistryQueried
from fsar_ledger.events.request import (
    AwardMade,
    BidSubmitted,
    ContractVoided,
    GapDetected,
    RequestClosed,
    RequestUnanswered,
)
from fsar_ledger.events.supervision import SupervisorResponded
from fsar_ledger.events.task import StepBegan
from fsar_ledger.projections.fleet import Fleet
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.request import Request
from fsar_ledger.runtime.handlers.commands import (
    BeginStep,
    CloseExecution,
    CloseRequest,
    CompleteStep,
    Handlers,
    Scheduled,
    at_once,
    message,
)
from fsar_ledger.runtime.ports import Ask

from .request import (
    AcceptAward,
    Award,
    CallForProposals,
    CloseBidding,
    DetectGap,
    EvaluateBid,
    GoOnWithout,
    ReceiveBid,
    best_bid,
)
from .talk import CALL, EVALUATION, OWN_RESULT, RELAY, RESULT, VOIDING, talk

LONGEST = 3  # a call that is delivered within the answer time, and two hops, are over after so many of them

HANDLERS = Handlers()


def call(fleet: Fleet, request: Request, robot: Robot, before: tuple[Ask, ...] = ()) -> tuple[Scheduled, ...]:
    """Deliver the call to the candidate, whose agents work out a bid. The waits `before` come first."""
    key = f"{request.action_id}/{request.round}/{robot}"
    said, record = talk(fleet, robot, EVALUATION, key, "evaluate", (*before, message(request.requester, key, "call")))
    return (Scheduled(EvaluateBid(request.action_id, robot), 0, said), record)


@HANDLERS.react(StepBegan)
def _on_step(_state: State, event: StepBegan, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(DetectGap(event.subject.action_id)),) if event.target_role is not None else ()


@HANDLERS.react(GapDetected)
def _on_gap(state: State, event: GapDetected, _now_us: int) -> tuple[Scheduled, ...]:
    assert event.subject.action_id is not None
    said, record = talk(
        state.fleet, state.request.open[event.subject.action_id].requester, CALL, event.subject.action_id, 0
    )
    return (Scheduled(CallForProposals(event.subject.action_id), 0, said), record)


@HANDLERS.react(RegistryQueried)
def _on_call(state: State, event: RegistryQueried, _now_us: int) -> tuple[Scheduled, ...]:
    assert event.subject.action_id is not None
    request = state.request.open[event.subject.action_id]
    calls = tuple(scheduled for robot in event.candidates for scheduled in call(state.fleet, request, robot))
    return (*calls, *_closing(state.fleet, request, (at_once(request.requester),)))


def _closing(fleet: Fleet, request: Request, waits: tuple[Ask, ...]) -> tuple[Scheduled, ...]:
    """Schedule both ends of bidding.

    The first is when the calls should have been delivered; the last is later by the longest time that agents take to
    judge a delivered call.
    """
    answer_us = fleet.answer_us
    last = CloseBidding(request.action_id, request.round, is_last=True)
    return (
        Scheduled(CloseBidding(request.action_id, request.round), answer_us, waits),
        Scheduled(last, LONGEST * answer_us, waits),
    )


@HANDLERS.react(BidSubmitted)
def _on_bid(state: State, event: BidSubmitted, _now_us: int) -> tuple[Scheduled, ...]:
    request = state.request.open.get(state.task[event.task_id].action_id) if event.task_id in state.task else None
    if request is None:
        return ()
    key = f"{request.action_id}/{request.round}/{event.robot}"
    received = ReceiveBid(request.action_id, event.robot, event.outcome)
    said, record = talk(state.fleet, request.requester, RELAY, key, "relay", (message(event.robot, key, "bid"),))
    return (Scheduled(received, 0, said), record)


@HANDLERS.react(BidReceived)
def _on_bid_received(state: State, event: BidReceived, _now_us: int) -> tuple[Scheduled, ...]:
    request = state.request.open[event.subject.action_id]
    if len(request.bids) < len(request.candidates):  # it may have been the last one that was waited for
        return _closing(state.fleet, request, (at_once(request.requester),))
    if best_bid(request) is None:
        return (
            Scheduled(BeginStep(event.subject.task_id, event.subject.action_id), state.fleet.structure.back_off_us),
        )
    return (Scheduled(Award(event.subject.action_id)),)


@HANDLERS.react(SupervisorResponded)
def _on_response(state: State, event: SupervisorResponded, _now_us: int) -> tuple[Scheduled, ...]:
    request = state.request.open.get(event.subject.action_id)
    if event.purpose != "review" or request is None or not request.is_delegated:
        return ()
    return (Scheduled(Award(event.subject.action_id), 1, (at_once(event.principals.decided_by),)),)


@HANDLERS.react(AwardMade)
def _on_award(state: State, event: AwardMade, _now_us: int) -> tuple[Scheduled, ...]:
    task = state.task.get(event.task_id)
    if task is None:  # given up meanwhile
        return ()
    request = state.request.open[task.action_id]
    told = Scheduled(
        AcceptAward(request.action_id), 0, (message(request.requester, request.action_id, f"award/{request.round}"),)
    )
    return (
        told,
        Scheduled(GoOnWithout(request.action_id, request.round), state.fleet.answer_us, (at_once(request.requester),)),
    )


@HANDLERS.react(RequestUnanswered)
def _on_unanswered(state: State, event: RequestUnanswered, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(BeginStep(event.subject.task_id, event.subject.action_id), state.fleet.structure.back_off_us),)


@HANDLERS.react(ContractVoided)
def _on_void(state: State, event: ContractVoided, _now_us: int) -> tuple[Scheduled, ...]:
    """Let both sides' agents agree that the contract is void, and negotiate again under the same action."""
    request = state.request.open[event.subject.action_id]
    key = f"{request.action_id}/{request.round}/void"
    said, record = talk(state.fleet, event.robot, VOIDING, key, "void")
    agreed, other = talk(
        state.fleet, request.requester, RELAY, key, "again", (*said, message(event.robot, key, "void"))
    )
    calls = tuple(scheduled for robot in request.candidates for scheduled in call(state.fleet, request, robot, agreed))
    return (*calls, record, other, *_closing(state.fleet, request, agreed))


@HANDLERS.react(ExecutionFinished)
def _on_finish(state: State, event: ExecutionFinished, _now_us: int) -> tuple[Scheduled, ...]:
    request = state.request.open.get(event.subject.action_id)
    close = Scheduled(CloseExecution(event.subject.action_id))
    if request is None or request.step == 0:
        return (close,)
    said, record = talk(
        state.fleet, event.robot, RESULT if request.is_delegated else OWN_RESULT, event.subject.action_id, "result"
    )
    if not request.is_delegated:
        return (close, Scheduled(CompleteStep(event.subject.action_id), 0, said), record)
    return (
        close,
        Scheduled(CloseRequest(event.subject.action_id), 0, (*said, message(event.robot, event.subject.action_id, 4))),
        record,
    )


@HANDLERS.react(RequestClosed)
def _on_close(_state: State, event: RequestClosed, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(CompleteStep(event.subject.action_id)),)
