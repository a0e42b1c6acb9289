"""A robot without the federation goes on alone, in a run of its own, and hands it over once the federation is back."""

from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

import fsar_ledger
from fsar_ledger.base.errors import UsageError
from fsar_ledger.events.fleet import IsolatedResultAccepted, IsolatedResultOvertaken, IsolationBegan, IsolationEnded
from fsar_ledger.events.recovery import RecoveryEscalated
from fsar_ledger.events.registry import CapabilityInstalled
from fsar_ledger.events.supervision import SupervisorCalled
from fsar_ledger.events.task import TaskCompleted
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.store.locations import record_of
from fsar_ledger.runtime.federation import Federation
from fsar_ledger.runtime.isolation import compared_with_fleet, isolation_of
from fsar_ledger.runtime.run_replay import replay_run
from tests.queries.histories import S, act, answer, event, run

A, B = "robot/A1", "robot/B1"
DRIVE = "A navigate.indoor"


class Site:
    """A fleet, and robot A1 that may go on alone; a second passes with each command."""

    def __init__(self, path: Path) -> None:
        self.path, self.now = path, 1_772_359_200
        self.hall = self.opened("hall", "morning")

    def opened(self, folder: str, name: str, **given: Any) -> Any:
        return fsar_ledger.federate(self.path / folder, run=name, clock=lambda: self.now * 10**9, **given)

    def alone(self) -> Any:
        return self.opened("a1", "A1", isolated=A, of=self.path / "hall")

    def to_hand_over(self) -> Any:
        return fsar_ledger.open_ledger(self.path / "a1").hand_over()

    def tell(self, one: Any, who: str, command: str, **fields: Any) -> Any:
        self.now += 1
        return one.give(command, by=who, **fields)

    def task(self, one: Any, *steps: str, name: str = "t1") -> Any:
        return self.tell(one, A, "SubmitTask", robot=A, task_id=name, steps=list(steps), budget_us=600_000_000)

    def does(self, one: Any, action_id: str) -> Any:
        assert self.tell(one, A, "ReportStart", robot=A, action_id=action_id).rejected is None
        return self.tell(one, A, "ReportResult", executor=A, action_id=action_id, result="success")


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return Site(tmp_path)


def of(decision: Any, kind: type) -> list[Any]:
    return [one for one in (*decision.events, *decision.followed) if isinstance(one, kind)]


def record(path: Path, name: str) -> Any:
    return record_of(open_ledger(path), name)


def test_it_does_its_own_steps_alone_and_the_fleet_accepts_them(site: Site) -> None:
    site.task(site.hall, DRIVE, DRIVE)
    with site.alone() as own:
        site.does(own, "t1/1.1")
        assert of(site.does(own, "t1/2.1"), TaskCompleted)
        fields = site.to_hand_over()
    done = site.tell(site.hall, A, "HandOver", **fields)
    assert [one.subject.action_id for one in of(done, IsolatedResultAccepted)] == ["t1/1.1", "t1/2.1"]
    assert of(done, TaskCompleted)
    [ended] = of(done, IsolationEnded)
    view = open_ledger(site.path / "a1")
    assert (ended.isolated_root, ended.isolated_seq) == (view.head.root, view.head.size - 1)


def test_each_run_replays_for_itself(site: Site) -> None:
    site.task(site.hall, DRIVE)
    head = open_ledger(site.path / "hall").head
    with site.alone() as own:
        site.does(own, "t1/1.1")
        fields = site.to_hand_over()
    site.tell(site.hall, A, "HandOver", **fields)
    alone = record(site.path / "a1", "A1")
    [began] = [one for one in alone.events if isinstance(one, IsolationBegan)]
    assert (began.fleet_run, began.fleet_seq, began.fleet_root) == ("morning", head.size - 1, head.root)
    assert replay_run(alone) is None
    assert replay_run(record(site.path / "hall", "morning")) is None


def test_its_run_goes_on_when_it_is_opened_again(site: Site) -> None:
    site.task(site.hall, DRIVE)
    site.alone().close()
    with site.alone() as own:
        assert of(site.does(own, "t1/1.1"), TaskCompleted)


def test_what_needs_others_is_not_begun(site: Site) -> None:
    site.task(site.hall, DRIVE, "A door.open.secure B")
    with site.alone() as own:
        site.does(own, "t1/1.1")
        assert own.state.task["t1"].step == 1
        assert own.state.request.open == {}
        assert site.task(own, "A door.open.secure B", name="t2").rejected


