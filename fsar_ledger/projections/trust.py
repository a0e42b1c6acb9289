"""Trust scopes between robots, and the record of results by which trust can move. Paper: eq:trust."""

from collections.abc import Iterator, Mapping
from typing import assert_never

import msgspec
from msgspec.structs import replace

from fsar_ledger.events.authority import AuthorityRevoked
from fsar_ledger.events.envelope import DEPARTED, Robot, TrustScope, recorded_robot
from fsar_ledger.events.execution import ExecutionFailed
from fsar_ledger.events.fleet import RobotJoined
from fsar_ledger.events.request import RequestClosed, RequestDenied, RequestIssued
from fsar_ledger.events.trust import InitialTrustSet, RoleTrustSet, TrustSet, TrustThresholdsSet
from fsar_ledger.events.world import OutsiderRequestInjected

from . import put, without

Result = RequestIssued | OutsiderRequestInjected | RequestDenied | RequestClosed | ExecutionFailed | AuthorityRevoked
HANDLES = RobotJoined | TrustSet | RoleTrustSet | InitialTrustSet | TrustThresholdsSet | Result

SCOPES: tuple[TrustScope, ...] = ("none", "capability", "task", "session", "persistent")  # from narrow to broad
VIOLATIONS = ("trust", "authority", "advertisement")  # refusals that are the requester's fault
About = tuple[str | None, str | None]  # capability, context; None: all of them
Entries = dict[About, TrustScope]
Member = tuple[str, str]  # role, domain
RequestKey = tuple[Robot, Robot, str, str | None]  # executor, requester, capability, context
Key = tuple[Robot, Robot, str, str | None]  # robot, peer, capability, and the context if trust is set for that one


class Record(msgspec.Struct, frozen=True, gc=False):
    """Consecutive results: a success resets the count of failures, a failure the count of successes."""

    successes: int = 0
    failures: int = 0


class Trust(msgspec.Struct, frozen=True, gc=False):
    """The trust between robots, and the results that each has had with the other.

    `entries`: (robot, peer) -> capability and context -> scope, for single pairs; `of_roles`: (role, role of the peer,
    domain) -> the same, for all robots of the roles; `initial`: robot that joined the running fleet, and whether it
    trusts or is trusted -> scope without any entry; `members`: robot -> its role and domain; `promote_after`,
    `downgrade_after`: consecutive results, 0 is never; `contexts`: those that some entry is limited to. Only while a
    threshold is set, `asked`: action -> open direct request; `records`: results of the peer as the robot saw them, by
    what its trust is set for; `judged`: the records that the last result changed.
    """

    entries: Mapping[tuple[Robot, Robot], Entries] = {}
    of_roles: dict[tuple[str, str, str], Entries] = {}
    initial: dict[tuple[Robot, bool], TrustScope] = {}
    members: Mapping[Robot, Member] = {}
    promote_after: int = 0
    downgrade_after: int = 0
    contexts: frozenset[str] = frozenset()
    asked: Mapping[str, RequestKey] = {}
    records: Mapping[Key, Record] = {}
    judged: tuple[Key, ...] = ()


INITIAL = Trust()


def scope_of(
    state: Trust, robot: Robot, peer: Robot, capability: str | None = None, context: str | None = None
) -> TrustScope:
    """Return how far the robot trusts the peer, by the most specific entry; `none` if there is no entry."""
    return _holding(state, robot, peer, capability, context)[1]


def _holding(
    state: Trust, robot: Robot, peer: Robot, capability: str | None, context: str | None
) -> tuple[About, TrustScope]:
    """Return the capability and context of the entry that holds between the two, and its scope.

    Entries for the pair come first, then those for their roles in the smallest domain, then the initial trust of a
    robot that joined later, the last one set.
    """
    # See docs/decisions/trust-and-rules-are-by-role.md.
    entries = state.entries.get((robot, peer))
    if entries is not None and (match := _most_specific(entries, capability, context)) is not None:
        return match
    if (state.of_roles or state.initial) and robot in state.members and peer in state.members:
        (role, domain), (peer_role, peer_domain) = state.members[robot], state.members[peer]
        for shared in (name for name in around(domain) if is_within(peer_domain, name)):
            entries = state.of_roles.get((role, peer_role, shared))
            if entries is not None and (match := _most_specific(entries, capability, context)) is not None:
                return match
        for key in tuple(state.initial)[::-1]:
            if key in ((robot, True), (peer, False)):
                return (None, None), state.initial[key]
    return (None, None), "none"


def _most_specific(entries: Entries, capability: str | None, context: str | None) -> tuple[About, TrustScope] | None:
    for about in ((capability, context), (capability, None), (None, context), (None, None)):
        if about in entries:
            return about, entries[about]
    return None


def around(domain: str) -> Iterator[str]:
    """Yield the domain and those that enclose it, the smallest first, the whole fleet last."""
    while domain:
        yield domain
        domain = domain.rpartition("/")[0]
    yield ""


def is_within(domain: str, other: str) -> bool:
    """Return whether the domain is the other one or lies below it; the empty domain, the fleet's, contains all."""
    return other in ("", domain) or domain.startswith(other + "/")


def covers(scope: TrustScope, required: TrustScope) -> bool:
    """Return whether the scope is at least as broad as the required one; `none` covers nothing."""
    return scope != "none" and SCOPES.index(scope) >= SCOPES.index(required)


def follows_record(state: Trust) -> bool:
    """Return whether trust moves with the record of results."""
    return state.promote_after > 0 or state.downgrade_after > 0


