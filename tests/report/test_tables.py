"""What the tables print against what the queries answer, for runs of one setting and of the shape of the paper's."""

import shutil
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path

import msgspec
import pytest

from fsar_ledger.base.errors import UsageError
from fsar_ledger.designs.registered import PAPER_SCENARIOS, PAPER_WORKFLOWS
from fsar_ledger.events.configuration import PAPER_ARCHITECTURES
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.metrics import verdicts
from fsar_ledger.metrics.database import connect, plain_rows
from fsar_ledger.metrics.definitions import published_metrics
from fsar_ledger.metrics.results import metric_rows, statistic_rows
from fsar_ledger.report import judge, printing, specs
from fsar_ledger.report.build import Document
from fsar_ledger.report.findings import Findings
from fsar_ledger.report.read import gather
from fsar_ledger.runtime.experiment import run_experiment, workflow_experiment
from tests.queries.histories import answer
from tests.quick import few
from tests.report.conftest import PARAMETERS
from tests.report.made import column, made, names, part, said
from tests.sure import known

Make = Callable[..., Path]


@pytest.fixture(scope="module")
def flows(ledger: Path, workflows: Path) -> Document:
    """The report of the ledger with the one of workflows beside it."""
    return Document(gather(ledger, beside={workflows: None}))


def keys(document: Document, table: str, by: str = "architecture") -> list[tuple[str, str]]:
    return list(zip(column(document, table, "metric"), column(document, table, by), strict=True))


def test_the_results_are_the_rows_of_the_query_beside_the_papers_own_digits(ledger: Path, document: Document) -> None:
    with connect(ledger) as database:
        rows = {(row.metric, row.architecture): row for row in metric_rows(database)}
        judged = {(one.metric, one.architecture): one for one in verdicts.compare(rows.values())}
    found = keys(document, "evaluation-results")
    assert len(found) == len(set(found)) == 24
    for name, field in (("ours", "mean"), ("denominator", "denominator"), ("without_routine", "mean_without_routine")):
        assert column(document, "evaluation-results", name) == [getattr(rows[key], field) for key in found]
    intervals = [None if rows[key].ci_low is None else [rows[key].ci_low, rows[key].ci_high] for key in found]
    assert column(document, "evaluation-results", "interval") == intervals
    assert column(document, "evaluation-results", "printed") == [row["mean"] for row in specs.paper_table("results")]
    assert len({mean for mean in column(document, "evaluation-results", "ours") if mean is not None}) > 8
    words = {"yes": "stands", "no": "does not", "undecided": "undecided"}
    expected = ["undecided" if judged[key].ours is None else words[judged[key].gives] for key in found]
    assert column(document, "evaluation-results", "outcome") == expected
    assert {"does not", "undecided"} <= set(expected)


def test_the_tests_and_the_means_by_scenario_are_the_rows_of_their_queries(ledger: Path, document: Document) -> None:
    with connect(ledger) as database:
        tests = {(row.metric, row.comparison): row for row in statistic_rows(database)}
        means = {
            (row.metric, row.architecture, row.scenario): row.mean for row in metric_rows(database, by_scenario=True)
        }
    found = keys(document, "statistical-significance", "comparison")
    assert len(set(found)) == 24
    for name in ("t", "p", "p_holm", "wilcoxon_p", "n"):
        assert column(document, "statistical-significance", name) == [getattr(tests[key], name) for key in found]
    printed = [float(row["t"]) for row in specs.paper_table("significance")]
    assert column(document, "statistical-significance", "paper_t") == printed
    for scenario in PAPER_SCENARIOS:
        expected = [means[metric, name, scenario] for metric, name in keys(document, "scenario-means")]
        assert column(document, "scenario-means", scenario) == expected


def test_no_effect_size_is_judged_by_fewer_runs_than_the_papers(document: Document) -> None:
    assert max(column(document, "statistical-significance", "n")) < judge.PAPER_RUNS
    assert {*column(document, "statistical-significance", "chance")} == {None}
    assert {*column(document, "statistical-significance", "outcome")} == {"undecided"}


def test_an_undefined_number_is_a_dash(document: Document) -> None:
    relay = dict(
        zip(keys(document, "scenario-means"), column(document, "scenario-means", "door-relay", "printed"), strict=True)
    )
    assert relay["recovery_containment", "fsar"] == "–"


def test_what_stands_behind_the_numbers_is_said_where_they_stand(ledger: Path, document: Document) -> None:
    with connect(ledger) as database:
        rows = database.rows("SELECT * FROM background WHERE configuration = 'full' AND fleet_size = 4")
    assert len(rows) == 3
    for row in rows:
        share = f"{100 * row['routine_share_of_decisions']:.1f} % of {row['architecture'].upper()}'s decisions"
        assert share in said(document)


