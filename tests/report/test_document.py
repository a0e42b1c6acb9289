"""What the PDF prints against what the queries answer."""

import shutil
import tomllib
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path
from typing import Any

import msgspec
import pytest

from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.metrics import verdicts
from fsar_ledger.metrics.database import connect
from fsar_ledger.metrics.results import metric_rows, statistic_rows
from fsar_ledger.report import document, result_rows, specs
from fsar_ledger.report.findings import SCENARIOS, Findings, answer, significance_level, with_agreement
from fsar_ledger.report.gather import gather
from tests.quick import few
from tests.sure import known

Make = Callable[..., Path]


@pytest.fixture(scope="module")
def printed(findings: Findings) -> dict[str, Any]:
    """The data of the template, read back from its bytes."""
    decoded: dict[str, Any] = msgspec.json.decode(document.encoded(document.data(findings, None)))
    return decoded


def values(printed: dict[str, Any], table: str, key: str) -> list[Any]:
    position = [column.key for column in specs.table(table).column].index(key)
    return [row[position]["value"] for row in printed["tables"][table]["rows"]]


def keys_of(printed: dict[str, Any], table: str, second: str = "architecture") -> list[tuple[str, str]]:
    """The metric of each row and what it is of."""
    return list(zip(values(printed, table, "metric"), values(printed, table, second), strict=True))


def test_evaluation_table_holds_the_query_rows(ledger: Path, printed: dict[str, Any]) -> None:
    with connect(ledger) as database:
        rows = {(row.metric, row.architecture): row for row in metric_rows(database)}
    keys = keys_of(printed, "evaluation-results")
    assert len(keys) == len(set(keys)) == 24
    assert values(printed, "evaluation-results", "mean") == [rows[key].mean for key in keys]
    assert values(printed, "evaluation-results", "denominator") == [rows[key].denominator for key in keys]
    intervals = [None if rows[key].ci_low is None else [rows[key].ci_low, rows[key].ci_high] for key in keys]
    assert values(printed, "evaluation-results", "interval") == intervals
    assert len({mean for mean in values(printed, "evaluation-results", "mean") if mean is not None}) > 8


def test_evaluation_table_prints_the_papers_own_digits_and_our_mean_in_the_same_unit(printed: dict[str, Any]) -> None:
    rows = printed["tables"]["evaluation-results"]["rows"]
    assert [row[2]["printed"] for row in rows] == [row["mean"] for row in specs.paper_table("results")]
    fsar_success, cfc_human = rows[0][3], rows[19][3]
    assert fsar_success["printed"] == f"{100 * fsar_success['value']:.1f}"
    assert cfc_human["printed"] == f"{100 * cfc_human['value']:.1f}"


def test_answers_are_those_of_the_rule(ledger: Path, printed: dict[str, Any]) -> None:
    with connect(ledger) as database:
        judged = {(one.metric, one.architecture): one for one in verdicts.compare(metric_rows(database))}
    keys = keys_of(printed, "evaluation-results")
    expected = [None if judged[key].ours is None else judged[key].gives for key in keys]
    assert values(printed, "evaluation-results", "gives") == expected
    assert {"no", "undecided"} <= set(expected)


def test_significance_table_holds_the_query_rows(ledger: Path, printed: dict[str, Any]) -> None:
    with connect(ledger) as database:
        rows = {(row.metric, row.comparison): row for row in statistic_rows(database)}
    keys = keys_of(printed, "statistical-significance", "comparison")
    assert len(set(keys)) == 24
    for name in ("t", "p", "p_holm", "wilcoxon_p", "n"):
        assert values(printed, "statistical-significance", name) == [getattr(rows[key], name) for key in keys]
    assert values(printed, "statistical-significance", "paper_t") == [
        float(row["t"]) for row in specs.paper_table("significance")
    ]


def test_scenario_table_holds_the_query_rows(ledger: Path, printed: dict[str, Any]) -> None:
    with connect(ledger) as database:
        rows = {
            (row.metric, row.architecture, row.scenario): row.mean for row in metric_rows(database, by_scenario=True)
        }
    for scenario in SCENARIOS:
        expected = [rows[metric, architecture, scenario] for metric, architecture in keys_of(printed, "scenario-means")]
        assert values(printed, "scenario-means", scenario) == expected


