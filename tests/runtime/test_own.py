"""A designer's own fleet, scenario and constants: in event 0, so that their runs replay without the files."""

import shutil
import sys
from pathlib import Path

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fsar_ledger.base.errors import InvalidExperiment, UsageError
from fsar_ledger.designs import (
    Capability,
    Fleet,
    Injection,
    OffShift,
    Policy,
    Robot,
    Scenario,
    Substitute,
    Task,
    Trust,
    registered,
)
from fsar_ledger.designs.constants import Constants, Load, Outages, read_constants, write_constants
from fsar_ledger.events.configuration import PAPER_ARCHITECTURES
from fsar_ledger.events.envelope import Supervisor, TrustScope
from fsar_ledger.events.execution import ExecutionStarted
from fsar_ledger.events.fleet import RobotJoined
from fsar_ledger.events.world import OutsiderRequestInjected, SupervisorLeft, SupervisorReturned
from fsar_ledger.ledger.verify import verify
from fsar_ledger.metrics.constant_names import unlike_ours
from fsar_ledger.runtime.experiment import Experiment, run_experiment
from fsar_ledger.runtime.own import with_own, with_settings
from fsar_ledger.runtime.replay import replay
from fsar_ledger.runtime.simulation import RunSpec, run_id, run_started, simulate_run
from fsar_ledger.runtime.world.checks import problems_of_fleet, problems_of_scenario
from fsar_ledger.runtime.world.schedule import schedule
from tests.quick import few
from tests.running import ran
from tests.runtime.live import of
from tests.runtime.test_replay import committed
from tests.runtime.test_replay_refused import restarted

ROOT = Path(__file__).resolve().parents[2]
FLEET = Fleet(
    "ward",
    (
        Robot("porter", ("navigate.indoor", "carry.linen")),
        Robot("east-door", ("door.open.secure",), role="door"),
        Robot("west-door", ("door.open.secure",), role="door", has_supervisor=False),
    ),
    (Capability("navigate.indoor"), Capability("carry.linen", lasts_s=(2.0, 5.0)), Capability("door.open.secure")),
    trust=(Trust("porter", "door", "task", is_mutual=True),),
    off_shift=(OffShift(30.0, 60.0), OffShift(50.0, 90.0, ("porter",))),
)
SCENARIO = Scenario("night", (Task("porter", ("porter door.open.secure east-door", "porter carry.linen")),))
OWN = Constants(scenario=SCENARIO, fleet=FLEET)
SPEC = RunSpec(7, "fsar", "full", "night", 3, 0)


def test_what_is_own_is_in_event_0_and_comes_back_from_it_as_it_was() -> None:
    started = run_started(SPEC, OWN)
    assert read_constants(started.parameters or "") == OWN
    assert '"fleet":' not in (run_started(SPEC, Constants()).parameters or "")
    assert write_constants(Constants()) == write_constants(Constants(scenario=None, fleet=None))


def test_own_scenarios_of_one_name_and_other_content_are_other_runs() -> None:
    other = msgspec.structs.replace(SCENARIO, tasks=(*SCENARIO.tasks, *SCENARIO.tasks))
    ids = {run_id(run_started(SPEC, msgspec.structs.replace(OWN, scenario=one))) for one in (SCENARIO, other)}
    ids.add(run_id(run_started(SPEC, msgspec.structs.replace(OWN, fleet=None))))
    assert len(ids) == 3
    assert all(name.startswith("fsar.full.night.n3.s7.r0000-") for name in ids)


def test_replay_names_own_designs_by_their_name() -> None:
    assert unlike_ours(write_constants(OWN)) == ['fleet="ward" (here absent)', 'scenario="night" (here absent)']


def test_an_own_fleet_is_founded_team_by_team_as_its_file_says() -> None:
    record = simulate_run(msgspec.structs.replace(SPEC, fleet_size=6), OWN)
    joined = [event for _, event in of(record, RobotJoined) if isinstance(event, RobotJoined)]
    assert [(one.robot, one.role, one.team, one.supervisor) for one in joined[:3]] == [
        ("robot/porter1", "porter", 1, "supervisor/porter1"),
        ("robot/east-door1", "door", 1, "supervisor/east-door1"),
        ("robot/west-door1", "door", 1, None),
    ]
    assert [one.robot for one in joined[3:]] == ["robot/porter2", "robot/east-door2", "robot/west-door2"]


