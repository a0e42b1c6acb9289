"""The registry answers who may be asked and why nobody else."""

from typing import Any

import pytest

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Robot, Subject
from fsar_ledger.events.execution import ExecutionQueued
from fsar_ledger.events.registry import CapabilityDeprecated, CapabilityWithdrawn
from fsar_ledger.runtime.handlers.candidates import Query, candidates
from tests import past
from tests.runtime.histories import DOOR, A, B, given, window

E1 = Robot("robot/E1")
ASKING = Query(A, DOOR, "A1-1")


def why_not(*events: Event, **fields: Any) -> tuple[str, ...]:
    """The filters that leave robot B1 out of the answer to A1 after these events; none when it is the candidate."""
    query = Query(A, "door.open.secure", fields.pop("context", "A1-1"), **fields)
    answer = candidates(given("fsar", *events), query)
    assert set(answer.rejected) | set(answer.candidates) == {"robot/B1"}
    return answer.rejected_by


def test_the_candidate_is_who_offers_it_and_trusts_the_requester() -> None:
    answer = candidates(given("fsar"), ASKING)
    assert (answer.candidates, answer.capabilities, answer.rejected) == (("robot/B1",), ("door.open.secure",), ())
    assert (answer.domain, answer.as_of_us) == ("", None)


def test_the_requester_itself_is_neither_candidate_nor_rejected() -> None:
    answer = candidates(given("fsar"), Query(B, "door.open.secure"))
    assert (answer.candidates, answer.rejected) == ((), ())


@pytest.mark.parametrize(
    ("events", "asked", "by"),
    [
        ((past.advertised(B, DOOR, visible_to=("C",)),), {}, "visibility"),
        ((past.advertised(B, DOOR, visibility="trust-gated"), past.trusted(B, A, "none")), {}, "visibility"),
        ((), {"version": "^2.0"}, "version"),
        ((past.advertised(B, DOOR, preconditions=("badge.shown",)),), {"provides": ()}, "contract"),
        ((past.advertised(B, DOOR, resources=("arm",)),), {"resources": ("gripper",)}, "contract"),
        ((), {"needs": ("door.opened",)}, "contract"),
        ((past.trusted(B, A, "none"),), {}, "trust"),
        ((past.advertised(B, DOOR, trust_required="session"),), {}, "trust"),
        ((past.advertised(B, DOOR, policy_required=("delivery",)),), {}, "policy"),
        ((past.ruled("deny", B, "door.open.secure"),), {}, "policy"),
        ((), {"override": "emergency-only"}, "authority"),
        ((past.available(B, None, "offline", "charging"),), {}, "availability"),
        ((past.available(B, "door.open.secure", "restricted", "roll-out"),), {}, "availability"),
        ((), {"embodiment": ("arm",)}, "embodiment"),
    ],
)
def test_each_filter_rejects_and_is_named(events: tuple[Event, ...], asked: dict[str, Any], by: str) -> None:
    assert why_not(*events, **asked) == (by,)


@pytest.mark.parametrize(
    ("events", "asked"),
    [
        ((past.advertised(B, DOOR, visible_to=("C", "A")),), {}),
        ((past.advertised(B, DOOR, visibility="trust-gated"),), {}),
        ((past.advertised(B, DOOR, version="1.9.3"),), {"version": "^1.2"}),
        ((past.advertised(B, DOOR, preconditions=("badge.shown",)),), {"provides": ("badge.shown", "door.closed")}),
        ((past.advertised(B, DOOR, preconditions=("badge.shown",)),), {}),
        ((past.advertised(B, DOOR, resources=("arm",)),), {"resources": ("gripper", "arm")}),
        ((past.advertised(B, DOOR, postconditions=("door.opened", "door.logged")),), {"needs": ("door.opened",)}),
        ((past.advertised(B, DOOR, trust_required="task"),), {}),
        ((past.advertised(B, DOOR, policy_required=("delivery",)),), {"context": "delivery"}),
        ((past.ruled("review", B, "door.open.secure"),), {}),
        ((past.ruled("deny", B, "door.open.basic"),), {}),
        ((window(B),), {}),
        ((), {"override": "hard-preempt"}),
        ((past.advertised(B, DOOR, override_allowed="soft-priority"),), {"override": "emergency-only"}),
        ((past.available(B, "door.open.basic", "offline", "jammed"),), {}),
        ((past.advertised(B, DOOR, embodiment=("arm", "wheels")),), {"embodiment": ("arm",)}),
    ],
)
def test_what_no_filter_rejects_is_a_candidate(events: tuple[Event, ...], asked: dict[str, Any]) -> None:
    assert why_not(*events, **asked) == ()


