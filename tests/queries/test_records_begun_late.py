"""A record of another system that begins while work is under way: what came before is no offence, and no case."""

from typing import Any

import pytest

from tests.queries.histories import Row, act, answer, event, run
from tests.recycled import from_rows

S = 1_000_000
FOREIGN: dict[str, Any] = {"kind": "foreign", "seed": None, "scenario": None, "run": None, "architecture": None}
A, B = "robot/A1", "robot/B1"
MEMBERS = [event("RobotJoined", robot=robot, supervisor="supervisor/x") for robot in (A, B)]


def start(action_id: str, robot: str, on_behalf_of: str) -> Row:
    named = {"requested_by": on_behalf_of, "executed_by": robot, "supervised_by": "supervisor/x"}
    return act("ExecutionStarted", S, action_id, robot=robot, on_behalf_of=on_behalf_of, capability="carry", **named)


def finish(action_id: str, robot: str) -> Row:
    return act("ExecutionFinished", 2 * S, action_id, robot=robot, requested_by=A, executed_by=robot)


def attempt(action_id: str, failure: int) -> Row:
    return act("RecoveryAttempted", 3 * S, action_id, robot=A, failure=failure, number=1, level="local")


OFFENCES: dict[str, list[Row]] = {
    "i2_local_execution_ownership": [start("t/1", B, A)],
    "a1_local_runtime_self_sufficiency": [start("t/1", A, A)],
    "a5_audit_completeness": [start("t/1", B, A), finish("t/1", B)],
    "i4_outward_recovery": [attempt("t/1", 1)],
}
ARRIVED = event("TaskArrived", task_id="t", budget_us=100 * S)


def offences(invariant: str, *events: Row, **started: Any) -> int:
    return len(answer(f"invariants/{invariant}", run(*MEMBERS, *events, **started), columns=("seq",)))


def cases(invariant: str, *events: Row, **started: Any) -> int:
    rows = answer("facts/invariant_cases", run(*MEMBERS, *events, **started), columns=("invariant", "cases"))
    return sum(count for judged, count in rows if judged == invariant)


@pytest.mark.parametrize("invariant", OFFENCES)
def test_what_goes_on_when_a_record_begins_is_no_offence_and_no_case(invariant: str) -> None:
    events = OFFENCES[invariant]
    assert offences(invariant, *events, **FOREIGN) == 0
    assert cases(invariant, *events, **FOREIGN) == 0
    assert offences(invariant, *events) > 0  # a simulated run begins with its first task


@pytest.mark.parametrize("invariant", OFFENCES)
@pytest.mark.parametrize(
    "known",
    [
        [ARRIVED],
        [event("StepBegan", task_id="t", action_id="t/1", robot=A)],
        [act("GapDetected", 0, "t/1", robot=A, capability="carry")],
    ],
    ids=["its task arrived", "its step began", "its gap was found"],
)
def test_what_began_within_the_record_is_judged(invariant: str, known: list[Row]) -> None:
    assert offences(invariant, *known, *OFFENCES[invariant], **FOREIGN) > 0
    assert cases(invariant, *known, *OFFENCES[invariant], **FOREIGN) > 0


def test_a_source_that_records_no_arrivals_cannot_tell_what_goes_on() -> None:
    observes = ["fleet", "request", "execution", "authority"]
    events = OFFENCES["i2_local_execution_ownership"]
    assert offences("i2_local_execution_ownership", *events, observes=observes, **FOREIGN) == 1
    assert offences("i2_local_execution_ownership", *events, observes=observes, records=["TaskArrived"], **FOREIGN) == 0


def test_the_next_failure_of_what_goes_on_is_judged_from_its_detection_on() -> None:
    failed = act("ExecutionFailed", 4 * S, "t/1", robot=A, failure=2, cause="worn")
    skipped = act("RecoveryEscalated", 5 * S, "t/1", robot=A, failure=2, level="local", to_level="human")
    assert offences("i4_outward_recovery", attempt("t/1", 1), failed, skipped, **FOREIGN) == 1
    assert cases("i4_outward_recovery", attempt("t/1", 1), failed, skipped, **FOREIGN) == 2


OPEN_POLICY, OFF_SHIFT = "the policy before the record", "who was off shift before the record"


def hidden(*events: Row, **started: Any) -> dict[str, tuple[str, bool]]:
    rows = answer(
        "facts/unobservable",
        run(*MEMBERS, *events, **started),
        columns=("judge", "not_observed", "hides_offences"),
    )
    return {judge: (what, hides) for judge, what, hides in rows}


def test_a_window_that_closes_without_having_opened_was_in_force_before() -> None:
    closed = event("PolicyWindowClosed", 50 * S, robot=B, scope="local", window="w")
    found = hidden(closed, **FOREIGN)
    assert found["policy_violations"] == found["i3_jointly_composed_policy"] == (OPEN_POLICY, False)
    assert not hidden(closed)
    opened = event("PolicyWindowOpened", 0, robot=B, scope="local", window="w", outcome="deny")
    assert not hidden(opened, closed, **FOREIGN)


def test_nobody_knows_what_a_policy_said_before_its_window_closed() -> None:
    closed = event("PolicyWindowClosed", 50 * S, robot=B, scope="local", window="w")
    with from_rows(run(*MEMBERS, closed, **FOREIGN)) as database:
        for at, outcome in ((12, None), (55, "allow")):
            rows = database.query("audit/policy_at", {"robot": B, "at_us": f"{at * S}"}).to_pylist()
            assert {row["outcome"] for row in rows if row["scope"] == "local"} == {outcome}


