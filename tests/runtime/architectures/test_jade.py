"""JADE as its sources say: yellow pages, and a contract net between robots that are one agent each."""

import msgspec
import pytest

from fsar_ledger.designs.dials import Jade
from fsar_ledger.events.authority import AuthorityClaimed, AuthorityReleased
from fsar_ledger.events.envelope import Robot, Subject, flat
from fsar_ledger.events.execution import ExecutionFinished, ExecutionQueued, ExecutionStarted
from fsar_ledger.events.knowledge import BidReceived
from fsar_ledger.events.registry import AvailabilityChanged, RegistryCached, RegistryQueried
from fsar_ledger.events.request import (
    AwardMade,
    BidSubmitted,
    ContractVoided,
    GapDetected,
    MessageUndelivered,
    RequestClosed,
    RequestDenied,
    RequestIssued,
    RequestUnanswered,
)
from fsar_ledger.events.task import TaskCompleted
from fsar_ledger.events.world import ContextChanged, LinkCameUp, LinkWentDown, RobotCameBack, RobotWentOff
from fsar_ledger.projections.registry import NO_ANSWER
from fsar_ledger.runtime.architectures.jade.contract_net import (
    Bounce,
    CallForProposals,
    EvaluateCall,
    EvaluateProposals,
    ReceiveAcceptance,
    ReceiveReply,
)
from fsar_ledger.runtime.architectures.jade.directory import RemoveNode
from fsar_ledger.runtime.handlers.commands import BeginStep
from fsar_ledger.runtime.ports import Fact
from fsar_ledger.runtime.simulation import SCENARIOS
from tests import past
from tests.runtime.architectures.jade_runs import (
    ABOUT,
    ACTION,
    B2,
    DOOR,
    LISTED,
    TASK,
    TWO_LISTED,
    A,
    B,
    C,
    D,
    S,
    contracted,
    decided,
    follows,
    given,
    play,
    ran,
    reactions,
    scenario,
    times,
)
from tests.runtime.histories import SECOND, happen, types, window
from tests.runtime.live import of


def test_a_robot_is_one_agent_whose_decisions_take_a_path_of_one() -> None:
    for name in SCENARIOS:
        for event in scenario(name, 4):
            found = flat(event)
            assert not any(str(value).startswith("agent/") for value in found.values())
            assert len(found.get("path") or ("itself",)) == 1


def test_a_search_of_the_yellow_pages_takes_two_messages() -> None:
    run = ran([(S, TASK)])
    [asked], [answered], [called] = times(run, GapDetected), times(run, RegistryQueried), times(run, RequestIssued)
    assert (answered - asked, called - answered) == (1, 1)


def test_the_yellow_pages_show_every_entry_to_everybody() -> None:
    [(_, queried)] = of(ran([(S, TASK)]), RegistryQueried)
    assert (queried.candidates, queried.rejected) == ((B, B2), ())


def test_a_subscriber_searches_once_and_is_told_of_changes() -> None:
    later = msgspec.structs.replace(TASK, task_id="A1-2")
    run = ran([(S, TASK), (40 * S, later), (50 * S, RobotWentOff(B2))], subscribes=1)
    waits = [two - one for one, two in zip(times(run, GapDetected), times(run, RequestIssued), strict=True)]
    assert waits == [2, 0]
    assert [as_of for as_of in (event.as_of_us for _, event in of(run, RegistryQueried)) if as_of is not None]
    [subscribed, told] = of(run, RegistryCached)
    assert (subscribed[1].holder, told[1].holder) == (A, A)
    assert told[0] // S == 50 + 10 + 1  # found dead, and one message


