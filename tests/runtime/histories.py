"""Given events, when a command, then events: helpers for the tests of pure handlers."""

from typing import Any

from fsar_ledger.constants import Constants
from fsar_ledger.events import Event
from fsar_ledger.events.configuration import Configuration
from fsar_ledger.events.envelope import Architecture, Robot, Subject
from fsar_ledger.events.task import StepBegan
from fsar_ledger.events.world import PolicyWindowOpened, TaskArrived
from fsar_ledger.projections.fold import State, apply, fold
from fsar_ledger.runtime.kernel import Kernel
from fsar_ledger.runtime.simulation import RunSpec, kernel, run_started
from fsar_ledger.runtime.world.founding import founding

STEPS = ("A navigate.indoor", "A door.open.secure B")
ARRIVED = TaskArrived(
    task_id="A1-1", robot=Robot("robot/A1"), team=1, steps=STEPS, budget_us=60_000_000, due_us=65_000_000
)
SECOND: tuple[Event, ...] = (  # another task of the same robot that needs the same door
    TaskArrived(task_id="A1-2", robot=Robot("robot/A1"), team=1, steps=STEPS, budget_us=60_000_000, due_us=65_000_000),
    StepBegan(
        subject=Subject("A1-2", "A1-2/2.1"),
        robot=Robot("robot/A1"),
        step=2,
        attempt=1,
        capability="door.open.secure",
        target_role="B",
    ),
)
OWN_STEP = StepBegan(
    subject=Subject("A1-1", "A1-1/1.1"), robot=Robot("robot/A1"), step=1, attempt=1, capability="navigate.indoor"
)
DELEGATED_STEP = StepBegan(
    subject=Subject("A1-1", "A1-1/2.1"),
    robot=Robot("robot/A1"),
    step=2,
    attempt=1,
    capability="door.open.secure",
    target_role="B",
)


def started(architecture: Architecture, configuration: Configuration = "full") -> tuple[Event, ...]:
    """The founding of a fleet of four under this architecture."""
    spec = RunSpec(1, architecture, configuration, "door-relay", 4, 0)
    return (run_started(spec, Constants()), *founding(4))


def given(architecture: Architecture, *events: Event, configuration: Configuration = "full") -> State:
    """The state after the founding and these events."""
    return fold((*started(architecture, configuration), *events))


def happen(state: State, *events: Event) -> None:
    """Let the state take in these events."""
    for event in events:
        apply(state, event)


def window(robot: Robot, outcome: Any = "deny", scope: Any = "local") -> PolicyWindowOpened:
    """A policy window at the robot."""
    return PolicyWindowOpened(robot=robot, scope=scope, window=f"{scope}/{robot[6:]}/0", outcome=outcome)


def finished(spec: RunSpec, constants: Constants | None = None) -> Kernel:
    """A whole run."""
    one = kernel(spec, constants or Constants())
    one.run()
    return one


def types(events: tuple[Event, ...]) -> list[str]:
    """The names of the events' types."""
    return [type(event).__name__ for event in events]
