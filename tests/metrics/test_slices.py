"""A ledger in slices: whole runs, each once, and the same verdicts as from the whole ledger."""

import shutil
import sqlite3
import tempfile
from collections.abc import Callable, Iterator
from contextlib import closing
from itertools import pairwise
from pathlib import Path
from typing import Any

import duckdb
import msgspec
import pyarrow as pa
import pytest

import fsar_ledger
from fsar_ledger.ledger.opening import open_for_answers
from fsar_ledger.ledger.store.derived import Extent
from fsar_ledger.metrics import connection, database, slices
from fsar_ledger.metrics.database import Database, Slices, connect
from fsar_ledger.metrics.invariants import audit_rows, invariants
from fsar_ledger.metrics.library import library
from fsar_ledger.metrics.slices import Slice
from fsar_ledger.runtime import simulation
from fsar_ledger.runtime.experiment import Experiment, run_experiment
from tests.quick import few

WHOLE = Experiment(("fsar", "cfc", "dhma"), ("door-relay", "fleet-contention"), 2, 7)
EVENTS = "SELECT run_id, seq, type FROM events ORDER BY ALL"


@pytest.fixture(scope="module")
def ledger(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("slices") / "ledger"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simulation, "COMMIT_EVENTS", 300)  # most runs are in several segments
        run_experiment(path, WHOLE, 1)
    return path


def test_slices_hold_whole_runs_and_each_event_once(ledger: Path) -> None:
    view = open_for_answers(ledger)
    of = Slices(view, most=1_500)
    with connect(ledger) as whole:
        expected, runs = whole.rows(EVENTS), whole.rows("SELECT run_id FROM runs ORDER BY ALL")
    found, known = [], []
    for some in of:
        found += some.rows(EVENTS)
        known += some.rows("SELECT run_id FROM runs ORDER BY ALL")
    assert len(of) > 3
    assert sorted(found, key=str) == sorted(expected, key=str)
    assert sorted(known, key=str) == sorted(runs, key=str)
    assert [extent.rows for extent in view.extents()] == [
        sum(row["run_id"] == extent.run for row in expected) for extent in view.extents()
    ]


@pytest.mark.parametrize("most", few([1, 2_000, 5_000], [], [2_000, 5_000]))
def test_the_verdicts_of_slices_are_those_of_the_whole_ledger(ledger: Path, most: int) -> None:
    told: list[tuple[int, int]] = []
    with connect(ledger) as whole:
        expected = audit_rows(whole, invariants())
    of = Slices(open_for_answers(ledger), most=most)
    assert audit_rows(of, invariants(), (), lambda done, total: told.append((done, total))) == expected
    assert told[-1] == (len(of) * 10, len(of) * 10)
    assert any(row.events for row in expected)
    assert any(row.holds for row in expected)


