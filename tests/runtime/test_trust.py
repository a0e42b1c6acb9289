"""Trust that supervisors set: by pair, by role and in a context."""

import pytest

from fsar_ledger.events.envelope import TRUST, RequestSubject, Robot, Service, Subject, Supervisor
from fsar_ledger.events.request import RequestClosed, RequestDenied, RequestIssued
from fsar_ledger.events.task import TaskCompleted
from fsar_ledger.events.trust import RoleTrustSet, TrustThresholdsSet
from fsar_ledger.projections.fold import State, apply
from fsar_ledger.projections.trust import scope_of
from fsar_ledger.runtime.handlers.trust import (
    AssessTrust,
    ExpireTrust,
    SetRoleTrust,
    SetTrust,
    set_role_trust,
    set_trust,
    trusts,
)
from tests import past
from tests.runtime.governed import H_F
from tests.runtime.histories import ARRIVED, DOOR, A, B, D, given
from tests.runtime.live import decided, refusal

H_B = Supervisor("supervisor/B1")


def results(*outcomes: str, promote: int = 0, downgrade: int = 0) -> State:
    """A state in which A asked B for the door so many times, and each time got this."""
    state = given("fsar", TrustThresholdsSet(promote, downgrade, H_F))
    for ordinal, outcome in enumerate(outcomes):
        subject = RequestSubject("t1", f"t1/{ordinal}", f"t1/{ordinal}")
        parties = past.parties(A, B)
        apply(
            state,
            RequestIssued(subject=subject, principals=parties.decided(A), capability=DOOR, carried_policy="allow"),
        )
        if outcome == "failed":
            apply(state, past.queued(Subject("t1", f"t1/{ordinal}"), B, A, DOOR))
            apply(state, past.failed(Subject("t1", f"t1/{ordinal}"), B, "degradation", 0, 0))
        elif outcome == "success":
            apply(state, RequestClosed(subject, parties.decided(Service("service/coordination"))))
        else:
            apply(state, RequestDenied(subject, parties.decided(B), outcome))
    return state


@pytest.mark.parametrize("supervisor", [H_B, H_F])
def test_the_robots_own_supervisor_and_the_fleets_may_set_its_trust(supervisor: Supervisor) -> None:
    state = given("fsar")
    assert not trusts(state, B, D, DOOR)
    [event] = decided(state, SetTrust(supervisor, B, D, "task", DOOR, "A1-1"))
    assert event == past.trusted(B, D, "task", DOOR, context="A1-1", decided_by=supervisor, reason="operator")
    apply(state, event)
    found = (trusts(state, B, D, DOOR, "A1-1"), trusts(state, B, D, DOOR, "A1-2"), trusts(state, D, B, DOOR, "A1-1"))
    assert found == (True, False, False)


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        (SetTrust(H_F, Robot("robot/X9"), A, "task"), "unknown robot robot/X9"),
        (SetTrust(H_F, A, Robot("robot/X9"), "task"), "unknown robot robot/X9"),
        (SetTrust(Supervisor("supervisor/X9"), B, A, "task"), "unknown supervisor supervisor/X9"),
        (SetTrust(Supervisor("supervisor/A1"), B, A, "task"), "supervisor/A1 does not supervise robot/B1"),
        (SetTrust(H_F, B, A, "task", "fly"), "unknown capability fly"),
        (SetTrust(H_F, B, A, "task", None, "A1-1"), "task A1-1 is over"),
        (SetTrust(H_F, B, A, "total"), "unknown scope total"),  # type: ignore[arg-type]
        (SetTrust(H_F, B, B, "task"), "robot/B1 needs no trust in itself"),
    ],
)
def test_trust_that_cannot_be_set_is_rejected(command: SetTrust, reason: str) -> None:
    state = given("fsar", ARRIVED, TaskCompleted("A1-1"))
    assert refusal(set_trust(state, command)).startswith(reason)


def test_the_fleet_supervisor_sets_trust_by_role_and_a_pair_stays_an_exception() -> None:
    state = given(
        "fsar",
        past.trusted(B, D, "none"),
        past.joined(Robot("robot/B9"), "B", 9, domain="yard"),
        past.joined(Robot("robot/D9"), "D", 9, domain="yard/gate"),
    )
    [event] = decided(state, SetRoleTrust(H_F, "B", "D", "task", capability=DOOR))
    assert event == RoleTrustSet(
        role="B",
        peer_role="D",
        scope="task",
        domain="",
        capability=DOOR,
        context=None,
        decided_by=H_F,
        reason="operator",
    )
    apply(state, event)
    assert (
        trusts(state, B, D, DOOR),
        trusts(state, B, Robot("robot/D9"), DOOR),
        trusts(state, Robot("robot/B9"), D, DOOR),
    ) == (False, True, True)
    [event] = decided(state, SetRoleTrust(H_F, "B", "D", "none", "yard"))
    apply(state, event)
    found = (trusts(state, Robot("robot/B9"), Robot("robot/D9"), DOOR), trusts(state, Robot("robot/B9"), D, DOOR))
    assert found == (False, True)


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        (SetRoleTrust(H_B, "B", "D", "task"), "supervisor/B1 supervises one robot"),
        (SetRoleTrust(H_F, "X", "D", "task"), "unknown role X"),
        (SetRoleTrust(H_F, "B", "b", "task"), "unknown role b, expected one of A, B, C, D"),
        (SetRoleTrust(H_F, "B", "D", "task", "hall"), "unknown domain hall"),
        (SetRoleTrust(H_F, "B", "D", "task", capability="fly"), "unknown capability fly"),
        (SetRoleTrust(H_F, "B", "D", "task", context="A1-1"), "task A1-1 is over"),
        (SetRoleTrust(H_F, "B", "D", "total"), "unknown scope total"),  # type: ignore[arg-type]
    ],
)
def test_trust_by_role_that_cannot_be_set_is_rejected(command: SetRoleTrust, reason: str) -> None:
    state = given("fsar", ARRIVED, TaskCompleted("A1-1"))
    assert refusal(set_role_trust(state, command)).startswith(reason)


def test_the_record_moves_the_pair_and_not_its_roles() -> None:
    state = results("trust", downgrade=1)
    [downgraded] = decided(state, AssessTrust(B, A, DOOR))
    apply(state, downgraded)
    assert (scope_of(state.trust, B, A, DOOR), scope_of(state.trust, B, A)) == ("capability", "task")
    assert state.trust.of_roles == given("fsar").trust.of_roles


def test_trust_by_role_in_a_context_ends_with_it_and_begins_the_rows_again() -> None:
    state = given(
        "fsar", RoleTrustSet(role="B", peer_role="D", scope="task", domain="", capability=DOOR, context="A1-1")
    )
    assert "A1-1" in state.trust.contexts
    assert decided(state, ExpireTrust("A1-1")) == (
        RoleTrustSet(
            role="B",
            peer_role="D",
            scope="none",
            domain="",
            capability=DOOR,
            context="A1-1",
            decided_by=TRUST,
            reason="context expired",
        ),
    )
    rows = results("success", promote=2)
    assert (B, A, DOOR, None) in rows.trust.records
    apply(rows, RoleTrustSet(role="B", peer_role="A", scope="session", domain="hall"))
    assert (B, A, DOOR, None) in rows.trust.records, "they are in no hall"
    apply(rows, RoleTrustSet(role="B", peer_role="A", scope="session"))
    assert (B, A, DOOR, None) not in rows.trust.records
