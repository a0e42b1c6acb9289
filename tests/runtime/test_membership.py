"""Robots leave the fleet and return: nothing stays open that only they could end, and nobody acts on an old claim."""

from typing import Any

import pytest

from fsar_ledger.designs.constants import Constants, Membership
from fsar_ledger.events.authority import AuthorityClaimed, AuthorityReleased
from fsar_ledger.events.envelope import DEPARTED, FLEET_SUPERVISOR, Robot, local_supervisor
from fsar_ledger.events.execution import ExecutionFailed, ExecutionFinished, ExecutionWithdrawn
from fsar_ledger.events.fleet import HeartbeatReceived, RobotCleared, RobotDeparted, RobotReturned, RobotSuspected
from fsar_ledger.events.recovery import AssistanceFailed, ReassignmentDecided, RecoveryEscalated
from fsar_ledger.events.registry import AvailabilityChanged, RegistryQueried
from fsar_ledger.events.request import RequestClosed
from fsar_ledger.events.supervision import SupervisorCalled, SupervisorResponded
from fsar_ledger.events.task import TaskAbandoned, TaskCompleted
from fsar_ledger.ledger.rows.codec import encode
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.registry import surface
from fsar_ledger.runtime.architectures.fsar import FSAR
from fsar_ledger.runtime.architectures.fsar.authority import Revoke
from fsar_ledger.runtime.architectures.fsar.reports import JudgeAssistance, JudgeRequest, ReportPresence, ReportStart
from fsar_ledger.runtime.handlers.fleet import JoinFleet, LeaveFleet
from fsar_ledger.runtime.handlers.public import PublicCommand
from fsar_ledger.runtime.handlers.recovery import ReportFailure
from fsar_ledger.runtime.handlers.registry import ReportAvailability
from fsar_ledger.runtime.handlers.request import ReportResult, RequestCapability
from fsar_ledger.runtime.handlers.supervision import RespondToCall, SetSupervisionDensity
from fsar_ledger.runtime.handlers.task import SubmitTask
from fsar_ledger.runtime.live import LiveRun, live_started
from fsar_ledger.runtime.run_replay import replay_run
from fsar_ledger.service.pages import OpenCall, overview
from tests.recycled import from_table
from tests.runtime.test_live import OPENING, A, B, C, D, Play, S, at_the_door, at_the_peers, done, opening


def leave(robot: Robot) -> LeaveFleet:
    return LeaveFleet(robot=robot)


def join(robot: Robot, **fields: Any) -> JoinFleet:
    return JoinFleet(**{"robot": robot, "role": robot[6], "team": 1, "supervisor": local_supervisor(robot), **fields})


def holders(play: Play, robot: Robot) -> list[str]:
    claims = play.run.kernel.state.authority.claims
    return [name for name, held in claims.items() if any(claim.claimant == robot for claim in held)]


def availabilities(play: Play, robot: Robot) -> set[str]:
    return {record.availability for record in surface(play.run.kernel.state.registry, robot)}


