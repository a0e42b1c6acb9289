"""How the clock keeps what cannot be done now: nothing that a robot should do while it is off, and no message over a
link that is down, is lost or early."""

from collections.abc import Sequence
from math import inf
from types import ModuleType
from typing import get_args

import msgspec
import pytest

from fsar_ledger.base.parameters import BadParameters
from fsar_ledger.designs.constants import (
    Constants,
    Outages,
    Range,
    Structure,
    WorldConstants,
    read_constants,
    write_constants,
)
from fsar_ledger.events import Event
from fsar_ledger.events.configuration import CONFIGURATIONS, PAPER_ARCHITECTURES, Configuration
from fsar_ledger.events.envelope import Architecture, Robot
from fsar_ledger.events.execution import ExecutionFinished, ExecutionHalted, ExecutionResumed, ExecutionStarted
from fsar_ledger.events.knowledge import CopySynced
from fsar_ledger.events.registry import RegistryQueried
from fsar_ledger.events.request import GapDetected, RequestAdmitted, RequestIssued
from fsar_ledger.events.supervision import ActuatorServiced
from fsar_ledger.events.task import StepBegan, StepCompleted, TaskAbandoned
from fsar_ledger.events.world import (
    ActuatorDegraded,
    Grade,
    LinkCameUp,
    LinkWentDown,
    PolicyWindowOpened,
    RobotCameBack,
    RobotWentOff,
    SyncPhaseSet,
    TaskArrived,
    WorldEvent,
)
from fsar_ledger.ledger.rows.codec import LedgerRun, decode, encode
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.world import World, evolve
from fsar_ledger.runtime.architectures import HandlerTable
from fsar_ledger.runtime.handlers import execution, task
from fsar_ledger.runtime.handlers.commands import BeginStep, Command, Handlers, Scheduled, StartAction
from fsar_ledger.runtime.handlers.public import PublicCommand
from fsar_ledger.runtime.kernel import Kernel
from fsar_ledger.runtime.ports import Ask, Fact
from fsar_ledger.runtime.run_replay import replay_run
from fsar_ledger.runtime.simulation import SCENARIOS, RunSpec, handler_table_of, simulate_run
from fsar_ledger.runtime.world import Draws, SimulatedEnvironment, Stream, run_key
from fsar_ledger.runtime.world.schedule import schedule
from tests import past
from tests.runtime.histories import started
from tests.runtime.live import when

EVERY = pytest.mark.parametrize("architecture", PAPER_ARCHITECTURES)
A, B, DOOR, S = Robot("robot/A1"), Robot("robot/B1"), "door.open.secure", 1_000_000
MIXED = Outages(0.02, 8.0, 0.03, 6.0, 0.002)
OWN = past.arrived("A1-1", A, ("A navigate.indoor",), budget_us=60 * S, due_us=61 * S)
DELEGATED = past.arrived("A1-1", A, (f"A {DOOR} B",), budget_us=60 * S, due_us=61 * S)


def nameless(one: HandlerTable) -> set[type[Command]]:
    """The commands that the clock may hold and of which nobody knows who does them; those from outside are done by
    whoever gives them."""
    return {command for command in one.decides if not issubclass(command, PublicCommand) and command not in one.actors}


@EVERY
def test_every_command_names_its_actor(architecture: Architecture) -> None:
    whole = handler_table_of(architecture)
    assert nameless(whole) == set()
    forgetful = {command: actor for command, actor in whole.actors.items() if command is not StartAction}
    assert nameless(HandlerTable(whole.decides, whole.reacts, forgetful)) == {StartAction}


def test_a_handler_table_that_lacks_what_it_names_is_refused() -> None:
    def reacts(_state: State, _event: Event, _now_us: int) -> tuple[Scheduled, ...]:
        return ()

    class Unknown(Command):
        """A command of no module."""

    assert HandlerTable.of(task).decides == task.HANDLERS.decides
    forgetful = ModuleType("forgetful")
    handlers = Handlers()
    handlers.decide(BeginStep)(task.begin_step)
    vars(forgetful)["HANDLERS"] = handlers
    with pytest.raises(ValueError, match="BeginStep by nobody"):
        HandlerTable.of(forgetful)
    with pytest.raises(ValueError, match="lacks what it names: reacts"):
        HandlerTable.of(task, instead={reacts: reacts})
    with pytest.raises(ValueError, match="lacks what it names: TakeTurn by no handler, StartAction by no handler, Dec"):
        HandlerTable.of(task, execution)
    with pytest.raises(ValueError, match="lacks what it names: Unknown by no module"):
        HandlerTable.of(task, own={Unknown: lambda _state, _command: ()})


