"""Predictions beside the paper's numbers: each registered prediction holds where its numbers do, and only there."""

import json
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest

from fsar_ledger.base.errors import FsarLedgerError, UsageError
from fsar_ledger.designs.constants import Constants, write_constants
from fsar_ledger.metrics.definitions import printed
from fsar_ledger.metrics.registration import registration
from fsar_ledger.metrics.study_results import METRICS, Predicted, Predictions, rules
from fsar_ledger.metrics.verdicts import MARGINS
from fsar_ledger.runtime.simulation import MODEL_VERSION, SCENARIOS
from fsar_ledger.studies.comparison import CHECKS, compared, judge
from fsar_ledger.studies.predictions import planned_experiments


def mean_of(metric: str, architecture: str, size: int) -> float:
    """Return the mean of a cell in a world in which every registered prediction holds."""
    if metric == "authority_conflicts":
        return 1.0 if architecture == "fsar" else 2.0
    return 0.4 if metric == "coordination_success" and size == 28 and architecture != "fsar" else 0.5


def every_number() -> list[Predicted]:
    return [
        Predicted(
            of=plan.of,
            seed=plan.seed,
            fleet_size=plan.experiment.fleet_size,
            teams_working=None
            if plan.experiment.constants.load is None
            else plan.experiment.constants.load.teams_working,
            encounter_mean_s=plan.experiment.constants.world.encounter_mean_s,
            configuration=configuration,
            architecture=architecture,
            scenario=scenario,
            metric=metric,
            mean=mean_of(metric, architecture, plan.experiment.fleet_size),
            sd=0.1,
            n=100,
            ci_low=None,
            ci_high=None,
        )
        for plan in planned_experiments()
        for configuration in plan.experiment.configurations
        for architecture in plan.experiment.architectures
        for scenario in (None, *SCENARIOS)
        for metric in MARGINS
    ]


NUMBERS = every_number()


def record(change: Callable[[Predicted], float | None] | None = None) -> Predictions:
    """Make a record of all numbers; `change` gives the mean of each."""
    numbers = NUMBERS if change is None else [msgspec.structs.replace(one, mean=change(one)) for one in NUMBERS]
    return Predictions(
        model_version=MODEL_VERSION,
        parameters=write_constants(Constants()),
        rules=rules(METRICS),
        numbers=numbers,
        cases=[],
    )


def holding(of: Predictions) -> dict[str, bool | None]:
    return {outcome.name: outcome.holds for outcome in compared(of).predictions}


def test_every_registered_prediction_is_checked_and_no_other() -> None:
    assert list(CHECKS) == [said.name for said in registration().prediction]


def test_all_predictions_hold_in_a_world_where_they_do() -> None:
    assert holding(record()) == dict.fromkeys(CHECKS, True)


def test_a_prediction_has_as_many_checks_as_it_names_numbers() -> None:
    found = {outcome.name: (outcome.held, outcome.of) for outcome in compared(record()).predictions}
    assert found == {
        "seeds": (2, 2),
        "twelve": (30, 30),
        "twenty-eight": (6, 6),
        "loads": (26, 26),
        "encounters": (7, 7),
        "triples": (24, 24),
    }


def is_success_of_a_triple(one: Predicted) -> bool:
    return one.of == "triples" and one.metric == "coordination_success" and one.scenario is None


@pytest.mark.parametrize(
    ("name", "is_hit", "mean"),
    [
        ("seeds", lambda one: one.of == "seeds", 0.93),
        ("twelve", lambda one: one.fleet_size == 12 and one.metric == "governance_locality", 0.53),
        ("twenty-eight", lambda one: one.fleet_size == 28 and one.metric == "governance_locality", 0.47),
        ("twenty-eight", lambda one: one.fleet_size == 28 and one.metric == "coordination_success", 0.4),
        ("loads", lambda one: one.of == "loads" and one.metric == "coordination_success", 0.6),
        ("loads", lambda one: one.of == "loads" and one.metric == "authority_conflicts", 0.7),
        ("encounters", lambda one: one.encounter_mean_s == 50 and one.metric == "coordination_success", 0.51),
        ("encounters", lambda one: one.encounter_mean_s == 200 and one.metric == "audit_attributability", 0.53),
        ("triples", is_success_of_a_triple, 0.56),
    ],
)
def test_a_number_beyond_what_is_implied_breaks_its_prediction_alone(
    name: str, is_hit: Callable[[Predicted], bool], mean: float
) -> None:
    found = holding(record(lambda one: mean if is_hit(one) else one.mean))
    assert found == {**dict.fromkeys(CHECKS, True), name: False}


