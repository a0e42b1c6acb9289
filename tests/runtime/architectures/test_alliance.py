"""ALLIANCE: one test for each fact of its sources, and for each choice that they leave open."""

from collections.abc import Sequence
from typing import Any

import msgspec
import pytest

from fsar_ledger.designs.constants import Constants, Range, WorldConstants
from fsar_ledger.designs.dials import Alliance
from fsar_ledger.events.authority import AuthorityClaimed
from fsar_ledger.events.envelope import Robot, Subject
from fsar_ledger.events.execution import (
    ApproachStarted,
    ExecutionFailed,
    ExecutionFinished,
    ExecutionStarted,
    ExecutionWithdrawn,
    OwnStepDecided,
    RoutinePerformed,
    RoutineWithheld,
)
from fsar_ledger.events.knowledge import ActivityBroadcast, ActivityHeard, MotivationBegan, NeedEnded
from fsar_ledger.events.recovery import FailureResolved, RecoveryAttempted, RecoveryEscalated
from fsar_ledger.events.request import GapDetected, RequestAccepted, RequestDenied
from fsar_ledger.events.supervision import SupervisorCalled
from fsar_ledger.events.task import StepCompleted, TaskCompleted
from fsar_ledger.events.world import (
    LinkCameUp,
    LinkWentDown,
    ObstructionAppeared,
    ObstructionCleared,
    OutsiderRequestInjected,
    PolicyWindowClosed,
    PolicyWindowOpened,
    RobotCameBack,
    RobotWentOff,
    RoutineDue,
)
from fsar_ledger.ledger.rows.codec import LedgerRun, encode
from fsar_ledger.metrics.results import metric_rows
from fsar_ledger.projections.fold import State, fold
from fsar_ledger.projections.motivation import Heard, Motivation
from fsar_ledger.runtime.architectures.alliance import ALLIANCE
from fsar_ledger.runtime.architectures.alliance.motivation import level_us, patience_us, ripe_us
from fsar_ledger.runtime.kernel import Kernel
from fsar_ledger.runtime.ports import Fact
from fsar_ledger.runtime.simulation import RunSpec, run_started
from fsar_ledger.runtime.world import Draws, SimulatedEnvironment, founding, run_key
from tests import past
from tests.recycled import from_table
from tests.runtime.live import when

A, B, C, D, B2 = (Robot(f"robot/{name}") for name in ("A1", "B1", "C1", "D1", "B2"))
S, DOOR, MINUTES = 1_000_000, "door.open.secure", 600_000_000
DIALS = Alliance()
HOP = 200_000  # microseconds of every message
WORLD = WorldConstants(message=Range(0.2, 0.2), approach=Range(3.0, 3.0))
LONG = msgspec.structs.replace(WORLD, durations=((DOOR, Range(9.0, 9.0)), ("navigate.indoor", Range(9.0, 9.0))))
ACTION = "A1-1/1.1"
FAR = past.arrived("A1-1", A, (f"A {DOOR} B",), budget_us=MINUTES, due_us=MINUTES)
OWN = past.arrived("A1-1", A, ("A navigate.indoor",), budget_us=MINUTES, due_us=MINUTES)
Times = list[int]


def ran(facts: Sequence[Fact], world: WorldConstants = WORLD, size: int = 8, dials: Alliance = DIALS) -> Kernel:
    """The run of these facts and no others: two teams, so that a door has two robots that can open it."""
    constants = Constants(world=world, alliance=dials)
    begun = run_started(RunSpec(1, "alliance", "full", "door-relay", size, 0), constants)
    draws = Draws(run_key(1, "door-relay", 0), constants.world)
    one = Kernel(ALLIANCE, SimulatedEnvironment(facts, draws), (begun, *founding(size)))
    one.run()
    return one


def of(run: Kernel, kind: type[Any]) -> list[Any]:
    return [event for event in run.events if isinstance(event, kind)]


def opened(robot: Robot, outcome: str = "deny", scope: str = "local") -> PolicyWindowOpened:
    return PolicyWindowOpened(robot=robot, scope=scope, window="w", outcome=outcome)  # type: ignore[arg-type]


