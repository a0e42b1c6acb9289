"""Commands that read take the memory that they state, and say so when it is not enough; nothing of it is the ledger's
fault."""

import os
import sys
from pathlib import Path

import pytest

from fsar_ledger.api.verbs import WORTH_BYTES, readers_of, workers_of
from fsar_ledger.base import memory
from fsar_ledger.base.errors import LimitReached, UsageError
from fsar_ledger.cli.building import BASE_BYTES, PER_BYTE, PER_WORKER_BYTES, bounded, default_bytes
from fsar_ledger.ledger.store.problem import unexpected
from fsar_ledger.metrics.database import from_rows
from tests.ledger.bomb_trial import cost_of
from tests.quick import few
from tests.running import ran

from .conftest import Call, one_message

LITTLE = "memory: this needs more than 256 MiB, the limit"
HUNGRY = """
import sys
import tempfile
from pathlib import Path
from fsar_ledger.base import memory
from fsar_ledger.cli.building import bounded
Path("part").touch()
memory.unfinished.add(Path("part"))
Path("temporary").mkdir()
tempfile.tempdir = "temporary"
with memory.folder_for_spilling() as folder, bounded(256, Path("ledger")):
    Path(folder, "rows").touch()
    kept = []
    for number in range(4000):
        kept.append(bytearray(b"x") * (1 << 20))
print("done")
"""


FORKING = """
import os
from fsar_ledger.base import memory
kept = bytearray(b"x") * (1 << 28)
before = memory.bytes_held()
waits, ends = os.pipe()
if not (child := os.fork()):
    os.close(ends)
    os.read(waits, 1)
    os._exit(0)
print(before > 1 << 28, memory.bytes_held() < before * 1.1)
"""