def test_nobody_but_the_robot_and_its_supervisor_is_there(site: Site) -> None:
    with site.alone() as own:
        refused = site.tell(own, "supervisor/fleet", "ReportShift", supervisor="supervisor/fleet", is_on=False)
        assert refused.rejected.startswith("supervisor/fleet is not there")
        on = site.tell(own, "supervisor/A1", "ReportShift", supervisor="supervisor/A1", is_on=False)
        assert on.rejected is None


def test_its_recovery_ends_with_its_own_supervisor(site: Site) -> None:
    site.task(site.hall, DRIVE)
    with site.alone() as own:
        site.tell(own, A, "ReportStart", robot=A, action_id="t1/1.1")
        site.tell(own, A, "ReportFailure", robot=A, action_id="t1/1.1", cause="stuck")
        while not of(
            last := site.tell(own, A, "ReportAttempt", robot=A, action_id="t1/1.1", succeeded=False), SupervisorCalled
        ):
            assert last.rejected is None
    assert [one.supervisor for one in of(last, SupervisorCalled)] == ["supervisor/A1"]
    assert [one.to_level for one in of(last, RecoveryEscalated)] == ["peer", "fleet", "human"]
    assert {one.principals.decided_by for one in of(last, RecoveryEscalated)} == {A}


def test_what_the_fleet_has_done_meanwhile_overtakes_it(site: Site) -> None:
    site.task(site.hall, DRIVE)
    with site.alone() as own:
        site.does(own, "t1/1.1")
        fields = site.to_hand_over()
    site.does(site.hall, "t1/1.1")
    found = of(site.tell(site.hall, A, "HandOver", **fields), IsolatedResultOvertaken)
    assert [one.reason for one in found] == ["the task is completed"]


def test_what_it_did_before_it_was_declared_departed_does_not_count(site: Site) -> None:
    site.task(site.hall, DRIVE)
    with site.alone() as own:
        site.does(own, "t1/1.1")
        fields = site.to_hand_over()
    site.tell(site.hall, A, "LeaveFleet", robot=A)
    assert site.tell(site.hall, A, "HandOver", **fields).rejected
    site.tell(site.hall, A, "JoinFleet", robot=A, role="A", team=1, supervisor="supervisor/A1")
    found = of(site.tell(site.hall, A, "HandOver", **fields, fence=1), IsolatedResultOvertaken)
    assert [one.reason for one in found] == ["the robot has departed since, so its claims are old"]


def test_nobody_else_hands_it_over(site: Site) -> None:
    with site.alone():
        fields = site.to_hand_over()
    assert (
        site.tell(site.hall, B, "HandOver", **fields).rejected == "robot/B1 speaks for robot/A1, expected its own word"
    )


def test_a_result_that_nobody_can_read_is_refused(site: Site) -> None:
    with site.alone():
        fields = site.to_hand_over()
    for result in ("t1 well", f"t1/{'9' * 5_000} success"):
        refused = site.tell(site.hall, A, "HandOver", **{**fields, "results": [result]}).rejected
        assert refused == f"result {result!r}, expected a step and success or failure, as t1/2 success"


def test_a_robot_outside_the_fleet_has_nothing_to_go_on_from(site: Site) -> None:
    with pytest.raises(UsageError, match="found no fleet with robot/Z9"):
        site.opened("z", "Z9", isolated="robot/Z9", of=site.path / "hall")
    with pytest.raises(UsageError, match=r"did you mean robot/A1\? expected one of robot/A1, robot/B1"):
        site.opened("z", "Z9", isolated="A2", of=site.path / "hall")
    with pytest.raises(UsageError, match="expected both"):
        site.opened("z", "Z9", isolated=A)


def test_it_goes_on_from_the_fleets_run_whatever_else_was_recorded_beside_it_since(site: Site) -> None:
    site.task(site.hall, DRIVE)
    for folder in ("hall", "other"):
        fsar_ledger.record(site.path / folder, run="badges").close()
    with pytest.raises(UsageError, match="found no run of a live fleet"):
        site.opened("a1", "A1", isolated=A, of=site.path / "other")
    with site.opened("hall", "B1 alone", isolated=B, of=site.path / "hall"), site.alone() as own:
        site.does(own, "t1/1.1")
        [began] = [one for one in record(site.path / "a1", "A1").events if isinstance(one, IsolationBegan)]
    assert began.fleet_run == "morning"
    assert compared_with_fleet(site.path / "a1", site.path / "hall").ok


