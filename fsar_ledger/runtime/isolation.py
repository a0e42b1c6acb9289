"""A robot alone and its fleet: what it goes on from, and what it hands over, each read from a ledger, and compared."""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from fsar_ledger.base.errors import UsageError
from fsar_ledger.base.printable import did_you_mean, list_few, value
from fsar_ledger.designs.constants import Constants
from fsar_ledger.events import Event
from fsar_ledger.events.command import CommandGiven
from fsar_ledger.events.envelope import Robot, recorded_robot
from fsar_ledger.events.execution import ExecutionFinished
from fsar_ledger.events.fleet import IsolationBegan, IsolationEnded, RunStarted
from fsar_ledger.events.task import StepCompleted
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows.runs import LedgerRun
from fsar_ledger.ledger.store.locations import (
    chain_of,
    event_at,
    place_of,
    record_of,
    seq_counted_on,
    whole_of,
    whole_runs,
)
from fsar_ledger.ledger.store.read import View
from fsar_ledger.ledger.store.shards import is_log
from fsar_ledger.projections.fold import fold

from .handlers.isolation import HandOver, restated
from .handlers.public import read
from .live import SOURCE
from .recipes import CannotReplay, recorded_constants
from .run_replay import Difference


class Isolation(NamedTuple):
    """The starting point of a robot alone: the fleet's run, and the robot's founding events from it."""

    began: IsolationBegan
    founding: tuple[Event, ...]
    constants: Constants
    epoch: str


class FleetComparison(msgspec.Struct, frozen=True):
    """The result of `compared_with_fleet`: `runs` of robots alone were compared, `handed_over` of them handed over."""

    runs: int
    handed_over: int
    differences: tuple[Difference, ...]

    @property
    def ok(self) -> bool:
        """Return whether nothing differs."""
        return not self.differences


# See docs/decisions/robots-alone-have-runs-of-their-own.md.
def isolation_of(path: Path, robot: str) -> Isolation:
    """Return the starting point of this robot alone, from the newest run of a live fleet in this ledger.

    Raises:
        UsageError: The ledger has no such run, or the robot is no member in it.
        NotALedger, LedgerCorrupted: As `open_ledger`.
    """
    view = _opened(path)
    run = next(filter(partial(_is_of_a_fleet, view), reversed(view.run_names.runs)), None)
    if run is None:
        raise UsageError(f"{path}: found no run of a live fleet, expected one that {value(robot)} continues from")
    return _isolation(view, run, recorded_robot(robot), view.head.size, view.head.root)


def _is_of_a_fleet(view: View, run: str) -> bool:
    """Return whether this is the run of a live fleet, rather than of a robot alone, recorded or simulated."""
    started = event_at(view, place_of(view, run, 0))
    is_alone = started.get("fleet_size") == 1 and _began(record_of(view, run))[1] is not None
    return started.get("source") == SOURCE and not is_alone


def _isolation(view: View, run: str, robot: Robot, size: int, root: str) -> Isolation:
    """As `isolation_of`, for this run within the first `size` events of the ledger."""
    record = record_of(view, run, size)
    started = record.events[0]
    if not isinstance(started, RunStarted) or started.source != SOURCE or started.epoch is None:
        raise UsageError(f"{view.path}: run {value(run)}: found a run that is not live, expected the fleet's")
    state = fold(record.events)
    if robot not in state.fleet.robots or state.fleet.isolated is not None:
        members = sorted(state.fleet.robots)
        raise UsageError(
            f"{view.path}: run {value(run)}: found no fleet with {value(robot)}{did_you_mean(robot, members) or ','} "
            f"expected one of {list_few(members)}"
        )
    began = IsolationBegan(
        robot=robot,
        fleet_run=run,
        fleet_seq=_last_seq(view, record),
        fleet_root=root,
        fence=state.fleet.fences.get(robot),
    )
    constants = recorded_constants(started, len(record.events))
    return Isolation(began, restated(record.events, state, robot), constants, started.epoch)


def _last_seq(view: View, record: LedgerRun) -> int:
    """Return the seq of the record's last event in its own run, which may continue others."""
    return len(record.events) - seq_counted_on(view, record.run_id, 1)


def _opened(path: Path) -> View:
    """Open one ledger. Raises: UsageError for the log of a federation, else as `open_ledger`."""
    view = open_ledger(path)
    require_single(view)
    return view


def require_single(view: View) -> None:
    """Require that this is one ledger. Raises: UsageError for the log of a federation, which has no commands."""
    if is_log(view):
        raise UsageError(
            f"{view.path}: found the log of a federation, expected the ledger of a fleet or a robot; name that one, as "
            "`fsar-ledger info` lists them"
        )


def handed_over(view: View, run: str) -> dict[str, Any]:
    """Return the fields of the `HandOver` of this run of a robot alone. Raises: UsageError where it is none."""
    return _handed_over(view, run, view.head.size, view.head.root)


def _handed_over(view: View, run: str, size: int, root: str) -> dict[str, Any]:
    record = record_of(view, run, size)
    seq, alone = _began(record)
    if alone is None:
        raise UsageError(f"run {value(run)}: found the run of a fleet, expected that of a robot alone")
    return {
        "robot": alone.robot,
        "isolated_run": run,
        "isolated_seq": _last_seq(view, record),
        "isolated_root": root,
        "since_us": record.times_us[seq],
        "since_fence": alone.fence,
        "results": _results(record.events[seq:]),
    }


