"""Each reading of the paper changes what it says, on given rows, and nothing else."""

import re
from collections.abc import Iterator
from itertools import combinations as pairs_of

import pytest

from fsar_ledger.metrics.database import Database, from_rows
from fsar_ledger.metrics.definitions import metrics
from fsar_ledger.metrics.library import library
from fsar_ledger.metrics.multiverse import Multiverse, Reading, Relations, combinations, multiverse, readings
from fsar_ledger.metrics.results import metric_rows
from tests.queries.histories import Row, S, event, run
from tests.queries.reading_cases import CASES, DENIED, MOTION, claimed, decided, failed, started, window

METRICS = tuple(one.name for one in metrics())


def timed(events: list[Row]) -> list[Row]:
    """The events in the order of their times, those of one instant as they stand."""
    return sorted(events, key=lambda row: int(str(row["time_us"])))


CASE_ROWS = [
    row
    for name, (_, _, _, runs) in CASES.items()
    for at, events in enumerate(runs)
    for row in run(*timed(events), run_id=f"{name}-{at}", run=at, architecture=name)
]
"""The runs of all cases, those of each as an architecture of its own."""


@pytest.fixture(scope="module")
def cases() -> Iterator[Database]:
    with from_rows(CASE_ROWS) as database:
        yield database


@pytest.fixture(scope="module")
def relations(cases: Database) -> Relations:
    """What the cases are under each reading."""
    return Relations(cases, readings())


def means(relations: Relations, metric: str, *chosen: str) -> dict[str | None, float | None]:
    """The mean of this metric for each architecture under these readings."""
    return {one.architecture: one.mean for one in relations.means(metric, [chosen])}


def test_every_reading_has_a_case_here() -> None:
    assert CASES.keys() == {one.name for one in readings()}
    assert [name for name, (_, ours, theirs, _) in CASES.items() if ours == theirs] == []


@pytest.mark.parametrize("name", CASES)
def test_a_reading_changes_what_it_says(relations: Relations, name: str) -> None:
    metric, ours, theirs, _ = CASES[name]
    assert means(relations, metric)[name] == pytest.approx(ours)
    assert means(relations, metric, name)[name] == pytest.approx(theirs)


@pytest.mark.slow
def test_a_reading_changes_no_other_metric(relations: Relations) -> None:
    elsewhere = [
        (one.name, metric)
        for one in readings()
        for metric in METRICS
        if metric not in one.moves and one.replaces in closure(metric)
    ]
    ours = {metric: means(relations, metric) for metric in METRICS}
    assert {name for name, _ in elsewhere} >= {
        "denials_are_records",
        "tasks_are_pooled",
        "failures_by_run",
        "latency_of_departures",
    }, "there is something to try"
    assert [(name, metric) for name, metric in elsewhere if means(relations, metric, name) != ours[metric]] == []


def closure(metric: str) -> set[str]:
    """The relations that a metric is made of, and the definitions by which its runs are put together."""
    return {query.relation for query in library().needs([metric, "metric_definitions"])}


@pytest.mark.parametrize("one", readings(), ids=lambda one: one.name)
def test_a_reading_has_the_columns_of_what_it_replaces_and_moves_what_hangs_on_it(
    cases: Database, one: Reading
) -> None:
    assert cases.query(one.name).schema == cases.query(one.replaces).schema
    assert set(one.moves) <= set(METRICS)
    assert [metric for metric in one.moves if one.replaces not in closure(metric)] == []


def test_readings_of_one_question_and_metric_are_told_apart_and_both_are_not_taken() -> None:
    asked = {(one.question, one.name) for one in readings() if "governance_locality" in one.moves}
    questions = dict.fromkeys(question for question, _ in asked)
    found = combinations("governance_locality")
    assert (found[0], len(found), len(set(found)), len(questions)) == ((), 36, 36, 4)
    for chosen in found:
        answered = [question for question, name in asked if name in chosen]
        assert len(answered) == len(set(answered))


def test_readings_of_one_relation_say_the_same_in_any_order(cases: Database, relations: Relations) -> None:
    together = [
        (one, two)
        for one, two in pairs_of(readings(), 2)
        if one.replaces == two.replaces and one.question != two.question and set(one.moves) & set(two.moves)
    ]
    assert len(together) >= 12
    differing = []
    for one, two in together:
        found = []
        for first, second in ((one, two), (two, one)):
            cases.define(
                "first_reading",
                library()
                .relations[first.name]
                .reading_from({one.replaces: relations.under(one.replaces, frozenset())}),
            )
            found.append(
                cases.rows(
                    "SELECT * FROM "
                    f"({library().relations[second.name].reading_from({one.replaces: 'first_reading'})}) ORDER "
                    "BY ALL"
                )
            )
            cases.undefine("first_reading")
        if found[0] != found[1]:
            differing.append((one.name, two.name))
    assert differing == []