def test_a_log_of_ledgers_is_no_ledger_of_a_fleet_or_a_robot(site: Site) -> None:
    site.opened("a1", "A1", isolated="A1", of=site.path / "hall", origin="site/a1").close()
    fsar_ledger.shards(site.path / "log", [site.path / "hall", site.path / "a1"])
    log = fsar_ledger.open_ledger(site.path / "log")
    for asked in (
        lambda: isolation_of(site.path / "log", A),
        lambda: compared_with_fleet(site.path / "a1", site.path / "log"),
        lambda: compared_with_fleet(site.path / "log", site.path / "hall"),
        lambda: log.hand_over(run="A1"),
    ):
        with pytest.raises(UsageError, match="log: found the log of a federation, expected the ledger of a fleet or a"):
            asked()


@pytest.mark.slow
def test_every_event_of_a_fleet_that_took_a_run_over_has_its_why(site: Site) -> None:
    site.task(site.hall, DRIVE, DRIVE)
    with site.alone() as own:
        site.does(own, "t1/1.1")
        site.does(own, "t1/2.1")
        fields = site.to_hand_over()
    site.tell(site.hall, A, "HandOver", **fields)
    hall = fsar_ledger.open_ledger(site.path / "hall")
    taken = [row["seq"] for row in hall.sql("SELECT seq FROM events WHERE seq >= 40 ORDER BY seq")]
    assert len(taken) > 5
    for seq in taken:
        assert hall.why(f"1:{seq}")


def test_a_run_is_handed_over_once(site: Site) -> None:
    site.task(site.hall, DRIVE)
    with site.alone() as own:
        site.does(own, "t1/1.1")
        fields = site.to_hand_over()
    assert site.tell(site.hall, A, "HandOver", **fields).rejected is None
    again = site.tell(site.hall, A, "HandOver", **fields)
    assert again.rejected == "A1 was handed over before, expected a run that was not"


def test_the_fleet_does_not_know_a_task_that_came_while_the_robot_was_alone(site: Site) -> None:
    with site.alone() as own:
        site.task(own, DRIVE, name="t9")
        site.does(own, "t9/1.1")
        fields = site.to_hand_over()
    found = of(site.tell(site.hall, A, "HandOver", **fields), IsolatedResultOvertaken)
    assert [(one.subject.task_id, one.reason) for one in found] == [("t9", "the fleet does not know the task")]


def test_a_failure_alone_is_recorded_and_leaves_the_step_to_be_done(site: Site) -> None:
    site.task(site.hall, DRIVE)
    with site.alone():
        fields = site.to_hand_over()
    done = site.tell(site.hall, A, "HandOver", **{**fields, "results": ["t1/1 failure"]})
    assert [one.result for one in of(done, IsolatedResultAccepted)] == ["failure"]
    assert site.hall.state.task["t1"].step == 0
    assert of(site.does(site.hall, "t1/1.1"), TaskCompleted)


def test_a_robot_alone_goes_on_with_the_fleet_of_the_ledger_and_with_its_own_run(site: Site) -> None:
    with pytest.raises(UsageError, match="isolated: found a fleet or settings, expected only those of the ledger"):
        site.opened("a1", "A1", isolated=A, of=site.path / "hall", robots=4)
    site.hall.close()
    with pytest.raises(UsageError, match="run morning: found another run, expected that of robot/A1 alone"):
        site.opened("hall", "morning", isolated=A, of=site.path / "hall")
    with pytest.raises(UsageError, match="found no fleet with robot/Z9"):
        site.opened("z", "Z9", isolated="robot/Z9", of=site.path / "hall")
    assert not (site.path / "z").exists()


# --- both ledgers beside each other ---


def compared(site: Site) -> list[str]:
    found = fsar_ledger.open_ledger(site.path / "a1").verify(of=site.path / "hall")
    assert found.fleet is not None
    assert found.ok is not bool(found.fleet.differences)
    return [f"{one.seq} {one.field}" for one in found.fleet.differences]


