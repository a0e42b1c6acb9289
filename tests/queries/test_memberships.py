"""Who was a member when, and what is found of a robot that acts although it had left."""

from typing import Any

import pytest

from tests.queries.histories import Row, S, act, answer, event, run

B = "robot/B1"
JOINED = event("RobotJoined", 0, robot=B, role="B", supervisor="supervisor/B1")


def departed(at_s: int, fence: int = 1, reason: str = "silent") -> Row:
    return event("RobotDeparted", at_s * S, robot=B, reason=reason, fence=fence, decided_by="service/registry")


def returned(at_s: int, fence: int = 1) -> Row:
    return event("RobotReturned", at_s * S, robot=B, fence=fence)


def test_a_robot_has_a_row_for_each_time_for_which_it_was_a_member() -> None:
    history = run(
        JOINED,
        event("RobotSuspected", 2 * S, robot=B),
        event("RobotCleared", 3 * S, robot=B),
        event("RobotSuspected", 5 * S, robot=B),
        departed(9),
        returned(20),
        departed(30, 2, "announced"),
    )
    columns = ("robot", "fence", "began_us", "ended_us", "how", "suspected", "cleared")
    assert answer("audit/memberships", history, columns=columns) == [
        (B, 0, 0, 9 * S, "silent", 2, 1),
        (B, 1, 20 * S, 30 * S, "announced", 0, 0),
    ]


def test_a_member_has_no_end() -> None:
    assert answer("audit/memberships", run(JOINED), columns=("robot", "fence", "ended_us")) == [(B, 0, None)]


def test_a_member_of_which_nobody_recorded_that_it_joined_was_one_until_it_departed() -> None:
    columns = ("robot", "fence", "began_us", "ended_us", "how")
    events = (event("RobotSuspected", 5 * S, robot=B), departed(9), returned(20))
    assert answer("audit/memberships", run(*events), columns=columns) == [
        (B, 0, None, 9 * S, "silent"),
        (B, 1, 20 * S, None, None),
    ]


def test_how_often_a_robot_had_departed_is_not_known_where_departures_are_not_recorded() -> None:
    history = run(JOINED, returned(20), observes=["trust"], records=["RobotJoined", "RobotReturned"])
    assert answer("audit/memberships", history, columns=("fence", "began_us")) == [(None, 0)]


def found(*events: Row) -> list[Any]:
    return [row[0] for row in answer("invariants/i1_local_agent_coherence", run(JOINED, *events), columns=("found",))]


def claimed(at_s: int, **fields: Any) -> Row:
    return act("AuthorityClaimed", at_s * S, "t/1.1", claimant=B, dimension="execution", reason="acceptance", **fields)


@pytest.mark.parametrize(
    "does",
    [
        act("ExecutionStarted", 12 * S, "t/1.1", robot=B, on_behalf_of=B, capability="fly"),
        act("ExecutionResumed", 12 * S, "t/1.1", robot=B),
        act("ExecutionFinished", 12 * S, "t/1.1", robot=B),
        act("ApproachStarted", 12 * S, "t/1.1", robot=B),
        act("RequestAccepted", 12 * S, "t/1.1", decided_by=B, executed_by=B),
        act("AssistanceAdmitted", 12 * S, "t/1.1", robot="robot/A1", helper=B),
        claimed(12, fence=1),
    ],
)
def test_a_robot_that_acts_after_it_departed_is_found_and_before_it_and_after_its_return_it_is_not(does: Row) -> None:
    assert found(departed(9), does) == [f"{B} acts after it departed"]
    assert found(does, departed(13)) == []
    assert found(departed(9), returned(10), does) == []


def test_a_robot_that_joins_anew_after_it_departed_is_in_the_fleet_again() -> None:
    again = {**JOINED, "time_us": 10 * S}
    assert found(departed(9), again, claimed(12)) == []
    assert found(departed(9), again, departed(11, 2), claimed(12)) == [f"{B} acts after it departed"]
    assert found(departed(9), again, {**again, "time_us": 11 * S}) == [f"{B} joins although it is in the fleet"]
    assert found(departed(9), returned(10), {**again, "time_us": 11 * S}) == [f"{B} joins although it is in the fleet"]


def test_a_claim_under_an_old_number_is_found() -> None:
    twice = (departed(2), returned(3), departed(4, 2), returned(5, 2))
    assert found(*twice, claimed(6, fence=1)) == [f"{B} claims authority under fencing number 1 after 2 departures"]
    assert found(departed(2), returned(3), claimed(6)) == [
        f"{B} claims authority under fencing number 0 after 1 departures"
    ]
    assert found(*twice, claimed(6, fence=2)) == []


def test_no_claim_is_under_an_old_number_where_the_numbers_of_claims_are_not_recorded() -> None:
    types = ["RobotJoined", "RobotDeparted", "RobotReturned", "AuthorityClaimed"]

    def accused(*events: Row, records: list[str]) -> list[Any]:
        rows = run(JOINED, *events, kind="foreign", observes=[], records=records)
        hidden = answer("facts/unobservable", rows, columns=("judge", "not_observed"))
        lacking = [lacks for judge, lacks in hidden if judge == "i1_local_agent_coherence"]
        return [*answer("invariants/i1_local_agent_coherence", rows, columns=("found",)), *lacking]

    claim = claimed(4)
    assert accused(departed(2), returned(3), claim, records=types) == ["AuthorityClaimed.fence"]
    assert accused(departed(2), claim, records=types) == [(f"{B} acts after it departed",), "AuthorityClaimed.fence"]
    assert accused(departed(2), returned(3), claim, records=[*types, "AuthorityClaimed.fence"]) == [
        (f"{B} claims authority under fencing number 0 after 1 departures",)
    ]


