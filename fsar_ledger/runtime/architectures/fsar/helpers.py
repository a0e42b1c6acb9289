"""FSAR: which robot may help with a failure or take the step over, or the reason why none may.

Paper: sec:model:recovery, levels 2 and 3.

The checks are those of any request: capability, visibility, presence, trust, authority, policy, then whether the robot
is free. Each check judges the robots left by the one before; the check that leaves none is the reason. All are asked at
once and answer for themselves. A robot that does not answer, because it is off or its link is down, cannot help, which
is known only when the answer time is over (R44). Only robots that rank before the chosen one are waited for.

Reading: a substitute is asked for its own capability, so its advertisement's terms count, and what holds of the step's
capability holds for it as well.
"""

from collections.abc import Iterable, Iterator
from typing import NamedTuple

from fsar_ledger.events import Event
from fsar_ledger.events.authority import AuthorityRevoked
from fsar_ledger.events.envelope import DEPARTED, PolicyOutcome, Robot
from fsar_ledger.events.recovery import AssistanceAdmitted
from fsar_ledger.events.registry import RegistryQueried
from fsar_ledger.projections.authority import Authority, right_of
from fsar_ledger.projections.execution import Action
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.recovery import Recovery
from fsar_ledger.projections.registry import NO_ANSWER, Advertisement, offered_in
from fsar_ledger.projections.trust import covers, scope_of
from fsar_ledger.projections.world import is_linked, stricter
from fsar_ledger.runtime.handlers.attribution import (
    family,
    helpers,
    is_idle,
    is_reachable,
    kin,
    means,
    recorded_by,
    stand_ins,
)
from fsar_ledger.runtime.handlers.candidates import Filter, Query, alike, rejecting_filter
from fsar_ledger.runtime.handlers.execution import NAVIGATION
from fsar_ledger.runtime.handlers.policy import compose, own_policy

_ALL = 6  # checks of a candidate (see `_first`)
ASSISTING_SCOPES = ("task", "session", "persistent")  # capability scope does not cover assistance


class HelperChoice(NamedTuple):
    """The helper, or the reason why there is none, and the silent robots that would rank before it."""

    robot: Robot | None
    reason: str
    silent: tuple[Robot, ...] = ()


class Candidate(NamedTuple):
    """A robot that could help, the capability that it would use, and the filter that excludes it.

    The capability is the step's own where the robot's body is enough.
    """

    robot: Robot
    capability: str
    left_out_by: Filter | None


# See docs/decisions/peer-recovery-composes-policies.md.
def peer(state: State, action: Action, recovery: Recovery) -> HelperChoice:
    """Return the nearest idle peer that can help, is trusted and is allowed to, among those not asked before.

    Its own policy and the asking robot's must both allow it.
    """
    if "shared-registry" in state.fleet.without:
        return HelperChoice(None, "no shared registry")
    if action.stage == "withdrawn":
        return HelperChoice(None, DEPARTED)
    candidates = _bodies(state, action) if recovery.cause == "obstruction" else _stand_ins(state, action, action.robot)
    return _first(
        state,
        action,
        action.robot,
        (candidate for candidate in candidates if candidate.robot not in recovery.tried),
        "peer",
    )


def agreed_to_help(state: State, action: Action, recovery: Recovery, helper: Robot) -> AssistanceAdmitted:
    """Return the event that admits the helper, which has agreed."""
    parties = recorded_by(state, helper, requested_by=action.requested_by, executed_by=action.executed_by)
    return AssistanceAdmitted(
        subject=action.subject,
        principals=parties.decided(helper),
        robot=action.robot,
        helper=helper,
        failure=recovery.failure,
        level="peer",
    )


def peer_query(state: State, action: Action, recovery: Recovery) -> tuple[Event, ...]:
    """Record the registry's answer on which peers have a capability of this kind; nothing for an obstruction.

    A robot whose capability of the kind does not cover what has failed is excluded by its contract.
    """
    is_asked = recovery.cause != "obstruction" and action.stage != "withdrawn"
    if not is_asked or "shared-registry" in state.fleet.without:
        return ()
    options = list(_stand_ins(state, action, action.robot))
    fit = tuple(dict.fromkeys(option.robot for option in options if option.left_out_by is None))
    accepted = set(fit)
    able = set(stand_ins(state.fleet, state.registry, action))
    kindred = kin(state.fleet, state.registry, action.robot, action.capability)
    left_out: dict[Robot, Filter] = {name: "contract" for name in kindred if name not in able}
    for option in options:
        if option.left_out_by is not None and option.robot not in accepted:
            left_out.setdefault(option.robot, option.left_out_by)
    return (
        RegistryQueried(
            subject=action.subject,
            principals=recorded_by(state, action.robot, requested_by=action.robot, executed_by=action.executed_by),
            capability=family(action.capability),
            candidates=fit,
            rejected=tuple(left_out),
            rejected_by=tuple(left_out.values()),
        ),
    )