def test_undefined_metric_is_printed_as_a_dash_and_named(printed: dict[str, Any]) -> None:
    table = printed["tables"]["scenario-means"]["rows"]
    containment = next(row for row in table if row[0]["value"] == "recovery_containment")
    assert (containment[2]["value"], containment[2]["printed"]) == (None, "–")
    assert (
        "Reassignment latency (s) of DHMA" in printed["answer"]["undefined"]
    )  # every failure of DHMA waits for a human in this ledger


@pytest.mark.slow
def test_missing_architectures_are_named_and_their_cells_are_empty(make_ledger: Make) -> None:
    found = gather(make_ledger(architectures=("fsar",)))
    said = answer(found)
    assert said["missing_architectures"] == ["CFC", "DHMA"]
    assert said["judged"] <= 8
    assert said["tested"] == 0
    assert all(row["mean"] is None and row["gives"] is None for row in found.cells if row["architecture"] != "fsar")
    assert [row["paper_printed"] for row in found.cells] == [row["mean"] for row in specs.paper_table("results")]


def test_cells_that_the_model_does_not_give_are_listed_farthest_first(
    findings: Findings, printed: dict[str, Any]
) -> None:
    missed = [row for row in findings.cells if row["gives"] == "no"]
    assert len(printed["misses"]) == len(missed) > 0
    distances = [abs(float(miss["distance"].replace("\u2212", "-"))) for miss in printed["misses"]]
    assert distances == sorted(distances, reverse=True)


def test_reasons_name_cells_of_the_results_table(findings: Findings) -> None:
    cells = {f"{row['metric']}/{row['architecture']}" for row in findings.cells}
    assert {passage.id for passage in specs.passages("reasons")} <= cells


SHAPES = {
    "workflows only": (
        ("workflow-door-relay", "workflow-layered-recovery"),
        (),
        "2 runs of workflow-door-relay, 2 runs of workflow-layered-recovery",
    ),
    "some scenarios": (SCENARIOS[:2], (), "2 runs of collaborative-delivery, 2 runs of door-relay"),
    "uneven runs": (SCENARIOS, SCENARIOS[:1], "3 runs of door-relay, 2 runs of failure-recovery-chain"),
}


@pytest.mark.parametrize("shape", few(["workflows only", "uneven runs", "some scenarios"], ["workflows only"]))
def test_runs_of_another_shape_than_the_papers_have_numbers_and_no_verdict_and_that_is_said(
    make_ledger: Make, tmp_path: Path, shape: str
) -> None:
    scenarios, more, held = SHAPES[shape]
    path = shutil.copytree(make_ledger(scenarios=scenarios), tmp_path / "ledger")
    with Writer(path, "test") as writer:
        for scenario in more:
            kept = [run for run in open_ledger(path).runs() if run.run_id.startswith(f"{scenario}-1-")]
            events = [[msgspec.structs.replace(run.events[0], run=2), *run.events[1:]] for run in kept]
            writer.append(
                stage(
                    path,
                    [
                        LedgerRun(f"2-{run.run_id}", run.times_us, run.caused_by, one)
                        for run, one in zip(kept, events, strict=True)
                    ],
                )
            )
    found = gather(path)
    assert found.unjudged is not None
    assert (
        "The printed tables are over 5 scenarios with equally many runs of each, but of FSAR, CFC, DHMA this "
        "ledger has " in found.unjudged
    )
    assert held in found.unjudged
    assert sum(row["mean"] is not None for row in found.cells) > 18
    assert (
        {row[name] for row in found.cells for name in ("gives", "could", "distance")}
        == {row["verdict"] for row in found.features}
        == {None}
    )
    assert {row["sign_agrees"] for row in found.tests} == {row["level_agrees"] for row in found.tests} == {None}
    assert any(row["t"] is not None for row in found.tests)
    said = document.data(found, None)
    assert (said["unjudged"], said["misses"], said["answer"]["judged"]) == (found.unjudged, [], 0)