@pytest.fixture
def in_slices(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Have ledgers of more than 3,500 events judged in slices, with a cache of their own, whose file is returned."""
    monkeypatch.setattr(database, "SLICE_EVENTS", 3_500)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "fsar-ledger" / "slices.sqlite"


@pytest.fixture(scope="module")
def known(ledger: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[pa.Table, Path]:
    """The metrics of the ledger, judged in such slices, and the file of the cache that this leaves."""
    folder = tmp_path_factory.mktemp("known")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(database, "SLICE_EVENTS", 3_500)
        patch.setenv("XDG_CACHE_HOME", str(folder))
        return fsar_ledger.open_ledger(ledger).metrics().arrow(), folder / "fsar-ledger" / "slices.sqlite"


@pytest.fixture
def cached(in_slices: Path, known: tuple[pa.Table, Path]) -> pa.Table:
    """Have the ledger judged in slices, its metrics in the cache; they are returned."""
    in_slices.parent.mkdir(parents=True)
    shutil.copy(known[1], in_slices)
    return known[0]


def judged(ledger: Path) -> list[list[dict[str, Any]]]:
    """Return what the verbs answer that judge all runs of a ledger."""
    of = fsar_ledger.open_ledger(ledger)
    tables = [of.metrics(), of.metrics(by="scenario", pool="seeds"), of.statistics().table(), of.audit().table()]
    tables += [of.compare("fsar", "cfc").table(), of.multiverse(metric=["policy_violations"]).table()]
    return [table.rows() for table in tables]


def looks(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return a list that gets the events of each slice that is read from now on."""
    found: list[int] = []
    fill = slices.fill

    def counted(database: Database, one: Slice, *args: Any) -> None:
        found.append(sum(run.rows for run in one.runs))
        fill(database, one, *args)

    monkeypatch.setattr(slices, "fill", counted)
    return found


@pytest.mark.slow
def test_a_question_about_runs_reads_no_event_where_their_beginnings_are_known(
    ledger: Path, cached: pa.Table, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = "SELECT * FROM runs ORDER BY run_id"
    read = looks(monkeypatch)
    with connect(ledger) as found:
        rows = found.rows(asked)
    assert not read
    assert len(rows) == len({*cached["architecture"].to_pylist()}) * 4
    monkeypatch.setattr(database, "SLICE_EVENTS", 1 << 30)
    with connect(ledger) as whole:
        assert whole.rows(asked) == rows


@pytest.mark.parametrize("has_place", [True, False])
def test_what_does_not_fit_into_the_memory_for_slices_is_spilled_or_held_after_all(
    ledger: Path, cached: pa.Table, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, has_place: bool
) -> None:
    spilled = tmp_path / "spilled"
    monkeypatch.setattr(tempfile, "tempdir", str(spilled))
    if has_place:
        spilled.mkdir()
    monkeypatch.setattr(connection, "HELD_MIB", (1, 2))  # less than DuckDB needs for any question
    with connect(ledger) as database:
        assert len([*spilled.glob("*")]) == has_place
        expected = len({*cached["metric"].to_pylist()}) * 12
        assert database.table("SELECT count(*) AS n FROM run_metrics")["n"].to_pylist() == [expected]
        assert not database._held_mib
    assert not [*spilled.glob("*")]


@pytest.mark.soak  # tests/api/test_shards.py asks the same of the slices of a federation
def test_verbs_answer_the_same_in_slices_and_from_the_cache(
    ledger: Path, in_slices: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as whole:
        whole.setattr(database, "SLICE_EVENTS", 1 << 30)
        expected = judged(ledger)
    seen = looks(monkeypatch)
    assert judged(ledger) == expected
    assert len(seen) > 3
    seen.clear()
    assert judged(ledger) == expected
    assert not seen


@pytest.mark.slow
@pytest.mark.usefixtures("in_slices")
def test_where_there_is_no_place_for_a_cache_all_slices_are_read(
    ledger: Path, known: tuple[pa.Table, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", "/dev/null")
    seen = looks(monkeypatch)
    assert fsar_ledger.open_ledger(ledger).metrics().arrow() == known[0]
    assert len(seen) == len(Slices(open_for_answers(ledger)))


OF_SLICES = [
    name for name, query in library().queries.items() if not query.parameters and library().partial([query.relation])
]
"""The queries that read what slices answer; to others it is all one."""


@pytest.mark.slow
@pytest.mark.parametrize("name", OF_SLICES)
def test_every_query_answers_the_same_in_slices(name: str, both: tuple[Database, Database]) -> None:
    whole, sliced = both
    assert sliced.query(name).equals(whole.query(name))


@pytest.mark.slow
@pytest.mark.usefixtures("in_slices")
def test_a_file_for_other_programs_is_the_same_made_of_slices(
    ledger: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read = looks(monkeypatch)
    made = fsar_ledger.open_ledger(ledger).open(tmp_path / "sliced.duckdb")
    assert read
    monkeypatch.setattr(database, "SLICE_EVENTS", 1 << 30)
    assert fsar_ledger.open_ledger(ledger).open(tmp_path / "whole.duckdb").relations == made.relations
    with duckdb.connect(tmp_path / "sliced.duckdb") as sliced, duckdb.connect(tmp_path / "whole.duckdb") as whole:
        tables, views = ([dict(told(file, kind)) for file in (sliced, whole)] for kind in ("table", "view"))
        assert tables[1].keys() <= tables[0].keys()
        assert views[0].items() <= views[1].items()
        assert tables[0].keys() | views[0].keys() == tables[1].keys() | views[1].keys()
        for name in tables[0]:
            rows = [file.sql(f"FROM {name} ORDER BY ALL").to_arrow_table() for file in (sliced, whole)]
            assert rows[0].equals(rows[1]), name


def told(file: duckdb.DuckDBPyConnection, kind: str) -> list[tuple[str, str]]:
    """Return the name and the SQL of each table, or each view, of a file; a view reads what the file holds."""
    return file.execute(f"SELECT {kind}_name, sql FROM duckdb_{kind}s() WHERE NOT internal").fetchall()


@pytest.fixture(scope="module")
def both(ledger: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Database, Database]]:
    with pytest.MonkeyPatch.context() as patch, connect(ledger) as whole:
        patch.setattr(database, "SLICE_EVENTS", 3_500)
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        with connect(ledger) as sliced:
            assert sliced.slices is not None
            yield whole, sliced


@pytest.mark.slow
@pytest.mark.usefixtures("cached")
def test_after_an_append_only_the_last_slices_are_read(
    ledger: Path, in_slices: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    grown = shutil.copytree(ledger, tmp_path / "grown")
    run_experiment(grown, msgspec.structs.replace(WHOLE, runs=3), 1)
    seen = looks(monkeypatch)
    found = fsar_ledger.open_ledger(grown).metrics().arrow()
    view = open_for_answers(grown)
    added = view.head.size - open_for_answers(ledger).head.size
    assert added <= sum(seen) <= added + 2 * database.SLICE_EVENTS < view.head.size
    in_slices.unlink()
    assert fsar_ledger.open_ledger(grown).metrics().arrow() == found


@pytest.mark.slow
def test_compacting_a_ledger_keeps_what_is_known_of_it(
    ledger: Path, cached: pa.Table, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compacted = fsar_ledger.open_ledger(shutil.copytree(ledger, tmp_path / "compacted"))
    done = compacted.compact()
    assert done.after < done.before
    seen = looks(monkeypatch)
    assert compacted.metrics().arrow() == cached
    assert not seen


def damaged_rows(file: Path) -> None:
    with closing(sqlite3.connect(file)) as cache, cache:
        cache.execute("UPDATE answers SET data = zeroblob(length(data))")


def swapped_rows(file: Path) -> None:
    """Give each slice what another one answered, its digest with it."""
    with closing(sqlite3.connect(file)) as cache, cache:
        rows = cache.execute("SELECT asked, sha256, data, slice FROM answers ORDER BY asked, slice").fetchall()
        for (asked, _, _, of), (other, sha256, data, _) in pairwise(rows):
            if asked == other:
                cache.execute(
                    "UPDATE answers SET sha256 = ?, data = ? WHERE asked = ? AND slice = ?", [sha256, data, asked, of]
                )


def truncated(file: Path) -> None:
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])


def no_database(file: Path) -> None:
    file.write_bytes(b"no database" * 1_000)


def open_to_others(file: Path) -> None:
    swapped_rows(file)
    file.chmod(0o666)


@pytest.mark.parametrize(
    "change", few([damaged_rows, swapped_rows, truncated, no_database, open_to_others], [swapped_rows])
)
def test_a_damaged_cache_is_made_again_and_never_believed(
    ledger: Path, in_slices: Path, cached: pa.Table, change: Callable[[Path], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    change(in_slices)
    seen = looks(monkeypatch)
    assert fsar_ledger.open_ledger(ledger).metrics().arrow() == cached
    assert seen
    if change is not open_to_others:
        seen.clear()
        assert fsar_ledger.open_ledger(ledger).metrics().arrow() == cached
        assert not seen


@pytest.mark.slow
@pytest.mark.usefixtures("cached")
def test_another_program_and_another_query_are_not_answered_from_the_cache(
    ledger: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = looks(monkeypatch)
    fsar_ledger.open_ledger(ledger).metrics()
    assert not seen
    monkeypatch.setattr(slices, "_program", lambda: "another")
    fsar_ledger.open_ledger(ledger).metrics()
    assert seen
    assert (
        slices.slice_query("SELECT * FROM coordination_success").text
        != slices.slice_query("SELECT * FROM failures").text
    )


def test_a_ledger_with_the_root_of_another_is_not_answered_from_its_cache(
    ledger: Path, in_slices: Path, tmp_path: Path
) -> None:
    """Whoever can write the folder can have the chain place a segment with other rows; no answer may mix the two."""
    forged = shutil.copytree(ledger, tmp_path / "forged")
    views = [open_for_answers(one) for one in (ledger, forged)]
    placed = views[1].chain.placed
    placed[0] = msgspec.structs.replace(placed[0], segment_sha256="0" * 64)
    first, second = ({one.digest for one in Slices(view)._slices} for view in views)
    assert views[0].head.root == views[1].head.root
    assert len(first - second) == 1


@pytest.mark.slow
def test_the_cache_has_an_upper_bound(
    ledger: Path, in_slices: Path, known: tuple[pa.Table, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    lengths = "SELECT sum(length(data)), max(length(data)) FROM answers"
    with closing(sqlite3.connect(known[1])) as cache:
        total, longest = cache.execute(lengths).fetchone()
    most = 2 * longest  # whichever answer is kept last, it fits
    assert total > most
    monkeypatch.setattr(slices, "CACHE_BYTES", most)
    assert fsar_ledger.open_ledger(ledger).metrics().arrow() == known[0]
    with closing(sqlite3.connect(in_slices)) as cache:
        assert 0 < cache.execute(lengths).fetchone()[0] <= most
    assert fsar_ledger.open_ledger(ledger).metrics().arrow() == known[0]


def test_runs_that_continue_each_other_are_in_slices_where_they_end() -> None:
    extents = [Extent("a", 600, 0, 600), Extent("b", 900, 600, 1_500), Extent("a2", 400, 1_500, 1_900)]
    found = list(database._windows([[extents[0], extents[2]], [extents[1]]], 1_500))
    assert [[one.run for one in part] for part in found] == [["b"], ["a", "a2"]]
