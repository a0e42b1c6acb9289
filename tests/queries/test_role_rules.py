"""Rules by role and domain: the handlers and the queries find the same policy, and a robot's own rule is the exception."""

from collections import Counter
from collections.abc import Iterable
from itertools import product
from random import Random

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import PolicyOutcome, PolicyScope, Robot, Supervisor
from fsar_ledger.events.execution import ExecutionStarted
from fsar_ledger.events.fleet import RobotJoined
from fsar_ledger.events.policy import PolicyRuleSet, RolePolicyRuleSet
from fsar_ledger.events.request import RequestDenied
from fsar_ledger.ledger.rows.codec import RunRecord, encode
from fsar_ledger.metrics.database import Database, from_rows, from_table
from fsar_ledger.metrics.invariants import chosen
from fsar_ledger.projections import policy
from fsar_ledger.runtime.architectures.fsar import FSAR
from fsar_ledger.runtime.architectures.handler_table import HandlerTable
from fsar_ledger.runtime.handlers.advertising import AdvertiseCapability
from fsar_ledger.runtime.handlers.commands import StartAction
from fsar_ledger.runtime.handlers.fleet import InstallCapability, JoinFleet
from fsar_ledger.runtime.handlers.policy import SetPolicyRule, SetRolePolicyRule
from fsar_ledger.runtime.handlers.request import RequestCapability
from tests.queries.histories import S, answer, event, run
from tests.queries.test_role_trust import DOMAINS, DOOR, LIFT, MEMBERS, ROBOTS, row
from tests.queries.test_rules_and_trust import ASKED, REFUSED, rule, unchecked_start
from tests.runtime.governed import H_F, governed
from tests.runtime.live import of, played

A, B = Robot("robot/A1"), Robot("robot/B1")

OUTCOMES: tuple[PolicyOutcome, ...] = ("allow", "deny", "review")
SCOPES: tuple[PolicyScope, ...] = ("local", "fleet")
ABOUT = list(product((DOOR, LIFT), ("t1", "t2")))


def history(seed: int) -> list[Event]:
    """A fleet whose robots join before, between and after random rules: of roles in domains, of single robots, and of all."""
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
    """What policy says at the time about the capability in the context, by run, robot and scope, as the queries have it."""
    found = database.query(
        "audit/policy_at", {"at_us": str(at_us), "capability": capability, "context": context}
    ).to_pylist()
    return {(one["run_id"], one["robot"], one["scope"]): one["outcome"] for one in found}


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
                    assert found[name, robot, scope] == (expected or "allow"), (
                        name,
                        place,
                        robot,
                        scope,
                        capability,
                        context,
                    )
                    seen.add(expected)
    assert seen == {*OUTCOMES, None}


