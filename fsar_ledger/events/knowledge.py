"""What a decider has been told: messages that arrived, copies that were refreshed, queues.

Knowledge lags behind the world. The architecture determines which knowledge exists.
"""

from .envelope import ActionId, Availability, Event, PolicyOutcome, Principal, Robot, Subject, TaskId


class FleetRuleLearned(Event, frozen=True):
    """The robot has been told the fleet's rule for its zone, as it was at `as_of_us` (run time)."""

    robot: Robot
    outcome: PolicyOutcome
    as_of_us: int


class PeerRemembered(Event, frozen=True):
    """Without a registry, a robot knows the peer it met until `until_us` (microseconds of run time)."""

    robot: Robot
    peer: Robot
    until_us: int


class CopySynced(Event, frozen=True, kw_only=True):
    """The coordinator has refreshed its copy of all robots.

    A robot that is not listed has policies that allow, is idle, and is not degraded.
    """

    local_deny: tuple[Robot, ...] = ()
    local_review: tuple[Robot, ...] = ()
    fleet_deny: tuple[Robot, ...] = ()
    fleet_review: tuple[Robot, ...] = ()
    busy: tuple[Robot, ...] = ()
    degraded: tuple[Robot, ...] = ()


class SnapshotTaken(Event, frozen=True):
    """A robot's planner has refreshed its snapshot of the robot's own policy."""

    robot: Robot
    outcome: PolicyOutcome


class BidReceived(Event, frozen=True):
    """The requester has read a bid; `ahead` as in `BidSubmitted`."""

    subject: Subject[TaskId, ActionId]
    robot: Robot
    outcome: PolicyOutcome
    ahead: int | None = None


class PlannerEngaged(Event, frozen=True):
    """The planning agent attends to a motion or a context change until `until_us` (microseconds of run time)."""

    robot: Robot
    until_us: int


class WorkQueued(Event, frozen=True):
    """An item waits for the coordinator, which serves one at a time; it is done at `ready_us` (run time)."""

    subject: Subject[TaskId, ActionId]
    item: str
    ready_us: int


class StoreEntryWritten(Event, frozen=True, kw_only=True):
    """A robot's entry in a shared store now shows this availability; `written_by` is who wrote it.

    Units: `until_us` microseconds of run time at which the entry expires, None if it does not.
    """

    robot: Robot
    availability: Availability
    until_us: int | None
    written_by: Principal
