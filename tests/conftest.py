"""The set-up of the whole test session."""

import gc
import os
import shutil
import tempfile
from pathlib import Path

CACHE = Path(tempfile.mkdtemp(prefix="fsar-ledger-tests-"))
"""The cache of commands under test, apart from the user's own and from that of earlier sessions."""


def pytest_configure() -> None:
    """Use the session's cache, but keep matplotlib's list of fonts, which takes seconds to make."""
    usual = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    os.environ.setdefault("MPLCONFIGDIR", f"{usual}/matplotlib")
    os.environ["XDG_CACHE_HOME"] = str(CACHE)


def pytest_collection_finish() -> None:
    """Exempt libraries and tests from garbage collection: searching them takes a twelfth of the time."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 100)


def pytest_unconfigure() -> None:
    """Collect everything at the end, so that libraries can complain about what is left."""
    gc.unfreeze()
    gc.collect()
    shutil.rmtree(CACHE, ignore_errors=True)
