"""Texts that do something where others open a file: in every output they stay text, and the file stays whole and
small."""

import csv
import io
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import msgspec
import pyarrow as pa
import pyarrow.csv as pa_csv
import pytest

from fsar_ledger.api.files import _write_tables
from fsar_ledger.api.tables import table_text
from fsar_ledger.cli.render import answer_json
from fsar_ledger.report import build, printing, sequence
from fsar_ledger.report.build import Document
from fsar_ledger.report.findings import Findings
from tests.one_by_one import csv_text
from tests.report.made import replaced
from tests.report.test_sequence import TIMELINE, told
from tests.terminal import PAINT, painted

FORMULAS = (
    *("=1+1", "+1+1", "-1+1", "@SUM(A1)", "=cmd|' /C calc'!A0"),
    *('=HYPERLINK("http://x","y")', "\t=1+1", "\r=1+1", "\uff1d1+1", " =1+1", "'=1+1"),
)
MARKUP = (
    *(
        *("<script>alert(1)</script>", "</text><script>1</script>", "<!-- x", "--> <b>"),
        *("]]>", "&lt;&amp;&#0;", '" onload="x', "<![CDATA[", "<?xml?>"),
    ),
    *(
        *('#panic("evaluated")', '#read("/etc/passwd")', "$ x / $", "*bold", "_under", "`raw"),
        *("] #panic()", '#eval("panic()")', "@nowhere", "<label>", "\\", "= Title"),
    ),
    *(
        "$x^{2$",
        r"$\frac{$",
        "$$",
        "{x}",
        "%s %d {0}",
        "https://evil.example/",
        "[x](javascript:1)",
        "../../x",
        "x" * 100_000,
    ),
)
PAYLOADS = (*FORMULAS, *MARKUP, *PAINT.values())
TAGS = {"svg", "defs", "g", "path", "use", "style", "metadata", "RDF", "Work", "type", "format", "clipPath", "rect"}


def drawn(kind: str, payloads: Sequence[str]) -> Iterator[bytes]:
    """A timeline and a ladder with these payloads in every text."""
    timeline = [
        told(number, one, "robot/B1", one, "evaluation" if number % 2 else "message", note=one)
        for number, one in enumerate(payloads)
    ]
    rung: dict[str, object] = {
        "failure": 1,
        "seq": 7,
        "level_number": 1,
        "spent_s": 1.0,
        "time_s": 1.0,
        "until_s": 2.0,
        "budget_s": 1.0,
        "to_level": None,
    }
    rungs = [rung | dict.fromkeys(("level", "what", "result", "achieved", "decided_by"), one) for one in payloads]
    rungs[-1]["to_level"] = payloads[-1]
    assert not sequence.drawable(timeline)[1]
    yield from (sequence.sequence(timeline, kind), sequence.ladder(rungs, kind))


def assert_only_a_picture(svg: bytes) -> None:
    assert len(svg) < 1_000_000
    root = ElementTree.fromstring(svg)
    assert {one.tag.rpartition("}")[2] for one in root.iter()} <= TAGS
    assert [
        name for one in root.iter() for name in one.attrib if name.startswith("on") or "javascript" in one.attrib[name]
    ] == []


def test_there_are_forty() -> None:
    assert len(set(PAYLOADS)) >= 40


@pytest.mark.slow
def test_no_figure_breaks_and_none_grows() -> None:
    for at in range(0, len(PAYLOADS), 5):
        for svg in drawn("svg", PAYLOADS[at : at + 5]):
            assert_only_a_picture(svg)
    for pdf in drawn("pdf", MARKUP[-8:-5]):
        assert pdf.startswith(b"%PDF")
        assert len(pdf) < 1_000_000
        assert not re.search(rb"/(?:URI|JavaScript|Launch)\b", pdf)


def test_a_long_timeline_says_what_it_leaves_out() -> None:
    many = [
        told(number, f"robot/{number}", f"robot/{number + 1}", "x" * 1_000, note="y" * 1_000)
        for number in range(1, 5_000)
    ]
    svg = sequence.sequence(many)
    assert_only_a_picture(svg)
    assert re.search(rb"4,9\d\d more steps, which are not drawn", svg)
    assert b"others" in svg
    assert len(sequence.drawable(TIMELINE)[0]) == len(TIMELINE)


