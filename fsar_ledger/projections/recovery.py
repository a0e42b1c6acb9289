"""Failures that are being recovered. Paper: eq:recovery."""

from collections.abc import Mapping
from typing import assert_never

import msgspec

from fsar_ledger.events.envelope import FailureCause, RecoveryLevel, Robot
from fsar_ledger.events.execution import ExecutionFailed, ExecutionWithdrawn
from fsar_ledger.events.recovery import (
    AssistanceAdmitted,
    AssistanceDeclined,
    AssistanceRequested,
    FailureResolved,
    RecoveryAttempted,
    RecoveryEscalated,
)
from fsar_ledger.events.supervision import SupervisorCalled

from . import put, without

HANDLES = (
    ExecutionFailed
    | ExecutionWithdrawn
    | RecoveryAttempted
    | RecoveryEscalated
    | AssistanceRequested
    | AssistanceAdmitted
    | AssistanceDeclined
    | SupervisorCalled
    | FailureResolved
)


class Recovery(msgspec.Struct, frozen=True, gc=False):
    """The open failure of one action: its attempts, the helpers asked, the one awaited, and the supervisors called.

    `cause` is None where the failure itself is not on record, only its recovery; then `detected_us` has no meaning. It
    is 0 where it is not on record.
    Units: `detected_us` run time, `deadline_us` run time at which the local level's budget ends, `since_us` run time at
    which recovery turned to the robot last asked for help.
    """

    robot: Robot
    failure: int
    cause: FailureCause | None
    detected_us: int
    level: RecoveryLevel = "local"
    number: int = 0
    deadline_us: int = 0
    tried: tuple[Robot, ...] = ()
    calls: int = 0
    since_us: int = 0
    awaited: Robot | None = None


Recoveries = Mapping[str, Recovery]  # action -> open failure

INITIAL: Recoveries = {}


def evolve(state: Recoveries, event: HANDLES) -> Recoveries:
    """Return the open failures after the event."""
    match event:
        case ExecutionFailed():
            failed = Recovery(event.robot, event.failure, event.cause, event.detected_us or 0)
            return put(state, event.subject.action_id, failed)
        case ExecutionWithdrawn():  # the robot gave the action up; else recovery continues with another robot
            return state if event.failure is None else without(state, event.subject.action_id)
        case RecoveryAttempted():
            changed = msgspec.structs.replace(_failed(state, event), number=event.number, deadline_us=event.deadline_us)
            return put(state, event.failed_action, changed)
        case RecoveryEscalated():
            failed = msgspec.structs.replace(_failed(state, event), level=event.to_level, awaited=None)
            return put(state, event.failed_action, failed)
        case AssistanceRequested():
            recovery = _failed(state, event)
            requested = msgspec.structs.replace(
                recovery, tried=(*recovery.tried, event.helper), since_us=event.since_us or 0, awaited=event.helper
            )
            return put(state, event.failed_action, requested)
        case AssistanceAdmitted() | AssistanceDeclined():
            action_id = event.subject.action_id or ""
            if action_id not in state:
                return state
            return put(state, action_id, msgspec.structs.replace(state[action_id], awaited=None))
        case SupervisorCalled():
            called = state.get(event.subject.action_id)
            if called is None or event.purpose != "recovery":
                return state
            return put(state, event.subject.action_id, msgspec.structs.replace(called, calls=called.calls + 1))
        case FailureResolved():
            return without(state, event.subject.action_id)
        case _:
            assert_never(event)


def _failed(state: Recoveries, event: RecoveryAttempted | RecoveryEscalated | AssistanceRequested) -> Recovery:
    """Return the open failure; one missing from another system's record is known only from its recovery."""
    recovery = state.get(event.failed_action)
    return Recovery(event.robot, event.failure, None, 0, event.level) if recovery is None else recovery
