"""Answers of many rows: each form holds the same rows, is as short as DuckDB's, and ends when its reader has enough."""

import csv
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import duckdb
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from benchmarks.rows import COPY, ROWS, duckdb_copy, ours
from fsar_ledger.api import files
from fsar_ledger.base.printable import field
from tests.cli.conftest import Call, one_message
from tests.ledger.bomb_trial import cost_of
from tests.quick import few

MOST = 1.5
"""How many times the bytes of DuckDB's file ours may take."""
MANY = "SELECT range AS seq, 'robot/B' || range % 7 AS robot, range / 7 AS share FROM range(1000000)"
LONG_NAMES = ", ".join(f"range AS {letter * 63}" for letter in "abcd")
FAILURES = ("query", "failures", "LEDGER")
FORMS = ("--json", "--ndjson", "--csv")


def lines_of(text: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in text.splitlines()]


def in_order(rows: list[dict[str, Any]]) -> list[str]:
    return sorted(json.dumps(row) for row in rows)


@pytest.mark.parametrize("asked", few([("sql", "LEDGER", "SELECT * FROM events"), FAILURES], [FAILURES]))
def test_each_row_of_json_is_one_line(call: Call, ledger: Path, asked: tuple[str, ...]) -> None:
    words = [ledger if word == "LEDGER" else word for word in asked]
    answer = call(*words, "--json").out
    rows = json.loads(answer)["rows"]
    assert rows
    before, *lines, end, last = answer[answer.index('  "rows": [') :].split("\n")[:-1]
    assert (before, end, last) == ('  "rows": [', "  ]", "}")
    assert [json.loads(line.removesuffix(",")) for line in lines] == rows
    assert call(*words, "--ndjson").out == "".join(f"{line.removesuffix(',').strip()}\n" for line in lines)


@pytest.mark.slow
def test_an_answer_without_rows_is_an_empty_list(call: Call, ledger: Path) -> None:
    select = ("sql", ledger, "SELECT seq FROM events WHERE seq < 0")
    assert json.loads(call(*select, "--json").out)["rows"] == []
    assert call(*select, "--ndjson").out == ""
    assert call(*select, "--csv").out == "seq\n"


@pytest.mark.parametrize("other", ["--json", "--csv"])
@pytest.mark.parametrize("verb", [("sql", "LEDGER", "SELECT 1"), ("query", "failures", "LEDGER"), ("query", "--list")])
def test_two_forms_at_once_are_refused(call: Call, ledger: Path, verb: tuple[str, ...], other: str) -> None:
    words = [ledger if word == "LEDGER" else word for word in verb]
    one_message(call(*words, "--ndjson", other), 2, f"found {other} and --ndjson, expected one of them")


def test_queries_are_listed_a_line_each(call: Call) -> None:
    rows = lines_of(call("query", "--list", "--ndjson").out)
    assert rows == json.loads(call("query", "--list", "--json").out)["queries"]
    one_message(call("query", "failures", "--show", "--ndjson"), 2, "--ndjson", "SQL is text")


@pytest.mark.parametrize("suffix", few(files.LINES, []))
def test_an_export_of_lines_is_what_ndjson_shows(call: Call, ledger: Path, tmp_path: Path, suffix: str) -> None:
    answer, events = tmp_path / f"answer{suffix}", tmp_path / f"events{suffix}"
    assert call("export", ledger, "--query", "run_metrics", "--out", answer).code == 0
    assert answer.read_text() == call("query", "run_metrics", ledger, "--ndjson").out
    assert call("export", ledger, "--out", events).code == 0
    shown = lines_of(call("sql", ledger, "SELECT * FROM events", "--ndjson").out)
    assert in_order(lines_of(events.read_text())) == in_order(shown)


@pytest.mark.parametrize("form", few(FORMS, ["--csv"]))
def test_a_reader_that_has_enough_ends_a_long_answer(ledger: Path, form: str) -> None:
    command = [sys.executable, "-m", "fsar_ledger", "sql", str(ledger), MANY, form]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        assert process.stdout.readline()
        process.stdout.close()
        assert process.wait(timeout=20) == 0
        assert process.stderr.read() == b""


