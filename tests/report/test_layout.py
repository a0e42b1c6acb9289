"""The report as pages: how many, how full, and that what a page names is near; and that every specification holds."""

import io
import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa
import pytest

from fsar_ledger.events.configuration import PAPER_ARCHITECTURES
from fsar_ledger.metrics.database import from_rows
from fsar_ledger.metrics.library import library
from fsar_ledger.metrics.results import DialledRow
from fsar_ledger.metrics.study_results import Calibration, packaged
from fsar_ledger.report import build, specs
from fsar_ledger.report.audit import AuditDocument
from fsar_ledger.report.build import Document
from fsar_ledger.report.findings import Findings, arrow
from fsar_ledger.report.read import gather, relations_of
from fsar_ledger.report.records import robustness_relations
from tests.report.made import (
    DIFFERENCE,
    HEAD,
    ensemble,
    made,
    names,
    of_table,
    placebo,
    prior,
    replaced,
    said,
    system_number,
    systems,
)
from tests.report.test_readings import multiverse

MOST_PAGES = 18
IMPATIENT = [
    system_number("alliance", metric, dial="alliance.impatience_us", value=value)
    for metric in ("coordination_success", "success_without_violation")
    for value in (100_000, 1_000_000, 15_000_000)
]
SWITCHED = [system_number("jade", "policy_violations", dial="jade.permissions", value=value) for value in (0, 1)]
MARGINS_MM = (19.0, 17.0)
"""What lies above and below the text of a page, of 297 mm; the line of the header is left out."""


