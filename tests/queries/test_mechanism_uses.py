"""How often each mechanism decided: given rows, expected counts; a mechanism that never decided has a zero."""

from typing import Any

import pytest

from tests.queries.histories import Row, answer, event, run


def uses(*events: Row, **fields: Any) -> dict[str, int | None]:
    rows = answer("metrics/mechanism_uses", run(*events, **fields), columns=("mechanism", "times"))
    return dict(rows)


def held(action: str, reason: str) -> Row:
    return event("ExecutionHeld", action_id=action, robot="robot/B1", outcome="deny", reason=reason)


DECIDED: dict[str, tuple[tuple[Row, ...], int]] = {
    "left out: trust": (
        (event("RegistryQueried", candidates=[], rejected=["robot/B1", "robot/C1"], rejected_by=["trust", "trust"]),),
        2,
    ),
    "left out: visibility": (
        (event("RegistryQueried", candidates=[], rejected=["robot/B1"], rejected_by=["visibility"]),),
        1,
    ),
    "denied: policy": ((event("RequestDenied", reason="policy"), event("RequestDenied", reason="no trust")), 1),
    "override level in effect": (
        (event("RequestAdmitted", override="none"), event("RequestAdmitted", override="hard-preempt")),
        1,
    ),
    "start held: fleet-rule": ((held("t1/1", "fleet-rule"), held("t1/1", "fleet-rule"), held("t1/2", "fleet-rule")), 2),
    "asked: ordering": (
        (event("SupervisorCalled", purpose="ordering"), event("SupervisorCalled", purpose="review")),
        1,
    ),
    "moved by record": ((event("TrustSet", reason="record"), event("TrustSet", reason="operator")), 1),
    "partial result": (
        (event("RecoveryAttemptFailed", result="partial"), event("ExecutionFinished", result="success")),
        1,
    ),
    "attempt rolled back": ((event("AttemptRolledBack", undone=["load.gripped"]),), 1),
    "step reassigned": ((event("ReassignmentDecided", helper="robot/B1"), event("ReassignmentDecided")), 1),
    "segment transferred": ((event("SegmentTransferred", robot="robot/D1", step=2),), 1),
}


@pytest.mark.parametrize("mechanism", DECIDED)
def test_what_a_mechanism_decided_is_counted(mechanism: str) -> None:
    events, times = DECIDED[mechanism]
    assert uses(*events)[mechanism] == times


def test_a_mechanism_that_never_decided_has_a_zero_and_one_that_is_not_observed_has_none() -> None:
    nothing = uses()
    assert set(nothing.values()) == {0}
    assert nothing.keys() >= DECIDED.keys()
    assert uses(observes=["request"])["denied: trust"] == 0
    assert uses(observes=["request"])["left out: trust"] is None