@pytest.mark.slow
@pytest.mark.parametrize("form", ["--ndjson", "--json"])
def test_memory_does_not_grow_with_the_text(ledger: Path, tmp_path: Path, form: str) -> None:
    few, many = (
        cost_of(["sql", str(ledger), f"SELECT {LONG_NAMES} FROM range({count})", form], tmp_path)
        for count in (1_000, 500_000)
    )
    assert (few.code, many.code) == (0, 0), many.said
    text_mib = 500_000 * 4 * len(f'"{"a" * 63}":123456,') >> 20
    assert many.memory_mib - few.memory_mib < text_mib / 2


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same 200,000 rows in each format: `ours.FORMAT`, and `copy.FORMAT` by DuckDB's COPY."""
    folder = tmp_path_factory.mktemp("rows")
    with duckdb.connect() as connection:
        table = connection.sql(ROWS.format(rows=200_000)).to_arrow_table()
        connection.register("answer", table)
        for kind in COPY:
            ours(table, kind, folder / f"ours.{kind}")
            duckdb_copy(connection, kind, folder / f"copy.{kind}")
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("kind", COPY)
def test_rows_take_little_more_room_than_duckdb_needs(written: Path, kind: str) -> None:
    own, copy = ((written / f"{name}.{kind}").stat().st_size for name in ("ours", "copy"))
    assert own < MOST * copy


@pytest.mark.slow
def test_duckdb_reads_the_same_rows_from_each_file_as_from_its_own(written: Path) -> None:
    reads = {"csv": "read_csv('{}')", "ndjson": "read_json('{}')", "parquet": "read_parquet('{}')"}
    for kind, read in reads.items():
        own, copy = (f"SELECT * FROM {read.format(written / f'{name}.{kind}')}" for name in ("ours", "copy"))
        with duckdb.connect() as connection:
            names = "seq, run_id, time_us, robot, action_id, reason, is_remote, share"
            more = connection.sql(f"SELECT {names} FROM ({own}) EXCEPT SELECT {names} FROM ({copy})").fetchall()
            assert (kind, more) == (kind, [])
            assert connection.execute(f"SELECT count(*) FROM ({own})").fetchone() == (200_000,)


def test_an_export_of_parquet_puts_small_commits_together(call: Call, ledger: Path, tmp_path: Path) -> None:
    out = tmp_path / "events.parquet"
    assert call("export", ledger, "--out", out).code == 0
    assert json.loads(call("info", ledger, "--json").out)["head"]["size"] == pq.read_metadata(out).num_rows
    assert pq.read_metadata(out).num_row_groups == 1


def test_a_long_table_of_parquet_has_row_groups_of_its_own(tmp_path: Path) -> None:
    rows = pa.table({"seq": range(files.GROUP_ROWS * 2 + 1)})
    files.write_table(tmp_path / "long.parquet", rows)
    stored = pq.ParquetFile(tmp_path / "long.parquet")
    groups = [stored.metadata.row_group(at).num_rows for at in range(stored.metadata.num_row_groups)]
    assert groups == [files.GROUP_ROWS, files.GROUP_ROWS, 1]
    assert stored.read().equals(rows)


def test_wide_tables_do_not_wait_for_a_whole_row_group(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "GROUP_BYTES", 1)
    out = tmp_path / "wide.parquet"
    tables = [pa.table({"seq": [at]}) for at in range(3)]
    assert files._write_tables(out, tables[0].schema, tables, raw=False) == 3
    assert pq.read_metadata(out).num_row_groups == 3


@pytest.mark.parametrize("text", ["=1+1", "@x", "  +1", "'@x", "''=x", "-", "a\x1b[2J", "é\u202e", "\x85=1", "\t=1"])
def test_a_dangerous_text_among_many_harmless_ones_is_found(tmp_path: Path, text: str) -> None:
    rows = pa.table({"robot": [*["robot/B1"] * 5_000, text, ""]})
    files.write_table(tmp_path / "rows.csv", rows)
    with (tmp_path / "rows.csv").open(newline="") as file:
        found = [row["robot"] for row in csv.DictReader(file)]
    assert found == [*["robot/B1"] * 5_000, field(text), ""]
    assert field(text) != text