def test_a_number_that_does_not_come_out_has_its_reason_or_says_that_none_is_on_record(document: Document) -> None:
    missed = [row for row in document.numbers if row["table"] == "results" and row["outcome"] == "does not"]
    found = said(document)
    distances = [f"({printing.number(row['distance'], 1)} margins)" for row in missed]
    assert len(missed) > 0
    assert all(one in found for one in distances)
    assert "no reason is on record" in found
    cells = {f"{spec.name}/{name}" for spec in published_metrics() for name in PAPER_ARCHITECTURES}
    assert {row["id"] for row in specs.rows("reasons")} <= cells


SHAPES = {
    "workflows only": (
        ("workflow-door-relay", "workflow-layered-recovery"),
        (),
        "2 runs of workflow-door-relay, 2 runs of workflow-layered-recovery",
    ),
    "some scenarios": (PAPER_SCENARIOS[:2], (), "2 runs of collaborative-delivery, 2 runs of door-relay"),
    "uneven runs": (PAPER_SCENARIOS, PAPER_SCENARIOS[:1], "3 runs of door-relay, 2 runs of failure-recovery-chain"),
}


@pytest.mark.parametrize("shape", few(["workflows only", "uneven runs", "some scenarios"], ["workflows only"]))
def test_runs_of_another_shape_than_the_papers_have_numbers_and_no_verdict_and_that_is_said(
    make_ledger: Make, tmp_path: Path, shape: str
) -> None:
    scenarios, more, held = SHAPES[shape]
    path = shutil.copytree(make_ledger(scenarios=scenarios), tmp_path / "ledger")
    for scenario in more:
        kept = [run for run in open_ledger(path).runs() if run.run_id.startswith(f"{scenario}-1-")]
        with Writer(path, "test") as writer:
            writer.append(stage(path, [_with(run, "2", run=2) for run in kept]))
    found = gather(path)
    assert "5 scenarios with equally many runs of each, but of FSAR, CFC, DHMA this ledger has " in known(
        found.unjudged
    )
    assert held in known(found.unjudged)
    numbers = [one for one in found.numbers if one.table == "results"]
    assert sum(one.ours is not None for one in numbers) > 18
    assert {(one.gives, one.could, one.distance, one.outcome) for one in numbers} == {(None, None, None, "undecided")}
    document = Document(found)
    assert known(found.unjudged) in said(document, "note")
    assert {(row["sign_agrees"], row["outcome"]) for row in document.tests} == {(None, "undecided")}
    assert set(column(document, "architectural-comparison", "verdict")) == {None}
    assert set(column(document, "claims", "holds")) == {None}


def _with(run: LedgerRun, prefix: str, /, **fields: object) -> LedgerRun:
    first = msgspec.structs.replace(run.events[0], **fields)
    return LedgerRun(f"{prefix}-{run.run_id}", run.times_us, run.caused_by, [first, *run.events[1:]])


@pytest.mark.slow
def test_only_the_architecture_of_another_shape_is_not_judged(
    make_ledger: Make, findings: Findings, tmp_path: Path
) -> None:
    path = shutil.copytree(make_ledger(architectures=("fsar", "dhma")), tmp_path / "ledger")
    part_of_cfc = list(open_ledger(make_ledger(architectures=("cfc",), scenarios=PAPER_SCENARIOS[1:])).runs())
    with Writer(path, "test") as writer:
        writer.append(stage(path, part_of_cfc))
    found = gather(path)
    assert "but of CFC this ledger has 2 runs of collaborative-delivery, " in known(found.unjudged)
    others = [one for one in findings.numbers if one.architecture != "cfc"]
    assert [one for one in found.numbers if one.architecture != "cfc"] == others
    assert {one.gives for one in found.numbers if one.architecture == "cfc"} == {None}
    tests = Document(found).tests
    assert {row["comparison"] for row in tests if row["sign_agrees"] is not None} == {"fsar-dhma"}


def test_pairs_of_another_shape_than_the_papers_are_not_judged() -> None:
    runs: judge.RunCounts = dict.fromkeys(PAPER_SCENARIOS, 2)
    even: judge.RunCounts = dict.fromkeys(PAPER_SCENARIOS, 1)
    held, pairs = {"fsar": runs, "cfc": runs}, {"fsar-cfc": {**even, "door-relay": 2}}
    assert judge.unjudged(held, pairs) == {"fsar-cfc"}
    why = known(judge.why_unjudged(held, pairs))
    assert "but of FSAR vs CFC this ledger has 1 pair of collaborative-delivery, 2 pairs of door-relay, " in why
    assert judge.why_unjudged(held, {"fsar-cfc": even}) is None


