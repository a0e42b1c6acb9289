"""FSAR: the executing robot decides when; its own steps and routine need no other. Paper: sec:architecture:local."""

from fsar_ledger.events import Event
from fsar_ledger.events.authority import AuthorityClaimed
from fsar_ledger.events.envelope import (
    FLEET_SUPERVISOR,
    POLICY,
    Parties,
    PolicyOutcome,
    Principal,
    Principals,
    RequestSubject,
    Robot,
    Supervisor,
)
from fsar_ledger.events.execution import (
    ApproachStarted,
    ExecutionHeld,
    ExecutionPaused,
    ExecutionWithdrawn,
    OwnStepDecided,
    RoutinePerformed,
    RoutineWithheld,
)
from fsar_ledger.events.knowledge import FleetRuleLearned
from fsar_ledger.events.policy import PolicyRuleSet, RolePolicyRuleSet
from fsar_ledger.events.request import RequestAccepted, RequestDenied
from fsar_ledger.events.supervision import SupervisorCalled, SupervisorResponded
from fsar_ledger.events.task import StepBegan
from fsar_ledger.events.world import ContextChanged, PolicyWindowClosed, PolicyWindowOpened
from fsar_ledger.projections.execution import Action, Execution, in_hand
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.policy import standing
from fsar_ledger.projections.request import Request
from fsar_ledger.projections.supervision import is_asked
from fsar_ledger.projections.world import in_force, stricter
from fsar_ledger.runtime.handlers.admissibility import holding
from fsar_ledger.runtime.handlers.attribution import recorded_by, supervisor_of
from fsar_ledger.runtime.handlers.authority import release
from fsar_ledger.runtime.handlers.commands import (
    ActionCommand,
    DecideRoutine,
    Handlers,
    RobotCommand,
    Scheduled,
    StartAction,
    TakeTurn,
    at_once,
    body,
    commanded_robot,
    known_action,
    message,
    open_request,
    requester,
)
from fsar_ledger.runtime.handlers.execution import (
    holds_robot,
    pause_running,
    queued,
    resume_when_replanned,
    start_action,
    started,
)
from fsar_ledger.runtime.handlers.policy import conflict, fleet_policy, own_policy
from fsar_ledger.runtime.handlers.supervision import supervisor_for

HANDLERS = Handlers()


class DecideOwnStep(ActionCommand):
    """Decide about a step of the robot's own."""


class RefuseHeld(ActionCommand):
    """Refuse a request that was admitted and held, since its review was not approved."""


class LearnFleetRule(RobotCommand):
    """Deliver the fleet's rule to the robot."""

    outcome: PolicyOutcome
    as_of_us: int


@HANDLERS.decide_on(open_request, DecideOwnStep, requester)
def decide_own_step(state: State, _command: DecideOwnStep, request: Request) -> tuple[Event, ...]:
    """Decide to do the step, and queue it at the robot itself."""
    robot = request.requester
    parties = recorded_by(state, robot, requested_by=robot, executed_by=robot)
    decided = OwnStepDecided(request.subject, parties.decided(robot), request.capability)
    return (decided, queued(request, parties, robot))


def ready(execution: Execution, command: StartAction) -> Action | None:
    """Return the action if it holds its robot and can be started, else None."""
    action = execution.actions.get(command.action_id)
    stages = ("held", "polling") if command.was_held else ("queued", "approaching", "held", "polling", "preempted")
    if (
        action is None
        or action.stage not in stages
        or not holds_robot(execution, action)
        or (action.stage == "preempted" and action.has_approach)  # the robot has to return first
    ):
        return None
    return action


@HANDLERS.decide_on(known_action, TakeTurn, body)
def take_turn(state: State, _command: TakeTurn, action: Action) -> tuple[Event, ...]:
    """Accept the request, claim execution and override, and approach.

    A request that was preempted comes back as accepted. Paper: eq:auth.
    """
    if action.stage not in ("queued", "preempted") or not holds_robot(state.execution, action):
        return ()
    robot = action.robot
    approach = ApproachStarted(action.subject, robot)
    if any(
        claim.claimant == robot and claim.dimension == "execution"
        for claim in state.authority.claims.get(action.action_id, ())
    ):
        return (approach,)
    parties, fence = _own_parties(state, action), state.fleet.fences.get(robot)
    return (
        RequestAccepted(RequestSubject(action.task_id, action.action_id, action.action_id), parties.decided(robot)),
        AuthorityClaimed(
            subject=action.subject, dimension="execution", claimant=robot, reason="acceptance", fence=fence
        ),
        AuthorityClaimed(
            subject=action.subject, dimension="override", claimant=robot, reason="acceptance", fence=fence
        ),
        approach,
    )


