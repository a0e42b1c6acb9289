"""The schedule: everything the world does by itself, generated before the run, whatever happens in it.

It is a function of constants, seed, scenario, run and fleet size. Each robot's streams are its own, so
another draw in one stream moves no other.
"""

from functools import lru_cache
from itertools import combinations, groupby
from math import inf

from fsar_ledger.constants import END_US, Load, Outages, WorldConstants
from fsar_ledger.events import Event
from fsar_ledger.events.envelope import (
    PolicyOutcome,
    PolicyScope,
    Robot,
    Scenario,
    Workflow,
    local_supervisor,
    robot_named,
)
from fsar_ledger.events.world import (
    ActuatorDegraded,
    ContextChanged,
    LinkCameUp,
    LinkWentDown,
    ObstructionAppeared,
    ObstructionCleared,
    OutsiderRequestInjected,
    PeersMet,
    PolicyWindowClosed,
    PolicyWindowOpened,
    RobotCameBack,
    RobotWentOff,
    RoutineDue,
    SnapshotPhaseSet,
    SupervisorLeft,
    SupervisorReturned,
    SyncPhaseSet,
    TaskArrived,
)

from .draws import FOREVER_US, Stream, run_key
from .scenarios import DEGRADABLE, INJECTIONS, TASKS, floor_of, robots
from .workflows import workflow_facts

Fact = tuple[int, Event]  # run time in microseconds, what happens


@lru_cache(maxsize=4)
def schedule(
    world: WorldConstants,
    seed: int,
    scenario: Scenario | Workflow,
    run: int,
    fleet_size: int,
    outages: Outages | None = None,
    load: Load | None = None,
) -> tuple[Fact, ...]:
    """All facts of the run in order of time; no two at the same microsecond. A workflow has only those of its script."""
    key = run_key(seed, scenario, run)
    match scenario:
        case "workflow-door-relay" | "workflow-layered-recovery" | "workflow-human-supervision":
            return _apart(workflow_facts(world, key, scenario))
        case _:
            return _disturbed(world, key, scenario, fleet_size, outages, load or Load())


def arrivals_expected(
    world: WorldConstants, fleet_size: int, outages: Outages | None = None, load: Load | None = None
) -> float:
    """How many arrivals one may expect in a run with such rates: nearly all of its facts, but for some of each robot, task and window."""
    rates: tuple[float, ...] = (world.context_rate_per_s, world.fleet_rule_rate_per_s, world.obstruction_rate_per_s)
    if outages is not None:
        rates = (*rates, outages.off_rate_per_s, outages.link_rate_per_s, outages.loss_rate_per_s)
    one_robot = sum(_expected(_mean_s(rate), world.horizon_s) for rate in rates)
    pairs = crowd = 0.0
    for floors, robots_there in floor_sizes(world, fleet_size):
        pairs += floors * robots_there * (robots_there - 1) / 2
        crowd += (
            floors
            * robots_there
            * _expected(_mean_s(world.crowding_rate_per_s * max(0, robots_there - 4)), world.horizon_s)
        )
    routine = 4 * teams_working(fleet_size, load) * _expected(_mean_s(world.routine_rate_per_s), world.routine_until_s)
    return fleet_size * one_robot + routine + crowd + pairs * _expected(world.encounter_mean_s, world.horizon_s)


def floor_sizes(world: WorldConstants, fleet_size: int) -> tuple[tuple[int, int], ...]:
    """How many floors there are with how many robots."""
    most = 4 * max(1, world.floor_teams)
    full, left = divmod(fleet_size, most)
    return (full, most), (1, left)


def teams_working(fleet_size: int, load: Load | None) -> int:
    """How many teams have tasks, and routine."""
    teams = fleet_size // 4
    return teams if load is None or load.teams_working is None else min(teams, load.teams_working)


def _expected(mean_s: float, until_s: float) -> float:
    """How many instants `_arrivals` makes on average, which are a microsecond apart at least."""
    return max(0.0, until_s * 1e6) / max(1.0, mean_s * 1e6)


def _disturbed(
    world: WorldConstants, key: bytes, scenario: Scenario, fleet_size: int, outages: Outages | None, load: Load
) -> tuple[Fact, ...]:
    """The tasks of the scenario, in a world that disturbs them."""
    members = robots(fleet_size)
    facts: list[Fact] = [(1, SyncPhaseSet(round(Stream(key, "sync-phase").uniform() * 1e6)))]
    working = teams_working(fleet_size, load)
    for _, floor in groupby(members, lambda member: floor_of(member[2], world.floor_teams)):
        there = [(name, team) for name, _, team in floor]
        for name, team in there:
            facts.append((1, SnapshotPhaseSet(name, round(Stream(key, f"snapshot-phase/{name}").uniform() * 1e6))))
            facts += _contexts(world, key, name)
            facts += _fleet_rules(world, key, name)
            facts += _obstructions(world, key, name)
            facts += _crowding(world, key, name, sum(other != team for _, other in there))
            if team <= working:
                facts += _routine(world, key, name)
            facts += _absence(world, key, name)
            if outages is not None:
                facts += _outages(outages, key, name, world.horizon_s)
        for (one, _), (other, _) in combinations(there, 2):
            facts += _encounters(world, key, one, other)
    for team in range(1, working + 1):
        facts += _tasks(world, key, scenario, team, load)
    facts.sort(key=lambda fact: fact[0])
    return _apart(facts)


