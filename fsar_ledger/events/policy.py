"""Policy that is set by rule (`eq:policy`, `app:foundations`); the world opens and closes windows by itself."""

from .envelope import ActionId, Event, PolicyOutcome, PolicyScope, Principal, Principals, Robot, Subject, TaskId


class PolicyRuleSet(Event, frozen=True, kw_only=True):
    """P_i(e, sigma) is this from now on: of one robot (`local`) or of the fleet for it, None for every robot.

    Paper: app:foundations.

    For one `capability`, in one `context` (task), or (None) for all; the strictest rule that applies holds. A rule
    replaces the one with the same scope, robot, capability and context, and that of the robot's role
    (`RolePolicyRuleSet`). A fleet rule that says `allow` is a mandate: where the robot's own policy denies, the two
    conflict.
    """

    scope: PolicyScope
    robot: Robot | None
    capability: str | None
    context: str | None
    outcome: PolicyOutcome
    decided_by: Principal | None


class RolePolicyRuleSet(Event, frozen=True, kw_only=True):
    """Every robot of `role` has this rule from now on, also robots that join later.

    It is the robot's own (`local`) or the fleet's for it. They must be in the `domain` or below it; empty is the whole
    fleet. A rule about the very robot with the same scope, capability and context replaces it for that robot, stricter
    or not, and so does the role's rule of a smaller domain. Of what is left the strictest holds. Paper:
    app:foundations. Reading: R36.
    """

    scope: PolicyScope
    role: str
    outcome: PolicyOutcome
    domain: str = ""
    capability: str | None = None
    context: str | None = None
    decided_by: Principal | None = None


class PolicyConflictEscalated(Event, frozen=True):
    """The fleet mandates what the robot's own policy denies.

    Nothing is overridden; a supervisor is told. Paper: sec:architecture:fleet.
    """

    subject: Subject[TaskId | None, ActionId | None]
    principals: Principals
    capability: str
    local: PolicyOutcome
    fleet: PolicyOutcome


PolicyEvent = PolicyRuleSet | RolePolicyRuleSet | PolicyConflictEscalated
