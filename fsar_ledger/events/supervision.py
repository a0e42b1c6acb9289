"""Human supervision (Lambda, `eq:supervision`)."""

from typing import Literal

from .envelope import Event

Purpose = Literal["review", "recovery", "ordering"]


class SupervisorCalled(Event, frozen=True):
    """A supervisor is asked to decide: a review, a failure that nothing else resolved, or the order of two commands.

    `robot` is the executor that a coordinator has picked already for what is under review.
    """

    task_id: str
    action_id: str
    supervisor: str
    purpose: Purpose
    robot: str | None = None


class SupervisorResponded(Event, frozen=True):
    """The supervisor has decided: approved the review, resolved the failure, ordered the commands."""

    task_id: str
    action_id: str
    decided_by: str | None
    requested_by: str | None
    executed_by: str | None
    supervised_by: str | None
    path: tuple[str, ...]
    purpose: Purpose


class ActuatorServiced(Event, frozen=True):
    """The fleet supervisor has had the robot's actuator repaired."""

    robot: str


SupervisionEvent = SupervisorCalled | SupervisorResponded | ActuatorServiced
