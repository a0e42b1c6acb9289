"""What grows with the fleet: floors and crowding, load and founding."""

from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from fsar_ledger.base.errors import InvalidExperiment
from fsar_ledger.designs.constants import Constants, Load, WorldConstants
from fsar_ledger.events import Event
from fsar_ledger.events.configuration import PAPER_ARCHITECTURES
from fsar_ledger.events.envelope import Architecture, Robot, Scenario
from fsar_ledger.events.fleet import RobotJoined
from fsar_ledger.events.policy import PolicyRuleSet, RolePolicyRuleSet
from fsar_ledger.events.task import TaskAbandoned
from fsar_ledger.events.trust import RoleTrustSet
from fsar_ledger.events.world import ObstructionAppeared, PeersMet, RoutineDue, TaskArrived
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.store import staging
from fsar_ledger.ledger.verify import verify
from fsar_ledger.projections.fold import fold
from fsar_ledger.projections.policy import ruled
from fsar_ledger.runtime.experiment import Experiment, run_experiment
from fsar_ledger.runtime.handlers.attribution import nearest_first
from fsar_ledger.runtime.simulation import SCENARIOS, RunSpec, run_id, run_started, simulate_run
from fsar_ledger.runtime.world import founding
from fsar_ledger.runtime.world.schedule import schedule

WORLD = WorldConstants()


def facts(
    fleet_size: int, load: Load | None = None, world: WorldConstants = WORLD, run: int = 0
) -> list[tuple[int, Event]]:
    return list(schedule(Constants(world, load=load), 5, "fleet-contention", run, fleet_size))


def of(kind: type[Event], found: list[tuple[int, Event]]) -> list[Any]:
    return [event for _, event in found if isinstance(event, kind)]


def made(
    architecture: Architecture,
    scenario: Scenario,
    fleet_size: int,
    load: Load | None = None,
    configuration: Any = "full",
) -> LedgerRun:
    return simulate_run(RunSpec(42, architecture, configuration, scenario, fleet_size, 0), Constants(load=load))


# --- places ---


def test_the_fleet_of_four_has_one_place_and_nobody_in_its_way_beyond_its_own() -> None:
    assert {event.place for event in founding(4) if isinstance(event, RobotJoined)} == {None}
    assert not any(
        event.obstruction.startswith("crowding/")
        for run in range(20)
        for event in of(ObstructionAppeared, facts(4, run=run))
    )


def test_a_larger_fleet_spreads_over_floors_and_robots_meet_where_they_are() -> None:
    places = {event.robot: event.place for event in founding(40) if isinstance(event, RobotJoined)}
    assert Counter(places.values()) == {"floor/1": 16, "floor/2": 16, "floor/3": 8}
    meetings = of(PeersMet, facts(40))
    assert {(places[event.robot], places[event.peer]) for event in meetings} == {
        (floor, floor) for floor in set(places.values())
    }
    assert 2 * 120 + 28 > len({(event.robot, event.peer) for event in meetings}) > 200, "of 780 pairs those of a floor"


def test_robots_of_other_teams_on_the_floor_are_in_the_way_as_often_as_there_are_more_of_them() -> None:
    def crowding(fleet_size: int) -> float:
        found = [
            event
            for run in range(20)
            for event in of(ObstructionAppeared, facts(fleet_size, run=run))
            if event.obstruction.startswith("crowding/")
        ]
        return len(found) / 20 / fleet_size / WORLD.horizon_s

    assert crowding(8) == pytest.approx(4 * WORLD.crowding_rate_per_s, rel=0.15)
    assert crowding(16) == pytest.approx(12 * WORLD.crowding_rate_per_s, rel=0.15)
    assert crowding(32) == pytest.approx(12 * WORLD.crowding_rate_per_s, rel=0.15), "two floors of sixteen"


def test_candidates_are_of_the_own_team_then_of_the_floor_then_of_other_floors() -> None:
    state = fold(founding(32))
    doors = [Robot(f"robot/B{team}") for team in range(1, 9)]
    order = [int(name[7:]) for name in nearest_first(state.fleet, doors, Robot("robot/A3"))]
    assert order == [3, 1, 2, 4, 5, 6, 7, 8]
    assert [int(name[7:]) for name in nearest_first(fold(founding(16)).fleet, doors[:4], Robot("robot/A3"))] == [
        3,
        1,
        2,
        4,
    ], "one floor"


# --- load ---


def test_only_teams_that_work_have_tasks_and_routine_and_all_else_stays_as_it_is() -> None:
    every, two = facts(16), facts(16, Load(2))
    assert {event.team for event in of(TaskArrived, two)} == {1, 2}
    assert {event.robot[7:] for event in of(RoutineDue, two)} == {"1", "2"}
    of_a_robot = [event for event in two if not isinstance(event[1], RoutineDue | TaskArrived)]
    assert {repr(event) for _, event in two} < {repr(event) for _, event in every}
    assert {getattr(event, "robot", "") for _, event in of_a_robot} >= {
        event.robot for event in founding(16) if isinstance(event, RobotJoined)
    }


