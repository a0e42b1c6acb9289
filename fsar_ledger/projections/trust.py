"""Trust scopes between robots, explicit, scope-aware and queryable, and the record on which trust can move. Paper: eq:trust."""

from typing import assert_never

import msgspec

from fsar_ledger.events.authority import AuthorityRevoked
from fsar_ledger.events.envelope import TrustScope
from fsar_ledger.events.execution import ExecutionFailed
from fsar_ledger.events.request import RequestClosed, RequestDenied, RequestIssued
from fsar_ledger.events.trust import TrustSet, TrustThresholdsSet
from fsar_ledger.events.world import OutsiderRequestInjected

Result = RequestIssued | OutsiderRequestInjected | RequestDenied | RequestClosed | ExecutionFailed | AuthorityRevoked
HANDLES = TrustSet | TrustThresholdsSet | Result

SCOPES: tuple[TrustScope, ...] = ("none", "capability", "task", "session", "persistent")  # from narrow to broad
VIOLATIONS = ("trust", "authority", "advertisement")  # refusals that are the requester's own doing
About = tuple[str | None, str | None]  # capability, context; None: all of them
Key = tuple[str, str, str]  # robot, peer, capability


class Record(msgspec.Struct, frozen=True, gc=False):
    """Results in a row: each success ends the row of failures, each failure that of successes."""

    successes: int = 0
    failures: int = 0


class Trust(msgspec.Struct, frozen=True, gc=False):
    """Who trusts whom, and how each has fared with the other.

    `entries`: (robot, peer) -> what about -> scope; `promote_after`, `downgrade_after`: results in a row, 0 is never;
    `contexts`: those that some entry is limited to. While a threshold is
    set, `asked`: action -> (executor, requester, capability) of each direct request that is open; `records`: what
    each robot has seen of its peer; `judged`: the records that the last result changed.
    """

    entries: dict[tuple[str, str], dict[About, TrustScope]] = {}
    promote_after: int = 0
    downgrade_after: int = 0
    contexts: frozenset[str] = frozenset()
    asked: dict[str, Key] = {}
    records: dict[Key, Record] = {}
    judged: tuple[Key, ...] = ()


INITIAL = Trust()


def scope_of(state: Trust, robot: str, peer: str, capability: str | None = None, context: str | None = None) -> TrustScope:
    """How far the robot trusts the peer; the most specific entry holds, and without any there is none."""
    entries = state.entries.get((robot, peer))
    if entries is None:
        return "none"
    for about in ((capability, context), (capability, None), (None, context)):
        if about in entries:
            return entries[about]
    return entries.get((None, None), "none")


def covers(scope: TrustScope, required: TrustScope) -> bool:
    """True when the scope is at least as broad as the required one; `none` covers nothing."""
    return scope != "none" and SCOPES.index(scope) >= SCOPES.index(required)


def follows_record(state: Trust) -> bool:
    """True while trust moves by itself."""
    return state.promote_after > 0 or state.downgrade_after > 0


def evolve(state: Trust, event: HANDLES) -> Trust:
    """Trust after the event."""
    match event:
        case TrustSet():
            return _set(state, event)
        case TrustThresholdsSet():
            thresholds = (event.promote_after, event.downgrade_after)
            if not any(thresholds):
                return Trust(state.entries, contexts=state.contexts)
            return Trust(state.entries, *thresholds, state.contexts, state.asked, state.records)
        case _:
            return _noted(state, event) if follows_record(state) else state


def _set(state: Trust, event: TrustSet) -> Trust:
    """What was set holds; the rows of results that it is about begin again."""
    pair = (event.robot, event.peer)
    entries = {**state.entries, pair: {**state.entries.get(pair, {}), (event.capability, event.context): event.scope}}
    contexts = state.contexts if event.context is None else state.contexts | {event.context}
    if not state.records:
        return msgspec.structs.replace(state, entries=entries, contexts=contexts)
    records = {key: record for key, record in state.records.items() if key[:2] != pair or event.capability not in (None, key[2])}
    return msgspec.structs.replace(state, entries=entries, contexts=contexts, records=records)


def _noted(state: Trust, event: Result) -> Trust:
    """The record after the result. Paper: sec:model:trust (performance history, failures)."""
    match event:
        case RequestIssued():
            if event.action_id is None or event.requested_by is None or event.executed_by is None or event.relay is not None:
                return state  # whoever needs a relay has no direct trust that could move
            return _asking(state, event.action_id, (event.executed_by, event.requested_by, event.capability))
        case OutsiderRequestInjected():
            return _asking(state, event.task_id, (event.peer, event.robot, event.capability))
        case RequestDenied():
            asked = state.asked.get(event.action_id or "")
            return _changed(_closed(state, event.action_id), (asked, False) if asked is not None and event.reason in VIOLATIONS else None)
        case RequestClosed():
            asked = state.asked.get(event.action_id)
            if asked is None:
                return _changed(state)
            executor, requester, capability = event.executed_by or asked[0], asked[1], asked[2]
            of_executor = ((requester, executor, capability), {"success": True, "partial": None, "failure": False}[event.result])
            of_requester = ((executor, requester, capability), True) if event.result == "success" else None
            return _changed(_closed(state, event.action_id), of_executor, of_requester)
        case ExecutionFailed():
            asked = state.asked.get(event.action_id)
            return _changed(state, None if asked is None or asked[1] == event.robot else ((asked[1], event.robot, asked[2]), False))
        case AuthorityRevoked():
            if event.reason != "human override" or event.executed_by is None or event.capability is None:
                return _changed(state)
            return _changed(state, ((event.executed_by, event.requested_by, event.capability), False))
        case _:
            assert_never(event)


def _asking(state: Trust, action_id: str, asked: Key) -> Trust:
    return msgspec.structs.replace(state, asked={**state.asked, action_id: asked}, judged=())


def _closed(state: Trust, action_id: str | None) -> Trust:
    return msgspec.structs.replace(state, asked={name: asked for name, asked in state.asked.items() if name != action_id})


def _changed(state: Trust, *results: tuple[Key, bool | None] | None) -> Trust:
    """Each record with one more success or failure; None is neither, and ends the row of successes."""
    records = dict(state.records)
    for result in filter(None, results):
        key, is_success = result
        known = records.get(key, Record())
        records[key] = Record(known.successes + 1, 0) if is_success else Record(0, known.failures + (is_success is False))
    return msgspec.structs.replace(state, records=records, judged=tuple(result[0] for result in results if result is not None))