@pytest.mark.slow
def test_no_answer_holds_a_formula_or_paints() -> None:
    rows = [{payload: payload, "n": -1.5, "list": [payload]} for payload in PAYLOADS]
    for row in rows:
        text = csv_text([row], list(row))
        header, values = csv.reader(io.StringIO(text))
        for cell in (header[0], values[0], values[2]):
            assert cell.lstrip()[:1] not in tuple("=+-@\t\r\uff1d\uff0b\uff0d\uff20")
        assert values[1] == "-1.5"
        assert msgspec.json.decode(values[2]) == row["list"]
        assert painted(text) == []
        assert painted(table_text([row], list(row))) == []
        assert msgspec.json.decode(answer_json(None, {"rows": [row]}))["rows"] == [row]
        raw = list(csv.reader(io.StringIO(csv_text([row], list(row), raw=True), newline="")))
        assert raw[1][0] == next(iter(row))


def test_an_exported_file_holds_no_formula_unless_asked(tmp_path: Path) -> None:
    texts = pa.array([*PAYLOADS, None, "", *PAYLOADS], pa.string())
    table = pa.table(
        {
            "text": texts,
            "coded": texts,
            "lists": pa.array([[text] for text in PAYLOADS] + [None, []] + [[text] for text in PAYLOADS]),
            "n": range(-9, len(texts) - 9),
        }
    )
    for raw in (False, True):
        out = tmp_path / f"{raw}.csv"
        assert _write_tables(out, table.schema, [table, table.slice(3)], raw=raw) == 2 * len(texts) - 3
        found = pa_csv.read_csv(
            out,
            parse_options=pa_csv.ParseOptions(newlines_in_values=True),
            convert_options=pa_csv.ConvertOptions(strings_can_be_null=True, quoted_strings_can_be_null=False),
        )
        assert found.column("n").to_pylist()[:9] == list(range(-9, 0))
        cells = found.column("text").to_pylist()
        assert (cells[: len(texts)] == texts.to_pylist()) == raw
        assert cells[len(PAYLOADS) : len(PAYLOADS) + 2] == [None, ""]
        if not raw:
            assert [cell for cell in cells if cell and cell.lstrip()[:1] in tuple("=+-@\uff1d\uff0b\uff0d\uff20")] == []
            assert painted(out.read_text("utf-8")[:200_000].rpartition("\n")[0]) == []


@pytest.mark.slow
def test_the_report_reads_no_payload_as_markup(findings: Findings) -> None:
    """A payload that were evaluated would stop the typesetter: it panics, or leaves something open."""
    hostile = {f"{payload[:200]} {number}": payload for number, payload in enumerate(PAYLOADS[:40])}
    run, model = (findings.relations[name].to_pylist()[0] for name in ("runs", "models"))
    others = [{**run, "configuration": payload, "architecture": payload} for payload in PAYLOADS]
    models = [{**model, "kind": payload, "model_version": payload} for payload in PAYLOADS * 5]
    notes = {"unjudged": "".join(MARKUP[:-1]), "shown": "".join(PAINT.values()), "differing": PAYLOADS}
    head = msgspec.structs.replace(findings.heads["results"], completeness=f"not complete: {''.join(MARKUP[:-1])}")
    evil = msgspec.structs.replace(
        replaced(findings, runs=others, models=models),
        parameters=hostile,
        heads={"results": head, "ablation": head},
        **notes,
    )
    laid_out = Document(evil)
    pdf = build.pdf(laid_out.encoded(), laid_out.drawings)
    assert pdf.startswith(b"%PDF")
    assert len(pdf) < 3_000_000
    parts = [part for section in laid_out.sections for part in section["parts"]]
    [shown] = [part for part in parts if part.get("name") == "models"]
    assert f"{len(models) - printing.MAX_ROWS} more rows are not shown" in shown["source"]
    for part in parts:
        cells = "".join(f"{cell.printed}\n" for row in part.get("rows", ()) for cell in row)
        assert painted(cells + part.get("text", "")) == []


@pytest.mark.parametrize(
    "payload", [*MARKUP[:-1], "// x", "- x", "+ x", "1. x", "/ a: b", "~~", "---", "...", "'q\"", "#u{41}"]
)
def test_a_text_as_markup_says_just_this_text(payload: str) -> None:
    import typst

    source = f"#metadata([{printing.markup(payload)}])<said>".encode()
    [found] = msgspec.json.decode(typst.query(source, "<said>", field="value"))
    assert _plain(found) == payload


def _plain(content: Any) -> str:
    """The words of Typst's content."""
    if "children" in content:
        return "".join(map(_plain, content["children"]))
    return " " if content["func"] == "space" else str(content["text"])


def test_nothing_of_ours_is_escaped_or_cut(document: Document) -> None:
    printed = [
        cell.printed
        for section in document.sections
        for part in section["parts"]
        for row in part.get("rows", ())
        for cell in row
    ]
    assert [text for text in printed if re.search(r"\\[xuU]|more\)", text)] == []
