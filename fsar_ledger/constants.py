"""The one file of constants: what the world is like, and what the architectures are built like.

`WorldConstants` are laws of the world, the same for every architecture. `Structure` holds lengths of time
and counts that belong to how an architecture is built. No constant is the probability or the count of an
outcome (conflict, violation, unattributed record, success, containment): those must come about.

Marks: [paper] printed in the paper; [calibrated] fitted to the paper's results table by
`fsar-ledger calibrate` (record: reports/calibration.json); [chosen] ours, not fitted.
"""

from typing import Any, TypeVar

import msgspec

_T = TypeVar("_T")
END_US = 1_800_000_000  # run time: no fact of the world is later, and no task is open longer [chosen]
MAX_LEVELS = 16
"""Of nesting in recorded parameters; those of this model take five."""


class Range(msgspec.Struct, frozen=True):
    """A uniform law between two lengths of time. Units: seconds."""

    low_s: float
    high_s: float


DURATIONS: tuple[tuple[str, Range], ...] = (  # uniform, seconds; doors and carry.package [paper], others [chosen]
    ("navigate.indoor", Range(2.0, 6.0)),
    ("carry.package", Range(1.0, 5.0)),
    ("handover.dropoff", Range(1.0, 3.0)),
    ("door.open.basic", Range(0.5, 2.0)),
    ("door.open.secure", Range(0.5, 2.0)),
    ("inspect.visual", Range(2.0, 6.0)),
    ("inspect.private_zone", Range(2.0, 6.0)),
    ("carry.heavy", Range(2.0, 7.0)),
    ("grasp.robust", Range(1.0, 4.0)),
)


class WorldConstants(msgspec.Struct, frozen=True):
    """Laws of the world. Rates are per robot and second of run time."""

    context_rate_per_s: float = 0.0229  # context changes, Poisson [calibrated]
    context_window_share: float = 0.349  # share of them that closes the robot's own policy for a while [calibrated]
    window_mean_s: float = 11.3  # length of policy windows, exponential [calibrated]
    review_share: float = 0.0623  # share of windows that ask for review instead of denying [calibrated]
    fleet_rule_rate_per_s: float = 0.00674  # fleet rules on the robot's zone, Poisson [calibrated]
    obstruction_rate_per_s: float = 0.0145  # obstructions in the robot's way, Poisson [calibrated]
    obstruction_mean_s: float = 2.55  # length of obstructions, exponential [calibrated]
    routine_rate_per_s: float = 0.22  # routine operations, Poisson [calibrated]
    routine_until_s: float = 100.0  # routine operations fall due until then [chosen]
    motion_share: float = 0.247  # share of routine operations that move the robot; the rest is sensing [calibrated]
    absence_s: float = 5.12  # length of the local supervisor's one absence [calibrated]
    absence_from_s: float = -50.0  # its start, uniform [chosen]
    absence_to_s: float = 150.0
    degradation_probability: float = 0.3  # per run, in scenarios with failure injection [paper]
    degradation_onset_s: float = 10.0  # onset uniform from 0 [chosen]
    degraded_reliability: float = 0.6  # success of an attempt with a degraded actuator [paper]
    encounter_mean_s: float = 90.0  # time between encounters of a pair of robots, exponential [chosen]
    floor_teams: int = 4  # teams that share a floor; a larger fleet spreads over floors, and robots of different floors never meet [chosen]
    # Each robot of another team on its floor is in a robot's way this often: they come within some 10 m of each other every `encounter_mean_s`,
    # and within the 0.7 m that a passing robot keeps free beside itself in 7 % of those encounters. It lasts as any obstruction does. [chosen]
    crowding_rate_per_s: float = 0.0008
    durations: tuple[tuple[str, Range], ...] = DURATIONS
    message: Range = Range(0.05, 0.5)  # latency of a message between principals [paper]
    approach: Range = Range(3.0, 8.0)  # a delegated executor first moves to the place [chosen]
    retry: Range = Range(1.3, 2.1)  # length of one attempt to recover [chosen]
    response: Range = Range(20.0, 60.0)  # time in which the fleet supervisor responds [chosen]
    start: Range = Range(0.0, 20.0)  # start of the scenario within the run [chosen]
    jitter: Range = Range(0.0, 3.0)  # arrival of a task around its offset [chosen]
    injection: Range = Range(5.0, 45.0)  # time of an injected out-of-trust request [chosen]
    budget_base_s: float = 41.2  # task budget: base, per delegated step, per own step; the base is [calibrated]
    budget_delegated_s: float = 14.0
    budget_own_s: float = 6.0
    horizon_s: float = 240.0  # the schedule ends here [chosen]


