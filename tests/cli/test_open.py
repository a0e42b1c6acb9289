"""`open`: a DuckDB file that other programs read, with every relation as the Python door answers it."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest

import fsar_ledger
from fsar_ledger.metrics.library import library
from tests.cli.conftest import Call, one_message

READER = """
import sys
import duckdb
import pyarrow as pa

file, folder, *calls = sys.argv[1:]
with duckdb.connect(file, read_only=True) as connection:
    for at, call in enumerate(calls):
        table = connection.sql(f"SELECT * FROM {call} ORDER BY ALL").to_arrow_table()
        with pa.OSFile(f"{folder}/{at}.arrow", "wb") as sink, pa.ipc.new_file(sink, table.schema) as writer:
            writer.write_table(table)
assert not any(name.startswith("fsar_ledger") for name in sys.modules)
"""
OLD = Path(__file__).parents[1] / "ledgers/0.1.0/ledger"


def read_elsewhere(file: Path, folder: Path, *calls: str) -> list[list[dict[str, Any]]]:
    """Return the rows of each relation or macro, read by plain DuckDB where nothing of this package is imported."""
    folder.mkdir(exist_ok=True)
    subprocess.run([sys.executable, "-I", "-c", READER, str(file), str(folder), *calls], check=True)
    return [pa.ipc.open_file(folder / f"{at}.arrow").read_all().to_pylist() for at in range(len(calls))]


def defaulted() -> dict[str, str]:
    """Return how SQL calls each packaged query that needs no value."""
    queries = library().queries.values()
    return {
        query.name: f"{query.relation}()" if query.parameters else query.relation
        for query in queries
        if all(one.default is not None for one in query.parameters.values())
    }


def sorted_rows(rows: list[dict[str, Any]]) -> list[str]:
    return sorted(json.dumps(row, default=str) for row in rows)


@pytest.mark.parametrize("is_old", [False, True], ids=["new", "0.1.0"])
def test_every_relation_reads_elsewhere_as_here(ledger: Path, tmp_path: Path, *, is_old: bool) -> None:
    opened = fsar_ledger.open_ledger(OLD if is_old else ledger)
    written = opened.open(tmp_path / "l.duckdb")
    calls = defaulted()
    found = read_elsewhere(written.file, tmp_path / "read", *calls.values())
    with opened.database() as database:
        for name, rows in zip(calls, found, strict=True):
            assert sorted_rows(rows) == sorted_rows(database.query(name).to_pylist()), name


def test_a_macro_takes_a_run_by_name(ledger: Path, tmp_path: Path) -> None:
    opened = fsar_ledger.open_ledger(ledger)
    run = opened.query("runs").rows()[-1]["run_id"]
    file = opened.open(tmp_path / "l.duckdb").file
    (found,) = read_elsewhere(file, tmp_path / "read", f"request_timeline(run := '{run}')")
    assert {row["run_id"] for row in found} == {run}
    assert sorted_rows(found) == sorted_rows(opened.query("request_timeline", run=str(run)).rows())


def test_the_file_names_its_head(ledger: Path, tmp_path: Path) -> None:
    written = fsar_ledger.open_ledger(ledger).open(tmp_path / "l.duckdb")
    head = written.provenance.head
    assert head is not None
    ((row,),) = read_elsewhere(written.file, tmp_path / "read", "ledger_head")
    assert (row["path"], row["commits"]) == (str(ledger.resolve()), head.commits)
    assert (row["events"], row["root"]) == (head.size, head.root)


def test_a_file_of_its_own_is_replaced(ledger: Path, tmp_path: Path) -> None:
    fsar_ledger.open_ledger(OLD).open(tmp_path / "l.duckdb")
    fsar_ledger.open_ledger(ledger).open(tmp_path / "l.duckdb")
    ((row,),) = read_elsewhere(tmp_path / "l.duckdb", tmp_path / "read", "ledger_head")
    assert row["path"] == str(ledger.resolve())


def test_a_file_of_someone_else_stays(call: Call, ledger: Path, tmp_path: Path) -> None:
    file = tmp_path / "l.duckdb"
    file.write_text("mine")
    one_message(call("open", ledger, "--out", file), 2, str(file), "not written", "choose another name")
    assert file.read_text() == "mine"


def test_another_suffix_is_refused(call: Call, ledger: Path, tmp_path: Path) -> None:
    one_message(call("open", ledger, "--out", tmp_path / "l.db"), 2, "'.db'", "expected .duckdb")


def test_a_place_inside_a_ledger_is_refused(call: Call, ledger: Path) -> None:
    one_message(call("open", ledger, "--out", ledger / "l.duckdb"), 2, str(ledger))
    assert not (ledger / "l.duckdb").exists()
