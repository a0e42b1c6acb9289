"""Physics: what no way of governing can bend, stated over every architecture and judged over whole runs.

Rates of 0 and probabilities of 0 and 1 are legal constants of the world, and these are what many statements are made
with.
"""

import pytest

from fsar_ledger.designs.constants import Constants, Outages, Range
from fsar_ledger.events.envelope import Architecture, flat
from fsar_ledger.events.execution import (
    ApproachStarted,
    ExecutionFailed,
    ExecutionFinished,
    ExecutionHalted,
    ExecutionPaused,
    ExecutionQueued,
    ExecutionResumed,
    ExecutionStarted,
    ExecutionWithdrawn,
    OwnStepDecided,
    RoutinePerformed,
    RoutineWithheld,
)
from fsar_ledger.events.policy import PolicyConflictEscalated
from fsar_ledger.events.recovery import AssistanceAdmitted, FailureResolved
from fsar_ledger.events.request import AwardMade, CommandIssued, RequestAccepted, RequestAdmitted
from fsar_ledger.events.supervision import ActuatorServiced, SupervisorCalled
from fsar_ledger.events.task import StepBegan, TaskAbandoned, TaskCompleted
from fsar_ledger.events.world import ActuatorDegraded, LinkWentDown, PolicyWindowOpened, RobotWentOff, TaskArrived
from fsar_ledger.projections.fold import State, apply
from fsar_ledger.projections.world import is_linked
from tests.runtime.physics import (
    ALWAYS,
    BLOCKED,
    EVERY,
    FOREVER,
    LASTING,
    LATE_HANDS,
    LAWLESS,
    MIXED,
    OURS,
    QUIET,
    deeds,
    failing,
    in_world,
    of,
    played,
    robot_of,
)


@EVERY
def test_our_world_has_what_the_statements_take_away(architecture: Architecture) -> None:
    ours = played(architecture)
    for kind in (
        *(PolicyWindowOpened, ExecutionFailed, ActuatorDegraded, ExecutionPaused),
        *(RoutinePerformed, RoutineWithheld, SupervisorCalled),
    ):
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
    assert {call.purpose for call in calls} <= {"ordering", "supervision"}


@EVERY
def test_a_world_that_only_reviews_denies_nothing(architecture: Architecture) -> None:
    opened = of(played(architecture, review_share=1.0).events, PolicyWindowOpened)
    assert {window.outcome for window in opened} == {"review"}


@EVERY
def test_robots_without_routine_do_none(architecture: Architecture) -> None:
    assert of(played(architecture, routine_rate_per_s=0.0).events, RoutinePerformed, RoutineWithheld) == []


@EVERY
@pytest.mark.parametrize(("share", "operation"), [(0.0, "sensing"), (1.0, "motion")])
def test_routine_is_all_of_one_kind_at_either_end_of_its_share(
    architecture: Architecture, share: float, operation: str
) -> None:
    done = of(played(architecture, motion_share=share).events, RoutinePerformed, RoutineWithheld)
    assert {event.operation for event in done} == {operation}


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
    ours, slow = (
        played(architecture, message=Range(low, high)).metrics["coordination_success"]
        for low, high in ((0.05, 0.5), (0.5, 5.0))
    )
    assert ours is not None
    assert slow is not None
    assert slow <= ours


@EVERY
def test_with_an_actuator_that_never_holds_no_attempt_of_the_degraded_robot_succeeds_by_itself(
    architecture: Architecture,
) -> None:
    for run in played(
        architecture, degradation_probability=1.0, degraded_reliability=0.0, obstruction_rate_per_s=0.0
    ).events:
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
    assert {event.cause for event in failed} <= {"obstruction"}


# Robots that are off, and links that are down


@EVERY
def test_with_every_robot_off_nobody_does_anything(architecture: Architecture) -> None:
    off = failing(architecture, Outages(off_rate_per_s=ALWAYS, off_mean_s=FOREVER))
    assert off.metrics["coordination_success"] == 0
    assert of(off.events, TaskArrived)
    assert list(deeds(off)) == []


@EVERY
def test_from_the_moment_at_which_every_robot_is_off_nobody_does_anything(architecture: Architecture) -> None:
    outages = Outages(off_rate_per_s=ALWAYS, off_mean_s=FOREVER, from_s=28.0)
    ours, lasting = failing(architecture, outages), failing(architecture, outages, **LASTING)
    for off in (ours, lasting):
        times = [time_us for _, time_us, _, _ in deeds(off)]
        assert times
        assert max(times) <= 28_000_100
        assert off.metrics["coordination_success"] == 0
    assert of(lasting.events, ExecutionHalted)
    never_off = failing(architecture, Outages(), **LASTING)
    assert never_off.metrics["coordination_success"] != 0


@EVERY
def test_a_robot_that_is_off_does_and_decides_nothing(architecture: Architecture) -> None:
    mixed = failing(architecture, MIXED)
    assert of(mixed.events, RobotWentOff)
    assert [(event, time_us) for state, time_us, robot, event in deeds(mixed) if robot in state.world.off] == []


@EVERY
def test_what_a_robot_was_at_goes_on_after_it_is_back_and_takes_no_less_time(architecture: Architecture) -> None:
    """However often an execution stops, it runs as long as it would have without."""
    halted = 0
    for record in failing(architecture, Outages(off_rate_per_s=0.1, off_mean_s=3.0), **QUIET).records:
        since: dict[str, int] = {}
        left: dict[str, int] = {}
        for time_us, event in zip(record.times_us, record.events, strict=True):
            match event:
                case ExecutionStarted() | ExecutionResumed():
                    since[event.subject.action_id] = time_us
                    left[event.subject.action_id] = (
                        (event.ends_us or 0) - time_us
                        if isinstance(event, ExecutionStarted)
                        else left[event.subject.action_id]
                    )
                case ExecutionHalted() | ExecutionPaused() | ExecutionFinished() if event.subject.action_id in left:
                    left[event.subject.action_id] -= time_us - since.pop(event.subject.action_id)
                    halted += isinstance(event, ExecutionHalted)
                    if isinstance(event, ExecutionFinished):
                        assert left[event.subject.action_id] == 0
    assert halted


