"""What a fleet file says of domains, visibility, priority, density and budgets changes what is decided."""

from typing import Any

import pytest
from msgspec.structs import replace

from fsar_ledger.designs import Budget, Capability, Density, Fleet, Policy, Robot, Scenario, Task, Trust
from fsar_ledger.designs.constants import Constants, WorldConstants
from fsar_ledger.events import Event
from fsar_ledger.events.authority import AuthorityClaimed
from fsar_ledger.events.envelope import flat
from fsar_ledger.events.execution import ExecutionFailed
from fsar_ledger.events.recovery import RecoveryAttempted, RecoveryBudgetSet, RecoveryEscalated
from fsar_ledger.events.registry import RegistryQueried
from fsar_ledger.events.request import RequestAdmitted, RequestCountered, RequestDenied
from fsar_ledger.events.supervision import SupervisionDensitySet, SupervisorCalled, SupervisorResponded
from fsar_ledger.events.world import ActuatorDegraded
from fsar_ledger.runtime.live import LiveRun, command_given, live_started
from fsar_ledger.runtime.replay import replay
from fsar_ledger.runtime.simulation import RunSpec, simulate_run
from fsar_ledger.runtime.world.checks import problems_of_fleet
from tests.runtime.test_replay import committed

FLEET = Fleet(
    "ward",
    (
        Robot("porter", ("navigate.indoor",), domain="ward/day"),
        Robot("door", ("door.open.secure",), domain="ward/night"),
        Robot("gate", ("door.open.secure",), role="door", domain="yard"),
    ),
    (Capability("navigate.indoor"), Capability("door.open.secure")),
    trust=(Trust("porter", "door", "task", is_mutual=True),),
)
SCENARIO = Scenario("night", (Task("porter", ("porter navigate.indoor", "porter door.open.secure door")),))
S = 1_000_000
PORTER, DOOR, GATE = "robot/porter1", "robot/door1", "robot/gate1"
LIVE: list[tuple[str, str, dict[str, Any]]] = [
    (
        "SubmitTask",
        PORTER,
        {"robot": PORTER, "task_id": "t", "steps": ["porter door.open.secure door"], "budget_us": 600 * S},
    ),
    ("JudgeRequest", DOOR, {"robot": DOOR, "action_id": "t/1.1", "accepts": True}),
    ("ReportStart", DOOR, {"robot": DOOR, "action_id": "t/1.1"}),
    ("ReportFailure", DOOR, {"robot": DOOR, "action_id": "t/1.1", "cause": "hinge jammed"}),
]


def capabilities(**terms: Any) -> tuple[Capability, ...]:
    return tuple(replace(one, **terms) for one in FLEET.capabilities)


def lived(fleet: Fleet, *commands: tuple[str, str, dict[str, Any]]) -> list[Event]:
    """The events of a live run of this fleet, a second between two commands."""
    assert list(problems_of_fleet(fleet)) == []
    constants = Constants(fleet=fleet)
    one = LiveRun(live_started(constants, 3), constants)
    for number, (name, by, fields) in enumerate(commands, start=1):
        one.give(number * S, command_given(name, by, fields))
    one.advance((len(commands) + 3) * S)
    return one.kernel.events


def simulated(fleet: Fleet, **world: Any) -> list[Event]:
    """The events of five simulated runs of this fleet, of which nothing asks for a review by itself."""
    laws = WorldConstants(review_share=0.0, **world)
    constants = Constants(world=laws, scenario=replace(SCENARIO, degradable=("door", "gate")), fleet=fleet)
    runs = [simulate_run(RunSpec(7, "fsar", "full", "night", 3, run), constants) for run in range(5)]
    return [event for run in runs for event in run.events]


def of(events: list[Event], kind: type[Any]) -> list[Any]:
    return [event for event in events if isinstance(event, kind)]


def found(events: list[Event]) -> set[tuple[str, ...]]:
    return {event.candidates for event in of(events, RegistryQueried)}


def test_who_is_visible_in_its_domain_alone_is_found_by_nobody_outside() -> None:
    in_domain = replace(FLEET, capabilities=capabilities(visibility="domain"))
    inside = replace(in_domain, robots=tuple(replace(one, domain="ward") for one in FLEET.robots))
    for run in (simulated, lambda fleet: lived(fleet, *LIVE[:1])):
        assert (DOOR in {name for names in found(run(FLEET)) for name in names}) is True
        assert found(run(in_domain)) == {()}
        assert {DOOR, GATE} <= {name for names in found(run(inside)) for name in names}


