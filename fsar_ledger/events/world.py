"""What the world does under every architecture: the only events that come from draws.

They all come from the schedule that is generated before the run (see `runtime/world/`), so their (time_us, type,
payload) is the same under every architecture and configuration.
"""

from typing import Literal

from .envelope import Event, Operation, PolicyOutcome, PolicyScope, Robot, Supervisor, TaskId

Grade = Literal["unreliable", "slipping", "lost"]  # from better to worse


class SyncPhaseSet(Event, frozen=True):
    """The fleet-wide clock of periodic exchanges has this phase (parts per million of a period)."""

    phase_ppm: int


class SnapshotPhaseSet(Event, frozen=True):
    """The robot's clock of periodic refreshes has this phase (parts per million of a period)."""

    robot: Robot
    phase_ppm: int


class ContextChanged(Event, frozen=True):
    """The situation around a robot has changed; `window` names the local-policy window that it opens, if any."""

    robot: Robot
    window: str | None = None


class PolicyWindowOpened(Event, frozen=True, kw_only=True):
    """From now on the robot's own policy (`local`) or the fleet's rule for its zone (`fleet`) does not allow."""

    robot: Robot
    scope: PolicyScope
    window: str
    outcome: PolicyOutcome


class PolicyWindowClosed(Event, frozen=True):
    """The policy window is over."""

    robot: Robot
    scope: PolicyScope
    window: str


class ObstructionAppeared(Event, frozen=True):
    """Something is in the robot's way."""

    robot: Robot
    obstruction: str


class ObstructionCleared(Event, frozen=True):
    """The obstruction is out of the robot's way."""

    robot: Robot
    obstruction: str


class ActuatorDegraded(Event, frozen=True):
    """The robot's actuator has degraded. Paper: sec:evaluation:simulator (failure injection).

    An unreliable actuator fails some attempts, a slipping one grips but does not hold, a lost one does not grip. One
    that is already worse stays so.
    """

    robot: Robot
    grade: Grade = "unreliable"


class RobotWentOff(Event, frozen=True):
    """The robot is off from now on: it executes, hears, decides and answers nothing.

    What it was doing stops, and continues when it is back.
    """

    robot: Robot


class RobotCameBack(Event, frozen=True):
    """The robot is on again."""

    robot: Robot


class RobotCalledAway(Event, frozen=True):
    """The robot is called away and will be off soon; until then it can announce that it leaves."""

    robot: Robot


class LinkWentDown(Event, frozen=True):
    """No message reaches or leaves the robot from now on; it carries on alone. Messages sent meanwhile wait."""

    robot: Robot


class LinkCameUp(Event, frozen=True):
    """Messages reach and leave the robot again."""

    robot: Robot


class SupervisorLeft(Event, frozen=True):
    """The local supervisor is off shift from now on."""

    supervisor: Supervisor


class SupervisorReturned(Event, frozen=True):
    """The local supervisor is back on shift."""

    supervisor: Supervisor


class RoutineDue(Event, frozen=True):
    """The robot is due to perform a routine operation, which no task asks for."""

    robot: Robot
    operation: Operation


class PeersMet(Event, frozen=True):
    """Two robots have come within range of each other."""

    robot: Robot
    peer: Robot


class TaskArrived(Event, frozen=True, kw_only=True):
    """A task has arrived. `steps` are `ACTOR capability` (own) or `ACTOR capability TARGET` (delegated).

    Actors and targets are roles of `team`. Another robot can resume before each step whose number is in `checkpoints`
    (None: before every step); a time-critical task competes for robots. Another system's record may lack the robot, the
    team, the steps and the budget.

    Units: `budget_us` microseconds from arrival; `due_us` run time at which the budget ends.
    """

    task_id: TaskId
    robot: Robot | None = None
    team: int | None = None
    steps: tuple[str, ...] = ()
    budget_us: int | None = None
    due_us: int | None = None
    checkpoints: tuple[str, ...] | None = None
    is_time_critical: bool = False


class OutsiderRequestInjected(Event, frozen=True, kw_only=True):
    """A robot attempts a request for which it has no trust. Paper: sec:evaluation:setup (injected trust violations)."""

    task_id: TaskId
    robot: Robot
    peer: Robot
    capability: str


WorldEvent = (
    SyncPhaseSet
    | SnapshotPhaseSet
    | ContextChanged
    | PolicyWindowOpened
    | PolicyWindowClosed
    | ObstructionAppeared
    | ObstructionCleared
    | ActuatorDegraded
    | RobotWentOff
    | RobotCameBack
    | RobotCalledAway
    | LinkWentDown
    | LinkCameUp
    | SupervisorLeft
    | SupervisorReturned
    | RoutineDue
    | PeersMet
    | TaskArrived
    | OutsiderRequestInjected
)