CLOSED = PolicyWindowClosed(robot=B, scope="local", window="w")
SECOND_HEARS_LATE: list[Fact] = [(1, LinkWentDown(B2)), (S, FAR), (3 * S, LinkCameUp(B2))]
"""The teammate's word of the need comes with the first robot's broadcasts, so it is patient."""


# Motivation: motivational_behaviour.cpp, impatience.cpp, impatience_reset.cpp

IMPATIENCE, SILENCE, PATIENCE = 1_000, 10_000, 20_000
GROWING = Motivation(level_us=0, as_of_us=100)


def hearing(*heard: Heard, level: int = 0) -> Motivation:
    return Motivation(level, 100, {Robot(f"robot/X{place}"): one for place, one in enumerate(heard)})


def test_motivation_grows_at_the_fast_rate_while_nobody_is_heard() -> None:
    assert level_us(GROWING, 700, IMPATIENCE, SILENCE) == 600
    assert ripe_us(GROWING, IMPATIENCE, SILENCE) == 1_100


def test_motivation_grows_at_the_slow_rate_while_a_teammate_is_heard() -> None:
    slowed = hearing(Heard(100, 100, PATIENCE))
    assert level_us(slowed, 2_100, IMPATIENCE, SILENCE) == 2_000 * IMPATIENCE // PATIENCE


def test_the_fast_rate_comes_back_when_a_teammate_falls_silent() -> None:
    slowed = hearing(Heard(100, 100, PATIENCE))
    assert level_us(slowed, 10_300, IMPATIENCE, SILENCE) == 500 + 200
    assert ripe_us(slowed, IMPATIENCE, SILENCE) == 100 + SILENCE + 500


def test_the_fast_rate_comes_back_when_a_teammate_has_exceeded_its_reliability_time() -> None:
    slowed = hearing(Heard(-5_000, 100, 6_000))
    assert level_us(slowed, 1_300, IMPATIENCE, SILENCE) == 900 * IMPATIENCE // 6_000 + 300


def test_a_teammate_that_is_always_heard_is_taken_over_from_after_the_patience() -> None:
    assert ripe_us(hearing(Heard(100, 19_000, PATIENCE)), IMPATIENCE, SILENCE) == 100 + PATIENCE


def test_the_slowest_rate_counts_where_several_teammates_are_heard() -> None:
    slowed = hearing(Heard(100, 100, 5_000), Heard(100, 100, PATIENCE))
    assert level_us(slowed, 2_100, IMPATIENCE, SILENCE) == 2_000 * IMPATIENCE // PATIENCE


def test_no_slow_rate_is_faster_than_the_fast_one() -> None:
    assert level_us(hearing(Heard(100, 100, 10)), 105, IMPATIENCE, SILENCE) <= 5


@pytest.mark.parametrize("level", [0, 1, 333, 999])
@pytest.mark.parametrize("patience", [0, 1, 700, 3_333, 20_000])
@pytest.mark.parametrize("last", [90, 100, 4_000])
def test_motivation_is_below_the_threshold_until_the_computed_instant_and_reaches_it_then(
    level: int, patience: int, last: int
) -> None:
    one = hearing(Heard(90, last, patience), Heard(95, 97, 2_000), level=level)
    due_us = ripe_us(one, IMPATIENCE, SILENCE)
    assert level_us(one, due_us, IMPATIENCE, SILENCE) >= IMPATIENCE
    assert level_us(one, due_us - 2, IMPATIENCE, SILENCE) < IMPATIENCE


def test_a_robot_starts_its_own_step_when_its_motivation_has_grown_to_the_threshold() -> None:
    run = ran([(S, OWN)])
    [grows], [decided] = when(run, MotivationBegan), when(run, OwnStepDecided)
    assert decided == grows + DIALS.impatience_us
    assert when(run, TaskCompleted)


def test_the_first_word_of_a_teammate_sets_the_motivation_to_zero_and_later_ones_do_not() -> None:
    first, second, *_ = [event for event in of(ran(SECOND_HEARS_LATE), ActivityHeard) if event.robot == B2]
    assert first.level_us == 0
    assert second.level_us > 0


# Sensing: the robot whose step it is tells each capable one; a teammate's activity is known from its broadcasts


