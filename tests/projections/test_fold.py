"""State is the fold of events; every event type has a projection or is listed as a mere record."""

import random

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fsar_ledger.designs.constants import Constants, Membership, Outages
from fsar_ledger.designs.registered import PAPER_WORKFLOWS
from fsar_ledger.events import EVENT_TYPES, Event
from fsar_ledger.events.configuration import CONFIGURATIONS, PAPER_ARCHITECTURES
from fsar_ledger.events.envelope import FLEET_SUPERVISOR, Robot, Subject, Supervisor
from fsar_ledger.events.execution import ExecutionFinished, ExecutionQueued, ExecutionStarted, ExecutionWithdrawn
from fsar_ledger.events.world import PolicyWindowClosed, PolicyWindowOpened
from fsar_ledger.projections import execution, world
from fsar_ledger.projections.fold import ROUTES, State, apply, fold
from fsar_ledger.projections.world import in_force, stricter
from fsar_ledger.runtime.experiment import Experiment
from fsar_ledger.runtime.simulation import SCENARIOS, RunSpec, simulate_run
from tests import past
from tests.foreign.histories import foreign_run
from tests.runtime.commanded import commanded
from tests.runtime.histories import A, B, happen

RECORDS_ONLY = {
    "ExperimentPlanned",  # of no run
    "ShardRecorded",  # of no run
    "AttemptRolledBack",
    "CandidateMatched",
    "CommandRejected",
    "ContextChanged",
    "GapDetected",
    "InternalHandoff",
    "OwnStepDecided",
    "PeerSought",
    "PeersMet",
    "PolicyConflictEscalated",
    "ReassignmentDecided",
    "RegistryConsulted",
    "ReplanOrdered",
    "RoutineDue",
    "RoutinePerformed",
    "RoutineReported",
    "RoutineWithheld",
    "RobotCalledAway",
    "SegmentTransferred",
    "SnapshotPhaseSet",
    "TaskStateTransferred",
    *("SourceOpened", "Observed", "SourceClosed"),  # what a source said, whatever is derived from it
    "CommandGiven",
    "RunContinued",  # with the state of another run
    "IsolatedResultAccepted",
    "IsolatedResultOvertaken",
}


def test_every_event_type_has_a_projection_or_is_listed_as_a_record() -> None:
    missing = {event_type.__name__ for event_type in set(EVENT_TYPES) - ROUTES.keys()} - RECORDS_ONLY
    assert not missing, f"{sorted(missing)}: name each in HANDLES of a projection, or in RECORDS_ONLY of this file"
    assert {event_type.__name__ for event_type in set(EVENT_TYPES) - ROUTES.keys()} == RECORDS_ONLY
    assert set(EVENT_TYPES) >= ROUTES.keys()


@pytest.fixture(scope="module")
def emitted() -> set[type[Event]]:
    specs = [
        RunSpec(8, architecture, "full", scenario, 4, run)
        for architecture in PAPER_ARCHITECTURES
        for scenario in SCENARIOS
        for run in range(12)
    ]
    specs += [
        RunSpec(8, "fsar", configuration, scenario, 4, 0)
        for configuration in CONFIGURATIONS[1:]
        for scenario in SCENARIOS
    ]
    specs += [RunSpec(8, "fsar", "full", workflow, 4, 0) for workflow in PAPER_WORKFLOWS]
    specs.append(
        RunSpec(42, "fsar", "full", "mixed-trust-inspection", 4, 19)
    )  # one of the few in which a task changes hands
    specs.append(RunSpec(8, "roboos", "full", "door-relay", 4, 0))  # which has a store
    specs.append(RunSpec(8, "alliance", "full", "door-relay", 16, 0))  # in which robots have teammates to hear
    specs.append(RunSpec(42, "cfc", "full", "fleet-contention", 4, 32))  # and in which a helper is busy
    away = simulate_run(
        RunSpec(8, "fsar", "full", "fleet-contention", 4, 0), Constants(outages=Outages(0.05, 8.0, 0.03, 6.0))
    ).events
    unreachable = simulate_run(
        RunSpec(42, "jade", "full", "door-relay", 8, 0), Constants(outages=Outages(0.02, 8.0, 0.03, 6.0))
    ).events
    churn = Constants(membership=Membership(0.006, 25.0, announced_share=0.3, heartbeat_us=5_000_000))
    leaving = simulate_run(RunSpec(8, "fsar", "full", "door-relay", 16, 0), churn).events
    planned = [Experiment(("fsar",), SCENARIOS, 12, 8).plan()]
    runs = (simulate_run(spec, Constants()).events for spec in specs)
    return {
        type(event) for events in (*runs, commanded().events, away, unreachable, leaving, planned) for event in events
    }


def test_every_event_type_is_emitted_by_some_run(emitted: set[type[Event]]) -> None:
    of_other_runs = {
        *("SourceOpened", "Observed", "SourceClosed"),
        *("CommandGiven", "RunContinued", "ShardRecorded"),
        *("IsolationBegan", "IsolationEnded", "IsolatedResultAccepted", "IsolatedResultOvertaken"),
    }
    missing = {event_type.__name__ for event_type in set(EVENT_TYPES) - emitted}
    assert not missing - of_other_runs, f"{sorted(missing - of_other_runs)}: give its command in runtime/commanded.py"
    assert missing == of_other_runs


def test_folding_on_is_folding_all() -> None:
    events = simulate_run(RunSpec(8, "cfc", "full", "fleet-contention", 4, 0), Constants()).events
    state = State()
    happen(state, *events)
    assert state == fold(events)
    assert state != fold(events[:-40])


