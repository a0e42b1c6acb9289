"""The schedule: everything the world does by itself, generated before the run and independent of it.

It is a function of constants, seed, scenario, run and fleet size; a designer's own scenario and fleet are among the
constants. Each robot has its own streams, so an extra draw in one stream shifts no other.
"""

from collections.abc import Iterable, Sequence
from functools import lru_cache
from itertools import combinations, groupby
from math import inf

from fsar_ledger.designs import Scenario, Task, Workflow, registered
from fsar_ledger.designs.constants import END_US, Constants, Load, Membership, Outages, WorldConstants
from fsar_ledger.events import Event
from fsar_ledger.events.envelope import PolicyOutcome, PolicyScope, Robot, Supervisor, robot_named
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
    RobotCalledAway,
    RobotCameBack,
    RobotWentOff,
    RoutineDue,
    SnapshotPhaseSet,
    SupervisorLeft,
    SupervisorReturned,
    SyncPhaseSet,
    TaskArrived,
)
from fsar_ledger.runtime.handlers.public import given_in_file
from fsar_ledger.runtime.ports import Fact

from . import FOREVER_US, Member, Stream, floor_of, members, run_key, team_size


def happening(constants: Constants, name: str) -> Scenario | Workflow:
    """Return the scenario or workflow of this name: the designer's own, or a registered one."""
    if constants.scenario is not None:
        return constants.scenario
    return registered.workflow(name) if name in registered.workflows() else registered.scenario(name)


@lru_cache(maxsize=4)
def schedule(constants: Constants, seed: int, scenario: str, run: int, fleet_size: int) -> tuple[Fact, ...]:
    """Return all facts of the run in order of time, no two at the same microsecond."""
    key, design = run_key(seed, scenario, run), happening(constants, scenario)
    if isinstance(design, Workflow):
        return apart(workflow_facts(constants.world, key, design))
    return _disturbed(constants, key, design, fleet_size)


def arrivals_expected(constants: Constants, fleet_size: int) -> float:
    """Return the mean number of arrivals in a run with these rates.

    They make up nearly all of its facts, except for a few of each robot, task and window.
    """
    world, outages = constants.world, constants.outages
    rates: tuple[float, ...] = (world.context_rate_per_s, world.fleet_rule_rate_per_s, world.obstruction_rate_per_s)
    if outages is not None:
        rates = (*rates, outages.off_rate_per_s, outages.link_rate_per_s, outages.loss_rate_per_s)
    if constants.membership is not None:
        rates = (*rates, constants.membership.away_rate_per_s)
    one_robot = sum(_expected(_mean_s(rate), world.horizon_s) for rate in rates)
    pairs = crowd = 0.0
    of_team = team_size(constants.fleet)
    for floors, robots_there in floor_sizes(world, fleet_size, of_team):
        pairs += floors * robots_there * (robots_there - 1) / 2
        crowd += (
            floors
            * robots_there
            * _expected(_mean_s(world.crowding_rate_per_s * max(0, robots_there - of_team)), world.horizon_s)
        )
    busy = of_team * teams_working(constants, fleet_size)
    routine = busy * _expected(_mean_s(world.routine_rate_per_s), world.routine_until_s)
    return fleet_size * one_robot + routine + crowd + pairs * _expected(world.encounter_mean_s, world.horizon_s)


def floor_sizes(world: WorldConstants, fleet_size: int, of_team: int) -> tuple[tuple[int, int], ...]:
    """Return pairs of a number of floors and the number of robots on each."""
    most = of_team * max(1, world.floor_teams)
    full, left = divmod(fleet_size, most)
    return (full, most), (1, left)


def teams_working(constants: Constants, fleet_size: int) -> int:
    """Return how many teams have tasks and routine."""
    teams, load = fleet_size // team_size(constants.fleet), constants.load
    return teams if load is None or load.teams_working is None else min(teams, load.teams_working)


def _expected(mean_s: float, until_s: float) -> float:
    """Return the mean number of instants of `_arrivals`, which are at least a microsecond apart."""
    return max(0.0, until_s * 1e6) / max(1.0, mean_s * 1e6)


