"""What a source does not record, by event type or field, is never held against anybody, and hides what rests on it."""

from collections.abc import Iterator, Sequence
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pytest

from fsar_ledger.designs.constants import Constants
from fsar_ledger.events.envelope import Architecture
from fsar_ledger.ledger.rows.codec import encode
from fsar_ledger.ledger.rows.schema import LAYOUTS, RECORDS
from fsar_ledger.metrics.definitions import metrics
from fsar_ledger.metrics.invariants import invariants
from fsar_ledger.metrics.library import library
from fsar_ledger.metrics.provenance import types_read
from fsar_ledger.runtime.simulation import SCENARIOS, RunSpec, simulate_run
from tests.queries.histories import answer
from tests.recycled import from_table

NEEDS = answer("facts/judged_records", columns=("judge", "record", "beside", "is_context"))
JUDGES = sorted({judge for judge, *_ in NEEDS})
INVARIANTS = [query.relation for query in invariants()]


def recorded(rows: pa.Table, name: str, records: Sequence[str]) -> pa.Table:
    """The rows of each run as a source would record them that records just this; the run's name says what it lacks."""
    values: dict[str, list[Any]] = {
        "run_id": [f"{run}:{name}" for run in rows["run_id"].to_pylist()],
        "observes": [None if said is None else [] for said in rows["observes"].to_pylist()],
        "records": [None if said is None else list(records) for said in rows["observes"].to_pylist()],
    }
    for column, texts in values.items():
        field = rows.schema.field(column)
        rows = rows.set_column(rows.schema.get_field_index(column), field, pa.array(texts, field.type))
    return rows


def is_of(rows: pa.Table, kind: str) -> pa.ChunkedArray:
    """Which events are of this type, in any version."""
    return pc.starts_with(rows["type"], f"{kind}.v")


def without(rows: pa.Table, record: str) -> pa.Table:
    """The rows without the events of this type, or without what they say in this field."""
    kind, _, field = record.partition(".")
    is_of_kind = is_of(rows, kind)
    if not field:
        return rows.filter(pc.invert(is_of_kind))
    texts = [None if hit else value for hit, value in zip(is_of_kind.to_pylist(), rows[field].to_pylist(), strict=True)]
    of_field = rows.schema.field(field)
    return rows.set_column(rows.schema.get_field_index(field), of_field, pa.array(texts, of_field.type))


def spec(architecture: Architecture, scenario: str, seed: int = 7, run: int = 3) -> RunSpec:
    return RunSpec(seed, architecture, "full", scenario, 4, run)


RESOLVED_BY_A_PEER = spec("fsar", "collaborative-delivery", seed=42, run=15)
EVERY = [*(spec(name, scenario) for name in ("fsar", "cfc", "dhma") for scenario in SCENARIOS), RESOLVED_BY_A_PEER]
FEW = [
    spec("fsar", "door-relay"),
    spec("fsar", "collaborative-delivery"),
    spec("fsar", "mixed-trust-inspection"),
    spec("fsar", "fleet-contention"),
    spec("cfc", "collaborative-delivery"),
    spec("cfc", "failure-recovery-chain"),
    spec("dhma", "door-relay"),
    RESOLVED_BY_A_PEER,
]
"""Runs of every scenario, in which everything occurs that occurs in all of them."""


def occurs_in(rows: pa.Table, record: str) -> pa.Table:
    """The rows of the runs in which there is an event of this type, or which say something in this field of it."""
    kind, _, field = record.partition(".")
    hits = is_of(rows, kind)
    if field:
        hits = pc.and_(hits, pc.is_valid(rows[field]))
    return rows.filter(pc.is_in(rows["run_id"], value_set=pc.unique(rows["run_id"].filter(hits))))


def variants(runs: Sequence[RunSpec]) -> Iterator[pa.Table]:
    """The runs whole, and once more without each event type and without each field where it occurs."""
    rows = encode([simulate_run(run, Constants()) for run in runs])
    yield recorded(rows, "nothing", RECORDS)
    for record in RECORDS:
        if held := occurs_in(rows, record):
            lacks = [name for name in RECORDS if f"{name}.".startswith(f"{record}.")]
            yield recorded(without(held, record), record, [name for name in RECORDS if name not in lacks])


