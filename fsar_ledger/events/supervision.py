"""Human supervision (Lambda, `eq:supervision`)."""

from typing import Literal

from .envelope import ActionId, Event, Principal, Principals, Robot, Subject, Supervisor, TaskId

Purpose = Literal["review", "recovery", "ordering"]


class SupervisorCalled(Event, frozen=True, kw_only=True):
    """A supervisor is asked to decide: a review, a failure that nothing else resolved, or the order of two commands.

    `robot` is the executor that a coordinator has already picked for the work under review, `competing` the other
    action that wants the same robot.
    """

    subject: Subject[TaskId, ActionId]
    supervisor: Supervisor
    purpose: Purpose
    robot: Robot | None = None
    competing: ActionId | None = None


class SupervisorResponded(Event, frozen=True):
    """The supervisor has decided: approved the review or not, resolved the failure, or ordered the commands.

    `preferred` is the action that goes first.
    """

    subject: Subject[TaskId, ActionId]
    principals: Principals
    purpose: Purpose
    approves: bool = True
    preferred: ActionId | None = None


class SupervisionDensitySet(Event, frozen=True, kw_only=True):
    """From now on every n-th admission by the robot (None: by every robot) goes to a supervisor; 0 means none.

    Paper: sec:model:supervision.
    """

    robot: Robot | None
    review_every: int
    decided_by: Principal | None
    reason: str


class ActuatorServiced(Event, frozen=True):
    """A supervisor has had the robot's actuator repaired."""

    robot: Robot
