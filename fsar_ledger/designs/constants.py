"""All constants: how the world behaves, and how the architectures are built.

`WorldConstants` are laws of the world, the same for every architecture. `Structure` holds durations and counts that
are part of how an architecture is built. No constant is the probability or the count of an outcome (conflict,
violation, unattributed record, success, containment): outcomes must emerge.

The type of each constant says where its value comes from. `Paper`: printed in the paper. `Fitted`: fitted to the
paper's results table by `fsar-ledger study run calibration` (reports/calibration.json). `AfterFits`: ours, chosen or
kept while looking at the cells of that table, in the study before the first fit or since; most move a cell, and none is
a prediction. `Chosen`: ours, and no cell depends on it. `Dial`: of a published system (`dials.py`).
"""

from functools import lru_cache
from typing import Annotated, Any, TypeVar, get_args, get_origin, get_type_hints

import msgspec

from fsar_ledger.base.parameters import decode_parameters
from fsar_ledger.designs import Fleet, Scenario
from fsar_ledger.designs.dials import Alliance, Jade, Roboos

_T = TypeVar("_T")
Paper = Annotated[_T, msgspec.Meta(extra={"from": "paper"})]
Fitted = Annotated[_T, msgspec.Meta(extra={"from": "fitted"})]
AfterFits = Annotated[_T, msgspec.Meta(extra={"from": "chosen after fits"})]
Chosen = Annotated[_T, msgspec.Meta(extra={"from": "chosen"})]

END_US = 1_800_000_000  # run time after which no fact of the world happens and no task is open
SIGNED = ("world.absence_from_s", "world.absence_to_s")
"""The constants that may be negative: an absence may begin before the run."""
LEAST = {
    "world.encounter_mean_s": 0.001,
    "structure.poll_us": 1_000,
    "structure.sync_period_us": 1_000,
    "structure.snapshot_period_us": 1_000,
    "alliance.broadcast_us": 1_000,
    "roboos.refresh_us": 1_000,
}
"""The shortest time between two repetitions of an event, a millisecond: with less a run hardly ever ends."""
NEVER_AT_0 = ("alliance.broadcast_us",)
"""The constants of `LEAST` that may be 0 nevertheless: the event does not happen then."""
MOST_PER_S = 100
"""The highest rate, some hundreds of times the highest default: with more a run hardly ever ends."""
MOST = {"world.horizon_s": 100_000, "world.routine_until_s": 100_000, "structure.watch_us": END_US}
"""The latest time at which the world acts and periodic exchanges go on: facts after `END_US` have no effect."""


class Range(msgspec.Struct, frozen=True):
    """A uniform distribution of a duration. Units: seconds."""

    low_s: float
    high_s: float