def test_of_several_filters_the_first_in_their_order_is_named() -> None:
    distrust = past.trusted(B, A, "none")
    offline = past.available(B, None, "offline", "charging")
    assert why_not(distrust, offline, version="^2") == ("version",)
    assert why_not(distrust, offline) == ("trust",)
    assert why_not(offline) == ("availability",)


def test_without_trust_evaluation_nobody_hides_and_nobody_distrusts() -> None:
    events = (past.advertised(B, DOOR, visible_to=("C",)), past.trusted(B, A, "none"))
    assert candidates(given("fsar", *events, configuration="without-trust-evaluation"), ASKING).candidates == (
        "robot/B1",
    )


def second(robot: Robot = E1, version: str = "1.0.0", domain: str = "", **fields: Any) -> tuple[Event, ...]:
    """Another robot that can open the door and trusts A1."""
    return (
        past.joined(robot, "B", domain=domain),
        past.installed(robot, "door.open.secure", version),
        past.advertised(robot, DOOR, version=version, **fields),
        past.trusted(robot, A, "task"),
    )


def busy(robot: Robot) -> ExecutionQueued:
    return past.queued(Subject("t", "t/1"), robot, robot, "navigate.indoor", principals=past.parties())


def test_ready_robots_come_before_busy_ones_before_degraded_ones() -> None:
    both = second()
    assert candidates(given("fsar", *both), ASKING).candidates == ("robot/B1", "robot/E1")
    assert candidates(given("fsar", *both, busy(B)), ASKING).candidates == ("robot/E1", "robot/B1")
    found = candidates(given("fsar", *both, past.available(B, None, "busy", "charging")), ASKING).candidates
    assert found == ("robot/E1", "robot/B1")
    degraded = past.available(Robot("robot/E1"), None, "degraded", "actuator")
    assert candidates(given("fsar", *both, busy(B), degraded), ASKING).candidates == ("robot/B1", "robot/E1")


def test_a_deprecated_version_is_shown_only_when_no_other_satisfies_the_query() -> None:
    deprecated = CapabilityDeprecated(robot=B, capability="door.open.secure", version="1.0.0", successor="2.0.0")
    alone = candidates(given("fsar", deprecated), ASKING)
    assert alone.candidates == ("robot/B1",)
    beside = candidates(given("fsar", *second(version="2.0.0"), deprecated), ASKING)
    assert (beside.candidates, beside.rejected, beside.rejected_by) == (("robot/E1",), ("robot/B1",), ("version",))
    wanted = Query(A, "door.open.secure", version="1.0.0")
    assert candidates(given("fsar", *second(version="2.0.0"), deprecated), wanted).candidates == ("robot/B1",)


def test_a_group_of_capabilities_matches_each_name_in_it_once_per_robot() -> None:
    answer = candidates(given("fsar"), Query(A, "door.*"))
    assert (answer.candidates, answer.capabilities) == (("robot/B1",), ("door.open.basic",))
    assert candidates(given("fsar"), Query(A, "doo.*")).candidates == ()
    refusing = CapabilityWithdrawn(B, "door.open.basic", "jammed"), past.advertised(B, DOOR, visible_to=("C",))
    assert candidates(given("fsar", *refusing), Query(A, "door.*")).rejected_by == ("visibility",)


def test_a_robot_that_matches_twice_is_rejected_by_the_filter_that_its_best_record_came_to() -> None:
    answer = candidates(
        given(
            "fsar",
            past.advertised(B, "door.open.basic", visible_to=("C",)),
            past.advertised(B, DOOR, availability="offline"),
        ),
        Query(A, "door.*"),
    )
    assert (answer.candidates, answer.rejected, answer.rejected_by) == ((), ("robot/B1",), ("availability",))


def test_a_robot_that_one_filter_leaves_out_for_one_capability_may_be_a_candidate_for_another() -> None:
    answer = candidates(given("fsar", past.advertised(B, "door.open.basic", visible_to=("C",))), Query(A, "door.*"))
    assert (answer.candidates, answer.capabilities, answer.rejected) == (("robot/B1",), ("door.open.secure",), ())


def test_of_a_group_what_is_deprecated_gives_way_and_comes_last() -> None:
    ageing = CapabilityDeprecated(robot=B, capability="door.open.basic", version="1.0.0")
    assert candidates(given("fsar", ageing), Query(A, "door.*")).capabilities == ("door.open.secure",)
    events = (ageing, CapabilityWithdrawn(B, "door.open.secure", "jammed"), *second())
    assert candidates(given("fsar", *events), Query(A, "door.*")).candidates == ("robot/E1", "robot/B1")


def test_a_limited_search_goes_on_past_what_is_deprecated() -> None:
    events = (*second(), CapabilityDeprecated(robot=B, capability="door.open.secure", version="1.0.0"))
    answer = candidates(given("fsar", *events), Query(A, "door.open.secure", limit=1))
    assert (answer.candidates, answer.rejected_by) == (("robot/E1",), ("version",))
