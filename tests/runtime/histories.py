"""Given events, when a command, then events: helpers for the tests of pure handlers."""

from typing import Any

from fsar_ledger.designs.constants import Constants
from fsar_ledger.events import Event
from fsar_ledger.events.configuration import Configuration
from fsar_ledger.events.envelope import Architecture, Robot, Subject
from fsar_ledger.events.world import PolicyWindowOpened
from fsar_ledger.projections.fold import State, apply, fold
from fsar_ledger.runtime.kernel import Kernel
from fsar_ledger.runtime.simulation import RunSpec, kernel, run_started
from fsar_ledger.runtime.world import founding
from tests import past

A, B, C, D = (Robot(f"robot/{name}1") for name in "ABCD")
DOOR = "door.open.secure"
STEPS = ("A navigate.indoor", f"A {DOOR} B")
ARRIVED = past.arrived("A1-1", A, STEPS)
SECOND: tuple[Event, ...] = (  # another task of the same robot that needs the same door
    past.arrived("A1-2", A, STEPS),
    past.began(Subject("A1-2", "A1-2/2.1"), A, 2, DOOR, "B"),
)
OWN_STEP = past.began(Subject("A1-1", "A1-1/1.1"), A, 1, "navigate.indoor")
DELEGATED_STEP = past.began(Subject("A1-1", "A1-1/2.1"), A, 2, DOOR, "B")


def started(
    architecture: Architecture,
    configuration: Configuration = "full",
    constants: Constants = Constants(),  # noqa: B008
) -> tuple[Event, ...]:
    """The founding of a fleet of four under this architecture."""
    spec = RunSpec(1, architecture, configuration, "door-relay", 4, 0)
    return (run_started(spec, constants), *founding(4))


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