def test_states_do_not_change_behind_the_back_of_those_who_hold_them() -> None:
    events = simulate_run(RunSpec(8, "dhma", "full", "fleet-contention", 4, 0), Constants()).events
    state = fold(events[: len(events) // 2])
    slots = {slot: getattr(state, slot) for slot in State.__slots__}
    before = {slot: repr(value) for slot, value in slots.items()}
    happen(state, *events[len(events) // 2 :])
    assert {slot: repr(value) for slot, value in slots.items()} == before


OUTCOMES = st.sampled_from(["allow", "deny", "review"])


@given(OUTCOMES, OUTCOMES, OUTCOMES)
def test_composition_is_commutative_associative_and_never_overrides_a_denial(one: str, two: str, three: str) -> None:
    left, right = stricter(one, two), stricter(two, one)  # type: ignore[arg-type]
    assert left == right
    assert stricter(left, three) == stricter(one, stricter(two, three))  # type: ignore[arg-type]
    assert (left == "deny") == ("deny" in (one, two))


@given(st.lists(st.tuples(st.integers(0, 5), st.sampled_from(["deny", "review"])), max_size=12), st.data())
@settings(max_examples=60)
def test_the_policy_in_force_is_the_strictest_open_window(windows: list[tuple[int, str]], data: st.DataObject) -> None:
    state = world.INITIAL
    opened: dict[int, str] = {}
    for name, outcome in windows:
        if name in opened:
            state = world.evolve(state, PolicyWindowClosed(A, "local", str(name)))
            del opened[name]
        else:
            state = world.evolve(
                state,
                PolicyWindowOpened(
                    robot=A,
                    scope="local",
                    window=str(name),
                    outcome=outcome,  # type: ignore[arg-type]
                ),
            )
            opened[name] = outcome
    expected = "deny" if "deny" in opened.values() else "review" if opened else "allow"
    assert in_force(state.local, A) == expected


def queued(name: str, robot: Robot) -> ExecutionQueued:
    return past.queued(Subject(name, name), robot, robot, "carry.package", principals=past.parties())


@given(st.lists(st.integers(0, 9), max_size=40))
@settings(max_examples=80)
def test_a_robot_serves_one_at_a_time_in_order_of_arrival(moves: list[int]) -> None:
    """Even numbers queue an action, odd ones finish the present one or withdraw the last; the model is a plain list."""
    state = execution.INITIAL
    model: list[str] = []
    for ordinal, move in enumerate(moves):
        name = f"task-{ordinal}"
        if move % 2 == 0 or not model:
            state = execution.evolve(state, queued(name, A))
            model.append(name)
        elif move < 6:
            state = execution.evolve(state, ExecutionFinished(Subject(model[0], model[0]), past.parties(), A))
            model.pop(0)
        else:
            state = execution.evolve(state, ExecutionWithdrawn(Subject(model[-1], model[-1]), A))
            model.pop()
        assert [*([state.current[A]] if model else []), *state.queues.get(A, ())] == model


@pytest.mark.parametrize(
    ("on_behalf_of", "supervisor", "stands"),
    [(A, None, (B, A, True, False, False)), (None, FLEET_SUPERVISOR, (B, B, False, False, True))],
)
def test_an_execution_that_was_not_queued_is_what_its_start_says_of_it(
    on_behalf_of: Robot | None, supervisor: Supervisor | None, stands: tuple[Robot, Robot, bool, bool, bool]
) -> None:
    started = ExecutionStarted(
        subject=Subject("t", "t/1"),
        principals=past.parties(supervised_by=supervisor),
        robot=B,
        on_behalf_of=on_behalf_of,
        capability="lift",
    )
    one = execution.evolve(execution.INITIAL, started).actions["t/1"]
    assert (one.robot, one.on_behalf_of, one.is_delegated, one.has_approach, one.is_supervised) == stands


def test_an_action_that_starts_at_another_robot_keeps_its_step_and_attempt() -> None:
    first = past.queued(Subject("t", "t/2.1"), A, A, "lift", step=2)
    state = execution.evolve(execution.INITIAL, first)
    moved = execution.evolve(state, past.started(first.subject, B, A, "lift", 9)).actions["t/2.1"]
    assert (moved.robot, moved.step, moved.attempt) == (B, 2, 1)


def test_events_are_immutable_to_the_leaves() -> None:
    for event_type in EVENT_TYPES:
        assert event_type.__struct_config__.frozen
        for field in msgspec.structs.fields(event_type):
            assert "list" not in str(field.type)
            assert "dict" not in str(field.type)
            assert "float" not in str(field.type)


def test_what_a_robot_has_in_hand_is_an_action_at_it_whatever_was_recorded() -> None:
    """Other systems record in any order, and not all: nothing that the writer stores ends in an error."""
    told = 0
    for seed in range(60):
        run = foreign_run("night", 200, random.Random(seed))
        state = State()
        for seq, event in enumerate(run.events):
            apply(state, event)
            of, told = state.execution, told + 1
            held = [*of.current.items(), *((robot, name) for robot, names in of.queues.items() for name in names)]
            assert len(held) == len(set(held)), (seed, seq)
            held = [one for one in held if not one[1].startswith(execution.HELPING)]
            at = {name: action.robot for name, action in of.actions.items() if action.stage != "withdrawn"}
            assert sorted(held) == sorted((robot, name) for name, robot in at.items()), (seed, seq)
    assert told > 8_000
