"""A failure and its recovery: the state in which it happened, for the tests of recovery."""

import msgspec

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Parties, RecoveryLevel, Robot, Subject
from fsar_ledger.events.execution import ExecutionFailed, ExecutionQueued, ExecutionStarted
from fsar_ledger.events.task import StepBegan
from fsar_ledger.events.world import TaskArrived
from fsar_ledger.projections.fold import State, apply
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
) -> State:
    """The state in which the robot executes the second step of a task, from 1 s to 3 s."""
    behalf = behalf or robot
    return given(
        "fsar",
        *before,
        TaskArrived(
            task_id="A1-1",
            robot=owner,
            team=1,
            steps=STEPS,
            budget_us=60_000_000,
            due_us=65_000_000,
            checkpoints=checkpoints,
        ),
        StepBegan(subject=Subject("A1-1", ACTION), robot=behalf, step=2, attempt=1, capability=capability),
        ExecutionQueued(
            subject=Subject("A1-1", ACTION),
            principals=Parties(requested_by=behalf, executed_by=robot, supervised_by=None),
            robot=robot,
            on_behalf_of=behalf,
            capability=capability,
            step=2,
            attempt=1,
            is_delegated=robot != behalf,
            has_approach=robot != behalf,
            is_supervised=True,
        ),
        ExecutionStarted(
            subject=Subject("A1-1", ACTION),
            principals=Parties(requested_by=behalf, executed_by=robot, supervised_by=None),
            robot=robot,
            on_behalf_of=behalf,
            capability=capability,
            ends_us=3_000_000,
        ),
        configuration=configuration,
    )


def failed(state: State, level: RecoveryLevel = "local", cause: str = "obstruction") -> State:
    """The execution has failed at 2 s, and its recovery has come to this level."""
    action = state.execution.actions[ACTION]
    apply(
        state,
        ExecutionFailed(
            subject=Subject("A1-1", ACTION),
            robot=action.robot,
            failure=1,
            cause=cause,  # type: ignore[arg-type]
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
