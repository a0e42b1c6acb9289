"""What decisions read, to the key, and which event wrote it."""

from collections.abc import Iterator
from functools import reduce
from typing import Any, NamedTuple

import msgspec
import pytest

from fsar_ledger.analysis.reads import ABSENT, Path, Reads, Step, last_writes, read_step
from fsar_ledger.analysis.why import decisions, first_of
from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Robot
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.events.world import PolicyWindowClosed, PolicyWindowOpened
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.projections import SharedMap
from fsar_ledger.projections.execution import Action, Execution
from fsar_ledger.projections.fold import State, apply, fold
from fsar_ledger.projections.world import World
from fsar_ledger.runtime.handlers.commands import Command, Decide, Scheduled
from fsar_ledger.runtime.knockouts import KNOCKOUTS
from fsar_ledger.runtime.simulation import RunSpec, handler_table_of, simulate_run
from tests import past
from tests.analysis.conftest import OUTAGES
from tests.analysis.emptied import emptied
from tests.quick import few

LOCAL = (Step("field", "world"), Step("field", "local"))
OFF = (Step("field", "world"), Step("field", "off"))


def firsts(record: LedgerRun) -> set[int]:
    return {first_of(record, seq) for seq in range(len(record.events))}


class Taken(NamedTuple):
    """A decision as it was taken: the state before it, the command, and the events that it made."""

    state: State
    command: Command
    events: tuple[Event, ...]


def taken(record: LedgerRun) -> Iterator[Taken]:
    """Every decision of the run that made events."""
    made = decisions(record, firsts(record))
    state, copied = State(), 0
    for first in sorted(made):
        for event in record.events[copied:first]:
            apply(state, event)
        copied = first
        end = next((seq for seq in range(first + 1, len(record.events)) if first_of(record, seq) != first), None)
        yield Taken(state, made[first].command, tuple(record.events[first:end]))


def table_of(record: LedgerRun) -> Any:
    started = record.events[0]
    assert isinstance(started, RunStarted)
    return handler_table_of(started.architecture or "", started.configuration or "full")


def require_exact(record: LedgerRun) -> int:
    """Each decision and each reaction does the same on a state that has nothing but what it read."""
    table, checked = table_of(record), 0
    for state, command, events in taken(record):
        reads = Reads()
        assert table.decides[type(command)](reads.state(state), command) == events
        msgspec.json.encode(events)  # plain values only
        assert table.decides[type(command)](emptied(state, reads.values), command) == events
        checked += 1
    state = State()
    for event, time_us in zip(record.events, record.times_us, strict=True):
        apply(state, event)
        for react in table.reacts.get(type(event), ()):
            reads = Reads()
            scheduled: tuple[Scheduled, ...] = react(reads.state(state), event, time_us)
            assert scheduled == react(state, event, time_us)
            assert all(_is_plain(one.command) for one in scheduled)
            assert react(emptied(state, reads.values), event, time_us) == scheduled
            checked += 1
    return checked


def _is_plain(command: Command) -> bool:
    return all(
        value is None or type(value) in (int, str, bool, tuple) or isinstance(value, msgspec.Struct)
        for value in msgspec.structs.asdict(command).values()
    )


def test_each_run_replays_under_observation(runs: list[LedgerRun]) -> None:
    for record in runs:
        made = decisions(record, firsts(record))
        assert len(made) > 100
        assert sum(bool(decision.reads) for decision in made.values()) > 0.7 * len(made)


@pytest.mark.parametrize("number", range(3))
def test_what_was_not_read_changes_no_decision(runs: list[LedgerRun], number: int) -> None:
    assert require_exact(runs[2 * number + 1]) > 300


