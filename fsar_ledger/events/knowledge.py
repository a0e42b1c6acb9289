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


class MotivationBegan(Event, frozen=True):
    """The robot senses that the action is wanted, and from `since_us` (run time) its motivation grows from zero.

    It has just been told, or is free again, or its own policy allows again.
    """

    subject: Subject[TaskId, ActionId]
    robot: Robot
    since_us: int


class ActivityBroadcast(Event, frozen=True):
    """The robot tells the others that it has been active on the action since `since_us` (run time).

    The first broadcast with a `since_us` is its activation.
    """

    subject: Subject[TaskId, ActionId]
    robot: Robot
    since_us: int


class ActivityHeard(Event, frozen=True, kw_only=True):
    """At `as_of_us` (run time) the robot has heard that `peer` is active on the action.

    Units: `level_us` its own motivation then, as microseconds of growth at the fast rate; `patience_us` microseconds
    for which it lets this peer slow its motivation.
    """

    subject: Subject[TaskId, ActionId]
    robot: Robot
    peer: Robot
    as_of_us: int
    level_us: int
    patience_us: int


class NeedEnded(Event, frozen=True, kw_only=True):
    """The robot knows that the action is no longer wanted, because `peer` (perhaps the robot itself) has done it.

    Units: `took_us` microseconds from when the robot first heard that the peer was active, None if it never did.
    """

    subject: Subject[TaskId, ActionId]
    robot: Robot
    peer: Robot
    capability: str
    took_us: int | None
