"""One fleet file, three architectures: what each did with a rule that the file declares."""

from collections import Counter
from typing import Any

import msgspec
import pytest

from fsar_ledger.designs import OffShift, Policy
from fsar_ledger.designs.constants import Constants, Structure, WorldConstants
from fsar_ledger.events.configuration import PAPER_ARCHITECTURES
from fsar_ledger.events.envelope import FLEET_SUPERVISOR, PolicyOutcome, PolicyScope, Robot, Subject, Supervisor
from fsar_ledger.events.execution import (
    ApproachStarted,
    ExecutionFailed,
    ExecutionHeld,
    ExecutionStarted,
    RoutinePerformed,
)
from fsar_ledger.events.knowledge import FleetRuleLearned
from fsar_ledger.events.policy import RolePolicyRuleSet
from fsar_ledger.events.recovery import RecoveryAttempted
from fsar_ledger.events.request import RequestDenied
from fsar_ledger.events.supervision import SupervisorCalled, SupervisorResponded
from fsar_ledger.projections.fold import State
from fsar_ledger.runtime.architectures.cfc.coordinator import ProcessWork
from fsar_ledger.runtime.architectures.cfc.execution import process
from fsar_ledger.runtime.architectures.fsar import FSAR
from fsar_ledger.runtime.architectures.fsar.execution import DecideOwnStep, RefuseHeld
from fsar_ledger.runtime.architectures.fsar.request import EvaluateRequest, evaluate_request
from fsar_ledger.runtime.handlers.commands import Command, StartAction, TakeTurn
from fsar_ledger.runtime.handlers.supervision import RespondToCall
from fsar_ledger.runtime.simulation import RunSpec, simulate_run
from tests.runtime.failures import ACTION, D, executing, failed
from tests.runtime.histories import ARRIVED, OWN_STEP, given, happen, types, window
from tests.runtime.live import play
from tests.runtime.physics import LAWLESS
from tests.runtime.pinned import PINNED
from tests.runtime.test_fsar import REQUESTED
from tests.runtime.test_own import FLEET, OWN, SPEC

A, H_A, STEP = Robot("robot/A1"), Supervisor("supervisor/A1"), "A1-1/1.1"
RUNS = range(6)
LOOKS_AT_THE_FLEETS_RULE = ("fsar", "cfc")
Found = list[list[Any]]
"""The events of each run."""


def ward(
    architecture: str,
    outcome: PolicyOutcome,
    scope: PolicyScope,
    role: str = "porter",
    capability: str | None = "carry.linen",
    off_shift: tuple[OffShift, ...] = (),
    ours: WorldConstants = OWN.world,
) -> Found:
    """Return what happened in six runs of the ward under one more rule."""
    fleet = msgspec.structs.replace(FLEET, policies=(Policy(role, outcome, scope, capability),), off_shift=off_shift)
    world = msgspec.structs.replace(ours, absence_s=0.0)  # only who is said to be off shift is away
    own = msgspec.structs.replace(OWN, fleet=fleet, world=world)
    spec = msgspec.structs.replace(SPEC, architecture=architecture)
    return [list(simulate_run(msgspec.structs.replace(spec, run=run), own).events) for run in RUNS]


def starts(found: Found, capability: str = "carry.linen") -> list[ExecutionStarted]:
    return [one for run in found for one in run if isinstance(one, ExecutionStarted) and one.capability == capability]


def reviewers(found: Found) -> set[str]:
    called = [one for run in found for one in run if isinstance(one, SupervisorCalled)]
    return {one.supervisor for one in called if one.purpose == "review"}


@pytest.mark.parametrize("architecture", PAPER_ARCHITECTURES)
@pytest.mark.parametrize("outcome", ["allow", "deny", "review"])
def test_a_rule_of_the_robots_own_binds_its_own_step_under_every_architecture(
    architecture: str, outcome: PolicyOutcome
) -> None:
    found = ward(architecture, outcome, "local")
    assert bool(starts(found)) == (outcome != "deny")
    assert bool(reviewers(found)) == (outcome == "review")


@pytest.mark.parametrize("architecture", PAPER_ARCHITECTURES)
def test_a_step_under_review_starts_after_a_supervisor_has_approved_it(architecture: str) -> None:
    for run in ward(architecture, "review", "local"):
        approved = set()
        for one in run:
            if isinstance(one, SupervisorResponded) and one.purpose == "review":
                approved.add(one.subject.action_id)
            if isinstance(one, ExecutionStarted) and one.capability == "carry.linen":
                assert one.subject.action_id in approved


@pytest.mark.parametrize("architecture", PAPER_ARCHITECTURES)
def test_a_rule_of_the_robots_own_binds_what_others_ask_of_it_under_every_architecture(architecture: str) -> None:
    assert starts(ward(architecture, "allow", "local", "door", "door.open.secure"), "door.open.secure")
    assert not starts(ward(architecture, "deny", "local", "door", "door.open.secure"), "door.open.secure")