@pytest.mark.parametrize("step", few([1, 2], [], [2]))
def test_what_was_not_read_changes_no_decision_in_any_scenario_or_knockout(step: int) -> None:
    specs = [
        (architecture, "full", scenario)
        for architecture in ("fsar", "cfc", "dhma")
        for scenario in (
            "collaborative-delivery",
            "failure-recovery-chain",
            "mixed-trust-inspection",
            "fleet-contention",
        )
    ]
    specs += [(one.architecture, one.configuration, "door-relay") for one in KNOCKOUTS]
    for architecture, configuration, scenario in specs[::step]:
        require_exact(simulate_run(RunSpec(7, architecture, configuration, scenario, 4, 0), OUTAGES))


def test_a_large_mapping_is_read_to_the_key() -> None:
    state = State()
    state.execution = Execution(
        current=SharedMap.of({Robot(f"robot/A{number}"): f"A{number}-1/1" for number in range(300)})
    )
    reads = Reads()
    assert reads.state(state).execution.current[Robot("robot/A7")] == "A7-1/1"
    assert list(reads.values) == [(Step("field", "execution"), Step("field", "current"), Step("key", "robot/A7"))]


def test_what_was_read_can_change_a_decision(runs: list[LedgerRun]) -> None:
    """Most decisions read something without which they do not decide the same; others did not need what they read."""
    record = runs[0]
    table, changed, readers = table_of(record), 0, 0
    for state, command, events in taken(record):
        reads = Reads()
        decide = table.decides[type(command)]
        decide(reads.state(state), command)
        readers += bool(reads.values)
        changed += any(not _is_same(decide, state, command, reads.values, path, events) for path in reads.values)
    assert changed > 0.7 * readers > 100


def _is_same(
    decide: Decide, state: State, command: Command, read: dict[Path, object], gone: Path, events: tuple[Event, ...]
) -> bool:
    """Whether the same is decided where one of the things that were read is gone."""
    left = emptied(state, {path: value for path, value in read.items() if path != gone})
    try:
        return decide(left, command) == events
    except (AssertionError, LookupError, AttributeError, TypeError, ValueError, StopIteration):
        return False


@pytest.mark.parametrize("number", [0, 2, 4])
def test_the_last_writer_is_the_event_after_which_the_value_differs(runs: list[LedgerRun], number: int) -> None:
    record = runs[number]
    made = decisions(record, sorted(firsts(record))[60:90])
    asked = [(path, seq) for seq, decision in made.items() for path in decision.reads]
    found = last_writes(record.events, asked)
    for seq in made:
        values: dict[Path, list[object]] = {path: [] for path, before in asked if before == seq}
        state = State()
        for event in (None, *record.events[:seq]):
            if event is not None:
                apply(state, event)
            for path, history in values.items():
                history.append(reduce(read_step, path, state))
        for path, history in values.items():
            last = next((at for at in range(len(history) - 1, 0, -1) if history[at] != history[at - 1]), None)
            assert found[path, seq].by == (None if last is None else last - 1)
    assert len(found) > 100


def test_each_window_is_known_by_the_event_that_opened_it() -> None:
    robot = Robot("robot/B1")
    opened = [
        PolicyWindowOpened(window=name, robot=robot, scope="local", outcome="deny") for name in ("one", "two", "three")
    ]
    closed = PolicyWindowClosed(window="two", robot=robot, scope="local")
    path = (*LOCAL, Step("key", robot))
    found = last_writes([*opened, closed], [(path, seq) for seq in range(5)])
    assert [found[path, seq].by for seq in range(5)] == [None, 0, 1, 2, 3]
    assert found[path, 3].elements == (0, 1, 2)
    assert found[path, 4].elements == (0, 2)


def test_what_lies_beyond_an_absent_key_was_written_by_nobody() -> None:
    pair = (Robot("robot/A1"), Robot("robot/B1"))
    entry = past.trusted(pair[0], pair[1], "task", "carry", reason="founding")
    of_pair = (Step("field", "trust"), Step("field", "entries"), Step("key", pair))
    other, own = (*of_pair, Step("has", ("lift", None))), (*of_pair, Step("has", ("carry", None)))
    nothing = (*of_pair, Step("key", ("lift", None)))
    found = last_writes([entry], [(other, 1), (own, 1), (nothing, 1), ((*of_pair, Step("size")), 1)])
    assert [one.by for one in found.values()] == [None, 0, None, 0]


