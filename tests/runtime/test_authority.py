"""Rights by a supervisor's word, revocation at the request boundary, and claims that end.

Paper: sec:model:authority.
"""

from typing import Any

import msgspec
import pytest

from fsar_ledger.events import Event
from fsar_ledger.events.authority import AuthorityClaimed, AuthorityReleased
from fsar_ledger.events.command import CommandRejected
from fsar_ledger.events.envelope import FLEET_SUPERVISOR, TRUST, Robot, Subject, Supervisor
from fsar_ledger.events.execution import ExecutionStarted
from fsar_ledger.events.request import RequestAdmitted, RequestClosed, RequestDenied
from fsar_ledger.events.task import TaskAbandoned, TaskCompleted
from fsar_ledger.events.trust import RoleTrustSet
from fsar_ledger.projections.fold import State, apply, fold
from fsar_ledger.runtime.architectures.fsar import FSAR
from fsar_ledger.runtime.architectures.fsar.request import EvaluateRequest
from fsar_ledger.runtime.handlers.authority import (
    ExpireContext,
    GrantAuthority,
    ReleaseAuthority,
    RevokeAuthority,
    RevokeDistrusted,
)
from fsar_ledger.runtime.handlers.commands import Command, StartAction, TakeTurn
from fsar_ledger.runtime.handlers.request import RequestCapability
from fsar_ledger.runtime.handlers.task import EndClaims
from tests import past
from tests.runtime.histories import DOOR, A, B, C, D, given, types
from tests.runtime.live import decided, of, play, played
from tests.runtime.test_requests import relayed, verdict
from tests.sure import only

H_F, H_A, H_B = FLEET_SUPERVISOR, Supervisor("supervisor/A1"), Supervisor("supervisor/B1")
ASK = RequestCapability(A, B, DOOR, "visit", "q1")
NEXT = msgspec.structs.replace(ASK, action_id="q2")
GRANTED = past.granted(A, B, "soft-priority", DOOR, "visit")
REVOKED = past.revoked(A, B)


def evaluated(state: State, command: RequestCapability = NEXT) -> Any:
    """What the executor makes of another request, at once."""
    return play(state, command, EvaluateRequest(command.action_id))[0]


def scheduled(state: State, event: Event) -> list[Command]:
    """What FSAR schedules after the event, which is applied."""
    apply(state, event)
    return [one.command for react in FSAR.reacts.get(type(event), ()) for one in react(state, event, 0)]


def test_a_supervisor_grants_authority_and_it_is_on_record_who() -> None:
    [granted] = decided(given("fsar"), GrantAuthority(H_F, C, None, "emergency-only"))
    assert granted == past.granted(C, None, "emergency-only")
    [own] = decided(given("fsar"), GrantAuthority(H_B, A, B, "hard-preempt", DOOR, "visit"))
    assert own == past.granted(A, B, "hard-preempt", DOOR, "visit", decided_by=H_B)


@pytest.mark.parametrize(
    ("command", "found"),
    [
        (GrantAuthority(H_F, Robot("robot/Z9"), None, "none"), "unknown robot robot/Z9"),
        (GrantAuthority(H_F, A, Robot("robot/Z9"), "none"), "unknown robot robot/Z9"),
        (GrantAuthority(Supervisor("supervisor/Z9"), A, B, "none"), "unknown supervisor supervisor/Z9"),
        (GrantAuthority(H_A, A, B, "none"), "supervisor/A1 does not supervise robot/B1"),
        (GrantAuthority(H_A, A, None, "none"), "does not supervise every robot"),
        (GrantAuthority(H_F, A, A, "none"), "to ask itself"),
        (GrantAuthority(H_F, A, B, "none", "fly"), "unknown capability fly"),
        (GrantAuthority(H_F, A, B, "none", DOOR, "rounds"), "rounds is over"),
        (GrantAuthority(H_B, A, B, "none", DOOR), "supervisor/fleet has revoked it"),
        (GrantAuthority(H_F, "robot/A1", "robot/B1", "absolute"), "unknown override level absolute"),  # type: ignore[arg-type]
        (RevokeAuthority(H_F, Robot("robot/Z9"), None), "unknown robot robot/Z9"),
        (RevokeAuthority(Supervisor("supervisor/Z9"), A, None), "unknown supervisor supervisor/Z9"),
        (RevokeAuthority(Supervisor("supervisor/C1"), A, B), "supervises neither robot"),
        (RevokeAuthority(H_F, A, B, "fly"), "unknown capability fly"),
        (RevokeAuthority(H_F, A, B), "it is revoked already"),
        (RevokeAuthority(H_B, A, B, DOOR), "it is revoked already"),
        (RevokeAuthority(H_F, "robot/A1", "robot/C1", reason="boredom"), "unknown reason boredom"),  # type: ignore[arg-type]
    ],
)
def test_a_right_that_nobody_may_give_or_take_is_rejected_and_changes_nothing(command: Command, found: str) -> None:
    state = given("fsar", TaskCompleted("rounds"), REVOKED)
    before = state.authority
    rejected = only(CommandRejected, play(state, command))
    assert found in rejected.reason
    assert rejected.command == type(command).__name__
    assert state.authority == before