def _own_parties(state: State, action: Action) -> Parties:
    """Return the parties of the robot's own record of the action."""
    return recorded_by(state, action.robot, requested_by=action.requested_by, executed_by=action.robot)


@HANDLERS.decide(StartAction, body)
def start(state: State, command: StartAction) -> tuple[Event, ...]:
    """Start the action, unless the robot's own policy or the fleet's rule, as last heard, holds it.

    A declared rule of review calls a supervisor. An approval lifts only the reviews known then. If the fleet mandates
    what is held here, the conflict is escalated.

    Paper: sec:model:invariants (I3), sec:architecture:fleet (never a silent override). Reading: R34.
    """
    action = ready(state.execution, command)
    if action is None:
        return ()
    return start_under(state, action, command, *_holding(state, action))


def start_under(
    state: State, action: Action, command: StartAction, local: PolicyOutcome, rule: PolicyOutcome
) -> tuple[Event, ...]:
    """Start the action, or hold it if the robot's own policy or the fleet's rule requires it."""
    if stricter(local, rule) == "review":
        reviewer = _reviewer(state, action, local, rule)
        if reviewer is not None:
            return _put_before(state, action, reviewer, "local-policy" if local == "review" else "fleet-rule")
    if rule == "deny" and local == "review" and _reviewer(state, action, local, "allow") is not None:
        return (_hold_event(state, action, rule, "fleet-rule", None),)  # reviewed once the fleet's denial is over
    if local != "allow":
        # See docs/decisions/denials-are-decided-once.md.
        decided_by = None if action.is_delegated or action.was_denied else action.robot
        clash = conflict(state, action.task_id, action.action_id, action.on_behalf_of, action.robot, action.capability)
        return (*clash, _hold_event(state, action, local, "local-policy", decided_by))
    if rule != "allow":
        return (_hold_event(state, action, rule, "fleet-rule", None),)
    return (started(state, action, command),)


# See docs/decisions/policy-is-composed-again-at-the-start.md.
def _holding(state: State, action: Action) -> tuple[PolicyOutcome, PolicyOutcome]:
    """Return what holds the action now: the robot's own policy, and the fleet's rule where it is composed."""
    local, rule = holding(state, action)
    is_uncomposed = action.is_delegated and "policy-composition" in state.fleet.without
    return local, "allow" if is_uncomposed else rule


@HANDLERS.decide_on(known_action, RefuseHeld, body)
def refuse_held(state: State, _command: RefuseHeld, action: Action) -> tuple[Event, ...]:
    """End the claims, withdraw the action and deny the request, as at its admission. Reading: R34."""
    if action.stage not in ("held", "polling"):
        return ()
    robot, subject = action.robot, RequestSubject(action.task_id, action.action_id, action.action_id)
    parties = _own_parties(state, action)
    return (
        *release(state.authority, action.action_id),
        ExecutionWithdrawn(action.subject, robot),
        RequestDenied(subject, parties.decided(robot), "review"),
    )


def _reviewer(state: State, action: Action, local: PolicyOutcome, rule: PolicyOutcome) -> Supervisor | None:
    """Return the supervisor who reviews the action under a declared rule, or None if only a window asks for review.

    H_i for the robot's own step and own rule if one is on shift, else H_F. A window closes by itself; a rule
    does not. Paper: sec:model:supervision, app:foundations.
    """
    about = (action.robot, action.capability, action.task_id)
    if local == "review" and standing(state.policy, "local", *about) == "review":
        return supervisor_for(state, action.robot, is_cross_robot=action.is_delegated)
    if rule == "review" and standing(state.policy, "fleet", *about) == "review":
        return FLEET_SUPERVISOR
    return None


def _put_before(state: State, action: Action, reviewer: Supervisor, reason: str) -> tuple[Event, ...]:
    """Hold the action, and call the supervisor once."""
    if is_asked(state.supervision, action.action_id, "review"):
        return ()
    call = SupervisorCalled(subject=action.subject, supervisor=reviewer, purpose="review", robot=action.robot)
    return (_hold_event(state, action, "review", reason, None), call)


def _hold_event(
    state: State, action: Action, outcome: PolicyOutcome, reason: str, decided_by: Principal | None
) -> ExecutionHeld:
    principals = Principals(
        decided_by=decided_by,
        requested_by=action.requested_by,
        executed_by=action.executed_by,
        supervised_by=supervisor_of(state, action),
        path=() if decided_by is None else (decided_by,),
    )
    return ExecutionHeld(action.subject, principals, action.robot, outcome, reason)


