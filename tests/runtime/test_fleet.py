"""Who may join, what a robot possesses, in which state it is, and how the registry hears of its actuator."""

import pytest

from fsar_ledger.designs.constants import Constants
from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Robot, Subject, Supervisor
from fsar_ledger.events.execution import ExecutionFailed, ExecutionResumed
from fsar_ledger.events.fleet import RobotJoined
from fsar_ledger.events.recovery import RecoveryEscalated
from fsar_ledger.events.registry import AvailabilityChanged, CapabilityRemoved
from fsar_ledger.events.supervision import ActuatorServiced
from fsar_ledger.events.trust import RoleTrustSet, TrustSet, TrustThresholdsSet
from fsar_ledger.events.world import ActuatorDegraded
from fsar_ledger.projections.fold import apply
from fsar_ledger.projections.registry import advertisement, possesses, surface
from fsar_ledger.projections.trust import covers, scope_of
from fsar_ledger.runtime.architectures.fsar import FSAR
from fsar_ledger.runtime.architectures.fsar.availability import HANDLERS as AVAILABILITY
from fsar_ledger.runtime.architectures.fsar.availability import ReportActuator, report_actuator
from fsar_ledger.runtime.handlers.attribution import nearest_first
from fsar_ledger.runtime.handlers.commands import Command
from fsar_ledger.runtime.handlers.fleet import HANDLERS, InstallCapability, JoinFleet, RemoveCapability
from fsar_ledger.runtime.handlers.trust import AssessTrust, SetTrust, trusts
from fsar_ledger.runtime.simulation import RunSpec, simulate_run
from tests import past
from tests.runtime.histories import A, B, C, D, given, happen, types
from tests.runtime.live import play, refusal
from tests.runtime.robot_states import execution_state


def decided(command: Command, *events: Event) -> tuple[Event, ...]:
    return FSAR.decides[type(command)](given("fsar", *events), command)


E, F = Robot("robot/E1"), Robot("robot/F1")


def test_a_robot_that_joins_possesses_nothing_and_has_the_narrowest_trust_both_ways() -> None:
    """Paper: sec:discussion:heterogeneity (initial trust scope capability)."""
    joined, *trust = decided(JoinFleet(E, "E", 1, Supervisor("supervisor/E1"), "hall/cell"))
    assert joined == RobotJoined(robot=E, role="E", team=1, supervisor=Supervisor("supervisor/E1"), domain="hall/cell")
    state = given("fsar", joined, *trust)
    assert state.fleet.robots[E].domain == "hall/cell"
    assert (list(surface(state.registry, E)), execution_state(state, E)) == ([], "idle")
    assert [scope_of(state.trust, *pair) for pair in ((E, A), (A, E), (C, D))] == ["capability", "capability", "none"]
    assert trusts(state, B, E, "door.open.basic")
    assert not covers(scope_of(state.trust, B, E), "task"), "what requires more is refused"


def test_initial_trust_stands_below_every_entry_and_is_promoted_by_approval_or_record() -> None:
    joined = [event for name in (E, F) for event in decided(JoinFleet(name, "E", 1))]
    state = given("fsar", *joined)
    assert scope_of(state.trust, E, F) == "capability", "those that join trust each other, too"
    roles = RoleTrustSet(role="E", peer_role="A", scope="none")
    assert scope_of(given("fsar", *joined, roles).trust, E, A) == "none"
    [approved] = play(state, SetTrust(Supervisor("supervisor/B1"), B, E, "task"))
    assert (type(approved), scope_of(state.trust, B, E)) == (TrustSet, "task")
    asked = past.issued("t1/1", past.principals(A, A, E), "lift")
    happen(state, TrustThresholdsSet(1, 0, None), asked, past.closed("t1/1", past.principals(None, A, E)))
    [promoted] = play(state, AssessTrust(A, E, "lift"))
    assert (type(promoted), scope_of(state.trust, A, E, "lift")) == (TrustSet, "task")


def test_robots_of_other_teams_come_by_name_whenever_they_joined() -> None:
    state = given("fsar", *(past.joined(Robot(f"robot/E{team}"), "E", team) for team in (4, 3, 2)))
    near = [Robot(f"robot/{name}") for name in ("B1", "E2", "E3", "E4")]
    assert nearest_first(state.fleet, near, Robot("robot/E3")) == ("robot/E3", "robot/B1", "robot/E2", "robot/E4")


