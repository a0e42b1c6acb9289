"""A failure and its recovery: the state in which it happened, for the tests of recovery."""

import msgspec

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import RecoveryLevel, Robot, Subject
from fsar_ledger.events.execution import ExecutionFailed
from fsar_ledger.projections.fold import State, apply
from tests import past
from tests.runtime.histories import given, happen

A, B, C, D = Robot("robot/A1"), Robot("robot/B1"), Robot("robot/C1"), Robot("robot/D1")
STEPS = ("A navigate.indoor", "A carry.package")
ACTION = "A1-1/2.1"


def executing(
    robot: Robot = A,
    capability: str = "carry.package",
    *before: Event,
    owner: Robot = A,
    behalf: Robot | None = None,
    checkpoints: tuple[str, ...] | None = None,
    configuration: str = "full",
    architecture: str = "fsar",
) -> State:
    """The state in which the robot executes the second step of a task, from 1 s to 3 s."""
    behalf = behalf or robot
    return given(
        architecture,
        *before,
        past.arrived("A1-1", owner, STEPS, checkpoints=checkpoints),
        past.began(Subject("A1-1", ACTION), behalf, 2, capability),
        past.queued(Subject("A1-1", ACTION), robot, behalf, capability, step=2),
        past.started(Subject("A1-1", ACTION), robot, behalf, capability, 3_000_000),
        configuration=configuration,
    )


def failed(state: State, level: RecoveryLevel = "local", cause: str = "obstruction", failure: int = 1) -> State:
    """The execution has failed at 2 s, and its recovery has come to this level."""
    action = state.execution.actions[ACTION]
    apply(
        state,
        ExecutionFailed(
            subject=Subject("A1-1", ACTION),
            robot=action.robot,
            failure=failure,
            cause=cause,
            remaining_us=1_000_000,
            detected_us=2_000_000,
        ),
    )
    state.recovery = {ACTION: msgspec.structs.replace(state.recovery[ACTION], level=level)}
    return state


def taken(state: State, events: tuple[Event, ...]) -> tuple[Event, ...]:
    """The events, which the state has taken in."""
    happen(state, *events)
    return events
