"""Policy set by rule (`eq:policy`, `app:foundations`); policy windows are the world's (`events/world.py`)."""

from .envelope import ActionId, Event, PolicyOutcome, PolicyScope, Principal, Principals, Robot, Subject, TaskId


class PolicyRuleSet(Event, frozen=True, kw_only=True):
    """P_i(e, sigma) has this outcome from now on: the robot's own (`local`) or the fleet's for it (`fleet`).

    Paper: app:foundations.

    None as robot means every robot. The rule applies to one `capability`, in one `context` (task), or (None) to all of
    them; the strictest applicable rule holds. It replaces the rule with the same scope, robot, capability and context,
    and that of the robot's role (`RolePolicyRuleSet`). A fleet rule of `allow` is a mandate: it conflicts with the
    robot's own policy where that denies.
    """

    scope: PolicyScope
    robot: Robot | None
    capability: str | None
    context: str | None
    outcome: PolicyOutcome
    decided_by: Principal | None


class RolePolicyRuleSet(Event, frozen=True, kw_only=True):
    """Every robot of `role` has this rule from now on, including robots that join later.

    The rule is the robot's own (`local`) or the fleet's for it. It covers robots in the `domain` or below it; empty is
    the whole fleet. A rule for one robot with the same scope, capability and context replaces it for that robot,
    stricter or not, and so does the role's rule in a smaller domain. Of the remaining rules the strictest holds. Paper:
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