@pytest.mark.slow
def test_a_single_run_has_values_and_no_verdict(make_ledger: Make) -> None:
    found = [
        one for one in gather(make_ledger(scenarios=("fleet-contention",), runs=1)).numbers if one.table == "results"
    ]
    assert sum(one.ours is not None for one in found) > 20
    assert {one.outcome for one in found} == {"undecided"}


def test_a_cell_that_a_single_constant_carries_is_judged_as_any_other(findings: Findings) -> None:
    judged = [one.gives for one in findings.numbers if one.kind == "dial" and one.ours is not None]
    assert judged
    assert None not in judged


@pytest.mark.slow
def test_runs_of_other_settings_stand_in_their_own_table(make_ledger: Make) -> None:
    made_otherwise = make_ledger(architectures=("fsar",), configuration="without-shared-registry", fleet_size=8)
    document = Document(gather(made_otherwise))
    found = zip(*(column(document, "other-runs", name) for name in ("configuration", "fleet_size", "n")), strict=True)
    assert list(found) == [("without-shared-registry", 8, 10)]
    assert "evaluation-results" not in names(document, "table")


@pytest.mark.slow
def test_tables_are_of_all_seeds_together(ledger: Path, tmp_path: Path, findings: Findings) -> None:
    several = shutil.copytree(ledger, tmp_path / "several")
    kept = [run for run in open_ledger(ledger).runs() if run.run_id.startswith("failure-recovery-chain-0-")]
    with Writer(several, "test") as writer:
        writer.append(stage(several, [_with(run, "other", seed=43) for run in kept]))
    document, alone = Document(gather(several)), Document(findings)
    assert "other-runs" not in names(document, "table")
    assert max(row["n"] for row in alone.numbers if row["table"] == "results") == 10
    assert max(row["n"] for row in document.numbers if row["table"] == "results") == 11
    assert column(document, "architectural-comparison", "feature") == column(
        alone, "architectural-comparison", "feature"
    )


@pytest.mark.slow
def test_constants_are_those_of_the_runs_in_the_tables_and_not_of_others_that_come_first(
    ledger: Path, tmp_path: Path, findings: Findings
) -> None:
    assert findings.parameters["world.motion_share"] == "0.24"
    several = shutil.copytree(ledger, tmp_path / "several")
    kept = [run for run in open_ledger(ledger).runs() if run.run_id.startswith("fleet-contention-0-")]
    with Writer(several, "test") as writer:
        writer.append(stage(several, [_with(run, "0", parameters='{"world":{"motion_share":0.5}}') for run in kept]))
    found = gather(several)
    assert (found.parameters, found.parameters_sha256) == (findings.parameters, sha256(PARAMETERS.encode()).hexdigest())
    assert len(column(Document(found), "models", "runs")) == 2


def test_pairs_that_met_different_worlds_are_named_before_the_answer(findings: Findings) -> None:
    unlike = Document(msgspec.structs.replace(findings, differing=("fsar-cfc: 1 pair \x1b[31m",)))
    assert "Not every pair of runs met the same world" in said(unlike, "note")
    assert "fsar-cfc: 1 pair x1b[31m" in said(unlike, "note")


@pytest.mark.parametrize(
    ("ours", "verdict"),
    [
        (("full", "full", "none"), "nobody"),
        (("full", "none", "none"), "CFC"),
        (("none", None, "full"), "FSAR, DHMA"),
        ((None, "full", None), "nobody"),
        ((None, None, None), None),
    ],
)
def test_a_feature_agrees_or_differs_where_the_ledger_shows_it(
    ours: tuple[str | None, ...], verdict: str | None
) -> None:
    rows = [
        {"feature": "single_agent_robot", "architecture": name, "grade": grade}
        for name, grade in zip(PAPER_ARCHITECTURES, ours, strict=True)
    ]
    rows.append({"feature": "layered_recovery", "architecture": "fsar", "grade": "full"})
    document = Document(made(features=rows))
    assert column(document, "architectural-comparison", "verdict")[0] == verdict
    assert "".join(column(document, "architectural-comparison", "fsar_paper", "printed")) == "●——●●●●●"
    shown = column(document, "architectural-comparison", "dhma_ours", "printed")[0]
    assert (shown == "n/a") == (ours[2] is None), "a dash would say that it is absent"
    heads = part(document, "architectural-comparison")["heads"]
    assert {"RoboOS", "JADE", "ALLIANCE"} <= set(heads)
    assert heads.count("ours") == 3, "nobody has run the others"