@HANDLERS.decide(DecideRoutine, commanded_robot)
def decide_routine(state: State, command: DecideRoutine) -> tuple[Event, ...]:
    """Perform the routine operation; a motion only if the robot's policy and the fleet's rule are clear."""
    robot = command.robot
    parties = recorded_by(state, robot, requested_by=robot, executed_by=robot)
    principals = parties.decided(robot)
    if command.operation == "motion" and (
        own_policy(state.policy, state.world, robot, None, None) != "allow"
        or fleet_policy(state.knowledge, state.policy, robot, None, None) != "allow"
    ):
        return (RoutineWithheld(principals, robot, command.operation),)
    return (RoutinePerformed(principals, robot, command.operation),)


@HANDLERS.decide(LearnFleetRule, commanded_robot)
def learn_fleet_rule(state: State, command: LearnFleetRule) -> tuple[Event, ...]:
    """Record the rule at the robot, unless a newer message has overtaken this one."""
    if command.as_of_us < state.knowledge.fleet_rule_as_of_us.get(command.robot, 0):
        return ()
    return (FleetRuleLearned(command.robot, command.outcome, command.as_of_us),)


@HANDLERS.react(StepBegan)
def _on_step(_state: State, event: StepBegan, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(DecideOwnStep(event.subject.action_id)),) if event.target_role is None else ()


@HANDLERS.react(ExecutionHeld)
def _on_hold(state: State, event: ExecutionHeld, _now_us: int) -> tuple[Scheduled, ...]:
    if event.reason != "fleet-rule":
        return ()
    capability = state.execution.actions[event.subject.action_id].capability
    return (start_action(event.subject.action_id, capability, state.fleet.structure.poll_us, was_held=True),)


@HANDLERS.react(SupervisorResponded)
def _on_review(state: State, event: SupervisorResponded, _now_us: int) -> tuple[Scheduled, ...]:
    """Start an action that a supervisor has reviewed at its start.

    If it was not approved, the robot refuses a delegated action, and submits its own step again after the
    back-off.
    """
    action = state.execution.actions.get(event.subject.action_id)
    if event.purpose != "review" or action is None or action.stage not in ("held", "polling"):
        return ()
    waits = (at_once(event.principals.decided_by),)
    if action.is_delegated and not event.approves:
        return (Scheduled(RefuseHeld(action.action_id), 1, waits),)
    delay_us = 1 if event.approves else state.fleet.structure.back_off_us
    return (start_action(action.action_id, action.capability, delay_us, waits, was_held=True),)


@HANDLERS.react(PolicyWindowClosed)
def _on_window_closed(state: State, event: PolicyWindowClosed, now_us: int) -> tuple[Scheduled, ...]:
    return _on_fleet_rule(state, event, now_us) if event.scope == "fleet" else _let_go(state, event.robot)


@HANDLERS.react(PolicyRuleSet, RolePolicyRuleSet)
def _on_rule(state: State, event: PolicyRuleSet | RolePolicyRuleSet, _now_us: int) -> tuple[Scheduled, ...]:
    """Retry actions that wait for a robot's own policy; those that wait for the fleet's rule poll by themselves."""
    if event.scope == "fleet":
        return ()
    robots = (
        (event.robot,)
        if isinstance(event, PolicyRuleSet) and event.robot is not None
        else tuple(state.execution.current)
    )
    return tuple(start for robot in robots for start in _let_go(state, robot))


def _let_go(state: State, robot: Robot) -> tuple[Scheduled, ...]:
    """Start the action that the robot's own policy held, if nothing holds it now or a supervisor can release it."""
    action = in_hand(state.execution, robot)
    if action is None or action.stage != "held":
        return ()
    local, rule = _holding(state, action)
    if local != "allow" and _reviewer(state, action, local, rule) is None:
        return ()
    return (start_action(action.action_id, action.capability, was_held=True),)


@HANDLERS.react(PolicyWindowOpened)
def _on_fleet_rule(state: State, event: PolicyWindowOpened | PolicyWindowClosed, now_us: int) -> tuple[Scheduled, ...]:
    if event.scope != "fleet":
        return ()
    edge = "opened" if isinstance(event, PolicyWindowOpened) else "closed"
    learn = LearnFleetRule(event.robot, in_force(state.world.fleet, event.robot), now_us)
    return (Scheduled(learn, 0, (message(POLICY, event.window, edge),)),)


HANDLERS.react(ExecutionPaused)(resume_when_replanned)
HANDLERS.react(ContextChanged)(pause_running)
