"""Policy rules: who may set which, deny before review before allow, and a mandate never overrides a robot's own
denial."""

import pytest
from hypothesis import given as for_all
from hypothesis import settings
from hypothesis import strategies as st

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import POLICY, Robot, Subject, Supervisor
from fsar_ledger.events.execution import ExecutionHeld, ExecutionStarted
from fsar_ledger.events.knowledge import FleetRuleLearned
from fsar_ledger.events.policy import PolicyConflictEscalated, PolicyRuleSet, RolePolicyRuleSet
from fsar_ledger.events.request import RequestDenied
from fsar_ledger.events.task import TaskCompleted
from fsar_ledger.projections.fold import apply, fold
from fsar_ledger.projections.policy import INITIAL, evolve, ruled
from fsar_ledger.projections.world import stricter
from fsar_ledger.runtime.architectures.fsar import FSAR
from fsar_ledger.runtime.architectures.fsar.execution import DecideOwnStep, start
from fsar_ledger.runtime.architectures.fsar.request import EvaluateRequest
from fsar_ledger.runtime.handlers.commands import StartAction, TakeTurn
from fsar_ledger.runtime.handlers.policy import (
    SetPolicyRule,
    SetRolePolicyRule,
    compose,
    conflict,
    fleet_policy,
    own_policy,
    set_policy_rule,
    set_role_policy_rule,
)
from tests import past
from tests.runtime.governed import H_F, governed
from tests.runtime.histories import ARRIVED, DELEGATED_STEP, DOOR, OWN_STEP, A, B, C, given, happen, types, window
from tests.runtime.live import decided, play, refusal
from tests.sure import only

H_B = Supervisor("supervisor/B1")
REQUESTED = (ARRIVED, DELEGATED_STEP, past.queried(Subject("A1-1", "A1-1/2.1"), past.parties(A, B), DOOR, B))
OUTCOME = st.sampled_from(["allow", "deny", "review"])
RULE = st.builds(
    PolicyRuleSet,
    scope=st.sampled_from(["local", "fleet"]),
    robot=st.sampled_from([None, A, B]),
    capability=st.sampled_from([None, DOOR, "carry.package"]),
    context=st.sampled_from([None, "A1-1", "A1-2"]),
    outcome=OUTCOME,
    decided_by=st.just(H_F),
)


def rule(
    outcome: str,
    robot: Robot | None = B,
    capability: str | None = None,
    context: str | None = None,
    scope: str = "local",
) -> PolicyRuleSet:
    return PolicyRuleSet(
        scope=scope,  # type: ignore[arg-type]
        robot=robot,
        capability=capability,
        context=context,
        outcome=outcome,  # type: ignore[arg-type]
        decided_by=H_F,
    )


def conflicts(*happened: Event) -> tuple[Event, ...]:
    """What is escalated when A asks B for its door after this."""
    return conflict(given("fsar", *happened), "A1-1", "A1-1/2.1", A, B, DOOR)


def test_a_robots_own_policy_is_set_by_its_own_supervisor() -> None:
    [event] = decided(given("fsar"), SetPolicyRule(H_B, "local", B, DOOR, "A1-1", "deny"))
    assert event == past.ruled("deny", B, DOOR, "A1-1")


@pytest.mark.parametrize("robot", [None, B])
def test_the_fleets_rules_are_set_by_the_fleet_supervisor(robot: Robot | None) -> None:
    [event] = decided(given("fsar"), SetPolicyRule(H_F, "fleet", robot, None, None, "review"))
    assert event == past.ruled_for_all("review", robot)


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        (SetPolicyRule(H_F, "local", B, None, None, "allow"), "supervisor/fleet does not set robot/B1's own policy"),
        (
            SetPolicyRule(Supervisor("supervisor/A1"), "local", B, None, None, "deny"),
            "supervisor/A1 does not supervise robot/B1",
        ),
        (SetPolicyRule(H_B, "fleet", B, None, None, "deny"), "supervisor/B1 supervises one robot"),
        (
            SetPolicyRule(Supervisor("supervisor/X9"), "local", B, None, None, "deny"),
            "unknown supervisor supervisor/X9",
        ),
        (SetPolicyRule(H_B, "local", None, None, None, "deny"), "a local rule of no robot"),
        (SetPolicyRule(H_F, "fleet", Robot("robot/X9"), None, None, "deny"), "unknown robot robot/X9"),
        (SetPolicyRule(H_F, "fleet", None, "fly", None, "deny"), "unknown capability fly"),
        (SetPolicyRule(H_F, "fleet", None, None, "A1-1", "deny"), "task A1-1 is over"),
        (SetPolicyRule(H_F, "fleet", None, None, None, "maybe"), "found fleet maybe"),  # type: ignore[arg-type]
        (SetPolicyRule(H_F, "world", None, None, None, "deny"), "found world deny"),  # type: ignore[arg-type]
    ],
)
def test_a_rule_that_cannot_be_set_is_rejected(command: SetPolicyRule, reason: str) -> None:
    assert refusal(set_policy_rule(given("fsar", ARRIVED, TaskCompleted("A1-1")), command)).startswith(reason)