@pytest.mark.slow
def test_only_the_architecture_of_another_shape_is_not_judged(
    make_ledger: Make, findings: Findings, tmp_path: Path
) -> None:
    path = shutil.copytree(make_ledger(architectures=("fsar", "dhma")), tmp_path / "ledger")
    part = list(open_ledger(make_ledger(architectures=("cfc",), scenarios=SCENARIOS[1:])).runs())
    with Writer(path, "test") as writer:
        writer.append(stage(path, part))
    found = gather(path)
    assert found.unjudged is not None
    assert "but of CFC this ledger has 2 runs of collaborative-delivery, " in found.unjudged
    assert [row for row in found.cells if row["architecture"] != "cfc"] == [
        row for row in findings.cells if row["architecture"] != "cfc"
    ]
    assert {row["gives"] for row in found.cells if row["architecture"] == "cfc"} == {None}
    assert {row["comparison"] for row in found.tests if row["sign_agrees"] is not None} == {"fsar-dhma"}


def test_pairs_of_another_shape_than_the_papers_are_not_judged() -> None:
    runs: result_rows.RunCounts = dict.fromkeys(SCENARIOS, 2)
    even: result_rows.RunCounts = dict.fromkeys(SCENARIOS, 1)
    held, pairs = {"fsar": runs, "cfc": runs}, {"fsar-cfc": {**even, "door-relay": 2}}
    assert result_rows.unjudged(held, pairs) == {"fsar-cfc"}
    said = known(result_rows.why_unjudged(held, pairs))
    assert "but of FSAR vs CFC this ledger has 1 pair of collaborative-delivery, 2 pairs of door-relay, " in said
    assert result_rows.why_unjudged(held, {"fsar-cfc": even}) is None


@pytest.mark.slow
def test_single_run_has_values_and_no_verdict(make_ledger: Make) -> None:
    said = answer(gather(make_ledger(scenarios=("fleet-contention",), runs=1)))
    assert said["valued"] > 20
    assert said["judged"] == 0


def test_other_configurations_stand_in_their_own_table(make_ledger: Make) -> None:
    found = gather(make_ledger(architectures=("fsar",), configuration="without-shared-registry", fleet_size=8))
    assert answer(found)["judged"] == 0
    assert [(row["configuration"], row["fleet_size"], row["n"]) for row in found.others] == [
        ("without-shared-registry", 8, 10)
    ]
    assert "other-runs" in document.data(found, None)["tables"]


@pytest.mark.slow
def test_tables_are_of_one_seed_and_the_others_stand_apart(ledger: Path, tmp_path: Path, findings: Findings) -> None:
    several = shutil.copytree(ledger, tmp_path / "several")
    kept = [run for run in open_ledger(ledger).runs() if run.run_id.startswith("failure-recovery-chain-0-")]
    others = [
        LedgerRun(
            f"other-{run.run_id}",
            run.times_us,
            run.caused_by,
            [msgspec.structs.replace(run.events[0], seed=43), *run.events[1:]],
        )
        for run in kept
    ]
    with Writer(several, "test") as writer:
        writer.append(stage(several, others))
    found = gather(several)
    assert [row["mean"] for row in found.cells] == [row["mean"] for row in findings.cells]
    assert found.evidence == findings.evidence
    assert {(row["otherwise"], row["n"]) for row in found.others} == {("seed 43", 1)}
    assert found.shown == (
        "The tables are of seed 42, simulated runs, model 1; runs made otherwise are never taken together with these."
    )
    pooled = gather(several, pools_seeds=True)
    assert (pooled.others, max(row["n"] for row in pooled.cells)) == ((), 11)
    assert [row["architecture"] for row in pooled.background] == [row["architecture"] for row in findings.background]
    assert [(row["feature"], row["architecture"]) for row in pooled.evidence] == [
        (row["feature"], row["architecture"]) for row in findings.evidence
    ]


def test_pairs_that_met_different_worlds_are_named_in_the_document(findings: Findings) -> None:
    unlike = msgspec.structs.replace(findings, differing=("fsar-cfc: 1 pair \x1b[31m",))
    assert document.data(unlike, None)["differing"] == [r"fsar-cfc: 1 pair \x1b[31m"]
    template = specs.text("templates", "report.typ")
    assert (
        template.index("data.differing.join")
        < template.index("*The answer.*")
        < template.index('booktab("statistical-significance")')
    )


