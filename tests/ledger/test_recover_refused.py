"""A recovery that the disk refuses, or that is killed, leaves the ledger as good as it was: the next writer goes on
from there."""

import shutil
from contextlib import suppress
from pathlib import Path

import pytest

from fsar_ledger.errors import FsarLedgerError, WriteFailed
from fsar_ledger.ledger.verify.recover import recover
from tests.ledger.crash_trials import BATCHES, encoded_once
from tests.ledger.faults import Fault, FaultyOs, Killed, calls_of, in_place_of_os
from tests.ledger.samples import append_all, contents
from tests.ledger.test_crash import files_of_at_most

KINDS = ("disk-full", "no-space", "io-error-after", "killed")


@pytest.fixture
def crashed(tmp_path: Path) -> Path:
    """Return a folder with a ledger whose second commit filled a tile; the power failed before anything was derived
    from it."""
    first, place = tmp_path / "first", tmp_path / "crashed"
    append_all(first, BATCHES[:1])
    append_all(place / "ledger", BATCHES[:2])
    shutil.rmtree(place / "ledger" / "tile")
    for name in ("tile", "checkpoint"):
        (shutil.copytree if name == "tile" else shutil.copy)(first / name, place / "ledger" / name)
    return place


@pytest.fixture
def whole(tmp_path: Path) -> dict[str, bytes]:
    """Return the files of the ledger that nothing interrupted."""
    append_all(tmp_path / "whole", BATCHES)
    return contents(tmp_path / "whole")


@pytest.mark.parametrize("step", [pytest.param(1, marks=pytest.mark.slow), 13])
def test_after_a_recovery_that_met_any_refusal_at_any_call_the_next_writer_goes_on(
    crashed: Path, whole: dict[str, bytes], tmp_path: Path, step: int
) -> None:
    shutil.copytree(crashed, tmp_path / "counted")
    calls = calls_of(tmp_path / "counted", lambda: recover(tmp_path / "counted" / "ledger"))
    assert len(calls) > 30
    refused = 0
    with encoded_once():
        for at in range(0, len(calls), step):
            root = tmp_path / str(at)
            shutil.copytree(crashed, root)
            with in_place_of_os(FaultyOs(root, Fault(at, KINDS[at // step % len(KINDS)]))), suppress(Killed):
                try:
                    recover(root / "ledger")
                except FsarLedgerError:
                    refused += 1
            append_all(root / "ledger", BATCHES[2:])
            assert contents(root / "ledger") == whole, (at, calls[at], KINDS[at // step % len(KINDS)])
    assert refused > len(calls) / step / 4


def test_where_there_is_no_room_to_mend_nothing_is_taken_away(crashed: Path) -> None:
    (crashed / "ledger" / "ledger.json").write_bytes(b"{}")
    before = contents(crashed)
    with files_of_at_most(10), pytest.raises(WriteFailed, match="mending failed"):
        recover(crashed / "ledger")
    assert contents(crashed) == before
    recovered = recover(crashed / "ledger")
    assert recovered.outcome == "mended"
    assert (crashed / "ledger.set-aside" / "000" / "ledger.json").read_bytes() == b"{}"