def test_a_module_has_one_handler_of_a_command_and_one_reaction_to_an_event() -> None:
    handlers = Handlers()
    handlers.decide(BeginStep)(task.begin_step)
    handlers.react(StepCompleted, TaskArrived)(task.on_completed)
    with pytest.raises(ValueError, match="begin_step: BeginStep has a handler in this module already"):
        handlers.decide(BeginStep)(task.begin_step)
    with pytest.raises(ValueError, match="on_transfer: TaskArrived has a reaction in this module already"):
        handlers.react(TaskArrived)(task.on_transfer)


def ran(architecture: Architecture, facts: Sequence[Fact], constants: Constants = Constants()) -> Kernel:  # noqa: B008
    """The run of these facts and no others."""
    one = Kernel(
        handler_table_of(architecture),
        SimulatedEnvironment(facts, Draws(run_key(1, "door-relay", 0), constants.world)),
        started(architecture, constants=constants),
    )
    one.run()
    return one


@EVERY
def test_a_step_begins_when_its_robot_is_back(architecture: Architecture) -> None:
    run = ran(architecture, [(1, RobotWentOff(A)), (S, OWN), (9 * S, RobotCameBack(A))])
    assert when(run, StepBegan) == [9 * S + 1]


@EVERY
def test_an_execution_halts_and_the_rest_goes_on(architecture: Architecture) -> None:
    [begun] = when(ran(architecture, [(S, OWN)]), ExecutionStarted)
    run = ran(architecture, [(S, OWN), (begun + S, RobotWentOff(A)), (begun + 5 * S, RobotCameBack(A))])
    assert when(run, ExecutionHalted) == [begun + S + 1]
    assert when(run, ExecutionResumed) == [begun + 5 * S + 1]
    [undisturbed] = when(ran(architecture, [(S, OWN)]), ExecutionFinished)
    assert when(run, ExecutionFinished) == [undisturbed + 4 * S]


@EVERY
def test_an_execution_goes_on_after_a_moment_without_its_robot(architecture: Architecture) -> None:
    [begun], [finished] = (when(ran(architecture, [(S, OWN)]), kind) for kind in (ExecutionStarted, ExecutionFinished))
    run = ran(architecture, [(S, OWN), (begun + S, RobotWentOff(A)), (begun + S + 1, RobotCameBack(A))])
    assert when(run, ExecutionFinished) == [finished + 1]


def test_an_actuator_gets_better_by_service_only() -> None:
    worse: list[tuple[Grade, Grade, Grade]] = [
        ("lost", "unreliable", "lost"),
        ("slipping", "unreliable", "slipping"),
        ("unreliable", "lost", "lost"),
    ]
    for first, second, then in worse:
        world = evolve(evolve(World(), ActuatorDegraded(A, first)), ActuatorDegraded(A, second))
        assert world.degraded == {A: then}
        assert evolve(world, ActuatorServiced(A)).degraded == {}


@EVERY
def test_a_way_goes_on_where_it_stopped(architecture: Architecture) -> None:
    """The executor goes off while it approaches; what is left of the way takes what it took."""
    plain = ran(architecture, [(S, DELEGATED)])
    [begun] = when(plain, ExecutionStarted, robot=B)
    run = ran(architecture, [(S, DELEGATED), (begun - S, RobotWentOff(B)), (begun + 9 * S, RobotCameBack(B))])
    assert when(run, ExecutionStarted, robot=B) == [begun + 10 * S]


OUTAGES = ((LinkWentDown, LinkCameUp), (RobotWentOff, RobotCameBack))


