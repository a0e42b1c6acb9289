"""What holds for all tests."""

import gc
import os
import shutil
import tempfile
from pathlib import Path

CACHE = Path(tempfile.mkdtemp(prefix="fsar-ledger-tests-"))
"""Where commands under test remember what they found right: not among what the user's own commands found, nor with what an earlier test session did."""


def pytest_configure() -> None:
    """The cache is that of this session; but where matplotlib keeps its list of fonts, which takes seconds to make, stays as it is."""
    usual = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    os.environ.setdefault("MPLCONFIGDIR", f"{usual}/matplotlib")
    os.environ["XDG_CACHE_HOME"] = str(CACHE)


def pytest_collection_finish() -> None:
    """The libraries and the tests live to the end: looking for garbage among them again and again takes a twelfth of all time."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 100)


def pytest_unconfigure() -> None:
    """At the end all is garbage again: libraries complain of what is left."""
    gc.unfreeze()
    gc.collect()
    shutil.rmtree(CACHE, ignore_errors=True)
