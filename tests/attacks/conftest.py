"""Commands in their own processes, with a cache of their own."""

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.cli.conftest import Called, in_a_process

Attack = Callable[..., Called]


@pytest.fixture
def command(tmp_path: Path) -> Attack:
    """Run a command in its own process with its own cache."""
    surroundings = {"XDG_CACHE_HOME": str(tmp_path / "cache")}
    return lambda *arguments: in_a_process(*arguments, cwd=tmp_path, surroundings=surroundings)
