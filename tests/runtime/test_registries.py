"""Registries of domains, copies and queries from outside, and any registry against its laws."""

import pytest
from hypothesis import given as forall
from hypothesis import settings
from hypothesis import strategies as st
from msgspec.structs import replace

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Robot, Supervisor
from fsar_ledger.events.fleet import RobotJoined
from fsar_ledger.events.registry import CapabilityDeprecated, CapabilityWithdrawn, RegistryCached, RegistryConsulted
from fsar_ledger.events.trust import TrustSet
from fsar_ledger.projections.fold import State, apply, fold
from fsar_ledger.projections.registry import advertisement
from fsar_ledger.runtime.handlers.candidates import FILTERS, Query, candidates, rejecting_filter
from fsar_ledger.runtime.handlers.registry import CacheRegistry, ConsultRegistry, consult_registry
from tests import past
from tests.runtime.histories import DOOR, A, B, given, started, types
from tests.runtime.live import decided, refusal
from tests.runtime.test_registry import ASKING, busy, second
from tests.sure import known

HALL = (
    *second(Robot("robot/E1"), domain="hall/north"),
    *second(Robot("robot/F1"), domain="hall/north/cell"),
    *second(Robot("robot/G1"), domain="hall/south"),
)


MEMBER = RobotJoined(robot=A, role="A", team=1, supervisor=Supervisor("supervisor/A1"))


def from_domain(domain: str, *events: Event) -> State:
    """The fleet of four and the hall, where A1 is in this domain."""
    founding = started("fsar")
    moved = [
        RobotJoined(robot=A, role="A", team=1, supervisor=Supervisor("supervisor/A1"), domain=domain)
        if event == MEMBER
        else event
        for event in founding
    ]
    assert moved.count(MEMBER) == (not domain)
    return fold((*moved, *HALL, *events))


@pytest.mark.parametrize(
    ("domain", "answering", "found"),
    [
        ("hall/north/cell", "hall/north/cell", ("robot/F1",)),
        ("hall/north", "hall/north", ("robot/E1", "robot/F1")),
        ("hall/south/cell", "hall/south", ("robot/G1",)),
        ("hall", "hall", ("robot/E1", "robot/F1", "robot/G1")),
        ("yard", "", ("robot/B1", "robot/E1", "robot/F1", "robot/G1")),
        ("", "", ("robot/B1", "robot/E1", "robot/F1", "robot/G1")),
    ],
)
def test_the_nearest_registry_around_the_requester_that_has_a_candidate_answers(
    domain: str, answering: str, found: tuple[str, ...]
) -> None:
    answer = candidates(from_domain(domain), ASKING)
    assert (answer.domain, answer.candidates) == (answering, found)


def test_a_registry_without_a_candidate_hands_the_query_on_with_its_rejections() -> None:
    distrust = past.trusted(Robot("robot/F1"), A, "none")
    answer = candidates(from_domain("hall/north/cell", distrust), ASKING)
    assert (answer.domain, answer.candidates, answer.rejected) == ("hall/north", ("robot/E1",), ("robot/F1",))
    assert answer.rejected_by == ("trust",)


def test_what_is_scoped_to_a_domain_is_visible_there_and_below_only() -> None:
    scoped = past.advertised(Robot("robot/E1"), DOOR, visibility="domain")
    for domain, is_seen in (
        ("hall/north", True),
        ("hall/north/cell", True),
        ("hall", False),
        ("hall/northern", False),
        ("", False),
    ):
        state = from_domain(domain, scoped)
        record = known(advertisement(state.registry, Robot("robot/E1"), "door.open.secure"))
        assert (rejecting_filter(state, ASKING, record) is None) == is_seen, domain
    fleetwide = given("fsar", past.advertised(B, DOOR, visibility="domain"))
    assert candidates(fleetwide, ASKING).candidates == ("robot/B1",)


def test_a_limited_search_ends_at_so_many_that_are_ready() -> None:
    def limited(limit: int, *events: Event) -> tuple[tuple[str, ...], tuple[str, ...]]:
        answer = candidates(from_domain("hall", *events), Query(A, "door.open.secure", limit=limit))
        return answer.candidates, answer.rejected

    assert limited(1) == (("robot/E1",), ())
    assert limited(2) == (("robot/E1", "robot/F1"), ())
    assert limited(9) == (("robot/E1", "robot/F1", "robot/G1"), ())
    assert limited(1, busy(Robot("robot/E1"))) == (("robot/F1",), ())
    assert limited(1, past.trusted(Robot("robot/E1"), A, "none")) == (("robot/F1",), ("robot/E1",))
    assert limited(1, past.trusted(Robot("robot/G1"), A, "none")) == (("robot/E1",), ()), "G1 was not looked at"


