"""What a run does not observe is not judged: not 0, not "holds"; and what is judged does not rest on it."""

import re
from collections.abc import Iterator, Sequence
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pytest

from fsar_ledger.events import BESIDE, CONCERNS, EVENT_TYPES
from fsar_ledger.events.configuration import PAPER_ARCHITECTURES
from fsar_ledger.events.retired import RETIRED_TYPES
from fsar_ledger.ledger.rows.codec import encode
from fsar_ledger.ledger.rows.schema import LAYOUTS
from fsar_ledger.metrics.database import Database
from fsar_ledger.metrics.invariants import audit_rows, invariants
from fsar_ledger.metrics.library import library
from fsar_ledger.metrics.provenance import is_judge, types_read
from fsar_ledger.metrics.results import metric_rows
from fsar_ledger.runtime.simulation import RunSpec, simulate_run
from tests.queries.histories import S, act, answer, event, run
from tests.recycled import from_rows, from_table
from tests.runtime.pinned import PINNED

OF_NO_CONCERN = {
    "RunStarted",
    "RunContinued",
    "ExperimentPlanned",
    "ShardRecorded",
    "SourceOpened",
    "Observed",
    "SourceClosed",
}
"""They say what a run is, and where it comes from."""

_JUDGED = answer("facts/judged_concerns")
NEEDED = {judge: {one[1] for one in _JUDGED if one[0] == judge} for judge, _, _ in _JUDGED}
CONCERN_OF = dict(answer("facts/event_concerns"))
ONLY_RECORDS = {"registry", "message"}
"""Of what `event_classes` names, what is a record and no decision."""
PRINCIPALS = {"decided_by", "requested_by", "executed_by", "supervised_by", "claimant", "sender", "receiver", "path"}


def concerns_with(fields: set[str]) -> set[str]:
    """The concerns of the event types that have one of these fields."""
    return {
        CONCERN_OF[tag]
        for tag, layout in LAYOUTS.items()
        if tag in CONCERN_OF and fields & {field.name for field in layout.fields}
    }


# --- the tables are complete ---


def test_every_event_type_is_of_one_concern_and_every_concern_has_event_types() -> None:
    known = {kind.__struct_config__.tag.partition(".")[0] for kind in (*EVENT_TYPES, *RETIRED_TYPES)}  # type: ignore[union-attr]
    assert {tag.partition(".")[0] for tag in CONCERN_OF} == known - OF_NO_CONCERN
    assert BESIDE.keys() <= known
    assert set(CONCERN_OF.values()) == set(CONCERNS)


def test_a_judge_is_known_as_one_wherever_something_can_say_that_it_is_not_judged() -> None:
    said = {judge for judge, *_ in answer("facts/judged_records")} | set(
        re.findall(r"'(\w+)'", library().find("censored").sql.partition("left_open AS (")[2])
    )
    assert len(said) > 20
    assert {
        judge for judge in (*said, *NEEDED) if not is_judge(library(), judge) and judge in library().relations
    } == set()
    assert not is_judge(library(), "denials")


def test_every_metric_invariant_mark_and_case_says_what_it_rests_on() -> None:
    metrics = {row[0] for row in answer("metrics/metric_definitions", columns=("metric",))}
    features = {part for *_, part in _rules()}
    with from_rows(run(scenario="workflow-door-relay")) as database:
        mechanisms = {row["mechanism"] for row in database.query("tables/mechanism_coverage").to_pylist()}
    cases = {row[0] for row in answer("cases/case_definitions", columns=("judge",))}
    judged = metrics | {query.relation for query in invariants()} | features | mechanisms | cases
    assert NEEDED.keys() == judged | {"coordination_cost"}, "queries/facts/judged_concerns.sql names each judge"
    assert set().union(*NEEDED.values()) <= set(CONCERNS)


def _rules() -> Iterator[tuple[str, str]]:
    with from_rows(run(observes=[])) as database:
        for row in database.query("tables/architecture_features").to_pylist():
            for part in row["evidence"].split("; "):
                yield row["feature"], part.removesuffix(" not observable")


@pytest.mark.parametrize(
    "judge",
    [query.relation for query in invariants()]
    + [row[0] for row in answer("metrics/metric_definitions", columns=("metric",))],
)
def test_a_judge_rests_on_the_concerns_of_all_events_that_its_query_reads(judge: str) -> None:
    types = types_read(library(), library().relations[judge])
    read = (
        concerns_with({"executed_by", "robot"})
        if types is None
        else {CONCERN_OF[tag] for tag in types if tag in CONCERN_OF}
    )
    if judge == "governance_locality":
        read -= ONLY_RECORDS
    if judge == "authority_conflicts":
        read -= {"fleet"}  # a departure ends claims, too, but what observes authority has their releases
    if judge == "i1_local_agent_coherence":
        read |= concerns_with(PRINCIPALS)
    assert NEEDED.get(judge) == read, f"{judge}: facts/judged_concerns says what it rests on"


