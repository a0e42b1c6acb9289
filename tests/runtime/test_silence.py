"""Nobody knows that a robot is off before it has not answered, and whether a message was delivered is waited for no
longer than is said. Reading: R44."""

from collections.abc import Sequence
from functools import cache

import msgspec
import pytest

from fsar_ledger.designs.constants import Constants, Outages, Range, WorldConstants
from fsar_ledger.events import Event
from fsar_ledger.events.authority import AuthorityReleased
from fsar_ledger.events.envelope import Architecture, Availability, Robot
from fsar_ledger.events.execution import ExecutionFailed, ExecutionQueued, ExecutionStarted, ExecutionWithdrawn
from fsar_ledger.events.knowledge import BidReceived, WorkQueued
from fsar_ledger.events.recovery import AssistanceAdmitted, AssistanceRequested, RecoveryEscalated
from fsar_ledger.events.registry import AvailabilityChanged
from fsar_ledger.events.request import AwardMade, CommandIssued, RequestIssued, RequestUnanswered
from fsar_ledger.events.supervision import ActuatorServiced
from fsar_ledger.events.task import StepCompleted, TaskAbandoned, TaskCompleted
from fsar_ledger.events.world import (
    ActuatorDegraded,
    LinkCameUp,
    LinkWentDown,
    ObstructionAppeared,
    RobotCameBack,
    RobotWentOff,
    TaskArrived,
)
from fsar_ledger.runtime.kernel import Kernel
from fsar_ledger.runtime.ports import Fact
from fsar_ledger.runtime.simulation import SCENARIOS, RunSpec, founding_of, handler_table_of
from fsar_ledger.runtime.world import Draws, SimulatedEnvironment, run_key
from fsar_ledger.runtime.world.schedule import schedule
from tests import past
from tests.runtime.live import of
from tests.runtime.physics import EVERY, LAWLESS, OURS, QUIET

S = 1_000_000
ANSWER_US = round(Outages().answer_s * S)
CALM = msgspec.structs.replace(
    OURS, **QUIET, **LAWLESS, context_rate_per_s=0.0, routine_rate_per_s=0.0, encounter_mean_s=5.0
)
A, B, B2, DOOR = Robot("robot/A1"), Robot("robot/B1"), Robot("robot/B2"), "door.open.secure"
TASK = past.arrived("A1-1", A, (f"A {DOOR} B",), budget_us=90 * S, due_us=91 * S)


def in_a_world(spec: RunSpec, world: WorldConstants, facts: Sequence[Fact]) -> Kernel:
    """The finished run in a world of these constants, in which this happens and nothing else."""
    one = Kernel(
        handler_table_of(spec.architecture),
        SimulatedEnvironment(facts, Draws(run_key(5, spec.scenario, spec.run), world)),
        *founding_of(spec, Constants(world=world)),
    )
    one.run()
    return one


def ran(architecture: Architecture, facts: list[Fact], size: int = 8) -> Kernel:
    """The run of two teams in a calm world, in which this happens and nothing else."""
    return in_a_world(RunSpec(5, architecture, "full", "door-relay", size, 0), CALM, facts)


@cache
def without(architecture: Architecture, scenario: str, robot: str, ends: type[Event]) -> Kernel:
    """The run of a scenario for two teams in a calm world, one robot off or without a link from the beginning."""
    spec, constants = RunSpec(5, architecture, "full", scenario, 8, 0), Constants(world=CALM)
    return in_a_world(spec, CALM, ((1, ends(robot)), *schedule(constants, 5, spec.scenario, 0, 8)))


@EVERY
@pytest.mark.parametrize("ends", [RobotWentOff, LinkWentDown])
def test_where_another_robot_could_serve_nobody_waits_for_ever_for_one_that_is_silent(
    architecture: Architecture, ends: type[Event]
) -> None:
    """Each robot in its turn; a task in which the silent one acts itself can only be given up."""
    tasks = 0
    for scenario in SCENARIOS:
        for robot in ("robot/A1", "robot/B1", "robot/C1", "robot/D1"):
            run = without(architecture, scenario, robot, ends)
            done = {event.task_id for _, event in of(run, TaskCompleted)}
            for _, event in of(run, TaskArrived):
                if all(f"robot/{step.partition(' ')[0]}{event.team}" != robot for step in event.steps):
                    tasks += 1
                    assert event.task_id in done, (scenario, robot, event.task_id, event.steps)
    assert tasks


