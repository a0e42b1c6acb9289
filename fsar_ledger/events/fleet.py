"""Plans of runs, runs, robots and their membership (`eq:fleet`, `eq:runtime`)."""

from typing import Literal

from .envelope import ActionId, Event, Principal, Robot, Subject, Supervisor, TaskId

Departure = Literal["announced", "silent"]
IsolatedResult = Literal["success", "failure"]


class RunStarted(Event, frozen=True, kw_only=True, tag="RunStarted.v2"):
    """A run has begun: event 0 of the run, with everything that distinguishes it from other runs.

    A run is simulated, live (commands from outside, decided by our handlers) or foreign (recorded by another system,
    named by `source`). `observes` names the concerns, some of `CONCERNS`, of which its source records everything.
    `records` names what else it records: event types (`ExecutionStarted`), with what every event of the type has, and
    further fields (`ExecutionStarted.requested_by`). Events of any other type are not in the run, and their absence
    means nothing. `epoch` is the time in UTC (ISO 8601) of run time 0, None where there is none. Architecture,
    configuration and scenario (or workflow) are open text, checked before a run is simulated; None: the run has none.
    `parameters` is JSON, an object of groups of constants; a group that the run does not have is left out.

    A fork repeats the run `forked_from_run` of a ledger with the root `forked_from_root` (hex) up to the event
    `forked_from_seq`, and says in `changes` what is otherwise (`runtime/changes.py`). Its other fields are its own.
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
    """The run goes on where another one ended: event 1 of it, after an event 0 that is like that of the other.

    `continues` is the other run, `continues_seq` the number of its last event, and `continues_root` the root (hex) of
    the ledger that had it then. `state_sha256` is the digest of all that was known and pending, from which this run
    goes on (`runtime/snapshot.py`), and `state_shape` names the shape in which it was kept: in another one the digest
    of the same may be another. Times count on. What was pending and comes about here is caused by this event.
    """

    continues: str
    continues_seq: int
    continues_root: str
    state_sha256: str
    state_shape: str


class RobotJoined(Event, frozen=True, kw_only=True):
    """A robot has joined the fleet, under its own supervisor H_i if it has one. Paper: eq:fleet, eq:runtime.

    `domain` is the path of the registry in which the robot advertises (`hall/cell`); empty is the fleet's own. `place`
    is where it works (`floor/2`): only robots at one place meet or get in each other's way; None: the fleet has one
    place. `team` is None where its record has no teams. `public_key` is the key by which who knows the robot
    recognises it; the fleet compares it and checks no signature.
    """

    robot: Robot
    role: str
    team: int | None = None
    supervisor: Supervisor | None
    domain: str = ""
    place: str | None = None
    public_key: str | None = None


class HeartbeatReceived(Event, frozen=True):
    """The registry has heard that the robot is there; `number` counts its heartbeats from 1."""

    robot: Robot
    number: int


class RobotSuspected(Event, frozen=True):
    """No heartbeat of the robot has come in for so long that it may have left. Nothing is taken from it yet."""

    robot: Robot


class RobotCleared(Event, frozen=True):
    """A heartbeat of the suspected robot has come in: it is a member as before."""

    robot: Robot


class RobotDeparted(Event, frozen=True, kw_only=True):
    """The robot is no member from now on: it announced that it leaves, or was silent for too long after a suspicion.

    What it held and what was asked of it ends with this event, and its name stays its own. `fence` counts its
    departures: what it says or claims under a smaller number does not count any more, rightly declared or not.

    Paper: sec:discussion:heterogeneity.
    """

    robot: Robot
    reason: Departure
    fence: int
    decided_by: Principal | None


class RobotReturned(Event, frozen=True, kw_only=True):
    """The robot is a member again, under the name, the role and the key with which it joined, and with its trust.

    From now on it names `fence` in what it reports.
    """

    robot: Robot
    fence: int
    decided_by: Principal | None


class IsolationBegan(Event, frozen=True, kw_only=True):
    """Without the federation, the robot goes on with its own work alone: the first event after a founding at time 0.

    The founding states again, as the fleet's run `fleet_run` had it until its event `fleet_seq`, in a ledger of the
    root `fleet_root` (hex), what the robot is, has and may do, and its own tasks that wait for it. The fleet's run may
    go on beside this one. Times are those of the fleet's run. `fence` is the number under which the robot reports,
    None where it has never departed.
    """

    robot: Robot
    fleet_run: str
    fleet_seq: int
    fleet_root: str
    fence: int | None = None


class IsolationEnded(Event, frozen=True, kw_only=True):
    """The robot has handed over what it did by itself, in a run of its own, to the fleet.

    `isolated_run` is that run, `isolated_seq` the number of its last event, and `isolated_root` the root (hex) of its
    ledger. Units: `since_us` run time at which it began, as the robot says.
    """

    robot: Robot
    isolated_run: str
    isolated_seq: int
    isolated_root: str
    since_us: int


class IsolatedResultAccepted(Event, frozen=True, kw_only=True):
    """What the robot did by itself counts in the fleet: a success completes the step, a failure leaves it to be done.

    `isolated_run` is where it did so.
    """

    subject: Subject[TaskId, ActionId]
    robot: Robot
    result: IsolatedResult
    isolated_run: str


class IsolatedResultOvertaken(Event, frozen=True, kw_only=True):
    """What the robot did by itself does not count in the fleet, which has gone on otherwise meanwhile."""

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
    """The head of a shard was recorded: of another ledger, named by the `origin` under which it publishes its heads.

    A ledger of such heads is the log of a federation. Each is the only event of a run of its own; the newest head of an
    origin holds. It counts `shard_events` events under the root `shard_root`, in hex. `folder` is where the shard was,
    as a path from the folder of the log.
    """

    origin: str
    folder: str
    shard_events: int
    shard_root: str
