"""The command line of the checkout under attack: this one, or an older one that `on_release.py` names."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.cli.conftest import Called

ATTACKED = "FSAR_LEDGER_ATTACKED"
"""The folder of the checkout whose commands are attacked."""

Attack = Callable[..., Called]
ROOT = Path(__file__).resolve().parents[2]


def attacked() -> Path:
    """Return the checkout under attack."""
    return Path(os.environ.get(ATTACKED, ROOT))


@pytest.fixture
def command(tmp_path: Path) -> Attack:
    """Run a command of the checkout under attack in its own process with its own cache.

    A command that takes longer than `seconds` is ended, with exit code -9.
    """

    def run(*arguments: object, seconds: float = 120, **surroundings: str) -> Called:
        environment = {
            **os.environ,
            "PYTHONPATH": str(attacked()),
            "XDG_CACHE_HOME": str(tmp_path / "cache"),
            **surroundings,
        }
        call = [sys.executable, "-m", "fsar_ledger", *map(str, arguments)]
        try:
            done = subprocess.run(
                call,
                cwd=tmp_path,
                env=environment,
                capture_output=True,
                text=True,
                errors="surrogateescape",
                timeout=seconds,
                check=False,
            )
        except subprocess.TimeoutExpired:
            return Called(-9, "", "")
        return Called(done.returncode, done.stdout, done.stderr)

    return run
