"""A recovery that the disk refuses, or that is killed, leaves the ledger as good as it was: the next writer goes on
from there."""

import shutil
from contextlib import suppress
from pathlib import Path

import pytest

from fsar_ledger.base.errors import FsarLedgerError, WriteFailed
from fsar_ledger.ledger.verify import recover
from tests.ledger.damage import SIGNER, piece, write_cut_short
from tests.ledger.faults import Fault, FaultyOs, Killed, calls_of, in_place_of_os
from tests.ledger.samples import append_all, contents
from tests.quick import few
from tests.running import files_of_at_most

KINDS = ("disk-full", "no-space", "io-error-after", "killed")
MORE = [[piece(3, 0, 6)]]


@pytest.fixture
def crashed(tmp_path: Path) -> Path:
    """Return a folder with a ledger whose writer ended right after its second append to the chain."""
    (tmp_path / "crashed").mkdir()
    write_cut_short(tmp_path / "crashed" / "ledger")
    return tmp_path / "crashed"


@pytest.fixture
def whole(crashed: Path, tmp_path: Path) -> dict[str, bytes]:
    """Return the files of the ledger after the next writer, where nobody recovered it before."""
    shutil.copytree(crashed / "ledger", tmp_path / "whole")
    append_all(tmp_path / "whole", MORE, signer=SIGNER)
    return contents(tmp_path / "whole")


@pytest.mark.parametrize("step", few([1, 4], [], [4]))
def test_after_a_recovery_that_met_any_refusal_at_any_call_the_next_writer_goes_on(
    crashed: Path, whole: dict[str, bytes], tmp_path: Path, step: int
) -> None:
    shutil.copytree(crashed, tmp_path / "counted")
    calls = calls_of(tmp_path / "counted", lambda: recover(tmp_path / "counted" / "ledger"))
    assert len(calls) > 30
    refused = 0
    for at in range(0, len(calls), step):
        root = tmp_path / str(at)
        shutil.copytree(crashed, root)
        kind = KINDS[at // step % len(KINDS)]
        with in_place_of_os(FaultyOs(root, Fault(at, kind))), suppress(Killed):
            try:
                recover(root / "ledger")
            except FsarLedgerError:
                refused += 1
        append_all(root / "ledger", MORE, signer=SIGNER)
        assert contents(root / "ledger") == whole, (at, calls[at], kind)
    assert refused


def test_where_there_is_no_room_to_mend_nothing_is_taken_away(crashed: Path) -> None:
    (crashed / "ledger" / "stray").write_bytes(b"?")
    before = contents(crashed)
    with files_of_at_most(10), pytest.raises(WriteFailed, match="mending failed"):
        recover(crashed / "ledger")
    assert {*before.values()} <= {*contents(crashed).values()}
    assert recover(crashed / "ledger").outcome == "mended"
    assert (crashed / "ledger.set-aside" / "000" / "stray").read_bytes() == b"?"
