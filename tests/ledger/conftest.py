"""Ledgers for tests that look at many damaged copies of one."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.ledger.crash_trials import write_with
from tests.ledger.crash_writer import Nursery
from tests.ledger.damage import write_ledger
from tests.ledger.faults import FaultyOs, calls_of
from tests.ledger.once import decoded_once
from tests.ledger.samples import append_all


@pytest.fixture(scope="session")
def nursery() -> Iterator[Nursery]:
    """Start the process that forks the processes to be killed."""
    with Nursery() as nursery:
        yield nursery


@pytest.fixture(scope="module")
def snapshots(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a signed ledger: folder `N` holds it after N commits, whose numbers of events are the module's `SIZES`;
    `whole` holds all."""
    folder = tmp_path_factory.mktemp("snapshots")
    write_ledger(folder / "whole", request.module.SIZES, folder)
    return folder


@pytest.fixture(scope="module")
def intact(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a ledger to be read only: of the module's `SIZES`, or of its `COMMITTED` batches, signed by `SIGNED_BY`."""
    own = vars(request.module)
    if "SIZES" in own:
        return Path(request.getfixturevalue("snapshots") / "whole")
    path = tmp_path_factory.mktemp("intact") / "ledger"
    append_all(path, own["COMMITTED"], signer=own.get("SIGNED_BY"))
    return path


@pytest.fixture
def path(intact: Path, tmp_path: Path) -> Iterator[Path]:
    """Copy the ledger, to be damaged. Only damaged segments are decoded again."""
    path = Path(shutil.copytree(intact, tmp_path / "ledger"))
    with decoded_once():
        yield path


@pytest.fixture(scope="session")
def calls(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Return the calls with which a writer changes the disk."""
    root = tmp_path_factory.mktemp("calls")
    return calls_of(root, lambda: write_with(FaultyOs(root), root / "out" / "ledger"))
