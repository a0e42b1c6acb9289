"""FSAR: who may help with a failure or take the step over, and if nobody may, why. Paper: sec:model:recovery, levels 2 and 3.

The checks are those of any request: who can and is there, trust, authority, policy, then whether the robot is free. What
remains after one is judged by the next; the check after which nobody remains is the reason.
"""

from collections.abc import Iterable

from fsar_ledger.events import Event
from fsar_ledger.events.authority import AuthorityRevoked
from fsar_ledger.events.registry import RegistryQueried
from fsar_ledger.projections.authority import right_of
from fsar_ledger.projections.execution import Action
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.recovery import Recovery
from fsar_ledger.projections.trust import scope_of
from fsar_ledger.projections.world import stricter
from fsar_ledger.runtime.handlers.attribution import family, helpers, is_idle, is_reachable, kin, on_shift, stand_ins
from fsar_ledger.runtime.handlers.execution import NAVIGATION
from fsar_ledger.runtime.handlers.policy import compose, own_policy

ASSISTING_SCOPES = ("task", "session", "persistent")  # capability scope does not cover assistance

Found = tuple[str | None, str]  # who, or why nobody


def peer(state: State, action: Action, recovery: Recovery) -> Found:
    """The nearest peer that can help, is trusted to, whose policy and the asking robot's allow it, and that is idle."""
    if state.fleet.configuration == "without-shared-registry":
        return None, "no shared registry"
    able = [name for name in helpers(state, action, recovery.cause) if is_reachable(state, name)]
    if not able:
        return None, "no capable peer"
    trusted = [name for name in able if _may_assist(state, name, action, recovery)]
    if not trusted:
        return None, "no trusted peer"
    entitled = [name for name in trusted if _may_ask(state, action.robot, name, action)]
    if not entitled:
        return None, "authority"
    asking = own_policy(state, action.robot, action.capability, action.task_id)
    willing = [name for name in entitled if compose(state, asking, name, action.capability, action.task_id) == "allow"]
    return _first_idle(state, willing, "policy", "peer busy")


def peer_query(state: State, action: Action, recovery: Recovery) -> tuple[Event, ...]:
    """The registry has answered which peers have a capability of this kind; an obstruction needs none, and is not asked about."""
    if recovery.cause == "obstruction" or state.fleet.configuration == "without-shared-registry":
        return ()
    able = [name for name in stand_ins(state, action) if is_reachable(state, name)]
    trusted = tuple(name for name in able if _may_assist(state, name, action, recovery))
    unfit = tuple(name for name in kin(state, action.robot, action.capability) if name not in able)
    distrusting = tuple(name for name in able if name not in trusted)
    away = [name for name in unfit if not is_reachable(state, name)]
    return (
        RegistryQueried(
            action.task_id,
            action.action_id,
            action.robot,
            action.executed_by,
            on_shift(state, action.robot),
            family(action.capability),
            trusted,
            rejected=unfit + distrusting,
            rejected_by=tuple("availability" if name in away else "contract" for name in unfit) + ("trust",) * len(distrusting),
        ),
    )


def _may_assist(state: State, name: str, action: Action, recovery: Recovery) -> bool:
    scope = scope_of(state.trust, name, action.robot, action.capability, action.task_id)
    return scope in ASSISTING_SCOPES if recovery.cause == "obstruction" else scope != "none"


def reassignee(state: State, action: Action) -> Found:
    """The nearest robot that may execute the step for whom it was: able, trusted, allowed by all three policies, and idle."""
    request = state.request.get(action.action_id)
    if action.capability == NAVIGATION or request is None:
        return None, "the robot's own way"
    able = [name for name in stand_ins(state, action) if name != action.on_behalf_of and is_reachable(state, name)]
    if not able:
        return None, "no capable robot"
    about = (action.capability, action.task_id)
    trusted = [name for name in able if scope_of(state.trust, name, action.on_behalf_of, *about) != "none"]  # recovery keeps its trust gate
    if not trusted:
        return None, "no trusted robot"
    entitled = [name for name in trusted if _may_ask(state, action.on_behalf_of, name, action)]
    if not entitled:
        return None, "authority"
    asking = own_policy(state, action.on_behalf_of, *about)
    willing = [name for name in entitled if stricter(asking, compose(state, request.carried, name, *about)) == "allow"]
    return _first_idle(state, willing, "policy", "robot busy")


def _may_ask(state: State, robot: str, name: str, action: Action) -> bool:
    """A revoked right stays revoked when something fails. Paper: sec:model:recovery."""
    return not isinstance(right_of(state.authority, robot, name, action.capability, action.task_id), AuthorityRevoked)


def _first_idle(state: State, willing: Iterable[str], nobody_willing: str, nobody_idle: str) -> Found:
    reason = nobody_willing
    for name in willing:
        if is_idle(state, name):
            return name, ""
        reason = nobody_idle
    return None, reason
