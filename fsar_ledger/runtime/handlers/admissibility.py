"""Whether a request is admissible, conjunct by conjunct, and the authority that it gives.

Paper: eq:admissible, eq:auth.

`evaluate` decides at arrival; `holding` decides again when the robot is about to start. Both are functions of the
state.
"""

from typing import Literal

import msgspec

from fsar_ledger.events.authority import AuthorityGranted, AuthorityRevoked
from fsar_ledger.events.envelope import OverrideLevel, PolicyOutcome, Robot, TrustScope
from fsar_ledger.projections.authority import Authority, Later, later_than, rank, right_of
from fsar_ledger.projections.execution import INTERRUPTING, Action, Execution, in_hand
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.policy import ruled, standing
from fsar_ledger.projections.registry import Registry, advertisement, possesses
from fsar_ledger.projections.request import Request
from fsar_ledger.projections.supervision import density
from fsar_ledger.projections.trust import covers, scope_of
from fsar_ledger.projections.world import stricter

from .attribution import is_idle
from .candidates import hides
from .policy import compose, fleet_policy, is_ruled_out, own_policy

Conjunct = Literal["possession", "advertisement", "trust", "policy", "local-execution", "authority"]
Verdict = Literal["accept", "defer", "negotiate", "review", "reject"]
PREEMPTIBLE = (
    "queued",
    "approaching",
    "held",
    "polling",
    "running",
    "paused",
)  # recovery and assistance are not interrupted


class Evaluation(msgspec.Struct, frozen=True, gc=False):
    """The executor's verdict, the conjunct that failed if one did, and the authority tuple of `eq:auth`.

    `override` is the level that is in effect if the request is admitted, in a negotiation the highest that is offered;
    `trust` the scope that the request rests on (None: trust is not evaluated).
    """

    verdict: Verdict
    conjunct: Conjunct | None
    trust: TrustScope | None
    may_request: bool
    may_execute: bool
    override: OverrideLevel
    is_audited: bool = True


def evaluate(state: State, request: Request, executor: Robot, is_reviewed: bool = False) -> Evaluation:
    """Judge the five conjuncts in the paper's order, then authority. Paper: eq:admissible.

    The approval of a reviewed request lifts reviews but no denial: a rule that denies by then stands, and an open
    window of the executor's own that denies holds the start. A request through a relay rests on the executor's trust
    in the relay: each link is judged by itself. A revocation of the requester's own right still counts.
    """
    about = (request.capability, request.task_id)
    if is_reviewed:
        outcome: PolicyOutcome = "deny" if is_ruled_out(state, request.carried, executor, *about) else "allow"
    else:
        outcome = compose(state, request.carried, executor, *about)
    is_blind = "trust-evaluation" in state.fleet.without
    trust = None if is_blind else scope_of(state.trust, executor, asker(request), *about)
    conjunct = failing(state, request, executor, trust, outcome)
    if conjunct is not None:
        return Evaluation("reject", conjunct, trust, conjunct not in ("trust", "authority"), False, "none")
    level: OverrideLevel = "none"
    if request.override != "none":
        level = override_asked(state.authority, request, executor)
        allowed = override_allowed(state.authority, state.registry, request, executor)
        if rank(level) > rank(allowed):
            return Evaluation("negotiate", None, trust, True, False, allowed)
    if outcome == "review":
        return Evaluation("review", None, trust, True, False, level)
    is_free = is_idle(state.execution, executor) or preemptible(state.execution, executor, level) is not None
    return Evaluation("accept" if is_free else "defer", None, trust, True, True, level)


def was_reviewed(state: State, request: Request, executor: Robot) -> bool:
    """Return whether the review for which a declared rule or the supervision density asks was approved.

    What a window alone asks for is asked again as long as it is open.
    """
    if request.action_id not in state.supervision.approved:
        return False
    about = (request.capability, request.task_id)
    rules = (
        standing(state.policy, "local", request.requester, *about),
        standing(state.policy, "local", executor, *about),
        standing(state.policy, "fleet", executor, *about),
    )
    return "review" in rules or density(state.supervision, executor) > 0


def asker(request: Request) -> Robot:
    """Return the robot that addresses the executor: the relay, or the requester itself. Paper: eq:nontransitive."""
    return request.relay or request.requester


