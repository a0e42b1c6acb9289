"""The tables "Ablation" and "Scaling" in the report: which runs they are of, what is judged, and what is a curve
instead."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from fsar_ledger.base.errors import UsageError
from fsar_ledger.designs.constants import Constants, Load
from fsar_ledger.events.envelope import Architecture
from fsar_ledger.ledger.rows.codec import encode
from fsar_ledger.metrics.database import Database
from fsar_ledger.metrics.results import dialled_rows
from fsar_ledger.report import curves, document, specs
from fsar_ledger.report.ablation_scaling import ablation_of, scaling_of
from fsar_ledger.report.findings import SCENARIOS, Ablation, Findings, Scaling
from fsar_ledger.report.other_ledgers import OtherSections, read_ledgers
from fsar_ledger.runtime.experiment import Experiment
from fsar_ledger.runtime.simulation import ARCHITECTURES, simulate_run
from tests.recycled import from_table
from tests.sure import known

MEANS = (30.0, 300.0)


def played(*experiments: Experiment) -> Iterator[Any]:
    for one in experiments:
        for spec in one.specs():
            yield simulate_run(spec, one.constants)


def meeting(mean: float, *configurations: str) -> Experiment:
    world = msgspec.structs.replace(Constants().world, encounter_mean_s=mean)
    return Experiment(("fsar",), SCENARIOS, 2, 42, 4, configurations, Constants(world))


def loaded(size: int, teams: int | None, architectures: tuple[Architecture, ...] = ARCHITECTURES) -> Experiment:
    return Experiment(
        architectures,
        SCENARIOS,
        1,
        42,
        size,
        constants=Constants(load=None if teams is None else Load(teams_working=teams)),
    )


@pytest.fixture(scope="module")
def ablations() -> Iterator[Database]:
    """Two ablations at one rate of encounters, one of them at another rate, too."""
    chosen = [
        meeting(30.0, "full", "without-layered-recovery", "without-shared-registry"),
        meeting(300.0, "without-shared-registry"),
    ]
    with from_table(encode(list(played(*chosen)))) as database:
        yield database


@pytest.fixture(scope="module")
def ablation(ablations: Database) -> Ablation:
    return known(ablation_of(ablations))


@pytest.fixture(scope="module")
def fleets() -> Scaling:
    with from_table(
        encode(list(played(loaded(4, None), loaded(8, None), loaded(8, 1), loaded(32, 1, ("fsar",)))))
    ) as database:
        found = scaling_of(database)
    assert found is not None
    return found


def test_the_table_is_of_the_rate_with_most_configurations_and_the_other_rate_is_on_the_curve(
    ablations: Database, ablation: Ablation
) -> None:
    assert ablation.encounter_mean_s == MEANS[0]
    assert [row["encounter_mean_s"] for row in ablation.rates] == list(MEANS)
    ours = {
        (row.encounter_mean_s, row.configuration, row.metric): row.mean
        for row in dialled_rows(ablations)
        if row.scenario is None
    }
    assert len(ablation.cells) == 30
    for cell in ablation.cells:
        assert cell["mean"] == ours.get((MEANS[0], cell["configuration"], cell["metric"]))


def test_a_cell_has_the_answers_unless_the_text_leaves_its_dial_open_or_there_are_no_runs(ablation: Ablation) -> None:
    for cell in (*ablation.cells, *ablation.text):
        held = (
            cell["configuration"] in ("full", "without-layered-recovery", "without-shared-registry")
            and cell["mean"] is not None
        )
        assert (cell["gives"] is not None) == (held and cell["class"] != "unspecified"), cell
        by_text = "no" if held and cell["class"] == "cannot follow" else None
        assert cell["could"] == by_text, "two runs are fewer than the paper's experiment"
        assert by_text in (None, cell["gives"]), "what the text excludes is answered by it"
    assert {cell["because"] is not None for cell in ablation.cells if cell["class"] == "cannot follow"} == {True}


def test_numbers_of_the_text_are_of_their_scenario(ablations: Database, ablation: Ablation) -> None:
    ours = {
        (row.configuration, row.scenario, row.metric): row.mean
        for row in dialled_rows(ablations)
        if row.encounter_mean_s == MEANS[0]
    }
    assert [row["mean"] for row in ablation.text] == [
        ours.get((row["configuration"], row["scenario"], row["metric"])) for row in ablation.text
    ]


@pytest.mark.slow
def test_larger_fleets_stand_at_both_ends_of_the_load_and_have_no_answer(fleets: Scaling) -> None:
    assert len(fleets.cells) == 45
    larger = [cell for cell in fleets.cells if cell["fleet_size"] == 8]
    assert all(cell["gives"] is None and cell["class"] == "unspecified" for cell in larger)
    conflicts = next(
        cell for cell in larger if (cell["architecture"], cell["metric"]) == ("dhma", "authority_conflicts")
    )
    assert conflicts["mean"] > conflicts["one"], "two teams have more to contend for"


def test_runs_of_one_scenario_are_not_judged_by_a_number_over_five_and_by_one_of_theirs_they_are() -> None:
    one = Experiment(("fsar",), ("mixed-trust-inspection",), 2, configurations=("full", "without-trust-evaluation"))
    with from_table(encode(list(played(one)))) as database:
        found = ablation_of(database)
    assert found is not None
    assert {cell["gives"] for cell in found.cells} == {None}
    assert [cell["scenario"] for cell in found.text if cell["gives"] is not None] == ["mixed-trust-inspection"] * 2


def test_runs_without_a_mechanism_or_another_size_make_no_section() -> None:
    with from_table(encode(list(played(Experiment(("fsar",), ("door-relay",), 1))))) as database:
        assert (ablation_of(database), scaling_of(database)) == (None, None)


def test_a_ledger_that_holds_nothing_for_the_report_is_refused(ledger: Path) -> None:
    with pytest.raises(UsageError, match=r"--with .* found no run of a workflow"):
        read_ledgers({ledger: None})


def test_what_a_ledger_lacks_another_gives(ablation: Ablation, fleets: Scaling) -> None:
    assert OtherSections(ablation=ablation).or_else(OtherSections(scaling=fleets)) == OtherSections(
        ablation=ablation, scaling=fleets
    )


def test_a_curve_has_a_value_where_it_crosses_it_on_the_logarithm_of_the_dial() -> None:
    points: list[tuple[float, Any]] = [(1.0, {"mean": 0.0}), (100.0, {"mean": 1.0}), (1000.0, {"mean": 1.0})]
    assert curves.crossings(points, 0.5) == pytest.approx([10.0])
    assert curves.crossings(points, 2.0) == []
    assert curves.crossings([(1.0, {"mean": 1.0}), (2.0, {"mean": 0.0})], 0.0) == [2.0]


def test_sections_print_our_means_beside_the_papers(findings: Findings, ablation: Ablation, fleets: Scaling) -> None:
    told = msgspec.structs.replace(findings, ablation=ablation, scaling=fleets)
    data = msgspec.json.decode(document.encoded(document.data(told, None)))
    column = [one.key for one in specs.table("ablation").column].index("mean")
    printed = [row[column]["value"] for row in data["tables"]["ablation"]["rows"]]
    assert sorted(filter(None, printed)) == sorted(cell["mean"] for cell in ablation.cells if cell["mean"])
    assert len(data["tables"]["scaling"]["rows"]) == 45
    assert {"ablation", "encounters"} <= data["figures"].keys()
    assert data["ablation"]["judged"] == sum(cell["gives"] is not None for cell in (*ablation.cells, *ablation.text))
    assert len(data["ablation"]["proofs"]) == 2
    assert data["scaling"]["judged"] == sum(cell["gives"] is not None for cell in fleets.cells)
    assert (data["scaling"]["open"], document.data(findings, None)["scaling"]) == (30 - 15, None), (
        "no runs of 16 robots"
    )