def test_at_night_nobody_supervises_but_the_fleets_supervisor_where_a_robot_has_none_of_its_own() -> None:
    found: dict[bool, set[str | None]] = {True: set(), False: set()}
    for off_shift in ((), (OffShift(),)):
        own = msgspec.structs.replace(OWN, fleet=msgspec.structs.replace(FLEET, off_shift=off_shift))
        for run in range(4):
            record = simulate_run(msgspec.structs.replace(SPEC, run=run), own)
            for _, event in of(record, ExecutionStarted):
                assert isinstance(event, ExecutionStarted)
                found[bool(off_shift)].add(event.principals.supervised_by)
    assert {"supervisor/porter1", "supervisor/east-door1"} <= found[False]
    assert found[True] <= {None, "supervisor/fleet"}
    assert None in found[True]


def test_spells_off_shift_that_overlap_are_one_and_a_robot_without_a_supervisor_has_none() -> None:
    constants = msgspec.structs.replace(OWN, world=msgspec.structs.replace(OWN.world, absence_s=0.0))
    facts = [
        one for one in schedule(constants, 7, "night", 0, 3) if isinstance(one[1], SupervisorLeft | SupervisorReturned)
    ]
    at_night = [(round(time_us / 1e6), event) for time_us, event in facts if time_us in range(29_999_999, 90_000_100)]
    porter, door = Supervisor("supervisor/porter1"), Supervisor("supervisor/east-door1")
    about = [one for one in at_night if one[0] in (30, 60, 90)]
    assert (30, SupervisorLeft(porter)) in about
    assert (90, SupervisorReturned(porter)) in about
    assert (60, SupervisorReturned(porter)) not in about
    assert (60, SupervisorReturned(door)) in about
    assert not any("west-door" in event.supervisor for _, event in facts if isinstance(event, SupervisorLeft))


def test_a_night_without_an_end_lasts_as_long_as_the_run() -> None:
    endless = msgspec.structs.replace(OWN, fleet=msgspec.structs.replace(FLEET, off_shift=(OffShift(30.0),)))
    returned = [
        time_us for time_us, event in schedule(endless, 7, "night", 0, 3) if isinstance(event, SupervisorReturned)
    ]
    assert all(time_us < 30_000_000 for time_us in returned)


def test_each_request_of_several_injections_has_a_name_and_a_time_of_its_own() -> None:
    asked = tuple(Injection("porter", door, "door.open.secure", 2) for door in ("east-door", "west-door"))
    own = msgspec.structs.replace(OWN, scenario=msgspec.structs.replace(SCENARIO, injections=asked))
    injected = [one for one in schedule(own, 7, "night", 0, 6) if isinstance(one[1], OutsiderRequestInjected)]
    names = [one.task_id for _, one in injected if isinstance(one, OutsiderRequestInjected)]
    assert sorted(names) == [f"injected-{team}-{number}" for team in (1, 2) for number in (1, 2, 3, 4)]
    assert len({round(time_us / 1e3) for time_us, _ in injected}) == 8


def test_own_runs_verify_and_replay_from_the_ledger_alone(tmp_path: Path) -> None:
    run_experiment(tmp_path / "ledger", Experiment(PAPER_ARCHITECTURES, ("night",), 2, 7, 6, constants=OWN), 1)
    assert verify(tmp_path / "ledger").ok
    report = replay(tmp_path / "ledger")
    assert (report.ok, report.runs) == (True, 6)


def test_a_run_that_records_another_fleet_than_it_was_made_with_is_found(tmp_path: Path) -> None:
    untrusting = msgspec.structs.replace(OWN, fleet=msgspec.structs.replace(FLEET, trust=()))
    forged = restarted(simulate_run(SPEC, OWN), parameters=write_constants(untrusting))
    [difference] = replay(committed(tmp_path / "ledger", forged)).differences
    assert (difference.field, difference.handler) == ("type", "world.schedule.schedule")
    assert "RoleTrustSet" in difference.actual


def test_a_run_that_records_an_impossible_fleet_is_a_doubt_and_says_why(tmp_path: Path) -> None:
    for wrong, why in (
        (msgspec.structs.replace(FLEET, robots=()), "expected at least one robot"),
        (msgspec.structs.replace(FLEET, name="paper"), "found one of your own named paper"),
    ):
        own = msgspec.structs.replace(OWN, fleet=wrong)
        forged = restarted(simulate_run(SPEC, OWN), parameters=write_constants(own))
        [difference] = replay(committed(tmp_path / wrong.name / str(len(wrong.robots)), forged)).differences
        assert why in difference.actual
        assert "cannot be replayed" in difference.actual


