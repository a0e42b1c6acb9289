"""What holds for all tests."""

import gc
import os
import shutil
import tempfile
from collections.abc import Generator
from pathlib import Path

import pytest

CACHE = Path(tempfile.mkdtemp(prefix="fsar-ledger-tests-"))
"""Where commands under test remember what they found right: not among what the user's own commands found, nor with what an earlier test session did."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add --no-skips, for where everything is set up."""
    parser.addoption("--no-skips", action="store_true", help="a skipped test is a failure, except an expected one")


def without_skip(report: pytest.TestReport | pytest.CollectReport) -> None:
    """Turn a skip into a failure that says why the test did not run."""
    if report.skipped and not hasattr(report, "wasxfail"):
        reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
        report.outcome = "failed"
        report.longrepr = f"{report.nodeid}: {reason}; with --no-skips every test has to run"


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Fail where a test is skipped, with --no-skips."""
    report = yield
    if item.config.getoption("--no-skips"):
        without_skip(report)
    return report


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(
    collector: pytest.Collector,
) -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    """Fail where a whole module is skipped, with --no-skips."""
    report = yield
    if collector.config.getoption("--no-skips"):
        without_skip(report)
    return report


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