@pytest.fixture(scope="module")
def whole(ledger: Path, workflows: Path) -> Findings:
    """The findings of a report with every section, with made-up numbers where ledgers would take minutes."""
    found = gather(ledger, beside={workflows: None})
    heads = {**found.heads, **dict.fromkeys(("ablation", "scaling", "mechanisms"), HEAD)}
    numbers = [*found.numbers, *of_table("ablation"), *of_table("ablation_text"), *of_table("scaling", one=0.9)]
    loads = [
        _dialled(metric=one.metric, architecture=one.architecture, mean=one.ours, fleet_size=size, teams_working=teams)
        for one in of_table("scaling")
        if one.fleet_size == 4
        for size in (4, 8, 16, 64)
        for teams in sorted({1, 2, size // 4})
    ]
    encounters = [
        _dialled(metric="coordination_success", scenario=scenario, mean=0.5, encounter_mean_s=at)
        for scenario in (None, "door-relay", "collaborative-delivery")
        for at in (30.0, 90.0)
    ]
    costs = _costs([(name, size) for name in PAPER_ARCHITECTURES for size in (4, 16)])
    read = multiverse({(): (0.1, 0.3, 0.2), ("level_four_is_fleet",): (0.4, 0.3, 0.2)})
    differences = [
        DIFFERENCE | {"architecture": name, "configuration": f"without-part-{at}", "metric": one.metric, "p_holm": 0.01}
        for name in PAPER_ARCHITECTURES
        for at in range(3)
        for one in of_table("results")[::3]
    ]
    replacing: dict[str, Any] = {
        **relations_of(read),
        "loads": arrow(loads, DialledRow),
        "encounters": arrow(encounters, DialledRow),
        "costs": costs,
        "differences": differences,
        "digests": pa.table({"digests": [["one"]]}),
        **_churn(),
    }
    return msgspec.structs.replace(replaced(found, **replacing), heads=heads, numbers=tuple(numbers))


def _dialled(**given: Any) -> DialledRow:
    row: dict[str, Any] = dict.fromkeys(DialledRow.__struct_fields__)
    row |= {"kind": "simulated", "setting": "s", "made_alike_but": "m", "n": 9, "seeds": 1, "configuration": "full"}
    return DialledRow(**row | given)


def _costs(of: Sequence[tuple[str, int]]) -> pa.Table:
    row: dict[str, Any] = {"kind": "simulated", "setting": "s", "made_alike_but": "m", "runs": 1, "requests": 1}
    row |= dict.fromkeys(("messages", "decisions", "hops", "look_ups", "robots_named", "checks", "completed"), 0.7)
    with from_rows((), threads=1) as empty:
        columns = empty.table("SELECT * FROM coordination_cost").schema
    return pa.Table.from_pylist([row | {"architecture": name, "fleet_size": size} for name, size in of], schema=columns)


def _churn() -> dict[str, pa.Table]:
    with from_rows((), threads=1) as empty:
        nothing_came_of_it = empty.query("audit/churn").schema.empty_table()
    run = {"run_id": "c", "architecture": "fsar", "configuration": "full", "fleet_size": 8}
    return {"churned": pa.Table.from_pylist([run]), "departures": nothing_came_of_it}


def typeset(document: Document | AuditDocument, folder: Path, kind: str) -> Any:
    import typst

    folder.mkdir()
    (folder / "report.typ").write_text(specs.text("templates", "report.typ"))
    (folder / "data.json").write_bytes(document.encoded())
    for name, svg in document.drawings.items():
        (folder / name).write_bytes(svg)
    fonts = typst.Fonts(include_system_fonts=False)
    if kind == "places":
        return msgspec.json.decode(
            typst.query(folder / "report.typ", "<places>", field="value", one=True, font_paths=fonts)
        )
    return typst.compile(folder / "report.typ", format="png", ppi=36, font_paths=fonts)


def widest_gap(page: Any) -> float:
    """The tallest white band of the text, as a share of its height."""
    above, below = (round(len(page) * margin / 297) for margin in MARGINS_MM)
    marked = np.flatnonzero((page[above : len(page) - below] < 0.8).any(axis=1))
    height = len(page) - above - below
    return float(np.diff([-1, *marked, height]).max() - 1) / height


@pytest.mark.slow
def test_what_the_first_page_has_no_room_for_is_followed_by_the_rest(findings: Findings, tmp_path: Path) -> None:
    for notes, pages in ((0, (1, 2)), (12, (2, 2))):
        noted = msgspec.structs.replace(findings, differing=("a long note. " * 12,) * notes)
        parts = typeset(Document(noted, packaged(Calibration)), tmp_path / f"{notes}", "places")["parts"]
        where = {one["name"]: one["page"] for one in parts}
        assert (where["tab-claims"], where["tab-tally"]) == pages


@pytest.mark.slow
@pytest.mark.parametrize("held", ["the results alone", "everything"])
def test_the_report_has_at_most_eighteen_pages_and_none_but_the_last_is_a_quarter_empty(
    findings: Findings, whole: Findings, tmp_path: Path, held: str
) -> None:
    from matplotlib.image import imread

    found = whole if held == "everything" else findings
    drawn = typeset(Document(found, packaged(Calibration)), tmp_path / "report", "png")
    gaps = [widest_gap(imread(io.BytesIO(page))[..., :3].min(axis=2)) for page in drawn]
    assert 5 < len(gaps) <= MOST_PAGES
    assert max(gaps[:-1]) < 0.25, [f"page {number}: {gap:.0%}" for number, gap in enumerate(gaps, 1) if gap >= 0.25]


@pytest.mark.slow
def test_a_group_stays_on_one_page_with_its_name(tmp_path: Path) -> None:
    import typst

    cells = [("group" if row % 5 == 0 else "", f"{row // 5}") for row in range(60)]
    rows = ", ".join(f'({", ".join(f"""(printed: "{text}", tone: "code")""" for text in row)})' for row in cells)
    looks = 'name: "t", title: "", caption: "", source: "", size: 8, heads: ("", ""), aligns: ("left", "left")'
    table = f"({looks}, rows: ({rows}), begins: {tuple(range(5, 60, 5))})"
    found = "#context [#metadata(query(raw).map(it => (it.text, it.location().page()))) <cells>]"
    (tmp_path / "data.json").write_bytes(Document(made()).encoded())
    for above in (100, 104, 108, 112, 116):  # mm, so that the page ends below any row of a group
        template = specs.text("templates", "report.typ").split("#align(center)")[0]
        (tmp_path / "report.typ").write_text(f"{template}#v({above}mm)\n#booktab({table})\n{found}")
        raws = msgspec.json.decode(typst.query(tmp_path / "report.typ", "<cells>", field="value", one=True))
        pages = [{page for text, page in raws if text == f"{group}"} for group in range(12)]
        assert [len(one) for one in pages] == [1] * 12
        assert {page for one in pages for page in one} == {1, 2}
        assert [page for text, page in raws if text == "group"] == [min(one) for one in pages]


def test_a_gap_is_measured_where_nothing_stands() -> None:
    page = np.ones((297, 210))
    assert widest_gap(page) == 1.0
    page[19:280] = 0.0
    assert widest_gap(page) == 0.0
    page[100:150] = 1.0
    assert widest_gap(page) == pytest.approx(50 / 261)


@pytest.mark.slow
def test_tables_and_figures_are_numbered_as_they_stand_near_the_text_that_names_them(
    whole: Findings, tmp_path: Path
) -> None:
    places = typeset(Document(whole, packaged(Calibration)), tmp_path / "report", "places")
    for kind in ("tab-", "fig-"):
        stand = [(one["page"], one["y"]) for one in places["parts"] if one["name"].startswith(kind)]
        assert len(stand) > 5
        assert stand == sorted(stand)
    where = {one["name"]: one["page"] for one in places["parts"]}
    far = [(one, where[one["name"]]) for one in places["named"] if abs(where[one["name"]] - one["page"]) > 1]
    assert far == []
    on_page_1 = {"tab-claims", "fig-overview"}
    assert where.keys() - on_page_1 == {one["name"] for one in places["named"]}


@pytest.mark.slow
def test_the_pdf_is_tagged_and_every_figure_has_its_alternative_text(document: Document) -> None:
    pdf = build.pdf(document.encoded(), document.drawings)
    assert b"/StructTreeRoot" in pdf
    assert b"/MarkInfo" in pdf
    figures = [part for section in document.sections for part in section["parts"] if part["shape"] == "figure"]
    assert len(figures) >= 2
    assert all(part["alt"] for part in figures)


def parts() -> Iterator[tuple[str, specs.AnyPart]]:
    for name, section in specs.sections().items():
        for part in section.part:
            yield name, part


def test_the_table_of_cases_says_where_the_paper_has_words_and_no_number() -> None:
    (caption,) = (part.caption for _, part in parts() if isinstance(part, specs.Table) and part.name == "cases")
    assert "case 1, and FSAR in case 4, have only words" in caption


def test_every_table_and_figure_has_a_name_of_its_own_a_caption_and_a_query_that_is_there() -> None:
    shown = [part for _, part in parts() if isinstance(part, specs.Table | specs.Figure)]
    labels = [("tab" if isinstance(part, specs.Table) else "fig", part.name) for part in shown]
    assert len(set(labels)) == len(labels)
    assert all(part.caption for part in shown if part.name != "claims")
    assert {part.query for part in shown if part.query} <= library().queries.keys()
    named = {
        name
        for _, part in parts()
        if isinstance(part, specs.Text)
        for name in re.findall(r"@([a-z]+-[a-z-]+)", part.text)
    }
    assert named <= {f"{kind}-{name}" for kind, name in labels}


def test_every_part_of_every_section_is_shown_by_a_report_with_everything(whole: Findings) -> None:
    """A SELECT over a relation that nothing gives, or a column that is not there, would be left out in silence."""
    studies = robustness_relations(
        prior(), ensemble(10), placebo(("governance_locality", "p")), systems(*IMPATIENT, *SWITCHED)
    )
    document = Document(whole, packaged(Calibration), robustness=studies)
    printed = {part["name"] for section in document.sections for part in section["parts"] if "name" in part}
    asked = {part.name for _, part in parts() if isinstance(part, specs.Table | specs.Figure)}
    only_where_needed = {"other-runs", "models", "predictions", "sensitivity", "calibrated-parameters"}
    assert asked - printed <= only_where_needed
    assert "calibrated-parameters" in printed
    of_studies = {"study", "effects", "effects_changed", "predictions", "changed_since"}
    for sql in (*specs.relations().values(), *(part.rows for _, part in parts() if part.rows)):
        assert document.missing(sql) <= of_studies, sql


@pytest.mark.slow
def test_a_text_names_only_what_is_shown(make_ledger: Callable[..., Path]) -> None:
    """Larger fleets alone have no figure of costs by size; the sentence on costs stands without it."""
    document = Document(gather(make_ledger(fleet_size=8)))
    assert "coordination-cost" not in names(document, "figure")
    assert "Here is counted what each request takes (@tab-coordination-cost)." in said(document)
    assert "@fig-coordination-cost" not in said(document)
    assert "@tab-evaluation-results" not in said(document), "the whole sentence is left out"
