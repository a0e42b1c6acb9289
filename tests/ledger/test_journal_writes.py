"""How a writer of small commits writes them: few bytes begin to be synced early, and nothing counts until they are."""

import os
from pathlib import Path

import pytest

from fsar_ledger.errors import WriteFailed
from fsar_ledger.ledger.opening import open_for_answers
from fsar_ledger.ledger.rows.pieces import piece
from fsar_ledger.ledger.store import growing, journal
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.paths import JOURNAL
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.ledger.verify.verify import verify
from tests.ledger.samples import ORIGIN, made_up_run

RUN = made_up_run("run-0", 200, 1)


@pytest.fixture
def begun(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return of how many bytes a sync began early, as writers go on."""
    sizes: list[int] = []
    begin = growing.begin_to_sync

    def noted(handle: int, place: int, size: int) -> None:
        sizes.append(size)
        begin(handle, place, size)

    monkeypatch.setattr(growing, "begin_to_sync", noted)
    return sizes


def test_the_sync_of_few_bytes_begins_early_and_that_of_many_does_not(tmp_path: Path, begun: list[int]) -> None:
    with Writer(tmp_path / "ledger", ORIGIN) as writer:
        writer.add([piece(RUN, 0, 1)])
        assert len(begun) == 1
        writer.add([piece(RUN, 1, 190)])
        assert len(begun) == 1
        writer.add([piece(RUN, 190, 192)])
    assert len(begun) == 2
    assert max(begun) < journal._SMALL < (tmp_path / "ledger" / JOURNAL).stat().st_size
    assert verify(tmp_path / "ledger").ok


def test_a_system_that_cannot_begin_early_writes_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("with", "without"):
        with Writer(tmp_path / name, ORIGIN) as writer:
            writer.add([piece(RUN, 0, 3)])
            writer.add([piece(RUN, 3, 4)])
        monkeypatch.setattr(growing, "_TAKES_ADVICE", False)
    found, expected = ((tmp_path / name / JOURNAL).read_bytes() for name in ("without", "with"))
    assert found == expected


def test_a_file_system_that_refuses_the_advice_makes_no_difference(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[int] = []

    def refused(_: int, __: int, size: int, ___: int) -> None:
        asked.append(size)
        raise OSError(22, "Invalid argument")

    monkeypatch.setattr(os, "posix_fadvise", refused)
    with Writer(tmp_path / "ledger", ORIGIN) as writer:
        assert writer.add([piece(RUN, 0, 3)]).size == 3
    assert len(asked) == 1
    assert verify(tmp_path / "ledger").remarks == ()


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
