"""What the paper's text places into a scenario happens in it. Paper: sec:evaluation:scenarios."""

from collections.abc import Iterator
from functools import cache
from typing import TypeVar

import pytest

from fsar_ledger.designs.constants import Constants
from fsar_ledger.events import Event
from fsar_ledger.events.configuration import PAPER_ARCHITECTURES
from fsar_ledger.events.envelope import COORDINATOR, FLEET_SUPERVISOR, TRUST, Architecture, Robot, Scenario, agent
from fsar_ledger.events.request import RequestDenied, RequestUnanswered, SegmentTransferred
from fsar_ledger.events.supervision import SupervisorCalled, SupervisorResponded
from fsar_ledger.events.task import StepBegan
from fsar_ledger.events.trust import TrustSet
from fsar_ledger.runtime.simulation import RunSpec, simulate_run

E = TypeVar("E", bound=Event)
RUNS = 10


@cache
def played(scenario: Scenario, architecture: Architecture = "fsar", configuration: str = "full") -> list[list[Event]]:
    specs = [RunSpec(7, architecture, configuration, scenario, 4, run) for run in range(RUNS)]
    return [list(simulate_run(spec, Constants()).events) for spec in specs]


def every(runs: list[list[Event]], kind: type[E]) -> Iterator[E]:
    return (one for run in runs for one in run if isinstance(one, kind))


def calls_of(run: list[Event]) -> list[SupervisorCalled]:
    """The calls to order two requests."""
    return [one for one in run if isinstance(one, SupervisorCalled) and one.purpose == "ordering"]


def test_in_scenario_5_the_fleet_supervisor_orders_requests_that_compete_with_the_time_critical_delivery() -> None:
    runs = played("fleet-contention")
    calls = [one for run in runs for one in calls_of(run)]
    assert calls
    assert {one.supervisor for one in calls} == {FLEET_SUPERVISOR}
    for run in runs:
        over = set[str | None]()
        for one in run:
            if isinstance(one, RequestDenied | RequestUnanswered):
                over.add(one.subject.action_id)
            if isinstance(one, SupervisorResponded) and one.purpose == "ordering":
                [call] = [call for call in calls_of(run) if call.subject == one.subject]
                delivery = {str(call.competing), call.subject.action_id} - {one.preferred}
                assert str(one.preferred).startswith("A1-1/") or delivery <= over, "the delivery goes first"
    for scenario in ("door-relay", "collaborative-delivery"):
        assert not [one for run in played(scenario) for one in calls_of(run)]


@pytest.mark.parametrize(
    ("architecture", "path"),
    [
        ("fsar", (Robot("robot/A1"),)),
        ("cfc", (COORDINATOR,)),
        ("dhma", (agent(Robot("robot/A1"), "planning"), agent(Robot("robot/A1"), "communication"))),
    ],
)
def test_in_scenario_2_a_segment_of_the_task_is_transferred_by_whoever_decides(
    architecture: Architecture, path: tuple[str, ...]
) -> None:
    runs = played("collaborative-delivery", architecture)
    there = [one for one in every(runs, SegmentTransferred) if one.robot == "robot/D1"]
    assert {one.principals.path for one in there} == {path}
    assert {one.principals.requested_by for one in there} == {None if architecture == "cfc" else "robot/A1"}


@pytest.mark.parametrize("architecture", PAPER_ARCHITECTURES)
def test_no_robot_begins_a_segment_before_it_was_transferred_to_it(architecture: Architecture) -> None:
    for scenario in ("collaborative-delivery", "failure-recovery-chain", "mixed-trust-inspection"):
        for run in played(scenario, architecture):
            acting: dict[str, str] = {}
            for one in run:
                if isinstance(one, SegmentTransferred):
                    acting[one.task_id] = one.robot
                if isinstance(one, StepBegan):
                    assert acting.setdefault(one.subject.task_id, one.robot) == one.robot


def test_trust_is_updated_after_coordination_events_and_stays_as_founded_without_that_mechanism() -> None:
    """Paper: sec:evaluation:simulator."""
    moved = list(every(played("door-relay"), TrustSet))
    assert moved
    assert {(one.decided_by, one.reason) for one in moved} == {(TRUST, "record")}
    assert not list(every(played("door-relay", configuration="without-trust-by-record"), TrustSet))