def test_what_the_robot_executes_goes_outward_through_recovery_level_by_level() -> None:
    play = opening().does(leave(B)).wait(30)
    [departed] = play.of(RobotDeparted)
    assert (departed.reason, departed.fence, departed.decided_by) == ("announced", 1, B)
    [failed] = play.of(ExecutionFailed)
    assert (failed.cause, failed.subject.action_id) == (DEPARTED, OPENING)
    assert (failed.failure, failed.remaining_us, failed.detected_us // S) == (1, None, 6)
    assert [event.to_level for event in play.of(RecoveryEscalated)] == ["peer", "fleet", "human"]
    assert [event.helper for event in play.of(ReassignmentDecided)] == [None]
    assert [event.supervisor for event in play.of(SupervisorCalled)] == [FLEET_SUPERVISOR]
    assert "Asked for help: nobody." in shown(play)[0].known
    assert replay_run(play.record) is None


def test_its_claims_are_released_its_entries_offline_and_it_has_nothing_in_hand() -> None:
    play = opening()
    assert holders(play, B) == [OPENING]
    play.does(leave(B))
    assert holders(play, B) == []
    assert {event.dimension for event in play.of(AuthorityReleased)} == {"execution", "override"}
    assert availabilities(play, B) == {"offline"}
    assert B not in play.run.kernel.state.execution.current


def test_an_entry_that_a_robot_reported_after_it_had_not_answered_is_offline_when_it_leaves() -> None:
    play = at_the_door().wait(60)
    assert availabilities(play, B) == {"offline"}
    play.does(ReportAvailability(B, "door.open.basic", "ready", "restarted"))
    assert availabilities(play, B) == {"offline", "ready"}
    [gone] = play.does(leave(B)).of(AvailabilityChanged)[-1:]
    assert (gone.capability, gone.reason) == ("door.open.basic", DEPARTED)
    assert availabilities(play, B) == {"offline"}


def test_a_human_who_settles_it_ends_the_request_as_a_departure_and_the_step_is_begun_again() -> None:
    play = opening().does(leave(B)).wait(30)
    play.does(RespondToCall(supervisor=FLEET_SUPERVISOR, action_id=OPENING, approves=True)).wait(20)
    [closed] = play.of(RequestClosed)
    assert (closed.subject.action_id, closed.result, closed.cause) == (OPENING, "failure", DEPARTED)
    assert [event.subject.action_id for event in play.of(RegistryQueried)].count("t/2.2") == 1
    assert B not in {one for event in play.of(RegistryQueried)[1:] for one in event.candidates}
    assert not play.of(ExecutionFinished)[1:]
    assert replay_run(play.record) is None


def test_a_review_that_is_answered_after_the_robot_has_left_allows_nothing_and_is_shown_to_nobody() -> None:
    review = SetSupervisionDensity(issued_by=FLEET_SUPERVISOR, robot=B, review_every=1, reason="test")
    play = at_the_door().does(review, JudgeRequest(robot=B, action_id=OPENING, accepts=True))
    assert [call.action_id for call in shown(play)] == [OPENING]
    play.does(leave(B))
    assert shown(play) == ()
    answer = RespondToCall(supervisor=FLEET_SUPERVISOR, action_id=OPENING, approves=True)
    assert play.does(answer).of(SupervisorResponded)
    assert allowed(play) is None
    assert replay_run(play.wait(60).record) is None
    in_time = at_the_door().does(review, JudgeRequest(robot=B, action_id=OPENING, accepts=True), answer, leave(B))
    assert f"{FLEET_SUPERVISOR}" in f"{allowed(in_time)}"


def allowed(play: Play) -> object:
    """Who allowed the request, by the queries."""
    with from_table(encode([play.record])) as database:
        rows = database.rows("SELECT allowed_by FROM action_records WHERE action_id = $action", {"action": OPENING})
    return rows[0]["allowed_by"]


def shown(play: Play) -> tuple[OpenCall, ...]:
    return overview(play.run.kernel.state, play.now_s * S, "auditor/anna", "day").calls


def test_a_request_that_waits_for_the_robot_ends_at_once_as_a_departure() -> None:
    for play in (at_the_door(), at_the_door().does(JudgeRequest(robot=B, action_id=OPENING, accepts=True))):
        play.does(leave(B))
        [closed] = play.of(RequestClosed)
        assert (closed.result, closed.cause, closed.principals.executed_by) == ("failure", DEPARTED, B)
        assert not play.of(ExecutionFailed)
        assert holders(play, B) == []
        assert replay_run(play.wait(60).record) is None


def test_a_task_that_waits_for_the_robot_to_act_is_given_up_at_once_and_others_finish_what_they_have_begun() -> None:
    play = opening().does(leave(A))
    assert [event.task_id for event in play.of(TaskAbandoned)] == ["t"]
    play.does(done(B, OPENING)).wait(5)
    assert OPENING in {event.subject.action_id for event in play.of(ExecutionFinished)}
    assert holders(play, B) == []
    waiting = at_the_door().does(JudgeRequest(robot=B, action_id=OPENING, accepts=True), leave(A))
    assert waiting.of(ExecutionWithdrawn)
    assert holders(waiting, B) == []
    assert [event.cause for event in waiting.of(RequestClosed)] == [DEPARTED]


def test_a_task_that_comes_to_a_step_of_a_robot_that_has_left_is_given_up_then() -> None:
    steps = ("A navigate.indoor", "C inspect.visual")
    play = Play().does(SubmitTask(robot=A, task_id="u", steps=steps, budget_us=600 * S), leave(C))
    assert not play.of(TaskAbandoned)
    play.does(ReportStart(robot=A, action_id="u/1.1"), done(A, "u/1.1")).wait(1)
    assert [event.task_id for event in play.of(TaskAbandoned)] == ["u"]
    assert replay_run(play.record) is None


def test_what_was_due_of_a_robot_when_it_left_does_not_act_for_it_afterwards() -> None:
    """Each command was scheduled while the robot was there, and is decided when it has left."""
    state = opening().does(leave(A)).run.kernel.state
    assert holders_of(state, OPENING) == {B}
    assert FSAR.decides[Revoke](state, Revoke(A)) == ()
    assert FSAR.decides[Revoke](opening().run.kernel.state, Revoke(A)) != ()


def holders_of(state: State, action_id: str) -> set[str]:
    return {claim.claimant for claim in state.authority.claims.get(action_id, ())}


def test_a_robot_that_helps_and_leaves_is_replaced_as_one_that_could_not() -> None:
    play = at_the_peers()
    helper = play.run.kernel.state.recovery[OPENING].awaited
    assert helper is not None
    play.does(JudgeAssistance(robot=helper, action_id=OPENING, accepts=True), leave(helper)).wait(20)
    assert [(event.helper, event.cause) for event in play.of(AssistanceFailed)] == [(helper, DEPARTED)]
    assert {event.to_level for event in play.of(RecoveryEscalated)} >= {"fleet"}


def test_who_is_helped_and_leaves_frees_the_helper() -> None:
    play = at_the_peers()
    helper = play.run.kernel.state.recovery[OPENING].awaited
    assert helper is not None
    play.does(JudgeAssistance(robot=helper, action_id=OPENING, accepts=True), leave(B)).wait(20)
    assert helper not in play.run.kernel.state.execution.current
    assert [event.cause for event in play.of(ExecutionFailed)] == ["obstruction"]
    assert [event.to_level for event in play.of(RecoveryEscalated)] == ["peer", "fleet", "human"]


def test_a_robot_that_leaves_while_it_recovers_by_itself_leaves_the_failure_to_the_next_level() -> None:
    play = opening().does(ReportFailure(robot=B, action_id=OPENING, cause="hinge jammed"), leave(B)).wait(30)
    assert len(play.of(ExecutionFailed)) == 1
    assert play.of(RecoveryEscalated)[0].reason == DEPARTED
    assert [event.to_level for event in play.of(RecoveryEscalated)] == ["peer", "fleet", "human"]


def test_who_was_asked_to_help_a_robot_that_has_left_meanwhile_helps_nobody() -> None:
    play = at_the_peers()
    helper = play.run.kernel.state.recovery[OPENING].awaited
    assert helper is not None
    play.does(leave(B))
    refused = play.give(JudgeAssistance(robot=helper, action_id=OPENING, accepts=True))
    assert refused == "robot/B1 has departed, expected a robot that is there to be helped"
    assert [event.to_level for event in play.wait(20).of(RecoveryEscalated)] == ["peer", "fleet", "human"]


@pytest.mark.parametrize(
    ("command", "said"),
    [
        (done(B, OPENING), "robot/B1 has departed (announced), expected that it returns by JoinFleet first"),
        (ReportStart(robot=B, action_id=OPENING), "robot/B1 has departed"),
        (JudgeRequest(robot=B, action_id=OPENING, accepts=True), "robot/B1 has departed"),
        (ReportPresence(robot=B, is_on=True), "robot/B1 has departed"),
        (leave(B), "robot/B1 has departed"),
        (RequestCapability(A, B, "door.open.secure", "visit", "q"), "robot/B1 has departed"),
        (SubmitTask(robot=B, task_id="u", steps=("B navigate.indoor",), budget_us=S), "robot/B1 has departed"),
        (leave(Robot("robot/Z9")), "unknown robot robot/Z9"),
        (LeaveFleet(robot=C, issued_by=local_supervisor(D)), "supervisor/D1 does not supervise robot/C1"),
        (join(B, issued_by=local_supervisor(D)), "supervisor/D1 does not supervise robot/B1"),
        (join(B, issued_by="supervisor/Z9"), "unknown supervisor supervisor/Z9"),
        (join(B, role="X"), "role X, expected B: robot/B1 has departed, and its name stays its own"),
        (join(B, public_key="k"), "public_key k, expected None"),
        (join(A), "robot/A1 is a member already"),
        (join(Robot("robot/E1"), role="E", supervisor=None, public_key=""), "an empty public key"),
    ],
)
def test_what_a_departed_robot_says_and_what_is_asked_of_it_is_rejected(command: PublicCommand, said: str) -> None:
    refused = opening().does(leave(B)).give(command)
    assert refused is not None
    assert refused.startswith(said), refused


def test_a_robot_returns_as_itself_with_its_trust_and_is_asked_again() -> None:
    play = at_the_door()
    trust = play.run.kernel.state.trust.of_roles
    play.does(leave(B), join(B)).wait(6)
    [back] = play.of(RobotReturned)
    assert (back.robot, back.fence) == (B, 1)
    assert play.run.kernel.state.trust.of_roles == trust
    assert not play.run.kernel.state.trust.records
    assert availabilities(play, B) == {"ready"}
    play.does(JudgeRequest(robot=B, action_id="t/2.2", accepts=True, fence=1))
    claims = [event for event in play.of(AuthorityClaimed) if event.subject.action_id == "t/2.2"]
    assert {(event.claimant, event.fence) for event in claims} == {(B, 1)}
    play.does(
        ReportStart(robot=B, action_id="t/2.2", fence=1),
        ReportResult(executor=B, action_id="t/2.2", result="success", fence=1),
        ReportStart(robot=A, action_id="t/3.1"),
        done(A, "t/3.1"),
    )
    assert play.of(TaskCompleted)
    assert replay_run(play.record) is None


def test_a_new_robot_keeps_its_key_and_nobody_else_returns_under_its_name() -> None:
    new = Robot("robot/E1")
    play = Play().does(join(new, public_key="ed25519:1"), leave(new))
    assert "public_key ed25519:2, expected ed25519:1" in str(play.give(join(new, public_key="ed25519:2")))
    assert "public_key None" in str(play.give(join(new)))
    play.does(join(new, public_key="ed25519:1"))
    assert [event.fence for event in play.of(RobotReturned)] == [1]


@pytest.mark.parametrize("fence", [None, 0, 2])
def test_what_was_said_before_a_departure_does_not_answer_what_was_asked_after_the_return(fence: int | None) -> None:
    """The same step comes back to the robot that had it; only the number tells its old report from a new one."""
    play = at_the_door().does(leave(B), join(B)).wait(6)
    play.does(JudgeRequest(robot=B, action_id="t/2.2", accepts=True, fence=1))
    play.does(ReportStart(robot=B, action_id="t/2.2", fence=1))
    late = ReportResult(executor=B, action_id="t/2.2", result="success", fence=fence)
    assert "expected 1, which it was given when it returned" in str(play.give(late))
    play.does(ReportResult(executor=B, action_id="t/2.2", result="success", fence=1))


def test_a_robot_that_never_left_names_no_number() -> None:
    refused = opening().give(ReportResult(executor=B, action_id=OPENING, result="success", fence=1))
    assert refused == "robot/B1 says so under fencing number 1, expected none"


WATCHED = Constants(membership=Membership(heartbeat_us=5 * S, suspect_us=10 * S, depart_us=20 * S))


class WatchedPlay(Play):
    """A play whose robots are watched."""

    def __init__(self) -> None:
        self.run = LiveRun(live_started(WATCHED, 4, "2026-03-01T10:00:00Z"), WATCHED)
        self.now_s = 0


def beat(robot: Robot, fence: int | None = None) -> ReportPresence:
    return ReportPresence(robot=robot, is_on=True, fence=fence)


def test_a_robot_that_falls_silent_is_suspected_and_then_has_departed() -> None:
    play = WatchedPlay().does(beat(B)).wait(9)
    assert not play.of(RobotSuspected)
    assert [event.robot for event in play.wait(2).of(RobotSuspected)] == [B]
    assert not play.wait(18).of(RobotDeparted)
    [departed] = play.wait(3).of(RobotDeparted)
    assert (departed.robot, departed.reason, departed.fence) == (B, "silent", 1)
    assert replay_run(play.record) is None


def test_a_heartbeat_clears_the_suspicion_and_nothing_was_taken_from_the_robot() -> None:
    play = WatchedPlay().does(beat(B)).wait(12)
    state = play.run.kernel.state
    assert state.knowledge.suspected == {B}
    assert availabilities(play, B) == {"ready"}
    play.does(beat(B)).wait(8)
    assert len(play.of(RobotCleared)) == 1
    assert not play.run.kernel.state.knowledge.suspected
    assert not play.of(RobotDeparted)
    assert [event.number for event in play.of(HeartbeatReceived)] == [1, 2]


def test_a_robot_that_was_wrongly_declared_departed_cannot_go_on_and_returns() -> None:
    play = WatchedPlay().does(beat(B)).wait(40)
    assert "robot/B1 has departed (silent)" in str(play.give(beat(B)))
    play.does(join(B), beat(B, 1))
    assert "under no fencing number" in str(play.give(beat(B)))


def test_who_never_sent_a_heartbeat_or_says_that_it_goes_off_is_not_suspected() -> None:
    play = WatchedPlay().does(beat(B), ReportPresence(robot=B, is_on=False)).wait(600)
    assert not play.of(RobotSuspected, RobotDeparted)
    play.does(beat(B)).wait(60)
    assert [event.robot for event in play.of(RobotDeparted)] == [B]


def test_without_a_heartbeat_interval_nobody_is_watched() -> None:
    play = Play()
    assert play.give(beat(B)) == "robot/B1 is on already"
    assert not play.wait(600).of(HeartbeatReceived, RobotSuspected, RobotDeparted)
