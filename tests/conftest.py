"""The set-up of the whole test session."""

import gc
import os
import shutil
import signal
import tempfile
from collections.abc import Generator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

# A machine that is shared is slow at times: how long an example takes says nothing about the code.
settings.register_profile("unhurried", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("unhurried")

ROOT = Path(__file__).resolve().parents[1]

CACHE = Path(tempfile.mkdtemp(prefix="fsar-ledger-tests-"))
"""The cache of commands under test, apart from the user's own and from that of earlier sessions."""


LONGEST = ("test_contributing.py", "test_printed_output.py")
"""Files with a test of a minute, which begin a session: at its end one process would wait for the other."""

SKIPPED = "fsar-ledger/skipped"
"""Where pytest's cache has the tests and modules that the last session without options skipped."""
_skipped: set[str] = set()


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add --no-skips, for where everything is set up, and --left-out, for what `make test` left out before."""
    parser.addoption("--no-skips", action="store_true", help="a skipped test is a failure, except an expected one")
    parser.addoption("--left-out", action="store_true", help="run slow tests, and those skipped by the session before")


def pytest_collectreport(report: pytest.CollectReport) -> None:
    """Note a module that is skipped."""
    if report.skipped:
        _skipped.add(report.nodeid)


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Note a test that is skipped."""
    if report.skipped and not hasattr(report, "wasxfail"):
        _skipped.add(report.nodeid)


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Keep what was skipped, for --left-out."""
    cache = getattr(session.config, "cache", None)  # it can be switched off
    if cache is not None and not hasattr(session.config, "workerinput") and not session.config.getoption("--left-out"):
        cache.set(SKIPPED, sorted(_skipped))


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Begin with the longest tests. With --left-out, drop what the session before ran; nothing where there was none."""
    items.sort(key=lambda item: item.path.name not in LONGEST)
    cache = getattr(config, "cache", None)
    known = cache.get(SKIPPED, None) if cache is not None and config.getoption("--left-out") else None
    if known is not None:
        left = set(known)
        items[:] = [
            item
            for item in items
            if item.get_closest_marker("slow") or not left.isdisjoint((item.nodeid, item.nodeid.partition("::")[0]))
        ]


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
    """Use the session's cache, but keep matplotlib's list of fonts, which takes seconds to make.

    A shell starts a job in the background with Ctrl-C ignored, and commands under test would inherit that.
    """
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
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


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """Copy what import-linter and the build read."""
    ignored = shutil.ignore_patterns("__pycache__")
    for folder in ("fsar_ledger", "queries", "reports"):
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=ignored)
    (tmp_path / "tests").mkdir()
    for file in ("pyproject.toml", "README.md", "LICENSE", "tests/import_contract.py"):
        shutil.copy(ROOT / file, tmp_path / file)
    return tmp_path