def test_who_is_shown_to_the_trusted_alone_is_hidden_from_who_has_no_trust() -> None:
    strangers = replace(FLEET, trust=(), capabilities=capabilities(visibility="trust-gated"))
    [query] = of(lived(strangers, *LIVE[:1]), RegistryQueried)
    assert set(query.rejected_by) == {"visibility"}
    [query] = of(lived(replace(strangers, capabilities=capabilities()), *LIVE[:1]), RegistryQueried)
    assert set(query.rejected_by) == {"trust"}


def test_trust_in_a_domain_holds_in_it_and_comes_before_that_of_a_larger_one() -> None:
    ward = replace(FLEET, trust=(Trust("porter", "door", "task", is_mutual=True, domain="ward"),))
    assert found(lived(ward, *LIVE[:1])) == {(DOOR,)}
    but = replace(FLEET, trust=(*FLEET.trust, Trust("door", "porter", "none", domain="ward")))
    assert found(lived(but, *LIVE[:1])) == {(GATE,)}


def test_a_rule_in_a_domain_binds_the_robots_in_it() -> None:
    denied = replace(FLEET, policies=(Policy("door", "deny", "fleet", domain="ward"),))
    [denial] = of(lived(denied, *LIVE[:2]), RequestDenied)
    assert (denial.principals.executed_by, denial.reason) == (DOOR, "policy")
    elsewhere = replace(FLEET, policies=(Policy("door", "deny", "fleet", domain="yard"),))
    assert of(lived(elsewhere, *LIVE[:2]), RequestDenied) == []


@pytest.mark.parametrize(("allowed", "kind"), [("none", RequestCountered), ("soft-priority", RequestAdmitted)])
def test_a_request_has_priority_as_far_as_the_capability_allows_it(allowed: str, kind: type[Event]) -> None:
    fields = {
        "requester": PORTER,
        "executor": DOOR,
        "capability": "door.open.secure",
        "context": "visit",
        "action_id": "q",
    }
    commands = (
        ("RequestCapability", PORTER, fields | {"override": "soft-priority"}),
        ("JudgeRequest", DOOR, {"robot": DOOR, "action_id": "q", "accepts": True}),
    )
    events = lived(replace(FLEET, capabilities=capabilities(override_allowed=allowed)), *commands)
    assert [type(event) for event in events if isinstance(event, RequestCountered | RequestAdmitted)] == [kind]


def test_density_puts_admissions_before_a_supervisor() -> None:
    reviewed = replace(FLEET, density=(Density(1), Density(0, "porter")))
    for run in (simulated, lambda fleet: lived(fleet, *LIVE[:2])):
        assert of(run(FLEET), SupervisorCalled) == [] or run is simulated
        calls = {call.purpose for call in of(run(reviewed), SupervisorCalled)}
        assert "review" in calls
        assert "review" not in {call.purpose for call in of(run(FLEET), SupervisorCalled)}
        assert "review" not in {
            call.purpose for call in of(run(replace(FLEET, density=(Density(1), Density(0, "door")))), SupervisorCalled)
        }
    sets = [(one.robot, one.review_every, one.decided_by) for one in of(lived(reviewed), SupervisionDensitySet)]
    assert sets == [(None, 1, None), (PORTER, 0, None)]


@pytest.mark.parametrize("asks", [{"policies": (Policy("door", "review"),)}, {"density": (Density(1, "door"),)}])
def test_what_was_approved_is_not_put_before_a_supervisor_again_when_it_has_been_put_in_order(asks: Any) -> None:
    """Two requests for one door, one of them time-critical: H_F reviews each, and then orders them."""
    porter, door, _ = FLEET.robots
    nurse = replace(porter, name="nurse", role="porter")
    fleet = replace(FLEET, robots=(porter, nurse, door), **asks)
    tasks = (Task("porter", ("porter door.open.secure door",)), Task("nurse", ("nurse door.open.secure door",)))
    tasks = (tasks[0], replace(tasks[1], is_time_critical=True))
    constants = Constants(WorldConstants(review_share=0.0), scenario=Scenario("night", tasks), fleet=fleet)
    ordered = 0
    for run in range(8):
        approved = set[str | None]()
        for one in simulate_run(RunSpec(7, "fsar", "full", "night", 3, run), constants).events:
            if isinstance(one, SupervisorCalled):
                ordered += one.purpose == "ordering" and one.subject.action_id in approved
                assert one.purpose != "review" or one.subject.action_id not in approved
            if isinstance(one, SupervisorResponded) and one.purpose == "review":
                approved.add(one.subject.action_id)
    assert ordered


