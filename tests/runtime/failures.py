"""A failure and its recovery: the state in which it happened, for the tests of recovery."""

import msgspec

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import RecoveryLevel
from fsar_ledger.events.execution import ExecutionFailed, ExecutionQueued, ExecutionStarted
from fsar_ledger.events.task import StepBegan
from fsar_ledger.events.world import TaskArrived
from fsar_ledger.projections.fold import State, apply
from tests.runtime.histories import given

A, B, C, D = "robot/A1", "robot/B1", "robot/C1", "robot/D1"
STEPS = ("A navigate.indoor", "A carry.package")
ACTION = "A1-1/2.1"


def executing(
    robot: str = A,
    capability: str = "carry.package",
    *before: Event,
    owner: str = A,
    behalf: str | None = None,
    checkpoints: tuple[str, ...] | None = None,
    configuration: str = "full",
) -> State:
    """The state in which the robot executes the second step of a task, from 1 s to 3 s."""
    behalf = behalf or robot
    return given(
        "fsar",
        *before,
        TaskArrived("A1-1", owner, 1, STEPS, 60_000_000, 65_000_000, checkpoints),
        StepBegan("A1-1", ACTION, behalf, 2, 1, capability),
        ExecutionQueued(
            "A1-1", ACTION, behalf, robot, None, robot, behalf, capability, 2, 1, robot != behalf, robot != behalf, True
        ),
        ExecutionStarted("A1-1", ACTION, behalf, robot, None, robot, behalf, capability, 3_000_000),
        configuration=configuration,
    )


def failed(state: State, level: RecoveryLevel = "local", cause: str = "obstruction") -> State:
    """The execution has failed at 2 s, and its recovery has come to this level."""
    action = state.execution.actions[ACTION]
    apply(state, ExecutionFailed("A1-1", ACTION, action.robot, 1, cause, 1_000_000, 2_000_000))  # type: ignore[arg-type]
    state.recovery = {ACTION: msgspec.structs.replace(state.recovery[ACTION], level=level)}
    return state


def taken(state: State, events: tuple[Event, ...]) -> tuple[Event, ...]:
    """The events, which the state has taken in."""
    for event in events:
        apply(state, event)
    return events
