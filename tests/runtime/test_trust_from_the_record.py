"""Trust that follows the record, one scope at a time, and ends with its task."""

from typing import Any

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import TRUST, Service, Supervisor
from fsar_ledger.events.task import TaskCompleted
from fsar_ledger.events.trust import TrustSet, TrustThresholdsSet
from fsar_ledger.events.world import OutsiderRequestInjected
from fsar_ledger.projections.fold import State, apply, fold
from fsar_ledger.projections.trust import scope_of
from fsar_ledger.runtime.architectures.fsar import FSAR
from fsar_ledger.runtime.handlers.commands import Command
from fsar_ledger.runtime.handlers.trust import AssessTrust, ExpireTrust, SetTrustThresholds, assess_trust, expire_trust
from tests import past
from tests.runtime.governed import H_F, governed
from tests.runtime.histories import ARRIVED, DOOR, A, B, C, D, given
from tests.runtime.live import decided, refusal
from tests.runtime.pinned import PINNED
from tests.runtime.test_trust import H_B, results


def test_only_the_fleet_supervisor_has_trust_follow_the_record() -> None:
    state = given("fsar")
    assert decided(state, SetTrustThresholds(H_F, 3, 1)) == (TrustThresholdsSet(3, 1, H_F),)
    assert refusal(decided(state, SetTrustThresholds(H_B, 3, 1))).startswith("supervisor/B1 supervises one robot")
    assert refusal(decided(state, SetTrustThresholds(Supervisor("supervisor/X9"), 3, 1))).startswith(
        "unknown supervisor"
    )
    assert refusal(decided(state, SetTrustThresholds(H_F, -1, 1))).startswith("thresholds -1 and 1")


def test_so_many_successes_in_a_row_promote_one_scope() -> None:
    assert decided(results("success", promote=2), AssessTrust(B, A, DOOR)) == ()
    [promoted] = decided(results("success", "success", promote=2), AssessTrust(B, A, DOOR))
    assert promoted == past.trusted(B, A, "session", DOOR, decided_by=TRUST, reason="record")
    assert decided(results("success", "trust", "success", promote=2), AssessTrust(B, A, DOOR)) == ()


def test_a_promotion_begins_the_row_again_and_never_gives_persistent_trust() -> None:
    state = results("success", "success", promote=1)
    [promoted] = decided(state, AssessTrust(B, A, DOOR))
    apply(state, promoted)
    assert (B, A, DOOR, None) not in state.trust.records
    again = results("success", promote=1)
    apply(again, past.trusted(B, A, "session"))
    apply(again, past.issued("t1/9", past.principals(A, A, B), DOOR))
    apply(again, past.closed("t1/9", past.principals(None, A, B)))
    assert decided(again, AssessTrust(B, A, DOOR)) == ()


def test_violations_downgrade_the_requester_and_failures_the_executor() -> None:
    [downgraded] = decided(results("trust", downgrade=1), AssessTrust(B, A, DOOR))
    assert downgraded == past.trusted(B, A, "capability", DOOR, decided_by=TRUST, reason="record")
    [downgraded] = decided(results("failed", downgrade=1), AssessTrust(A, B, DOOR))
    assert downgraded == past.trusted(A, B, "capability", DOOR, decided_by=TRUST, reason="record")
    assert decided(results("failed", downgrade=1), AssessTrust(B, A, DOOR)) == ()
    assert decided(results("policy", downgrade=1), AssessTrust(B, A, DOOR)) == ()


def test_a_revocation_by_a_supervisor_counts_against_the_requester() -> None:
    def revoked(reason: Any) -> State:
        return given("fsar", TrustThresholdsSet(0, 1, H_F), past.revoked(A, B, DOOR, None, reason))

    assert [type(event) for event in decided(revoked("human override"), AssessTrust(B, A, DOOR))] == [TrustSet]
    assert decided(revoked("context expired"), AssessTrust(B, A, DOOR)) == ()


def test_the_record_makes_no_trust_where_there_is_none() -> None:
    state = given("fsar", TrustThresholdsSet(1, 1, H_F), past.trusted(B, A, "none", DOOR))
    apply(state, past.issued("t1/1", past.principals(A, A, B), DOOR))
    apply(state, past.closed("t1/1", past.principals(None, A, B)))
    assert decided(state, AssessTrust(B, A, DOOR)) == ()