def test_a_copy_answers_with_the_offers_of_its_time_and_says_how_old_it_is() -> None:
    state = given("fsar", RegistryCached(A, 5_000_000), CapabilityWithdrawn(B, "door.open.secure", "jammed"))
    assert candidates(state, ASKING).candidates == ()
    copied = candidates(state, ASKING, A)
    assert (copied.candidates, copied.as_of_us) == (("robot/B1",), 5_000_000)
    apply(state, past.trusted(B, A, "none"))
    assert candidates(state, ASKING, A).rejected_by == ("trust",), "trust is that of now"


def test_that_a_robot_executes_just_now_is_in_no_copy() -> None:
    state = given("fsar", *second(), RegistryCached(A, 5), busy(B))
    assert candidates(state, ASKING, A).candidates == ("robot/B1", "robot/E1")
    assert candidates(state, ASKING).candidates == ("robot/E1", "robot/B1")


def test_a_query_from_outside_is_answered_and_recorded_with_its_rejections() -> None:
    state = given("fsar", *second(trust_required="persistent"))
    [answer] = decided(state, ConsultRegistry(ASKING))
    assert answer == RegistryConsulted(
        requested_by=A,
        capability="door.open.secure",
        candidates=(B,),
        rejected=(Robot("robot/E1"),),
        rejected_by=("trust",),
        domain="",
        as_of_us=None,
    )


def test_that_nobody_offers_it_is_an_answer() -> None:
    [answer] = decided(given("fsar"), ConsultRegistry(Query(A, "teleport")))
    assert answer == RegistryConsulted(
        requested_by=A, capability="teleport", candidates=(), rejected=(), rejected_by=()
    )


def test_a_copy_is_taken_and_asked() -> None:
    state = given("fsar")
    [cached] = decided(state, CacheRegistry(A, now_us=7))
    assert cached == RegistryCached(A, 7)
    apply(state, cached)
    [answer] = decided(state, ConsultRegistry(ASKING, A, now_us=9))
    assert (answer.candidates, answer.as_of_us) == (("robot/B1",), 7)  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        (ConsultRegistry(Query(Robot("robot/Z9"), "door.open.secure")), "unknown robot robot/Z9"),
        (ConsultRegistry(ASKING, Robot("robot/Z9")), "unknown robot robot/Z9"),
        (ConsultRegistry(ASKING, A), "no copy"),
        (ConsultRegistry(Query(A, "")), "no name"),
        (ConsultRegistry(Query(A, ".*")), "no name"),
        (ConsultRegistry(Query(A, "door*")), "no name"),
        (ConsultRegistry(Query(A, "door.open.secure", version="~1")), "no range"),
        (ConsultRegistry(Query("robot/A1", "door.open.secure", override="total")), "unknown"),  # type: ignore[arg-type]
        (ConsultRegistry(Query(A, "door.open.secure", limit=0)), "limit 0"),
    ],
)
def test_a_query_that_cannot_be_asked_is_rejected(command: ConsultRegistry, reason: str) -> None:
    assert reason in refusal(consult_registry(given("fsar"), command))


def test_a_copy_for_nobody_is_rejected() -> None:
    assert types(decided(given("fsar"), CacheRegistry(Robot("robot/Z9")))) == ["CommandRejected"]