OF_B = RolePolicyRuleSet(scope="fleet", role="B", outcome="deny", domain="", capability=DOOR)
NEARNESS: dict[str, tuple[tuple[Event, ...], PolicyOutcome | None]] = {
    "its role": ((OF_B,), "deny"),
    "another role": ((RolePolicyRuleSet(scope="fleet", role="A", outcome="deny"),), None),
    "the robots' own": ((RolePolicyRuleSet(scope="local", role="B", outcome="deny"),), None),
    "the robot": (
        (
            OF_B,
            PolicyRuleSet(scope="fleet", robot=B, capability=DOOR, context=None, outcome="allow", decided_by=None),
        ),
        "allow",
    ),
    "the robot before": (
        (
            PolicyRuleSet(scope="fleet", robot=B, capability=DOOR, context=None, outcome="review", decided_by=None),
            OF_B,
        ),
        "review",
    ),
    "another robot": (
        (
            OF_B,
            PolicyRuleSet(
                scope="fleet", robot=Robot("robot/B2"), capability=DOOR, context=None, outcome="allow", decided_by=None
            ),
        ),
        "deny",
    ),
    "its own, not the fleet's": (
        (
            OF_B,
            PolicyRuleSet(scope="local", robot=B, capability=DOOR, context=None, outcome="allow", decided_by=None),
        ),
        "deny",
    ),
    "about everything": (
        (
            OF_B,
            PolicyRuleSet(scope="fleet", robot=B, capability=None, context=None, outcome="allow", decided_by=None),
        ),
        "deny",
    ),
    "in one context": (
        (
            OF_B,
            PolicyRuleSet(scope="fleet", robot=B, capability=DOOR, context="t1", outcome="allow", decided_by=None),
        ),
        "deny",
    ),
    "every robot": (
        (
            OF_B,
            PolicyRuleSet(scope="fleet", robot=None, capability=DOOR, context=None, outcome="allow", decided_by=None),
        ),
        "deny",
    ),
    "every robot before": (
        (
            PolicyRuleSet(scope="fleet", robot=None, capability=DOOR, context=None, outcome="deny", decided_by=None),
            RolePolicyRuleSet(scope="fleet", role="B", outcome="allow", domain="", capability=DOOR),
        ),
        "deny",
    ),
    "replaced": (
        (OF_B, RolePolicyRuleSet(scope="fleet", role="B", outcome="review", domain="", capability=DOOR)),
        "review",
    ),
    "its domain": (
        (OF_B, RolePolicyRuleSet(scope="fleet", role="B", outcome="allow", domain="hall", capability=DOOR)),
        "allow",
    ),
    "its domain before": (
        (RolePolicyRuleSet(scope="fleet", role="B", outcome="allow", domain="hall/cell", capability=DOOR), OF_B),
        "allow",
    ),
    "another domain": (
        (OF_B, RolePolicyRuleSet(scope="fleet", role="B", outcome="allow", domain="yard", capability=DOOR)),
        "deny",
    ),
    "half a name": (
        (OF_B, RolePolicyRuleSet(scope="fleet", role="B", outcome="allow", domain="hal", capability=DOOR)),
        "deny",
    ),
}
"""Rules of the fleet about robot/B1, which works in hall/cell, and what they make of the secure door in t1."""


def test_a_rule_is_replaced_by_a_nearer_one_about_the_same_and_by_nothing_else() -> None:
    runs = {
        name: (RobotJoined(robot=B, role="B", team=1, supervisor=None, domain="hall/cell"), *rules)
        for name, (rules, _) in NEARNESS.items()
    }
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
    assert answer("audit/supervisor_decisions", rows, columns=("decision",)) == [
        ("B fleet deny",),
        ("B of yard fleet deny in t1",),
    ]


def test_a_hold_ends_when_a_rule_comes_into_force_for_the_robot() -> None:
    joined = event("RobotJoined", robot="robot/B1", role="B", team=1, domain="yard")
    held = event("ExecutionHeld", 2, robot="robot/B1", action_id="t1/1", outcome="deny")
    began = event(
        "ExecutionStarted",
        4,
        task_id="t1",
        action_id="t1/1",
        robot="robot/B1",
        on_behalf_of="robot/B1",
        capability=DOOR,
        ends_us=9,
    )
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
    assert answer("facts/mandate_conflicts", rows, columns=("run_id",)) == [
        ("its role",),
        ("the exception is the mandate",),
    ]


# --- runs ---

A1, B1, B2 = A, B, Robot("robot/B2")
COMMANDS = (
    (1 * S, SetRolePolicyRule(H_F, "B", "deny", capability=DOOR)),
    (2 * S, SetPolicyRule(H_F, "fleet", B1, DOOR, None, "allow")),
    (3 * S, JoinFleet(B2, "B", 2, Supervisor("supervisor/B2"), "yard")),
    (3 * S, InstallCapability(B2, DOOR, "1.0.0")),
    (4 * S, AdvertiseCapability(B2, DOOR, "1.0.0")),
    (5 * S, RequestCapability(A1, B1, DOOR, "visit", "excepted")),
    (20 * S, RequestCapability(A1, B2, DOOR, "visit", "of the role")),
    (40 * S, SetRolePolicyRule(H_F, "B", "allow", "yard", DOOR)),
    (41 * S, RequestCapability(A1, B2, DOOR, "visit", "of the yard")),
    (60 * S, SetRolePolicyRule(H_F, "B", "deny", "yard", DOOR, "visit")),
    (61 * S, RequestCapability(A1, B2, DOOR, "visit", "of the visit")),
    (80 * S, SetPolicyRule(H_F, "fleet", B1, DOOR, None, "deny")),
    (81 * S, SetRolePolicyRule(H_F, "B", "allow", capability=DOOR)),
    (82 * S, RequestCapability(A1, B1, DOOR, "visit", "no longer excepted")),
)


