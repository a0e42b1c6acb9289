"""A reader gets a segment only if it is the very file that was committed; each file is read for that once."""

import os
import shutil
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path

import pyarrow as pa
import pytest

from fsar_ledger.base.errors import LedgerCorrupted, WriteFailed
from fsar_ledger.ledger.opening import open_for_answers, open_ledger
from fsar_ledger.ledger.rows.codec import encode
from fsar_ledger.ledger.rows.segment import to_parquet
from fsar_ledger.ledger.store import staging
from fsar_ledger.ledger.store.staging import materialized
from tests.ledger.forgery import segment_at, staged_at
from tests.ledger.samples import ORIGIN, made_up_run

COMMITTED = [[made_up_run(f"run-{number}", 20, seed=number)] for number in range(3)]


def flip(file: Path) -> None:
    """Flip a bit in the middle; nothing else about the file, not even its time, shows it."""
    status, data = file.stat(), bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(data)
    os.utime(file, ns=(status.st_atime_ns, status.st_mtime_ns))


def test_the_first_segment_that_is_not_as_committed_is_named(path: Path) -> None:
    for number in (1, 2):
        flip(segment_at(path, number))
    with pytest.raises(
        LedgerCorrupted,
        match=r"segments/000000000020-000000000040\.parquet: commit 1, field segment_sha256: found SHA-256 "
        r"[0-9a-f]{64}, expected [0-9a-f]{64}, as chain",
    ):
        open_ledger(path).segments()


@pytest.mark.parametrize("read", ["tables", "event", "segment", "runs"])
def test_no_row_is_read_from_a_segment_that_is_not_as_committed(path: Path, read: str) -> None:
    flip(segment_at(path, 0))
    view = open_ledger(path)
    reads: dict[str, Callable[[], object]] = {
        "tables": lambda: list(view.tables()),
        "event": lambda: view.event(3),
        "segment": lambda: view.segment(0, is_laid_out=True),
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


def test_a_segment_in_staging_is_compared_there_and_again_where_it_is_moved_to(path: Path) -> None:
    view, place, staged = open_ledger(path), segment_at(path, 2), staged_at(path, 2)
    place.rename(staged)
    assert view.segment(2) == staged
    staged.rename(place)
    assert view.segment(2) == place
    place.rename(staged)
    flip(staged)
    with pytest.raises(LedgerCorrupted, match=f"staging/{staged.name}: commit 2, field segment_sha256: found SHA-256"):
        view.segment(2)


def test_a_link_to_a_segment_is_no_segment(path: Path, tmp_path: Path) -> None:
    place = segment_at(path, 0)
    place.symlink_to(place.rename(tmp_path / "elsewhere.parquet"))
    with pytest.raises(LedgerCorrupted, match="found a link or not a regular file"):
        open_ledger(path).segment(0)


def test_a_checkpoint_that_is_no_note_of_the_newest_commits_is_refused(path: Path) -> None:
    notes = [str(commit.note(ORIGIN)) for commit in open_ledger(path).commits]
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


@pytest.mark.slow
def test_threads_that_read_a_journal_as_a_segment_for_the_first_time_read_all_of_it() -> None:
    for number in range(20):
        table = encode([made_up_run(f"r{number}", 40, number)])
        start, found = threading.Barrier(8), list[bytes]()

        def read(table: pa.Table = table, start: threading.Barrier = start, found: list[bytes] = found) -> None:
            start.wait()
            found.append(materialized(table).read_bytes())

        threads = [threading.Thread(target=read) for _ in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert found == [to_parquet(table)] * 8


def test_what_lost_its_temporary_folder_is_written_into_a_new_one(tmp_path: Path) -> None:
    (table, other) = (encode([made_up_run(f"lost-{number}", 20, seed=number)]) for number in range(2))
    shutil.rmtree(materialized(table).parent)
    for each in (table, other):
        assert materialized(each).read_bytes() == to_parquet(each)


def test_where_no_temporary_folder_can_be_written_rows_of_a_journal_are_refused_in_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", None)
    monkeypatch.setattr(tempfile, "_candidate_tempdir_list", lambda: [str(tmp_path / "missing")])
    monkeypatch.setattr(staging, "_folders", [])
    with pytest.raises(WriteFailed, match="temporary files cannot be written: No usable temporary directory found"):
        materialized(encode([made_up_run("nowhere", 20, seed=1)]))
