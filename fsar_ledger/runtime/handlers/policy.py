"""Which policy holds for an action, and what several policies compose to. Paper: eq:policy, app:foundations."""

from typing import get_args

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import POLICY, Parties, PolicyOutcome, PolicyScope, Robot, Subject, Supervisor
from fsar_ledger.events.policy import PolicyConflictEscalated, PolicyRuleSet, RolePolicyRuleSet
from fsar_ledger.projections.fleet import Fleet
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.knowledge import Knowledge
from fsar_ledger.projections.policy import Policy, ruled, standing
from fsar_ledger.projections.world import World, in_force, stricter

from .commands import Handlers
from .public import (
    PublicCommand,
    carried_out,
    made_from,
    not_for_roles,
    not_in_charge,
    unknown_about,
    unknown_robot,
    unknown_word,
)
from .supervision import supervisor_for

HANDLERS = Handlers()


class SetPolicyRule(PublicCommand):
    """Set a rule of one robot's own (`local`), or the fleet's rule for it or (None) for every robot."""

    issued_by: Supervisor
    scope: PolicyScope
    robot: Robot | None
    capability: str | None
    context: str | None
    outcome: PolicyOutcome


class SetRolePolicyRule(PublicCommand):
    """Set the fleet's rule for every robot of the role, in a domain or (empty) in the whole fleet."""

    issued_by: Supervisor
    role: str
    outcome: PolicyOutcome
    domain: str = ""
    capability: str | None = None
    context: str | None = None


def own_policy(
    policy: Policy, world: World, robot: Robot, capability: str | None, context: str | None
) -> PolicyOutcome:
    """Return P_i(e, sigma): the strictest of the robot's open windows and of its rules. Paper: app:foundations."""
    return stricter(in_force(world.local, robot), standing(policy, "local", robot, capability, context))


def fleet_policy(
    knowledge: Knowledge, policy: Policy, robot: Robot, capability: str | None, context: str | None
) -> PolicyOutcome:
    """Return the strictest of the fleet's rules for the robot and the rule for its zone as last heard."""
    heard = knowledge.fleet_rule.get(robot, "allow")
    return stricter(heard, standing(policy, "fleet", robot, capability, context))


def compose(
    state: State, carried: PolicyOutcome, executor: Robot, capability: str, context: str | None
) -> PolicyOutcome:
    """Compose Pi: the requester's policy as carried by the request, the executor's own and the fleet's.

    Without policy composition, the executor's own alone counts: the ablation removes composition between robots, so a
    robot's own steps and routine keep the fleet's rule. Paper: eq:policy.
    """
    local = own_policy(state.policy, state.world, executor, capability, context)
    # See docs/decisions/own-steps-keep-the-fleet-rule.md.
    if "policy-composition" in state.fleet.without:
        return local
    return stricter(
        carried, stricter(local, fleet_policy(state.knowledge, state.policy, executor, capability, context))
    )


def is_ruled_out(state: State, carried: PolicyOutcome, executor: Robot, capability: str, context: str | None) -> bool:
    """Return whether a rule, of the executor or the fleet, or the requester's policy denies.

    An open window of the executor's own is no rule.
    """
    local = ruled(state.policy, "local", executor, capability, context)
    if "policy-composition" in state.fleet.without:
        return local == "deny"
    return "deny" in (local, carried, fleet_policy(state.knowledge, state.policy, executor, capability, context))


def conflict(
    state: State, task_id: str | None, action_id: str | None, requester: Robot | None, executor: Robot, capability: str
) -> tuple[PolicyConflictEscalated, ...]:
    """Return the escalation when the fleet mandates what the executor's own policy denies; the denial stands.

    Paper: sec:architecture:fleet.
    """
    is_uncomposed = "policy-composition" in state.fleet.without and requester != executor
    if is_uncomposed or ruled(state.policy, "fleet", executor, capability, task_id) is None:
        return ()
    local = own_policy(state.policy, state.world, executor, capability, task_id)
    fleet = fleet_policy(state.knowledge, state.policy, executor, capability, task_id)
    if (local, fleet) != ("deny", "allow"):
        return ()
    supervisor = supervisor_for(state, executor, is_cross_robot=requester != executor)
    return (
        PolicyConflictEscalated(
            Subject(task_id, action_id),
            Parties(requested_by=requester, executed_by=executor, supervised_by=supervisor).decided(POLICY),
            capability,
            local,
            fleet,
        ),
    )


@HANDLERS.decide(SetPolicyRule)
def set_policy_rule(state: State, command: SetPolicyRule) -> tuple[Event, ...]:
    """Set the rule: a robot's own by its own supervisor alone, the fleet's by H_F alone. Paper: app:foundations."""
    refused = unknown_robot(state.fleet, command.robot) or unknown_about(state, command) or _unfit(state.fleet, command)
    event = made_from(PolicyRuleSet, command, decided_by=command.issued_by)
    return carried_out(command, command.robot or "fleet", refused, command.issued_by, event)


@HANDLERS.decide(SetRolePolicyRule)
def set_role_policy_rule(state: State, command: SetRolePolicyRule) -> tuple[Event, ...]:
    """Set the fleet's rule for the robots of the role.

    A rule for a robot by name takes precedence. Paper: app:foundations.
    """
    refused = not_for_roles(state, command.issued_by, command.domain, command.role) or unknown_about(state, command)
    refused = refused or unknown_word("outcome", command.outcome, get_args(PolicyOutcome))
    event = made_from(RolePolicyRuleSet, command, scope="fleet", decided_by=command.issued_by)
    return carried_out(command, command.role, refused, command.issued_by, event)


def _unfit(fleet: Fleet, command: SetPolicyRule) -> str | None:
    """Return why the supervisor may not set this rule, or why no such rule exists, or None."""
    if command.scope not in get_args(PolicyScope) or command.outcome not in get_args(PolicyOutcome):
        return f"found {command.scope} {command.outcome}, expected local or fleet, and allow, deny or review"
    if command.scope == "fleet":
        return not_in_charge(fleet, command.issued_by, None, is_fleet_matter=True)
    if command.robot is None:
        return "a local rule of no robot, expected a robot; what holds for every robot is the fleet's"
    refused = not_in_charge(fleet, command.issued_by, command.robot)
    supervisor = fleet.robots[command.robot].supervisor
    if refused is None and supervisor is not None and supervisor != command.issued_by:
        return (
            f"{command.issued_by} does not set {command.robot}'s own policy, "
            f"expected {supervisor}; a fleet rule composes with it"
        )
    return refused
