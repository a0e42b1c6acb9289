"""Rules by role and domain: the handlers and the queries find the same policy, and a robot's own rule is the
exception."""

from collections.abc import Iterable
from itertools import product
from random import Random

import pytest

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import PolicyOutcome, PolicyScope, Robot
from fsar_ledger.events.policy import PolicyRuleSet, RolePolicyRuleSet
from fsar_ledger.metrics.database import Database, from_rows
from fsar_ledger.metrics.invariants import chosen
from fsar_ledger.projections import policy
from tests import past
from tests.queries.histories import act, answer, event, run
from tests.queries.test_role_trust import DOMAINS, DOOR, LIFT, MEMBERS, ROBOTS, row
from tests.queries.test_rules_and_trust import ASKED, REFUSED, rule
from tests.runtime.governed import H_F

A, B = Robot("robot/A1"), Robot("robot/B1")

OUTCOMES: tuple[PolicyOutcome, ...] = ("allow", "deny", "review")
SCOPES: tuple[PolicyScope, ...] = ("local", "fleet")
ABOUT = list(product((DOOR, LIFT), ("t1", "t2")))


def history(seed: int) -> list[Event]:
    """A fleet whose robots join before, between and after random rules: of roles in domains, of single robots, and of
    all."""
    draw = Random(seed)
    events: list[Event] = []
    for _ in range(draw.randint(1, 12)):
        scope, outcome = draw.choice(SCOPES), draw.choice(OUTCOMES)
        about = (draw.choice((None, None, DOOR, LIFT)), draw.choice((None, None, "t1", "t2")))
        if draw.random() < 0.3:
            events.append(
                PolicyRuleSet(
                    scope=scope,
                    robot=draw.choice((*ROBOTS, None)),
                    capability=about[0],
                    context=about[1],
                    outcome=outcome,
                    decided_by=None,
                )
            )
        else:
            events.append(
                RolePolicyRuleSet(
                    scope=scope,
                    role=draw.choice("AB"),
                    outcome=outcome,
                    domain=draw.choice(DOMAINS),
                    capability=about[0],
                    context=about[1],
                )
            )
    for member in MEMBERS:
        events.insert(draw.randint(0, len(events)), member)
    return events


def folded(events: Iterable[Event]) -> policy.Policy:
    state = policy.INITIAL
    for one in events:
        if isinstance(one, policy.HANDLES):
            state = policy.evolve(state, one)
    return state


def in_force(database: Database, at_us: int, capability: str, context: str) -> dict[tuple[str, str, str], str]:
    """What policy says at the time about the capability in the context, by run, robot and scope, as the queries have
    it."""
    found = database.query(
        "audit/policy_at", {"at_us": str(at_us), "capability": capability, "context": context}
    ).to_pylist()
    return {(one["run_id"], one["robot"], one["scope"]): one["outcome"] for one in found}


@pytest.mark.slow
def test_handlers_and_queries_find_the_same_rules_of_robot_role_domain_capability_and_context() -> None:
    runs = {f"r{seed}": history(seed) for seed in range(50)}
    rows = [
        one
        for name, events in runs.items()
        for one in run(*(row(one, 10 * place) for place, one in enumerate(events, 1)), run_id=name)
    ]
    seen = set()
    with from_rows(rows) as database:
        for (capability, context), place in product(ABOUT, (4, 9, 99)):
            found = in_force(database, 10 * place, capability, context)
            for name, events in runs.items():
                state = folded(events[:place])
                for robot, scope in product(state.members, SCOPES):
                    expected = policy.ruled(state, scope, robot, capability, context)
                    about = (name, place, robot, scope, capability, context)
                    assert found[name, robot, scope] == (expected or "allow"), about
                    seen.add(expected)
    assert seen == {*OUTCOMES, None}


def of_b(outcome: PolicyOutcome, domain: str = "") -> RolePolicyRuleSet:
    """A rule of the fleet's about the door of every robot of B's role."""
    return RolePolicyRuleSet(scope="fleet", role="B", outcome=outcome, domain=domain, capability=DOOR)


OF_B = of_b("deny")
NEARNESS: dict[str, tuple[tuple[Event, ...], PolicyOutcome | None]] = {
    "its role": ((OF_B,), "deny"),
    "another role": ((RolePolicyRuleSet(scope="fleet", role="A", outcome="deny"),), None),
    "the robots' own": ((RolePolicyRuleSet(scope="local", role="B", outcome="deny"),), None),
    "the robot": ((OF_B, past.ruled_for_all("allow", B, DOOR)), "allow"),
    "the robot before": ((past.ruled_for_all("review", B, DOOR), OF_B), "review"),
    "another robot": ((OF_B, past.ruled_for_all("allow", Robot("robot/B2"), DOOR)), "deny"),
    "its own, not the fleet's": ((OF_B, past.ruled("allow", B, DOOR)), "deny"),
    "about everything": ((OF_B, past.ruled_for_all("allow", B)), "deny"),
    "in one context": ((OF_B, past.ruled_for_all("allow", B, DOOR, "t1")), "deny"),
    "every robot": ((OF_B, past.ruled_for_all("allow", None, DOOR)), "deny"),
    "every robot before": ((past.ruled_for_all("deny", None, DOOR), of_b("allow")), "deny"),
    "replaced": ((OF_B, of_b("review")), "review"),
    "its domain": ((OF_B, of_b("allow", "hall")), "allow"),
    "its domain before": ((of_b("allow", "hall/cell"), OF_B), "allow"),
    "another domain": ((OF_B, of_b("allow", "yard")), "deny"),
    "half a name": ((OF_B, of_b("allow", "hal")), "deny"),
}
"""Rules of the fleet about robot/B1, which works in hall/cell, and what they make of the secure door in t1."""