def helped(architecture: Architecture) -> Kernel:
    """Something stays in the way of A while B, the first that could help, is off."""
    own = past.arrived("A1-1", A, ("A navigate.indoor",), budget_us=90 * S, due_us=91 * S)
    return ran(architecture, [(1, RobotWentOff(B)), (S, own), (S + 100, ObstructionAppeared(A, "o"))])


@pytest.mark.parametrize("architecture", ["fsar", "cfc"])
def test_that_a_helper_is_silent_is_known_when_the_time_for_its_answer_is_over(architecture: Architecture) -> None:
    """Under DHMA robots do not help each other."""
    run = helped(architecture)
    turned = [
        time_us
        for time_us, event in of(run, RecoveryEscalated, AssistanceRequested)
        if getattr(event, "to_level", "peer") == "peer"
    ]
    helping = of(run, AssistanceAdmitted)
    assert len(helping) == 1
    admitted_us, admitted = helping[0]
    assert isinstance(admitted, AssistanceAdmitted)
    assert admitted.helper != B
    assert ANSWER_US <= admitted_us - turned[0] <= ANSWER_US + 2 * S
    asked = [event.helper for _, event in of(run, AssistanceRequested)]
    assert asked == (
        [admitted.helper] if architecture == "fsar" else [B, admitted.helper]
    )  # the coordinator orders one by one
    assert of(run, TaskCompleted)


def test_the_registry_has_a_silent_robot_offline_until_it_has_reported_back() -> None:
    later = msgspec.structs.replace(TASK, task_id="A1-2")
    last = msgspec.structs.replace(TASK, task_id="A1-3")
    for ends, begins in ((RobotWentOff, RobotCameBack), (LinkWentDown, LinkCameUp)):
        run = ran("fsar", [(1, ends(B)), (S, TASK), (30 * S, later), (60 * S, begins(B)), (61 * S, last)])
        asked = [(event.subject.action_id, event.principals.executed_by) for _, event in of(run, RequestIssued)]
        assert asked == [("A1-1/1.1", B), ("A1-1/1.2", B2), ("A1-2/1.1", B2), ("A1-3/1.1", B)]
        (gone_us, gone), (back_us, back) = of(run, AvailabilityChanged)
        assert gone == past.available(B, None, "offline", "no answer")
        assert back == past.available(B, None, "ready", "answers again")
        assert gone_us - of(run, RequestIssued)[0][0] == ANSWER_US
        assert 60 * S < back_us < 61 * S


def test_what_a_robot_has_said_of_itself_since_stands_when_it_reports_back() -> None:
    before = past.available(B, "door.open.basic", "restricted", "inspection")
    run = ran("fsar", [(1, before), (2, RobotWentOff(B)), (S, TASK), (60 * S, RobotCameBack(B))])
    back = {event.capability: event.availability for _, event in of(run, AvailabilityChanged)[2:]}
    assert back["door.open.basic"] == "restricted"
    assert back[DOOR] == "ready"
    assert run.state.registry.silent == {}


def test_a_requester_without_a_link_blames_nobody() -> None:
    run = ran("fsar", [(S, TASK), (S + 200_000, LinkWentDown(A)), (40 * S, LinkCameUp(A))])
    assert of(run, AvailabilityChanged) == []
    assert of(run, TaskCompleted)


def test_a_command_that_nobody_confirmed_is_taken_back_and_not_carried_out_later() -> None:
    run = ran("cfc", [(1, RobotWentOff(B)), (S, TASK), (7 * S, RobotCameBack(B))])  # a second after it was
    commanded = [event.robot for _, event in of(run, CommandIssued)]
    assert commanded == [B, B2]
    [(late_us, late)] = of(run, RequestUnanswered)
    assert (late.principals.decided_by, late.principals.executed_by) == ("coordinator", B)
    assert late.principals.requested_by is None
    assert late_us - of(run, CommandIssued)[0][0] == ANSWER_US
    found = [event.dimension for time_us, event in of(run, AuthorityReleased) if time_us == late_us]
    assert found == ["execution", "override"]
    assert [event.robot for _, event in of(run, ExecutionQueued)] == [B2]
    assert len(of(run, StepCompleted)) == 1


def test_an_order_to_a_silent_helper_is_not_carried_out_after_another_was_asked() -> None:
    run = helped("cfc")
    facts: list[Fact] = [(time_us, event) for time_us, event in of(run, RobotWentOff, TaskArrived, ObstructionAppeared)]
    [(admitted_us, _)] = of(run, AssistanceAdmitted)
    again = ran("cfc", [*facts, (admitted_us + S, RobotCameBack(B))])
    assert len(of(again, AssistanceAdmitted)) == 1
    assert [event.item for _, event in of(again, WorkQueued)].count("no answer") == 1