DURATIONS: tuple[tuple[str, Range], ...] = (  # uniform, seconds
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
PRINTED_DURATIONS = ("carry.package", "door.open.basic", "door.open.secure")
"""The durations that the paper prints; the others were chosen after fits."""


class WorldConstants(msgspec.Struct, frozen=True):
    """Laws of the world. Rates are per robot and second of run time."""

    context_rate_per_s: Fitted[float] = 0.024  # context changes, Poisson
    context_window_share: Fitted[float] = 0.428  # share of them that closes the robot's own policy for a while
    window_mean_s: Fitted[float] = 2.63  # length of policy windows, exponential
    review_share: Fitted[float] = 0.0951  # share of windows that ask for review instead of denying
    fleet_rule_rate_per_s: Fitted[float] = 0.0326  # fleet rules on the robot's zone, Poisson
    obstruction_rate_per_s: Fitted[float] = 0.012  # obstructions in the robot's way, Poisson
    obstruction_mean_s: Fitted[float] = 2.35  # length of obstructions, exponential
    routine_rate_per_s: Fitted[float] = 0.222  # routine operations, Poisson
    routine_until_s: AfterFits[float] = 100.0  # routine operations fall due until then
    motion_share: Fitted[float] = 0.276  # share of routine operations that move the robot; the rest is sensing
    absence_s: AfterFits[float] = 30.0  # length of the local supervisor's one absence: half a minute
    absence_from_s: AfterFits[float] = -50.0  # its start, uniform
    absence_to_s: AfterFits[float] = 150.0
    degradation_probability: Paper[float] = 0.3  # per run, in scenarios with failure injection
    degradation_onset_s: AfterFits[float] = 10.0  # onset uniform from 0
    degraded_reliability: Paper[float] = 0.6  # success of an attempt with a degraded actuator
    encounter_mean_s: AfterFits[float] = 90.0  # time between encounters of a pair of robots, exponential
    floor_teams: Chosen[int] = 4  # teams that share a floor; robots of different floors never meet
    # How often each robot of another team on the same floor is in a robot's way. Two robots come within about 10 m of
    # each other every `encounter_mean_s`, and in 7 % of those encounters within the 0.7 m that a passing robot keeps
    # free beside it. It lasts as long as any obstruction.
    crowding_rate_per_s: Chosen[float] = 0.0008
    durations: AfterFits[tuple[tuple[str, Range], ...]] = DURATIONS
    message: Paper[Range] = Range(0.05, 0.5)  # latency of a message between principals
    approach: AfterFits[Range] = Range(3.0, 8.0)  # a delegated executor's way to the place of the action
    retry: AfterFits[Range] = Range(1.3, 2.1)  # length of one attempt to recover
    response: AfterFits[Range] = Range(20.0, 60.0)  # response time of the fleet supervisor
    start: AfterFits[Range] = Range(0.0, 20.0)  # start of the scenario within the run
    jitter: AfterFits[Range] = Range(0.0, 3.0)  # arrival of a task around its offset
    injection: AfterFits[Range] = Range(5.0, 45.0)  # time of an injected out-of-trust request
    budget_base_s: Fitted[float] = 22.2  # task budget: base, per delegated step, per own step
    budget_delegated_s: AfterFits[float] = 14.0
    budget_own_s: AfterFits[float] = 6.0
    horizon_s: AfterFits[float] = 240.0  # the schedule ends here


class Structure(msgspec.Struct, frozen=True):
    """How the architectures are built. Units: microseconds unless the name says otherwise."""

    # every architecture
    assistance_us: AfterFits[int] = 5_000_000  # a helper is held this long
    injected_execution_us: AfterFits[int] = 3_000_000  # an injected request that runs takes this long
    expiry_budgets: AfterFits[int] = 2  # a task is given up after this many budgets
    watch_us: AfterFits[int] = 100_000_000  # periodic exchanges go on at least this long, and while a task is open
    # FSAR
    back_off_us: AfterFits[int] = 7_000_000  # wait after a denial or an empty answer (DHMA too)
    poll_us: AfterFits[int] = 1_000_000  # an own step that the fleet's rule holds asks again after this
    replan_us: AfterFits[int] = 1_000_000  # replanning after a context change (the last part of it in CFC and DHMA)
    retry_preparation_us: AfterFits[int] = 400_000  # diagnosis before each attempt to recover (DHMA too)
    local_attempts: Paper[int] = 2  # recovery budget of the local level: attempts (DHMA too; CFC one at most)
    local_budget_us: Paper[int] = 30_000_000  # recovery budget of the local level: time
    negotiation_rounds: Chosen[int] = 3  # counter-offers in one negotiation; the executor then denies
    peer_budget_us: Chosen[int] = 30_000_000  # of the peer level: time from turning to the peers until one is asked
    peer_helpers: AfterFits[int] = 1  # and helpers asked: one that agrees is occupied until the failure is over
    fleet_budget_us: Chosen[int] = 30_000_000  # of the fleet level: time until the orchestrator has decided
    fleet_reassignments: AfterFits[int] = 1  # and reassignments: after one it is another robot's execution
    human_budget_us: Chosen[int] = 120_000_000  # of the human level: time a call stays open, twice the longest response
    human_calls: Chosen[int] = 2  # and calls: an H_i who does not answer, then H_F (CFC and DHMA: H_F, once)
    encounter_memory_us: AfterFits[int] = 60_000_000  # without a registry, a met peer is known this long
    # CFC
    sync_period_us: Fitted[int] = 2_240_000  # the coordinator's copies are refreshed this often
    service_us: Fitted[int] = 242_000  # the coordinator's time per item of work, for four robots
    candidate_cost_ppm: AfterFits[int] = 170_000  # plus this share of it for each candidate
    ordering_response_ppm: AfterFits[int] = 400_000  # ordering two commands takes H_F this share of a response
    # DHMA
    hop_ppm: Fitted[int] = 302_000  # an internal hop takes this share of a message latency
    snapshot_period_us: Fitted[int] = 7_140_000  # planners refresh their snapshot of policy this often
    engagement_us: Fitted[int] = 4_790_000  # the planner is occupied this long by a motion or a context change
    dispute_timeout_us: Fitted[int] = 9_610_000  # a disputed recovery that failed gives up after this
    renegotiation_us: Fitted[int] = 355_000  # of a replanned delegated action: the other robot evaluates it again


class Outages(msgspec.Struct, frozen=True):
    """Outages of robots and their links, alike under every architecture.

    Rates are per robot and second in which it is on, or linked. The paper injects none of these, so the group is absent
    by default and no published number rests on it.
    """

    off_rate_per_s: Chosen[float] = 0.0  # robots that go off, exponential time until then
    off_mean_s: Chosen[float] = 30.0  # how long they are off, exponential
    link_rate_per_s: Chosen[float] = 0.0  # links that go down, exponential time until then
    link_mean_s: Chosen[float] = 10.0  # how long they are down, exponential
    loss_rate_per_s: Chosen[float] = 0.0  # actuators that are lost until they are serviced, Poisson
    from_s: Chosen[float] = 0.0  # none of these happens before then
    # A message that is not delivered within this time counts as unanswered: ten times the longest latency. It also
    # applies without the group.
    answer_s: Chosen[float] = 5.0


class Membership(msgspec.Struct, frozen=True):
    """Robots that leave the fleet and come back, and how the fleet finds out. Without this group no robot leaves.

    In the world a robot is called away, or goes, at a rate per second of presence; some report that they leave.
    The paper has no such run: no published number rests on it.
    """

    away_rate_per_s: Chosen[float] = 0.0  # robots that leave, exponential time until then
    away_mean_s: Chosen[float] = 120.0  # how long they are away, exponential
    announced_share: Chosen[float] = 0.5  # of them are called away and can report it, the others just go
    notice_s: Chosen[float] = 2.0  # from the call until the robot is off: four times the longest latency
    # How FSAR finds out. A robot is monitored from its first heartbeat on.
    heartbeat_us: Chosen[int] = 0  # a robot tells the registry this often that it is there; 0: never, none is monitored
    suspect_us: Chosen[int] = 15_000_000  # it is suspected this long after its last heartbeat
    depart_us: Chosen[int] = 30_000_000  # and has departed this long after it was suspected


class Load(msgspec.Struct, frozen=True):
    """The amount of work. Without this group every team has the tasks of its scenario, once."""

    teams_working: Chosen[int | None] = None  # teams 1 to this have tasks and routine, the others stand by; None: all
    task_sets: Chosen[int] = 1  # how many times each of them gets the tasks of the scenario
    interval_s: Chosen[float] = 30.0  # from one set to the next


# See docs/decisions/constants-name-their-source.md.
class Constants(msgspec.Struct, frozen=True):
    """All constants of a run, as `RunStarted.parameters` holds them.

    Groups that a later release adds are optional: `GROUP: Group | None = None`. An absent group is left out of the
    parameters, so runs without it keep their parameters, their ids and their roots.

    `scenario` and `fleet` are a designer's own: no file of the package holds them, so the run itself does.
    """

    world: WorldConstants = WorldConstants()
    structure: Structure = Structure()
    outages: Outages | None = None
    load: Load | None = None
    jade: Jade | None = None
    alliance: Alliance | None = None
    roboos: Roboos | None = None
    scenario: Scenario | None = None
    fleet: Fleet | None = None
    membership: Membership | None = None

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how a worker gets the constants: as text, in which what a design leaves out stays left out.

        msgspec leaves a default out by its identity, which a number loses on its way to another process.
        """
        return decode_parameters, (_as_json(self), type(self))


DESIGNS = ("scenario", "fleet")
"""The groups that are a designer's own and hold no constants."""


def with_all_groups(constants: Constants) -> Constants:
    """Return the constants with every optional group, at its defaults where it is absent."""
    absent = {name: kind() for name, kind in _groups().items() if getattr(constants, name) is None}
    return msgspec.structs.replace(constants, **absent)


def write_constants(constants: Constants) -> str:
    """Return the constants as `RunStarted.parameters` holds them: JSON in field order, without absent groups.

    Equal constants give equal text, whether a caller wrote 240 or 240.0, 0.0 or -0.0; what the file of a design writes
    out stays written out, also where it is the default.

    Raises:
        BadParameters: A value cannot be written as JSON, such as infinity, or is too long.
    """
    return _written(_as_json(constants), type(constants))


@lru_cache(maxsize=8)
def _written(given: str, kind: type[Constants]) -> str:
    valid = decode_parameters(given, kind)
    text = _as_json(valid)
    return (
        _as_json(msgspec.convert(_unsigned_zeros(msgspec.to_builtins(valid)), type(valid))) if "-0.0" in text else text
    )


def _unsigned_zeros(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _unsigned_zeros(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_unsigned_zeros(item) for item in value]
    return 0.0 if isinstance(value, float) and not value else value


def _as_json(constants: Constants) -> str:
    groups = {name: group for name in constants.__struct_fields__ if (group := getattr(constants, name)) is not None}
    return msgspec.json.encode(groups).decode()


def negatives(constants: Constants) -> list[str]:
    """Return the name and value of each constant that is negative or not a number, which only `SIGNED` may be."""
    return _negatives("", msgspec.to_builtins(constants))


def _negatives(name: str, value: Any) -> list[str]:
    if isinstance(value, dict):
        return [found for part, item in value.items() for found in _negatives(f"{name}.{part}" if name else part, item)]
    if isinstance(value, list | tuple):
        return [found for item in value for found in _negatives(name, item)]
    is_negative = isinstance(value, int | float) and not value >= 0 and name not in SIGNED
    return [f"{name} {value}"] if is_negative else []


def read_constants(parameters: str) -> Constants:
    """Parse the constants that a run of this model records. Raises: BadParameters."""
    return decode_parameters(parameters, Constants)


WORDS = {
    "paper": "printed in the paper",
    "fitted": "fitted to the paper's results table; the record of the fit is `reports/calibration.json`",
    "chosen after fits": "ours, and chosen or kept while the cells of that table were looked at, in the study before "
    "the first fit or since; "
    "most move a cell, and none is a prediction",
    "chosen": "ours, and none of the 24 cells depends on it",
    "dial": "left open, or given, by the sources of a published system; nothing is fitted",
}
"""The meaning of each word."""


def origins() -> dict[str, str]:
    """Return the word for each constant by dotted name, in the order of the file.

    "" if its type gives no word, or more than one.
    """
    words: dict[str, str] = {}
    for group, kind in _groups().items():
        for name, hint in _hints(kind).items():
            words |= _split(f"{group}.{name}", _word(hint))
    return words


def _groups() -> dict[str, type[msgspec.Struct]]:
    """Return the type of each group of constants."""
    hints = {name: hint for name, hint in _hints(Constants).items() if name not in DESIGNS}
    return {
        name: next(arg for arg in (hint, *get_args(hint)) if isinstance(arg, type) and issubclass(arg, msgspec.Struct))
        for name, hint in hints.items()
    }


def _hints(kind: type[msgspec.Struct]) -> dict[str, Any]:
    return get_type_hints(kind, include_extras=True)


def _word(hint: Any) -> str:
    if get_origin(hint) is not Annotated:
        return ""
    words = [meta.extra["from"] for meta in hint.__metadata__ if isinstance(meta, msgspec.Meta) and meta.extra]
    return words[0] if len(words) == 1 else ""


def _split(name: str, word: str) -> dict[str, str]:
    """Return the words of durations: one constant per capability, some of them the paper's."""
    if name != "world.durations":
        return {name: word}
    return {f"{name}.{capability}": "paper" if capability in PRINTED_DURATIONS else word for capability, _ in DURATIONS}