@pytest.mark.parametrize(
    ("constants", "scenarios", "size", "message"),
    [
        (OWN, ("door-relay",), 3, "scenario: found door-relay, expected some of night, each once"),
        (OWN, ("night",), 4, "fleet size: found 4, expected 3 or a multiple of it (teams of ward)"),
        (Constants(fleet=FLEET), ("door-relay",), 3, "scenario door-relay: found fleet ward, expected the paper's"),
        (
            Constants(fleet=FLEET),
            ("workflow-door-relay",),
            3,
            "workflow workflow-door-relay: found a fleet of your own",
        ),
        (Constants(scenario=SCENARIO), ("night",), 4, "scenario night: tasks[0].owner: found porter, expected one of"),
        (
            Constants(scenario=registered.scenario("door-relay")),
            ("door-relay",),
            4,
            "found one of your own named door-relay",
        ),
        (Constants(fleet=registered.fleet()), ("door-relay",), 4, "found one of your own named paper"),
        (Constants(fleet=msgspec.structs.replace(FLEET, robots=())), ("x",), 3, "scenario: found x"),
    ],
)
def test_an_experiment_that_is_not_of_its_fleet_is_refused(
    constants: Constants, scenarios: tuple[str, ...], size: int, message: str
) -> None:
    with pytest.raises(InvalidExperiment) as refused:
        Experiment(("fsar",), scenarios, 1, 7, size, constants=constants)
    assert message in str(refused.value)


def test_an_unknown_architecture_or_scenario_is_refused_with_the_nearest_name() -> None:
    for architecture, scenario, nearest in (("fsra", "door-relay", "fsar"), ("fsar", "door-realy", "door-relay")):
        with pytest.raises(InvalidExperiment, match=rf"did you mean {nearest}\?"):
            Experiment((architecture,), (scenario,), 1)


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("world.review_share", "expected NAME=VALUE"),
        ("world.reviewshare=0.5", "unknown constant world.reviewshare; did you mean world.review_share?"),
        ("nothing.like.it=1", "unknown constant nothing.like.it"),
        ("world.review_share=much", "found much, expected a number"),
        ("world.review_share=true", "found true, expected a number"),
        ("world.review_share=1.5", "found 1.5, expected a share, 0 to 1"),
        ("world.window_mean_s=-1", "found -1, expected 0 or more"),
        ("world.window_mean_s=1e999", "expected a number"),
        ("structure.local_attempts=1.5", "found 1.5, expected a whole number"),
        ("structure.human_calls=0", "found 0, expected 1 or more"),
        ("world.message.low_s=0.7", "found world.message from 0.7 to 0.5 s, expected the smaller first"),
        ("world.absence_to_s=-60", "found world.absence from -50 to -60 s, expected the smaller first; set both"),
        ("fleet=x", "unknown constant fleet"),
    ],
)
def test_a_setting_that_is_none_is_refused_with_what_was_found(setting: str, message: str) -> None:
    with pytest.raises(UsageError) as refused:
        with_settings(Constants(), [setting])
    assert message in str(refused.value)


def test_settings_change_the_constants_that_they_name_and_no_others() -> None:
    default = Constants()
    found = with_settings(
        default,
        [
            *("world.review_share=0.5", 'world.durations["carry.heavy"].low_s=1', "load.task_sets=2"),
            *("outages.off_rate_per_s=0.01", "structure.local_attempts=3", "world.absence_from_s=-10"),
        ],
    )
    assert sorted(unlike_ours(write_constants(found))) == [
        "load.task_sets=2 (here 1)",
        "outages.off_rate_per_s=0.01 (here 0)",
        "structure.local_attempts=3 (here 2)",
        "world.absence_from_s=-10 (here -50)",
        'world.durations["carry.heavy"].low_s=1 (here 2)',
        f"world.review_share=0.5 (here {default.world.review_share})",
    ]
    assert (found.load, found.outages) == (Load(task_sets=2), Outages(off_rate_per_s=0.01))
    assert with_settings(default, []) is default
    with pytest.raises(UsageError, match="one value for each name"):
        with_settings(default, ["load.task_sets=2", "load.task_sets=3"])


def test_a_file_stands_alone_and_a_fleet_has_a_name_or_is_a_file(tmp_path: Path) -> None:
    (tmp_path / "my.toml").write_text('name = "my"\n[[tasks]]\nowner = "A"\nsteps = ["A navigate.indoor"]\n')
    constants, names = with_own(Constants(), [str(tmp_path / "my.toml")])
    assert (names, constants.fleet) == (("my",), None)
    assert with_own(Constants(), ["door-relay"], "paper") == (Constants(), ("door-relay",))
    with pytest.raises(UsageError, match="expected a file alone"):
        with_own(Constants(), [str(tmp_path / "my.toml"), "door-relay"])
    with pytest.raises(UsageError, match="did you mean paper"):
        with_own(Constants(), ["door-relay"], "papr")