def _began(record: LedgerRun) -> tuple[int, IsolationBegan | None]:
    """Return the seq and the event at which a robot alone begins after its founding; None for another run."""
    began = ((seq, event) for seq, event in enumerate(record.events) if isinstance(event, IsolationBegan))
    return next(began, (0, None))


def _results(events: Sequence[Event]) -> tuple[str, ...]:
    """Return the last result of each step, in order, in the form of `HandOver`."""
    results: dict[str, str] = {}
    for event in events:
        if isinstance(event, StepCompleted) or (isinstance(event, ExecutionFinished) and event.result != "success"):
            step = event.subject.action_id.rpartition(".")[0]
            results.pop(step, None)
            results[step] = "success" if isinstance(event, StepCompleted) else "failure"
    return tuple(f"{step} {result}" for step, result in results.items())


def compared_with_fleet(path: Path, fleet: Path) -> FleetComparison:
    """Compare the runs of robots alone in the ledger `path` with the ledger of their fleet.

    The founding of each must agree with the fleet's ledger at the recorded root, and what was handed over with the
    robot's ledger at its recorded root. Both ledgers are assumed to verify.

    Raises:
        UsageError: No run of the ledger is that of a robot alone.
        NotALedger, LedgerCorrupted: As `open_ledger`.
    """
    own, theirs = _opened(path), _opened(fleet)
    records = [record for record in whole_runs(own) if _began(record)[1] is not None]
    if not records:
        raise UsageError(f"{path}: found no run of a robot alone, expected one to compare with {fleet}")
    differences: list[Difference] = []
    count = 0
    for record in records:
        differences += _founding_differences(record, theirs)
        ended = _handings_over(record, chain_of(own, record.run_id), theirs)
        count += bool(ended)
        differences += [each for run, seq, command in ended for each in _handing_differences(run, seq, command, own)]
    return FleetComparison(len(records), count, tuple(differences))


def _founding_differences(record: LedgerRun, fleet: View) -> Iterator[Difference]:
    """Yield the differences between the founding of a robot alone and the fleet's ledger."""
    seq, began = _began(record)
    started = record.events[0]
    assert began is not None
    assert isinstance(started, RunStarted)
    size = _sizes(fleet).get(began.fleet_root)
    if size is None or not fleet.has_run(began.fleet_run):
        known = f"a run of {fleet.path}, and a root that it had after a commit"
        yield Difference(record.run_id, seq, "fleet_root", None, known, f"{began.fleet_run}, {began.fleet_root}")
        return
    try:
        theirs = _isolation(fleet, began.fleet_run, began.robot, size, began.fleet_root)
    except (UsageError, CannotReplay) as error:
        yield Difference(record.run_id, seq, "fleet_run", None, "a live run of the robot's fleet", f"{error}")
        return
    expected = (theirs.epoch, theirs.constants, theirs.founding, theirs.began)
    found = (started.epoch, recorded_constants(started, len(record.events)), tuple(record.events[1:seq]), began)
    for name, mine, other in zip(("epoch", "parameters", "founding", "began"), found, expected, strict=True):
        if mine != other:
            yield _difference(record.run_id, {"founding": 1, "began": seq}.get(name, 0), name, mine, other)


def _difference(run: str, seq: int, name: str, found: Any, expected: Any) -> Difference:
    """Return the difference; between two foundings, that of the first event that differs."""
    if name != "founding":
        return Difference(run, seq, name, None, _repr_text(expected), _repr_text(found))
    differing = next((at for at, pair in enumerate(zip(found, expected, strict=False)) if pair[0] != pair[1]), None)
    index = min(len(found), len(expected)) if differing is None else differing
    missing = "the end of the founding"
    wanted, actual = (_repr_text(events[index]) if index < len(events) else missing for events in (expected, found))
    return Difference(run, seq + index, None, None, wanted, actual)


def _repr_text(part: Any) -> str:
    return value(repr(part))


def _sizes(view: View) -> Mapping[str, int]:
    """Return the size of the ledger after each commit, by root."""
    return {commit.tree_root: commit.tree_size for commit in view.commits}


def _handings_over(record: LedgerRun, names: Sequence[str], fleet: View) -> list[tuple[str, int, HandOver]]:
    """Return each command, with its run and seq, that handed over to the fleet what the robot did in these runs."""
    _, began = _began(record)
    if began is None or not fleet.has_run(began.fleet_run):
        return []
    theirs = record_of(fleet, whole_of(fleet, began.fleet_run))
    commands = []
    for seq, event in enumerate(theirs.events):
        if isinstance(event, IsolationEnded) and event.robot == began.robot and event.isolated_run in names:
            cause = theirs.caused_by[seq]
            given = None if cause is None else theirs.events[cause]
            if isinstance(given, CommandGiven):
                command = read(HandOver, given.parameters)
                assert isinstance(command, HandOver)
                commands.append((theirs.run_id, cause or 0, command))
    return commands


def _handing_differences(run: str, seq: int, command: HandOver, own: View) -> Iterator[Difference]:
    """Yield the differences between what was handed over and the robot's own ledger."""
    size = _sizes(own).get(command.isolated_root)
    if size is None:
        expected = f"a root that {own.path} had after a commit"
        yield Difference(run, seq, "isolated_root", None, expected, command.isolated_root)
        return
    for name, expected in _handed_over(own, command.isolated_run, size, command.isolated_root).items():
        if getattr(command, name) != expected:
            yield Difference(run, seq, name, None, f"{expected!r}", f"{getattr(command, name)!r}")