def test_no_step_of_a_query_hides_a_relation_that_a_reading_replaces() -> None:
    hidden = []
    for query in library().needs([*METRICS, *(one.name for one in readings())]):
        steps = set(re.findall(r"^(?:WITH )?(\w+) AS (?:MATERIALIZED )?\($", query.sql, flags=re.MULTILINE))
        hidden += [(query.relation, step) for step in steps & {one.replaces for one in readings()}]
    assert hidden == []


def test_what_is_not_observed_is_not_observed_under_any_reading() -> None:
    with from_rows(
        [*run(run_id="seen", architecture="fsar"), *run(run_id="blind", architecture="cfc", observes=["fleet"])]
    ) as database:
        found = multiverse(database, ["coordination_success", "recovery_containment", "human_intervention"])
    blind = [cell for cell in found.cells if cell.architecture == "cfc"]
    assert {
        (cell.lowest, cell.highest, cell.undefined == cell.combinations, cell.runs_not_observed) for cell in blind
    } == {(None, None, True, 1)}
    assert {(row.order, row.same_order, row.fsar_best, row.changed_under) for row in found.rankings} == {
        (None, None, None, None)
    }


REPORTED = event("RoutineReported", robot="robot/B1", requested_by="robot/B1", executed_by="robot/B1")
TOGETHER = [
    # Metric, readings, events, the mean as we read them, and the mean when all these readings replace ours.
    (
        "governance_locality",
        ("closings_decide_nothing", "denials_decide_each_time", "only_agents_are_traversed", "routine_decides_nothing"),
        [
            MOTION,
            decided("service/coordination", name="RequestClosed"),
            decided("robot/A1", "robot/A1", "robot/B1"),
            DENIED,
            DENIED,
        ],
        1 / 4,
        1 / 3,
    ),
    (
        "audit_attributability",
        (
            "absent_supervisors_are_missing",
            "denials_are_records",
            "handoffs_leave_no_records",
            "principals_on_the_record",
        ),
        [
            *(
                event("RobotJoined", robot="robot/B1", supervisor="supervisor/B1"),
                event("SupervisorLeft", supervisor="supervisor/B1"),
                REPORTED,
                decided("coordinator", name="RequestDenied"),
                event("InternalHandoff"),
            ),
            *(started(), event("ExecutionFinished", action_id="a1", robot="robot/B1", executed_by="robot/B1")),
        ],
        3 / 4,
        1 / 4,
    ),
    (
        "authority_conflicts",
        ("conflict_of_pair", "instants_are_shared"),
        [*claimed(0, "x", 5), *claimed(5, "y", 9), *claimed(5, "z", 9)],
        1.0,
        3.0,
    ),
    (
        "reassignment_latency_s",
        ("latency_of_departures", "ordered_retry_is_fleet"),
        [*failed(0, "local", after_us=S, ordered_by="coordinator"), *failed(0, "local", after_us=S, action="a2")],
        1.0,
        1 / 2,
    ),
    (
        "policy_violations",
        ("motions_are_no_actions", "review_is_no_denial"),
        [
            window("review"),
            MOTION,
            started(),
            *({**row, "time_us": 5} for row in (window("deny"), MOTION, started("a2"))),
        ],
        4.0,
        1.0,
    ),
]


@pytest.mark.parametrize(
    ("metric", "chosen", "events", "ours", "theirs"), TOGETHER, ids=[metric for metric, *_ in TOGETHER]
)
def test_readings_that_go_together_are_all_read(
    metric: str, chosen: tuple[str, ...], events: list[Row], ours: float, theirs: float
) -> None:
    with from_rows(run(*timed(events))) as database:
        parts = [tuple(name for name in chosen if name != left_out) for left_out in chosen]
        mine, together, *others = [
            one.mean for one in Relations(database, readings()).means(metric, [(), chosen, *parts])
        ]
    assert (mine, together) == pytest.approx((ours, theirs))
    assert [mean for mean in others if mean == together] == [], "each of them tells"


def test_a_run_that_is_not_observed_is_counted_by_no_convention() -> None:
    with from_rows(
        [*run(*failed(0, "human", after_us=S), run_id="seen"), *run(run_id="blind", observes=["fleet"])]
    ) as database:
        (mine,) = Relations(database, readings()).means("recovery_containment", [("published_convention",)])
    assert (mine.mean, mine.runs_not_observed) == (0.0, 1)


def test_where_no_run_failed_no_convention_makes_a_mean(relations: Relations) -> None:
    for metric in ("recovery_containment", "reassignment_latency_s"):
        assert means(relations, metric, "published_convention")["conflict_of_pair"] is None


def test_our_reading_is_the_mean_of_the_metrics(cases: Database, relations: Relations) -> None:
    table = {(row.metric, row.architecture): row.mean for row in metric_rows(cases)}
    assert {(metric, name): mean for metric in METRICS for name, mean in means(relations, metric).items()} == table


@pytest.mark.slow
def test_every_combination_is_the_same_bits_on_any_number_of_threads() -> None:
    assert len({repr(everything(threads)) for threads in (1, 2, 4)}) == 1


def everything(threads: int) -> Multiverse:
    with from_rows(CASE_ROWS, threads=threads) as database:
        return multiverse(database)