def test_nobody_is_said_to_know_a_policy_wrongly_that_a_window_before_the_record_may_have_set() -> None:
    told = event("SnapshotTaken", S, robot=B, outcome="deny")
    closed = event("PolicyWindowClosed", 50 * S, robot=B, scope="local", window="w")
    with from_rows(run(*MEMBERS, told, closed, **FOREIGN)) as database:
        for at, expected in ((12, (None, None)), (55, ("allow", True))):
            rows = database.query("audit/policy_known_at", {"robot": B, "at_us": f"{at * S}"}).to_pylist()
            assert [(row["true_outcome"], row["is_wrong"]) for row in rows if row["known_outcome"]] == [expected]


def test_who_returns_without_having_left_was_off_shift_before() -> None:
    returned = event("SupervisorReturned", 50 * S, supervisor="supervisor/x")
    found = hidden(returned, **FOREIGN)
    assert found["a5_audit_completeness"] == found["audit_attributability"] == (OFF_SHIFT, True)
    assert not hidden(event("SupervisorLeft", S, supervisor="supervisor/x"), returned, **FOREIGN)


@pytest.mark.parametrize(
    ("query", "told"), [("robot_state_at", {"state": "executing"}), ("robot_activity", {"doing": "executing"})]
)
def test_what_a_robot_does_is_told_where_a_source_records_how_executions_end(query: str, told: Row) -> None:
    events = (start("t/1", A, A), act("ExecutionFinished", 20 * S, "t/1", robot=A, executed_by=A))
    for records, expected in (
        (["ExecutionStarted", "ExecutionFinished", "ExecutionWithdrawn"], [{"action_id": "t/1", **told}]),
        (["ExecutionStarted", "ExecutionFinished"], []),
        (["ExecutionStarted"], []),
    ):
        with from_rows(run(*events, kind="foreign", observes=[], records=records)) as database:
            for at, rows in ((10, expected), (20, [])):
                found = database.query(f"audit/{query}", {"at_us": f"{at * S}"}).to_pylist()
                assert [{name: row[name] for name in ("action_id", *told)} for row in found] == rows


@pytest.mark.parametrize(
    ("first", "until"),
    [
        (act("ExecutionFinished", 20 * S, "t/1", robot=A, executed_by=A), 20),
        (act("ExecutionPaused", 20 * S, "t/1", robot=A), 20),
        (act("RecoveryEscalated", 15 * S, "t/1", robot=A, failed_action="t/1", failure=1, to_level="fleet"), 30),
        (act("AssistanceEnded", 20 * S, "t/1", robot=B, helper=A, failure=1), 20),
        (event("RobotCameBack", 20 * S, robot=A), 20),
    ],
)
@pytest.mark.parametrize(("query", "column"), [("robot_state_at", "state"), ("robot_activity", "doing")])
def test_a_robot_is_not_idle_before_the_end_of_what_it_was_in_when_the_record_began(
    query: str, column: str, first: Row, until: int
) -> None:
    ended = act("ExecutionWithdrawn", 30 * S, "t/1", robot=A)
    with from_rows(run(*MEMBERS, first, ended, **FOREIGN)) as database:
        for at, expected in ((5, None), (until - 1, None), (30, "idle")):
            [row] = database.query(f"audit/{query}", {"robot": A, "at_us": f"{at * S}"}).to_pylist()
            assert row[column] == expected, at
    with from_rows(run(*MEMBERS, start("t/1", A, A), ended, **FOREIGN)) as database:
        [row] = database.query(f"audit/{query}", {"robot": A, "at_us": "0"}).to_pylist()
        assert row[column] == "idle"


def test_the_records_of_a_supervisor_who_returns_without_having_left_were_made_off_shift() -> None:
    returned = event("SupervisorReturned", 50 * S, supervisor="supervisor/x")
    later = act("ExecutionStarted", 60 * S, "t/1", robot=A, executed_by=A, supervised_by="supervisor/x")
    given = run(*MEMBERS, start("t/1", A, A), returned, later, **FOREIGN)
    columns = ("supervised_by", "records", "records_off_shift")
    assert set(answer("audit/supervisor_of", given, columns=columns)) == {("supervisor/x", 2, 1)}


def test_a_source_that_was_opened_again_is_open() -> None:
    opened = event("SourceOpened", 0, source="bag", format="mcap")
    closed = event("SourceClosed", 9 * S, source="bag", until_us=8 * S)
    history = run(opened, closed, {**opened, "time_us": 20 * S}, **FOREIGN)
    assert answer("audit/recordings", history, columns=("seq", "until_us")) == [(1, 8 * S), (3, None)]


@pytest.mark.parametrize(
    ("told", "failures"),
    [
        (act("ExecutionPaused", S, "t/1", robot=A), 0),
        (act("ExecutionResumed", S, "t/1", robot=A), 0),
        (act("ExecutionFailed", S, "t/1", robot=A, failure=2, cause="worn"), 1),
        (attempt("t/1", 1), 1),
    ],
)
def test_an_action_that_was_under_way_had_begun_and_a_failure_that_is_being_recovered_had_happened(
    told: Row, failures: int
) -> None:
    rows = run(told, **FOREIGN)
    assert answer("facts/action_records", rows, columns=("failures", "state")) == [(failures, "not finished")]