def evolve(state: Trust, event: HANDLES) -> Trust:
    """Return trust after the event."""
    match event:
        case RobotJoined():
            return replace(state, members=put(state.members, event.robot, (event.role, event.domain)))
        case TrustSet():
            pair = (event.robot, event.peer)
            entries = put(
                state.entries, pair, {**state.entries.get(pair, {}), (event.capability, event.context): event.scope}
            )
            return _set(replace(state, entries=entries), event)
        case RoleTrustSet():
            roles = (event.role, event.peer_role, event.domain)
            of_roles = {
                **state.of_roles,
                roles: {**state.of_roles.get(roles, {}), (event.capability, event.context): event.scope},
            }
            return _set(replace(state, of_roles=of_roles), event)
        case InitialTrustSet():
            key = (event.robot, event.is_trusting)
            others = {pair: scope for pair, scope in state.initial.items() if pair != key}
            return replace(state, initial={**others, key: event.scope})
        case TrustThresholdsSet():
            if not event.promote_after and not event.downgrade_after:
                return Trust(state.entries, state.of_roles, state.initial, state.members, contexts=state.contexts)
            return replace(state, promote_after=event.promote_after, downgrade_after=event.downgrade_after, judged=())
        case _:
            return _noted(state, event) if follows_record(state) else state


def _set(state: Trust, event: TrustSet | RoleTrustSet) -> Trust:
    """Return trust with the new entry's context, and without the records of results that the entry concerns."""
    contexts = state.contexts if event.context is None else state.contexts | {event.context}
    if not state.records:
        return replace(state, contexts=contexts)
    records = {
        key: record
        for key, record in state.records.items()
        if event.capability not in (None, key[2])
        or event.context != key[3]
        or not is_about(state, event, key[0], key[1])
    }
    return replace(state, contexts=contexts, records=records)


def is_about(state: Trust, event: TrustSet | RoleTrustSet, robot: Robot, peer: Robot) -> bool:
    """Return whether the entry concerns the trust of this robot in this peer."""
    if isinstance(event, TrustSet):
        return (event.robot, event.peer) == (robot, peer)
    if robot not in state.members or peer not in state.members:
        return False
    (role, domain), (peer_role, peer_domain) = state.members[robot], state.members[peer]
    return (
        (event.role, event.peer_role) == (role, peer_role)
        and is_within(domain, event.domain)
        and is_within(peer_domain, event.domain)
    )


def _noted(state: Trust, event: Result) -> Trust:
    """Return trust with the result on record. Paper: sec:model:trust (performance history, failures)."""
    match event:
        case RequestIssued():
            if (
                event.subject.action_id is None
                or event.principals.requested_by is None
                or event.principals.executed_by is None
                or event.relay is not None
            ):
                return state  # a request that needs a relay has no direct trust that could move
            return _asking(
                state,
                event.subject.action_id,
                (
                    event.principals.executed_by,
                    recorded_robot(event.principals.requested_by),
                    event.capability,
                    event.subject.task_id,
                ),
            )
        case OutsiderRequestInjected():
            return _asking(state, event.task_id, (event.peer, event.robot, event.capability, event.task_id))
        case RequestDenied():
            key = state.asked.get(event.subject.action_id or "")
            return _changed(
                _closed(state, event.subject.action_id),
                (key, False) if key is not None and event.reason in VIOLATIONS else None,
            )
        case RequestClosed() if event.cause == DEPARTED:  # leaving is not a bad result
            return _changed(_closed(state, event.subject.action_id))
        case RequestClosed():
            key = state.asked.get(event.subject.action_id)
            if key is None:
                return _changed(state)
            executor, requester, capability, context = event.principals.executed_by or key[0], *key[1:]
            of_executor = (
                (requester, executor, capability, context),
                {"success": True, "partial": None, "failure": False}[event.result],
            )
            of_requester = ((executor, requester, capability, context), True) if event.result == "success" else None
            return _changed(_closed(state, event.subject.action_id), of_executor, of_requester)
        case ExecutionFailed():
            key = None if event.cause == DEPARTED else state.asked.get(event.subject.action_id)
            return _changed(
                state,
                None if key is None or key[1] == event.robot else ((key[1], event.robot, *key[2:]), False),
            )
        case AuthorityRevoked():
            if event.reason != "human override" or event.executed_by is None or event.capability is None:
                return _changed(state)
            return _changed(state, ((event.executed_by, event.requested_by, event.capability, event.context), False))
        case _:
            assert_never(event)


def _asking(state: Trust, action_id: str, key: RequestKey) -> Trust:
    return replace(state, asked=put(state.asked, action_id, key), judged=())


def _closed(state: Trust, action_id: str | None) -> Trust:
    return state if action_id is None else replace(state, asked=without(state.asked, action_id))


def _changed(state: Trust, *results: tuple[RequestKey, bool | None] | None) -> Trust:
    """Return trust with these results counted; None is neither success nor failure, and resets the successes."""
    records = state.records
    judged: list[Key] = []
    for about, is_success in filter(None, results):
        key = _row(state, *about)
        judged.append(key)
        record = records.get(key, Record())
        updated = Record(record.successes + 1, 0) if is_success else Record(0, record.failures + (is_success is False))
        records = put(records, key, updated)
    return replace(state, records=records, judged=tuple(judged))


def _row(state: Trust, robot: Robot, peer: Robot, capability: str, context: str | None) -> Key:
    """Return the key of the record in which a result between the two counts.

    Its context is that of the trust entry that holds: the given one, or None for all.
    """
    (_, of_context), _ = _holding(state, robot, peer, capability, context)
    return robot, peer, capability, of_context
