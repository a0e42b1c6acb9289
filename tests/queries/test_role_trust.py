"""Trust by role and domain: the handlers and the queries find the same entry, and no row is made for each pair."""

from itertools import permutations
from random import Random
from typing import Any

import pytest

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Robot, TrustScope, flat
from fsar_ledger.events.trust import InitialTrustSet, RoleTrustSet
from fsar_ledger.projections import trust
from fsar_ledger.projections.fold import fold
from fsar_ledger.runtime.world import founding
from tests import past
from tests.queries.histories import Row, answer, event, run
from tests.recycled import from_rows

A, B = Robot("robot/A1"), Robot("robot/B1")

DOOR, LIFT = "door.open.secure", "carry.heavy"
DOMAINS = ("", "hall", "hall/cell", "hall/cell/bay", "hallway", "yard")
MEMBERS = [
    past.joined(Robot(f"robot/{role}{team}"), role, team, domain=DOMAINS[(team * 3 + offset) % len(DOMAINS)])
    for team in (1, 2)
    for offset, role in enumerate("AB")
]
ROBOTS = tuple(one.robot for one in MEMBERS)
ASKED = [
    (robot, peer, capability, context)
    for robot, peer in permutations(ROBOTS, 2)
    for capability in (DOOR, LIFT)
    for context in ("t1", "t2")
]


def row(one: Event, time_us: int = 0) -> Row:
    """The event as a row."""
    return event(type(one).__name__, time_us, **{name: value for name, value in flat(one).items() if value is not None})


def history(seed: int) -> list[Event]:
    """A fleet whose robots join before, between and after random entries of trust, about pairs and about roles."""
    draw = Random(seed)
    events: list[Event] = []
    for _ in range(draw.randint(1, 9)):
        scope: TrustScope = draw.choice(trust.SCOPES)
        about = (draw.choice((None, None, DOOR, LIFT)), draw.choice((None, None, "t1", "t2")))
        if draw.random() < 0.3:
            robot, peer = draw.sample(ROBOTS, 2)
            events.append(past.trusted(robot, peer, scope, about[0], context=about[1]))
        elif draw.random() < 0.2:
            events.append(
                InitialTrustSet(
                    robot=draw.choice(ROBOTS), scope=scope, is_trusting=draw.random() < 0.5, decided_by=None
                )
            )
        else:
            events.append(
                RoleTrustSet(
                    role=draw.choice("AB"),
                    peer_role=draw.choice("AB"),
                    scope=scope,
                    domain=draw.choice(DOMAINS),
                    capability=about[0],
                    context=about[1],
                )
            )
    for member in MEMBERS:
        events.insert(draw.randint(0, len(events)), member)
    return events


def folded(events: list[Event]) -> trust.Trust:
    state = trust.INITIAL
    for one in events:
        state = trust.evolve(state, one)  # type: ignore[arg-type]
    return state


def test_handlers_and_queries_find_the_same_entry_of_pair_role_domain_capability_and_context() -> None:
    runs, expected, began = [], {}, {}
    for seed in range(60):
        events = history(seed)
        state = folded(events)
        rows = [row(one) for one in events]
        for robot, peer, capability, context in ASKED:
            began[f"r{seed}", len(rows) + 1] = (robot, peer, capability, context)
            expected[f"r{seed}", robot, peer, capability, context] = trust.scope_of(
                state, robot, peer, capability, context
            )
            action = {"task_id": context, "action_id": f"{context}/{len(rows)}", "capability": capability}
            rows.append(event("ExecutionStarted", 5, robot=robot, on_behalf_of=peer, ends_us=9, **action))
        runs.append(run(*rows, run_id=f"r{seed}"))
    assert set(expected.values()) == set(trust.SCOPES)
    with from_rows([one for rows in runs for one in rows]) as database:
        direct = {
            (one["run_id"], one["seq"]): one["is_direct"] for one in database.query("facts/delegated_trust").to_pylist()
        }
        assert direct == {(run_id, seq): expected[(run_id, *about)] != "none" for (run_id, seq), about in began.items()}
        for capability, context in ((DOOR, "t1"), (DOOR, "t2"), (LIFT, "t1"), (LIFT, "t2")):
            found = database.query("audit/trust_at", {"capability": capability, "context": context}).to_pylist()
            scopes = {(one["run_id"], one["robot"], one["peer"]): one["trust_scope"] for one in found}
            assert len(scopes) == len(found)
            for (run_id, robot, peer, *about), scope in expected.items():
                if about == [capability, context]:
                    assert scopes.get((run_id, robot, peer), "none") == scope, (run_id, robot, peer, *about)


