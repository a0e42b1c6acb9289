"""One fleet file, three architectures: what each did with a rule that the file declares."""

from collections import Counter
from typing import Any

import msgspec
import pytest

from fsar_ledger.designs import OffShift, Policy
from fsar_ledger.designs.constants import Constants, Structure, WorldConstants
from fsar_ledger.events.envelope import PolicyOutcome, PolicyScope, Robot, Supervisor
from fsar_ledger.events.execution import ExecutionFailed, ExecutionHeld, ExecutionStarted, RoutinePerformed
from fsar_ledger.events.policy import RolePolicyRuleSet
from fsar_ledger.events.recovery import RecoveryAttempted
from fsar_ledger.events.supervision import SupervisorCalled, SupervisorResponded
from fsar_ledger.runtime.architectures.fsar import FSAR
from fsar_ledger.runtime.architectures.fsar.execution import DecideOwnStep
from fsar_ledger.runtime.handlers.commands import StartAction
from fsar_ledger.runtime.handlers.supervision import RespondToCall
from fsar_ledger.runtime.simulation import ARCHITECTURES, RunSpec, simulate_run
from tests.runtime.histories import ARRIVED, OWN_STEP, given, happen, types, window
from tests.runtime.live import play
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
) -> Found:
    """Return what happened in six runs of the ward under one more rule."""
    fleet = msgspec.structs.replace(FLEET, policies=(Policy(role, outcome, scope, capability),), off_shift=off_shift)
    own = msgspec.structs.replace(OWN, fleet=fleet)
    spec = msgspec.structs.replace(SPEC, architecture=architecture)
    return [list(simulate_run(msgspec.structs.replace(spec, run=run), own).events) for run in RUNS]


def starts(found: Found, capability: str = "carry.linen") -> list[ExecutionStarted]:
    return [one for run in found for one in run if isinstance(one, ExecutionStarted) and one.capability == capability]


def reviewers(found: Found) -> set[str]:
    called = [one for run in found for one in run if isinstance(one, SupervisorCalled)]
    return {one.supervisor for one in called if one.purpose == "review"}


@pytest.mark.parametrize("architecture", ARCHITECTURES)
@pytest.mark.parametrize("outcome", ["allow", "deny", "review"])
def test_a_rule_of_the_robots_own_binds_its_own_step_under_every_architecture(
    architecture: str, outcome: PolicyOutcome
) -> None:
    found = ward(architecture, outcome, "local")
    assert bool(starts(found)) == (outcome != "deny")
    assert bool(reviewers(found)) == (outcome == "review")


@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_a_step_under_review_starts_after_a_supervisor_has_approved_it(architecture: str) -> None:
    for run in ward(architecture, "review", "local"):
        approved = set()
        for one in run:
            if isinstance(one, SupervisorResponded) and one.purpose == "review":
                approved.add(one.subject.action_id)
            if isinstance(one, ExecutionStarted) and one.capability == "carry.linen":
                assert one.subject.action_id in approved


@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_a_rule_of_the_robots_own_binds_what_others_ask_of_it_under_every_architecture(architecture: str) -> None:
    assert starts(ward(architecture, "allow", "local", "door", "door.open.secure"), "door.open.secure")
    assert not starts(ward(architecture, "deny", "local", "door", "door.open.secure"), "door.open.secure")


@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_the_fleets_rule_binds_where_the_structure_composes_it_and_is_violated_where_it_does_not(
    architecture: str,
) -> None:
    assert bool(starts(ward(architecture, "deny", "fleet"))) != (architecture in LOOKS_AT_THE_FLEETS_RULE)


@pytest.mark.parametrize("architecture", ARCHITECTURES)
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
    for run in ward("fsar", "review", "local"):
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
    assert [one.command for react in FSAR.reacts[type(eased)] for one in react(state, eased, 0)] == [StartAction(STEP)]
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


@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_the_local_budget_of_attempts_means_the_same_under_every_architecture(architecture: str) -> None:
    assert set(attempts(architecture, 0)) == {0}
    assert max(attempts(architecture, 1)) == 1
    assert max(attempts(architecture, 20)) > 2 or architecture == "cfc", "the coordinator orders one retry at most"