@pytest.mark.parametrize("supervisor", [H_F, H_A, H_B])
def test_either_robots_supervisor_may_revoke(supervisor: Supervisor) -> None:
    [revoked] = decided(given("fsar"), RevokeAuthority(supervisor, A, B, DOOR))
    assert revoked == past.revoked(A, B, DOOR, decided_by=supervisor)


def test_a_revocation_takes_effect_at_the_next_request_and_leaves_alone_what_was_admitted() -> None:
    state = given("fsar")
    play(state, ASK, EvaluateRequest("q1"), RevokeAuthority(H_F, A, B))
    assert "RequestAccepted" in types(play(state, TakeTurn("q1"))), "queued, and goes on"
    assert types(play(state, StartAction("q1", answer=5))) == ["ExecutionStarted"]
    denied = evaluated(state)
    assert isinstance(denied, RequestDenied)
    assert denied.reason == "authority"


def test_in_a_whole_run_a_running_action_outlives_its_revocation() -> None:
    [(began_us, _)] = of(played([(1_000_000, ASK)]), ExecutionStarted)
    run = played([(1_000_000, ASK), (began_us + 1_000, RevokeAuthority(H_F, A, B)), (began_us + 2_000, NEXT)])
    assert [event.subject.action_id for _, event in of(run, RequestClosed)] == ["q1"]
    assert [(event.subject.action_id, event.reason) for _, event in of(run, RequestDenied)] == [("q2", "authority")]
    assert run.state == fold(run.events)


@pytest.mark.parametrize(
    ("about", "is_denied"),
    [
        ((None, None, None), True),
        (("robot/B1", None, None), True),
        (("robot/B1", DOOR, "visit"), True),
        (("robot/C1", None, None), False),
        (("robot/B1", "door.open.basic", None), False),
        (("robot/B1", None, "rounds"), False),
    ],
)
def test_a_revocation_is_about_what_it_names(
    about: tuple[Robot | None, str | None, str | None], is_denied: bool
) -> None:
    state = given("fsar", past.revoked(A, about[0], about[1], about[2]))
    assert isinstance(evaluated(state), RequestDenied if is_denied else RequestAdmitted)
    assert isinstance(evaluated(state, RequestCapability(C, B, DOOR, "visit", "q3")), RequestAdmitted), (
        "of another requester"
    )


def test_a_later_grant_lifts_a_revocation() -> None:
    state = given("fsar", REVOKED, GRANTED)
    assert isinstance(evaluated(state), RequestAdmitted)
    assert isinstance(
        evaluated(state, msgspec.structs.replace(ASK, context="rounds", action_id="q3")), RequestDenied
    ), "for its context alone"


def test_what_the_relay_may_ask_does_not_lift_a_revocation_of_the_requester() -> None:
    assert verdict(relayed(), "A1-1/2.1") == ("accept", None)
    for robot in (D, A):
        assert verdict(relayed(past.revoked(robot, B)), "A1-1/2.1") == ("reject", "authority")