def test_a_robot_without_a_supervisor_of_its_own_may_join() -> None:
    assert types(decided(JoinFleet(E, "E", 1))) == ["RobotJoined", "InitialTrustSet", "InitialTrustSet"]


def test_an_installed_capability_is_possessed_and_advertised_to_nobody() -> None:
    [installed] = decided(InstallCapability(B, "lift", "0.1.0", ("seen",), ("held",), ("arm",)))
    assert installed == past.installed(
        B, "lift", "0.1.0", preconditions=("seen",), postconditions=("held",), resources=("arm",)
    )
    state = given("fsar", installed)
    assert possesses(state.registry, B, "lift")
    assert advertisement(state.registry, B, "lift") is None


def test_a_removed_capability_is_neither_possessed_nor_advertised() -> None:
    [removed] = decided(RemoveCapability(B, "door.open.secure"))
    assert removed == CapabilityRemoved(B, "door.open.secure")
    state = given("fsar", removed)
    assert not possesses(state.registry, B, "door.open.secure")
    assert advertisement(state.registry, B, "door.open.secure") is None


QUEUED = past.queued(Subject("t", "t/1"), B, A, "door.open.secure")


@pytest.mark.parametrize(
    ("events", "command", "reason"),
    [
        ((), JoinFleet(A, "A", 1), "member already"),
        ((), JoinFleet(Robot("A9"), "A", 1), "no robot's name"),
        ((), JoinFleet(Robot("robot/"), "A", 1), "no robot's name"),
        ((), JoinFleet(Robot("robot/E/1"), "A", 1), "no robot's name"),
        ((), JoinFleet(Robot("robot/ E"), "A", 1), "no robot's name"),
        ((), JoinFleet(Robot("robot/E 1"), "A", 1), "no robot's name"),
        ((), JoinFleet(Robot("robot/E1"), "", 1), "expected a role"),
        ((), JoinFleet(Robot("robot/E1"), "E", 0), "team from 1"),
        (
            (),
            JoinFleet(Robot("robot/E1"), "E", 1, Supervisor("supervisor/A1")),
            "expected supervisor/E1, none, or who issues it",
        ),
        ((), JoinFleet(Robot("robot/E1"), "E", 1, None, "hall//cell"), "no path"),
        ((), JoinFleet(Robot("robot/E1"), "E", 1, None, "/hall"), "no path"),
        ((), InstallCapability(Robot("robot/Z9"), "lift", "1.0.0"), "unknown robot"),
        ((), InstallCapability(B, "door.open.secure", "2.0.0"), "possesses version 1.0.0 already"),
        ((), InstallCapability(B, "lift", "one"), "no version"),
        ((), InstallCapability(B, "lift.*", "1.0.0"), "no name"),
        ((), InstallCapability(B, " ", "1.0.0"), "no name"),
        ((), InstallCapability(B, "lift", "1.0.0", ("lit", "not lit")), "contradict"),
        ((), RemoveCapability(Robot("robot/Z9"), "lift"), "unknown robot"),
        ((), RemoveCapability(B, "lift"), "does not possess lift"),
        ((QUEUED,), RemoveCapability(B, "door.open.secure"), "in use by t/1"),
    ],
)
def test_what_is_unknown_doubled_or_impossible_is_rejected(
    events: tuple[Event, ...], command: Command, reason: str
) -> None:
    assert reason in refusal(HANDLERS.decides[type(command)](given("fsar", *events), command))


STARTED = past.started(Subject("t", "t/1"), B, A, "door.open.secure", 9)
FAILED = past.failed(Subject("t", "t/1"), B, "obstruction", 4, 5)
WEAK = past.failed(Subject("t", "t/1"), B, "degradation", 4, 5)
OUTWARD = RecoveryEscalated(
    subject=Subject("t", "t/1"),
    principals=past.principals(),
    robot=B,
    failure=1,
    level="local",
    to_level="peer",
    failed_action="t/1",
)
RESUMED = ExecutionResumed(Subject("t", "t/1"), B, 12)