def test_a_need_is_told_to_each_capable_robot_by_one_message() -> None:
    run = ran([(S, FAR)])
    [noticed] = when(run, GapDetected)
    assert {event.robot for event in of(run, MotivationBegan)} == {B, B2}
    assert when(run, MotivationBegan) == [noticed + HOP, noticed + HOP + 1]


def test_a_robots_own_step_is_its_own_alone() -> None:
    run = ran([(S, OWN)])
    assert {event.robot for event in of(run, MotivationBegan)} == {A}
    assert not of(run, GapDetected)


def test_an_active_robot_broadcasts_every_period_until_it_is_done() -> None:
    run = ran([(S, OWN)], LONG)
    begun, *later = when(run, ActivityBroadcast)
    [finished] = when(run, ExecutionFinished)
    assert later == [begun + n * DIALS.broadcast_us for n in range(1, (finished - begun) // DIALS.broadcast_us + 1)]


def test_a_teammates_activity_is_known_only_when_its_broadcast_arrives() -> None:
    run = ran(SECOND_HEARS_LATE)
    [sent, *_] = when(run, ActivityBroadcast, robot=B)
    assert sent < 3 * S
    assert min(when(run, ActivityHeard, robot=B2)) >= 3 * S


def test_a_robot_that_hears_a_teammate_before_its_threshold_stays_out() -> None:
    run = ran(SECOND_HEARS_LATE)
    assert {event.robot for event in of(run, ExecutionStarted)} == {B}
    assert when(run, NeedEnded, robot=B2), "it hears that the need is over"


# Activity suppression: one behaviour set is active at a time


def test_a_robot_that_is_active_has_no_motivation_for_anything_else_and_begins_anew_afterwards() -> None:
    other = past.arrived("A1-2", A, (f"A {DOOR} B",), budget_us=MINUTES, due_us=MINUTES)
    run = ran([(S, FAR), (S + 500_000, other)], size=4)
    first, second = when(run, RequestAccepted, executed_by=B)
    [finished, _] = when(run, ExecutionFinished)
    assert first < finished < second
    assert when(run, MotivationBegan, robot=B)[-1] == finished + 1
    assert second == finished + 1 + DIALS.impatience_us


# Acquiescence: acquiescence.cpp


def test_a_robot_yields_to_a_teammate_that_broadcasts_after_the_yielding_delay_and_not_before() -> None:
    run = ran([(S, FAR)], LONG)
    begun = min(when(run, AuthorityClaimed))
    [*first] = when(run, ExecutionWithdrawn)[:2]
    assert all(begun + DIALS.yield_us < time_us <= begun + DIALS.yield_us + 10 for time_us in first)


def test_a_robot_whom_no_teammate_joins_gives_up_after_the_giving_up_delay_and_goes_on_trying() -> None:
    run = ran([(S, FAR)], LONG, 4)  # 3 s of way and 9 s of work
    begun, again = when(run, AuthorityClaimed, claimant=B)
    [given_up] = when(run, ExecutionWithdrawn)
    assert given_up == begun + DIALS.give_up_us + 1
    assert again == given_up + DIALS.impatience_us + 1
    assert len(of(run, ApproachStarted)) == 1, "it is still there"
    assert when(run, TaskCompleted)


def test_a_dial_moves_each_delay() -> None:
    for dials in (Alliance(give_up_us=5 * S), Alliance(give_up_us=6 * S)):
        run = ran([(S, OWN)], LONG, 4, dials)
        [begun, *_], [given_up, *_] = when(run, AuthorityClaimed), when(run, ExecutionWithdrawn)
        assert given_up == begun + dials.give_up_us + 1


# No central store and no arbiter: two robots may be active at once


def test_two_robots_that_sense_a_need_at_once_both_claim_it_and_both_move() -> None:
    run = ran([(S, FAR)])
    claims = of(run, AuthorityClaimed)
    assert [(claim.subject.action_id, claim.claimant) for claim in claims] == [(ACTION, B), (ACTION, B2)]
    assert [(one.robot, one.subject.action_id) for one in of(run, ApproachStarted)] == [
        (B, ACTION),
        (B2, f"{ACTION}:B2"),
    ]


def test_two_claims_to_an_action_at_once_are_one_conflict() -> None:
    run = ran([(S, FAR)])
    record = LedgerRun("run", run.times_us, run.caused_by, run.events)
    with from_table(encode([record])) as database:
        [conflicts] = [row.mean for row in metric_rows(database) if row.metric == "authority_conflicts"]
    assert conflicts == 1


def test_the_first_to_finish_completes_the_step_and_the_other_stops_when_it_hears_of_that() -> None:
    slower = [(S, FAR), (4 * S, ObstructionAppeared(B2, "cart"))]
    run = ran(slower)
    [finished] = when(run, ExecutionFinished)
    assert when(run, StepCompleted) == [finished + HOP]
    assert when(run, ExecutionWithdrawn, robot=B2) == [finished + HOP + 1], "two messages of one cause"
    assert not run.state.authority.claims
    assert not run.state.motivation.of


# Sensory feedback: its own policy, as a dial; nothing looks at the fleet's rule


@pytest.mark.parametrize("outcome", ["deny", "review"])
def test_a_robot_has_no_motivation_while_its_own_policy_denies_or_reviews(outcome: str) -> None:
    facts = [(S // 2, opened(B, outcome)), (S, FAR), (20 * S, CLOSED)]
    run = ran(facts, size=4)
    assert when(run, RequestAccepted) == [20 * S + 1 + DIALS.impatience_us]
    assert not of(run, SupervisorCalled)
    assert not of(run, RequestDenied)


def test_without_the_dial_policy_is_not_sensed() -> None:
    run = ran([(S // 2, opened(B)), (S, FAR), (20 * S, CLOSED)], size=4, dials=Alliance(senses_policy=0))
    assert max(when(run, ExecutionStarted)) < 20 * S


def test_a_robot_on_its_way_turns_back_when_its_policy_denies() -> None:
    run = ran([(S, FAR), (4 * S, opened(B)), (8 * S, CLOSED)], size=4)
    assert when(run, ExecutionWithdrawn) == [4 * S + 1]
    assert when(run, ExecutionStarted) == [8 * S + 1 + DIALS.impatience_us + 1 + 3 * S]


def test_a_robot_that_executes_goes_on_when_its_policy_denies() -> None:
    run = ran([(S, OWN), (4 * S, opened(A))], LONG, 4)
    assert len(of(run, ExecutionStarted)) == len(of(run, ExecutionFinished)) == 1


def test_nothing_looks_at_the_fleets_rule() -> None:
    run = ran([(S // 2, opened(B, scope="fleet")), (S, FAR)], size=4)
    assert of(run, ExecutionStarted)


def test_a_routine_motion_is_withheld_by_the_robots_own_policy_where_it_is_sensed() -> None:
    facts = [(S, opened(B)), (2 * S, RoutineDue(B, "motion")), (3 * S, RoutineDue(B, "sensing"))]
    assert [len(of(ran(facts), kind)) for kind in (RoutineWithheld, RoutinePerformed)] == [1, 1]
    assert len(of(ran(facts, dials=Alliance(senses_policy=0)), RoutinePerformed)) == 2


# Recovery: retries until it gives up, takeover by a teammate, and nothing else

BLOCKED: list[Fact] = [*SECOND_HEARS_LATE, (5 * S, ObstructionAppeared(B, "cart"))]


def test_a_teammate_takes_over_from_a_robot_that_has_gone_off_when_it_is_silent_or_has_taken_too_long() -> None:
    run = ran([*SECOND_HEARS_LATE, (4 * S, RobotWentOff(B)), (90 * S, RobotCameBack(B))])
    heard = when(run, ActivityHeard, robot=B2)
    [taken] = when(run, RequestAccepted, executed_by=B2)
    assert taken <= min(max(heard) + DIALS.silence_us + DIALS.impatience_us, min(heard) + DIALS.patience_us)
    assert [event.robot for event in of(run, ExecutionFinished)] == [B2]
    assert when(run, TaskCompleted)[0] < 90 * S
    assert when(run, ExecutionWithdrawn, robot=B) > [90 * S]


def test_a_failing_robot_tries_again_until_it_acquiesces_and_a_teammate_takes_over() -> None:
    run = ran(BLOCKED)
    begun = min(when(run, AuthorityClaimed, claimant=B))
    escalated, *_ = of(run, RecoveryEscalated)
    resolved, *_ = of(run, FailureResolved)
    attempts = [event for event in of(run, RecoveryAttempted) if event.failed_action == escalated.failed_action]
    assert [event.number for event in attempts] == [1, 2, 3, 4]
    assert when(run, FailureResolved)[0] == when(run, RequestAccepted, executed_by=B2)[0]
    assert (escalated.level, escalated.to_level, escalated.robot) == ("local", "peer", B)
    assert when(run, RecoveryEscalated)[0] <= begun + DIALS.give_up_us + 1
    assert (resolved.level, resolved.robot) == ("peer", B)
    assert [event.robot for event in of(run, ExecutionFinished)] == [B2]


def test_without_a_teammate_a_failing_robot_goes_on_trying_and_calls_nobody() -> None:
    run = ran([(S, FAR), (5 * S, ObstructionAppeared(B, "cart")), (60 * S, ObstructionCleared(B, "cart"))], size=4)
    assert len(when(run, AuthorityClaimed, claimant=B)) > 3
    assert not of(run, SupervisorCalled)
    assert when(run, TaskCompleted)[0] > 60 * S
    assert of(run, FailureResolved)[-1].level == "local"


def test_a_failure_of_a_robots_own_step_is_its_own() -> None:
    run = ran([(S, OWN), (3 * S, ObstructionAppeared(A, "cart")), (40 * S, ObstructionCleared(A, "cart"))])
    assert of(run, ExecutionFailed)
    assert not of(run, RecoveryEscalated)
    assert when(run, TaskCompleted)


# An outsider's need is a need


def test_an_outsiders_need_is_done_like_any_other_and_once() -> None:
    outside = OutsiderRequestInjected(task_id="X1", robot=D, peer=C, capability="inspect.private_zone")
    run = ran([(S, outside)], size=4)
    assert [event.robot for event in of(run, ExecutionFinished)] == [C]
    assert not run.state.motivation.of


def test_an_outsiders_need_that_nobody_can_meet_does_not_keep_the_run_going() -> None:
    outside = OutsiderRequestInjected(task_id="X1", robot=D, peer=C, capability="inspect.private_zone")
    run = ran([(S, outside), (2 * S, ObstructionAppeared(C, "cart"))], size=4)
    assert 100 * S < run.times_us[-1] < 150 * S


# L-ALLIANCE


def learnt(*times_us: int, dials: Alliance) -> State:
    constants = Constants(alliance=dials)
    begun = run_started(RunSpec(1, "alliance", "full", "door-relay", 8, 0), constants)
    seen = (
        NeedEnded(subject=Subject("t", "t/1.1"), robot=B2, peer=B, capability=DOOR, took_us=took_us)
        for took_us in times_us
    )
    return fold((begun, *founding(8), *seen))


def test_patience_is_fixed_unless_the_robot_learns() -> None:
    assert patience_us(learnt(3 * S, dials=DIALS), B2, B, DOOR) == DIALS.patience_us


def test_a_robot_that_learns_is_as_patient_as_the_mean_time_of_the_teammate_and_its_deviation() -> None:
    learns = Alliance(learns=1)
    assert patience_us(learnt(dials=learns), B2, B, DOOR) == DIALS.patience_us
    assert patience_us(learnt(3 * S, dials=learns), B2, B, DOOR) == 3 * S
    assert patience_us(learnt(2 * S, 4 * S, dials=learns), B2, B, DOOR) == 3 * S + S
    assert patience_us(learnt(2 * S, 4 * S, dials=learns), B, B2, DOOR) == DIALS.patience_us


def test_a_robot_learns_from_what_it_has_heard_begin_and_end() -> None:
    run = ran(SECOND_HEARS_LATE, dials=Alliance(learns=1))
    heard, [ended] = when(run, ActivityHeard, robot=B2), when(run, NeedEnded, robot=B2)
    assert run.state.motivation.times_us == {(B2, B, DOOR): (ended - min(heard),)}