def test_a_dead_agent_is_deregistered_when_its_node_was_silent_for_the_dials_time_and_registers_again() -> None:
    for ends, begins in ((RobotWentOff, RobotCameBack), (LinkWentDown, LinkCameUp)):
        run = ran([(S, ends(B)), (30 * S, begins(B))], dead_after_us=4 * S)
        found = [(time_us // S, event.availability, event.reason) for time_us, event in of(run, AvailabilityChanged)]
        assert found[0] == (5, "offline", NO_ANSWER)
        assert set(found[1:]) == {(31, "ready", "registered again")}


def test_a_node_that_was_back_in_time_was_never_dead() -> None:
    blinks = [(S, RobotWentOff(B)), (6 * S, RobotCameBack(B)), (7 * S, LinkWentDown(B)), (16 * S, LinkCameUp(B))]
    assert of(ran(blinks), AvailabilityChanged) == []


def test_a_node_stays_silent_while_either_its_robot_or_its_link_is_out() -> None:
    both = [(S, RobotWentOff(B)), (3 * S, LinkWentDown(B)), (8 * S, RobotCameBack(B))]
    assert times(ran(both), AvailabilityChanged)[:1] == [11]


def test_an_entry_has_no_lease_by_default_and_else_ends_with_it() -> None:
    assert Jade().lease_us == 0
    silence: list[Fact] = [(S, LinkWentDown(B))]
    assert times(ran(silence, lease_us=3 * S), AvailabilityChanged) == [4]
    assert times(ran(silence, lease_us=30 * S), AvailabilityChanged) == [11]


def test_who_is_not_listed_is_not_called() -> None:
    run = ran([(S, LinkWentDown(B)), (20 * S, TASK)])
    assert [event.candidates for _, event in of(run, RegistryQueried)] == [(B2,)]
    assert {event.robot for _, event in of(run, BidSubmitted)} == {B2}


def test_every_candidate_that_is_listed_is_called() -> None:
    state = given(*LISTED[:-1], TWO_LISTED)
    [issued] = play(state, CallForProposals(ACTION))
    calls = [one for one in follows(state, issued) if isinstance(one, EvaluateCall)]
    assert [one.robot for one in calls] == [B, C]
    assert (issued.principals.executed_by, issued.carried_policy) == (None, None)


def test_a_candidate_proposes_or_refuses_by_its_own_policy_of_that_moment() -> None:
    assert types(decided(given(*LISTED), EvaluateCall(ACTION, B, 0))) == ["RequestAdmitted", "BidSubmitted"]
    assert types(decided(given(*LISTED, window(B)), EvaluateCall(ACTION, B, 0))) == ["RequestDenied", "BidSubmitted"]


def test_a_review_means_refuse_since_there_is_nobody_to_ask() -> None:
    refused, _ = decided(given(*LISTED, window(B, "review")), EvaluateCall(ACTION, B, 0))
    assert isinstance(refused, RequestDenied)
    assert (refused.principals.decided_by, refused.reason) == (B, "policy")


def test_neither_the_requesters_policy_nor_the_fleets_rule_is_composed() -> None:
    for unseen in (window(A), window(B, scope="fleet"), window(A, scope="fleet")):
        assert types(decided(given(*LISTED, unseen), EvaluateCall(ACTION, B, 0)))[0] == "RequestAdmitted"


def test_a_proposal_says_how_many_actions_come_first_in_the_bidders_own_queue() -> None:
    [_, free] = decided(given(*LISTED), EvaluateCall(ACTION, B, 0))
    busy = contracted(*SECOND, past.queried(Subject("A1-2", "A1-2/2.1"), past.parties(A), DOOR, B))
    [_, queued] = decided(busy, EvaluateCall("A1-2/2.1", B, 0))
    assert isinstance(free, BidSubmitted)
    assert isinstance(queued, BidSubmitted)
    assert (free.ahead, queued.ahead) == (0, 1)


@pytest.mark.parametrize(("ahead", "chosen"), [((2, 1), C), ((1, 2), B), ((1, 1), B), ((0, 0), B)])
def test_the_proposal_with_the_least_before_it_is_accepted_and_among_equals_the_first_received(
    ahead: tuple[int, int], chosen: Robot
) -> None:
    bids = (BidReceived(ABOUT, B, "allow", ahead[0]), BidReceived(ABOUT, C, "allow", ahead[1]))
    [award] = decided(given(*LISTED[:-1], TWO_LISTED, *bids), EvaluateProposals(ACTION, 0))
    assert isinstance(award, AwardMade)
    assert award.robot == award.principals.executed_by == chosen


def test_one_proposal_is_accepted_and_the_other_proposers_are_rejected() -> None:
    three = msgspec.structs.replace(TWO_LISTED, candidates=(B, C, D))
    bids = (BidReceived(ABOUT, B, "deny"), BidReceived(ABOUT, C, "allow", 0), BidReceived(ABOUT, D, "allow", 0))
    [award] = decided(given(*LISTED[:-1], three, *bids), EvaluateProposals(ACTION, 0))
    assert isinstance(award, AwardMade)
    assert (award.robot, award.rejected) == (C, (D,))


def test_the_initiator_evaluates_when_all_replies_are_in() -> None:
    state = given(*LISTED[:-1], TWO_LISTED)
    [first] = play(state, ReceiveReply(ACTION, B, 0, "allow", 0))
    assert follows(state, first) == []
    assert decided(state, EvaluateProposals(ACTION, 0)) == ()
    [last] = play(state, ReceiveReply(ACTION, C, 0, "deny", None))
    assert follows(state, last) == [EvaluateProposals(ACTION, 0)]


SILENT: list[Fact] = [(S, LinkWentDown(B2)), (2 * S, TASK), (40 * S, LinkCameUp(B2))]


def test_at_the_reply_by_the_initiator_evaluates_what_it_has() -> None:
    run = ran(SILENT, reply_by_us=6 * S)
    [called], [awarded] = times(run, RequestIssued), times(run, AwardMade)
    assert awarded - called == 6


def test_without_a_reply_by_the_initiator_waits_for_ever() -> None:
    """Only the reply ends it: the platform has not found the candidate's node dead."""
    assert times(ran(SILENT, reply_by_us=0, dead_after_us=60 * S), AwardMade) == [40 + 1]


def test_a_candidate_that_the_platform_cannot_reach_is_waited_for_no_longer() -> None:
    run = ran(SILENT, reply_by_us=0, dead_after_us=10 * S)
    [(lost_us, lost)] = of(run, MessageUndelivered)
    assert (lost_us // S, lost.robot) == (11, B2)
    assert times(run, AwardMade) == [12]


def test_a_call_to_a_robot_that_has_left_the_platform_is_found_undeliverable_at_once() -> None:
    """A subscriber that has not heard yet of its removal calls it all the same."""
    state = given(LinkWentDown(B))
    play(state, RemoveNode(B, 0))
    happen(state, *LISTED)
    [issued] = play(state, CallForProposals(ACTION))
    bounced = [one for one in follows(state, issued) if isinstance(one, Bounce)]
    assert bounced == [Bounce(ACTION, B, 0)]
    assert [type(one) for one in decided(state, bounced[0])] == [MessageUndelivered]
    assert not any(isinstance(one, Bounce) for one in follows(given(*LISTED, issued), issued))


def test_a_reply_that_comes_after_the_deadline_is_out_of_sequence_and_ignored() -> None:
    run = ran([*SILENT[:2], (11 * S, LinkCameUp(B2))], reply_by_us=6 * S)
    assert times(run, AwardMade) == [10]
    assert {event.robot for _, event in of(run, BidSubmitted)} == {B, B2}
    assert {event.robot for _, event in of(run, BidReceived)} == {B}
    state = given(*LISTED, BidReceived(ABOUT, B, "allow", 0))
    play(state, EvaluateProposals(ACTION, 0))
    assert decided(state, ReceiveReply(ACTION, C, 0, "allow", 0)) == ()
    assert decided(given(*LISTED), ReceiveReply(ACTION, B, 1, "allow", 0)) == ()


def test_no_reply_at_all_at_the_reply_by_leaves_the_step_to_be_tried_anew() -> None:
    state = given(*LISTED)
    [unanswered] = play(state, EvaluateProposals(ACTION, 0, is_deadline=True))
    assert isinstance(unanswered, RequestUnanswered)
    assert follows(state, unanswered) == [BeginStep("A1-1", ACTION)]


def test_where_all_refuse_the_step_is_tried_anew_after_the_back_off() -> None:
    state = given(*LISTED)
    [refused] = play(state, ReceiveReply(ACTION, B, 0, "deny", None))
    [again] = reactions(state, refused)
    assert (again.command, again.after_us) == (BeginStep("A1-1", ACTION), state.fleet.structure.back_off_us)
    assert decided(state, EvaluateProposals(ACTION, 0, is_deadline=True)) == (), "its end is on record already"


def test_an_initiator_to_whom_nobody_is_listed_tries_anew() -> None:
    nobody = msgspec.structs.replace(TWO_LISTED, candidates=())
    assert types(decided(given(*LISTED[:-1], nobody), CallForProposals(ACTION))) == ["RequestUnanswered"]


def test_the_contractor_claims_execution_from_acceptance_to_inform_and_nobody_claims_more() -> None:
    run = ran([(S, TASK)])
    [(claimed_us, claim)], [(released_us, _)] = of(run, AuthorityClaimed), of(run, AuthorityReleased)
    [(finished_us, _)] = of(run, ExecutionFinished)
    assert (claim.dimension, claim.claimant) == ("execution", B)
    assert [time_us for time_us, _ in of(run, ExecutionQueued)] == [claimed_us]
    assert released_us == finished_us + 1
    assert times(run, RequestClosed) == [finished_us // S + 1]


def test_an_acceptance_has_no_reply_by_so_the_result_is_waited_for_for_ever() -> None:
    """The contractor is off after it has accepted, for longer than it takes to be found dead."""
    [begun_us] = [time_us for time_us, _ in of(ran([(S, TASK)]), ExecutionStarted)]
    run = ran([(S, TASK), (begun_us + 100, RobotWentOff(B)), (begun_us + 30 * S, RobotCameBack(B))])
    assert [event.robot for _, event in of(run, AwardMade)] == [B]
    assert of(run, MessageUndelivered, ContractVoided) == []
    assert of(run, TaskCompleted)


def test_an_acceptance_that_the_platform_cannot_deliver_comes_back_as_a_failure() -> None:
    awarded_us = of(ran([(S, TASK)]), AwardMade)[0][0]
    run = ran([(S, TASK), (awarded_us + 1, LinkWentDown(B))])
    assert [event.robot for _, event in of(run, MessageUndelivered)] == [B]
    assert [event.robot for _, event in of(run, AwardMade)] == [B, B2]
    assert [event.robot for _, event in of(run, ExecutionStarted)] == [B2]
    assert of(run, TaskCompleted)


def test_an_acceptance_that_was_found_undeliverable_is_not_delivered_later() -> None:
    state = given(*LISTED, BidReceived(ABOUT, B, "allow", 0))
    play(state, EvaluateProposals(ACTION, 0))
    happen(state, MessageUndelivered(ABOUT, B))
    assert decided(state, ReceiveAcceptance(ACTION, 0)) == ()


def test_an_acceptance_to_an_agent_that_is_dead_by_then_comes_back_at_once() -> None:
    dead = AvailabilityChanged(robot=B, capability=None, availability="offline", reason=NO_ANSWER)
    state = given(*LISTED, BidReceived(ABOUT, B, "allow", 0), LinkWentDown(B), dead)
    [award] = play(state, EvaluateProposals(ACTION, 0))
    _, bounce = follows(state, award)
    assert decided(state, bounce) == (MessageUndelivered(ABOUT, B),)
    happen(state, LinkCameUp(B))
    assert decided(state, bounce) == (), "it is back in time"


def test_a_change_of_context_leaves_the_contract_standing() -> None:
    [begun_us] = [time_us for time_us, _ in of(ran([(S, TASK)]), ExecutionStarted)]
    for robot in (A, B):
        run = ran([(S, TASK), (begun_us - S, ContextChanged(robot)), (begun_us + 100, ContextChanged(robot))])
        assert len(of(run, AwardMade)) == len(of(run, ExecutionStarted)) == 1
        assert of(run, TaskCompleted)