@EVERY
def test_short_absences_are_survived(architecture: Architecture) -> None:
    """Else the statements above could hold because nothing ever went on."""
    assert failing(architecture, Outages(off_rate_per_s=0.01, off_mean_s=3.0)).metrics["coordination_success"] != 0


@EVERY
def test_over_links_that_are_down_nobody_is_asked_and_own_steps_go_on_where_robots_decide(
    architecture: Architecture,
) -> None:
    runs = failing(architecture, Outages(link_rate_per_s=ALWAYS, link_mean_s=FOREVER))
    assert of(runs.events, LinkWentDown)
    assert of(runs.events, RequestAdmitted, RequestAccepted, AssistanceAdmitted) == []
    finished = of(runs.events, ExecutionFinished)
    steps = {(queued.robot, queued.on_behalf_of) for queued in of(runs.events, ExecutionQueued)}
    assert all(robot == on_behalf_of for robot, on_behalf_of in steps)
    assert bool(finished) == (architecture != "cfc")  # under the coordinator no robot moves without its word
    assert of(runs.events, RoutinePerformed)


@EVERY
def test_no_message_reaches_or_leaves_a_robot_whose_link_is_down(architecture: Architecture) -> None:
    """Who admits, accepts or helps has heard from another; so has the coordinator that a step was finished."""
    heard = 0
    for state, _, event in failing(architecture, MIXED).told():
        if isinstance(event, RequestAdmitted | AssistanceAdmitted | ExecutionQueued) and getattr(
            event, "is_delegated", True
        ):
            robot = (
                robot_of(event.principals.decided_by)
                if isinstance(event, RequestAdmitted)
                else event.helper
                if isinstance(event, AssistanceAdmitted)
                else event.robot
            )
            heard += 1
            assert robot is None or is_linked(state.world, robot), event
    assert heard


@EVERY
def test_outages_that_never_come_change_nothing(architecture: Architecture) -> None:
    never, ours = failing(architecture, Outages()), in_world(architecture, Constants(), 1)
    assert [run[1:] for run in never.events] == [run[1:] for run in ours.events]


@EVERY
def test_every_task_comes_to_an_end_whatever_happens(architecture: Architecture) -> None:
    """Who waits for an answer that never comes gives up."""
    worlds = (
        failing(architecture, Outages(off_rate_per_s=0.01, off_mean_s=FOREVER)),
        failing(architecture, Outages(link_rate_per_s=0.01, link_mean_s=FOREVER)),
        failing(architecture, MIXED),
        played(architecture, **BLOCKED, **LATE_HANDS),
    )
    for runs in worlds:
        ends = [event.task_id for event in of(runs.events, TaskCompleted, TaskAbandoned)]
        assert sorted(ends) == sorted(event.task_id for event in of(runs.events, TaskArrived))


@EVERY
def test_nothing_of_a_task_begins_where_it_is_known_to_be_given_up_and_nobody_claims_what_nobody_does(
    architecture: Architecture,
) -> None:
    """Known is it where it was decided, and at another robot when a message has been under way for its time and both
    can be reached."""
    begins = (ExecutionQueued, RequestAdmitted, CommandIssued, AwardMade, OwnStepDecided, StepBegan)
    goes_on = (ApproachStarted, ExecutionStarted, RequestAccepted)
    message_us = round(OURS.message.high_s * 1_000_000) + 10
    worlds = (
        failing(architecture, MIXED),
        failing(architecture, Outages(off_rate_per_s=0.01, off_mean_s=FOREVER)),
        played(architecture, budget_base_s=0.0, budget_delegated_s=2.0, budget_own_s=4.0),
    )
    withdrawn = 0
    for record in (record for runs in worlds for record in runs.records):
        over: set[str | None] = set()
        told_us: dict[str, int] = {}  # by when the action's robot has heard of it
        state = State()
        for time_us, event in zip(record.times_us, record.events, strict=True):
            if isinstance(event, TaskAbandoned):
                over.add(event.task_id)
                told_us |= {
                    name: time_us + message_us
                    for name, action in state.execution.actions.items()
                    if action.task_id == event.task_id
                }
            for name in told_us:
                if not _is_reached(state, name):
                    told_us[name] = time_us + message_us
            withdrawn += isinstance(event, ExecutionWithdrawn) and event.subject.task_id in over
            assert not (isinstance(event, begins) and flat(event)["task_id"] in over), event
            if isinstance(event, goes_on) and event.subject.task_id in over:
                action = state.execution.actions[str(event.subject.action_id)]
                assert action.robot != action.requested_by, event
                assert time_us <= told_us[action.action_id], event
            apply(state, event)
        for name in (
            claim.subject.action_id
            for claims in state.authority.claims.values()
            for claim in claims
            if claim.subject.task_id in over
        ):
            assert state.execution.actions[name].stage in ("running", "paused", "halted", "failed") or not _is_reached(
                state, name
            ), name
    assert withdrawn


def _is_reached(state: State, action_id: str) -> bool:
    """True when who has the action and who asked for it can reach each other, or it is over."""
    action = state.execution.actions.get(action_id)
    return action is None or all(is_linked(state.world, end or "") for end in (action.robot, action.requested_by))