def test_a_level_of_recovery_spends_what_the_file_gives_it() -> None:
    none = replace(FLEET, budgets=(Budget("local", 30.0, 0, "door"),))
    assert [one.number for one in of(lived(FLEET, *LIVE), RecoveryAttempted)] == [1]
    assert of(lived(none, *LIVE), RecoveryAttempted) == []
    assert [(one.level, one.to_level) for one in of(lived(none, *LIVE), RecoveryEscalated)][:1] == [("local", "peer")]
    worn = {"degradation_probability": 1.0, "degraded_reliability": 0.0}
    assert of(simulated(FLEET, **worn), ActuatorDegraded)
    assert {DOOR} <= {one.robot for one in of(simulated(FLEET, **worn), RecoveryAttempted)}
    assert {DOOR} <= {one.robot for one in of(simulated(none, **worn), ExecutionFailed)}
    assert {PORTER} >= {one.robot for one in of(simulated(none, **worn), RecoveryAttempted)}


def test_the_budget_of_a_role_comes_before_that_of_every_role() -> None:
    given = (Budget("local", 5.0, 1, "door"), Budget("local", 20.0, 3), Budget("human", 60.0, 1))
    events = lived(replace(FLEET, budgets=given))
    sets = [(one.robot, one.level, one.t_max_us, one.n_max) for one in of(events, RecoveryBudgetSet)]
    assert sorted(sets) == sorted(
        [
            (DOOR, "local", 5 * S, 1),
            (GATE, "local", 5 * S, 1),
            (PORTER, "local", 20 * S, 3),
            *((robot, "human", 60 * S, 1) for robot in (PORTER, DOOR, GATE)),
        ]
    )


@pytest.mark.parametrize("architecture", ["fsar", "cfc", "dhma", "jade", "alliance", "roboos"])
def test_nobody_supervises_whom_the_file_does_not_name(architecture: str) -> None:
    """A window opens at each robot as it works: those of CFC have its supervisors claim to supervise the work."""
    porter, door, gate = FLEET.robots
    robots = (
        replace(porter, supervisor="maria"),
        replace(door, has_supervisor=False),
        replace(gate, supervisor="otto"),
    )
    laws = WorldConstants(context_rate_per_s=0.3, context_window_share=1.0, review_share=0.0)
    constants = Constants(world=laws, scenario=SCENARIO, fleet=replace(FLEET, robots=robots))
    events = list(simulate_run(RunSpec(7, architecture, "full", "night", 3, 0), constants).events)
    named = {str(value) for event in events for value in flat(event).values() if str(value).startswith("supervisor/")}
    assert named <= {"supervisor/maria", "supervisor/otto", "supervisor/fleet"}
    claimed = {one.claimant for one in of(events, AuthorityClaimed) if one.dimension == "audit"}
    assert architecture != "cfc" or "supervisor/maria" in claimed


def test_such_fleets_replay_under_every_architecture(tmp_path: Any) -> None:
    fleet = replace(
        FLEET,
        capabilities=capabilities(visibility="domain", override_allowed="hard-preempt"),
        trust=(*FLEET.trust, Trust("door", "porter", "none", domain="yard")),
        density=(Density(2),),
        budgets=(Budget("peer", 10.0, 2), Budget("local", 5.0, 1, "door")),
    )
    constants = Constants(scenario=SCENARIO, fleet=fleet)
    for architecture in ("fsar", "cfc", "dhma", "jade", "alliance", "roboos"):
        record = simulate_run(RunSpec(7, architecture, "full", "night", 3, 0), constants)
        assert replay(committed(tmp_path / architecture, record)).ok, architecture