@pytest.mark.parametrize("question", ["audit/robot_activity", "audit/robot_state_at"])
def test_who_is_off_or_has_departed_is_not_idle_and_who_works_need_not_have_joined(question: str) -> None:
    works = act("ExecutionStarted", 3 * S, "t1/1", robot="robot/C1", ends_us=9 * S)
    off = event("RobotWentOff", 3 * S, robot="robot/A1")
    history = (event("RobotJoined", 0, robot="robot/A1"), JOINED, departed(2), off, works)
    assert [row[1:3] for row in answer(question, run(*history))] == [
        ("robot/A1", "off"),
        (B, "departed"),
        ("robot/C1", "executing"),
    ]
    ends = act("ExecutionFinished", 4 * S, "t1/1", robot="robot/C1", result="success")
    back = (event("RobotCameBack", 4 * S, robot="robot/A1"), returned(4), ends)
    assert [row[1:3] for row in answer(question, run(*history, *back))] == [("robot/A1", "idle"), (B, "idle")]


@pytest.mark.parametrize(
    ("question", "needed"),
    [
        ("audit/robot_activity", {"execution", "recovery"}),
        ("audit/robot_state_at", {"execution", "recovery", "registry", "supervision", "world"}),
    ],
)
def test_a_robot_is_idle_only_where_all_that_it_could_be_at_is_observed(question: str, needed: set[str]) -> None:
    for missing in (None, *needed):
        observes = sorted({"fleet", *needed} - {missing})
        history = run(JOINED, kind="foreign", observes=observes, records=["RobotJoined"])
        assert [row[2] for row in answer(question, history)] == [None if missing else "idle"], missing


def test_nobody_is_said_to_be_away_or_to_act_meanwhile_where_a_run_does_not_tell_who_returned() -> None:
    asks = event("RegistryQueried", 12 * S, requested_by="robot/A1", capability="fly", candidates=[B], domain="")
    started = act("ExecutionStarted", 12 * S, "t/1.1", robot=B, on_behalf_of=B, capability="fly")
    for records, acts, reason in (
        (["RobotDeparted"], None, "candidate"),
        (["RobotDeparted", "RobotReturned"], 1, "candidate, although it had departed"),
    ):
        history = run(JOINED, departed(9), asks, started, kind="foreign", observes=[], records=records)
        assert answer("audit/churn", history, columns=("found_out", "acts")) == [(1, acts)]
        assert answer("audit/query_candidates", history, columns=("reason",)) == [(reason,)]


@pytest.mark.parametrize("question", ["audit/robot_activity", "audit/robot_state_at"])
def test_a_robot_is_not_said_to_be_off_or_away_for_good_where_nobody_records_when_robots_come_back(
    question: str,
) -> None:
    off = event("RobotWentOff", 3 * S, robot="robot/A1")
    history = (event("RobotJoined", 0, robot="robot/A1"), JOINED, departed(2), off)
    observes = ["execution", "recovery", "registry", "supervision"]
    leaving = ["RobotJoined", "RobotDeparted", "RobotWentOff"]
    coming = [*leaving, "RobotCameBack", "RobotReturned"]
    for records, states in ((leaving, [None, None]), (coming, ["off", "departed"])):
        rows = run(*history, kind="foreign", observes=observes, records=records)
        assert [row[2] for row in answer(question, rows)] == states
    begins = act("ExecutionStarted", 5 * S, "t1/1", robot="robot/A1", ends_us=9 * S)
    rows = run(*history, begins, kind="foreign", observes=observes, records=leaving)
    assert [row[2] for row in answer(question, rows)] == ["executing", None]


def test_what_a_run_does_not_record_is_not_counted_as_never() -> None:
    columns = ("announced", "found_out", "suspected", "cleared", "returned", "away", "requests_failed")
    tasks = ("tasks_recovered", "tasks_abandoned")
    for observes, records, suspected, none in (
        ([], ["RobotDeparted"], None, None),
        ([], ["RobotDeparted", "RobotSuspected"], 0, None),
        (["fleet", "recovery", "request", "task", "world"], None, 0, 0),
    ):
        rows = run(JOINED, departed(9), kind="foreign", observes=observes, records=records)
        assert answer("audit/churn", rows, columns=columns) == [(0, 1, suspected, none, none, none, none)]
        assert answer("audit/churn", rows, columns=tasks) == [(none, none)]
        assert answer("audit/memberships", rows, columns=("suspected", "cleared")) == [(suspected, none)]
    seen = run(JOINED, event("RobotSuspected", 5 * S, robot=B), kind="foreign", observes=[])
    assert answer("audit/memberships", seen, columns=("suspected", "cleared")) == [(1, None)]
