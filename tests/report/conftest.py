"""A small ledger, made of handwritten runs: enough for every metric to be defined, and different in every run."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest

from fsar_ledger.designs.registered import PAPER_SCENARIOS
from fsar_ledger.events import CONCERNS, Event
from fsar_ledger.events.authority import AuthorityClaimed
from fsar_ledger.events.configuration import Configuration
from fsar_ledger.events.envelope import (
    FLEET_SUPERVISOR,
    Architecture,
    Coordinator,
    Principal,
    Principals,
    RecoveryLevel,
    Robot,
    Scenario,
    Subject,
    Supervisor,
)
from fsar_ledger.events.execution import OwnStepDecided, RoutinePerformed
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.events.recovery import FailureResolved
from fsar_ledger.events.task import TaskCompleted
from fsar_ledger.events.world import PolicyWindowOpened
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.report.build import Document, write_report
from fsar_ledger.report.findings import Findings
from fsar_ledger.report.read import gather
from fsar_ledger.runtime.experiment import run_experiment, workflow_experiment
from tests import past

A = Robot("robot/A1")
ARRIVED = past.arrived("t1", A, ("A navigate.indoor",), due_us=60_000_001)
FAILED = past.failed(Subject("t1", "t1/1"), A, "obstruction", 1_000_000, 6)
ARCHITECTURES: tuple[Architecture, ...] = ("fsar", "cfc", "dhma")
PARAMETERS = '{"structure":{"poll_us":1000000},"world":{"message":{"high_s":0.5,"low_s":0.05},"motion_share":0.24}}'
Make = Callable[..., Path]


def _events(
    architecture: Architecture, configuration: Configuration, scenario: Scenario, fleet_size: int, run: int
) -> Iterator[tuple[int, Event]]:
    """One run: a task of one step that fails once, with more going wrong in later runs and other architectures."""
    bad = ARCHITECTURES.index(architecture) + run
    yield (
        0,
        RunStarted(
            kind="simulated",
            observes=CONCERNS,
            seed=42,
            architecture=architecture,
            configuration=configuration,
            scenario=scenario,
            fleet_size=fleet_size,
            run=run,
            model_version="1",
            parameters=PARAMETERS,
        ),
    )
    yield 1, ARRIVED
    yield 2, _decision("t1/1", A, (A,))
    for number in range(bad):
        action = f"t1/{number + 2}"
        yield 3, _decision(action, Coordinator("coordinator"), (A, Coordinator("coordinator")))
        for claimant in (A, Coordinator("coordinator")):
            yield (
                3,
                AuthorityClaimed(
                    subject=Subject("t1", action), dimension="override", claimant=claimant, reason="execution"
                ),
            )
    yield 4, PolicyWindowOpened(robot=A, scope="local", window="w1", outcome="deny")
    for _ in range(bad):
        yield 5, _motion()
    if scenario != "door-relay":  # containment and latency stay undefined there
        yield 6, FAILED
        level: RecoveryLevel = "local" if bad < 2 else "human"
        yield (6 + (1 + bad) * 700_000, FailureResolved(Subject("t1", "t1/1"), robot=A, failure=1, level=level))
    if bad > 2:
        yield (9_000_000, past.called(Subject("t1", "t1/1"), FLEET_SUPERVISOR, "recovery"))
    if bad < 3:
        yield 10_000_000, TaskCompleted(task_id="t1")


def _decision(action: str, decided_by: Principal, path: tuple[Principal, ...]) -> Event:
    origin = A if decided_by == "robot/A1" else None
    return OwnStepDecided(
        Subject("t1", action),
        Principals(
            decided_by=decided_by,
            requested_by=origin,
            executed_by=A,
            supervised_by=Supervisor("supervisor/A1"),
            path=path,
        ),
        capability="navigate.indoor",
    )


def _motion() -> Event:
    return RoutinePerformed(past.principals(A, A, A), robot=A, operation="motion")


def _record(
    architecture: Architecture, configuration: Configuration, scenario: Scenario, fleet_size: int, run: int
) -> LedgerRun:
    timed = list(_events(architecture, configuration, scenario, fleet_size, run))
    causes = [None, *range(len(timed) - 1)]
    name = f"{scenario}-{run}-{architecture}-{configuration}-{fleet_size}"
    return LedgerRun(name, [time for time, _ in timed], causes, [event for _, event in timed])


@pytest.fixture(scope="session")
def make_ledger(tmp_path_factory: pytest.TempPathFactory) -> Make:
    """A ledger of these architectures, in the given configuration and fleet size, two runs per scenario unless told."""

    def make(
        architectures: Sequence[Architecture] = ARCHITECTURES,
        configuration: Configuration = "full",
        fleet_size: int = 4,
        runs: int = 2,
        scenarios: Sequence[Scenario] = PAPER_SCENARIOS,
    ) -> Path:
        path = tmp_path_factory.mktemp("ledger") / "ledger"
        records = [
            _record(one, configuration, scenario, fleet_size, run)
            for scenario in scenarios
            for run in range(runs)
            for one in architectures
        ]
        with Writer(path, "test") as writer:
            if records:
                writer.append(stage(path, records))
        return path

    return make


@pytest.fixture(scope="session")
def ledger(make_ledger: Make) -> Path:
    """Three architectures, five scenarios, two runs of each."""
    return make_ledger()


@pytest.fixture(scope="session")
def workflows(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ledger of the paper's three workflows."""
    path = tmp_path_factory.mktemp("workflows") / "ledger"
    run_experiment(path, workflow_experiment(7), 1)
    return path


@pytest.fixture(scope="session")
def whole_report(ledger: Path, workflows: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of both ledgers under every reading, its numbers beside it as `report.pdf.json`."""
    out = tmp_path_factory.mktemp("report") / "report.pdf"
    write_report(ledger, out, workflows, numbers_out=out.with_name("report.pdf.json"))
    return out


@pytest.fixture(scope="session")
def findings(ledger: Path) -> Findings:
    """What that ledger says, with no ledger beside it."""
    return gather(ledger)


@pytest.fixture(scope="session")
def document(findings: Findings) -> Document:
    """The same, laid out."""
    return Document(findings)
