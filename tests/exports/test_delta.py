"""Readers of Delta tables count the rows of the ledger, whose own segments they read, and find its metrics."""

import os
from pathlib import Path
from typing import Any

import duckdb
import polars
import pytest

import fsar_ledger
from benchmarks.metrics import by_polars, by_sql, event_classes
from fsar_ledger.events.configuration import PAPER_ARCHITECTURES
from fsar_ledger.ledger.opening import open_for_answers
from fsar_ledger.ledger.rows.schema import SCHEMA
from fsar_ledger.metrics.database import from_table
from fsar_ledger.metrics.results import metric_rows
from tests.sure import known

deltalake = pytest.importorskip("deltalake", reason="make test-all installs it")


@pytest.fixture(scope="module")
def table(growing: fsar_ledger.Ledger, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Any]:
    out = tmp_path_factory.mktemp("delta") / "table"
    return out, growing.export(out, format="delta")


def files_of(out: Path) -> list[str]:
    return [str(uri) for uri in deltalake.DeltaTable(out).file_uris()]


def test_every_reader_counts_the_rows_of_the_ledger(table: tuple[Path, Any], growing: fsar_ledger.Ledger) -> None:
    size = growing.head.size
    rows = deltalake.DeltaTable(table[0]).to_pyarrow_table()
    with duckdb.connect() as database:
        database.register("rows", rows)
        (counted,) = known(database.execute("SELECT count(DISTINCT (run_id, seq)) FROM rows").fetchone())
        by_files = f"SELECT count(*) FROM read_parquet({files_of(table[0])}, union_by_name := true)"
        (in_files,) = known(database.execute(by_files).fetchone())
    found = (rows.num_rows, counted, in_files, polars.read_delta(str(table[0])).height, table[1].row_count)
    assert found == (size,) * 5


def test_segments_are_links_and_only_the_journal_is_written(
    table: tuple[Path, Any], growing: fsar_ledger.Ledger
) -> None:
    view = open_for_answers(growing.path)
    names = {Path(file).name for file in files_of(table[0])}
    segments = [growing.path / "segments" / name for name in names if (growing.path / "segments" / name).exists()]
    assert len(segments) == len(view.chain.placed) == len(names) - 1 > 0
    assert all(os.path.samefile(segment, table[0] / segment.name) for segment in segments)
    assert f"{len(segments)} segments are hard links into the ledger, 0 are copies" in table[1].notes[0]
    assert table[1].notes[1].startswith(f"{view.head.size - view.chain.placed_size:,} events of the journal")
    assert sorted(path.name for path in table[0].iterdir()) == sorted([*names, "_delta_log"])


def test_the_ledger_is_as_it_was_even_after_the_table_is_gone(growing: fsar_ledger.Ledger, tmp_path: Path) -> None:
    before = sorted(path.relative_to(growing.path) for path in growing.path.rglob("*"))
    growing.export(tmp_path / "table", format="delta")
    for path in sorted((tmp_path / "table").rglob("*"), reverse=True):
        path.rmdir() if path.is_dir() else path.unlink()
    assert sorted(path.relative_to(growing.path) for path in growing.path.rglob("*")) == before
    assert not growing.verify().problems


def test_where_there_can_be_no_links_there_are_copies_and_the_answer_says_so(
    growing: fsar_ledger.Ledger, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(18, "Invalid cross-device link")

    monkeypatch.setattr(os, "link", refuse)
    answer = growing.export(tmp_path / "table", format="delta")
    assert answer.notes[0] == "0 segments are hard links into the ledger, 2 are copies"
    assert polars.read_delta(str(tmp_path / "table")).height == growing.head.size


@pytest.mark.slow
def test_the_metrics_of_the_table_are_those_of_the_ledger(table: tuple[Path, Any], growing: fsar_ledger.Ledger) -> None:
    rows = deltalake.DeltaTable(table[0]).to_pyarrow_table().select(SCHEMA.names).cast(SCHEMA)
    with from_table(rows.sort_by([("run_id", "ascending"), ("seq", "ascending")])) as database:
        found = {(row.architecture, row.metric): row.mean for row in metric_rows(database)}  # SQL, in DuckDB
    stored = {(row["architecture"], row["metric"]): row["mean"] for row in growing.metrics().rows()}
    assert len({metric for _, metric in stored}) >= 8
    assert found == pytest.approx(stored, nan_ok=True)


@pytest.mark.slow
def test_polars_finds_the_eight_metrics_of_a_federation_of_ledgers_in_one_table(tmp_path: Path) -> None:
    """By judging rules written once more in Polars, over the table that both shards make."""
    places = [tmp_path / name for name in ("first", "second")]
    for number, place in enumerate(places):
        fsar_ledger.simulate(place, runs=2, first_run=2 * number, seed=5, origin=f"example.org/{place.name}")
    fsar_ledger.shards(tmp_path / "log", places)
    log = fsar_ledger.open_ledger(tmp_path / "log")
    log.export(tmp_path / "table", format="delta")
    found = by_polars(polars.scan_delta(str(tmp_path / "table")), event_classes(log.path))
    assert found == pytest.approx(by_sql(log.path), rel=1e-9)
    assert len(found) == 8 * len(PAPER_ARCHITECTURES)


def test_an_old_ledger_has_null_in_the_columns_that_came_later(tmp_path: Path, older: fsar_ledger.Ledger) -> None:
    answer = older.export(tmp_path / "table", format="delta")
    assert polars.read_delta(str(tmp_path / "table")).height == answer.row_count == older.head.size > 0
