"""Decisions, locality, coordination events and attributability, by the judging rules."""

import pytest

from tests.queries.histories import Row, answer, event, measured, run

WHOLE = {"requested_by": "robot/A1", "executed_by": "robot/B1", "supervised_by": "supervisor/B1"}


@pytest.mark.parametrize(
    ("decided_by", "path", "is_local"),
    [
        ("robot/A1", ["robot/A1"], True),
        ("supervisor/A1", ["supervisor/A1"], True),
        ("supervisor/fleet", ["supervisor/fleet"], True),
        ("coordinator", ["coordinator"], False),
        ("service/coordination", ["service/coordination"], False),
        ("agent/A1/planning", ["agent/A1/planning"], False),
        ("robot/A1", ["robot/B1", "robot/A1"], False),
        (None, ["coordinator"], False),
    ],
)
def test_a_decision_is_local_if_a_robot_or_named_supervisor_took_it_by_itself(
    decided_by: str | None, path: list[str], is_local: bool
) -> None:
    rows = answer(
        "facts/decisions",
        run(event("OwnStepDecided", decided_by=decided_by, path=path)),
        columns=("decision_kind", "is_local"),
    )
    assert rows == [("own-step", is_local)]


def test_an_event_with_an_empty_path_is_no_decision() -> None:
    assert (
        answer(
            "facts/decisions",
            run(
                event("ExecutionHeld", decided_by=None, path=[]),
                event("ExecutionHeld", decided_by="robot/A1", path=None),
            ),
        )
        == []
    )


def test_a_type_that_decides_nothing_is_no_decision() -> None:
    assert answer("facts/decisions", run(event("GapDetected", decided_by="robot/A1", path=["robot/A1"]))) == []


def denied(task: str | None = "t1", action: str | None = None, reason: str = "policy", by: str = "coordinator") -> Row:
    return event("RequestDenied", task_id=task, action_id=action, decided_by=by, path=[by], reason=reason)


def decided(*events: Row) -> list[str]:
    return [row[0] for row in answer("facts/decisions", run(*events), columns=("type",))]


def test_a_denial_that_still_stands_when_looked_at_again_is_not_decided_again() -> None:
    assert len(decided(denied(), denied(), denied())) == 1
    assert len(decided(denied(action="t1/1.1"), denied(action="t1/1.2"))) == 1, (
        "a new number for the same step asks nobody anew"
    )


def test_a_denial_of_something_else_or_by_somebody_else_is_decided() -> None:
    assert len(decided(denied(), denied("t2"))) == 2
    assert len(decided(denied(), denied(reason="review"))) == 2
    assert len(decided(denied(), denied(by="robot/B1"))) == 2
    assert len(decided(denied(None), denied(None))) == 2, "nothing says that these were about the same"


def test_who_asks_again_decides_to_ask_and_the_answer_is_a_decision() -> None:
    asked = event("RequestIssued", task_id="t1", decided_by="robot/A1", path=["robot/A1"])
    found = decided(asked, denied(by="robot/B1"), asked, denied(by="robot/B1"))
    assert found == ["RequestIssued.v1", "RequestDenied.v1"] * 2


def test_what_is_no_denial_is_decided_each_time() -> None:
    considered = event("CandidateMatched", task_id="t1", decided_by="coordinator", path=["coordinator"])
    assert len(decided(considered, considered)) == 2


def test_locality_is_the_share_of_local_decisions() -> None:
    local = event("RequestIssued", decided_by="robot/A1", path=["robot/A1"])
    closing = event("RequestClosed", decided_by="service/coordination", path=["service/coordination"])
    assert measured("governance_locality", local, local, local, closing) == (3, 4, 0.75)


def test_locality_of_a_run_without_decisions_is_undefined() -> None:
    assert measured("governance_locality") == (0, 0, None)


def judged(*events: Row) -> list[tuple[bool, bool, bool, bool]]:
    columns = ("has_origin", "has_executor", "has_supervisor", "is_attributable")
    with_order = answer("facts/coordination_events", run(*events), columns=("seq", *columns))
    return [(origin, executor, supervisor, whole) for _, origin, executor, supervisor, whole in with_order]


def test_a_record_with_all_principals_is_attributable_without_any_other() -> None:
    assert judged(event("GapDetected", **WHOLE)) == [(True, True, True, True)]


@pytest.mark.parametrize("lacking", WHOLE)
def test_a_record_that_lacks_one_principal_is_not_attributable(lacking: str) -> None:
    ((*_, whole),) = judged(event("GapDetected", **(WHOLE | {lacking: None})))
    assert whole is False
    judgements = judged(
        *[event(name, action_id="t1/1", **(WHOLE | {lacking: None})) for name in ("GapDetected", "RequestIssued")]
    )
    assert [whole for *_, whole in judgements] == [False, False], "the other record of the action lacks it too"