def reassignee(state: State, action: Action) -> HelperChoice:
    """Return the nearest idle robot that may execute the step: able, trusted, and allowed by all three policies."""
    request = state.request.open.get(action.action_id)
    if action.capability == NAVIGATION or request is None:
        return HelperChoice(None, "the robot's own way")
    candidates = (
        candidate
        for candidate in _stand_ins(state, action, action.on_behalf_of)
        if candidate.robot != action.on_behalf_of
    )
    return _first(state, action, action.on_behalf_of, candidates, "robot", request.carried)


def _bodies(state: State, action: Action) -> Iterator[Candidate]:
    """Yield every other robot whose body could clear the way, which needs broader trust but no capability."""
    about = (action.capability, action.task_id)
    for name in helpers(state.fleet, state.registry, action, "obstruction"):
        is_trusted = scope_of(state.trust, name, action.robot, *about) in ASSISTING_SCOPES
        excluded_by: Filter | None = None if is_trusted else "trust"
        is_there = name not in state.fleet.departed and is_reachable(state.registry, name)
        yield Candidate(name, action.capability, excluded_by if is_there else "availability")


def _stand_ins(state: State, action: Action, asking: Robot) -> Iterator[Candidate]:
    """Yield every other robot with each capability that fits the step, as the registry would answer."""
    capabilities = means(state.fleet, action.capability)
    excluded_by: dict[tuple[Robot, str], Filter | None] = {}
    for capability in capabilities:
        for offered in offered_in(state.registry.offers, capability):
            for record, robots in alike(state, offered, asking):
                excluded_by.update(
                    dict.fromkeys(
                        [(robot, capability) for robot in robots], _left_out_by(state, action, asking, record)
                    )
                )
    for name in stand_ins(state.fleet, state.registry, action):
        for capability in capabilities:
            if (name, capability) in excluded_by:
                yield Candidate(name, capability, excluded_by[name, capability])


def _left_out_by(state: State, action: Action, asking: Robot, record: Advertisement) -> Filter | None:
    """Return the filter that excludes the record: presence before trust.

    Recovery keeps its trust gate in every configuration.
    """
    excluded_by = rejecting_filter(state, Query(asking, record.capability, action.task_id), record)
    if excluded_by == "visibility":
        return excluded_by
    if record.availability in ("offline", "restricted"):
        return "availability"
    scopes = (
        scope_of(state.trust, record.robot, asking, capability, action.task_id)
        for capability in (record.capability, action.capability)
    )
    return excluded_by if all(covers(scope, record.trust_required) for scope in scopes) else "trust"


def _first(
    state: State,
    action: Action,
    asking: Robot,
    candidates: Iterable[Candidate],
    kind: str,
    carried: PolicyOutcome | None = None,
) -> HelperChoice:
    """Return the nearest idle candidate that answers and passes every check, or the check that left none."""
    furthest = 0
    silent: dict[Robot, bool] = {}  # robots that do not answer, and whether nothing else leaves them out
    for candidate in candidates:
        if candidate.left_out_by in ("visibility", "availability"):
            continue
        if not is_linked(state.world, candidate.robot):
            silent[candidate.robot] = silent.get(candidate.robot, False) or candidate.left_out_by is None
            passed = 1
        else:
            passed = _passed_checks(state, action, asking, candidate, carried)
        if passed == _ALL:
            return HelperChoice(candidate.robot, "", tuple([robot for robot, is_fit in silent.items() if is_fit]))
        furthest = max(furthest, passed)
    reasons = (f"no capable {kind}", NO_ANSWER, f"no trusted {kind}", "authority", "policy", f"{kind} busy")
    return HelperChoice(None, reasons[furthest], tuple(silent))


def _passed_checks(
    state: State, action: Action, asking: Robot, candidate: Candidate, carried: PolicyOutcome | None
) -> int:
    """Return how many checks a candidate that answers passes, in the order of the reasons in `_first`."""
    if candidate.left_out_by == "trust":
        return 2
    if not _may_ask(state.authority, asking, candidate, action):
        return 3
    if candidate.left_out_by is not None or not _is_allowed(state, asking, candidate, action, carried):
        return 4
    return _ALL if is_idle(state.execution, candidate.robot) else 5


def _is_allowed(
    state: State, asking: Robot, candidate: Candidate, action: Action, carried: PolicyOutcome | None
) -> bool:
    """Return whether every policy allows it: the asking robot's, the carried one, the executor's and the fleet's."""
    for capability in {candidate.capability, action.capability}:
        about = (capability, action.task_id)
        asking_policy = own_policy(state.policy, state.world, asking, *about)
        outcome = (
            compose(state, asking_policy, candidate.robot, *about)
            if carried is None
            else stricter(asking_policy, compose(state, carried, candidate.robot, *about))
        )
        if outcome != "allow":
            return False
    return True


def _may_ask(authority: Authority, asking: Robot, candidate: Candidate, action: Action) -> bool:
    """Return whether the requester's right still stands; a failure lifts no revocation. Paper: sec:model:recovery."""
    rights = (
        right_of(authority, asking, candidate.robot, capability, action.task_id)
        for capability in {candidate.capability, action.capability}
    )
    return not any(isinstance(right, AuthorityRevoked) for right in rights)
