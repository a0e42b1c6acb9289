"""Work that a cluster does: the same bytes and answers, whoever does it and whoever dies."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

import fsar_ledger
from fsar_ledger.analysis import whatif
from fsar_ledger.base import workers
from fsar_ledger.base.errors import SequenceConflict, UsageError, WorkerDied
from fsar_ledger.ledger.opening import open_for_answers
from fsar_ledger.metrics import database, slices

distributed = pytest.importorskip("distributed", reason="make test-all installs it")
pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def small_slices(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Have ledgers judged in slices of 6,000 events, without what is known from other tests."""
    monkeypatch.setattr(database, "SLICE_EVENTS", 6_000)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def simulated(out: Path, **more: object) -> "fsar_ledger.Ledger":
    return fsar_ledger.simulate(out, scenario=["door-relay", "fleet-contention"], runs=4, seed=3, **more).ledger  # type: ignore[arg-type]


def judged(ledger: "fsar_ledger.Ledger") -> list[object]:
    tables = [ledger.metrics(), ledger.statistics().table(), ledger.audit().table()]
    return [table.arrow() for table in tables]


@contextmanager
def scheduler(count: int = 2) -> Iterator[tuple[str, Any]]:
    """Run a scheduler and workers whose processes restart when they die; yield its address."""
    with distributed.LocalCluster(n_workers=count, threads_per_worker=1, dashboard_address=":0") as made:
        yield made.scheduler_address, made
        with distributed.Client(made) as client:  # closed while a worker begins again, distributed would fail
            client.wait_for_workers(count, timeout=60)


def test_a_cluster_makes_the_same_ledger_and_gives_the_same_answers(tmp_path: Path) -> None:
    alone = simulated(tmp_path / "alone", workers=1)
    expected = judged(alone)
    (tmp_path / "cache/fsar-ledger/slices.sqlite").unlink()
    for count in (1, 2):
        with fsar_ledger.cluster(f"local:{count}"):
            made = simulated(tmp_path / f"made{count}")
            assert judged(made) == expected
            assert made.verify().ok
        assert (made.path / "chain.jsonl").read_bytes() == (alone.path / "chain.jsonl").read_bytes()
        (tmp_path / "cache/fsar-ledger/slices.sqlite").unlink()


def test_a_worker_that_is_killed_in_the_middle_changes_no_byte_and_no_answer(tmp_path: Path) -> None:
    alone = simulated(tmp_path / "alone", workers=1)
    expected = judged(alone)
    (tmp_path / "cache/fsar-ledger/slices.sqlite").unlink()
    with scheduler() as (address, made), fsar_ledger.cluster(address):
        killer = subprocess.Popen([sys.executable, "-c", _KILLER, *map(str, pids(made))])
        found = simulated(tmp_path / "made")
        assert judged(found) == expected
        killer.wait()
    assert (found.path / "chain.jsonl").read_bytes() == (alone.path / "chain.jsonl").read_bytes()


_KILLER = """
import os, signal, sys, time
for process in map(int, sys.argv[1:]):
    time.sleep(0.5)
    os.kill(process, signal.SIGKILL)
"""


def pids(made: Any) -> list[int]:
    return [worker.pid for worker in made.workers.values()]


def test_a_call_whose_worker_always_dies_is_an_error_that_says_so(tmp_path: Path) -> None:
    with scheduler(1) as (address, _), fsar_ledger.cluster(address), workers.pool_of(1) as pool:
        assert pool is not None
        with pytest.raises(WorkerDied, match="KilledWorker"):
            pool.submit(signal.raise_signal, signal.SIGKILL).result()


def test_a_scheduler_that_dies_is_an_error_and_what_is_committed_stays(tmp_path: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", _SCHEDULER, str(tmp_path / "address")], start_new_session=True, stderr=subprocess.DEVNULL
    )
    try:
        while not (tmp_path / "address").exists():
            time.sleep(0.05)
        with fsar_ledger.cluster((tmp_path / "address").read_text()), workers.pool_of(1) as pool:
            assert pool is not None
            waiting = pool.submit(time.sleep, 60)
            os.killpg(process.pid, signal.SIGKILL)
            with pytest.raises(WorkerDied):
                waiting.result(timeout=50)
    finally:
        process.kill()


_SCHEDULER = """
import sys, time
from pathlib import Path
from typing import Any
from distributed import LocalCluster
if __name__ == "__main__":
    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=":0") as made:
        file = Path(sys.argv[1])
        file.with_suffix(".part").write_text(made.scheduler_address)
        file.with_suffix(".part").rename(file)
        time.sleep(100)
"""


def test_workers_of_another_version_are_named_and_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    with scheduler(1) as (address, _):
        monkeypatch.setattr(fsar_ledger, "__version__", "9.9.9")
        with pytest.raises(UsageError, match=r"found workers with fsar-ledger 0\..*expected fsar-ledger 9\.9\.9"):
            fsar_ledger.cluster(address).__enter__()


@pytest.mark.parametrize("address", ["local:", "local:0", "local:x", "local:-1", "nowhere", ""])
def test_an_address_of_another_form_is_a_usage_error(address: str) -> None:
    with pytest.raises(UsageError, match="expected the address of a Dask scheduler"):
        fsar_ledger.cluster(address).__enter__()


def test_workers_fork_every_run_as_one_process_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ledger = simulated(tmp_path / "ledger")
    alone = ledger.whatif("drop window:*")
    assert alone.diverging > 0
    monkeypatch.setattr(whatif, "EVENTS_AT_ONCE", 5_000)
    with fsar_ledger.cluster("local:2"):
        assert ledger.whatif("drop window:*") == alone


def test_a_worker_that_finds_another_ledger_forks_nothing(tmp_path: Path) -> None:
    view, other = (open_for_answers(simulated(tmp_path / name, fleet_size=size).path) for name, size in SIZES.items())
    runs = whatif.runs_of(view, ())[:1]
    assert whatif._forked(str(view.path), view.head.root, runs, ())[0][0].base == runs[0]
    with pytest.raises(SequenceConflict, match="expected the same"):
        whatif._forked(str(other.path), view.head.root, runs, ())


SIZES = {"ledger": 4, "other": 8}


def test_a_worker_that_finds_another_ledger_under_the_path_gives_no_rows(tmp_path: Path) -> None:
    ledger, other = simulated(tmp_path / "ledger"), simulated(tmp_path / "other", fleet_size=8)
    _, first, *_ = database.Slices(open_for_answers(ledger.path))._slices
    asked = {"runs": slices.slice_query("SELECT run_id FROM runs")}
    assert database.slice_answers(str(ledger.path), first.runs, first.digest or "", asked)["runs"].num_rows == len(
        first.runs
    )
    with pytest.raises(SequenceConflict, match="found other events"):
        database.slice_answers(str(other.path), first.runs, first.digest or "", asked)