def _disturbed(constants: Constants, key: bytes, scenario: Scenario, fleet_size: int) -> tuple[Fact, ...]:
    """Return the tasks of the scenario and the disturbances of the world."""
    world, outages = constants.world, constants.outages
    everyone = members(fleet_size, constants.fleet)
    supervised = _supervised(everyone)
    facts: list[Fact] = [(1, SyncPhaseSet(round(Stream(key, "sync-phase").uniform() * 1e6)))]
    working = teams_working(constants, fleet_size)
    for _, floor in groupby(everyone, lambda member: floor_of(member.team, world.floor_teams)):
        on_floor = list(floor)
        for member in on_floor:
            name, team, _ = member
            facts.append((1, SnapshotPhaseSet(name, round(Stream(key, f"snapshot-phase/{name}").uniform() * 1e6))))
            facts += _contexts(world, key, name)
            facts += _fleet_rules(world, key, name)
            facts += _in_the_way(world, key, name, "obstruction", world.obstruction_rate_per_s)
            # See docs/decisions/fleets-share-a-floor.md.
            others = sum(other.team != team for other in on_floor)  # one team keeps out of its own way
            facts += _in_the_way(world, key, name, "crowding", world.crowding_rate_per_s * others)
            if team <= working:
                facts += _routine(world, key, name)
            if member.supervisor is not None and member == supervised[member.supervisor][0]:
                facts += _absences(constants, key, member.supervisor, supervised[member.supervisor])
            if outages is not None:
                facts += _outages(outages, key, name, world.horizon_s)
            if constants.membership is not None:
                facts += _departures(constants.membership, key, name, world.horizon_s)
        for one, other in combinations(on_floor, 2):
            meetings = Stream(key, f"encounter/{one.name}/{other.name}")
            instants = _arrivals(meetings, world.encounter_mean_s, world.horizon_s)
            facts += [(time_us, PeersMet(one.name, other.name)) for time_us in instants]
    for team in range(1, working + 1):
        facts += _tasks(world, key, scenario, team, constants.load or Load())
    facts += [
        (max(1, round(command.at_s * 1e6)), given_in_file(command.command, command.by, command.parameters))
        for command in scenario.commands
    ]
    facts.sort(key=lambda fact: fact[0])
    return apart(facts)


def apart(facts: Iterable[Fact], end_us: int = END_US) -> tuple[Fact, ...]:
    """Move the facts, in order of time, so that no two share a microsecond, and drop those after `end_us`."""
    spaced: list[Fact] = []
    last_us = 0
    for time_us, event in facts:
        last_us = max(time_us, last_us + 1)
        if last_us > end_us:
            break
        spaced.append((last_us, event))
    return tuple(spaced)


def _mean_s(rate_per_s: float) -> float:
    """Return the mean time between arrivals at this rate; infinite for a rate of 0."""
    return 1 / rate_per_s if rate_per_s else inf


def _arrivals(stream: Stream, mean_s: float, until_s: float) -> list[int]:
    """Return the instants of a Poisson process with this mean time between them. Units: microseconds."""
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
    draws = Stream(key, f"context-window/{robot}")
    facts: list[Fact] = []
    for ordinal, time_us in enumerate(instants):
        if draws.uniform() < world.context_window_share:
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


def _in_the_way(world: WorldConstants, key: bytes, robot: Robot, kind: str, rate_per_s: float) -> list[Fact]:
    lengths = Stream(key, f"{kind}-length/{robot}")
    facts: list[Fact] = []
    for ordinal, time_us in enumerate(_arrivals(Stream(key, f"{kind}/{robot}"), _mean_s(rate_per_s), world.horizon_s)):
        name = f"{kind}/{robot[6:]}/{ordinal}"
        facts.append((time_us, ObstructionAppeared(robot, name)))
        facts.append((time_us + lengths.exponential_us(world.obstruction_mean_s), ObstructionCleared(robot, name)))
    return facts