# --- real runs, each also as a source would record it that does not observe one concern ---


def variants() -> Iterator[pa.Table]:
    """One run of each architecture in full, and once for each concern without its events; `run_id` is
    architecture:concern."""
    for architecture in PAPER_ARCHITECTURES:
        rows = encode([simulate_run(RunSpec(42, architecture, "full", "failure-recovery-chain", 4, 12), PINNED)])
        for missing in ("nothing", *CONCERNS):
            types = pa.array([tag for tag, concern in CONCERN_OF.items() if concern == missing], pa.string())
            left = rows.filter(pc.invert(pc.is_in(rows["type"], types)))
            values = {"run_id": [f"{architecture}:{missing}"] * len(left)}
            values["observes"] = [[one for one in CONCERNS if one != missing], *[None] * (len(left) - 1)]  # type: ignore[list-item]
            for name, column in values.items():
                left = left.set_column(
                    left.schema.get_field_index(name), name, pa.array(column, left.schema.field(name).type)
                )
            yield left


@pytest.fixture(scope="module")
def database() -> Iterator[Database]:
    with from_table(pa.concat_tables(variants())) as made:
        yield made


def test_a_metric_is_null_without_a_concern_that_it_rests_on_and_else_as_with_it(database: Database) -> None:
    rows = {(row["run_id"], row["metric"]): row for row in database.rows("SELECT * FROM run_metrics")}
    hidden = 0
    for (name, metric), row in rows.items():
        architecture, missing = name.split(":")
        numbers = [row[column] for column in ("numerator", "denominator", "value", "published_convention_value")]
        if missing in NEEDED[metric]:
            assert (numbers, row["not_observed"]) == ([None] * 4, missing)
            hidden += 1
        else:
            full = rows[f"{architecture}:nothing", metric]
            assert numbers == [
                full[column] for column in ("numerator", "denominator", "value", "published_convention_value")
            ], (name, metric)
            assert row["not_observed"] is None
    assert hidden == 3 * sum(len(NEEDED[metric]) for metric in {metric for _, metric in rows})


@pytest.mark.slow
def test_an_invariant_holds_of_no_run_that_lacks_what_it_rests_on_and_offences_are_never_made_of_gaps(
    database: Database,
) -> None:
    context = {(judge, concern) for judge, concern, is_context in answer("facts/judged_concerns") if is_context}
    kept = 0
    for query in invariants():
        found: dict[str, set[int]] = {}
        for row in database.rows(f"SELECT DISTINCT run_id, seq FROM {query.relation}"):
            found.setdefault(row["run_id"], set()).add(row["seq"])
        for architecture in PAPER_ARCHITECTURES:
            for missing in NEEDED[query.relation]:
                if (query.relation, missing) not in context:
                    partial = found.get(f"{architecture}:{missing}", set())
                    assert partial <= found.get(f"{architecture}:nothing", set()), (query.relation, missing)
                    kept += len(partial)
    assert kept > 100


def test_audit_judges_each_variant_so(database: Database) -> None:
    for row in audit_rows(database, invariants()):
        needed = NEEDED.get(row.invariant, set())
        assert (row.runs, row.runs_not_observed) == (len(CONCERNS) + 1, len(needed))
        assert row.holds is not True
        assert set((row.not_observed or "").split("; ")) == needed
        assert row.cases is not None
        assert row.events is not None
        assert row.events <= row.cases > 0
        assert row.architecture != "fsar" or (row.holds, row.events) == (None, 0), (
            "a gap in the record was taken for an offence"
        )


# --- small cases ---


JOINED = [event("RobotJoined", at, robot=f"robot/A{at}", supervisor=f"supervisor/A{at}") for at in (1, 2, 3)]
MEMBERSHIP: dict[str, Any] = {
    "kind": "foreign",
    "observes": ["fleet"],
    "seed": None,
    "scenario": None,
    "run": None,
    "fleet_size": None,
    "architecture": None,
}