@pytest.mark.parametrize("architecture", PAPER_ARCHITECTURES)
def test_the_fleets_rule_binds_where_the_structure_composes_it_and_is_violated_where_it_does_not(
    architecture: str,
) -> None:
    assert bool(starts(ward(architecture, "deny", "fleet"))) != (architecture in LOOKS_AT_THE_FLEETS_RULE)


@pytest.mark.parametrize("architecture", PAPER_ARCHITECTURES)
@pytest.mark.parametrize("scope", ["local", "fleet"])
def test_a_rule_about_everything_binds_motions_through_the_check_that_a_window_reaches(
    architecture: str, scope: PolicyScope
) -> None:
    performed = [
        one
        for run in ward(architecture, "deny", scope, capability=None)
        for one in run
        if isinstance(one, RoutinePerformed)
    ]
    motions = [one for one in performed if one.operation == "motion" and one.robot == "robot/porter1"]
    assert bool(motions) == (architecture == "dhma" and scope == "fleet")


def test_an_own_step_is_reviewed_by_the_robots_supervisor_unless_it_is_away_or_the_rule_is_the_fleets() -> None:
    assert reviewers(ward("fsar", "review", "local")) == {"supervisor/porter1"}
    assert reviewers(ward("fsar", "review", "local", off_shift=(OffShift(),))) == {"supervisor/fleet"}
    assert reviewers(ward("fsar", "review", "fleet")) == {"supervisor/fleet"}
    assert reviewers(ward("cfc", "review", "fleet")) == {"supervisor/fleet"}


def test_an_own_step_is_put_before_its_supervisor_once_and_held_without_a_decision_until_the_answer() -> None:
    nothing_else_holds = msgspec.structs.replace(OWN.world, **LAWLESS)
    for run in ward("fsar", "review", "local", ours=nothing_else_holds):
        [called] = [one for one in run if isinstance(one, SupervisorCalled)]
        [held] = [one for one in run if isinstance(one, ExecutionHeld) and one.subject == called.subject]
        assert (held.outcome, held.reason, held.principals.decided_by) == ("review", "local-policy", None)


def test_an_own_step_that_was_not_approved_is_put_before_its_supervisor_again_after_the_back_off() -> None:
    state = given("fsar", ARRIVED, OWN_STEP, RolePolicyRuleSet(scope="local", role="A", outcome="review"))
    play(state, DecideOwnStep(STEP))
    for approves in (False, True):
        assert types(play(state, StartAction(STEP))) == ["ExecutionHeld", "SupervisorCalled"]
        assert play(state, StartAction(STEP)) == (), "it is asked once"
        [response] = play(state, RespondToCall(H_A, STEP, approves))
        scheduled = [one for react in FSAR.reacts[SupervisorResponded] for one in react(state, response, 0)]
        [start] = [one for one in scheduled if isinstance(one.command, StartAction)]
        assert start.after_us == (1 if approves else state.fleet.structure.back_off_us)
    assert types(play(state, StartAction(STEP))) == ["ExecutionStarted"]


def test_an_own_step_under_a_rule_that_denies_is_put_before_its_supervisor_once_the_rule_asks_for_review() -> None:
    state = given("fsar", ARRIVED, OWN_STEP, RolePolicyRuleSet(scope="local", role="A", outcome="deny"))
    play(state, DecideOwnStep(STEP))
    assert types(play(state, StartAction(STEP))) == ["ExecutionHeld"]
    eased = RolePolicyRuleSet(scope="local", role="A", outcome="review")
    happen(state, eased)
    assert [one.command for react in FSAR.reacts[type(eased)] for one in react(state, eased, 0)] == [
        StartAction(STEP, was_held=True)
    ]
    assert types(play(state, StartAction(STEP))) == ["ExecutionHeld", "SupervisorCalled"]


def test_a_review_that_only_a_window_asks_for_waits_for_the_window() -> None:
    state = given("fsar", ARRIVED, OWN_STEP, window(A, "review"))
    play(state, DecideOwnStep(STEP))
    assert types(play(state, StartAction(STEP))) == ["ExecutionHeld"]


def attempts(architecture: str, allowed: int) -> list[int]:
    """Return how many attempts of its own each failure of twenty runs got."""
    structure = Structure(local_attempts=allowed, local_budget_us=600_000_000)
    constants = Constants(WorldConstants(degraded_reliability=0.2), structure)
    made: Counter[tuple[int, str, int]] = Counter()
    for run in range(20):
        spec = RunSpec(7, architecture, "full", "failure-recovery-chain", 4, run)
        for one in simulate_run(spec, constants).events:
            if isinstance(one, ExecutionFailed):
                made[run, one.subject.action_id, one.failure] += 0
            if isinstance(one, RecoveryAttempted):
                made[run, one.failed_action, one.failure] += 1
    return list(made.values())


@pytest.mark.parametrize("architecture", PAPER_ARCHITECTURES)
def test_the_local_budget_of_attempts_means_the_same_under_every_architecture(architecture: str) -> None:
    assert set(attempts(architecture, 0)) == {0}
    assert max(attempts(architecture, 1)) == 1
    assert max(attempts(architecture, 20)) > 2 or architecture == "cfc", "the coordinator orders one retry at most"


