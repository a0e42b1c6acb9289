"""Commands as users call them: in a process of their own, or (quicker) in this one."""

import os
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import pytest

from fsar_ledger.cli import app
from tests.ledger.keep_release import LEDGERS
from tests.running import ran


class Called(NamedTuple):
    """What a command answered."""

    code: int
    out: str
    err: str

    def good(self) -> "Called":
        """The same, which ended without a failure."""
        assert self.code == 0, self.err
        return self


Call = Callable[..., Called]

SMALL = (
    *("--scenario", "door-relay", "--scenario", "failure-recovery-chain"),
    *("--runs", "2", "--seed", "7", "--workers", "1"),
)


def in_a_process(*arguments: object, cwd: Path | None = None, surroundings: Mapping[str, str] = {}) -> Called:
    command = [sys.executable, "-m", "fsar_ledger", *map(str, arguments)]
    done = ran(command, cwd=cwd, env={**os.environ, **surroundings})
    return Called(done.returncode, done.stdout, done.stderr)


@pytest.fixture
def call(capsys: pytest.CaptureFixture[str]) -> Call:
    """Runs a command in this process."""

    def run(*arguments: object) -> Called:
        capsys.readouterr()
        code = app.run([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        return Called(code, captured.out, captured.err)

    return run


@pytest.fixture
def empty_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Start with an empty cache."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def made_in(folder: Path, *options: str) -> Path:
    """Make a small ledger: two scenarios, two runs, three architectures. Its rows are known to be those of its root."""
    path = folder / "out" / "ledger"
    for command in (("simulate", path, *SMALL, *options), ("verify", path)):
        assert app.run([*map(str, command)]) == 0
    return path


@pytest.fixture(scope="session")
def ledger(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small ledger that tests may read but not change."""
    return made_in(tmp_path_factory.mktemp("cli"))


@pytest.fixture(scope="session")
def older() -> Path:
    """A ledger of format 1, which a release kept."""
    return LEDGERS / "0.8.1" / "ledger"


def one_message(called: Called, code: int, *parts: str) -> None:
    """The command ended with this exit code and one message on stderr that holds these parts, and no traceback."""
    assert (called.code, "Traceback" in called.err) == (code, False), called.err
    assert called.err.startswith("fsar-ledger: ")
    assert len(called.err.splitlines()) == 1, called.err
    for part in parts:
        assert part in called.err