def test_nothing_is_said_of_a_prediction_whose_number_is_undefined() -> None:
    assert holding(record(lambda one: None if is_success_of_a_triple(one) else one.mean))["triples"] is None


def test_a_sum_of_three_ablations_beyond_the_range_of_a_share_implies_nothing() -> None:
    def alone(one: Predicted) -> float | None:
        return (
            0.1
            if one.of == "ablation" and one.configuration != "full" and one.metric == "coordination_success"
            else one.mean
        )

    (triples,) = (outcome for outcome in compared(record(alone)).predictions if outcome.name == "triples")
    assert (triples.holds, triples.of) == (True, 20)


def test_every_printed_cell_is_answered_unless_its_dial_is_open() -> None:
    cells = compared(record()).cells
    assert Counter(cell.table for cell in cells) == {
        table: len(printed(table)) for table in ("results", "ablation", "ablation_text", "scaling")
    }
    assert {(cell.kind, cell.gives) for cell in cells if cell.gives is None} == {("unspecified", None)}
    assert all((cell.ours_one_team is None) == (cell.fleet_size == 4) for cell in cells)


def test_what_the_text_excludes_is_no_answer_of_ours_even_where_ours_is_the_same() -> None:
    cells = compared(record(lambda one: 0.97 if one.metric == "recovery_containment" else one.mean)).cells
    (excluded,) = (cell for cell in cells if (cell.table, cell.kind) == ("ablation", "cannot_follow"))
    assert (excluded.paper, excluded.ours, excluded.gives) == (0.97, 0.97, "no")


def test_the_comparison_is_written_whole(tmp_path: Path) -> None:
    (tmp_path / "predictions.json").write_bytes(msgspec.json.encode(record()))
    judge(tmp_path / "predictions.json", tmp_path / "out" / "comparison.json")
    written = json.loads((tmp_path / "out" / "comparison.json").read_text())
    assert written == msgspec.to_builtins(compared(record()))


@pytest.mark.parametrize(
    ("content", "said"),
    [(b"{", "truncated"), (b"\xff", "expected what"), (b"[]", "array"), (b'{"x":' + b"[" * 100_000, "expected what")],
)
def test_a_file_that_is_no_record_is_refused(tmp_path: Path, content: bytes, said: str) -> None:
    (tmp_path / "predictions.json").write_bytes(content)
    with pytest.raises(FsarLedgerError, match=said):
        judge(tmp_path / "predictions.json", tmp_path / "comparison.json")
    assert not (tmp_path / "comparison.json").exists()


def test_a_file_that_is_not_there_is_a_mistake_of_the_call(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="cannot be read"):
        judge(tmp_path / "none.json", tmp_path / "comparison.json")


def written(folder: Path, of: Predictions) -> Path:
    path = folder / "predictions.json"
    path.write_bytes(msgspec.json.encode(of))
    return path


def test_a_record_that_lacks_a_number_is_refused_by_its_place(tmp_path: Path) -> None:
    short = msgspec.structs.replace(record(), numbers=[one for one in NUMBERS if one.fleet_size != 12])
    with pytest.raises(FsarLedgerError, match=r"predictions\.json: found no .*12.*expected everything"):
        judge(written(tmp_path, short), tmp_path / "comparison.json")


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        (
            {"model_version": "1"},
            rf"predictions\.json: found predictions of model '1', expected model '{MODEL_VERSION}'",
        ),
        (
            {"parameters": "{}"},
            r"predictions\.json: found predictions with the constants 44136fa355b3 .*, "
            r"expected those of this version, \w{12};",
        ),
    ],
)
def test_predictions_of_another_model_or_other_constants_are_refused(
    tmp_path: Path, changed: dict[str, str], said: str
) -> None:
    with pytest.raises(UsageError, match=said):
        judge(written(tmp_path, msgspec.structs.replace(record(), **changed)), tmp_path / "comparison.json")
    assert not (tmp_path / "comparison.json").exists()


def test_a_comparison_never_replaces_the_predictions(tmp_path: Path) -> None:
    path = written(tmp_path, record())
    before = path.read_bytes()
    with pytest.raises(UsageError, match="the same file"):
        judge(path, tmp_path / "none" / ".." / path.name)
    assert path.read_bytes() == before