def failing(
    state: State, request: Request, executor: Robot, trust: TrustScope | None, outcome: PolicyOutcome
) -> Conjunct | None:
    """Return the first conjunct that fails, or None.

    `trust` is the executor's in the asker, `outcome` the composed policy. Paper: eq:admissible.
    """
    if not possesses(state.registry, executor, request.capability):
        return "possession"
    record = advertisement(state.registry, executor, request.capability)
    if (
        record is None
        or hides(state, record, request.requester, asker(request), request.task_id)
        or request.version not in (None, record.version)
    ):
        return "advertisement"
    if trust is not None and not covers(trust, record.trust_required):
        return "trust"
    if outcome == "deny" or (record.policy_required and request.task_id not in record.policy_required):
        return "policy"
    if request.directives or record.availability in ("offline", "restricted"):
        return "local-execution"
    if request.task_id in state.context or is_revoked(state.authority, request, executor):
        return "authority"
    return None


def is_revoked(authority: Authority, request: Request, executor: Robot) -> bool:
    """Return whether the requester, or the relay that asks for it, may no longer ask this of the executor.

    Paper: sec:model:authority.
    """
    if not authority.rights:
        return False
    about = (executor, request.capability, request.task_id)
    return any(
        isinstance(right_of(authority, robot, *about), AuthorityRevoked)
        for robot in {request.requester, asker(request)}
    )


def override_asked(authority: Authority, request: Request, executor: Robot) -> OverrideLevel:
    """Return the level that the request asks for; emergency-only without a supervisor's grant is none.

    Paper: eq:override.
    """
    if request.override != "emergency-only":
        return request.override
    right = right_of(authority, request.requester, executor, request.capability, request.task_id)
    return "emergency-only" if isinstance(right, AuthorityGranted) and right.override == "emergency-only" else "none"


def override_allowed(authority: Authority, registry: Registry, request: Request, executor: Robot) -> OverrideLevel:
    """Return the highest level that the executor's advertisement, and a grant if there is one, allows.

    Paper: eq:override, eq:adv.
    """
    record = advertisement(registry, executor, request.capability)
    allowed: OverrideLevel = "none" if record is None else record.override_allowed
    right = right_of(authority, request.requester, executor, request.capability, request.task_id)
    return min(allowed, right.override, key=rank) if isinstance(right, AuthorityGranted) else allowed


def preemptible(execution: Execution, robot: Robot, override: OverrideLevel) -> Action | None:
    """Return the action that a request of this level takes the robot from, or None. Paper: eq:override."""
    action = in_hand(execution, robot)
    if (
        action is None
        or action.stage not in PREEMPTIBLE
        or rank(override) < INTERRUPTING
        or rank(action.override) >= rank(override)
    ):
        return None
    return action


def holding(state: State, action: Action) -> tuple[PolicyOutcome, PolicyOutcome]:
    """Return the outcomes of the executor's own policy and the fleet's rule, as last heard, for a start now.

    An approval lifts the reviews known when it was given. Paper: eq:policy, sec:architecture:fleet (never a silent
    override).
    """
    about = (action.robot, action.capability, action.task_id)
    local, fleet = own_policy(state.policy, state.world, *about), fleet_policy(state.knowledge, state.policy, *about)
    later = later_than(state.authority, action.action_id)
    if later is None:
        return local, fleet
    local_later, fleet_later = _came_later(state, action, later)
    return local if local == "deny" else local_later, fleet if fleet == "deny" else fleet_later


def _came_later(state: State, action: Action, later: Later) -> tuple[PolicyOutcome, PolicyOutcome]:
    """Compose only the executor's own policy and the fleet's rule from after the approval."""
    about = (action.robot, action.capability, action.task_id)
    local = ruled(state.policy, "local", *about, among=later.rules) or "allow"
    for window, outcome in state.world.local.get(action.robot, ()):
        if window in later.windows:
            local = stricter(local, outcome)
    heard = state.knowledge.fleet_rule.get(action.robot, "allow") if action.robot in later.heard else "allow"
    return local, stricter(heard, ruled(state.policy, "fleet", *about, among=later.rules) or "allow")