def test_the_fleet_supervisor_rules_by_role_and_a_robot_stays_an_exception() -> None:
    yard = (
        past.joined(Robot("robot/B8"), "B", 8, domain="yard"),
        past.joined(Robot("robot/B9"), "B", 9, domain="yard/gate"),
    )
    state = given("fsar", rule("allow", capability=DOOR, scope="fleet"), *yard)
    [event] = decided(state, SetRolePolicyRule(H_F, "B", "deny", capability=DOOR))
    assert event == RolePolicyRuleSet(
        scope="fleet", role="B", outcome="deny", domain="", capability=DOOR, context=None, decided_by=H_F
    )
    apply(state, event)
    apply(state, past.joined(Robot("robot/B7"), "B", 7, domain="hall"))
    assert [
        fleet_policy(state.knowledge, state.policy, robot, DOOR, None)
        for robot in (B, Robot("robot/B7"), Robot("robot/B8"), A)
    ] == ["allow", "deny", "deny", "allow"]
    [event] = decided(state, SetRolePolicyRule(H_F, "B", "review", "yard", DOOR))
    apply(state, event)
    assert [
        fleet_policy(state.knowledge, state.policy, robot, DOOR, None)
        for robot in (B, *(Robot(f"robot/B{team}") for team in (7, 8, 9)))
    ] == ["allow", "deny", "review", "review"]
    assert compose(state, "allow", Robot("robot/B9"), DOOR, None) == "review"


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        (SetRolePolicyRule(H_B, "B", "deny"), "supervisor/B1 supervises one robot"),
        (SetRolePolicyRule(Supervisor("supervisor/X9"), "B", "deny"), "unknown supervisor supervisor/X9"),
        (SetRolePolicyRule(H_F, "b", "deny"), "unknown role b, expected one of A, B, C, D"),
        (SetRolePolicyRule(H_F, "B", "deny", "hall"), "unknown domain hall"),
        (SetRolePolicyRule(H_F, "B", "deny", capability="fly"), "unknown capability fly"),
        (SetRolePolicyRule(H_F, "B", "deny", context="A1-1"), "task A1-1 is over"),
        (SetRolePolicyRule(H_F, "B", "maybe"), "unknown outcome maybe, expected one of allow, deny, review"),  # type: ignore[arg-type]
    ],
)
def test_a_rule_of_a_role_that_cannot_be_set_is_rejected(command: SetRolePolicyRule, reason: str) -> None:
    assert refusal(set_role_policy_rule(given("fsar", ARRIVED, TaskCompleted("A1-1")), command)).startswith(reason)


@for_all(
    st.lists(RULE, max_size=8),
    st.sampled_from([A, B, C]),
    st.sampled_from([DOOR, "carry.package"]),
    st.sampled_from(["A1-1", "A1-2"]),
)
@settings(max_examples=80)
def test_the_strictest_rule_that_applies_holds_and_of_one_rule_the_last_word(
    rules: list[PolicyRuleSet], robot: Robot, capability: str, context: str
) -> None:
    state = INITIAL
    for one in rules:
        state = evolve(state, one)
    last = {(one.robot, one.capability, one.context): one.outcome for one in rules if one.scope == "local"}
    applying = [
        outcome
        for (of, what, where), outcome in last.items()
        if of in (None, robot) and what in (None, capability) and where in (None, context)
    ]
    expected = None if not applying else "deny" if "deny" in applying else "review" if "review" in applying else "allow"
    assert ruled(state, "local", robot, capability, context) == expected