@pytest.mark.parametrize(("begins", "ends"), OUTAGES)
def test_a_message_travels_to_who_cannot_receive_it_and_waits_there(begins: type[Event], ends: type[Event]) -> None:
    plain = ran("fsar", [(S, DELEGATED)])
    [issued], [admitted] = when(plain, RequestIssued), when(plain, RequestAdmitted)
    for since_us in (issued - 1, issued + 1):  # before it set out, and while it was under way
        late = ran("fsar", [(S, DELEGATED), (since_us, begins(B)), (issued + 4 * S, ends(B))])  # in time for an answer
        assert when(late, RequestAdmitted) == [issued + 4 * S + 1]
        early = ran("fsar", [(S, DELEGATED), (since_us, begins(B)), (admitted - 1, ends(B))])
        assert when(early, RequestAdmitted) == [admitted]


@pytest.mark.parametrize(("begins", "ends"), OUTAGES)
def test_a_message_that_has_set_out_is_not_called_back(begins: type[Event], ends: type[Event]) -> None:
    plain = ran("fsar", [(S, DELEGATED)])
    [issued], [admitted] = when(plain, RequestIssued), when(plain, RequestAdmitted)
    run = ran("fsar", [(S, DELEGATED), (issued + 1, begins(A)), (issued + 9 * S, ends(A))])
    assert when(run, RequestAdmitted) == [admitted]


def test_a_message_that_cannot_leave_sets_out_when_its_sender_can_send() -> None:
    plain = ran("fsar", [(S, DELEGATED)])
    [gap], [queried] = when(plain, GapDetected), when(plain, RegistryQueried)
    run = ran("fsar", [(S, DELEGATED), (gap - 1, LinkWentDown(A)), (gap + 9 * S, LinkCameUp(A))])
    assert when(run, GapDetected) == [gap]
    assert when(run, RegistryQueried) == [gap + 9 * S + queried - gap]


@EVERY
def test_a_robot_without_a_link_goes_on_with_what_it_is_at(architecture: Architecture) -> None:
    [begun], [finished] = (when(ran(architecture, [(S, OWN)]), kind) for kind in (ExecutionStarted, ExecutionFinished))
    run = ran(architecture, [(S, OWN), (begun + 1, LinkWentDown(A)), (begun + 200 * S, LinkCameUp(A))])
    assert when(run, ExecutionFinished) == [finished]


@EVERY
def test_who_waits_for_a_robot_that_never_comes_back_gives_up(architecture: Architecture) -> None:
    rarely = Constants(structure=Structure(sync_period_us=50 * S))  # the coordinator is not about to ask again then
    run = ran(architecture, [(1, RobotWentOff(B)), (S, DELEGATED)], rarely)
    assert when(run, TaskAbandoned) == [61 * S + 60 * S + 1]


def test_the_coordinator_sees_a_silent_robot_as_it_was() -> None:
    window = PolicyWindowOpened(robot=A, scope="local", window="local/A1/0", outcome="deny")
    for outage, end in ((LinkWentDown(A), LinkCameUp(A)), (RobotWentOff(A), RobotCameBack(A))):
        run = ran("cfc", [(1, SyncPhaseSet(500_000)), (2, outage), (3, window), (12 * S, end)])
        copies = [
            (time_us, event.local_deny)
            for time_us, event in zip(run.times_us, run.events, strict=True)
            if isinstance(event, CopySynced)
        ]
        assert {denied for time_us, denied in copies if time_us < 12 * S} == {()}
        assert {denied for time_us, denied in copies if time_us > 12 * S} == {(A,)}


@pytest.mark.parametrize("configuration", CONFIGURATIONS)
def test_a_run_with_outages_is_replayed(configuration: Configuration) -> None:
    for architecture in PAPER_ARCHITECTURES if configuration == "full" else ("fsar",):
        record = simulate_run(
            RunSpec(7, architecture, configuration, "fleet-contention", 4, 1), Constants(outages=MIXED)
        )
        assert replay_run(record) is None
        [back] = decode(encode([record]))
        assert list(back.events) == record.events