def _apart(facts: list[Fact]) -> tuple[Fact, ...]:
    """The facts, each at a microsecond of its own; what would be later than any run is none of its facts."""
    apart: list[Fact] = []
    last_us = 0
    for time_us, event in facts:
        last_us = max(time_us, last_us + 1)
        if last_us > END_US:
            break
        apart.append((last_us, event))
    return tuple(apart)


def _mean_s(rate_per_s: float) -> float:
    """The mean distance of what happens at this rate; infinite where it never happens."""
    return 1 / rate_per_s if rate_per_s else inf


def _arrivals(stream: Stream, mean_s: float, until_s: float) -> list[int]:
    """The instants of a Poisson process with this mean distance. Units: microseconds."""
    if mean_s == inf:
        return []
    instants, time_us, until_us = [], stream.exponential_us(mean_s), round(until_s * 1e6)
    while time_us < until_us:
        instants.append(time_us)
        time_us += stream.exponential_us(mean_s)
    return instants


def _window(
    world: WorldConstants, stream: Stream, robot: Robot, scope: PolicyScope, name: str, opened_us: int
) -> list[Fact]:
    outcome: PolicyOutcome = "review" if stream.uniform() < world.review_share else "deny"
    closed_us = opened_us + stream.exponential_us(world.window_mean_s)
    return [
        (opened_us, PolicyWindowOpened(robot=robot, scope=scope, window=name, outcome=outcome)),
        (closed_us, PolicyWindowClosed(robot, scope, name)),
    ]


def _contexts(world: WorldConstants, key: bytes, robot: Robot) -> list[Fact]:
    instants = _arrivals(Stream(key, f"context/{robot}"), _mean_s(world.context_rate_per_s), world.horizon_s)
    marks = Stream(key, f"context-window/{robot}")
    facts: list[Fact] = []
    for ordinal, time_us in enumerate(instants):
        if marks.uniform() < world.context_window_share:
            name = f"local/{robot[6:]}/{ordinal}"
            facts.append((time_us, ContextChanged(robot, name)))
            facts += _window(world, Stream(key, f"window/{name}"), robot, "local", name, time_us + 1)
        else:
            facts.append((time_us, ContextChanged(robot)))
    return facts


def _fleet_rules(world: WorldConstants, key: bytes, robot: Robot) -> list[Fact]:
    facts: list[Fact] = []
    for ordinal, time_us in enumerate(
        _arrivals(Stream(key, f"fleet-rule/{robot}"), _mean_s(world.fleet_rule_rate_per_s), world.horizon_s)
    ):
        name = f"fleet/{robot[6:]}/{ordinal}"
        facts += _window(world, Stream(key, f"window/{name}"), robot, "fleet", name, time_us)
    return facts


def _obstructions(world: WorldConstants, key: bytes, robot: Robot) -> list[Fact]:
    return _in_the_way(world, key, robot, "obstruction", world.obstruction_rate_per_s)


def _crowding(world: WorldConstants, key: bytes, robot: Robot, others: int) -> list[Fact]:
    """So many robots of other teams are on the floor, and each is in the way now and then; a team keeps out of its own way."""
    return _in_the_way(world, key, robot, "crowding", world.crowding_rate_per_s * others)


def _in_the_way(world: WorldConstants, key: bytes, robot: Robot, what: str, rate_per_s: float) -> list[Fact]:
    lengths = Stream(key, f"{what}-length/{robot}")
    facts: list[Fact] = []
    for ordinal, time_us in enumerate(_arrivals(Stream(key, f"{what}/{robot}"), _mean_s(rate_per_s), world.horizon_s)):
        name = f"{what}/{robot[6:]}/{ordinal}"
        facts.append((time_us, ObstructionAppeared(robot, name)))
        facts.append((time_us + lengths.exponential_us(world.obstruction_mean_s), ObstructionCleared(robot, name)))
    return facts


def _routine(world: WorldConstants, key: bytes, robot: Robot) -> list[Fact]:
    marks = Stream(key, f"routine-operation/{robot}")
    instants = _arrivals(Stream(key, f"routine/{robot}"), _mean_s(world.routine_rate_per_s), world.routine_until_s)
    return [
        (time_us, RoutineDue(robot, "motion" if marks.uniform() < world.motion_share else "sensing"))
        for time_us in instants
    ]