def test_a_rule_is_replaced_by_a_nearer_one_about_the_same_and_by_nothing_else() -> None:
    runs = {name: (past.joined(B, "B", domain="hall/cell"), *rules) for name, (rules, _) in NEARNESS.items()}
    expected = {name: outcome for name, (_, outcome) in NEARNESS.items()}
    assert {name: policy.ruled(folded(events), "fleet", B, DOOR, "t1") for name, events in runs.items()} == expected
    with from_rows([one for name, events in runs.items() for one in run(*map(row, events), run_id=name)]) as database:
        found = in_force(database, 5, DOOR, "t1")
    assert {name: found[name, "robot/B1", "fleet"] for name in runs} == {
        name: outcome or "allow" for name, outcome in expected.items()
    }


def test_a_rule_of_a_role_is_a_window_of_each_robot_until_a_nearer_one_is_set() -> None:
    robots = [
        event("RobotJoined", robot=f"robot/{name}", role=name[0], team=1, domain=domain)
        for name, domain in (("A1", ""), ("B1", ""), ("B2", "yard"))
    ]
    late = event("RobotJoined", 9, robot="robot/B3", role="B", team=3)
    of_b = event(
        "RolePolicyRuleSet", 2, scope="fleet", role="B", domain="", outcome="deny", capability=DOOR, decided_by=H_F
    )
    rows = run(
        *robots,
        of_b,
        event("PolicyRuleSet", 4, scope="fleet", robot="robot/B1", outcome="allow", capability=DOOR, decided_by=H_F),
        {**of_b, "time_us": 5, "domain": "yard", "outcome": "review"},
        {**of_b, "time_us": 7, "outcome": "review"},
        late,
    )
    expected = [
        ("robot/B1", 2, 4, "deny"),
        ("robot/B2", 2, 5, "deny"),
        ("robot/B2", 5, None, "review"),
        ("robot/B3", 2, 7, "deny"),
        ("robot/B3", 7, None, "review"),
    ]
    assert (
        sorted(answer("facts/policy_windows", rows, columns=("robot", "opened_us", "closed_us", "outcome")), key=str)
        == expected
    )
    assert len(answer("facts/policy_rules", rows)) == 6, "and the exception of the one robot"


def test_a_supervisors_rule_of_a_role_is_on_the_list_of_what_it_decided() -> None:
    said = event("RolePolicyRuleSet", 2, scope="fleet", role="B", domain="", outcome="deny", decided_by=H_F)
    rows = run(said, {**said, "domain": "yard", "context": "t1"}, {**said, "decided_by": None})
    found = answer("audit/supervisor_decisions", rows, columns=("decision",))
    assert found == [("B fleet deny",), ("B of yard fleet deny in t1",)]


def test_a_hold_ends_when_a_rule_comes_into_force_for_the_robot() -> None:
    joined = event("RobotJoined", robot="robot/B1", role="B", team=1, domain="yard")
    held = event("ExecutionHeld", 2, robot="robot/B1", action_id="t1/1", outcome="deny")
    began = act("ExecutionStarted", 4, "t1/1", robot="robot/B1", on_behalf_of="robot/B1", capability=DOOR, ends_us=9)
    of_role = event("RolePolicyRuleSet", 3, scope="local", role="B", domain="", outcome="allow")
    own = event("PolicyRuleSet", 1, scope="local", robot="robot/B1", outcome="allow")

    histories = {
        "nothing": (held, began),
        "its role": (held, of_role, began),
        "its domain": (held, {**of_role, "domain": "yard"}, began),
        "another role": (held, {**of_role, "role": "A"}, began),
        "another domain": (held, {**of_role, "domain": "hall"}, began),
        "an exception": (own, held, of_role, began),
    }
    named = {
        "its own": {**own, "time_us": 3},
        "every robot's": {**own, "robot": None, "time_us": 3},
        "another's": {**own, "robot": "robot/A1", "time_us": 3},
    }
    rows = [one for name, events in histories.items() for one in run(joined, *events, run_id=name)]
    rows += [
        one
        for name, rule in named.items()
        for one in run(held, rule, began, run_id=f"{name}, of a robot that nobody saw join")
    ]
    (a3,) = chosen(["a3"])
    with from_rows(rows) as database:
        broken = {found["run_id"] for found in database.rows(f"SELECT run_id FROM {a3.relation}")}
    assert broken == {
        "nothing",
        "another role",
        "another domain",
        "an exception",
        "another's, of a robot that nobody saw join",
    }


def test_a_refusal_against_a_mandate_of_the_role_is_a_conflict_unless_the_robot_is_an_exception() -> None:
    joined = event("RobotJoined", robot="robot/B1", role="B", team=1)
    mandate = event("RolePolicyRuleSet", 1, scope="fleet", role="B", domain="", outcome="allow", decided_by=H_F)
    histories = {
        "its role": (mandate,),
        "another role": ({**mandate, "role": "A"},),
        "another domain": ({**mandate, "domain": "yard"},),
        "another task": ({**mandate, "context": "t2"},),
        "a review": ({**mandate, "outcome": "review"},),
        "an exception": (mandate, rule(1, "review", scope="fleet")),
        "the exception is the mandate": ({**mandate, "outcome": "review"}, rule(1, "allow", scope="fleet")),
    }
    rows = [
        one for name, events in histories.items() for one in run(joined, *events, rule(2), ASKED, REFUSED, run_id=name)
    ]
    found = answer("facts/mandate_conflicts", rows, columns=("run_id",))
    assert found == [("its role",), ("the exception is the mandate",)]
