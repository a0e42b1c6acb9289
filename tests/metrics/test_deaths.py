"""A process that answers SQL and dies says what of: each cause is made to happen."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from fsar_ledger.base.errors import QueryFailed
from fsar_ledger.metrics.sandbox import Limits
from fsar_ledger.metrics.untrusted import ENVIRONMENT, cause_of_death
from tests.untrusted import children, run_untrusted

NEVER_ENDS = "SELECT sum(x % 7) FROM range(1000000000000) AS t(x)"
IN_TIME = (
    "from fsar_ledger.metrics.sandbox import GRACE_S, Limits, give_up; give_up(Limits(seconds=1 - GRACE_S)); "
    "exec('while True: pass')"
)
NOT_ENOUGH = (
    "from fsar_ledger.metrics.sandbox import Limits, give_up; give_up(Limits(memory_bytes=1 << 29)); 'x' * (1 << 30)"
)


def death_of(code: str) -> str:
    """What is said of a process that runs this."""
    done = subprocess.run(
        [sys.executable, "-c", code], env={**os.environ, **ENVIRONMENT}, capture_output=True, text=True, check=False
    )
    return cause_of_death(done.returncode, done.stderr, Limits())


@pytest.mark.parametrize(
    ("code", "reason"),
    [
        (IN_TIME, "used 65 s of processor time"),
        (NOT_ENOUGH, "ran out of memory, the limit is 4,096 MiB"),
        (
            (
                'import os, sys; sys.stderr.write("terminate called after throwing an instance of '
                "'std::bad_alloc'\"); sys.stderr.flush(); os.abort()"
            ),
            "ran out of",
        ),
        ("import os; os.abort()", "was ended by SIGABRT; its last output: nothing"),
        ("import os; os.kill(os.getpid(), 9)", "was killed from outside (SIGKILL)"),
        ("import os; os.kill(os.getpid(), 11)", "crashed (SIGSEGV): values are nested too deeply"),
        ("import os; os.kill(os.getpid(), 15)", "was ended by SIGTERM"),
        (
            "import nothing_of_this_name",
            "exit code 1, as when it cannot start; its last output: ModuleNotFoundError",
        ),
    ],
)
def test_each_way_to_die_is_told_from_the_others(code: str, reason: str) -> None:
    assert reason in death_of(code)


def test_a_process_that_closes_its_pipe_and_lives_is_told_too() -> None:
    assert "did not end" in cause_of_death(None, "", Limits())


def test_a_process_that_cannot_start_says_so(ledger: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "path", [])
    with pytest.raises(QueryFailed, match="exit code 1, as when it cannot start; its last output: ModuleNotFoundError"):
        run_untrusted(ledger, "SELECT 1")


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="only Linux shows the processes of this one")
def test_a_process_that_somebody_kills_says_so(ledger: Path) -> None:
    before = children()

    def kill() -> None:
        while not (started := children() - before):
            time.sleep(0.01)
        os.kill(int(started.pop()), signal.SIGKILL)

    killing = threading.Thread(target=kill)
    killing.start()
    with pytest.raises(QueryFailed, match=r"was killed from outside \(SIGKILL\)"):
        run_untrusted(ledger, NEVER_ENDS)
    killing.join()