def test_a_principal_is_recoverable_from_a_record_of_the_same_robots_part_in_the_same_action() -> None:
    gap = event("GapDetected", action_id="t1/1", requested_by="robot/A1", supervised_by="supervisor/A1")
    issued = event(
        "RequestIssued",
        action_id="t1/1",
        requested_by="robot/A1",
        executed_by="robot/B1",
        supervised_by="supervisor/A1",
    )
    assert judged(gap, issued) == [(True, True, True, True)] * 2


def test_a_losing_bidder_is_not_credited_with_the_winner() -> None:
    asked = {"action_id": "t1/1", "requested_by": "robot/A1"}
    lost = event("RequestAdmitted", decided_by="agent/B2/execution", supervised_by="supervisor/B2", **asked)
    won = event("RequestAdmitted", decided_by="agent/B1/execution", supervised_by="supervisor/B1", **asked)
    accepted = event(
        "RequestAccepted",
        decided_by="agent/B1/execution",
        executed_by="robot/B1",
        supervised_by="supervisor/B1",
        **asked,
    )
    found = judged(lost, won, accepted)
    assert found == [(True, False, True, False), (True, True, True, True), (True, True, True, True)]


def test_a_supervisor_is_not_credited_with_another_robots_shift() -> None:
    asked = {"action_id": "t1/1", "requested_by": "robot/A1", "executed_by": "robot/B1"}
    issued = event("RequestIssued", decided_by="robot/A1", supervised_by=None, **asked)
    accepted = event("RequestAccepted", decided_by="robot/B1", supervised_by="supervisor/B1", **asked)
    assert judged(issued, accepted) == [(True, True, False, False), (True, True, True, True)]


def test_a_record_that_names_no_robot_recovers_nothing() -> None:
    answered = event(
        "SupervisorResponded", action_id="t1/1", decided_by="supervisor/fleet", supervised_by="supervisor/fleet"
    )
    assert judged(answered, event("RequestIssued", action_id="t1/1", **WHOLE))[0] == (False, False, True, False)


def test_a_principal_is_not_recoverable_from_another_action_another_run_or_without_an_action() -> None:
    gap = event("GapDetected", action_id="t1/1", requested_by="robot/A1", supervised_by="supervisor/A1")
    whole = {"requested_by": "robot/A1", "executed_by": "robot/B1", "supervised_by": "supervisor/A1"}
    other, loose, same = (
        event("RequestIssued", action_id="t1/2", **whole),
        event("RequestIssued", **whole),
        event("RequestIssued", action_id="t1/1", **whole),
    )
    assert judged(gap, other, loose)[0] == (True, False, True, False)
    assert answer("facts/coordination_events", run(gap), run(same, run_id="r2"), columns=("run_id", "has_executor"))[
        0
    ] == ("r1", False)
    uncorrelated = event("InternalHandoff", executed_by="robot/B1", supervised_by="supervisor/B1")
    assert judged(uncorrelated, loose)[0] == (False, True, True, False)


def test_who_owns_supervision_can_be_recovered_while_an_absence_is_on_record() -> None:
    """The metric and I5 give one answer; a robot without a supervisor of its own has H_F, who has to be named."""
    joined, alone = (
        event("RobotJoined", robot="robot/B1", supervisor=supervisor) for supervisor in ("supervisor/B1", None)
    )
    left = event("SupervisorLeft", supervisor="supervisor/B1")
    back = event("SupervisorReturned", supervisor="supervisor/B1")
    started = event(
        "ExecutionStarted", action_id="t1/1", requested_by="robot/A1", executed_by="robot/B1", supervised_by=None
    )
    for events, is_whole in (
        ([joined, left, started, back], True),
        ([joined, started], False),
        ([joined, left, back, started], False),
        ([joined, started, left], False),
        ([joined, event("SupervisorLeft", supervisor="supervisor/A1"), started], False),
        ([alone, left, started], False),
    ):
        assert judged(*events) == [(True, True, is_whole, is_whole)]
        broken = answer("invariants/i5_audit_attributability", run(*events), columns=("seq",))
        assert len(broken) == (not is_whole)


def test_a_type_that_is_no_record_does_not_count() -> None:
    assert judged(event("ExecutionQueued", **WHOLE), event("RequestRelayed", **WHOLE)) == []


def test_attributability_is_the_share_of_attributable_records() -> None:
    handoff = event("InternalHandoff")
    assert measured(
        "audit_attributability", event("GapDetected", **WHOLE), handoff, handoff, event("AwardMade", **WHOLE)
    ) == (2, 4, 0.5)
    assert measured("audit_attributability") == (0, 0, None)