def test_a_scenario_is_one_file_and_an_architecture_a_folder_and_a_line(tmp_path: Path) -> None:
    """The package is copied with these, and nothing else of it changes; no experiment of the paper is enlarged by
    them."""
    shutil.copytree(ROOT / "fsar_ledger", tmp_path / "fsar_ledger", ignore=shutil.ignore_patterns("__pycache__"))
    scenario = 'name = "sixth"\n[[tasks]]\nowner = "A"\nsteps = ["A door.open.basic B"]\n'
    (tmp_path / "fsar_ledger/runtime/world/scenarios/sixth.toml").write_text(scenario)
    architectures = tmp_path / "fsar_ledger/runtime/architectures"
    shutil.copytree(architectures / "cfc", architectures / "mine")
    handlers = architectures / "mine/__init__.py"
    register = tmp_path / "fsar_ledger/events/configuration.py"
    handlers.write_text(handlers.read_text().replace("CFC: HandlerTable", "MINE: HandlerTable"))
    register.write_text(register.read_text().replace('    "dhma",\n', '    "dhma",\n    "mine",\n'))
    program = (
        "from pathlib import Path\n"
        "from fsar_ledger.runtime.experiment import Experiment, run_experiment\n"
        "from fsar_ledger.runtime.paper import NAMES, paper_ledger\n"
        "from fsar_ledger.runtime.replay import replay\n"
        "import fsar_ledger; assert fsar_ledger.__file__.startswith(str(Path.cwd())), fsar_ledger.__file__\n"
        "run_experiment(Path('ledger'), Experiment(('mine', 'fsar'), ('sixth', 'door-relay'), 1), 1)\n"
        "report = replay(Path('ledger')); assert report.ok and report.runs == 4, report\n"
        "parts = [part for one in NAMES for part in paper_ledger(one).parts]\n"
        "print({name for one in parts for name in one.scenarios + one.architectures} & {'sixth', 'mine'})\n"
        "print(Experiment(('mine', 'fsar'), ('sixth', 'fleet-contention'), 1).scenarios)\n"
    )
    done = ran([sys.executable, "-c", program], cwd=tmp_path, env={"PYTHONPATH": str(tmp_path)})
    assert (done.stdout, done.stderr) == ("set()\n('fleet-contention', 'sixth')\n", "")


NAMES = st.sampled_from(("porter", "lift", "door-a", "door_b", "Cart"))
CAPABILITIES = ("navigate.indoor", "door.open.secure", "lift.ride", "carry.linen")


SCOPES: tuple[TrustScope, ...] = ("none", "capability", "task", "session", "persistent")


@st.composite
def designs(draw: st.DrawFn) -> Constants:
    """A fleet, and a scenario that can happen to it."""
    names = draw(st.lists(NAMES, min_size=1, max_size=4, unique=True))
    able = st.lists(st.sampled_from(CAPABILITIES), min_size=1, max_size=3, unique=True).map(tuple)
    robots = tuple(
        Robot(name, draw(able), draw(st.sampled_from((None, "crew", "door"))), draw(st.booleans())) for name in names
    )
    roles = st.sampled_from(tuple(dict.fromkeys(robot.kind for robot in robots)))
    pairs = draw(st.lists(st.tuples(roles, roles), max_size=3, unique=True))
    scopes = st.sampled_from(SCOPES)
    spells = st.builds(OffShift, st.sampled_from((0.0, 20.0)), st.sampled_from((None, 40.0, 400.0)))
    fleet = Fleet(
        "any",
        robots,
        tuple(Capability(name, (), draw(st.lists(roles, max_size=1).map(tuple)), (0.5, 4.0)) for name in CAPABILITIES),
        bodies=draw(st.lists(roles, max_size=1).map(tuple)),
        substitutes=draw(st.sampled_from(((), (Substitute("lift.ride", "carry.linen"),)))),
        trust=tuple(Trust(one, other, draw(scopes)) for one, other in pairs),
        policies=draw(
            st.lists(st.builds(Policy, roles, st.sampled_from(("allow", "deny", "review"))), max_size=1).map(tuple)
        ),
        off_shift=draw(st.lists(spells, max_size=2).map(tuple)) if any(one.has_supervisor for one in robots) else (),
    )
    own = [f"{one.name} {capability}" for one in robots for capability in one.capabilities]
    delegated = [
        f"{one.name} {what} {to.name}" for one in robots for to in robots for what in to.capabilities if to != one
    ]
    steps = st.lists(st.sampled_from(own + delegated), min_size=1, max_size=5).map(tuple)
    tasks = st.builds(Task, st.sampled_from(names), steps, st.sampled_from((0.0, 30.0)), st.booleans())
    asked = [Injection(one.name, to.name, to.capabilities[0]) for one in robots for to in robots if one != to]
    injections = draw(st.lists(st.sampled_from(asked), max_size=1)) if asked else []
    trusted = {(one.role, one.peer_role) for one in fleet.trust if one.scope != "none"}
    kinds = {robot.name: robot.kind for robot in robots}
    scenario = Scenario(
        "any-night",
        tuple(draw(st.lists(tasks, min_size=1, max_size=3))),
        tuple(one for one in injections if (kinds[one.target], kinds[one.requester]) not in trusted),
        tuple(draw(st.lists(st.sampled_from(names), max_size=2, unique=True))),
    )
    return Constants(scenario=scenario, fleet=fleet)


