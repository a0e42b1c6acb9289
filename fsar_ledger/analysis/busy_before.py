"""What robots were in before their record, as what comes later shows: facts/busy_before.sql, of one run."""

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Robot
from fsar_ledger.events.execution import (
    ApproachStarted,
    ExecutionFailed,
    ExecutionFinished,
    ExecutionHalted,
    ExecutionHeld,
    ExecutionPaused,
    ExecutionPreempted,
    ExecutionQueued,
    ExecutionResumed,
    ExecutionStarted,
    ExecutionWithdrawn,
)
from fsar_ledger.events.recovery import (
    AssistanceAdmitted,
    AssistanceEnded,
    AssistanceFailed,
    AssistanceRequested,
    FailureResolved,
    RecoveryAttempted,
    RecoveryAttemptFailed,
    RecoveryEscalated,
)
from fsar_ledger.events.world import RobotCameBack, RobotWentOff
from fsar_ledger.ledger.rows.codec import LedgerRun

BEGINS = (ExecutionQueued, ApproachStarted, ExecutionHeld, ExecutionStarted)
GOES_ON = (
    *(ExecutionPaused, ExecutionHalted, ExecutionPreempted, ExecutionResumed, ExecutionFailed),
    *(ExecutionFinished, ExecutionWithdrawn),
)
RECOVERS = (RecoveryAttempted, RecoveryAttemptFailed, RecoveryEscalated, AssistanceRequested, FailureResolved)
"""What tells of a failure, and not of what the robot does."""
HELPS = (AssistanceAdmitted, AssistanceEnded, AssistanceFailed)
OUTAGES = (RobotWentOff, RobotCameBack)
OFF = ("off",)
"""What an outage is about, beside the names of actions."""


def is_busy_before(record: LedgerRun, seq: int, robot: Robot) -> bool:
    """Return whether the robot of a foreign run is off, or has something in hand, since before its record.

    What began within it is on record, so the first that is told of anything else shows that it was so until then.
    """
    if getattr(record.events[0], "kind", None) != "foreign":
        return False
    until_now = record.events[: seq + 1]
    told = {_thing(event, robot) for event in until_now if not isinstance(event, RECOVERS)} - {None}
    if {_thing(event, robot) for event in until_now} - {None} - told:
        return True
    for event in record.events[seq + 1 :]:
        thing = _thing(event, robot)
        if thing is not None and thing not in told:
            if not isinstance(event, (*BEGINS, AssistanceAdmitted, RobotWentOff)):
                return True
            told.add(thing)
    return False


def _thing(event: Event, robot: Robot) -> object:
    """Return which action of this robot, or help, the event is about, or that it is off; None for any other."""
    if isinstance(event, HELPS):
        return (event.subject.action_id, "help") if event.helper == robot else None
    if isinstance(event, RECOVERS):
        return getattr(event, "failed_action", event.subject.action_id) if event.robot == robot else None
    if isinstance(event, (*BEGINS, *GOES_ON)):
        return event.subject.action_id if event.robot == robot else None
    return OFF if isinstance(event, OUTAGES) and event.robot == robot else None
