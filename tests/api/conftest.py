"""A small ledger, asked from Python."""

import shutil
from pathlib import Path

import pytest

import fsar_ledger
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.runtime.experiment import run_experiment
from tests.api.sites import NAMES, WHOLE, append, parts

RUN = "fsar.full.door-relay.n4.s7.r0000"


@pytest.fixture(scope="session")
def ledger(tmp_path_factory: pytest.TempPathFactory) -> fsar_ledger.Ledger:
    """Two runs of one scenario under each architecture; for reading only."""
    path = tmp_path_factory.mktemp("api") / "ledger"
    return fsar_ledger.simulate(path, scenario="door-relay", runs=2, seed=7, workers=1).ledger


@pytest.fixture
def copy(ledger: fsar_ledger.Ledger, tmp_path: Path) -> Path:
    """The same ledger, to be changed."""
    return Path(shutil.copytree(ledger.path, tmp_path / "copy"))


@pytest.fixture(scope="session")
def runs(tmp_path_factory: pytest.TempPathFactory) -> list[LedgerRun]:
    """A plan and twelve runs, in the order in which the one ledger has them."""
    path = tmp_path_factory.mktemp("runs") / "ledger"
    run_experiment(path, WHOLE, 1)
    return list(open_ledger(path).runs())


@pytest.fixture(scope="session")
def whole(runs: list[LedgerRun], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return append(tmp_path_factory.mktemp("whole") / "ledger", runs)


@pytest.fixture(scope="session")
def site(runs: list[LedgerRun], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of three ledgers with a third of the runs each, and of the log of their federation."""
    path = tmp_path_factory.mktemp("site")
    for name, part in zip(NAMES, parts(runs), strict=True):
        append(path / name, part)
    fsar_ledger.shards(path / "log", [path / name for name in NAMES])
    return path


@pytest.fixture
def site_copy(site: Path, tmp_path: Path) -> Path:
    """The same folder, to be changed."""
    return Path(shutil.copytree(site, tmp_path / "site"))