class Structure(msgspec.Struct, frozen=True):
    """How the architectures are built. Units: microseconds unless the name says otherwise."""

    # every architecture
    assistance_us: int = 5_000_000  # a helper is held this long
    injected_execution_us: int = 3_000_000  # an injected request that runs takes this long
    expiry_budgets: int = 2  # a task is given up after this many budgets
    watch_us: int = 100_000_000  # periodic exchanges go on at least this long, and while a task is open
    # FSAR
    back_off_us: int = 7_000_000  # wait after a denial or an empty answer (DHMA too)
    poll_us: int = 1_000_000  # an own step that the fleet's rule holds asks again after this
    replan_us: int = 1_000_000  # replanning after a context change (the last part of it in CFC and DHMA)
    retry_preparation_us: int = 400_000  # diagnosis before each attempt to recover (DHMA too)
    local_attempts: int = 2  # recovery budget of the local level: attempts [paper] (DHMA too)
    local_budget_us: int = 30_000_000  # recovery budget of the local level: time [paper]
    negotiation_rounds: int = 3  # counter-offers in one negotiation; the executor then denies [chosen]
    peer_budget_us: int = 30_000_000  # recovery budget of the peer level: time from turning to the peers until one of them has been asked [chosen]
    peer_helpers: int = 1  # and helpers asked: whoever agrees is held until the failure is over [chosen]
    fleet_budget_us: int = 30_000_000  # recovery budget of the fleet level: time until the orchestrator has decided [chosen]
    fleet_reassignments: int = 1  # and reassignments: after one it is another robot's execution [chosen]
    human_budget_us: int = 120_000_000  # recovery budget of the human level: time a call may stay open, twice the longest response [chosen]
    human_calls: int = 2  # and calls: an H_i who does not answer, then H_F [chosen]
    encounter_memory_us: int = 60_000_000  # without a registry, a met peer is known this long
    # CFC
    sync_period_us: int = 5_850_000  # the coordinator's copies are refreshed this often [calibrated]
    service_us: int = 109_000  # the coordinator's time per item of work, for four robots [calibrated]
    candidate_cost_ppm: int = 170_000  # and this share of it more for each candidate
    ordering_response_ppm: int = 400_000  # ordering two commands takes H_F this share of a response
    # DHMA
    hop_ppm: int = 688_000  # an internal hop takes this share of a message latency [calibrated]
    snapshot_period_us: int = 12_900_000  # planners refresh their snapshot of policy this often [calibrated]
    engagement_us: int = 2_770_000  # the planner attends this long to a motion or a context change [calibrated]
    dispute_timeout_us: int = 12_300_000  # a disputed recovery that failed gives up after this [calibrated]
    renegotiation_us: int = 4_530_000  # replanning a delegated action takes this much more [calibrated]


class Outages(msgspec.Struct, frozen=True):
    """What else may happen to robots and their links, whoever governs them. Rates are per robot and second in which it is on, or linked; all are [chosen].

    The paper injects none of these, so the group is absent by default, and no published number rests on it.
    """

    off_rate_per_s: float = 0.0  # robots that go off, exponential time until then
    off_mean_s: float = 30.0  # how long they are off, exponential
    link_rate_per_s: float = 0.0  # links that go down, exponential time until then
    link_mean_s: float = 10.0  # how long they are down, exponential
    loss_rate_per_s: float = 0.0  # actuators that are lost until they are serviced, Poisson
    from_s: float = 0.0  # none of these before then


class Load(msgspec.Struct, frozen=True):
    """How much there is to do. Without it every team has the tasks of its scenario, once."""

    teams_working: int | None = None  # teams 1 to this have tasks and routine; the others stand by and can be asked; None: all
    task_sets: int = 1  # how often each of them gets the tasks of the scenario
    interval_s: float = 30.0  # from one set to the next [chosen]


class Constants(msgspec.Struct, frozen=True):
    """All constants of a run, as `RunStarted.parameters` holds them.

    Groups that a later release adds are optional: `GROUP: Group | None = None`. An absent group is left out of the parameters,
    so runs without it keep their parameters, their ids and their roots.
    """

    world: WorldConstants = WorldConstants()
    structure: Structure = Structure()
    outages: Outages | None = None
    load: Load | None = None


def write_constants(constants: Constants) -> str:
    """Return the constants as `RunStarted.parameters` holds them: JSON in the order of the fields, without absent groups.

    Raises:
        BadParameters: JSON has no word for one of them, as for a length without end; a very long one does as well.
    """
    groups = {name: group for name in constants.__struct_fields__ if (group := getattr(constants, name)) is not None}
    text = msgspec.json.encode(groups).decode()
    read_constants(text)
    return text


class BadParameters(ValueError):
    """The text is not what a run records as its parameters; the message says what was found and expected."""


def read_constants(parameters: str) -> Constants:
    """The constants that a run of this model records. Raises: BadParameters."""
    return _decoded(parameters, Constants)


def read_parameters(parameters: str) -> dict[str, Any]:
    """What a run of any model, also of a foreign one, records as its parameters: names and values, in few levels. Raises: BadParameters."""
    found: dict[str, Any] = _decoded(parameters, dict[str, Any])
    level: list[Any] = [found]
    for _ in range(MAX_LEVELS):
        values = [value for one in level for value in (one.values() if isinstance(one, dict) else one)]
        if any(isinstance(value, int) and not -(2**63) <= value < 2**63 for value in values):
            raise _bad(parameters, "an integer beyond 64 bits")
        level = [value for value in values if isinstance(value, dict | list)]
        if not level:
            return found
    raise _bad(parameters, f"more than {MAX_LEVELS} levels")


def _decoded(parameters: str, kind: type[_T]) -> _T:
    try:
        return msgspec.json.decode(parameters, type=kind)
    except (msgspec.MsgspecError, RecursionError, ValueError) as error:  # nested without end, a number of thousands of digits
        raise _bad(parameters, str(error)) from error


def _bad(parameters: str, why: str) -> BadParameters:
    return BadParameters(f"found {parameters!r:.80}, expected constants as a JSON object ({why:.200})")