def test_of_three_members_nothing_is_known_but_that_they_joined() -> None:
    with from_rows(run(*JOINED, **MEMBERSHIP)) as made:
        for audited in audit_rows(made, invariants()):
            assert (audited.holds, audited.events, audited.cases, audited.runs_not_observed) == (None, None, None, 1)
            assert audited.not_observed
        for row in metric_rows(made):
            assert (row.mean, row.ci_low, row.denominator, row.published_convention_mean) == (None, None, None, None)
            assert (row.n, row.runs_not_observed) == (0, 1)
        marks = made.query("tables/architecture_features").to_pylist()
        assert {(row["grade"], row["essential_share"]) for row in marks} == {(None, None)}
        assert all(" not observable" in row["evidence"] and "0/" not in row["evidence"] for row in marks)


def test_a_robot_that_is_named_shows_nothing_where_its_agents_may_be_named_in_what_is_not_recorded() -> None:
    asked = act("RequestIssued", 2 * S, "t1/1.1", requested_by=JOINED[0]["robot"])
    with from_rows(run(*JOINED, asked, **MEMBERSHIP | {"observes": ["fleet", "request"]})) as made:
        marks = {row["feature"]: row for row in made.query("tables/architecture_features").to_pylist()}
    assert marks["single_agent_robot"]["grade"] is None
    assert marks["single_agent_robot"]["evidence"] == "robots that appear as one principal not observable"


def test_a_member_that_joins_twice_is_an_offence_although_little_else_is_observed() -> None:
    with from_rows(run(*JOINED, JOINED[0], **MEMBERSHIP)) as made:
        found = {row.invariant: row for row in audit_rows(made, invariants())}
    broken = found.pop("i1_local_agent_coherence")
    assert (broken.holds, broken.events, broken.cases, broken.first_seq) == (False, 1, 4, 4)
    assert {row.holds for row in found.values()} == {None}


def test_a_run_in_which_nothing_happened_is_judged_and_says_of_how_much() -> None:
    with from_rows(run()) as made:
        assert [(row.holds, row.cases, row.events, row.not_observed) for row in audit_rows(made, invariants())] == [
            (None, 0, 0, None)
        ] * len(invariants())
        assert {row.metric: row.mean for row in metric_rows(made)}["policy_violations"] == 0


def test_a_member_or_an_obstruction_is_no_case_of_who_executes_and_what_a_robot_does_is() -> None:
    world = [event("ObstructionAppeared", 1, place="aisle")]
    moved = event("RoutinePerformed", 2, robot="robot/A1")
    with from_rows([*run(*JOINED, *world, run_id="r1"), *run(*JOINED, moved, run_id="r2")]) as made:
        sql = "SELECT run_id, cases FROM invariant_cases WHERE invariant = 'a2_coordination_only_federation'"
        assert [tuple(row.values()) for row in made.rows(sql)] == [("r2", 1)]


def test_a_decision_that_names_nobody_is_a_case_of_who_decides() -> None:
    with from_rows(run(*JOINED, event("RequestAdmitted", 4, path=[]))) as made:
        judged = next(row for row in audit_rows(made, invariants()) if row.invariant == "a4_thin_federation_interface")
    assert (judged.holds, judged.events, judged.cases) == (False, 1, 1)


def test_attributability_looks_at_each_record(database: Database) -> None:
    looked = database.rows(
        "SELECT run_id, cases FROM invariant_cases WHERE invariant = 'i5_audit_attributability' ORDER BY ALL"
    )
    assert looked == database.rows(
        "SELECT run_id, count(*) AS cases FROM coordination_events GROUP BY run_id ORDER BY ALL"
    )
    assert len(looked) > 3


def test_runs_that_do_not_observe_are_left_out_of_a_mean_and_counted() -> None:
    called = event("SupervisorCalled", 1, supervisor="supervisor/fleet")
    blind = [one for one in CONCERNS if one != "supervision"]
    with from_rows([*run(called, run_id="r1"), *run(run_id="r2"), *run(run_id="r3", observes=blind)]) as made:
        row = next(one for one in metric_rows(made) if one.metric == "human_intervention")
    assert (row.mean, row.n, row.denominator, row.runs_not_observed) == (0.5, 2, 2, 1)


def test_what_the_paper_counts_where_nothing_failed_is_not_said_of_a_run_that_does_not_observe_failures() -> None:
    rows = answer(
        "metrics/run_metrics",
        run(run_id="r1"),
        run(run_id="r2", observes=["task"]),
        columns=("run_id", "metric", "published_convention_value"),
    )
    found = {run_id: value for run_id, metric, value in rows if metric == "recovery_containment"}
    assert found == {"r1": 1.0, "r2": None}