def test_what_happens_in_a_context_moves_the_trust_that_was_set_for_it() -> None:
    """Trust in all else stays, be it broader or none."""
    for general in ("none", "session"):
        state = given(
            "fsar",
            TrustThresholdsSet(2, 1, H_F),
            past.trusted(B, A, general),
            past.trusted(B, A, "task", DOOR, context="t1"),
        )
        apply(state, past.issued("t1/1", past.principals(A, A, B), DOOR))
        commands = scheduled(state, past.denied("t1/1", past.principals(B, A, B), "authority"))
        [command] = [one for one in commands if isinstance(one, AssessTrust)]
        [moved] = assess_trust(state, command)
        assert moved == past.trusted(B, A, "capability", DOOR, context="t1", decided_by=TRUST, reason="record")
        apply(state, moved)
        assert scope_of(state.trust, B, A, DOOR, "t1") == "capability"
        assert scope_of(state.trust, B, A, DOOR, "t2") == general


def test_an_assessment_without_a_record_is_stale() -> None:
    assert decided(given("fsar"), AssessTrust(B, A, DOOR)) == ()


def test_an_injected_request_that_is_refused_counts_against_who_made_it() -> None:
    injected = OutsiderRequestInjected(task_id="i1", robot=D, peer=C, capability="inspect.private_zone")
    refused = past.denied("i1", past.principals(Service("service/registry"), D), "advertisement", "i1")
    state = given("fsar", TrustThresholdsSet(0, 1, H_F), past.trusted(C, D, "task"), injected, refused)
    [downgraded] = decided(state, AssessTrust(C, D, "inspect.private_zone"))
    assert downgraded.scope == "capability"  # type: ignore[attr-defined]


def scheduled(state: State, event: Event) -> list[Command]:
    apply(state, event)
    return [one.command for react in FSAR.reacts[type(event)] for one in react(state, event, 0)]


def test_trust_is_assessed_in_both_directions_after_a_success_and_only_while_thresholds_are_set() -> None:
    def assessments(*thresholds: Event) -> set[tuple[str, str]]:
        state = given("fsar", *thresholds, past.issued("t1/1", past.principals(A, A, B), DOOR))
        commands = scheduled(state, past.closed("t1/1", past.principals(None, A, B)))
        return {(one.robot, one.peer) for one in commands if isinstance(one, AssessTrust)}

    assert assessments(TrustThresholdsSet(1, 0, H_F)) == {(A, B), (B, A)}
    assert assessments(TrustThresholdsSet(2, 0, H_F)) == set(), "not yet"
    assert assessments(TrustThresholdsSet(0, 0, H_F)) == set()


def test_task_trust_in_the_context_of_a_task_ends_with_the_task() -> None:
    entries = (
        past.trusted(B, D, "task", context="A1-1"),
        past.trusted(C, D, "session", context="A1-1"),
        past.trusted(C, D, "task", context="A1-2"),
    )
    state = given("fsar", ARRIVED, *entries)
    commands = scheduled(state, TaskCompleted("A1-1"))
    [command] = [one for one in commands if isinstance(one, ExpireTrust)]
    assert expire_trust(state, command) == (
        past.trusted(B, D, "none", context="A1-1", decided_by=TRUST, reason="context expired"),
    )
    assert not any(isinstance(one, ExpireTrust) for one in scheduled(given("fsar", ARRIVED), TaskCompleted("A1-1")))


def test_in_a_run_trust_follows_the_record_and_the_state_is_still_the_fold_of_the_events() -> None:
    one = governed("collaborative-delivery", (2, TrustThresholdsSet(1, 1, H_F)), run=3, constants=PINNED)
    moved = [event for event in one.events if isinstance(event, TrustSet) and event.decided_by == TRUST]
    assert {event.reason for event in moved} == {"record"}
    assert {scope for event in moved for scope in [event.scope]} >= {"capability", "task"}, "one up, one down"
    assert fold(one.events) == one.state
    assert all(scope_of(one.state.trust, event.robot, event.peer, event.capability) != "persistent" for event in moved)


def test_in_a_run_without_thresholds_nothing_moves() -> None:
    one = governed("collaborative-delivery", run=2)
    assert not any(isinstance(event, TrustSet) and event.decided_by is not None for event in one.events)
