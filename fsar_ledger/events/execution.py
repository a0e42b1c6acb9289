"""Execution of capabilities by robots, and the routine operations of a robot.

`robot` is the body that moves, `on_behalf_of` the robot whose step it is. These are physical facts, kept beside the
principals that the architecture recorded, which may be None.
"""

from .envelope import (
    ActionId,
    Event,
    FailureCause,
    Operation,
    OverrideLevel,
    Parties,
    PolicyOutcome,
    Principals,
    Result,
    Robot,
    Subject,
    TaskId,
)


class OwnStepDecided(Event, frozen=True):
    """The robot has decided to do a step of its own."""

    subject: Subject[TaskId, ActionId | None]
    principals: Principals
    capability: str


class ExecutionQueued(Event, frozen=True, kw_only=True):
    """The action waits for the robot, which serves one at a time: by override level, then in order of arrival.

    The principals are those that the architecture records for the execution; `is_supervised` is False when it knows no
    supervisor for it at all.

    Paper: eq:override.
    """

    subject: Subject[TaskId, ActionId]
    principals: Parties
    robot: Robot
    on_behalf_of: Robot
    capability: str
    step: int
    attempt: int
    is_delegated: bool
    has_approach: bool
    is_supervised: bool
    override: OverrideLevel = "none"


class ApproachStarted(Event, frozen=True):
    """The robot moves to where the delegated action is to happen."""

    subject: Subject[TaskId, ActionId]
    robot: Robot


class ExecutionHeld(Event, frozen=True):
    """The robot is ready but waits, because the policy known to it does not allow the start.

    `decided_by` names the decider when the wait is a denial, else it is None.
    """

    subject: Subject[TaskId, ActionId]
    principals: Principals
    robot: Robot
    outcome: PolicyOutcome
    reason: str


class ExecutionStarted(Event, frozen=True, kw_only=True):
    """The robot has begun to execute. Units: `ends_us` microseconds of run time, the planned end.

    `on_behalf_of` and `ends_us` are None where the record of another system lacks them.
    """

    subject: Subject[TaskId, ActionId]
    principals: Parties
    robot: Robot
    on_behalf_of: Robot | None = None
    capability: str
    ends_us: int | None = None


class ExecutionPaused(Event, frozen=True):
    """The robot paused: to replan in the model, for any reason in another system's record.

    Units: `remaining_us` microseconds of execution left.
    """

    subject: Subject[TaskId, ActionId]
    robot: Robot
    remaining_us: int | None = None


class ExecutionHalted(Event, frozen=True):
    """The robot went off while executing; the rest continues when it is back.

    Units: `remaining_us` microseconds of execution left.
    """

    subject: Subject[TaskId, ActionId]
    robot: Robot
    remaining_us: int | None = None


class ExecutionPreempted(Event, frozen=True):
    """A request of a higher override level has taken the robot; this action continues after it. Paper: eq:override.

    Units: `remaining_us` microseconds of execution left, None when it had not started.
    """

    subject: Subject[TaskId, ActionId]
    robot: Robot
    preempted_by: ActionId
    remaining_us: int | None


class ReplanOrdered(Event, frozen=True):
    """The coordinator has sent a new plan for a paused action."""

    task_id: TaskId
    principals: Principals


class ExecutionResumed(Event, frozen=True):
    """The robot executes the rest of the action. Units: `ends_us` microseconds of run time, the planned end."""

    subject: Subject[TaskId, ActionId]
    robot: Robot
    ends_us: int | None = None


class ExecutionFailed(Event, frozen=True, kw_only=True):
    """An attempt has failed and the failure has just been detected; `failure` counts from 1 within the action.

    `cause` is open text: `obstruction` or `degradation` in our own runs, what the source says in others.

    Units: `remaining_us` microseconds of execution left; `detected_us` run time.
    """

    subject: Subject[TaskId, ActionId]
    robot: Robot
    failure: int
    cause: FailureCause
    remaining_us: int | None = None
    detected_us: int | None = None


class ExecutionFinished(Event, frozen=True):
    """The execution is over and its result is known to the robot. Paper: sec:model:request, phase 5.

    `achieved` names the postconditions that hold, when not all do.
    """

    subject: Subject[TaskId, ActionId]
    principals: Parties
    robot: Robot
    result: Result = "success"
    achieved: tuple[str, ...] = ()


class ExecutionWithdrawn(Event, frozen=True):
    """The action no longer occupies this robot.

    Its contract is void, it was reassigned, its robot has left it, or its task was given up before it began. With a
    `failure` number, the robot gave it up because of that failure, from which nobody recovers.
    """

    subject: Subject[TaskId, ActionId]
    robot: Robot
    failure: int | None = None


# See docs/decisions/routine-work-counts.md.
class RoutinePerformed(Event, frozen=True):
    """The robot performed a routine operation. Motion is subject to policy; sensing is not."""

    principals: Principals
    robot: Robot
    operation: Operation


class RoutineWithheld(Event, frozen=True):
    """The robot withheld a routine motion, because the policy known at that time does not allow it."""

    principals: Principals
    robot: Robot
    operation: Operation


class RoutineReported(Event, frozen=True):
    """A second agent of the robot has recorded a motion that needed two agents.

    Paper: sec:evaluation:baselines (DHMA).
    """

    principals: Parties
    robot: Robot
