"""What is counted is what was decided and recorded, not how often somebody looked."""

from functools import cache

import msgspec
import pytest

from fsar_ledger.designs.constants import Constants, Structure, WorldConstants
from fsar_ledger.events.envelope import Architecture
from fsar_ledger.ledger.rows.codec import encode
from fsar_ledger.metrics.results import metric_rows
from fsar_ledger.runtime.simulation import SCENARIOS, RunSpec, simulate_run
from tests.recycled import from_table

RUNS = 3
DENIALS_OF_STEPS = """
    SELECT coalesce(max(denials), 0) AS most, coalesce(sum(denials), 0)::BIGINT AS denials
    FROM (
        SELECT count(*) AS denials
        FROM decisions
        ASOF JOIN step_began AS steps
            ON decisions.run_id = steps.run_id AND decisions.task_id = steps.task_id AND decisions.seq > steps.seq
        WHERE decisions.decision_kind = 'denial' AND (steps.target_role IS NULL OR decisions.decided_by = 'coordinator')
        GROUP BY steps.run_id, steps.task_id, steps.step
    )
"""
COUNTS = """
    SELECT
        count(*) AS decisions, avg(is_local::INTEGER) AS locality, (SELECT count(*) FROM coordination_events) AS records
    FROM decisions
"""


class Counted(msgspec.Struct, frozen=True):
    """Over all runs: decisions, their local share, records, denials of steps that nobody asks for again, and the most
    of one step."""

    decisions: int
    locality: float
    records: int
    denials: int
    most: int


@cache
def counted(architecture: Architecture, name: str, length_us: int) -> Counted:
    """What is counted with this length of time in the structure."""
    constants = Constants(structure=msgspec.structs.replace(Structure(), **{name: length_us}))
    records = [
        simulate_run(RunSpec(42, architecture, "full", scenario, 4, run), constants)
        for scenario in SCENARIOS
        for run in range(RUNS)
    ]
    with from_table(encode(records), threads=1) as database:
        [counts], [denials] = database.rows(COUNTS), database.rows(DENIALS_OF_STEPS)
    return Counted(**counts, **denials)


@pytest.mark.parametrize(
    ("architecture", "name", "often_us", "seldom_us"),
    [
        ("fsar", "poll_us", 100_000, 5_000_000),
        pytest.param("cfc", "sync_period_us", 200_000, 5_850_000, marks=pytest.mark.slow),
        pytest.param("dhma", "back_off_us", 1_000_000, 7_000_000, marks=pytest.mark.slow),
    ],
)
def test_a_step_that_waits_is_denied_once_however_often_it_is_looked_at(
    architecture: Architecture, name: str, often_us: int, seldom_us: int
) -> None:
    for length_us in (often_us, seldom_us):
        found = counted(architecture, name, length_us)
        assert found.denials > 0
        assert found.most == 1


def test_a_coordinator_that_syncs_thirty_times_as_often_neither_decides_nor_records_more() -> None:
    often, seldom = counted("cfc", "sync_period_us", 200_000), counted("cfc", "sync_period_us", 5_850_000)
    # Truer copies move a step here and there, and with it some routine: one in a hundred.
    assert often.decisions <= seldom.decisions * 1.01
    assert often.records <= seldom.records * 1.01
    assert often.locality >= seldom.locality - 0.01


def attributability(architecture: Architecture, absence_s: float) -> tuple[float | None, int]:
    """The mean of the runs, and how many records in all are not attributable."""
    constants = Constants(world=msgspec.structs.replace(WorldConstants(), absence_s=absence_s))
    records = [
        simulate_run(RunSpec(42, architecture, "full", scenario, 4, run), constants)
        for scenario in SCENARIOS
        for run in range(RUNS)
    ]
    with from_table(encode(records), threads=1) as database:
        [mean] = [row.mean for row in metric_rows(database) if row.metric == "audit_attributability"]
        [lost] = database.rows("SELECT count(*) AS n FROM coordination_events WHERE NOT is_attributable")
    return mean, lost["n"]


@pytest.mark.parametrize("absence_s", [0.0, 100.0])
def test_under_fsar_nothing_is_ever_missing_however_long_supervisors_are_away(absence_s: float) -> None:
    """The cell is by construction: who owns the supervision can be recovered from a recorded absence. Reading: R8."""
    assert attributability("fsar", absence_s) == (1.0, 0)


@pytest.mark.parametrize("architecture", ["cfc", "dhma"])
def test_under_the_baselines_more_is_missing_than_supervisors(architecture: Architecture) -> None:
    mean, _ = attributability(architecture, 0.0)
    assert mean is not None
    assert mean < 0.9