@pytest.mark.slow
def test_grades_and_cells_are_those_of_the_queries(ledger: Path, flows: Document) -> None:
    with connect(ledger) as database:
        rows = {
            (row["feature"], row["architecture"]): row["grade"]
            for row in plain_rows(database.query("tables/architecture_features"))
        }
    order = [row["feature"] for row in specs.paper_table("architecture_features")]
    for architecture in PAPER_ARCHITECTURES:
        ours = column(flows, "architectural-comparison", f"{architecture}_ours")
        assert ours == [rows[feature, architecture] for feature in order]
    paper = [row["workflow_2_layered_recovery"] or None for row in specs.paper_table("mechanism_coverage")]
    assert column(flows, "mechanism-coverage", "wf2_paper") == column(flows, "mechanism-coverage", "wf2_ours") == paper
    verdicts_of = dict(
        zip(
            column(flows, "mechanism-coverage", "mechanism"),
            column(flows, "mechanism-coverage", "verdict"),
            strict=True,
        )
    )
    assert {name for name, one in verdicts_of.items() if one != "agrees"} == {"Trust evaluation", "Delegation chain"}
    assert "capability-scoped" in said(flows)
    assert b"query: door.open.secure" in flows.drawings["workflow-door-relay.svg"]
    assert b"budget exhausted" in flows.drawings["workflow-layered-recovery.svg"]


def test_every_name_of_the_paper_has_its_words() -> None:
    held = {
        kind: [one["name"] for one in specs.labels() if one["kind"] == kind]
        for kind in ("feature", "mechanism", "workflow", "difference")
    }
    assert held["feature"] == [row["feature"] for row in specs.paper_table("architecture_features")]
    assert held["mechanism"] == [row["mechanism"] for row in specs.paper_table("mechanism_coverage")]
    assert held["workflow"] == list(PAPER_WORKFLOWS)
    for name in held["difference"]:
        workflow, mechanism, cell = name.split("/")
        assert workflow in PAPER_WORKFLOWS
        assert mechanism in held["mechanism"]
        assert cell


@pytest.mark.slow
def test_workflows_of_another_seed_have_no_part_in_the_table(make_ledger: Make, ledger: Path, tmp_path: Path) -> None:
    ours = make_ledger(architectures=("fsar",), scenarios=("workflow-door-relay",))
    several = shutil.copytree(ours, tmp_path / "several")
    kept = next(open_ledger(ours).runs())
    other = LedgerRun("another", (0,), (None,), [msgspec.structs.replace(kept.events[0], seed=43)])
    with Writer(several, "test") as writer:
        writer.append(stage(several, [other]))
    alone, found = (Document(gather(ledger, beside={path: None})) for path in (ours, several))
    assert "have no part in the table" not in said(alone)
    assert "Of these, 1 that was made with another seed" in said(found)
    assert part(alone, "mechanism-coverage")["rows"] == part(found, "mechanism-coverage")["rows"]


@pytest.mark.slow
def test_a_ledger_with_one_workflow_shows_what_it_has_and_one_with_none_is_refused(
    ledger: Path, make_ledger: Make, tmp_path: Path
) -> None:
    run_experiment(tmp_path / "one", workflow_experiment(7, 1, ("workflow-layered-recovery",)), 1)
    found = Document(gather(ledger, beside={tmp_path / "one": None}))
    assert "workflow-layered-recovery" in names(found, "figure")
    assert "workflow-door-relay" not in names(found, "figure")
    assert set(column(found, "mechanism-coverage", "verdict")) == {"agrees"}
    without = make_ledger(runs=1, architectures=("cfc",))
    with pytest.raises(UsageError, match="found no run of workflow-door-relay"):
        gather(ledger, beside={without: None}, workflows=without)
    with pytest.raises(UsageError, match=r"--with .* found no run of a workflow"):
        gather(ledger, beside={without: None})


def test_every_number_of_a_case_has_one_cell_with_claims_that_the_queries_know() -> None:
    printed = [(int(row["case"]), row["architecture"].lower()) for row in specs.paper_table("cases")]
    cells = specs.rows("cases")
    assert [(cell["case"], cell["architecture"]) for cell in cells] == printed
    taken = {row[0]: row[1:] for row in answer("cases/case_definitions", columns=("claim", "case_number", "is_taken"))}
    for cell in cells:
        assert taken[cell["claim"]] == (cell["case"], True)
        assert cell.get("of") is None or taken[cell["of"]] == (cell["case"], True)
        assert cell.get("other") is None or taken[cell["other"]] == (cell["case"], False)


def test_heads_and_query_hashes_are_those_of_the_ledger_and_the_files(
    ledger: Path, findings: Findings, document: Document
) -> None:
    with connect(ledger) as database:
        assert database.head is not None
        assert findings.heads["results"].root == database.head.root
        hashes = {name: query.sha256 for name, query in database.library.queries.items()}
    held = {one.name: one.sha256 for one in findings.sources}
    assert {"metrics/metric_summary", "statistics/pairwise_tests", "facts/decisions"} <= held.keys()
    assert held == {name: hashes[name] for name in held}
    assert database.head.root in said(document)
    assert part(document, "evaluation-results")["source"] == "queries/metrics/metric_summary.sql"
