"""A small ledger, asked from Python."""

import shutil
from pathlib import Path

import pytest

import fsar_ledger

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