def test_a_contract_whose_award_is_not_accepted_is_awarded_anew() -> None:
    calm = ran("dhma", [(S, TASK)])
    [(awarded_us, first)] = of(calm, AwardMade)
    run = ran("dhma", [(S, TASK), (awarded_us + 1, RobotWentOff(first.robot)), (60 * S, RobotCameBack(first.robot))])
    [(late_us, late)] = of(run, RequestUnanswered)
    assert (late_us, late.principals.executed_by) == (awarded_us + ANSWER_US, first.robot)
    found = [event.robot for _, event in of(run, AwardMade)]
    assert found == [first.robot, ({B, B2} - {first.robot}).pop()]
    assert [event.robot for _, event in of(run, ExecutionQueued)] == [({B, B2} - {first.robot}).pop()]


@EVERY
def test_where_nobody_else_could_serve_the_robot_is_asked_until_it_is_back(architecture: Architecture) -> None:
    run = ran(architecture, [(1, RobotWentOff(B)), (S, TASK), (60 * S, RobotCameBack(B))], size=4)
    assert len(of(run, RequestUnanswered)) >= 1
    assert of(run, TaskCompleted)
    assert of(run, ExecutionFailed, TaskAbandoned) == []


@EVERY
def test_where_nobody_is_off_nobody_is_found_silent_as_long_as_each_message_is_delivered_in_time(
    architecture: Architecture,
) -> None:
    """Bids and relayed requests take several messages of up to 4.9 s; the time for an answer is for the delivery of
    one."""
    slow = msgspec.structs.replace(CALM, message=Range(0.49, 4.9))
    for run in range(3):
        spec, constants = RunSpec(5, architecture, "full", "door-relay", 4, run), Constants(world=slow)
        one = in_a_world(spec, slow, schedule(constants, 5, spec.scenario, run, 4))
        assert of(one, RequestIssued, CommandIssued, AwardMade)
        assert of(one, RequestUnanswered, AvailabilityChanged) == []


def test_a_bid_on_its_way_is_waited_for_when_another_candidate_is_silent() -> None:
    slow = msgspec.structs.replace(CALM, message=Range(2.0, 2.5))
    run = in_a_world(RunSpec(5, "dhma", "full", "door-relay", 8, 0), slow, [(1, RobotWentOff(B)), (S, TASK)])
    (asked_us, _), *_ = of(run, RequestIssued)
    assert [time_us - asked_us > ANSWER_US for time_us, _ in of(run, BidReceived)] == [True]
    assert [event.robot for _, event in of(run, AwardMade)] == [B2]
    assert of(run, RequestUnanswered) == []


def test_a_relayed_request_is_two_messages_and_each_has_its_time() -> None:
    run = relayed(2.6, 3.0)
    assert [event.relay for _, event in of(run, RequestIssued)] == [A]
    assert of(run, RequestUnanswered, AvailabilityChanged) == []
    assert of(run, TaskCompleted)


@EVERY
def test_a_robot_that_nobody_can_reach_does_not_know_that_a_task_was_given_up(architecture: Architecture) -> None:
    """Of three robots that are still on their way one is linked, one without a link for long, and one until before it
    would begin."""
    short = past.arrived("A1-1", A, (f"A {DOOR} B",), budget_us=2 * S, due_us=2 * S)
    [(queued_us, queued)] = of(ran(architecture, [(S, short)]), ExecutionQueued)
    down = (queued_us + 1000, LinkWentDown(queued.robot))
    linked = ran(architecture, [(S, short)])
    for_long = ran(architecture, [(S, short), down, (80 * S, LinkCameUp(queued.robot))])
    in_time = ran(architecture, [(S, short), down, (5 * S, LinkCameUp(queued.robot))])
    [(given_up_us, _)] = of(linked, TaskAbandoned)
    [(told_us, _)] = of(linked, ExecutionWithdrawn)
    assert 50_000 <= told_us - given_up_us <= 500_000
    assert of(for_long, ExecutionWithdrawn) == []
    [(begun_us, _)] = of(for_long, ExecutionStarted)
    assert begun_us > 5 * S
    assert [time_us for time_us, _ in of(in_time, ExecutionWithdrawn)] == [5 * S + 1]
    assert of(linked, ExecutionStarted) == of(in_time, ExecutionStarted) == []


