"""The section "Every reading": ranges, the reading that moves a cell most, and what the sentences count."""

from pathlib import Path

import pytest

from fsar_ledger.metrics.database import connect
from fsar_ledger.metrics.multiverse import Multiverse, ReadingNames, Universe, cells, rankings, readings
from fsar_ledger.metrics.verdicts import published
from fsar_ledger.report import all_readings, document
from fsar_ledger.report.findings import Findings
from fsar_ledger.report.gather import SETTING, gather

NAMES = ("level_four_is_fleet", "reviews_are_no_interventions")
Means = dict[ReadingNames, tuple[float | None, float, float]]
PAPER = published()["human_intervention", "fsar"].value


def multiverse(means: Means) -> Multiverse:
    """Human intervention of the three architectures under these combinations."""
    setting = {
        "configuration": "full",
        "fleet_size": 4,
        "seed": 1,
        "kind": "simulated",
        "source": None,
        "model_version": "2",
        "constants": None,
    }
    found = [
        Universe(
            metric="human_intervention",
            architecture=name,
            readings=chosen,
            mean=mean,
            runs_not_observed=0,
            **setting,  # type: ignore[arg-type]
        )
        for chosen, mine in means.items()
        for name, mean in zip(("fsar", "cfc", "dhma"), mine, strict=True)
    ]
    used = tuple(one for one in readings() if one.name in NAMES)
    return Multiverse(used, tuple(cells(found)), tuple(rankings(found, {"human_intervention": "lower"})), tuple(found))


def test_a_cell_has_its_range_and_the_reading_that_moves_it_most() -> None:
    fsar = all_readings.ranges(
        multiverse({(): (0.1, 0.3, 0.2), NAMES[:1]: (0.25, 0.3, 0.2), NAMES[1:]: (0.05, 0.3, 0.2)})
    )[0]
    number = next(one.reading for one in readings() if one.name == NAMES[0])
    assert (fsar["range"], fsar["most_moving"], fsar["moved_by"]) == (
        (0.05, 0.25),
        f"level four is fleet ({number})",
        pytest.approx(0.15),
    )


@pytest.mark.parametrize(
    ("mean", "holds"), [(PAPER, True), (PAPER - 0.049, True), (PAPER - 0.051, False), (None, None)]
)
def test_the_range_holds_the_printed_number_give_or_take_a_margin(mean: float | None, holds: bool | None) -> None:
    assert all_readings.ranges(multiverse({(): (mean, 0.3, 0.2)}))[0]["holds"] is holds


def test_the_smallest_combinations_under_which_fsar_is_not_the_best_are_named() -> None:
    row = all_readings.orders(
        multiverse(
            {(): (0.1, 0.3, 0.2), NAMES[:1]: (0.4, 0.3, 0.2), NAMES[1:]: (0.1, 0.3, 0.2), NAMES: (0.5, 0.3, 0.2)}
        )
    )[0]
    assert (row["order"], row["combinations"], row["fsar_best"], row["same_order"]) == ("FSAR > DHMA > CFC", 4, 2, 2)
    assert row["not_best_under"].startswith("level four is fleet (")
    assert " with " not in row["not_best_under"]


@pytest.mark.parametrize(("other", "counts"), [((0.05, 0.3, 0.2), (1, 0, 0)), ((0.35, 0.3, 0.2), (0, 1, 0))])
def test_the_sentences_count_by_how_many_metrics_fsar_is_best_under_all_some_and_no_combinations(
    other: tuple[float, float, float], counts: tuple[int, int, int]
) -> None:
    said = all_readings.said(multiverse({(): (0.1, 0.3, 0.2), NAMES[:1]: other}))
    assert said is not None
    assert tuple(said[name] for name in ("always", "sometimes", "never")) == counts
    never = all_readings.said(multiverse({(): (0.6, 0.3, 0.2)}))
    assert never is not None
    assert (never["never"], never["never_by"]) == (1, "human interventions")
    assert all_readings.said(None) is None


@pytest.mark.slow  # all combinations of all metrics
def test_the_report_has_the_multiverse_of_the_runs_that_its_tables_are_of(ledger: Path, alone: Findings) -> None:
    found = gather(ledger, reads_every_way=True)
    assert found.multiverse is not None
    ours = {(cell["metric"], cell["architecture"]): cell["mean"] for cell in alone.cells}
    assert {(cell.metric, cell.architecture): cell.ours for cell in found.multiverse.cells} == pytest.approx(
        ours, nan_ok=True
    )
    data = document.data(found, None)
    assert len(data["tables"]["every-reading"].rows) == 24
    assert "specification-curves" in data["figures"]
    assert {f"readings/{one.name}" for one in found.multiverse.readings} <= {source.name for source in found.sources}
    with connect(ledger) as database:
        assert all_readings.multiverse_of(database, dict.fromkeys(SETTING, "another")) is None
