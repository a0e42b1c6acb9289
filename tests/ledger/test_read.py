"""A reader gets a segment only if it is the very file that was committed; each file is read for that once."""

import os
from collections.abc import Callable
from pathlib import Path

import pyarrow as pa
import pytest

from fsar_ledger.errors import LedgerCorrupted
from fsar_ledger.ledger.opening import open_for_answers
from fsar_ledger.ledger.store.append import Writer, stage
from fsar_ledger.ledger.store.paths import segment_path, staged_path
from fsar_ledger.ledger.store.read import open_ledger
from tests.ledger.samples import ORIGIN, made_up_run


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Write a ledger of three commits."""
    ledger = tmp_path / "ledger"
    for number in range(3):
        with Writer(ledger, ORIGIN) as writer:
            writer.append(stage(ledger, [made_up_run(f"run-{number}", 20, seed=number)]))
    return ledger


def flip(file: Path) -> None:
    """Flip a bit in the middle; nothing else about the file, not even its time, shows it."""
    status, data = file.stat(), bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(data)
    os.utime(file, ns=(status.st_atime_ns, status.st_mtime_ns))


def test_the_first_segment_that_is_not_as_committed_is_named(path: Path) -> None:
    for number in (1, 2):
        flip(segment_path(path, number))
    with pytest.raises(
        LedgerCorrupted,
        match=r"segments/000000000001\.parquet: commit 1, field segment_sha256: found SHA-256 [0-9a-f]{64}, expected "
        r"[0-9a-f]{64}, as commits/",
    ):
        open_ledger(path).segments()


def test_many_bytes_are_hashed_in_threads_with_the_same_result(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    alone = open_ledger(path).segments()
    monkeypatch.setattr("fsar_ledger.ledger.store.read._WORTH_THREADS_BYTES", 0)
    assert open_ledger(path).segments() == alone
    for number in (1, 2):
        flip(segment_path(path, number))
    with pytest.raises(LedgerCorrupted, match=r"000000000001\.parquet"):
        open_ledger(path).segments()


@pytest.mark.parametrize("read", ["tables", "row", "leaves", "runs"])
def test_no_row_is_read_from_a_segment_that_is_not_as_committed(path: Path, read: str) -> None:
    flip(segment_path(path, 0))
    view = open_ledger(path)
    reads: dict[str, Callable[[], object]] = {
        "tables": lambda: list(view.tables()),
        "row": lambda: view.row(0, 3),
        "leaves": lambda: view.leaves(0),
        "runs": lambda: list(view.runs()),
    }
    with pytest.raises(LedgerCorrupted, match="found SHA-256"):
        reads[read]()


def test_memory_that_the_machine_lacks_is_no_damage_to_the_segment(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def lack(*_: object, **__: object) -> None:
        raise pa.ArrowMemoryError("malloc of size 1099511627776 failed")

    monkeypatch.setattr("fsar_ledger.ledger.rows.segment.pq.ParquetFile", lack)
    with pytest.raises(MemoryError, match="malloc of size"):
        list(open_ledger(path).tables())


def test_a_segment_that_changes_after_it_was_found_right_is_read_again(path: Path) -> None:
    view = open_ledger(path)
    view.segments()
    flip(segment_path(path, 1))
    assert view.segment(0) == segment_path(path, 0)
    with pytest.raises(LedgerCorrupted, match="commit 1, field segment_sha256: found SHA-256"):
        view.segment(1)


def test_a_segment_is_read_once_for_a_view(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    view = open_ledger(path)
    first = view.segments()
    monkeypatch.setattr(type(view), "_require_committed", None)  # to call it would raise
    assert view.segments() == first


def test_a_segment_in_staging_is_compared_there_and_again_where_it_is_moved_to(path: Path) -> None:
    view = open_ledger(path)
    staged = staged_path(path, view.records[2].segment_sha256)
    segment_path(path, 2).rename(staged)
    assert view.segment(2) == staged
    staged.rename(segment_path(path, 2))
    assert view.segment(2) == segment_path(path, 2)
    segment_path(path, 2).rename(staged)
    flip(staged)
    with pytest.raises(LedgerCorrupted, match=f"staging/{staged.name}: commit 2, field segment_sha256: found SHA-256"):
        view.segment(2)


def test_who_only_moves_segments_does_not_read_them(path: Path) -> None:
    flip(segment_path(path, 0))
    assert open_ledger(path).location(0) == segment_path(path, 0)
    with Writer(
        path, ORIGIN
    ) as writer:  # an append costs the same however much is there; `verify` and every reader find the bit
        writer.append(stage(path, [made_up_run("run-3", 20, seed=3)]))


def test_a_link_to_a_segment_is_no_segment(path: Path, tmp_path: Path) -> None:
    moved = segment_path(path, 0).rename(tmp_path / "elsewhere.parquet")
    segment_path(path, 0).symlink_to(moved)
    with pytest.raises(LedgerCorrupted, match="found a link or something else than a file"):
        open_ledger(path).segment(0)


def test_a_checkpoint_that_is_no_note_of_the_newest_commits_is_refused(path: Path) -> None:
    notes = [record.note for record in open_ledger(path).records]
    for behind in (2, 1):
        (path / "checkpoint").write_text(notes[behind])
        assert open_for_answers(path).head.commits == 3
    for text, found in ((notes[0], "example.org"), ("", "no note|''")):
        (path / "checkpoint").write_text(text)
        with pytest.raises(LedgerCorrupted, match=f"{path}/checkpoint: .*found .*({found}).* run fsar-ledger verify"):
            open_for_answers(path)
    (path / "checkpoint").unlink()
    with pytest.raises(LedgerCorrupted, match=r"checkpoint: .*found no file"):
        open_for_answers(path)