def test_more_sets_of_tasks_come_after_the_first_and_leave_it_alone() -> None:
    first, both = of(TaskArrived, facts(8)), of(TaskArrived, facts(8, Load(task_sets=2)))
    assert [event for event in both if event in first] == first
    later = {event.task_id: event for event in both if event not in first}
    assert len(later) == len(first)
    assert {event.steps for event in later.values()} == {event.steps for event in first}
    assert later["A1-5"].due_us - first[0].due_us == pytest.approx(30_000_000, abs=60_000_000)


def test_another_load_is_another_run_of_the_same_world() -> None:
    spec = RunSpec(1, "fsar", "full", "door-relay", 8, 0)
    names = {run_id(run_started(spec, Constants(load=load))) for load in (None, Load(1), Load(task_sets=2))}
    assert len(names) == 3
    assert "load" not in (run_started(spec, Constants()).parameters or "load")


@pytest.mark.parametrize(
    ("fleet_size", "constants", "message"),
    [
        (8, Constants(load=Load(3)), "teams working: found 3, expected 1 to 2, the teams of a fleet of 8"),
        (8, Constants(load=Load(0)), "teams working: found 0"),
        (8, Constants(load=Load(task_sets=0)), "task sets: found 0, expected 1 to 5"),
        (8, Constants(load=Load(task_sets=6)), "task sets: found 6, expected 1 to 5, one each 30 s"),
        (8, Constants(load=Load(interval_s=0.0)), "interval of task sets: found 0.0 s"),
        (8, Constants(WorldConstants(floor_teams=0)), "teams of a floor: found 0, expected at least 1"),
    ],
)
def test_an_impossible_load_or_floor_is_refused_with_what_was_found(
    fleet_size: int, constants: Constants, message: str
) -> None:
    with pytest.raises(InvalidExperiment, match=message):
        Experiment(PAPER_ARCHITECTURES, SCENARIOS, 1, fleet_size=fleet_size, constants=constants)


# --- founding ---


def test_the_founding_of_a_thousand_robots_grows_with_the_robots_and_not_with_their_pairs() -> None:
    for fleet_size in (4, 16, 1024):
        events = founding(fleet_size)
        assert len(events) == 7 * fleet_size + 6 + 1  # trust of three pairs of roles both ways, and its thresholds
        assert sum(isinstance(event, RoleTrustSet) for event in events) == 6
    state = fold(founding(1024))
    assert (len(state.fleet.robots), len(state.trust.entries), len(state.trust.of_roles)) == (1024, 0, 6)


def test_the_rules_of_a_thousand_robots_are_as_many_as_its_roles_and_exceptions() -> None:
    exception = PolicyRuleSet(
        scope="fleet", robot=Robot("robot/B7"), capability=None, context=None, outcome="allow", decided_by=None
    )
    state = fold((RolePolicyRuleSet(scope="fleet", role="B", outcome="deny"), *founding(1024), exception))
    assert (len(state.policy.of_roles), len(state.policy.rules)) == (1, 1)
    outcomes = Counter(ruled(state.policy, "fleet", robot, "door.open.secure", None) for robot in state.fleet.robots)
    assert outcomes == {None: 768, "deny": 255, "allow": 1}


# --- runs of large fleets ---


@pytest.mark.parametrize("architecture", PAPER_ARCHITECTURES)
def test_a_fleet_of_256_with_all_its_tasks_comes_to_an_end(architecture: Architecture) -> None:
    load = None if architecture == "cfc" else Load(8)
    record = made(architecture, "door-relay", 256, load)
    assert max(record.times_us) < 600_000_000
    if architecture == "cfc":
        given_up = sum(isinstance(event, TaskAbandoned) for event in record.events)
        assert given_up > 100, "one coordinator for 64 teams"


@pytest.mark.slow
@pytest.mark.parametrize("architecture", PAPER_ARCHITECTURES)
def test_a_fleet_of_a_thousand_robots_is_simulated_and_stored(tmp_path: Path, architecture: Architecture) -> None:
    experiment = Experiment(
        (architecture,), ("fleet-contention",), 1, fleet_size=1024, constants=Constants(load=Load(4))
    )
    assert run_experiment(tmp_path / "ledger", experiment, workers=1).head.size > 50_000


def test_what_one_segment_cannot_hold_is_staged_in_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    experiment = Experiment(PAPER_ARCHITECTURES, ("door-relay",), 1)
    whole = run_experiment(tmp_path / "whole", experiment, workers=1).head
    monkeypatch.setattr(staging, "MAX_ROWS", 500)
    parts = run_experiment(tmp_path / "parts", experiment, workers=1).head
    assert (parts.size, parts.root) == (whole.size, whole.root)
    assert parts.commits > whole.commits
    assert verify(tmp_path / "parts").ok
