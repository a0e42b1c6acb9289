"""Requests that are under way, one per action, however the architecture negotiates them. Paper: eq:request."""

from typing import assert_never

import msgspec

from fsar_ledger.events.envelope import PolicyOutcome
from fsar_ledger.events.knowledge import BidReceived
from fsar_ledger.events.registry import RegistryQueried
from fsar_ledger.events.request import AwardMade, CommandIssued, ContractQuestioned, ContractVoided, RequestAccepted, RequestIssued, RequestRelayed
from fsar_ledger.events.supervision import SupervisorCalled
from fsar_ledger.events.task import StepBegan, StepCompleted
from fsar_ledger.events.world import OutsiderRequestInjected

HANDLES = (
    StepBegan
    | StepCompleted
    | OutsiderRequestInjected
    | RegistryQueried
    | RequestIssued
    | RequestRelayed
    | CommandIssued
    | BidReceived
    | SupervisorCalled
    | AwardMade
    | RequestAccepted
    | ContractQuestioned
    | ContractVoided
)


class Request(msgspec.Struct, frozen=True, gc=False):
    """The request for one action. `target` is the robot asked; `round` counts negotiations from 0."""

    task_id: str
    action_id: str
    requester: str
    capability: str
    step: int
    attempt: int
    is_delegated: bool
    candidates: tuple[str, ...] = ()
    relay: str | None = None
    carried: PolicyOutcome = "allow"
    target: str | None = None
    seen_busy: bool = False
    bids: tuple[tuple[str, PolicyOutcome], ...] = ()
    is_accepted: bool = False
    is_questioned: bool = False
    round: int = 0


Requests = dict[str, Request]

INITIAL: Requests = {}


def evolve(state: Requests, event: HANDLES) -> Requests:
    """The requests after the event."""
    match event:
        case StepBegan():
            others = {name: request for name, request in state.items() if request.task_id != event.task_id}
            begun = Request(event.task_id, event.action_id, event.robot, event.capability, event.step, event.attempt, event.target_role is not None)
            return {**others, event.action_id: begun}
        case StepCompleted():
            return {name: request for name, request in state.items() if name != event.action_id}
        case OutsiderRequestInjected():
            injected = Request(event.task_id, event.task_id, event.robot, event.capability, 0, 1, True, (event.peer,), target=event.peer)
            return {**state, event.task_id: injected}
        case RegistryQueried():
            asking = state.get(event.action_id or "")
            if asking is None or asking.capability != event.capability:  # a query in service of the action's recovery
                return state
            return _changed(state, event.action_id, candidates=event.candidates, relay=event.relay)
        case RequestIssued():
            carried = event.carried_policy or "allow"
            return _changed(state, event.action_id, carried=carried, relay=event.relay)
        case RequestRelayed():
            return _changed(state, event.action_id, carried=event.carried_policy)
        case CommandIssued():
            return _changed(state, event.action_id, target=event.robot, seen_busy=event.seen_busy)
        case BidReceived():
            bids = (*state[event.action_id].bids, (event.robot, event.outcome))
            return _changed(state, event.action_id, bids=bids)
        case AwardMade():
            action_id = next(name for name, request in state.items() if request.task_id == event.task_id)
            return _changed(state, action_id, target=event.robot, is_questioned=False)
        case SupervisorCalled():
            return state if event.robot is None else _changed(state, event.action_id, target=event.robot)
        case RequestAccepted():
            return _changed(state, event.action_id, target=event.executed_by, is_accepted=True)
        case ContractQuestioned():
            return _changed(state, event.action_id, is_questioned=True)
        case ContractVoided():
            known = state[event.action_id]
            return _changed(state, event.action_id, bids=(), target=None, is_accepted=False, is_questioned=False, round=known.round + 1)
        case _:
            assert_never(event)


def _changed(state: Requests, action_id: str | None, **changes: object) -> Requests:
    if action_id is None or action_id not in state:
        return state
    return {**state, action_id: msgspec.structs.replace(state[action_id], **changes)}
