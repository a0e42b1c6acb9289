"""Physics of robots at work: lost actuators, blocked ways and help, over every architecture and whole runs."""

from fsar_ledger.designs.constants import Outages
from fsar_ledger.events.envelope import Architecture
from fsar_ledger.events.execution import ExecutionFailed, ExecutionFinished, ExecutionResumed, ExecutionStarted
from fsar_ledger.events.recovery import (
    AssistanceAdmitted,
    AssistanceEnded,
    AssistanceFailed,
    AssistanceRequested,
    FailureResolved,
    RecoveryEscalated,
)
from fsar_ledger.events.world import RobotCameBack, RobotWentOff
from fsar_ledger.projections.execution import HELPING
from fsar_ledger.projections.fold import State, apply
from tests.runtime.physics import BLOCKED, EVERY, LATE_HANDS, MIXED, failing, of, played

# Actuators that are lost


@EVERY
def test_nothing_that_needs_a_lost_actuator_succeeds_before_it_is_serviced(architecture: Architecture) -> None:
    runs = failing(architecture, Outages(loss_rate_per_s=1.0), obstruction_rate_per_s=0.0, **LATE_HANDS)
    assert runs.metrics["coordination_success"] == 0
    assert runs.metrics["recovery_containment"] == 0
    tried = 0
    for state, _, event in runs.told():
        if isinstance(event, ExecutionFinished | FailureResolved) and state.world.degraded.get(event.robot) == "lost":
            action = state.execution.actions[event.subject.action_id]
            assert action.capability == "navigate.indoor" or (
                isinstance(event, FailureResolved) and event.level == "fleet"
            ), event
        tried += isinstance(event, ExecutionFailed)
    assert tried


# Ways that are blocked


@EVERY
def test_with_every_way_blocked_nothing_that_needs_the_way_succeeds(architecture: Architecture) -> None:
    """Each robot has something in its way that never goes by itself, and no hand comes in time."""
    runs = played(architecture, **BLOCKED, **LATE_HANDS)
    assert runs.metrics["coordination_success"] == 0
    assert runs.metrics["recovery_containment"] == 0
    assert of(runs.events, AssistanceEnded) == []


@EVERY
def test_hands_clear_what_is_in_the_way_and_nothing_succeeds_where_more_comes_at_once(
    architecture: Architecture,
) -> None:
    runs = failing(architecture, Outages(), obstruction_rate_per_s=3.0, obstruction_mean_s=1e5)
    assert any(
        isinstance(event, FailureResolved) and event.level == "human" for event in of(runs.events, FailureResolved)
    )
    assert runs.metrics["coordination_success"] == 0
    assert runs.metrics["recovery_containment"] == 0


@EVERY
def test_nothing_is_executed_through_an_obstruction(architecture: Architecture) -> None:
    """What finishes had a clear way to its end, in our world and in a worse one."""
    for runs in (played(architecture), failing(architecture, Outages(), obstruction_rate_per_s=0.2)):
        finished = [
            state.world.obstructions.get(event.robot)
            for state, _, event in runs.told()
            if isinstance(event, ExecutionFinished)
        ]
        assert finished
        assert not any(finished)


# A helper's work is work


@EVERY
def test_help_fails_where_something_is_in_the_way_of_the_helper_too(architecture: Architecture) -> None:
    runs = failing(architecture, Outages(), obstruction_rate_per_s=0.2)
    asked = of(runs.events, AssistanceRequested)
    assert bool(asked) == (architecture != "dhma")  # its failures go from the robot to H_F
    assert bool(of(runs.events, AssistanceFailed)) == bool(asked)
    for state, _, event in runs.told():
        if isinstance(event, AssistanceEnded):
            assert not state.world.obstructions.get(event.helper)


@EVERY
def test_a_helper_that_could_not_help_is_free_and_recovery_goes_on_elsewhere(architecture: Architecture) -> None:
    for run in played(architecture, obstruction_rate_per_s=0.1).events:
        failed: dict[tuple[str, int], str] = {}
        helping: dict[str, str] = {}
        for event in run:
            match event:
                case AssistanceAdmitted():
                    assert event.helper not in helping
                    helping[event.helper] = event.subject.action_id
                case AssistanceEnded() | AssistanceFailed():
                    assert helping.pop(event.helper) == event.subject.action_id
                    if isinstance(event, AssistanceFailed):
                        failed[event.subject.action_id, event.failure] = event.helper
                case AssistanceRequested() | RecoveryEscalated() if (event.failed_action, event.failure) in failed:
                    assert getattr(event, "helper", None) != failed.pop((event.failed_action, event.failure))
                case FailureResolved():
                    assert (event.subject.action_id, event.failure) not in failed
        assert helping == {}


@EVERY
def test_nobody_helps_with_a_lost_actuator_and_nobody_helps_while_off(architecture: Architecture) -> None:
    lost = failing(architecture, Outages(loss_rate_per_s=1.0), obstruction_rate_per_s=0.0, **LATE_HANDS)
    assert of(lost.events, AssistanceEnded) == []
    for state, _, event in failing(
        architecture, Outages(off_rate_per_s=0.05, off_mean_s=5.0), obstruction_rate_per_s=0.1
    ).told():
        if isinstance(event, AssistanceAdmitted | AssistanceEnded | AssistanceFailed):
            assert event.helper not in state.world.off, event


@EVERY
def test_help_takes_its_time_not_counting_that_in_which_the_helper_is_off(architecture: Architecture) -> None:
    for record in failing(
        architecture, Outages(off_rate_per_s=0.1, off_mean_s=2.0), obstruction_rate_per_s=0.05
    ).records:
        state, spent, on_since = State(), dict[str, int](), dict[str, int]()
        for time_us, event in zip(record.times_us, record.events, strict=True):
            match event:
                case AssistanceAdmitted():
                    spent[event.helper], on_since[event.helper] = 0, time_us
                case RobotWentOff() if event.robot in spent and event.robot in on_since:
                    spent[event.robot] += time_us - on_since.pop(event.robot)
                case RobotCameBack() if event.robot in spent:
                    on_since[event.robot] = time_us
                case AssistanceEnded():
                    assert spent.pop(event.helper) + time_us - on_since.pop(event.helper) >= 5_000_000
            apply(state, event)


@EVERY
def test_a_robot_is_at_one_thing_at_a_time(architecture: Architecture) -> None:
    """Whoever helps executes nothing meanwhile, and is contended for."""
    for state, _, event in failing(architecture, MIXED, obstruction_rate_per_s=0.2).told():
        if isinstance(event, ExecutionStarted | ExecutionResumed):
            assert state.execution.current[event.robot] == event.subject.action_id
        if isinstance(event, AssistanceAdmitted):
            assert event.helper not in state.execution.current
        if isinstance(event, AssistanceEnded):
            assert state.execution.current[event.helper] == HELPING + event.subject.action_id