@pytest.mark.parametrize(("ends", "begins"), [(LinkWentDown, LinkCameUp), (RobotWentOff, RobotCameBack)])
def test_a_robot_that_reports_back_says_what_has_become_of_its_actuator_since(
    ends: type[Event], begins: type[Event]
) -> None:
    """Whichever of its two words, that it is back and that it was serviced, comes in first."""
    worn = ActuatorDegraded(B)
    said = past.available(B, None, "degraded", "actuator")
    own_word = past.available(B, None, "degraded", "dusty lens")
    first = set()
    cases: tuple[tuple[list[Fact], list[Fact], Availability], ...] = (
        ([(1, worn), (2, said)], [(30 * S, ActuatorServiced(B))], "ready"),
        ([(1, worn), (2, said)], [(59_700_000, ActuatorServiced(B))], "ready"),
        ([(1, worn), (2, said)], [(59_999_999, ActuatorServiced(B))], "ready"),
        ([(1, worn), (2, said)], [], "degraded"),
        ([(2, own_word)], [], "degraded"),
        ([], [(30 * S, worn)], "degraded"),
        ([], [], "ready"),
    )
    for start, since, after in cases:
        facts: list[Fact] = [*start, (3, ends(B)), (S, TASK), *since, (60 * S, begins(B))]
        run = ran("fsar", facts, size=4)
        words = [event for time_us, event in of(run, AvailabilityChanged) if 60 * S < time_us < 61 * S]
        first.add(tuple(word.reason for word in words))
        assert words[-1] == past.available(B, None, after, words[-1].reason), (start, since, words)
        assert run.state.registry.silent == {}
    assert first == {("answers again",), ("answers again", "actuator")}


def test_a_silent_robot_that_nobody_would_choose_is_not_waited_for() -> None:
    """B is the nearest that may help, and those that are off are farther."""
    own = past.arrived("A1-1", A, ("A navigate.indoor",), budget_us=90 * S, due_us=91 * S)
    facts: list[Fact] = [(S, own), (S + 100, ObstructionAppeared(A, "o"))]
    calm = of(ran("fsar", facts), AssistanceAdmitted)
    assert [event.helper for _, event in calm if isinstance(event, AssistanceAdmitted)] == [B]
    for far in (Robot("robot/D1"), Robot("robot/D2"), B2):
        off = ran("fsar", [(1, RobotWentOff(far)), *facts])
        assert of(off, AssistanceAdmitted) == calm, far
        assert of(off, AvailabilityChanged) == []


def relayed(low_s: float, high_s: float, *facts: Fact) -> Kernel:
    """The run of one team in which D asks B through A, with messages of this length."""
    slow = msgspec.structs.replace(CALM, message=Range(low_s, high_s))
    task = past.arrived("D1-1", Robot("robot/D1"), (f"D {DOOR} B",), budget_us=90 * S, due_us=91 * S)
    return in_a_world(RunSpec(5, "fsar", "full", "door-relay", 4, 0), slow, [*facts, (S, task)])


def test_where_the_relay_is_silent_the_relay_is_named_and_heard_when_its_word_comes_late() -> None:
    for run in (relayed(0.05, 0.5, (1, RobotWentOff(A))), relayed(5.5, 6.0)):
        (asked_us, asked), *_ = of(run, RequestIssued)
        (late_us, late), *_ = of(run, RequestUnanswered)
        assert (asked.relay, asked.principals.executed_by, late.principals.executed_by) == (A, B, A)
        assert late_us - asked_us == ANSWER_US
    words = [(event.robot, event.availability) for _, event in of(relayed(5.5, 6.0), AvailabilityChanged)]
    assert words[:2] == [(A, "offline"), (A, "ready")]


@EVERY
def test_an_acceptance_that_was_given_before_the_link_went_down_counts(architecture: Architecture) -> None:
    calm = ran(architecture, [(S, TASK)])
    [(queued_us, queued)] = of(calm, ExecutionQueued)
    run = ran(
        architecture, [(S, TASK), (queued_us + 1, LinkWentDown(queued.robot)), (40 * S, LinkCameUp(queued.robot))]
    )
    assert of(run, RequestUnanswered, AvailabilityChanged) == []
    assert of(run, ExecutionQueued) == [(queued_us, queued)]
    [(done_us, _)] = of(run, TaskCompleted)
    assert done_us > 40 * S
