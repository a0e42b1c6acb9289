"""A plan is the only event of its run: both verifiers report a plan with company, and neither counts one as a run."""

from pathlib import Path

import pytest

from fsar_ledger.events import Event
from fsar_ledger.events.fleet import ExperimentPlanned
from fsar_ledger.events.task import TaskCompleted
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.verify import verify
from tests.ledger.agreement import Case, judged
from tests.ledger.hostile import stage_anything
from tests.ledger.samples import ORIGIN

PLAN = ExperimentPlanned(
    architectures=("fsar",),
    configurations=("full",),
    scenarios=("door-relay",),
    run_count=2,
    seed=42,
    fleet_size=4,
    model_version="2",
    parameters="{}",
)
TASK = TaskCompleted("T1")


def of(name: str, *events: Event) -> LedgerRun:
    return LedgerRun(name, range(len(events)), [None, *range(len(events) - 1)], events)


def write(path: Path, *batches: list[LedgerRun]) -> Path:
    """Write a ledger of these batches, without the checks of a writer."""
    with Writer(path, ORIGIN) as writer:
        for batch in batches:
            writer.append(stage_anything(path, batch))
    return path


def test_a_plan_alone_is_no_run_and_no_doubt(tmp_path: Path) -> None:
    path = write(
        tmp_path / "ledger", [of("plan", PLAN)], [of("run-1", TASK, TASK), of("another plan", PLAN), of("run-2", TASK)]
    )
    assert judged(Case("plans", path, True)).difference == ""
    report = verify(path)
    assert (report.ok, report.runs, report.events, report.commits) == (True, 2, 5, 2)


@pytest.mark.parametrize(
    ("events", "row"), [((PLAN, TASK), 0), ((TASK, PLAN), 1), ((TASK, PLAN, TASK), 1), ((PLAN, PLAN), 0)]
)
def test_a_plan_with_company_is_named_by_both_verifiers(tmp_path: Path, events: tuple[Event, ...], row: int) -> None:
    path = write(tmp_path / "ledger", [of("before", TASK), of("run-1", *events), of("after", TASK)])
    assert judged(Case("a plan with company", path, False)).difference == ""
    [problem] = verify(path).problems
    assert (problem.run, problem.seq, problem.field, problem.expected) == (
        "run-1",
        row,
        "type",
        "the only event of its run, as this type is",
    )