def offences(database: Database) -> dict[tuple[str, str], int]:
    """How often I3 and A3 are broken in each run, where they are."""
    found = [
        (query.relation[:2], one["run_id"])
        for query in chosen(["i3", "a3"])
        for one in database.rows(f"SELECT run_id FROM {query.relation}")
    ]
    return dict(Counter(found))


def test_in_a_commanded_run_the_role_is_ruled_the_exception_is_not_and_the_queries_agree_at_every_moment() -> None:
    one = played(COMMANDS)
    began = {event.subject.action_id for _, event in of(one, ExecutionStarted)}  # type: ignore[attr-defined]
    denied = {(event.subject.action_id, event.reason) for _, event in of(one, RequestDenied)}  # type: ignore[attr-defined]
    assert began == {"excepted", "of the yard"}
    assert denied == {("of the role", "policy"), ("of the visit", "policy"), ("no longer excepted", "policy")}
    with from_table(encode([RunRecord("r1", one.times_us, one.caused_by, one.events)]), threads=1) as database:
        for at_us in sorted({time_us + S // 2 for time_us, _ in COMMANDS}):
            state = folded(event for time_us, event in zip(one.times_us, one.events, strict=True) if time_us <= at_us)
            found = in_force(database, at_us, DOOR, "visit")
            for robot, scope in product(state.members, SCOPES):
                assert found["r1", robot, scope] == (policy.ruled(state, scope, robot, DOOR, "visit") or "allow"), (
                    at_us,
                    robot,
                    scope,
                )
        assert offences(database) == {}


INTERVENTIONS = (
    (
        2,
        RolePolicyRuleSet(
            scope="fleet", role="B", outcome="deny", domain="", capability=DOOR, context=None, decided_by=H_F
        ),
    ),
    (3, RolePolicyRuleSet(scope="local", role="A", outcome="deny", domain="", capability="carry.package")),
    (60 * S, PolicyRuleSet(scope="fleet", robot=B1, capability=DOOR, context=None, outcome="allow", decided_by=H_F)),
    (
        70 * S,
        RolePolicyRuleSet(
            scope="fleet", role="B", outcome="deny", domain="", capability=DOOR, context=None, decided_by=H_F
        ),
    ),
    (80 * S, RolePolicyRuleSet(scope="local", role="A", outcome="allow", domain="", capability="carry.package")),
)


def test_in_simulated_runs_rules_of_roles_are_heeded_and_a_start_that_does_not_look_is_caught() -> None:
    one = governed("door-relay", *INTERVENTIONS, run=4)
    starts = of(one, ExecutionStarted)
    for capability, from_us in ((DOOR, 60 * S), ("carry.package", 80 * S)):
        times = [time_us for time_us, event in starts if event.capability == capability]  # type: ignore[attr-defined]
        assert times
        assert min(times) > from_us
    blind = HandlerTable({**FSAR.decides, StartAction: unchecked_start}, FSAR.reacts)
    other = governed("door-relay", *INTERVENTIONS, run=4, structure=blind)
    runs = [
        RunRecord(name, made.times_us, made.caused_by, made.events) for name, made in (("blind", other), ("fsar", one))
    ]
    with from_table(encode(runs), threads=1) as database:
        broken = offences(database)
    assert broken["i3", "blind"] > 0
    assert {name for _, name in broken} == {"blind"}
