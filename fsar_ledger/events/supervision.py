"""Human supervision (Lambda, `eq:supervision`)."""

from typing import Literal

from .envelope import Event

Purpose = Literal["review", "recovery", "ordering"]


class SupervisorCalled(Event, frozen=True):
    """A supervisor is asked to decide: a review, a failure that nothing else resolved, or the order of two commands.

    `robot` is the executor that a coordinator has picked already for what is under review; `competing` the other
    action that wants the same robot.
    """

    task_id: str
    action_id: str
    supervisor: str
    purpose: Purpose
    robot: str | None = None
    competing: str | None = None


class SupervisorResponded(Event, frozen=True):
    """The supervisor has decided: approved the review or not, resolved the failure, ordered the commands (`preferred` goes first)."""

    task_id: str
    action_id: str
    decided_by: str | None
    requested_by: str | None
    executed_by: str | None
    supervised_by: str | None
    path: tuple[str, ...]
    purpose: Purpose
    approves: bool = True
    preferred: str | None = None


class SupervisionDensitySet(Event, frozen=True):
    """One in so many admissions of the robot (None: of every robot) is put before a supervisor; 0 is none. Paper: sec:model:supervision."""

    robot: str | None
    review_every: int
    decided_by: str | None
    reason: str


class ActuatorServiced(Event, frozen=True):
    """A supervisor has had the robot's actuator repaired."""

    robot: str


SupervisionEvent = SupervisorCalled | SupervisorResponded | SupervisionDensitySet | ActuatorServiced