@for_all(OUTCOME, OUTCOME, OUTCOME, OUTCOME)
@settings(max_examples=81)
def test_composition_is_the_strictest_of_all_parts_so_that_allow_loosens_nothing(
    carried: str, local: str, fleet: str, opened: str
) -> None:
    happened = [rule(local), rule(fleet, scope="fleet")] + ([] if opened == "allow" else [window(B, opened)])
    composed = compose(given("fsar", *happened), carried, B, DOOR, "A1-1")  # type: ignore[arg-type]
    parts = [carried, local, fleet, opened]
    assert composed == ("deny" if "deny" in parts else "review" if "review" in parts else "allow")
    more = compose(given("fsar", *happened, rule("allow", capability=DOOR)), carried, B, DOOR, "A1-1")  # type: ignore[arg-type]
    assert more == stricter(composed, more) == composed


def test_a_rule_about_a_capability_or_a_task_leaves_others_alone() -> None:
    state = given("fsar", rule("deny", capability=DOOR, context="A1-1"))
    assert [
        own_policy(state.policy, state.world, B, *about)
        for about in ((DOOR, "A1-1"), (DOOR, "A1-2"), ("door.open.basic", "A1-1"))
    ] == ["deny", "allow", "allow"]


def test_a_mandate_against_the_executors_own_denial_is_denied_and_escalated() -> None:
    state = given("fsar", *REQUESTED, rule("deny"), rule("allow", robot=None, capability=DOOR, scope="fleet"))
    escalated, denied = decided(state, EvaluateRequest("A1-1/2.1"))
    assert escalated == PolicyConflictEscalated(
        Subject("A1-1", "A1-1/2.1"), past.principals(POLICY, A, B, H_F), DOOR, "deny", "allow"
    )
    assert isinstance(denied, RequestDenied)
    assert denied.reason == "policy"


def test_a_matter_of_one_robot_alone_is_escalated_to_its_own_supervisor() -> None:
    state = given("fsar", window(B), rule("allow", scope="fleet"))
    [escalated] = conflict(state, None, None, B, B, DOOR)
    assert escalated.principals.supervised_by == H_B


def test_a_mandate_against_a_denial_that_holds_the_start_is_escalated_at_every_hold() -> None:
    state = given("fsar", *REQUESTED, rule("allow", robot=None, capability=DOOR, scope="fleet"))
    happen(state, *decided(state, EvaluateRequest("A1-1/2.1")), rule("deny"))
    play(state, TakeTurn("A1-1/2.1"))
    escalated, held = start(state, StartAction("A1-1/2.1", now_us=5, answer=7))
    assert escalated == PolicyConflictEscalated(
        Subject("A1-1", "A1-1/2.1"), past.principals(POLICY, A, B, H_F), DOOR, "deny", "allow"
    )
    assert isinstance(held, ExecutionHeld)
    assert held.outcome == "deny"
    happen(state, *(escalated, held))
    found = types(start(state, StartAction("A1-1/2.1", now_us=9, answer=7)))
    assert found == ["PolicyConflictEscalated", "ExecutionHeld"]
    apply(state, rule("review"))
    assert types(start(state, StartAction("A1-1/2.1", now_us=9, answer=7))) == ["ExecutionHeld", "SupervisorCalled"]


@pytest.mark.parametrize(
    "happened",
    [
        (rule("deny"),),
        (rule("review"), rule("allow", scope="fleet")),
        (rule("deny"), rule("review", scope="fleet")),
        (rule("deny"), rule("allow", scope="fleet"), rule("deny", robot=None, scope="fleet")),
        (rule("deny"), rule("allow", scope="fleet"), FleetRuleLearned(B, "deny", 1)),
        (rule("deny"), rule("allow", robot=A, scope="fleet")),
        (rule("allow", scope="fleet"),),
    ],
    ids=[
        *("no mandate", "own review", "fleet reviews", "fleet also denies"),
        *("zone denies", "mandate for another", "no denial"),
    ],
)
def test_without_a_mandate_or_without_a_denial_there_is_no_conflict(happened: tuple[Event, ...]) -> None:
    assert conflicts(*happened) == ()