@pytest.mark.parametrize(
    ("events", "state"),
    [
        ((), "idle"),
        ((QUEUED,), "executing"),
        ((QUEUED, STARTED), "executing"),
        ((QUEUED, STARTED, FAILED), "failed"),
        ((QUEUED, STARTED, FAILED, OUTWARD), "failed"),
        ((QUEUED, STARTED, FAILED, RESUMED), "executing"),
        ((QUEUED, STARTED, FAILED, OUTWARD, RESUMED), "failed"),
        ((ActuatorDegraded(B),), "degraded"),
        ((ActuatorDegraded(B), QUEUED, STARTED), "degraded"),
        ((ActuatorDegraded(B), QUEUED, STARTED, WEAK), "failed"),
        ((ActuatorDegraded(B), ActuatorServiced(B)), "idle"),
        ((past.available(B, "door.open.basic", "degraded", "worn"),), "degraded"),
        ((past.available(B, None, "offline", "charging"),), "idle"),
        ((past.assisted(Subject("t", "t/9"), A, B, past.principals()),), "executing"),
    ],
)
def test_a_robot_is_failed_before_degraded_before_executing_before_idle(events: tuple[Event, ...], state: str) -> None:
    assert execution_state(given("fsar", *events), B) == state


def test_a_failure_of_the_actuator_is_reported_and_an_obstruction_is_not() -> None:
    state = given("fsar", ActuatorDegraded(B), QUEUED, STARTED, WEAK)
    [word] = AVAILABILITY.reacts[ExecutionFailed](state, WEAK, 5)
    assert word.command == ReportActuator(B, True)
    assert report_actuator(state, ReportActuator(B, True)) == (past.available(B, None, "degraded", "actuator"),)
    assert AVAILABILITY.reacts[ExecutionFailed](state, FAILED, 5) == ()


def test_what_was_reported_is_not_reported_again_and_a_serviced_robot_is_ready() -> None:
    state = given("fsar", ActuatorDegraded(B))
    happen(state, *report_actuator(state, ReportActuator(B, True)))
    assert report_actuator(state, ReportActuator(B, True)) == ()
    assert report_actuator(state, ReportActuator(B, False)) == (), "it is not in order yet"
    serviced = ActuatorServiced(B)
    apply(state, serviced)
    [word] = AVAILABILITY.reacts[ActuatorServiced](state, serviced, 5)
    assert FSAR.decides[ReportActuator](state, word.command) == (past.available(B, None, "ready", "actuator"),)


def test_word_of_the_actuator_lifts_no_restriction() -> None:
    held_back = past.available(B, "door.open.secure", "restricted", "inspection")
    state = given("fsar", held_back, ActuatorDegraded(B))
    words = report_actuator(state, ReportActuator(B, True))
    assert [event.capability for event in words] == ["navigate.indoor", "door.open.basic"]  # type: ignore[attr-defined]


def test_without_a_registry_there_is_nobody_to_tell() -> None:
    state = given("fsar", ActuatorDegraded(B), QUEUED, STARTED, WEAK, configuration="without-shared-registry")
    assert AVAILABILITY.reacts[ExecutionFailed](state, WEAK, 5) == ()
    assert AVAILABILITY.reacts[ActuatorServiced](state, ActuatorServiced(B), 5) == ()


def test_in_whole_runs_every_degradation_failure_is_reported_and_every_service_after_it_lifts_it() -> None:
    lifted = 0
    for run in range(30):
        state = ""
        for event in simulate_run(RunSpec(8, "fsar", "full", "failure-recovery-chain", 4, run), Constants()).events:
            match event:
                case ExecutionFailed(cause="degradation"):
                    state = state or "to report"
                case AvailabilityChanged(robot="robot/D1", capability=None, availability="degraded"):
                    assert state == "to report"
                    state = "reported"
                case ActuatorServiced():
                    state = "to lift" if state == "reported" else state
                case AvailabilityChanged(robot="robot/D1", capability=None, availability="ready"):
                    assert state == "to lift"
                    state, lifted = "", lifted + 1
        assert state in ("", "reported"), "a word is missing at the end of the run"
    assert lifted
