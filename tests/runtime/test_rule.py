"""The Rule: all randomness belongs to the world, and the world does not know who governs it.

Each test of the Rule is a check with two subjects: ours, which holds, and one that is broken on purpose.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import get_args

import pytest
from msgspec.structs import replace

from fsar_ledger.designs.constants import Constants, Structure, WorldConstants
from fsar_ledger.events import Event
from fsar_ledger.events.configuration import ARCHITECTURES, CONFIGURATIONS, Configuration
from fsar_ledger.events.envelope import Architecture, Scenario
from fsar_ledger.events.recovery import FailureResolved
from fsar_ledger.events.task import TaskCompleted
from fsar_ledger.events.world import WorldEvent
from fsar_ledger.ledger.rows.codec import LedgerRun, encode
from fsar_ledger.metrics.results import metric_rows
from fsar_ledger.runtime.architectures import HandlerTable
from fsar_ledger.runtime.handlers.commands import StartAction, TakeTurn
from fsar_ledger.runtime.kernel import Kernel
from fsar_ledger.runtime.ports import Ask, Fact
from fsar_ledger.runtime.simulation import SCENARIOS, RunSpec, handler_table_of, kernel, simulate_run
from fsar_ledger.runtime.world import Draws, SimulatedEnvironment, Stream, run_key
from fsar_ledger.runtime.world.schedule import schedule
from tests.recycled import from_table
from tests.runtime.histories import finished

WORLD_TYPES = get_args(WorldEvent)
GOVERNANCES: tuple[tuple[Architecture, Configuration], ...] = (
    *((architecture, "full") for architecture in ARCHITECTURES),
    *(("fsar", configuration) for configuration in CONFIGURATIONS[1:]),
)


def facts_of(run: Kernel) -> list[Fact]:
    return [
        (time, event) for time, event in zip(run.times_us, run.events, strict=True) if isinstance(event, WORLD_TYPES)
    ]


def worlds_are_the_same(runs: Sequence[Kernel]) -> bool:
    return all(facts_of(run) == facts_of(runs[0]) for run in runs)


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_every_governance_meets_the_same_world(scenario: Scenario) -> None:
    runs = [
        finished(RunSpec(3, architecture, configuration, scenario, 4, 1)) for architecture, configuration in GOVERNANCES
    ]
    assert len(facts_of(runs[0])) > 100
    others = [who for who, one in zip(GOVERNANCES, runs, strict=True) if not worlds_are_the_same([runs[0], one])]
    assert not others, f"{others}: found other events of the world; only its schedule makes them, no handler does"


def test_a_world_that_knows_its_governor_is_found_out() -> None:
    def leaking(architecture: Architecture) -> Kernel:
        spec = RunSpec(3, architecture, "full", "door-relay", 4, 1)
        facts = schedule(Constants(), 3 + len(architecture), "door-relay", 1, 4)
        one = kernel(spec, Constants())
        one._facts = facts
        one.run()
        return one

    assert not worlds_are_the_same([leaking("fsar"), leaking("cfc")])


class RecordingDraws(Draws):
    """Draws that remember what was asked and answered."""

    __slots__ = ("asked",)

    def __init__(self, key: bytes, world: WorldConstants) -> None:
        super().__init__(key, world)
        self.asked: dict[tuple[str, str], int] = {}

    def answer(self, ask: Ask) -> int:
        self.asked[ask.what, ask.key] = super().answer(replace(ask, share_ppm=1_000_000))
        return super().answer(ask)


class CountingDraws(RecordingDraws):
    """Broken on purpose: the draw depends on how many were made before."""

    __slots__ = ()

    def answer(self, ask: Ask) -> int:
        drawn = super().answer(replace(ask, key=f"{len(self.asked)}/{ask.key}"))
        self.asked[ask.what, ask.key] = drawn
        return drawn


def asked_by(architecture: Architecture, draws: type[RecordingDraws]) -> dict[tuple[str, str], int]:
    spec = RunSpec(3, architecture, "full", "collaborative-delivery", 4, 1)
    recording = draws(run_key(3, "collaborative-delivery", 1), WorldConstants())
    run = kernel(spec, Constants())
    run._answer = SimulatedEnvironment((), recording).answer
    run.run()
    return recording.asked


def meetings_agree(one: dict[tuple[str, str], int], other: dict[tuple[str, str], int]) -> bool:
    common = one.keys() & other.keys()
    return len(common) > 10 and all(one[key] == other[key] for key in common)


@pytest.mark.parametrize("other", ["cfc", "dhma", "alliance"])
def test_draws_agree_wherever_two_architectures_meet_the_same_key(other: Architecture) -> None:
    assert meetings_agree(asked_by("fsar", RecordingDraws), asked_by(other, RecordingDraws))


def test_draws_that_count_do_not_agree() -> None:
    assert not meetings_agree(asked_by("fsar", CountingDraws), asked_by("cfc", CountingDraws))


def names_are_blind(names: Sequence[str]) -> bool:
    return not any(word in name for name in names for word in (*ARCHITECTURES, *CONFIGURATIONS))


def test_no_stream_name_contains_an_architecture_or_a_configuration() -> None:
    names = [
        f"{stream}/{key}" for architecture in ARCHITECTURES for stream, key in asked_by(architecture, RecordingDraws)
    ]
    assert names_are_blind(names)
    assert not names_are_blind([*names, "message/cfc/A1-1"])


def others_are_unmoved(stream: Callable[[bytes, str], Stream]) -> bool:
    key = run_key(1, "door-relay", 0)
    quiet = [stream(key, f"context/{robot}").uniform() for robot in ("robot/A1", "robot/B1")]
    first = stream(key, "context/robot/A1")
    again = [first.uniform(), *(first.uniform() for _ in range(50))][:1]
    again.append(stream(key, "context/robot/B1").uniform())
    return quiet == again


class SharedStream(Stream):
    """Broken on purpose: all streams draw from one."""

    __slots__ = ()
    _one: Stream | None = None

    def uniform(self) -> float:
        if SharedStream._one is None:
            SharedStream._one = Stream(b"x" * 32, "one")
        return SharedStream._one.uniform()


def test_more_draws_in_one_stream_move_no_other() -> None:
    assert others_are_unmoved(Stream)
    assert not others_are_unmoved(SharedStream)


def test_a_robot_of_a_larger_fleet_meets_the_same_world() -> None:
    def of_robot(fleet_size: int) -> list[Event]:
        return [
            event
            for _, event in schedule(Constants(), 5, "door-relay", 2, fleet_size)
            if getattr(event, "robot", "") == "robot/B1"
        ]

    alone = [
        event
        for event in of_robot(8)
        if type(event).__name__ != "PeersMet" and not getattr(event, "obstruction", "").startswith("crowding/")
    ]
    assert alone == [event for event in of_robot(4) if type(event).__name__ != "PeersMet"]


def completed(structure: HandlerTable | None) -> int:
    runs = [simulate_run(RunSpec(3, "fsar", "full", scenario, 4, 0), Constants(), structure) for scenario in SCENARIOS]
    return sum(isinstance(event, TaskCompleted) for run in runs for event in run.events)


def test_when_all_robots_are_offline_no_task_succeeds() -> None:
    whole = handler_table_of("fsar")
    offline = HandlerTable(
        {**whole.decides, TakeTurn: lambda _state, _command: (), StartAction: lambda _state, _command: ()}, whole.reacts
    )
    assert completed(offline) == 0
    assert completed(None) > 0


def metric(name: str, architecture: Architecture, structure: Structure, runs: int = 25) -> float:
    constants = Constants(structure=structure)
    records: list[LedgerRun] = [
        simulate_run(RunSpec(11, architecture, "full", scenario, 4, run), constants)
        for scenario in SCENARIOS
        for run in range(runs)
    ]
    with from_table(encode(records), threads=1) as database:
        found = next(row.mean for row in metric_rows(database) if row.metric == name)
    assert found is not None
    return found


def rises(values: Sequence[float]) -> bool:
    return all(left < right for left, right in pairwise(values))


@pytest.mark.slow
def test_more_local_attempts_contain_more_failures() -> None:
    def contained(attempts: int) -> int:
        constants = Constants(structure=Structure(local_attempts=attempts))
        runs = [
            simulate_run(RunSpec(11, "fsar", "full", scenario, 4, run), constants)
            for scenario in SCENARIOS
            for run in range(25)
        ]
        return sum(
            isinstance(event, FailureResolved) and event.level == "local" for run in runs for event in run.events
        )

    counts = [contained(attempts) for attempts in (1, 2, 5)]
    assert rises(counts)
    assert not rises(counts[::-1])


@pytest.mark.slow
def test_shorter_sync_gives_fewer_violations_under_cfc() -> None:
    violations = [
        metric("policy_violations", "cfc", Structure(sync_period_us=period))
        for period in (1_000_000, 6_500_000, 25_000_000)
    ]
    assert rises(violations)
    assert not rises(violations[::-1])


def test_every_command_is_decided_once_and_every_reaction_is_to_an_event() -> None:
    for architecture in ARCHITECTURES:
        found = handler_table_of(architecture)
        assert all(issubclass(event, Event) for event in found.reacts)
        assert TakeTurn in found.decides