def seen(world: World) -> tuple[Any, Reads]:
    state = State()
    state.world = world
    reads = Reads()
    return reads.state(state).world, reads


def test_an_absent_key_is_read_as_absent() -> None:
    world, reads = seen(World(local={"robot/A1": ()}))  # type: ignore[dict-item]
    assert world.local.get("robot/B1", "nothing") == "nothing"
    assert reads.values == {(*LOCAL, Step("key", "robot/B1")): ABSENT}


def test_a_key_is_asked_for_without_its_value() -> None:
    world, reads = seen(World(local={"robot/A1": ()}))  # type: ignore[dict-item]
    assert "robot/A1" in world.local
    assert "robot/B1" not in world.local
    assert reads.values == {(*LOCAL, Step("has", "robot/A1")): True, (*LOCAL, Step("has", "robot/B1")): False}


def test_who_goes_through_a_mapping_reads_all_its_keys_and_the_values_it_comes_to() -> None:
    world, reads = seen(World(local={"robot/A1": (), "robot/B1": ()}))  # type: ignore[dict-item]
    next(iter(world.local.items()))
    assert reads.values == {(*LOCAL, Step("keys")): ("robot/A1", "robot/B1"), (*LOCAL, Step("key", "robot/A1")): ()}


def test_whether_there_is_anything_is_less_than_what_there_is() -> None:
    world, reads = seen(World(local={"robot/A1": ()}))  # type: ignore[dict-item]
    assert world.local
    assert not world.off
    assert len(world.local) == 1
    assert reads.values == {(*LOCAL, Step("any")): True, (*OFF, Step("any")): False, (*LOCAL, Step("size")): 1}


def test_a_member_of_a_set_is_asked_for_alone() -> None:
    world, reads = seen(World(off=frozenset({"robot/A1"})))  # type: ignore[arg-type]
    assert "robot/A1" in world.off
    assert reads.values == {(*OFF, Step("has", "robot/A1")): True}
    assert world.off | {"robot/B1"} == {"robot/A1", "robot/B1"}
    assert reads.values[*OFF, Step("keys")] == {"robot/A1"}


def test_a_property_reads_the_fields_that_it_needs() -> None:
    action = Action("A1-1", "A1-1/1.1", None, None, "robot/A1", "robot/A1", "carry", 1, 1, False, False, False)  # type: ignore[arg-type]
    state, reads = State(), Reads()
    state.execution = Execution(actions={"A1-1/1.1": action})
    found = reads.state(state).execution.actions["A1-1/1.1"]
    assert (found.subject.task_id, found.subject.action_id) == ("A1-1", "A1-1/1.1")
    assert [path[-1] for path in reads.values] == [
        Step("has", "A1-1/1.1"),
        Step("field", "task_id"),
        Step("field", "action_id"),
    ]


def test_two_structures_are_compared_as_wholes() -> None:
    world, reads = seen(World())
    other, _ = seen(World(off=frozenset({"robot/A1"})))  # type: ignore[arg-type]
    assert world == World()
    assert world != other
    assert reads.values == {(Step("field", "world"),): World()}


def test_a_changed_copy_reads_only_what_was_not_changed() -> None:
    world, reads = seen(World())
    changed = world.__replace__(off=frozenset({"robot/A1"}))
    assert "robot/A1" in changed.off
    assert reads.values == {}
    assert changed.degraded.get("robot/A1") is None
    assert list(reads.values) == [(Step("field", "world"), Step("field", "degraded"), Step("key", "robot/A1"))]
    assert changed == World(off=frozenset({"robot/A1"}))  # type: ignore[arg-type]


def test_the_state_itself_stays_as_it_is(runs: list[LedgerRun]) -> None:
    state = fold(runs[0].events)
    shown = Reads().state(state)
    assert state == fold(runs[0].events)
    assert shown.world is not state.world
