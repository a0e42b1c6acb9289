"""A robot alone and its fleet: what it goes on from, and what it hands over, each read from a ledger."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from fsar_ledger.base.errors import UsageError
from fsar_ledger.base.printable import value
from fsar_ledger.designs.constants import Constants
from fsar_ledger.events import Event
from fsar_ledger.events.envelope import recorded_robot
from fsar_ledger.events.execution import ExecutionFinished
from fsar_ledger.events.fleet import IsolationBegan, RunStarted
from fsar_ledger.events.task import StepCompleted
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.store.locations import record_of
from fsar_ledger.ledger.store.read import View
from fsar_ledger.projections.fold import fold

from .handlers.isolation import restated
from .live import SOURCE
from .recipes import recorded_constants


class Isolation(NamedTuple):
    """What a robot alone goes on from: the fleet's run, and from it what makes the robot what it is."""

    began: IsolationBegan
    founding: tuple[Event, ...]
    constants: Constants
    epoch: str


# See docs/decisions/robots-alone-have-runs-of-their-own.md.
def isolation_of(path: Path, robot: str) -> Isolation:
    """Return from what this robot goes on without the federation, by the newest live run of this ledger.

    Raises:
        UsageError: The ledger has no live run, or the robot is no member in it.
        NotALedger, LedgerCorrupted: As `open_ledger`.
    """
    view = open_ledger(path)
    run = view.run_names.runs[-1] if view.run_names.runs else ""
    record = record_of(view, run)
    started, member = record.events[0], recorded_robot(robot)
    if not isinstance(started, RunStarted) or started.source != SOURCE or started.epoch is None:
        raise UsageError(f"{path}: run {value(run)}: found a run that is not live, expected the fleet's")
    state = fold(record.events)
    if member not in state.fleet.robots or state.fleet.isolated is not None:
        raise UsageError(f"{path}: run {value(run)}: found no fleet with {value(robot)}, expected one that it is in")
    own = sum(part.block.rows for part in view.parts(run))
    began = IsolationBegan(
        robot=member,
        fleet_run=run,
        fleet_seq=own - 1,
        fleet_root=view.head.root,
        fence=state.fleet.fences.get(member),
    )
    constants = recorded_constants(started, len(record.events))
    return Isolation(began, restated(record.events, state, member), constants, started.epoch)


def handed_over(view: View, run: str) -> dict[str, Any]:
    """Return the fields of the `HandOver` of this run of a robot alone. Raises: UsageError where it is none."""
    record = record_of(view, run)
    began = next((seq for seq, one in enumerate(record.events) if isinstance(one, IsolationBegan)), 0)
    alone = record.events[began]
    if not isinstance(alone, IsolationBegan):
        raise UsageError(f"run {value(run)}: found the run of a fleet, expected that of a robot alone")
    return {
        "robot": alone.robot,
        "isolated_run": run,
        "isolated_seq": sum(part.block.rows for part in view.parts(run)) - 1,
        "isolated_root": view.head.root,
        "since_us": record.times_us[began],
        "since_fence": alone.fence,
        "results": _results(record.events[began:]),
    }


def _results(events: Sequence[Event]) -> tuple[str, ...]:
    """Return how each step ended, as `HandOver` has it: the last word on it, in the order in which they came."""
    found: dict[str, str] = {}
    for event in events:
        if isinstance(event, StepCompleted) or (isinstance(event, ExecutionFinished) and event.result != "success"):
            step = event.subject.action_id.rpartition(".")[0]
            found.pop(step, None)
            found[step] = "success" if isinstance(event, StepCompleted) else "failure"
    return tuple(f"{step} {result}" for step, result in found.items())