@pytest.fixture(
    scope="module", params=[pytest.param("few", marks=pytest.mark.slow), pytest.param("every", marks=pytest.mark.soak)]
)
def found(request: pytest.FixtureRequest) -> dict[str, Any]:
    """What each invariant and metric says of each variant, and of what it says nothing."""
    with from_table(pa.concat_tables(variants(FEW if request.param == "few" else EVERY))) as database:
        offences = {name: set[tuple[str, str, int]]() for name in INVARIANTS}
        for name in INVARIANTS:
            for row in database.rows(f"SELECT DISTINCT run_id, seq FROM {name}"):
                run, _, lacks = row["run_id"].partition(":")
                offences[name].add((lacks, run, row["seq"]))
        hidden = {
            (row["judge"], row["run_id"].partition(":")[2]): row
            for row in database.rows("SELECT judge, run_id, not_observed, hides_offences FROM unobservable")
        }
        numbers = {
            (row["metric"], *row["run_id"].partition(":")[::2]): (row["numerator"], row["denominator"])
            for row in database.rows("SELECT metric, run_id, numerator, denominator FROM run_metrics")
        }
    return {"offences": offences, "hidden": hidden, "numbers": numbers}


def test_a_source_that_records_every_type_and_field_is_judged_as_one_that_observes_every_concern(
    found: dict[str, Any],
) -> None:
    hidden = {judge for judge, lacks in found["hidden"] if lacks == "nothing"}
    assert hidden.isdisjoint(JUDGES)


@pytest.mark.parametrize("invariant", INVARIANTS)
def test_what_is_not_recorded_makes_no_offence(found: dict[str, Any], invariant: str) -> None:
    whole = {(run, seq) for lacks, run, seq in found["offences"][invariant] if lacks == "nothing"}
    accused = {
        lacks
        for lacks, run, seq in found["offences"][invariant]
        if (run, seq) not in whole and not found["hidden"].get((invariant, lacks), {}).get("hides_offences")
    }
    assert accused == set(), f"name them for {invariant} in queries/facts/judged_records.sql: without them it accuses"


OF_WHAT_IS_ON_RECORD = "audit_attributability"
"""A share of the coordination events on record: without a type of them it is that of the others."""
COORDINATION = {kind.partition(".")[0] for (kind,) in answer("facts/event_classes", columns=("type",))}


@pytest.mark.parametrize("metric", [metric.name for metric in metrics() if metric.records])
def test_a_metric_has_the_same_value_without_a_record_or_none(found: dict[str, Any], metric: str) -> None:
    whole = {
        run: value for (name, run, lacks), value in found["numbers"].items() if (name, lacks) == (metric, "nothing")
    }
    other = {
        lacks
        for (name, run, lacks), value in found["numbers"].items()
        if name == metric
        and value not in (whole[run], (None, None))
        and not (metric == OF_WHAT_IS_ON_RECORD and lacks in COORDINATION)
    }
    assert other == set(), f"name them among the records of {metric} in reports/metrics.toml: without them it differs"


@pytest.mark.parametrize("judge", JUDGES)
def test_a_judge_needs_only_what_its_query_reads(judge: str) -> None:
    types = types_read(library(), library().relations[judge])
    read = {tag.partition(".")[0] for tag in (LAYOUTS if types is None else types)}
    needed = {record for one, record, _, _ in NEEDS if one == judge}
    assert {record.partition(".")[0] for record in needed} <= read
    assert needed - set(RECORDS) == set(), "these are no event types, and no fields of one that may be NULL"


def test_what_a_judge_lacks_is_named(found: dict[str, Any]) -> None:
    assert found["hidden"]["a1_local_runtime_self_sufficiency", "OwnStepDecided"]["not_observed"] == "OwnStepDecided"
    lacking = found["hidden"]["a5_audit_completeness", "ExecutionStarted.requested_by"]
    assert (lacking["not_observed"], lacking["hides_offences"]) == ("ExecutionStarted.requested_by", True)