def _routine(world: WorldConstants, key: bytes, robot: Robot) -> list[Fact]:
    draws = Stream(key, f"routine-operation/{robot}")
    instants = _arrivals(Stream(key, f"routine/{robot}"), _mean_s(world.routine_rate_per_s), world.routine_until_s)
    return [
        (time_us, RoutineDue(robot, "motion" if draws.uniform() < world.motion_share else "sensing"))
        for time_us in instants
    ]


def _absences(constants: Constants, key: bytes, supervisor: Supervisor, robots: Sequence[Member]) -> list[Fact]:
    """Return the spells in which the supervisor of these robots is absent, none overlapping.

    They are one drawn absence, keyed by the first robot, and the off-shift spells of the fleet's design.
    """
    world, fleet = constants.world, constants.fleet
    start_s = (
        world.absence_from_s
        + (world.absence_to_s - world.absence_from_s) * Stream(key, f"absence/{robots[0].name}").uniform()
    )
    left_us, returned_us = round(start_s * 1e6), round((start_s + world.absence_s) * 1e6)
    spells = [] if returned_us <= 0 else [(max(1, left_us), returned_us)]
    if fleet is not None:
        spells += [
            (max(1, round(shift.from_s * 1e6)), END_US + 1 if shift.to_s is None else round(shift.to_s * 1e6))
            for shift in fleet.off_shift
            if any(fleet.is_off_shift(shift, member.design) for member in robots)
        ]
    facts: list[Fact] = []
    for left_us, returned_us in _merged(spells):
        facts += [(left_us, SupervisorLeft(supervisor)), (returned_us, SupervisorReturned(supervisor))]
    return facts


def _supervised(robots: Sequence[Member]) -> dict[Supervisor, list[Member]]:
    """Return the robots of each supervisor except the fleet's."""
    robots_of: dict[Supervisor, list[Member]] = {}
    for member in robots:
        if member.supervisor is not None:
            robots_of.setdefault(member.supervisor, []).append(member)
    return robots_of


