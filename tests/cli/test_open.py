"""`open`: a DuckDB file that other programs read, with every relation as the Python door answers it."""

import json
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import duckdb
import pyarrow as pa
import pytest

import fsar_ledger
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.v1 import upgrade
from fsar_ledger.metrics.library import library
from tests.cli.conftest import Call, Called, in_a_process, one_message
from tests.cli.test_interruption import limited_disk
from tests.ledger.crash_trials import RUNS, piece
from tests.ledger.keep_release import LEDGERS
from tests.ledger.samples import ORIGIN
from tests.quick import few
from tests.running import ran

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
OLD = LEDGERS / "0.1.0" / "ledger"


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


def described(calls: dict[str, str]) -> dict[str, str]:
    """Return the calls, but where a relation draws hundreds of thousands of rows, one for its columns and their types:
    that it can be read is found so as well, and the soak compares its rows."""
    return {
        name: f"(DESCRIBE FROM {call})" if call.startswith(("drawn_", "cluster_")) else call
        for name, call in calls.items()
    }


def sorted_rows(rows: list[dict[str, Any]]) -> list[str]:
    return sorted(json.dumps(row, default=str) for row in rows)


class Opened(NamedTuple):
    """A file that `open` wrote, and what it said."""

    file: Path
    said: str


@pytest.fixture(scope="module")
def opened(ledger: Path, tmp_path_factory: pytest.TempPathFactory) -> Opened:
    """The ledger in a file that tests only read."""
    file = tmp_path_factory.mktemp("opened") / "l.duckdb"
    called = in_a_process("open", ledger, "--out", file)
    assert called.code == 0, called.err
    return Opened(file, called.out)


@pytest.fixture(scope="module")
def upgraded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The ledger of release 0.1.0 in today's format."""
    path = tmp_path_factory.mktemp("upgraded") / "ledger"
    upgrade(OLD, path)
    return path


