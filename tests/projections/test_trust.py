"""Trust entries and the record of results: the most specific entry holds, and rows of results end each other."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import RequestSubject, Robot, Service, Subject, Supervisor
from fsar_ledger.events.execution import ExecutionFailed
from fsar_ledger.events.request import RequestClosed, RequestDenied, RequestIssued
from fsar_ledger.events.trust import TrustThresholdsSet
from fsar_ledger.projections.trust import INITIAL, SCOPES, Record, Trust, covers, evolve, scope_of
from tests import past

A, B = Robot("robot/A1"), Robot("robot/B1")
DOOR = "door.open.secure"
ABOUT = st.tuples(st.sampled_from([None, DOOR, "door.open.basic"]), st.sampled_from([None, "t1", "t2"]))
SCOPE = st.sampled_from(SCOPES)
OF_REQUESTER, OF_EXECUTOR = (B, A, DOOR, None), (A, B, DOOR, None)


def folded(*events: object, of: Trust | None = None) -> Trust:
    """Trust after these events, with thresholds set unless a state is given."""
    state = evolve(INITIAL, TrustThresholdsSet(3, 3, Supervisor("supervisor/fleet"))) if of is None else of
    for event in events:
        state = evolve(state, event)  # type: ignore[arg-type]
    return state


def issued(action: str = "t1/1", relay: Robot | None = None) -> RequestIssued:
    return past.issued(action, past.principals(A, A, B), DOOR, relay=relay)


def closed(action: str = "t1/1", result: str = "success", by: Robot | None = B) -> RequestClosed:
    return RequestClosed(
        RequestSubject("t1", action, action),
        past.principals(Service("service/coordination"), A, by),
        result,  # type: ignore[arg-type]
    )


def denied(reason: str, action: str = "t1/1") -> RequestDenied:
    return past.denied(action, past.principals(B, A, B), reason)


def failed(action: str = "t1/1", robot: Robot = B) -> ExecutionFailed:
    return past.failed(Subject("t1", action), robot, "obstruction", 0, 0)


@given(st.lists(st.tuples(ABOUT, SCOPE), max_size=9), ABOUT)
def test_the_most_specific_entry_holds_and_of_one_entry_the_last_word(
    entries: list[tuple[tuple[str | None, str | None], str]], asked: tuple[str, str]
) -> None:
    state = folded(
        *[
            past.trusted(A, B, scope, about[0], context=about[1])  # type: ignore[arg-type]
            for about, scope in entries
        ],
        of=INITIAL,
    )
    last = dict(entries)
    capability, context = asked
    expected = next(
        (
            last[about]
            for about in ((capability, context), (capability, None), (None, context), (None, None))
            if about in last
        ),
        "none",
    )
    assert scope_of(state, A, B, capability, context) == expected
    assert scope_of(state, B, A, capability, context) == "none"


@given(SCOPE, SCOPE)
def test_none_covers_nothing_and_a_broader_scope_covers_a_narrower_one(scope: str, required: str) -> None:
    expected = scope != "none" and SCOPES.index(scope) >= SCOPES.index(required)
    assert covers(scope, required) == expected  # type: ignore[arg-type]


@given(st.lists(st.booleans(), max_size=12))
def test_a_record_counts_the_last_results_that_were_alike(results: list[bool]) -> None:
    state = folded()
    for ordinal, is_success in enumerate(results):
        state = folded(
            issued(f"t1/{ordinal}"),
            closed(f"t1/{ordinal}") if is_success else denied("trust", f"t1/{ordinal}"),
            of=state,
        )
    alike = next((count for count, result in enumerate(reversed(results)) if result != results[-1]), len(results))
    expected = Record(alike, 0) if results and results[-1] else Record(0, alike)
    assert state.records.get(OF_REQUESTER, Record()) == expected
    assert state.asked == {}


D = Robot("robot/D1")


@pytest.mark.parametrize(
    ("events", "records"),
    [
        ((issued(), closed()), {OF_REQUESTER: Record(1, 0), OF_EXECUTOR: Record(1, 0)}),
        *(
            ((issued(), denied(reason)), {OF_REQUESTER: Record(0, 1)})
            for reason in ("trust", "authority", "advertisement")
        ),
        ((issued(), denied("policy")), {}),
        ((issued(), failed()), {OF_EXECUTOR: Record(0, 1)}),
        ((issued(), closed(), issued("t1/2"), failed("t1/2")), {OF_REQUESTER: Record(1, 0), OF_EXECUTOR: Record(0, 1)}),
        ((failed("t1/own", A),), {}),
        ((issued(), closed(result="failure")), {OF_EXECUTOR: Record(0, 1)}),
        (  # a partial result only ends the row of successes
            (issued(), closed(), issued("t1/2"), closed("t1/2", "partial")),
            {OF_REQUESTER: Record(1, 0), OF_EXECUTOR: Record(0, 0)},
        ),
        (  # another robot has taken over
            (issued(), failed(), closed(by=D)),
            {OF_EXECUTOR: Record(0, 1), (A, D, DOOR, None): Record(1, 0), (D, A, DOOR, None): Record(1, 0)},
        ),
        ((issued(relay=Robot("robot/C1")), closed()), {}),
    ],
)
def test_a_success_counts_for_both_ends_a_violation_against_the_requester_and_a_failure_against_who_failed(
    events: tuple[Event, ...], records: dict[Any, Record]
) -> None:
    assert folded(*events).records == records


def test_without_thresholds_nothing_is_kept_and_without_them_again_it_is_forgotten() -> None:
    assert folded(issued(), closed(), of=INITIAL) == INITIAL
    assert folded(issued(), closed(), TrustThresholdsSet(0, 0, None)) == INITIAL


def test_what_is_set_begins_the_rows_that_it_is_about_again() -> None:
    state = folded(issued(), closed())
    assert folded(past.trusted(B, A, "task", DOOR), of=state).records == {OF_EXECUTOR: Record(1, 0)}
    assert folded(past.trusted(B, A, "task"), of=state).records == {OF_EXECUTOR: Record(1, 0)}
    assert folded(past.trusted(B, A, "task", "carry.heavy"), of=state).records == state.records


@pytest.mark.parametrize(
    ("entries", "about"),
    [
        ((past.trusted(B, A, "task", DOOR, context="t1"),), (B, A, DOOR, "t1")),
        ((past.trusted(B, A, "task", context="t1"),), (B, A, DOOR, "t1")),
        ((past.trusted(B, A, "task", context="t1"), past.trusted(B, A, "task", DOOR)), OF_REQUESTER),
        ((past.trusted(B, A, "task", DOOR, context="t2"),), OF_REQUESTER),
    ],
)
def test_results_count_for_the_trust_that_holds_in_their_context(entries: tuple[Event, ...], about: Any) -> None:
    assert folded(*entries, issued(), denied("trust")).records == {about: Record(0, 1)}


def test_what_is_set_for_one_context_leaves_the_rows_of_the_others() -> None:
    state = folded(past.trusted(B, A, "task", DOOR, context="t1"), issued(), closed())
    assert (
        folded(past.trusted(B, A, "task", DOOR), past.trusted(B, A, "task", DOOR, context="t2"), of=state).records
        == state.records
    )
    assert folded(past.trusted(B, A, "session", context="t1"), of=state).records == {OF_EXECUTOR: Record(1, 0)}