def handed(site: Site, **changed: Any) -> None:
    site.task(site.hall, DRIVE)
    with site.alone() as own:
        site.does(own, "t1/1.1")
        fields = site.to_hand_over()
    assert site.tell(site.hall, A, "HandOver", **{**fields, **changed}).rejected is None


def test_what_was_handed_over_as_it_is_on_record_agrees(site: Site) -> None:
    handed(site)
    site.task(site.hall, DRIVE, name="t2")
    assert compared(site) == []
    found = fsar_ledger.open_ledger(site.path / "a1").verify(of=site.path / "hall").fleet
    assert found is not None
    assert (found.runs, found.handed_over) == (1, 1)


def test_a_ledger_in_doubt_is_not_compared_and_the_fleets_is_not_read(site: Site) -> None:
    handed(site)
    (site.path / "a1" / "stray").touch()
    (site.path / "hall" / "stray").touch()
    found = fsar_ledger.open_ledger(site.path / "a1").verify(of=site.path / "hall")
    assert [problem.where for problem in found.problems] == ["stray"]
    assert found.fleet is not None
    assert found.fleet.runs == 0


@pytest.mark.parametrize(
    ("name", "changed"),
    [
        ("results", ["t1/1 failure"]),
        ("results", []),
        ("since_us", 5),
        ("isolated_seq", 3),
        ("isolated_root", "0" * 64),
    ],
)
def test_who_hands_over_anything_else_than_is_on_record_is_found(site: Site, name: str, changed: Any) -> None:
    handed(site, **{name: changed})
    assert [one.rpartition(" ")[2] for one in compared(site)] == [name]


def founded_otherwise(site: Site, **changed: Any) -> None:
    found = isolation_of(site.path / "hall", A)
    began = replace(found.began, **{name: one for name, one in changed.items() if name != "founding"})
    founding = changed.get("founding", lambda events: events)(found.founding)
    Federation(
        site.path / "a1",
        "A1",
        found.constants,
        1,
        lambda: site.now * 10**9,
        isolation=found._replace(began=began, founding=founding),
    ).close()


def test_a_robot_that_gives_itself_what_it_does_not_have_is_found(site: Site) -> None:
    founded_otherwise(
        site,
        founding=lambda events: tuple(
            replace(event, capability="carry.heavy")
            if isinstance(event, CapabilityInstalled) and event.capability == "carry.package"
            else event
            for event in events
        ),
    )
    assert compared(site) == ["3 None"]
    site.hall.close()


@pytest.mark.parametrize(
    ("changed", "found"),
    [
        ({"fleet_root": "0" * 64}, "fleet_root"),
        ({"fleet_run": "evening"}, "fleet_root"),
        ({"fleet_seq": 1}, "began"),
        ({"fence": 7}, "began"),
    ],
)
def test_a_robot_that_names_another_beginning_is_found(site: Site, changed: dict[str, Any], found: str) -> None:
    founded_otherwise(site, **changed)
    assert [one.rpartition(" ")[2] for one in compared(site)] == [found]


def test_a_ledger_without_a_robot_alone_has_nothing_to_compare(site: Site) -> None:
    site.alone().close()
    with pytest.raises(UsageError, match="found no run of a robot alone"):
        fsar_ledger.open_ledger(site.path / "hall").verify(of=site.path / "a1")
    with pytest.raises(UsageError, match="quick and of: expected one of them"):
        fsar_ledger.open_ledger(site.path / "a1").verify(of=site.path / "hall", quick=True)


def alone(decided_by: str) -> Any:
    began = event("IsolationBegan", 0, robot=A, fleet_run="morning", fleet_seq=9, fleet_root="00")
    return run(
        event("RobotJoined", 0, robot=A, role="A", supervisor="supervisor/A1"),
        began,
        act("OwnStepDecided", S, "t/1.1", decided_by=decided_by, executed_by=A, path=(decided_by,)),
    )


def test_own_steps_of_a_robot_alone_are_cases_of_a1_and_nobody_else_decides_them() -> None:
    assert answer("invariants/a1_local_runtime_self_sufficiency", alone(A), columns=("seq",)) == []
    found = answer("invariants/a1_local_runtime_self_sufficiency", alone("service/coordination"), columns=("found",))
    assert len(found) == 1
    assert answer("audit/isolations", alone(A), columns=("robot", "fleet_run")) == [(A, "morning")]