ROBOTS = tuple(Robot(f"robot/{letter}{team}") for letter in "EFGHK" for team in (1, 2))
RECORDS = st.builds(
    past.advertised,
    st.sampled_from(ROBOTS),
    st.sampled_from(("door.open.secure", "door.open.wide", "lift")),
    version=st.sampled_from(("1.0.0", "1.4.0", "2.0.0")),
    visible_to=st.sampled_from(((), ("A",), ("C",))),
    visibility=st.sampled_from(("global", "domain", "trust-gated")),
    preconditions=st.sampled_from(((), ("badge",))),
    trust_required=st.sampled_from(("capability", "session")),
    policy_required=st.sampled_from(((), ("A1-1",), ("other",))),
    override_allowed=st.sampled_from(("none", "emergency-only")),
    availability=st.sampled_from(("ready", "busy", "degraded", "restricted", "offline")),
    embodiment=st.sampled_from(((), ("arm",))),
)
CHANGES = st.one_of(
    RECORDS,
    st.builds(
        TrustSet,
        robot=st.sampled_from(ROBOTS),
        peer=st.just("robot/A1"),
        scope=st.sampled_from(("none", "capability", "persistent")),
    ),
    st.builds(
        CapabilityDeprecated,
        robot=st.sampled_from(ROBOTS),
        capability=st.just("door.open.secure"),
        version=st.sampled_from(("1.0.0", "1.4.0")),
    ),
    st.builds(CapabilityWithdrawn, st.sampled_from(ROBOTS), st.just("door.open.secure"), st.just("jammed")),
    st.sampled_from(ROBOTS).map(busy),
)
QUERIES = st.builds(
    Query,
    st.just("robot/A1"),
    st.sampled_from(("door.open.secure", "door.*")),
    st.just("A1-1"),
    version=st.sampled_from(("", "^1.0", ">=1.4")),
    provides=st.sampled_from((None, (), ("badge",))),
    override=st.sampled_from(("none", "emergency-only")),
    embodiment=st.sampled_from(((), ("arm",))),
)
DOMAINS = st.dictionaries(st.sampled_from(ROBOTS), st.sampled_from(("", "hall", "hall/north", "yard")))


def populated(changes: list[Event], domains: dict[str, str]) -> State:
    """A1 and ten more robots, each in its domain, after these changes."""
    joined = [past.joined(robot, robot[6], int(robot[7]), domain=domains.get(robot, "")) for robot in (A, *ROBOTS)]
    modules = [
        past.installed(robot, name) for robot in ROBOTS for name in ("door.open.secure", "door.open.wide", "lift")
    ]
    trusted = [past.trusted(robot, A, "task") for robot in ROBOTS]
    return fold((started("fsar")[0], *joined, *modules, *trusted, *changes))


@forall(st.lists(CHANGES, max_size=30), DOMAINS, st.sampled_from(("", "hall", "hall/north/cell")), QUERIES)
@settings(max_examples=150, deadline=None)
def test_every_match_is_candidate_or_rejected_once_and_no_candidate_fails_a_filter(
    changes: list[Event], domains: dict[str, str], at: str, query: Query
) -> None:
    state = populated(changes, {**domains, "robot/A1": at})
    answer = candidates(state, query)
    named = ("door.open.secure", "door.open.wide") if query.capability.endswith("*") else (query.capability,)
    within = [
        robot
        for robot in ROBOTS
        if f"{domains.get(robot, '')}/".startswith(f"{answer.domain}/" if answer.domain else "")
    ]
    records = {
        robot: [record for name in named if (record := advertisement(state.registry, robot, name))] for robot in within
    }
    assert sorted((*answer.candidates, *answer.rejected)) == sorted(robot for robot, found in records.items() if found)
    for robot, capability in zip(answer.candidates, answer.capabilities, strict=True):
        record = known(advertisement(state.registry, robot, capability))
        assert rejecting_filter(state, query, record) is None
    for robot, by in zip(answer.rejected, answer.rejected_by, strict=True):
        filters = [rejecting_filter(state, query, record) for record in records[robot]]
        is_superseded = by == "version" and any(record.is_deprecated for record in records[robot])
        assert is_superseded or (
            None not in filters and by == max((name for name in filters if name), key=FILTERS.index)
        )
    limited = candidates(
        state, Query(**{**{name: getattr(query, name) for name in query.__struct_fields__}, "limit": 1})
    )
    assert len(limited.candidates) == min(1, len(answer.candidates))
    assert limited.domain == answer.domain
    one_by_one, by_kind = (candidates(state, replace(query, limit=limit)) for limit in (len(ROBOTS) + 1, None))
    assert one_by_one == by_kind


@forall(st.lists(CHANGES, max_size=30), QUERIES)
@settings(max_examples=100, deadline=None)
def test_in_a_flat_fleet_the_registry_of_any_domain_answers_as_the_fleets_own(
    changes: list[Event], query: Query
) -> None:
    """Where every robot is in one domain, its depth changes nothing but the name of the registry that answers."""
    changes = [event for event in changes if getattr(event, "visibility", "") != "domain"]
    flat = candidates(populated(changes, {}), query)
    deep = candidates(populated(changes, dict.fromkeys(("robot/A1", *ROBOTS), "hall/north")), query)
    found = (flat.candidates, dict(zip(flat.rejected, flat.rejected_by, strict=True)))
    assert found == (deep.candidates, dict(zip(deep.rejected, deep.rejected_by, strict=True)))
    assert deep.domain == ("hall/north" if deep.candidates else "")