@pytest.fixture(scope="module")
def many(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ledger of 20 runs of each scenario under each architecture."""
    path = tmp_path_factory.mktemp("many") / "ledger"
    assert cost_of(["simulate", str(path), "--runs", "20"], path.parent).code == 0
    return path


def test_a_child_that_has_not_begun_its_program_is_not_counted_twice() -> None:
    done = ran([sys.executable, "-c", FORKING])
    assert (done.stdout, done.stderr) == ("True True\n", "")


@pytest.mark.parametrize(
    "verb", ["info", "metrics", "statistics", "compare", "audit", "explain", "verify", "maintain recover"]
)
def test_every_command_that_reads_states_its_memory(call: Call, ledger: Path, verb: str) -> None:
    one_message(call(*verb.split(), ledger, "--memory", "255"), 2, "--memory 255", "at least 256")


def test_a_query_with_a_name_states_it_too(call: Call, ledger: Path) -> None:
    one_message(call("query", "failures", ledger, "--memory", "100"), 2, "--memory 100", "at least 256")
    one_message(call("metrics", ledger, "--memory", "9" * 20), 2, "--memory 99999", "at most 16777216")
    assert call("query", "failures", ledger, "--memory", "2000").code == 0


def test_what_takes_more_is_ended_with_one_message_and_leaves_no_half_file(tmp_path: Path) -> None:
    done = ran([sys.executable, "-c", HUNGRY], cwd=tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith(f"fsar-ledger: {LITTLE}; ")
    assert len(done.stderr.splitlines()) == 1
    assert not (tmp_path / "part").exists()
    assert not [*(tmp_path / "temporary").iterdir()]


@pytest.mark.skipif(
    not Path("/proc/self/statm").exists(), reason="only Linux says what a process and those that it started hold"
)
def test_the_processes_that_it_starts_count_too(tmp_path: Path) -> None:
    grow = "kept = bytearray(b'x') * (400 << 20); import time; time.sleep(60)"
    within = (
        "import subprocess, sys\nwith bounded(256, Path('ledger')):\n    subprocess.run([sys.executable, '-c', "
        f"{grow!r}])\n"
    )
    code = f"from pathlib import Path\nfrom fsar_ledger.cli.building import bounded\n{within}"
    done = ran([sys.executable, "-c", code], cwd=tmp_path, timeout=60)
    assert done.returncode == 2
    assert LITTLE in done.stderr


def test_what_is_asked_for_at_once_is_refused_by_the_system(tmp_path: Path) -> None:
    code = (
        "from pathlib import Path\nfrom fsar_ledger.cli.building import bounded\nwith bounded(256, "
        "Path('ledger')):\n    bytearray(64 << 30)\n"
    )
    done = ran([sys.executable, "-c", code], cwd=tmp_path)
    assert "LimitReached: memory: this needs more than 256 MiB" in done.stderr


def test_a_process_that_has_reserved_much_already_is_limited_like_another(tmp_path: Path) -> None:
    code = (
        "import mmap\nfrom pathlib import Path\nfrom fsar_ledger.cli.building import bounded\n"
        "reserved = [mmap.mmap(-1, 1 << 30, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS) for _ in range(8)]\n"
        "with bounded(256, Path('ledger')):\n    kept = bytearray(32 << 20)\nprint('done')\n"
    )
    done = ran([sys.executable, "-c", code], cwd=tmp_path, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (0, "done\n", "")


@pytest.mark.slow
def test_duckdb_counts_for_itself_and_spills_nowhere(tmp_path: Path) -> None:
    with bounded(512, tmp_path), from_rows([]) as database:
        settings = {row["name"]: row["value"] for row in database.rows("SELECT name, value FROM duckdb_settings()")}
        assert (settings["temp_directory"], settings["memory_limit"]) == ("", "384.0 MiB")
        with pytest.raises(LimitReached, match="needs more than 512 MiB"):
            database.rows("SELECT i FROM range(100000000) AS t(i) ORDER BY hash(i)")
    assert memory.limit() is None


def test_the_default_grows_with_what_the_segments_take(
    ledger: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert default_bytes(tmp_path, workers=2) == default_bytes(None, workers=2) == BASE_BYTES
    stored = sum(file.stat().st_size for file in (ledger / "segments").iterdir())
    assert default_bytes(ledger, workers=2) - BASE_BYTES == PER_BYTE * stored
    assert default_bytes(ledger, workers=2, memory_factor=3) - BASE_BYTES == 3 * PER_BYTE * stored
    (tmp_path / "segments").mkdir()
    (tmp_path / "segments" / "sparse").touch()
    os.truncate(tmp_path / "segments" / "sparse", 1 << 40)
    assert default_bytes(tmp_path, workers=2) == BASE_BYTES
    monkeypatch.setattr(memory, "bytes_installed", lambda: 1 << 29)
    assert default_bytes(ledger, workers=2) == int(0.8 * (1 << 29))


def test_processes_are_started_where_there_is_enough_to_do_or_they_are_asked_for(ledger: Path, tmp_path: Path) -> None:
    assert [readers_of(asked, ledger) for asked in (None, 1, 8)] == [1, 1, 8]
    (tmp_path / "segments").mkdir()
    (tmp_path / "segments" / "large").write_bytes(bytes(2 * WORTH_BYTES))
    assert readers_of(None, tmp_path) == min(2, workers_of(None))
    assert [workers_of(None, worth) for worth in (0, 1, 10_000)] == [1, 1, workers_of(None)]


def test_too_little_memory_is_no_damage() -> None:
    with pytest.raises(MemoryError):
        unexpected("segments/000000000000.parquet", 0, MemoryError())
    with pytest.raises(UsageError), bounded(1):
        pass


@pytest.mark.slow
def test_a_command_over_a_ledger_of_its_size_stays_within_it(ledger: Path, tmp_path: Path) -> None:
    cost = cost_of(["metrics", str(ledger), "--memory", "256"], tmp_path)
    assert cost.code == 0
    assert cost.memory_mib < 512


@pytest.mark.slow
@pytest.mark.parametrize(
    "verb",
    few(
        [
            "info",
            "metrics",
            "statistics",
            "audit",
            "study run multiverse",
            "explain",
            "compare --first fsar --second cfc",
        ],
        [],
        ["info", "statistics", "audit", "explain"],
    ),
)
def test_a_command_over_three_hundred_runs_stays_within_its_default(many: Path, tmp_path: Path, verb: str) -> None:
    words = verb.split()
    at = 3 if words[0] == "study" else 1
    cost = cost_of([*words[:at], str(many), *words[at:]], tmp_path)
    assert cost.code in (0, 1), cost.said
    assert cost.memory_mib < 448


def test_more_workers_may_take_more(tmp_path: Path) -> None:
    assert default_bytes(tmp_path, workers=1) == default_bytes(tmp_path, workers=2)
    assert default_bytes(tmp_path, workers=10) - default_bytes(tmp_path, workers=2) == 8 * PER_WORKER_BYTES


@pytest.mark.slow
def test_eight_workers_verify_a_ledger_without_more_memory_than_is_theirs(ledger: Path, call: Call) -> None:
    called = call("verify", ledger, "--workers", 8)
    assert called.code == 0, called.err
