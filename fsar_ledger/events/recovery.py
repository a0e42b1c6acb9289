"""Recovery of a failed execution, outward from the robot (Omega, `eq:recovery`).

`failure` is the number of the failure within the action, as in `ExecutionFailed`.
"""

from .envelope import (
    ActionId,
    Event,
    FailureCause,
    Principal,
    Principals,
    RecoveryLevel,
    Result,
    Robot,
    Subject,
    TaskId,
)


class RecoveryBudgetSet(Event, frozen=True, kw_only=True):
    """The robot's Q_i gives this level the budget (t_max, n_max) from now on.

    Units: `t_max_us` microseconds. Paper: app:foundations.
    """

    robot: Robot
    level: RecoveryLevel
    t_max_us: int
    n_max: int
    decided_by: Principal | None


class RecoveryAttempted(Event, frozen=True, kw_only=True):
    """An attempt to recover has begun; `number` counts from 1 within the failure.

    Units: `deadline_us` run time. Paper: sec:model:recovery.
    """

    subject: Subject[TaskId, ActionId | None]
    principals: Principals
    robot: Robot
    failure: int
    number: int
    level: RecoveryLevel
    deadline_us: int
    # See docs/decisions/recovery-records-carry-failed-action.md.
    failed_action: ActionId


class RecoveryAttemptFailed(Event, frozen=True, kw_only=True):
    """The attempt did not resolve the failure; a partial one has `achieved` some of the postconditions."""

    subject: Subject[TaskId, ActionId]
    robot: Robot
    failure: int
    number: int
    result: Result = "failure"
    achieved: tuple[str, ...] = ()


class AttemptRolledBack(Event, frozen=True, kw_only=True):
    """The effects of a partial attempt have been undone, so that the next attempt begins where the first did.

    Paper: fig:recovery (level 1: retry, rollback, replan).
    """

    subject: Subject[TaskId, ActionId]
    robot: Robot
    failure: int
    number: int
    undone: tuple[str, ...]


class RecoveryEscalated(Event, frozen=True, kw_only=True):
    """Recovery has moved to the next level for this reason; a level that has nothing to try is left at once.

    Paper: eq:recovery.
    """

    subject: Subject[TaskId, ActionId | None]
    principals: Principals
    robot: Robot
    failure: int
    level: RecoveryLevel
    to_level: RecoveryLevel
    failed_action: ActionId
    reason: str | None = None


class AssistanceRequested(Event, frozen=True, kw_only=True):
    """`helper` has been asked to help `robot`. Paper: sec:model:recovery, level 2.

    Units: `since_us` run time at which recovery turned to this level, None where the level has no budget of its own.
    """

    subject: Subject[TaskId, ActionId | None]
    principals: Principals
    robot: Robot
    helper: Robot
    failure: int
    level: RecoveryLevel
    failed_action: ActionId
    since_us: int | None = None


class AssistanceAdmitted(Event, frozen=True, kw_only=True):
    """The helper has agreed and stays occupied until it has helped."""

    subject: Subject[TaskId, ActionId]
    principals: Principals
    robot: Robot
    helper: Robot
    failure: int
    level: RecoveryLevel


class AssistanceDeclined(Event, frozen=True):
    """The helper is busy, or in a live fleet says no."""

    subject: Subject[TaskId, ActionId]
    robot: Robot
    helper: Robot
    failure: int


class AssistanceEnded(Event, frozen=True):
    """The helper has helped and is free again."""

    subject: Subject[TaskId, ActionId]
    robot: Robot
    helper: Robot
    failure: int


class AssistanceFailed(Event, frozen=True, kw_only=True):
    """The helper could not help and is free again.

    Its own way was blocked, or its actuator did not hold either. Paper: sec:model:recovery, level 2.
    """

    subject: Subject[TaskId, ActionId]
    robot: Robot
    helper: Robot
    failure: int
    cause: FailureCause


class ReassignmentDecided(Event, frozen=True, kw_only=True):
    """The recovery orchestrator has looked for another robot; `helper` is None when no reassignment is feasible.

    Paper: sec:model:recovery, level 3.

    `checkpoint` is the declared state from which the helper resumes; `reason` says why none can.
    """

    subject: Subject[TaskId, ActionId]
    principals: Principals
    robot: Robot
    helper: Robot | None
    failure: int
    checkpoint: str | None = None
    reason: str | None = None


class TaskStateTransferred(Event, frozen=True, kw_only=True):
    """The helper has received the state of the task as of the checkpoint: the steps done until then.

    Paper: sec:model:recovery, level 3.
    """

    subject: Subject[TaskId, ActionId]
    robot: Robot
    helper: Robot
    checkpoint: str
    completed: tuple[str, ...]


class FailureResolved(Event, frozen=True):
    """The failure has been resolved at this level."""

    subject: Subject[TaskId, ActionId]
    robot: Robot
    failure: int
    level: RecoveryLevel
