"""The report as pages, looked at as pictures: none but the last is more than a quarter empty."""

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from fsar_ledger.metrics.study_results import Calibration, packaged
from fsar_ledger.report import document, specs
from fsar_ledger.report.findings import Ablation, Findings, LedgerHead, Row, Scaling
from tests.report.test_all_readings import NAMES, multiverse

MARGINS_MM = (21.0, 19.0)
"""What lies above and below the text of a page, of 297 mm; the line of the header is left out."""

HEAD = LedgerHead(1, 1, "root", 1, "complete", "2")


def pages(findings: Findings, folder: Path) -> list[Any]:
    """Each page of the report as an array of grey, 1 is white."""
    import typst
    from matplotlib.image import imread

    folder.mkdir()
    (folder / "report.typ").write_text(specs.text("templates", "report.typ"))
    (folder / "data.json").write_bytes(document.encoded(document.data(findings, packaged(Calibration))))
    for name, svg in document.drawings(findings).items():
        (folder / name).write_bytes(svg)
    drawn = typst.compile(
        folder / "report.typ", format="png", ppi=36, font_paths=typst.Fonts(include_system_fonts=False)
    )
    return [imread(io.BytesIO(page))[..., :3].min(axis=2) for page in (drawn if isinstance(drawn, list) else [drawn])]


def widest_gap(page: Any) -> float:
    """The tallest white band of the text, as a share of its height."""
    above, below = (round(len(page) * margin / 297) for margin in MARGINS_MM)
    marked = np.flatnonzero((page[above : len(page) - below] < 0.8).any(axis=1))
    height = len(page) - above - below
    return float(np.diff([-1, *marked, height]).max() - 1) / height


def cells() -> Iterator[Row]:
    """So many cells as the ablation table has, each with an answer."""
    answers = {
        "gives": "yes",
        "share": 0.2,
        "could": "yes",
        "class": "informed",
        "because": None,
        "lies": None,
        "one": 0.9,
        "one_interval": (0.8, 1.0),
    }
    for metric in (
        *("coordination_success", "governance_locality", "recovery_containment"),
        *("authority_conflicts", "policy_violations", "audit_attributability"),
    ):
        for configuration in (
            "full",
            "without-trust-evaluation",
            "without-policy-composition",
            "without-layered-recovery",
            "without-shared-registry",
        ):
            where = {
                "metric": metric,
                "architecture": "fsar",
                "configuration": configuration,
                "fleet_size": 4,
                "scenario": None,
            }
            ours = {"mean": 0.9, "interval": (0.8, 1.0), "n": 5, "difference": (-0.01, 0.01), "distance": 0.1}
            yield {**where, **ours, **answers, "paper": 0.9, "paper_printed": "0.90"}


@pytest.mark.slow
@pytest.mark.parametrize("held", ["the results alone", "all tables"])
def test_no_page_but_the_last_is_more_than_a_quarter_empty(alone: Findings, tmp_path: Path, held: str) -> None:
    found = alone
    if held == "all tables":
        ablation = tuple(cells())
        scaling = tuple(row for row in ablation if row["metric"] != "policy_violations")
        curve = tuple(
            row | {"fleet_size": size, "teams_working": 1, "encounter_mean_s": 90.0}
            for row in scaling
            for size in (4, 8, 16)
        )
        read = multiverse({(): (0.1, 0.3, 0.2), NAMES[:1]: (0.4, 0.3, 0.2)})
        found = msgspec.structs.replace(
            alone,
            ablation=Ablation(HEAD, 90.0, ablation, ablation[:8], (), ()),
            scaling=Scaling(HEAD, scaling, curve),
            multiverse=read,
        )
    shown = pages(found, tmp_path / "report")
    gaps = [widest_gap(page) for page in shown]
    assert len(gaps) > 10
    assert max(gaps[:-1]) < 0.25, [f"page {number}: {gap:.0%}" for number, gap in enumerate(gaps, 1) if gap >= 0.25]


def test_a_gap_is_measured_where_nothing_stands() -> None:
    page = np.ones((297, 210))
    assert widest_gap(page) == 1.0
    page[21:278] = 0.0
    assert widest_gap(page) == 0.0
    page[100:150] = 1.0
    assert widest_gap(page) == pytest.approx(50 / 257)
