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
Asked = tuple[str, str, str, str | None]  # executor, requester, capability, context
Key = tuple[str, str, str, str | None]  # robot, peer, capability, and the context if trust is set for that one


class Record(msgspec.Struct, frozen=True, gc=False):
    """Results in a row: each success ends the row of failures, each failure that of successes."""

    successes: int = 0
    failures: int = 0


class Trust(msgspec.Struct, frozen=True, gc=False):
    """Who trusts whom, and how each has fared with the other.

    `entries`: (robot, peer) -> what about -> scope; `promote_after`, `downgrade_after`: results in a row, 0 is never;
    `contexts`: those that some entry is limited to. While a threshold is
    set, `asked`: action -> each direct request that is open; `records`: what each robot has seen of its peer, by what
    its trust is set for; `judged`: the records that the last result changed.
    """

    entries: dict[tuple[str, str], dict[About, TrustScope]] = {}
    promote_after: int = 0
    downgrade_after: int = 0
    contexts: frozenset[str] = frozenset()
    asked: dict[str, Asked] = {}
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
    records = {key: record for key, record in state.records.items() if key[:2] != pair or event.capability not in (None, key[2]) or event.context != key[3]}
    return msgspec.structs.replace(state, entries=entries, contexts=contexts, records=records)


def _noted(state: Trust, event: Result) -> Trust:
    """The record after the result. Paper: sec:model:trust (performance history, failures)."""
    match event:
        case RequestIssued():
            if event.action_id is None or event.requested_by is None or event.executed_by is None or event.relay is not None:
                return state  # whoever needs a relay has no direct trust that could move
            return _asking(state, event.action_id, (event.executed_by, event.requested_by, event.capability, event.task_id))
        case OutsiderRequestInjected():
            return _asking(state, event.task_id, (event.peer, event.robot, event.capability, event.task_id))
        case RequestDenied():
            asked = state.asked.get(event.action_id or "")
            return _changed(_closed(state, event.action_id), (asked, False) if asked is not None and event.reason in VIOLATIONS else None)
        case RequestClosed():
            asked = state.asked.get(event.action_id)
            if asked is None:
                return _changed(state)
            executor, requester, capability, context = event.executed_by or asked[0], *asked[1:]
            of_executor = ((requester, executor, capability, context), {"success": True, "partial": None, "failure": False}[event.result])
            of_requester = ((executor, requester, capability, context), True) if event.result == "success" else None
            return _changed(_closed(state, event.action_id), of_executor, of_requester)
        case ExecutionFailed():
            asked = state.asked.get(event.action_id)
            return _changed(state, None if asked is None or asked[1] == event.robot else ((asked[1], event.robot, *asked[2:]), False))
        case AuthorityRevoked():
            if event.reason != "human override" or event.executed_by is None or event.capability is None:
                return _changed(state)
            return _changed(state, ((event.executed_by, event.requested_by, event.capability, event.context), False))
        case _:
            assert_never(event)


def _asking(state: Trust, action_id: str, asked: Asked) -> Trust:
    return msgspec.structs.replace(state, asked={**state.asked, action_id: asked}, judged=())


def _closed(state: Trust, action_id: str | None) -> Trust:
    return msgspec.structs.replace(state, asked={name: asked for name, asked in state.asked.items() if name != action_id})


def _changed(state: Trust, *results: tuple[Asked, bool | None] | None) -> Trust:
    """Each record with one more success or failure; None is neither, and ends the row of successes."""
    records = dict(state.records)
    judged: list[Key] = []
    for about, is_success in filter(None, results):
        key = _row(state, *about)
        judged.append(key)
        known = records.get(key, Record())
        records[key] = Record(known.successes + 1, 0) if is_success else Record(0, known.failures + (is_success is False))
    return msgspec.structs.replace(state, records=records, judged=tuple(judged))


def _row(state: Trust, robot: str, peer: str, capability: str, context: str | None) -> Key:
    """Where a result between the two counts: for the trust that holds there, be it that of the context or that of all of them."""
    entries = state.entries.get((robot, peer), {})
    is_of_context = (capability, context) in entries or ((None, context) in entries and (capability, None) not in entries)
    return robot, peer, capability, context if is_of_context else None
