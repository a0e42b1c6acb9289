"""Physics: what no way of governing can bend, stated over every architecture and judged by SQL over whole runs.

Rates of 0 and probabilities of 0 and 1 are legal constants of the world, and these are what many statements are made with.
"""

from functools import cache
from typing import get_args

import msgspec
import pytest

from fsar_ledger.constants import Constants, Range, WorldConstants
from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Architecture
from fsar_ledger.events.execution import ExecutionFailed, ExecutionPaused, RoutinePerformed, RoutineWithheld
from fsar_ledger.events.policy import PolicyConflictEscalated
from fsar_ledger.events.recovery import FailureResolved
from fsar_ledger.events.supervision import ActuatorServiced, SupervisorCalled
from fsar_ledger.events.world import ActuatorDegraded, PolicyWindowOpened
from fsar_ledger.ledger.codec import encode
from fsar_ledger.metrics.database import from_table
from fsar_ledger.metrics.results import metric_rows
from fsar_ledger.runtime.simulation import SCENARIOS, RunSpec, simulate_run

EVERY = pytest.mark.parametrize("architecture", get_args(Architecture))
RUNS = 3
QUIET = {"obstruction_rate_per_s": 0.0, "degradation_probability": 0.0}
LAWLESS = {"context_window_share": 0.0, "fleet_rule_rate_per_s": 0.0}


class Played(msgspec.Struct, frozen=True):
    """The runs of all scenarios in one world: their events, and their metrics by name."""

    events: tuple[tuple[Event, ...], ...]
    metrics: dict[str, float | None]


@cache
def _played(architecture: Architecture, world: WorldConstants) -> Played:
    constants = Constants(world=world)
    records = [simulate_run(RunSpec(5, architecture, "full", scenario, 4, run), constants) for scenario in SCENARIOS for run in range(RUNS)]
    with from_table(encode(records), threads=1) as database:
        found = {row.metric: row.mean for row in metric_rows(database)}
    return Played(tuple(tuple(record.events) for record in records), found)


def played(architecture: Architecture, **changes: object) -> Played:
    """The runs in a world of which only this differs from ours."""
    return _played(architecture, msgspec.structs.replace(WorldConstants(), **changes))


def of(events: tuple[tuple[Event, ...], ...], *types: type[Event]) -> list[Event]:
    """The events of these types, of all runs."""
    return [event for run in events for event in run if isinstance(event, types)]


@EVERY
def test_our_world_has_what_the_statements_take_away(architecture: Architecture) -> None:
    ours = played(architecture)
    for kind in (PolicyWindowOpened, ExecutionFailed, ActuatorDegraded, ExecutionPaused, RoutinePerformed, RoutineWithheld, SupervisorCalled):
        assert of(ours.events, kind), kind.__name__
    assert ours.metrics["coordination_success"] != 0
    assert ours.metrics["policy_violations"] != 0
    assert ours.metrics["recovery_containment"] is not None


@EVERY
def test_without_windows_and_rules_nothing_violates_a_policy(architecture: Architecture) -> None:
    free = played(architecture, **LAWLESS)
    assert of(free.events, PolicyWindowOpened) == []
    assert free.metrics["policy_violations"] == 0
    assert of(free.events, RoutineWithheld, PolicyConflictEscalated) == []


@EVERY
def test_without_failures_containment_and_latency_are_undefined(architecture: Architecture) -> None:
    whole = played(architecture, **QUIET)
    assert of(whole.events, ExecutionFailed, FailureResolved) == []
    assert whole.metrics["recovery_containment"] is None
    assert whole.metrics["reassignment_latency_s"] is None


@EVERY
def test_without_failures_and_reviews_nobody_resolves_one(architecture: Architecture) -> None:
    calls = of(played(architecture, **QUIET, review_share=0.0).events, SupervisorCalled)
    assert {call.purpose for call in calls if isinstance(call, SupervisorCalled)} <= {"ordering", "supervision"}


@EVERY
def test_a_world_that_only_reviews_denies_nothing(architecture: Architecture) -> None:
    opened = of(played(architecture, review_share=1.0).events, PolicyWindowOpened)
    assert {window.outcome for window in opened if isinstance(window, PolicyWindowOpened)} == {"review"}


@EVERY
def test_robots_without_routine_do_none(architecture: Architecture) -> None:
    assert of(played(architecture, routine_rate_per_s=0.0).events, RoutinePerformed, RoutineWithheld) == []


@EVERY
@pytest.mark.parametrize(("share", "operation"), [(0.0, "sensing"), (1.0, "motion")])
def test_routine_is_all_of_one_kind_at_either_end_of_its_share(architecture: Architecture, share: float, operation: str) -> None:
    done = of(played(architecture, motion_share=share).events, RoutinePerformed, RoutineWithheld)
    assert {event.operation for event in done if isinstance(event, RoutinePerformed | RoutineWithheld)} == {operation}


@EVERY
def test_sensing_breaks_no_policy_and_waits_for_none(architecture: Architecture) -> None:
    assert of(played(architecture, motion_share=0.0).events, RoutineWithheld) == []


@EVERY
def test_without_context_changes_nobody_stops_to_replan(architecture: Architecture) -> None:
    assert of(played(architecture, context_rate_per_s=0.0).events, ExecutionPaused) == []


@EVERY
def test_a_task_without_time_never_succeeds(architecture: Architecture) -> None:
    nothing = {"budget_base_s": 0.0, "budget_delegated_s": 0.0, "budget_own_s": 0.0}
    assert played(architecture, **nothing).metrics["coordination_success"] == 0


@EVERY
def test_messages_ten_times_slower_never_raise_success(architecture: Architecture) -> None:
    ours, slow = (played(architecture, message=Range(low, high)).metrics["coordination_success"] for low, high in ((0.05, 0.5), (0.5, 5.0)))
    assert ours is not None
    assert slow is not None
    assert slow <= ours


@EVERY
def test_with_an_actuator_that_never_holds_no_attempt_of_the_degraded_robot_succeeds_by_itself(architecture: Architecture) -> None:
    for run in played(architecture, degradation_probability=1.0, degraded_reliability=0.0, obstruction_rate_per_s=0.0).events:
        degraded: set[str] = set()
        for event in run:
            match event:
                case ActuatorDegraded():
                    degraded.add(event.robot)
                case ActuatorServiced():
                    degraded.discard(event.robot)
                case FailureResolved(level="local"):
                    assert event.robot not in degraded


@EVERY
def test_an_actuator_that_always_holds_fails_nothing(architecture: Architecture) -> None:
    failed = of(played(architecture, degradation_probability=1.0, degraded_reliability=1.0).events, ExecutionFailed)
    assert {event.cause for event in failed if isinstance(event, ExecutionFailed)} <= {"obstruction"}