def _merged(spells: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Return the spells in order, merged where they overlap or touch."""
    merged: list[tuple[int, int]] = []
    for begin, end in sorted(spells):
        if merged and begin <= merged[-1][1]:
            merged[-1] = (merged[-1][0], max(merged[-1][1], end))
        else:
            merged.append((begin, end))
    return merged


def _outages(outages: Outages, key: bytes, robot: Robot, until_s: float) -> list[Fact]:
    from_us = round(outages.from_s * 1000000.0)
    facts: list[Fact] = []
    for name, rate_per_s, mean_s, edges in (
        ("off", outages.off_rate_per_s, outages.off_mean_s, (RobotWentOff(robot), RobotCameBack(robot))),
        ("link", outages.link_rate_per_s, outages.link_mean_s, (LinkWentDown(robot), LinkCameUp(robot))),
    ):
        gaps, lengths = Stream(key, f"{name}/{robot}"), Stream(key, f"{name}-length/{robot}")
        facts += _spells(gaps, lengths, _mean_s(rate_per_s), mean_s, from_us, until_s, edges)
    lost = _arrivals(Stream(key, f"loss/{robot}"), _mean_s(outages.loss_rate_per_s), until_s - outages.from_s)
    return facts + [(from_us + after_us, ActuatorDegraded(robot, "lost")) for after_us in lost]


def _departures(membership: Membership, key: bytes, robot: Robot, until_s: float) -> list[Fact]:
    """Return the spells for which the robot is away; a robot that is called away is notified before it goes.

    The world has no notion of membership: the robot is off meanwhile, as in a longer outage.
    """
    gaps, lengths = Stream(key, f"away/{robot}"), Stream(key, f"away-length/{robot}")
    calls, notice_us = Stream(key, f"away-called/{robot}"), max(1, round(membership.notice_s * 1e6))
    edges = (RobotWentOff(robot), RobotCameBack(robot))
    rate_per_s, mean_s = membership.away_rate_per_s, membership.away_mean_s
    spells, facts = _spells(gaps, lengths, _mean_s(rate_per_s), mean_s, 0, until_s, edges), list[Fact]()
    for off, back in zip(spells[::2], spells[1::2], strict=True):
        if calls.uniform() < membership.announced_share:
            facts.append((max(1, off[0] - notice_us), RobotCalledAway(robot)))
        facts += [off, back]
    return facts


def _spells(
    gaps: Stream,
    lengths: Stream,
    gap_s: float,
    length_s: float,
    from_us: int,
    until_s: float,
    edges: tuple[Event, Event],
) -> list[Fact]:
    """Return the beginning and the end of each spell that begins in time.

    Spells and the times between them are exponentially distributed.
    """
    facts: list[Fact] = []
    begins_us, until_us = from_us + gaps.exponential_us(gap_s), round(until_s * 1e6)
    while begins_us < until_us:
        ends_us = begins_us + lengths.exponential_us(length_s)
        facts += [(begins_us, edges[0]), (ends_us, edges[1])]
        begins_us = ends_us + gaps.exponential_us(gap_s)
    return facts


def _tasks(world: WorldConstants, key: bytes, scenario: Scenario, team: int, load: Load) -> list[Fact]:
    facts: list[Fact] = []
    start_us = Stream(key, f"start/{team}").within_us(world.start)
    sets = [
        (task, round((task.offset_s + load.interval_s * number) * 1e6))
        for number in range(load.task_sets)
        for task in scenario.tasks
    ]
    for ordinal, (task, offset_us) in enumerate(sets, start=1):
        jitter_us = Stream(key, f"jitter/{task.owner}{team}-{ordinal}").within_us(world.jitter)
        arrival_us = start_us + offset_us + jitter_us
        facts.append((arrival_us, arrived(world, task, team, ordinal, arrival_us)))
    injected = [injection for injection in scenario.injections for _ in range(injection.times)]
    for ordinal, injection in enumerate(injected, start=1):
        name = f"injected-{team}-{ordinal}"
        time_us = Stream(key, f"injection/{name}").within_us(world.injection)
        requester, target = robot_named(injection.requester, team), robot_named(injection.target, team)
        facts.append(
            (
                time_us,
                OutsiderRequestInjected(task_id=name, robot=requester, peer=target, capability=injection.capability),
            )
        )
    if scenario.degradable:
        stream = Stream(key, f"degradation/{team}")
        happens, which, onset = stream.uniform() < world.degradation_probability, stream.uniform(), stream.uniform()
        if happens:
            robot = robot_named(scenario.degradable[int(which * len(scenario.degradable))], team)
            facts.append((max(1, round(onset * world.degradation_onset_s * 1e6)), ActuatorDegraded(robot)))
    return facts


WEAR_AFTER_US = 1_000_000
"""The time from the tasks' arrival to the wear of an actuator: during its robot's first approach of at least 2 s."""


def workflow_facts(world: WorldConstants, key: bytes, workflow: Workflow) -> list[tuple[int, Event]]:
    """Return the facts of the workflow in order of time. Units: microseconds of run time."""
    arrival_us = Stream(key, "start/1").within_us(world.start)
    facts: list[tuple[int, Event]] = [
        (arrival_us, arrived(world, task, 1, ordinal, arrival_us))
        for ordinal, task in enumerate(workflow.tasks, start=1)
    ]
    facts += [
        (arrival_us + WEAR_AFTER_US, ActuatorDegraded(robot_named(wear.robot, 1), wear.grade)) for wear in workflow.wear
    ]
    return facts


def arrived(world: WorldConstants, task: Task, team: int, ordinal: int, arrival_us: int) -> TaskArrived:
    """Return the arrival of a team's task, with a budget for its steps."""
    own = len(task.steps) - task.delegated
    budget_s = world.budget_base_s + world.budget_delegated_s * task.delegated + world.budget_own_s * own
    budget_us = round(min(budget_s * 1e6, FOREVER_US))
    return TaskArrived(
        task_id=f"{task.owner}{team}-{ordinal}",
        robot=robot_named(task.owner, team),
        team=team,
        steps=task.steps,
        budget_us=budget_us,
        due_us=arrival_us + budget_us,
        checkpoints=task.checkpoints,
        is_time_critical=task.is_time_critical,
    )
