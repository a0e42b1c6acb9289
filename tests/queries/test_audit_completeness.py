"""A5 of requests that are sent again, and of two robots at one action."""

from typing import Any

from tests.queries.histories import act, answer, run


def a5_offences(*acts: tuple[str, dict[str, Any]]) -> list[str]:
    """What A5 finds in these acts of B1 or C1 for A1, all of them about one action."""
    asked = {"on_behalf_of": "robot/A1", "requested_by": "robot/A1", "supervised_by": "x", "request_id": "q"}
    rows = run(*(act(name, at, "t1/1", **{**asked, **columns}) for at, (name, columns) in enumerate(acts, 1)))
    return [found for (found,) in answer("invariants/a5_audit_completeness", rows, columns=("found",))]


OF_B, OF_C = ({"robot": name, "executed_by": name} for name in ("robot/B1", "robot/C1"))
ASKED_B: list[tuple[str, dict[str, Any]]] = [(f"Request{name}", OF_B) for name in ("Issued", "Admitted", "Accepted")]


def test_a5_takes_a_request_that_was_sent_again_for_the_one_it_was() -> None:
    issued, start = ASKED_B[0], ("ExecutionStarted", OF_B)
    anew = ["robot/B1 for robot/A1: no admission of the request"]
    assert a5_offences(*ASKED_B, issued, issued, start) == []
    for end in ("RequestDenied", "RequestClosed"):
        assert a5_offences(*ASKED_B, (end, OF_B), issued, start) == anew
    assert a5_offences(*ASKED_B, ("RequestIssued", {**OF_B, "request_id": "other"}), start) == anew
    unnamed = [(name, {**columns, "request_id": None}) for name, columns in (*ASKED_B, issued, start)]
    assert a5_offences(*unnamed) == anew


def test_a5_lets_each_of_two_robots_end_what_it_began() -> None:
    asked_c = [(name, OF_C) for name, _ in ASKED_B]
    both = (*ASKED_B, ("ExecutionStarted", OF_B), *asked_c, ("ExecutionStarted", OF_C))
    b_ends, c_ends = ("ExecutionFinished", OF_B), ("ExecutionFinished", OF_C)
    taken = ["robot/B1 for robot/A1: begun by robot/C1"]
    assert a5_offences(*both, b_ends, c_ends) == a5_offences(*both, c_ends, b_ends) == []
    assert a5_offences(*both, ("ExecutionWithdrawn", OF_B), b_ends) == taken
    assert a5_offences(*both, ("ExecutionFailed", OF_B), b_ends) == taken
    assert a5_offences(*both, ("ExecutionFailed", OF_B), ("ExecutionResumed", OF_B), b_ends) == []


def test_a5_judges_an_execution_by_what_was_asked_of_its_robot_before_it_began() -> None:
    to_c, start, end = (
        ("RequestIssued", {**OF_C, "request_id": "r"}),
        ("ExecutionStarted", OF_B),
        ("ExecutionFinished", OF_B),
    )
    again = ("RequestIssued", {**OF_B, "request_id": "again"})
    assert a5_offences(*ASKED_B, to_c, start, end) == []
    assert a5_offences(*ASKED_B, to_c, ("RequestAdmitted", OF_C), start, end) == []
    assert a5_offences(*ASKED_B, start, to_c, ("RequestDenied", OF_C), end) == []
    assert a5_offences(*ASKED_B, start, again, end) == []
    anew = "robot/B1 for robot/A1: no admission of the request"
    assert a5_offences(*ASKED_B, start, ("ExecutionFailed", OF_B), again, start, end) == [anew, anew]


def test_a5_takes_an_admission_that_is_told_again_for_the_one_it_was() -> None:
    admitted, accepted = ASKED_B[1:]
    assert a5_offences(*ASKED_B, admitted, ("ExecutionStarted", OF_B)) == []
    found = ["robot/B1 for robot/A1: no acceptance after it was admitted"]
    assert a5_offences(ASKED_B[0], accepted, admitted, ("ExecutionStarted", OF_B)) == found
