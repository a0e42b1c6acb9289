"""Three published systems differ in the same worlds by what each of them has, and are played again with a change."""

from collections import Counter
from functools import cache
from pathlib import Path
from typing import TypeVar

import pytest

from fsar_ledger.designs.constants import Constants, Outages
from fsar_ledger.events import Event
from fsar_ledger.events.authority import AuthorityClaimed
from fsar_ledger.events.execution import ExecutionStarted
from fsar_ledger.events.knowledge import ActivityHeard, BidReceived
from fsar_ledger.events.recovery import FailureResolved
from fsar_ledger.events.request import MessageUndelivered
from fsar_ledger.events.supervision import SupervisorCalled
from fsar_ledger.events.world import OutsiderRequestInjected
from fsar_ledger.runtime.simulation import RunSpec, simulate_run
from tests.foreign.verbs import ask
from tests.runtime.physics import MIXED

Kind = TypeVar("Kind", bound=Event)
SYSTEMS = ("roboos", "jade", "alliance")


@cache
def events(architecture: str, scenario: str, size: int = 4, outages: Outages | None = None) -> tuple[Event, ...]:
    """What six runs of the scenario record."""
    specs = [RunSpec(42, architecture, "full", scenario, size, run) for run in range(6 if size == 4 else 2)]
    return tuple(event for spec in specs for event in simulate_run(spec, Constants(outages=outages)).events)


def of(kind: type[Kind], architecture: str, scenario: str, size: int = 4, outages: Outages | None = None) -> list[Kind]:
    return [event for event in events(architecture, scenario, size, outages) if isinstance(event, kind)]


def test_who_serves_outsiders_follows_from_who_decides() -> None:
    """RoboOS has no channel for them, under JADE the asked agent's policy decides, under ALLIANCE a need is a need."""
    served = {}
    for name in SYSTEMS:
        injected = {event.task_id for event in of(OutsiderRequestInjected, name, "mixed-trust-inspection")}
        starts = of(ExecutionStarted, name, "mixed-trust-inspection")
        served[name] = len({event.subject.task_id for event in starts} & injected) / len(injected)
    assert served["roboos"] == 0.0
    assert served["alliance"] == 1.0
    assert 0.0 < served["jade"] <= 1.0
    assert not any(
        event.subject.task_id in {one.task_id for one in of(OutsiderRequestInjected, "fsar", "mixed-trust-inspection")}
        for event in of(ExecutionStarted, "fsar", "mixed-trust-inspection")
    )


def test_the_levels_in_use_are_those_that_each_has() -> None:
    levels = {name: {event.level for event in of(FailureResolved, name, "failure-recovery-chain")} for name in SYSTEMS}
    assert levels["jade"] == set()
    assert levels["alliance"] <= {"local", "peer"}
    assert "local" in levels["roboos"]
    assert "fleet" not in levels["roboos"]
    assert {
        event.supervisor for name in ("jade", "alliance") for event in of(SupervisorCalled, name, "fleet-contention")
    } == set()


def test_bids_and_motivations_compete_where_several_robots_can() -> None:
    bids = Counter(event.subject.action_id for event in of(BidReceived, "jade", "fleet-contention", 16))
    assert max(bids.values()) >= 3
    heard = of(ActivityHeard, "alliance", "fleet-contention", 16)
    assert len({(event.robot, event.peer) for event in heard}) > 10
    claims = Counter(event.subject.action_id for event in of(AuthorityClaimed, "alliance", "fleet-contention", 16))
    assert max(claims.values()) > 1
    one = simulate_run(RunSpec(42, "jade", "full", "fleet-contention", 4, 0), Constants()).events
    alone = Counter(event.subject.action_id for event in one if isinstance(event, BidReceived))
    assert max(alone.values()) == 1, "at four robots there is one that can"


def test_an_outage_is_met_by_what_each_has_for_it() -> None:
    """The platform of JADE reports what it cannot deliver; nobody does so elsewhere."""
    found = {name: len(of(MessageUndelivered, name, "door-relay", 16, MIXED)) for name in SYSTEMS}
    assert found["jade"] > 0
    assert found["roboos"] == found["alliance"] == 0


@pytest.fixture(scope="module")
def ledger(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("systems") / "ledger"
    chosen = [word for name in SYSTEMS for word in ("--architecture", name)]
    ask("simulate", path, *chosen, "--scenario", "door-relay", "--runs", "1", "--workers", "1").good()
    return path


@pytest.mark.slow
def test_a_run_is_played_again_with_a_fact_a_dial_or_the_architecture_changed(ledger: Path) -> None:
    for change in ("drop window:fleet/D1/0", "architecture fsar"):
        for run in ("1", "2", "3"):
            assert "they diverge at" in ask("whatif", ledger, "--run", run, "--change", change).out
    slower = ask("whatif", ledger, "--run", "3", "--change", "set alliance.impatience_us=15000000").good()
    assert "they diverge at" in slower.out
    refused = ask("whatif", ledger, "--run", "3", "--change", "rule fleet deny robot=B1")
    assert (refused.code, "alliance decides no such command" in refused.err) == (2, True)