def test_a_mechanism_that_a_workflow_does_not_record_is_no_empty_cell() -> None:
    def cells(observes: Sequence[str]) -> dict[str, str | None]:
        found = run(scenario="workflow-door-relay", observes=list(observes))
        return dict(answer("tables/mechanism_coverage", found, columns=("mechanism", "cell")))

    assert cells(CONCERNS)["registry_discovery"] is None
    assert cells([one for one in CONCERNS if one != "registry"])["registry_discovery"] == "not observable"


def test_events_that_contradict_the_declaration_are_listed() -> None:
    rows = answer(
        "audit/undeclared_events",
        run(*JOINED[:1], event("TaskCompleted", 9, task_id="t"), observes=["fleet", "weather"]),
    )
    assert sorted(rows, key=str) == [("r1", 2, "TaskCompleted.v1", "task"), ("r1", None, None, "weather")]
    assert answer("audit/undeclared_events", run(*JOINED)) == []


@pytest.mark.parametrize("record", ["TaskCompleted", "TaskArrived.robot"])
def test_events_of_which_a_run_says_that_it_records_their_type_contradict_nothing(record: str) -> None:
    done = event("TaskCompleted", 9, task_id="t")
    others = event("LinkWentDown", 9, robot="robot/A1")
    rows = answer("audit/undeclared_events", run(done, others, observes=[], records=[record]), columns=("type",))
    assert rows == [("LinkWentDown.v1",)]


def test_runs_that_do_not_observe_have_no_weight_in_a_pooled_metric() -> None:
    failed = [
        event("ExecutionFailed", 1, action_id="a", robot="robot/A1", failure=1, cause="obstruction"),
        event("FailureResolved", 2, action_id="a", robot="robot/A1", failure=1, level="human"),
    ]
    seen = [
        run(*failed, run_id="r1"),
        run(failed[0], run_id="r2"),
        run(*failed[:1], failed[1] | {"level": "peer"}, run_id="r3"),
    ]

    def containment(*runs: Sequence[Any]) -> tuple[float | None, ...]:
        with from_rows([row for rows in runs for row in rows]) as made:
            row = next(one for one in metric_rows(made) if one.metric == "recovery_containment")
        return row.mean, row.sd, row.n, row.ci_low, row.ci_high

    assert containment(*seen, *(run(run_id=f"x{at}", observes=["task"]) for at in range(5))) == containment(*seen)


def test_each_opening_of_a_source_has_its_own_end() -> None:
    opens = event("SourceOpened", S, source="s", format="f", adapter="a/1", clock="arrival")
    closes = [event("SourceClosed", at * S, source="s", until_us=at * S) for at in (2, 4)]
    found = answer("audit/recordings", run(opens, closes[0], opens, opens, closes[1], opens), columns=("until_us",))
    assert found == [(2 * S,), (None,), (4 * S,), (None,)]


def test_a_record_that_was_cut_at_first_counts_once_and_those_without_a_number_each() -> None:
    opens = event("SourceOpened", S, source="s", format="f", adapter="a/1", clock="arrival")
    told = event("Observed", S, source="s", kind="state", caused_by=None)
    lines = [told | {"record_number": number} for number in (1, 2, 2, None, None)]
    follows = event("TaskCompleted", S, task_id="t", caused_by=4)
    columns = ("record_count", "underived_count")
    assert answer("audit/recordings", run(opens, *lines, follows), columns=columns) == [(4, 3)]


def test_a_record_whose_event_has_another_cause_than_the_record_is_not_without_an_event() -> None:
    opens = event("SourceOpened", S, source="s", format="f", adapter="a/1", clock="source")
    asks, battery, ends = (
        event("Observed", S, source="s", kind="job", record_number=number, caused_by=None) for number in (1, 2, 3)
    )
    follows = [event("TaskArrived", S, task_id="t", caused_by=2), event("TaskCompleted", S, task_id="t", caused_by=3)]
    closes = event("SourceClosed", S, source="s", until_us=S)
    columns = ("record_count", "underived_count")
    rows = run(opens, asks, follows[0], battery, ends, follows[1], closes)
    assert answer("audit/recordings", rows, columns=columns) == [(3, 1)]


def test_a3_says_what_a_request_carried_only_where_it_carried_it() -> None:
    asks = act("RequestIssued", S, "t/1", requested_by="robot/A1", capability="c")
    for carried, found in (
        (None, "admitted as deny, which is no admission"),
        ("review", "admitted as deny although the request carried review"),
    ):
        admits = act("RequestAdmitted", 2 * S, "t/1", decided_by="robot/B1", outcome="deny")
        rows = run({**asks, "carried_policy": carried}, admits)
        assert answer("invariants/a3_no_silent_policy_override", rows, columns=("found",)) == [(found,)]
