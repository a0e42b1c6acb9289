"""Plans of runs, runs, robots and their membership (`eq:fleet`, `eq:runtime`)."""

from typing import Literal

from .envelope import ActionId, Event, Principal, Robot, Subject, Supervisor, TaskId

Departure = Literal["announced", "silent"]
IsolatedResult = Literal["success", "failure"]


class RunStarted(Event, frozen=True, kw_only=True, tag="RunStarted.v2"):
    """A run has begun: event 0 of the run, with everything that distinguishes it from other runs.

    A run is simulated, live (commands from outside, decided by our handlers) or foreign (recorded by another system,
    named by `source`). `observes` names the concerns, some of `CONCERNS`, of which its source records everything.
    `records` names what else it records: event types (`ExecutionStarted`) with their required fields, and optional
    fields (`ExecutionStarted.requested_by`). Events of any other type are not in the run, and their absence means
    nothing. `epoch` is the time in UTC (ISO 8601) of run time 0, None if the run has none. Architecture, configuration
    and scenario (or workflow) are open text, checked before a run is simulated; None: the run has none.
    `parameters` is JSON, an object of groups of constants; a group that the run does not have is left out.

    A fork repeats the run `forked_from_run` of a ledger with the root `forked_from_root` (hex) up to the event
    `forked_from_seq`, and lists in `changes` what differs (`runtime/changes.py`). Its other fields are its own.
    """

    kind: Literal["simulated", "live", "foreign"]
    observes: tuple[str, ...]
    # See docs/decisions/event-0-is-open-text.md.
    architecture: str | None = None
    configuration: str | None = None
    scenario: str | None = None
    seed: int | None = None
    fleet_size: int | None = None
    run: int | None = None
    model_version: str | None = None
    parameters: str | None = None
    source: str | None = None
    forked_from_root: str | None = None
    forked_from_run: str | None = None
    forked_from_seq: int | None = None
    changes: tuple[str, ...] | None = None
    records: tuple[str, ...] | None = None
    epoch: str | None = None


class RunContinued(Event, frozen=True, kw_only=True):
    """The run continues where another one ended: its event 1, after an event 0 equal to that of the other run.

    `continues` is the other run, `continues_seq` the number of its last event, and `continues_root` the root (hex) of
    the ledger that held it then. `state_sha256` is the digest of the state from which this run continues, all that was
    known and pending (`runtime/snapshot.py`); `state_shape` names the format of that state, since the same state has
    another digest in another format. Times continue. What was pending and happens here is caused by this event.
    """

    continues: str
    continues_seq: int
    continues_root: str
    state_sha256: str
    state_shape: str


class RobotJoined(Event, frozen=True, kw_only=True):
    """A robot has joined the fleet, under its own supervisor H_i if it has one. Paper: eq:fleet, eq:runtime.

    `domain` is the path of the registry in which the robot advertises (`hall/cell`); empty is the fleet's own. `place`
    is where it works (`floor/2`): only robots in the same place meet or get in each other's way; None: the fleet has
    one place. `team` is None where the record has no teams. `public_key` identifies the robot to those who know it; the
    fleet compares it and checks no signature.
    """

    robot: Robot
    role: str
    team: int | None = None
    supervisor: Supervisor | None
    domain: str = ""
    place: str | None = None
    public_key: str | None = None


class HeartbeatReceived(Event, frozen=True):
    """The registry has received a heartbeat of the robot; `number` counts its heartbeats from 1."""

    robot: Robot
    number: int


class RobotSuspected(Event, frozen=True):
    """The registry has received no heartbeat for so long that the robot may have left. It loses nothing yet."""

    robot: Robot


class RobotCleared(Event, frozen=True):
    """The registry has received a heartbeat of the suspected robot, which remains a member."""

    robot: Robot


class RobotDeparted(Event, frozen=True, kw_only=True):
    """The robot is no longer a member: it announced that it leaves, or was silent for too long after a suspicion.

    Its claims and the requests to it end with this event, and its name stays its own. `fence` counts its departures:
    reports and claims under a smaller number are no longer valid, even if it had not really left.

    Paper: sec:discussion:heterogeneity.
    """

    robot: Robot
    reason: Departure
    fence: int
    decided_by: Principal | None


class RobotReturned(Event, frozen=True, kw_only=True):
    """The robot is a member again, with the name, role and key with which it joined, and with its trust.

    From now on its reports carry `fence`.
    """

    robot: Robot
    fence: int
    decided_by: Principal | None


class IsolationBegan(Event, frozen=True, kw_only=True):
    """The robot, cut off from its fleet, continues its own work alone: the first event after a founding at time 0.

    The founding repeats what the robot is, has and may do, and its own waiting tasks, as of event `fleet_seq` of the
    fleet's run `fleet_run` in a ledger with the root `fleet_root` (hex). The fleet's run may continue meanwhile. Times
    are those of the fleet's run. `fence` is the fencing number that the robot's reports carry, None if it has never
    departed.
    """

    robot: Robot
    fleet_run: str
    fleet_seq: int
    fleet_root: str
    fence: int | None = None


class IsolationEnded(Event, frozen=True, kw_only=True):
    """The robot has handed over to the fleet the work that it did in isolation, in a run of its own.

    `isolated_run` is that run, `isolated_seq` the number of its last event, and `isolated_root` the root (hex) of its
    ledger. Units: `since_us` run time at which it began, according to the robot.
    """

    robot: Robot
    isolated_run: str
    isolated_seq: int
    isolated_root: str
    since_us: int


class IsolatedResultAccepted(Event, frozen=True, kw_only=True):
    """The fleet accepts a result from isolation: a success completes the step, a failure leaves it to be done.

    `isolated_run` is the run in which the robot did the work.
    """

    subject: Subject[TaskId, ActionId]
    robot: Robot
    result: IsolatedResult
    isolated_run: str


class IsolatedResultOvertaken(Event, frozen=True, kw_only=True):
    """The fleet does not accept a result from isolation, because it has meanwhile proceeded in another way."""

    subject: Subject[TaskId, ActionId]
    robot: Robot
    result: IsolatedResult
    isolated_run: str
    reason: str


class ExperimentPlanned(Event, frozen=True, kw_only=True):
    """An experiment was planned: `run_count` simulated runs for each architecture, configuration and scenario.

    The plan is the only event of a run of its own. The planned runs are numbered from `first_run` on (None: from 0);
    every other field is as in the `RunStarted` of each of them. Repeating or continuing the experiment adds no second
    plan; enlarging it adds the plan of the larger one.
    """

    architectures: tuple[str, ...]
    configurations: tuple[str, ...]
    scenarios: tuple[str, ...]
    run_count: int
    seed: int
    fleet_size: int
    model_version: str
    parameters: str
    first_run: int | None = None


class ShardRecorded(Event, frozen=True, kw_only=True):
    """The head of a shard was recorded: another ledger, named by the `origin` under which it publishes its heads.

    A ledger of heads is the log of a federation. Each is the only event of a run of its own; the newest head of an
    origin is the valid one. It counts `shard_events` events under the root `shard_root`, in hex. `folder` is where the
    shard was, as a path from the folder of the log.
    """

    origin: str
    folder: str
    shard_events: int
    shard_root: str