def test_without_policy_composition_a_requester_does_not_see_the_mandate() -> None:
    state = given("fsar", rule("deny"), rule("allow", scope="fleet"), configuration="without-policy-composition")
    assert conflict(state, "A1-1", "A1-1/2.1", A, B, DOOR) == ()
    assert types(conflict(state, "A1-1", "A1-1/2.1", B, B, DOOR)) == ["PolicyConflictEscalated"], (
        "its own step is not composed between robots"
    )


def test_a_start_that_a_rule_held_goes_on_when_the_rule_is_replaced() -> None:
    state = given("fsar", ARRIVED, OWN_STEP)
    play(state, DecideOwnStep("A1-1/1.1"))
    apply(state, rule("deny", robot=A))
    held = only(ExecutionHeld, start(state, StartAction("A1-1/1.1", now_us=5, answer=7)))
    apply(state, held)

    def woken(event: PolicyRuleSet | RolePolicyRuleSet) -> list[object]:
        apply(state, event)
        return [one.command for react in FSAR.reacts[type(event)] for one in react(state, event, 6)]

    assert woken(RolePolicyRuleSet(scope="local", role="A", outcome="allow")) == [], "the robot's own stands"
    assert woken(rule("allow", robot=B)) == []
    assert woken(rule("review", robot=A)) == [StartAction("A1-1/1.1", was_held=True)], "a supervisor can let it go"
    assert woken(rule("allow", robot=A)) == [StartAction("A1-1/1.1", was_held=True)]
    assert types(start(state, StartAction("A1-1/1.1", now_us=9, answer=7))) == ["ExecutionStarted"]


def test_what_a_rule_of_the_role_held_goes_on_when_that_or_the_robots_exception_allows() -> None:
    for lifted in (RolePolicyRuleSet(scope="local", role="A", outcome="allow"), rule("allow", robot=A)):
        state = given("fsar", ARRIVED, OWN_STEP)
        for event in (
            *decided(state, DecideOwnStep("A1-1/1.1")),
            RolePolicyRuleSet(scope="local", role="A", outcome="deny"),
        ):
            apply(state, event)
        held = only(ExecutionHeld, start(state, StartAction("A1-1/1.1", now_us=5, answer=7)))
        apply(state, held)
        apply(state, lifted)
        assert [one.command for react in FSAR.reacts[type(lifted)] for one in react(state, lifted, 6)] == [
            StartAction("A1-1/1.1", was_held=True)
        ]
        assert types(start(state, StartAction("A1-1/1.1", now_us=9, answer=7))) == ["ExecutionStarted"]


def test_a_rule_of_the_role_is_a_mandate_for_each_of_its_robots_without_an_exception() -> None:
    mandate = RolePolicyRuleSet(scope="fleet", role="B", outcome="allow", domain="", capability=DOOR)
    assert types(conflicts(rule("deny"), mandate)) == ["PolicyConflictEscalated"]
    assert conflicts(rule("deny"), mandate, rule("deny", capability=DOOR, scope="fleet")) == ()
    assert conflicts(rule("deny"), RolePolicyRuleSet(scope="fleet", role="A", outcome="allow")) == ()


def test_in_a_run_nothing_starts_under_a_rule_that_denies_and_it_all_goes_on_when_the_rule_is_lifted() -> None:
    denied, lifted = (1_500_000, rule("deny", capability=DOOR)), (60_000_000, rule("allow", capability=DOOR))
    one = governed("door-relay", denied, lifted)
    starts = [
        time
        for time, event in zip(one.times_us, one.events, strict=True)
        if isinstance(event, ExecutionStarted) and event.capability == DOOR
    ]
    assert starts
    assert min(starts) > 60_000_000
    assert fold(one.events) == one.state


def test_in_a_run_a_mandate_is_escalated_with_denials_and_nothing_is_overridden() -> None:
    one = governed(
        "door-relay", (1_500_000, rule("deny", capability=DOOR)), (1_600_000, rule("allow", robot=None, scope="fleet"))
    )
    denied = {
        event.subject.action_id for event in one.events if isinstance(event, RequestDenied) and event.reason == "policy"
    }
    escalated = {event.subject.action_id for event in one.events if isinstance(event, PolicyConflictEscalated)}
    assert escalated
    assert escalated < denied, "while the fleet denies as well there is no conflict"
    assert not any(isinstance(event, ExecutionStarted) and event.capability == DOOR for event in one.events)