def _absence(world: WorldConstants, key: bytes, robot: Robot) -> list[Fact]:
    start_s = (
        world.absence_from_s + (world.absence_to_s - world.absence_from_s) * Stream(key, f"absence/{robot}").uniform()
    )
    left_us, returned_us = round(start_s * 1e6), round((start_s + world.absence_s) * 1e6)
    if returned_us <= 0:
        return []
    supervisor = local_supervisor(robot)
    return [(max(1, left_us), SupervisorLeft(supervisor)), (returned_us, SupervisorReturned(supervisor))]


def _outages(outages: Outages, key: bytes, robot: Robot, until_s: float) -> list[Fact]:
    off, back = (Stream(key, f"{name}/{robot}") for name in ("off", "off-length"))
    down, up = (Stream(key, f"{name}/{robot}") for name in ("link", "link-length"))
    from_us, lost = (
        round(outages.from_s * 1e6),
        _arrivals(Stream(key, f"loss/{robot}"), _mean_s(outages.loss_rate_per_s), until_s - outages.from_s),
    )
    return [
        *_spells(
            off,
            back,
            _mean_s(outages.off_rate_per_s),
            outages.off_mean_s,
            from_us,
            until_s,
            (RobotWentOff(robot), RobotCameBack(robot)),
        ),
        *_spells(
            down,
            up,
            _mean_s(outages.link_rate_per_s),
            outages.link_mean_s,
            from_us,
            until_s,
            (LinkWentDown(robot), LinkCameUp(robot)),
        ),
        *((from_us + after_us, ActuatorDegraded(robot, "lost")) for after_us in lost),
    ]


def _spells(
    before: Stream,
    lengths: Stream,
    before_s: float,
    length_s: float,
    from_us: int,
    until_s: float,
    edges: tuple[Event, Event],
) -> list[Fact]:
    """Spells of something that is there or not, exponential as are the times between them: both edges of each that begins in time."""
    facts: list[Fact] = []
    begins_us, until_us = from_us + before.exponential_us(before_s), round(until_s * 1e6)
    while begins_us < until_us:
        ends_us = begins_us + lengths.exponential_us(length_s)
        facts += [(begins_us, edges[0]), (ends_us, edges[1])]
        begins_us = ends_us + before.exponential_us(before_s)
    return facts


def _encounters(world: WorldConstants, key: bytes, one: Robot, other: Robot) -> list[Fact]:
    instants = _arrivals(Stream(key, f"encounter/{one}/{other}"), world.encounter_mean_s, world.horizon_s)
    return [(time_us, PeersMet(one, other)) for time_us in instants]


def _tasks(world: WorldConstants, key: bytes, scenario: Scenario, team: int, load: Load) -> list[Fact]:
    facts: list[Fact] = []
    start_us = Stream(key, f"start/{team}").within_us(world.start)
    sets = [
        (script, round((script.offset_s + load.interval_s * number) * 1e6))
        for number in range(load.task_sets)
        for script in TASKS[scenario]
    ]
    for ordinal, (script, offset_us) in enumerate(sets, start=1):
        task_id = f"{script.owner}{team}-{ordinal}"
        arrival_us = start_us + offset_us + Stream(key, f"jitter/{task_id}").within_us(world.jitter)
        delegated = sum(step.count(" ") == 2 for step in script.steps)
        budget_s = (
            world.budget_base_s
            + world.budget_delegated_s * delegated
            + world.budget_own_s * (len(script.steps) - delegated)
        )
        budget_us = round(min(budget_s * 1e6, FOREVER_US))
        facts.append(
            (
                arrival_us,
                TaskArrived(
                    task_id=task_id,
                    robot=robot_named(script.owner, team),
                    team=team,
                    steps=script.steps,
                    budget_us=budget_us,
                    due_us=arrival_us + budget_us,
                ),
            )
        )
    for injection in INJECTIONS.get(scenario, ()):
        for ordinal in range(1, injection.times + 1):
            name = f"injected-{team}-{ordinal}"
            time_us = Stream(key, f"injection/{name}").within_us(world.injection)
            requester, target = robot_named(injection.requester, team), robot_named(injection.target, team)
            facts.append(
                (
                    time_us,
                    OutsiderRequestInjected(
                        task_id=name, robot=requester, peer=target, capability=injection.capability
                    ),
                )
            )
    roles = DEGRADABLE.get(scenario, ())
    if roles:
        stream = Stream(key, f"degradation/{team}")
        happens, which, onset = stream.uniform() < world.degradation_probability, stream.uniform(), stream.uniform()
        if happens:
            robot = robot_named(roles[int(which * len(roles))], team)
            facts.append((max(1, round(onset * world.degradation_onset_s * 1e6)), ActuatorDegraded(robot)))
    return facts