@pytest.fixture(scope="module")
def old(upgraded: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file of another ledger, to be copied."""
    return fsar_ledger.open_ledger(upgraded).open(tmp_path_factory.mktemp("old") / "l.duckdb").file


@pytest.mark.slow
def test_every_relation_reads_elsewhere_as_here(ledger: Path, opened: Opened, tmp_path: Path) -> None:
    calls = described(defaulted())
    assert len(set(calls.values()) - set(defaulted().values())) > 3
    found = read_elsewhere(opened.file, tmp_path / "read", *calls.values())
    with fsar_ledger.open_ledger(ledger).database() as database:
        for (name, call), rows in zip(calls.items(), found, strict=True):
            is_whole = call == defaulted()[name]
            here = database.query(name).to_pylist() if is_whole else database.rows(f"FROM {call}")
            assert sorted_rows(rows) == sorted_rows(here), name


@pytest.mark.soak
@pytest.mark.parametrize("is_old", [False, True], ids=["new", "0.1.0"])
def test_every_row_of_every_relation_reads_elsewhere_as_here(
    ledger: Path, upgraded: Path, tmp_path: Path, *, is_old: bool
) -> None:
    opened = fsar_ledger.open_ledger(upgraded if is_old else ledger)
    written = opened.open(tmp_path / "l.duckdb")
    assert written.provenance.head == opened.head
    calls = defaulted()
    found = read_elsewhere(written.file, tmp_path / "read", *calls.values())
    with opened.database() as database:
        for name, rows in zip(calls, found, strict=True):
            assert sorted_rows(rows) == sorted_rows(database.query(name).to_pylist()), name


def in_pieces(path: Path) -> Path:
    """Make a ledger of two segments, and of rows that are in no segment yet."""
    with Writer(path, ORIGIN) as writer:
        for run in RUNS[:2]:
            writer.add([run])
            writer.seal()
        writer.add([piece(2, 0, 20)])
    return path


@pytest.mark.slow
def test_rows_of_a_journal_stay_in_the_file_until_segments_are_compacted(tmp_path: Path) -> None:
    path, file = in_pieces(tmp_path / "ledger"), tmp_path / "l.duckdb"
    assert in_a_process("open", path, "--out", file).code == 0  # whose temporary files are gone with it
    with duckdb.connect(str(file), read_only=True) as elsewhere:
        views = elsewhere.execute("SELECT string_agg(sql) FROM duckdb_views() WHERE NOT internal").fetchall()
    read = re.findall(r"'([^']*)[.]parquet'", views[0][0])
    assert {str(Path(one).parent) for one in read} == {str(path / "segments")}
    calls = ("events", "run_numbers", "ledger_head", "runs", "denials()")
    found = read_elsewhere(file, tmp_path / "read", *calls)
    with fsar_ledger.open_ledger(path).database() as database:
        here = {call: database.rows(f"FROM {call}") for call in ("events", "run_numbers", "runs")}
    assert [sorted_rows(rows) for rows in found[:2]] == [sorted_rows(here["events"]), sorted_rows(here["run_numbers"])]
    assert sorted_rows(found[3]) == sorted_rows(here["runs"])
    assert found[2][0]["events"] == len(found[0]) == 100
    with Writer(path, ORIGIN) as writer:
        writer.add([piece(2, 20, 40)])
        writer.seal()
    assert read_elsewhere(file, tmp_path / "read", *calls) == found
    fsar_ledger.open_ledger(path).compact()
    with (
        duckdb.connect(str(file), read_only=True) as elsewhere,
        pytest.raises(duckdb.IOException, match=str(path / "segments")),
    ):
        elsewhere.execute("FROM events").fetchall()


@pytest.mark.parametrize("step", few([1, 2], [], [2]))
def test_the_command_line_of_an_older_duckdb_answers_alike(
    ledger: Path, opened: Opened, tmp_path: Path, step: int
) -> None:
    pytest.importorskip("duckdb_cli", reason="make test-all installs it")
    calls = list(described(defaulted()).values())[::step]
    script = "\n".join(f"SELECT to_json(whole) AS r FROM {call} AS whole ORDER BY r; SELECT '--';" for call in calls)
    command = [sys.executable, "-m", "duckdb_cli", "-readonly", "-list", "-noheader", "-bail", str(opened.file)]
    older = ran(command, input=script)
    assert (older.returncode, older.stderr) == (0, "")
    with duckdb.connect(str(opened.file), read_only=True) as newer:
        for call, answer in zip(calls, older.stdout.split("--\n")[:-1], strict=True):
            rows = newer.execute(f"SELECT to_json(whole)::VARCHAR AS r FROM {call} AS whole ORDER BY r").fetchall()
            assert answer.splitlines() == [row for (row,) in rows], call


def test_the_file_is_of_a_storage_version_that_older_programs_read(opened: Opened) -> None:
    with duckdb.connect(str(opened.file), read_only=True) as elsewhere:
        ((tags,),) = elsewhere.execute("SELECT tags FROM duckdb_databases() WHERE path IS NOT NULL").fetchall()
        own = elsewhere.execute("SELECT function_name FROM duckdb_functions() WHERE NOT internal").fetchall()
    assert tags["storage_version"] == "v1.0.0+"
    assert ("if",) in own  # which older programs lack


def test_denials_of_one_run_are_read_from_tables(opened: Opened) -> None:
    with duckdb.connect(str(opened.file), read_only=True) as elsewhere:
        for name, table in (("denials", "denied_actions"), ("grounds_of_denials", "policy_grounds")):
            ((_, plan),) = elsewhere.execute(f"EXPLAIN FROM {name}(run := 1)").fetchall()
            assert table in plan
            assert plan.lower().count("read_parquet") <= 2  # the names of plans, of which one could be asked for


@pytest.mark.slow
def test_a_macro_takes_a_run_by_name(ledger: Path, opened: Opened, tmp_path: Path) -> None:
    here = fsar_ledger.open_ledger(ledger)
    run = list(here.numbers())[-1]
    (found,) = read_elsewhere(opened.file, tmp_path / "read", f"request_timeline(run := '{run}')")
    assert {row["run_id"] for row in found} == {run}
    assert sorted_rows(found) == sorted_rows(here.query("request_timeline", run=run).rows())


@pytest.mark.slow
def test_a_macro_takes_a_run_by_its_number_and_refuses_one_that_is_not_on_record(
    ledger: Path, opened: Opened, tmp_path: Path
) -> None:
    here = fsar_ledger.open_ledger(ledger)
    run, number = list(here.numbers().items())[-1]
    calls = [f"requests(run := {given})" for given in (f"'{run}'", f"'{number}'", number)]
    found = read_elsewhere(opened.file, tmp_path / "read", *calls)
    assert [sorted_rows(rows) for rows in found] == [sorted_rows(here.query("requests", run=run).rows())] * 3
    assert found[0]
    with duckdb.connect(str(opened.file), read_only=True) as elsewhere:
        for unknown in ("'nosuch'", "999", "''", "NULL"):
            with pytest.raises(duckdb.InvalidInputException, match=r"no such run, .* FROM run_numbers` lists"):
                elsewhere.execute(f"FROM denials(run := {unknown})").fetchall()


def test_a_macro_takes_a_short_name_and_refuses_one_that_is_not_on_record(opened: Opened) -> None:
    with duckdb.connect(str(opened.file), read_only=True) as elsewhere:
        counts = [
            elsewhere.execute(f"SELECT count(*) FROM robot_state_at(robot := '{name}')").fetchall()
            for name in ("A1", "robot/A1")
        ]
        assert counts[0] == counts[1] != [(0,)]
        for given in ("robot_state_at(robot := 'Z9')", "requests(action := 'nope')", "requests(action := NULL)"):
            with pytest.raises(duckdb.InvalidInputException, match=r"no such (robot|action), expected the name"):
                elsewhere.execute(f"FROM {given}").fetchall()


@pytest.mark.parametrize(
    ("call", "kind"),
    [
        ("churn(run := 999)", "run"),  # over relations without a row
        ("policy_at(capability := 'nope')", "capability"),
        ("trust_at(context := 'nope')", "context"),
        ("refusals(reason := 'nope')", "reason"),
        ("unattributed_records(kind := 'nope')", "record"),
        ("decision_owner(seq := 999999)", "event"),
    ],
)
def test_a_macro_refuses_whatever_is_not_on_record(opened: Opened, call: str, kind: str) -> None:
    with (
        duckdb.connect(str(opened.file), read_only=True) as elsewhere,
        pytest.raises(duckdb.InvalidInputException, match=f"there is no such {kind}"),
    ):
        elsewhere.execute(f"FROM {call}").fetchall()


@pytest.mark.slow
def test_open_says_how_to_call_a_macro(ledger: Path, opened: Opened, tmp_path: Path) -> None:
    macro = opened.said.partition("as in `FROM ")[2].partition("`")[0]
    (found,) = read_elsewhere(opened.file, tmp_path / "read", macro)
    assert sorted_rows(found) == sorted_rows(fsar_ledger.open_ledger(ledger).query("denials", run="1").rows())


def test_the_file_names_its_head(ledger: Path, opened: Opened, tmp_path: Path) -> None:
    head = fsar_ledger.open_ledger(ledger).head
    ((row,),) = read_elsewhere(opened.file, tmp_path / "read", "ledger_head")
    assert (row["path"], row["commits"]) == (str(ledger.resolve()), head.commits)
    assert (row["events"], row["root"]) == (head.size, head.root)


@pytest.mark.slow
def test_a_file_of_its_own_is_replaced(ledger: Path, old: Path, tmp_path: Path) -> None:
    shutil.copy(old, tmp_path)
    opened = fsar_ledger.open_ledger(ledger)
    assert opened.open(tmp_path / "l.duckdb").provenance.head == opened.head
    ((row,),) = read_elsewhere(tmp_path / "l.duckdb", tmp_path / "read", "ledger_head")
    assert row["path"] == str(ledger.resolve())


def test_a_file_of_someone_else_stays(call: Call, ledger: Path, tmp_path: Path) -> None:
    file = tmp_path / "l.duckdb"
    file.write_text("mine")
    one_message(call("open", ledger, "--out", file), 2, str(file), "not written", "choose another name")
    assert file.read_text() == "mine"


def test_another_suffix_is_refused_and_the_ledger_itself_is_no_place(call: Call, ledger: Path, tmp_path: Path) -> None:
    one_message(call("open", ledger, "--out", tmp_path / "l.db"), 2, "'.db'", "expected .duckdb")
    one_message(call("open", ledger, "--out", ledger), 2, f"{ledger}: found", "expected .duckdb")


@pytest.mark.slow
def test_an_empty_ledger_has_every_relation_without_rows(call: Call, tmp_path: Path) -> None:
    with Writer(tmp_path / "empty", origin="fsar-ledger/empty"):
        pass
    called = call("open", tmp_path / "empty", "--out", tmp_path / "l.duckdb")
    assert called.code == 0, called.err
    head, runs, requests = read_elsewhere(tmp_path / "l.duckdb", tmp_path / "read", "ledger_head", "runs", "requests()")
    assert ([row["events"] for row in head], runs, requests) == ([0], [], [])


@pytest.mark.parametrize("bytes_max", few([4_096, 1 << 18, 3 << 20, 5 << 20], [], [4_096, 1 << 18, 5 << 20]))
def test_a_full_disk_leaves_the_old_file_and_no_part_of_a_new_one(
    ledger: Path, old: Path, tmp_path: Path, bytes_max: int
) -> None:
    file = Path(shutil.copy(old, tmp_path))
    before = file.read_bytes()
    called = limited_disk("open", ledger, "--out", file, "--verified", file_bytes_max=bytes_max)
    one_message(Called(called.returncode, called.stdout, called.stderr), 1, f"{file}: cannot be written", "too large")
    assert list(tmp_path.iterdir()) == [file]
    assert file.read_bytes() == before


def test_a_place_where_nothing_can_be_written_is_named(call: Call, ledger: Path, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "folder.duckdb").mkdir()
    for out in (tmp_path / "file" / "l.duckdb", Path("/proc/l.duckdb")):
        called = call("open", ledger, "--out", out)
        one_message(called, 1, f"{out}: cannot be written", "choose another place")
        assert ".part" not in called.err
    one_message(call("open", ledger, "--out", tmp_path / "folder.duckdb"), 2, "found a folder", "choose another name")


def test_a_file_that_another_program_writes_stays(call: Call, ledger: Path, old: Path, tmp_path: Path) -> None:
    file = Path(shutil.copy(old, tmp_path))
    before = file.read_bytes()
    held = (
        f"import duckdb, sys\nwith duckdb.connect({str(file)!r}):\n    print('held', flush=True)\n    sys.stdin.read()"
    )
    with subprocess.Popen([sys.executable, "-c", held], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        assert other.stdout is not None
        assert other.stdout.readline()
        one_message(call("open", ledger, "--out", file), 2, "another program has open", "close it there")
        other.communicate()
    assert file.read_bytes() == before


@pytest.mark.slow
def test_two_at_once_leave_one_whole_file(ledger: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "fsar_ledger", "open", str(ledger), "--out", str(tmp_path / "l.duckdb")]
    both = [subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) for _ in range(2)]
    ended = [(*process.communicate(timeout=120), process.returncode) for process in both]
    assert [(error, code) for _, error, code in ended] == [("", 0), ("", 0)]
    assert list(tmp_path.iterdir()) == [tmp_path / "l.duckdb"]
    ((row,),) = read_elsewhere(tmp_path / "l.duckdb", tmp_path / "read", "ledger_head")
    assert row["path"] == str(ledger.resolve())


def test_ctrl_c_leaves_nothing_half_written(ledger: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "fsar_ledger", "open", str(ledger), "--out", str(tmp_path / "l.duckdb")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        deadline = time.monotonic() + 60
        while not list(tmp_path.iterdir()) and process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.005)
        process.send_signal(signal.SIGINT)
        _, error = process.communicate(timeout=60)
    assert (process.returncode, error) == (130, "fsar-ledger: interrupted; nothing was changed\n")
    assert list(tmp_path.iterdir()) == []