def test_a_rule_that_asks_for_review_waits_while_the_fleet_denies_and_asks_when_that_is_over() -> None:
    """A start that both hold polls: nothing wakes what only a robot's own rule holds."""
    state = given("fsar", ARRIVED, OWN_STEP, RolePolicyRuleSet(scope="local", role="A", outcome="review"))
    play(state, DecideOwnStep(STEP))
    happen(state, FleetRuleLearned(A, "deny", 1))
    [held] = play(state, StartAction(STEP))
    assert isinstance(held, ExecutionHeld)
    assert (held.outcome, held.reason) == ("deny", "fleet-rule")
    [again] = [one for react in FSAR.reacts[ExecutionHeld] for one in react(state, held, 0)]
    assert (again.command, again.after_us) == (StartAction(STEP, was_held=True), state.fleet.structure.poll_us)
    happen(state, FleetRuleLearned(A, "allow", 2))
    assert types(play(state, again.command)) == ["ExecutionHeld", "SupervisorCalled"]


def admitted_and_reviewed(*, approves: bool) -> tuple[State, list[Command]]:
    """Delegated work whose review, by a rule that came after the admission, has been answered; and what follows."""
    state = given("fsar", *REQUESTED)
    action = "A1-1/2.1"
    happen(state, *evaluate_request(state, EvaluateRequest(action)))
    play(state, TakeTurn(action))
    happen(state, RolePolicyRuleSet(scope="fleet", role="B", outcome="review"))
    assert types(play(state, StartAction(action))) == ["ExecutionHeld", "SupervisorCalled"]
    [response] = play(state, RespondToCall(FLEET_SUPERVISOR, action, approves))
    scheduled = [one for react in FSAR.reacts[SupervisorResponded] for one in react(state, response, 0)]
    return state, [one.command for one in scheduled if isinstance(one.command, StartAction | RefuseHeld)]


def test_delegated_work_that_a_supervisor_disapproves_at_its_start_is_refused_as_at_its_admission() -> None:
    state, [command] = admitted_and_reviewed(approves=False)
    found = play(state, command)
    assert types(found) == ["AuthorityReleased", "AuthorityReleased", "ExecutionWithdrawn", "RequestDenied"]
    assert found[-1].reason == "review"
    assert "robot/B1" not in state.execution.current, "the robot is free for others"


def test_an_answer_starts_only_what_is_still_held_and_not_what_is_on_its_way() -> None:
    state, [command] = admitted_and_reviewed(approves=True)
    assert command == StartAction("A1-1/2.1", was_held=True)
    there = state.copy()
    assert types(play(there, command)) == ["ExecutionStarted"]
    happen(state, ApproachStarted(Subject("A1-1", "A1-1/2.1"), Robot("robot/B1")))
    assert play(state, command) == ()


@pytest.mark.parametrize("architecture", PAPER_ARCHITECTURES)
def test_an_approval_lifts_no_denial_under_any_architecture(architecture: str) -> None:
    """A declared review of the robot's own steps, and windows that deny while the supervisor thinks."""
    world = msgspec.structs.replace(PINNED.world, absence_s=0.0, context_rate_per_s=0.06, context_window_share=1.0)
    world = msgspec.structs.replace(world, window_mean_s=10.0, budget_base_s=200.0)  # open when the answer comes
    fleet = msgspec.structs.replace(FLEET, policies=(Policy("porter", "review", "local", "carry.linen"),))
    structure = msgspec.structs.replace(PINNED.structure, sync_period_us=100_000, snapshot_period_us=100_000)
    own = msgspec.structs.replace(OWN, fleet=fleet, world=msgspec.structs.replace(world, review_share=0.0))
    own = msgspec.structs.replace(own, structure=structure)
    refused = 0
    for run in RUNS:
        approved: set[str | None] = set()
        spec = msgspec.structs.replace(SPEC, architecture=architecture, run=run)
        for one in simulate_run(spec, own).events:
            if isinstance(one, SupervisorResponded) and one.purpose == "review":
                approved.add(one.subject.task_id)
            refused += isinstance(one, RequestDenied | ExecutionHeld) and one.subject.task_id in approved
    assert refused, "what was approved was refused or held under a window that denies"


def test_the_coordinator_orders_no_retry_where_a_rule_of_the_robots_own_asks_for_review() -> None:
    """A declared rule reaches every check that a window reaches."""
    for outcome, expected in (("allow", "RecoveryAttempted"), ("review", "AssistanceRequested")):
        state = failed(executing(D, "grasp.robust", architecture="cfc"), cause="obstruction")
        happen(state, RolePolicyRuleSet(scope="local", role="D", outcome=outcome))  # type: ignore[arg-type]
        found = types(process(state, ProcessWork(ACTION, "failure", now_us=3_000_000)))
        assert found[0] == expected