def test_every_architecture_meets_the_same_outages_and_they_move_nothing_else() -> None:
    runs = [
        simulate_run(RunSpec(7, architecture, "full", "fleet-contention", 4, 1), Constants(outages=MIXED))
        for architecture in PAPER_ARCHITECTURES
    ]
    worlds = [
        [(at, one) for at, one in zip(run.times_us, run.events, strict=True) if isinstance(one, get_args(WorldEvent))]
        for run in runs
    ]
    assert worlds[0] == worlds[1] == worlds[2]
    ours = schedule(Constants(), 7, "fleet-contention", 1, 4)
    away = (RobotWentOff, RobotCameBack, LinkWentDown, LinkCameUp)
    rest = [fact for fact in worlds[0] if not isinstance(fact[1], away) and getattr(fact[1], "grade", "") != "lost"]
    assert rest == list(ours)


def test_outages_are_constants_that_are_left_out_while_absent() -> None:
    assert "outages" not in write_constants(Constants())
    assert read_constants(write_constants(Constants(outages=MIXED))).outages == MIXED


# Legal constants: rates of 0, probabilities of 0 and 1, lengths of nothing, and lengths longer than any run

HUGE = 1e300
WORLD = {name: getattr(WorldConstants(), name) for name in WorldConstants.__struct_fields__}


def extremes(name: str, value: object) -> list[object]:
    """The ends of what the constant may be."""
    if name.endswith(("share", "probability", "reliability")):
        return [0.0, 1.0]
    if name.endswith("rate_per_s"):
        return [0.0]
    if isinstance(value, Range):
        return [Range(0.0, 0.0), Range(HUGE, HUGE)]
    if name == "durations":
        return [
            tuple((capability, Range(length, length)) for capability, _ in WorldConstants().durations)
            for length in (0.0, HUGE)
        ]
    if name in ("horizon_s", "routine_until_s"):  # until then the world makes facts
        return [0.0]
    if isinstance(value, int):  # a count
        return [1, 10**6]
    return [HUGE] if name == "encounter_mean_s" else [0.0, HUGE]


LEGAL = [(name, value) for name, ours in WORLD.items() for value in extremes(name, ours)]


@pytest.mark.parametrize(("name", "value"), LEGAL, ids=[f"{name}-{place}" for place, (name, _) in enumerate(LEGAL)])
def test_extreme_constants_make_runs_that_end_and_can_be_stored_and_replayed(name: str, value: object) -> None:
    constants = Constants(world=msgspec.structs.replace(WorldConstants(), **{name: value}))
    place = LEGAL.index((name, value))
    spec = RunSpec(3, PAPER_ARCHITECTURES[place % 3], "full", SCENARIOS[place % 5], 4, 0)
    record: LedgerRun = simulate_run(spec, constants)
    [back] = decode(encode([record]))
    assert list(back.events) == record.events
    assert replay_run(record) is None


def test_a_length_longer_than_any_run_is_a_time_that_can_be_stored() -> None:
    law = Range(HUGE, HUGE)
    draws = Draws(run_key(1, "door-relay", 0), msgspec.structs.replace(WorldConstants(), response=law))
    assert draws.answer(Ask("human", "response", "call")) < 2**53
    stream = Stream(run_key(1, "door-relay", 0), "long")
    assert max(stream.within_us(law), stream.exponential_us(HUGE)) < 2**53


def test_a_length_without_end_is_refused_by_name() -> None:
    with pytest.raises(BadParameters, match="window_mean_s"):
        write_constants(Constants(world=msgspec.structs.replace(WorldConstants(), window_mean_s=inf)))


@pytest.mark.parametrize(
    "outages", [Outages(1e9, 0.0), Outages(0.0, HUGE, 1e9, HUGE), Outages(1e9, HUGE, 0.0, 0.0, 0.0, 20.0)], ids=str
)
@EVERY
def test_extreme_outages_make_runs_that_end(architecture: Architecture, outages: Outages) -> None:
    if outages.off_mean_s == 0.0:
        outages = msgspec.structs.replace(outages, off_rate_per_s=1.0)  # spells of a microsecond
    record = simulate_run(RunSpec(3, architecture, "full", "fleet-contention", 4, 0), Constants(outages=outages))
    [back] = decode(encode([record]))
    assert list(back.events) == record.events