def plays(folder: Path, own: Constants, teams: int, architecture: str) -> None:
    """Check that the design is well made, and that its run verifies and replays."""
    assert own.fleet is not None
    assert own.scenario is not None
    assert list(problems_of_fleet(own.fleet)) == []
    assert list(problems_of_scenario(own.scenario, own.fleet)) == []
    run_experiment(
        folder, Experiment((architecture,), ("any-night",), 1, 5, teams * len(own.fleet.robots), constants=own), 1
    )
    assert verify(folder).ok
    report = replay(folder)
    assert report.ok, report.differences
    assert report.runs == 1


FEW = settings(max_examples=6, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)


@FEW
@given(designs(), st.integers(1, 2), st.sampled_from(PAPER_ARCHITECTURES))
def test_any_well_made_fleet_and_scenario_simulate_verify_and_replay(
    tmp_path_factory: pytest.TempPathFactory, own: Constants, teams: int, architecture: str
) -> None:
    plays(tmp_path_factory.mktemp("any") / "ledger", own, teams, architecture)


@pytest.mark.parametrize("many", few([20, 300], [], [20]))
def test_any_of_many_well_made_fleets_and_scenarios_simulate_verify_and_replay(
    tmp_path_factory: pytest.TempPathFactory, many: int
) -> None:
    @settings(max_examples=many, deadline=None, suppress_health_check=list(HealthCheck))
    @given(designs(), st.integers(1, 3), st.sampled_from(PAPER_ARCHITECTURES))
    def played(own: Constants, teams: int, architecture: str) -> None:
        plays(tmp_path_factory.mktemp("any") / "ledger", own, teams, architecture)

    played()


def test_one_person_supervises_several_robots_and_is_absent_once() -> None:
    robots = tuple(msgspec.structs.replace(one, supervisor="maria", has_supervisor=True) for one in FLEET.robots[:2])
    fleet = msgspec.structs.replace(FLEET, robots=(*robots, FLEET.robots[2]))
    assert list(problems_of_fleet(fleet)) == []
    record = simulate_run(SPEC, Constants(scenario=SCENARIO, fleet=fleet))
    joined = [event.supervisor for _, event in of(record, RobotJoined)]
    assert joined == ["supervisor/maria", "supervisor/maria", None]
    left = [event.supervisor for _, event in of(record, SupervisorLeft)]
    alone = [event.supervisor for _, event in of(simulate_run(SPEC, OWN), SupervisorLeft)]
    assert set(left) == {"supervisor/maria"}
    assert len(left) < len(alone)
    assert {event.principals.supervised_by for _, event in of(record, ExecutionStarted)} == {"supervisor/maria"}


@pytest.mark.parametrize(
    ("named", "has_supervisor"), [("Maria", True), ("maria k", True), ("fleet", True), ("maria", False)]
)
def test_a_supervisor_that_nobody_can_be_is_refused(named: str, has_supervisor: bool) -> None:
    robot = msgspec.structs.replace(FLEET.robots[0], supervisor=named, has_supervisor=has_supervisor)
    problem, *_ = problems_of_fleet(msgspec.structs.replace(FLEET, robots=(robot, *FLEET.robots[1:])))
    assert f"{problem}".startswith("robots[0].supervisor: found")