def test_the_answer_counts_cells_by_each_of_the_two_questions() -> None:
    def cell(mean: float | None, gives: str | None, could: str | None) -> dict[str, Any]:
        return {"metric": "governance_locality", "architecture": "fsar", "mean": mean, "gives": gives, "could": could}

    def test(t: float | None) -> dict[str, Any]:
        return with_agreement({"t": t, "p": 0.02, "paper_t": -2.0, "paper_level": "p<.05"})

    cells = (
        cell(0.9, "yes", "yes"),
        cell(0.8, "undecided", None),
        cell(0.7, "no", "no"),
        cell(0.6, "no", "yes"),
        cell(None, None, None),
    )
    blank = Findings(1, 1, "", 1, cells, (test(-1.0), test(1.0), test(None)), (), (), (), (), (), {}, ())
    said = answer(blank)
    assert [said[key] for key in ("cells", "valued", "judged", "gives", "gives_not", "undecided")] == [5, 4, 4, 1, 2, 1]
    assert [said[key] for key in ("drawn", "could", "could_not")] == [3, 2, 1]
    assert [said[key] for key in ("tests", "tested", "signs", "levels")] == [3, 2, 1, 2]


@pytest.mark.parametrize(
    ("p", "level"), [(0.0009, "p<.001"), (0.001, "p<.01"), (0.01, "p<.05"), (0.05, "n.s."), (1.0, "n.s.")]
)
def test_significance_level_is_the_papers(p: float, level: str) -> None:
    assert significance_level(p) == level


def test_head_and_query_hashes_are_those_of_the_ledger_and_the_files(ledger: Path, printed: dict[str, Any]) -> None:
    with connect(ledger) as database:
        assert database.head is not None
        assert printed["head"]["root"] == database.head.root
        hashes = {name: query.sha256 for name, query in database.library.queries.items()}
    names, digests = values(printed, "queries", "name"), values(printed, "queries", "sha256")
    assert {"metrics/metric_summary", "statistics/pairwise_tests", "facts/decisions"} <= set(names)
    assert digests == [hashes[name] for name in names]
    assert printed["tables"]["evaluation-results"]["source"] == "queries/metrics/metric_summary.sql"


def test_every_table_spec_is_used_and_every_figure_has_its_query(printed: dict[str, Any]) -> None:
    named = {entry.name.removesuffix(".toml") for entry in files("fsar_ledger.reports").joinpath("tables").iterdir()}
    from_the_fit = {"calibrated-parameters", "residuals", "directions"}
    of_other_ledgers = {
        *("mechanism-coverage", "ablation", "ablation-text", "encounters", "scaling"),
        *("beyond", "coordination-cost", "carried", "mechanism-differences"),
    }
    of_readings = {"every-reading", "rankings"}
    assert (
        named
        == set(printed["tables"])
        | from_the_fit
        | {"other-runs", "sensitivity", "predictions"}
        | of_other_ledgers
        | of_readings
    )
    for name in named:
        tomllib.loads(specs.text("tables", f"{name}.toml"))
        assert specs.table(name).caption
    for name, figure in printed["figures"].items():
        assert ("statistics/pairwise_tests.sql" if name == "effects" else "metrics/metric_summary.sql") in figure[
            "source"
        ]
        assert figure["alt"]


def test_what_stands_behind_the_numbers_is_said_where_they_stand(ledger: Path, printed: dict[str, Any]) -> None:
    with connect(ledger) as database:
        rows = [
            row
            for row in database.rows(
                "SELECT * FROM background ORDER BY list_position(['fsar', 'cfc', 'dhma'], architecture)"
            )
            if (row["configuration"], row["fleet_size"]) == ("full", 4)
        ]
        beside = {(row.metric, row.architecture): row.mean_without_routine for row in metric_rows(database)}
    keys = keys_of(printed, "evaluation-results")
    assert values(printed, "evaluation-results", "mean_without_routine") == [beside[key] for key in keys]
    for name in (
        "routine_share_of_decisions",
        "routine_share_of_local_decisions",
        "off_shift_share_of_coordination_events",
    ):
        assert values(printed, "background", name) == [row[name] for row in rows]
    assert [(one["architecture"].lower(), one["decisions"]) for one in printed["background"]] == [
        (row["architecture"], f"{100 * row['routine_share_of_decisions']:.1f}") for row in rows
    ]