def of_roles(scope: TrustScope, **about: Any) -> RoleTrustSet:
    """Every B trusts every A."""
    return RoleTrustSet(role="B", peer_role="A", scope=scope, **about)


@pytest.mark.parametrize(
    ("entries", "scope"),
    [
        ((of_roles("task"),), "task"),
        ((RoleTrustSet(role="A", peer_role="B", scope="task"),), "none"),
        ((past.trusted(B, A, "none"), of_roles("task")), "none"),
        ((past.trusted(B, A, "none", LIFT), of_roles("task")), "task"),
        ((of_roles("session", domain="hall"), of_roles("task", capability=DOOR, context="t1")), "session"),
        ((of_roles("session", domain="yard"), of_roles("task")), "task"),
        ((of_roles("session", domain="hal"), of_roles("task")), "task"),
        ((of_roles("task", capability=DOOR), of_roles("none")), "task"),
    ],
)
def test_the_pair_goes_before_its_roles_and_the_smaller_domain_before_the_larger(
    entries: tuple[Event, ...], scope: str
) -> None:
    joined = (past.joined(A, "A", domain="hall/cell"), past.joined(B, "B", domain="hall"))
    state = folded([*joined, *entries])
    assert trust.scope_of(state, B, A, DOOR, "t1") == scope
    rows = run(*(row(one) for one in (*joined, *entries)))
    with from_rows(rows) as database:
        found = database.query("audit/trust_at", {"robot": "robot/B1", "capability": DOOR, "context": "t1"}).to_pylist()
    assert [one["trust_scope"] for one in found] == ([] if scope == "none" and len(entries) == 1 else [scope])


def test_a_robot_that_is_no_member_is_trusted_only_by_name() -> None:
    state = folded(
        [MEMBERS[0], RoleTrustSet(role="A", peer_role="A", scope="task"), past.trusted(A, Robot("robot/X9"), "session")]
    )
    assert trust.scope_of(state, A, Robot("robot/X9")) == "session"
    assert trust.scope_of(state, A, Robot("robot/X8")) == "none"
    assert trust.scope_of(state, Robot("robot/X9"), A) == "none"


@pytest.mark.parametrize("fleet_size", [4, 16])
def test_the_trust_of_a_fleet_is_six_entries_whatever_its_size(fleet_size: int) -> None:
    rows = run(*(row(one) for one in founding(fleet_size)))
    assert len(answer("facts/trust_precedence", rows)) == len(answer("facts/trust_in_force", rows)) == 6
    assert len(answer("facts/trust_parties", rows)) == 3 * fleet_size
    assert len(answer("audit/trust_at", rows)) == 6 * (fleet_size // 4) ** 2, "of pairs only where pairs are asked for"


def test_no_trust_is_in_force_before_both_robots_are_members() -> None:
    rows = run(
        event("RobotJoined", 0, robot="robot/B1", role="B", team=1, domain=""),
        event("RoleTrustSet", 5, role="B", peer_role="A", scope="task", domain=""),
        event("RobotJoined", 20, robot="robot/A1", role="A", team=1, domain=""),
    )
    with from_rows(rows) as database:

        def trusted(at_us: int) -> list[tuple[str, int]]:
            return [
                (row["peer"], row["since_us"])
                for row in database.query("audit/trust_at", {"at_us": str(at_us)}).to_pylist()
            ]

        assert (trusted(19), trusted(20), trusted(99)) == ([], [("robot/A1", 20)], [("robot/A1", 20)])


def test_a_robot_that_is_recorded_as_joining_twice_is_one_member_as_in_the_state() -> None:
    joined = [past.joined(B, "A", domain="hall"), past.joined(A, "A"), past.joined(B, "B", 2, domain="yard")]
    state = fold(joined)
    rows = run(*(row(one, number) for number, one in enumerate(joined)))
    members = answer("facts/fleet_members", rows, columns=("robot", "role", "team", "domain", "joined_us"))
    of_state = [(name, robot.role, robot.team, robot.domain) for name, robot in state.fleet.robots.items()]
    assert sorted((*known, 0 if known[0] == "robot/B1" else 1) for known in of_state) == sorted(
        (*member[:3], member[3] or "", member[4]) for member in members
    )
    assert (len(answer("audit/robot_activity", rows)), len(answer("audit/policy_at", rows))) == (2, 4)
