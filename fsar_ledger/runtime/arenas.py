"""Large pages of memory for who simulates large fleets, where `_arenas.c` was built."""

from collections.abc import Callable

LARGE_FLEET = 256
"""Robots from which the objects of a run fill more memory than the caches of a processor find quickly."""


def _compiled() -> Callable[[], None] | None:
    try:
        from fsar_ledger.runtime import _arenas
    except ImportError:  # it was not built, as without a compiler
        return None
    return _arenas.install


def prepare_for(robots: int) -> None:
    """Let this process have large pages for what it makes from now on, if so many robots need them."""
    if robots >= LARGE_FLEET and (install := _compiled()) is not None:
        install()
