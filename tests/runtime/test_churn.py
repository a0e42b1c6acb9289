"""Robots leave and return as the world has it: alike under everybody, and found out under FSAR."""

from dataclasses import dataclass
from typing import Any

import pytest
from msgspec.structs import replace

from fsar_ledger.base.errors import InvalidExperiment
from fsar_ledger.designs.constants import Constants, Membership, Outages, write_constants
from fsar_ledger.events import Event
from fsar_ledger.events.fleet import RobotCleared, RobotDeparted, RobotReturned, RobotSuspected
from fsar_ledger.events.request import GapDetected, RequestIssued
from fsar_ledger.events.world import LinkCameUp, LinkWentDown, RobotCalledAway, RobotCameBack, RobotWentOff
from fsar_ledger.ledger.rows.codec import LedgerRun, encode
from fsar_ledger.metrics.invariants import audit_rows, chosen
from fsar_ledger.runtime.experiment import Experiment
from fsar_ledger.runtime.run_replay import replay_run
from fsar_ledger.runtime.simulation import RunSpec, simulate_run
from fsar_ledger.runtime.world.schedule import schedule
from tests.quick import few
from tests.recycled import from_table
from tests.runtime.histories import finished
from tests.runtime.test_rule import GOVERNANCES, worlds_are_the_same

S = 1_000_000
MEMBERSHIP = Membership(away_rate_per_s=0.004, away_mean_s=90.0, heartbeat_us=5 * S)
CHURN = Constants(membership=MEMBERSHIP)
OF_IT = (RobotCalledAway, RobotWentOff, RobotCameBack)


def runs(constants: Constants, count: int = 6, scenario: str = "door-relay", size: int = 8) -> list[LedgerRun]:
    return [simulate_run(RunSpec(8, "fsar", "full", scenario, size, run), constants) for run in range(count)]


def of(record: LedgerRun, *kinds: type[Event]) -> list[tuple[int, Any]]:
    pairs = zip(record.times_us, record.events, strict=True)
    return [(time_us, event) for time_us, event in pairs if isinstance(event, kinds)]


def test_every_governance_meets_the_same_departures() -> None:
    found = [
        finished(RunSpec(3, architecture, configuration, "door-relay", 8, 1), CHURN)
        for architecture, configuration in GOVERNANCES
    ]
    assert {type(event) for event in found[0].events} >= set(OF_IT)
    assert worlds_are_the_same(found)


def test_departures_shift_no_other_draw_and_without_the_group_nothing_of_it_is_there() -> None:
    plain, churned = (schedule(constants, 3, "door-relay", 1, 8) for constants in (Constants(), CHURN))
    assert [event for _, event in churned if not isinstance(event, OF_IT)] == [event for _, event in plain]
    assert "membership" not in write_constants(Constants())


def test_who_is_called_away_says_so_before_it_is_off_and_has_departed_by_its_own_word() -> None:
    announced = 0
    for record in runs(CHURN):
        off = of(record, RobotWentOff)
        for time_us, event in of(record, RobotDeparted):
            if event.reason == "announced":
                announced += 1
                assert any(0 < at - time_us <= 2 * S and one.robot == event.robot for at, one in off)
                assert event.decided_by == event.robot
    assert announced > 10


def test_who_just_goes_is_found_out_after_both_budgets_and_returns_when_it_is_back() -> None:
    silent = 0
    for record in runs(CHURN):
        for time_us, event in of(record, RobotDeparted):
            if event.reason != "silent":
                continue
            silent += 1
            gone = max(at for at, one in of(record, RobotWentOff) if one.robot == event.robot and at < time_us)
            longest_us = MEMBERSHIP.heartbeat_us + MEMBERSHIP.suspect_us + MEMBERSHIP.depart_us
            assert MEMBERSHIP.depart_us < time_us - gone <= longest_us
            back = [at for at, one in of(record, RobotCameBack) if one.robot == event.robot and at > time_us]
            returned = [at for at, one in of(record, RobotReturned) if one.robot == event.robot and at > time_us]
            assert all(0 < at - min(back) < S for at in returned[:1])
    assert silent > 5


def test_a_link_that_is_down_for_long_makes_a_robot_wrongly_departed_and_for_a_moment_makes_it_suspected() -> None:
    unlinked = Constants(
        membership=replace(MEMBERSHIP, away_rate_per_s=0.0), outages=Outages(link_rate_per_s=0.01, link_mean_s=30.0)
    )
    kinds: list[type[Event]] = [RobotSuspected, RobotCleared, RobotDeparted, RobotReturned]
    counts = dict.fromkeys(kinds, 0)
    for record in runs(unlinked):
        down: dict[str, int] = {}
        for time_us, event in of(record, LinkWentDown, LinkCameUp, *counts):
            if isinstance(event, LinkWentDown):
                down[event.robot] = time_us
            elif type(event) in counts:
                counts[type(event)] += 1
                assert event.robot in down, "nobody is suspected whose heartbeats come"
    assert min(counts.values()) > 3


@dataclass(frozen=True)
class Case:
    """Constants under which members come and go, and the runs to look at."""

    constants: Constants
    scenario: str


CASES = [
    Case(CHURN, "door-relay"),
    Case(CHURN, "failure-recovery-chain"),
    Case(CHURN, "fleet-contention"),
    Case(Constants(membership=replace(MEMBERSHIP, away_rate_per_s=0.02, away_mean_s=30.0)), "mixed-trust-inspection"),
    Case(Constants(membership=MEMBERSHIP, outages=Outages(link_rate_per_s=0.01, link_mean_s=30.0)), "fleet-contention"),
]


@pytest.mark.parametrize("case", few(CASES, CASES[2:]), ids=lambda case: case.scenario)
def test_no_invariant_is_broken_where_members_come_and_go_and_every_run_replays(case: Case) -> None:
    records = runs(case.constants, 5, case.scenario)
    assert sum(len(of(record, RobotDeparted)) for record in records) > 5
    with from_table(encode(records)) as database:
        broken = {row.invariant: row.first_found for row in audit_rows(database, chosen(())) if row.events}
        unnamed = database.rows("SELECT run_id, action_id, found FROM i5_audit_attributability")
    nobody = {  # as with any outage: who finds nobody to ask has no executor on record, and I5 says so
        (record.run_id, event.subject.action_id) for record in records for _, event in of(record, GapDetected)
    } - {(record.run_id, event.subject.action_id) for record in records for _, event in of(record, RequestIssued)}
    assert {(row["run_id"], row["action_id"]) for row in unnamed} <= nobody
    assert {row["found"] for row in unnamed} <= {"no executor can be recovered"}
    assert set(broken) <= {"i5_audit_attributability"}
    assert replay_run(records[0]) is None


def test_what_makes_no_sense_is_refused() -> None:
    for constants in (
        Constants(membership=Membership(heartbeat_us=10)),
        Constants(membership=Membership(heartbeat_us=20 * S, suspect_us=15 * S)),
        Constants(membership=Membership(away_rate_per_s=0.1), outages=Outages(off_rate_per_s=0.1)),
    ):
        with pytest.raises(InvalidExperiment):
            Experiment(("fsar",), ("door-relay",), 1, 1, constants=constants)
