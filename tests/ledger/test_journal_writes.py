"""How a writer of small commits writes them: into room, and nothing counts until it is synced."""

import os
from pathlib import Path

import pytest

from fsar_ledger.base.errors import WriteFailed
from fsar_ledger.ledger.opening import open_for_answers
from fsar_ledger.ledger.rows.runs import piece
from fsar_ledger.ledger.store import growing, journal
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.paths import JOURNAL
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.ledger.verify import verify
from tests.ledger.samples import ORIGIN, made_up_run

RUN = made_up_run("run-0", 200, 1)


def test_a_commit_that_could_not_be_synced_does_not_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "ledger"
    with Writer(path, ORIGIN) as writer:
        before = writer.add([piece(RUN, 0, 3)])

        def refused(_: int) -> None:
            raise OSError(5, "Input/output error")

        with monkeypatch.context() as patch:
            patch.setattr(os, "fdatasync", refused)
            with pytest.raises(WriteFailed, match="writing to the journal failed: Input/output error"):
                writer.add([piece(RUN, 3, 5)])
        assert writer.head == before
        with pytest.raises(WriteFailed, match="this writer is broken"):
            writer.add([piece(RUN, 3, 5)])
    assert open_for_answers(path).head == before
    with Writer(path, ORIGIN) as writer:
        assert writer.add([piece(RUN, 3, 5)]).size == 5
    assert verify(path).remarks == ()


def test_room_is_made_in_pieces(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sizes: list[int] = []
    pwrite = os.pwrite

    def noted(handle: int, data: bytes, place: int) -> int:
        sizes.append(len(data))
        return pwrite(handle, data, place)

    monkeypatch.setattr(os, "pwrite", noted)
    with Writer(tmp_path / "ledger", ORIGIN) as writer:
        writer.add([piece(RUN, 0, 3)])
        assert (tmp_path / "ledger" / JOURNAL).stat().st_size == journal.ALLOTTED
        written = len((tmp_path / "ledger" / JOURNAL).read_bytes().rstrip(b"\0"))
    assert max(sizes) == growing._ZEROS_AT_ONCE
    assert sum(sizes) == journal.ALLOTTED + written


def test_a_writer_sees_what_another_appends_whether_or_not_the_chain_was_there(tmp_path: Path) -> None:
    path = tmp_path / "ledger"
    with Writer(path, ORIGIN) as one, Writer(path, ORIGIN) as other:
        one.add([piece(RUN, 0, 3)])
        assert other.append(stage(path, [piece(RUN, 3, 9)])).size == 9  # now there is a chain
        assert one.add([piece(RUN, 9, 10)]).size == 10
        assert other.append(stage(path, [piece(RUN, 10, 20)])).size == 20
        assert one.add([piece(RUN, 20, 21)]).size == 21
        assert other.add([piece(RUN, 21, 22)]).size == 22
        assert one.add([piece(RUN, 22, 23)]).size == 23
    assert verify(path).remarks == ()