def test_a_context_that_ends_ends_the_rights_that_were_given_for_it_and_no_others() -> None:
    broad = past.granted(A, B)
    for over in (TaskCompleted("visit"), TaskAbandoned("visit")):
        state = given("fsar", broad, GRANTED)
        [command] = [one for one in scheduled(state, over) if not isinstance(one, EndClaims)]
        assert command == ExpireContext("visit")
        [revoked] = play(state, command)
        assert revoked == past.revoked(A, B, DOOR, "visit", "context expired", decided_by=TRUST)
        assert play(state, command) == ()


def test_a_context_without_rights_ends_without_a_word() -> None:
    assert scheduled(given("fsar"), TaskCompleted("visit")) == []
    assert scheduled(given("fsar", GRANTED), TaskCompleted("rounds")) == []
    assert (
        scheduled(
            given("fsar", GRANTED, REVOKED, msgspec.structs.replace(REVOKED, capability=DOOR, context="visit")),
            TaskCompleted("visit"),
        )
        == []
    )


def test_trust_that_falls_below_what_is_required_revokes_what_the_peer_holds_admitted() -> None:
    state = given("fsar")
    play(state, ASK, EvaluateRequest("q1"))
    assert scheduled(state, past.trusted(B, A, "capability")) == [], "enough"
    assert scheduled(state, past.trusted(B, D, "none")) == [], "somebody else"
    [command] = [one for one in scheduled(state, past.trusted(B, A, "none")) if isinstance(one, RevokeDistrusted)]
    [revoked] = play(state, command)
    assert revoked == past.revoked(A, B, DOOR, "visit", "trust downgrade", decided_by=TRUST)
    assert play(state, command) == (), "once"
    assert "RequestAccepted" in types(play(state, TakeTurn("q1"))), "what was admitted goes on"
    apply(state, past.trusted(B, A, "task"))
    assert evaluated(state).reason == "authority", "trust regained does not give back what was revoked"


def test_trust_of_the_roles_that_falls_revokes_what_their_pairs_hold_admitted() -> None:
    state = given("fsar")
    play(state, ASK, EvaluateRequest("q1"))
    assert scheduled(state, RoleTrustSet(role="B", peer_role="A", scope="none", domain="hall")) == [], (
        "they are in no hall"
    )
    assert scheduled(state, RoleTrustSet(role="B", peer_role="D", scope="none")) == [], "others"
    state = given("fsar", past.trusted(B, A, "task"))
    play(state, ASK, EvaluateRequest("q1"))
    assert scheduled(state, RoleTrustSet(role="B", peer_role="A", scope="none")) == [], "the pair is an exception"
    state = given("fsar")
    play(state, ASK, EvaluateRequest("q1"))
    assert scheduled(state, RoleTrustSet(role="B", peer_role="A", scope="none")) == [RevokeDistrusted(B, A)]


def test_trust_that_falls_while_nothing_is_admitted_revokes_nothing() -> None:
    state = given("fsar")
    play(state, ASK)
    assert scheduled(state, past.trusted(B, A, "none")) == []


def test_a_claim_is_released_by_who_holds_it_and_execution_not_before_its_end() -> None:
    state = given("fsar")
    play(state, ASK, EvaluateRequest("q1"), TakeTurn("q1"))
    held = only(CommandRejected, decided(state, ReleaseAuthority(B, "q1", "execution")))
    assert "has yet to finish it" in held.reason
    [released] = play(state, ReleaseAuthority(B, "q1", "override"))
    assert released == AuthorityReleased(Subject("visit", "q1"), "override", B, "acceptance")
    for command in (
        ReleaseAuthority(B, "q1", "override"),
        ReleaseAuthority(A, "q1", "execution"),
        ReleaseAuthority(B, "q9", "audit"),
    ):
        rejected = only(CommandRejected, decided(state, command))
        assert "expected an open claim" in rejected.reason
    apply(state, AuthorityClaimed(subject=Subject("visit", "q1"), dimension="audit", claimant=H_F, reason="watch"))
    assert types(decided(state, ReleaseAuthority(H_F, "q1", "audit"))) == ["AuthorityReleased"]
