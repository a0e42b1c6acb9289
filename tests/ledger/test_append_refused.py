"""What a writer refuses to append to, and what it names as missing."""

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from fsar_ledger.base.errors import FormatVersionMismatch, LedgerCorrupted, NotALedger, UsageError, WriteFailed
from fsar_ledger.ledger.log.note import Signer
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows import canonical
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.manifest import Manifest
from fsar_ledger.ledger.store.record import EMPTY_HEAD
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.ledger.verify import recover, verify
from tests.ledger.forgery import segment_at
from tests.ledger.samples import ORIGIN, append_all, contents, made_up_run
from tests.ledger.test_append import BATCHES


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "out" / "ledger"


def test_a_staged_file_that_is_gone_or_changed_is_not_committed(path: Path) -> None:
    damages: tuple[Callable[[Path], object], ...] = (
        lambda file: file.unlink(),
        lambda file: file.write_bytes(b"other"),
    )
    for damage in damages:
        with Writer(path, ORIGIN) as writer:
            staged = stage(path, BATCHES[0])
            damage(path / "staging" / f"{staged.segment_sha256}.parquet")
            with pytest.raises(WriteFailed):
                writer.append(staged)
    assert open_ledger(path).head == EMPTY_HEAD


def test_into_a_ledger_that_was_removed_nothing_is_committed(path: Path) -> None:
    writer = Writer(path, ORIGIN)
    writer.add([made_up_run("first", 20, seed=1)])
    shutil.rmtree(path)
    with pytest.raises(WriteFailed, match="the ledger was removed while it was open; restore it, and open it again"):
        writer.add([made_up_run("second", 20, seed=2)])
    with pytest.raises(WriteFailed, match="the ledger was removed while it was open; restore it, and open it again"):
        writer.close()


def test_staging_nothing_is_a_mistake(path: Path) -> None:
    with pytest.raises(ValueError, match="at least 1"):
        stage(path, [])


def test_staging_into_no_ledger_fails_clearly(tmp_path: Path) -> None:
    with pytest.raises(WriteFailed, match="No such file or directory"):
        stage(tmp_path / "nowhere", BATCHES[0])


@pytest.mark.parametrize("origin", ["", "two words", "a+b", "line\nfeed", "x" * 300_000])
def test_an_origin_that_no_note_can_carry_is_refused(path: Path, origin: str) -> None:
    with pytest.raises(ValueError, match=r"found (an )?origin"):
        Writer(path, origin)
    assert not path.exists()


def test_a_key_of_another_origin_makes_no_ledger(path: Path) -> None:
    with pytest.raises(UsageError, match=f"found a key named example.org/other, expected {ORIGIN}"):
        Writer(path, ORIGIN, Signer("example.org/other", bytes(32)))
    assert not path.exists()


def test_what_is_not_a_ledger_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "photo.jpg").write_text("mine")
    (tmp_path / "json").mkdir()
    (tmp_path / "json" / "ledger.json").write_text('{"accounts":[]}')
    (tmp_path / "almost" / "segments").mkdir(parents=True)
    (tmp_path / "almost" / "segments" / "x.parquet").write_text("{}")
    before = contents(tmp_path)
    for name in ("file", "full", "json", "almost"):
        with pytest.raises(NotALedger, match="expected"):
            Writer(tmp_path / name, ORIGIN)
    assert contents(tmp_path) == before


def test_an_empty_folder_or_a_half_made_ledger_becomes_one(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "half" / "segments").mkdir(parents=True)
    (tmp_path / "half" / "staging").mkdir()
    (tmp_path / "half" / "staging" / "ledger.json.17.tmp").write_text("{")
    for name in ("empty", "half"):
        append_all(tmp_path / name, BATCHES[:1])
        assert verify(tmp_path / name).ok
    assert contents(tmp_path / "empty") == contents(tmp_path / "half")


def test_what_an_interrupted_creation_left_is_no_damage(tmp_path: Path) -> None:
    (tmp_path / "half" / "segments").mkdir(parents=True)
    for look in (verify, open_ledger):
        with pytest.raises(NotALedger, match="creation was interrupted before anything was in it"):
            look(tmp_path / "half")


@pytest.mark.parametrize("place", ["another", "segments/another", "tile/0/another"])
def test_no_ledger_is_created_inside_another(path: Path, place: str) -> None:
    append_all(path, BATCHES[:1])
    before = contents(path)
    with pytest.raises(UsageError, match="found a place inside the ledger"):
        Writer(path / place, ORIGIN)
    assert contents(path) == before


def test_a_ledger_of_another_origin_is_not_appended_to(path: Path) -> None:
    append_all(path, BATCHES[:1])
    with pytest.raises(NotALedger, match=r"found a ledger of origin 'example\.org/fsar-test', expected 'other\.org/x'"):
        Writer(path, "other.org/x")


def test_a_ledger_of_another_format_version_is_not_read(path: Path) -> None:
    append_all(path, BATCHES[:1])
    (path / "ledger.json").write_bytes(canonical.document(Manifest("fsar-ledger", ORIGIN, 3)))
    for opens in (lambda: Writer(path, ORIGIN), lambda: open_ledger(path)):
        with pytest.raises(FormatVersionMismatch, match="found format version 3, expected 2"):
            opens()


def test_a_path_without_a_ledger_is_neither_opened_nor_verified(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    for name, found in (("nowhere", "no such path"), ("", r"no ledger\.json"), ("file", "a file")):
        with pytest.raises(NotALedger, match=found):
            open_ledger(tmp_path / name)
        with pytest.raises(NotALedger):
            verify(tmp_path / name)


def test_a_missing_or_shortened_segment_is_named(path: Path) -> None:
    append_all(path, BATCHES)
    file = segment_at(path, 1)
    data = file.read_bytes()
    file.write_bytes(data[:-1])
    with pytest.raises(
        LedgerCorrupted, match=r"000000000048\.parquet: commit 1, field segment_bytes: found \d+ bytes, expected"
    ):
        open_ledger(path).segments()
    file.unlink()
    for opens in (lambda: list(open_ledger(path).runs()), lambda: Writer(path, ORIGIN)):
        with pytest.raises(
            LedgerCorrupted, match=r"000000000048\.parquet: commit 1, field segment_sha256: found no segment"
        ):
            opens()


def test_a_record_that_contradicts_the_chain_is_named(path: Path) -> None:
    append_all(path, BATCHES)
    data = (path / "chain.jsonl").read_bytes()
    (path / "chain.jsonl").write_bytes(data.replace(b'"release":"0', b'"release":"1', 1))
    with pytest.raises(
        FormatVersionMismatch, match=r"chain\.jsonl: commit 0, field release.*read it with fsar-ledger 1"
    ):
        open_ledger(path)
    lines = data.splitlines(keepends=True)
    (path / "chain.jsonl").write_bytes(b"".join([*lines[2:4], *lines[:2], *lines[4:]]))
    with pytest.raises(LedgerCorrupted, match=r"chain\.jsonl: commit 0, field previous_sha256"):
        open_ledger(path)


def test_readers_do_not_write(path: Path) -> None:
    append_all(path, BATCHES[:1])
    before = {str(file): (file.stat().st_mtime_ns, file.stat().st_ino) for file in path.rglob("*")}
    list(open_ledger(path).runs())
    verify(path)
    assert {str(file): (file.stat().st_mtime_ns, file.stat().st_ino) for file in path.rglob("*")} == before


def test_a_lock_does_not_outlive_its_writer(path: Path) -> None:
    open_handles = len(os.listdir("/proc/self/fd"))
    for _ in range(3):
        append_all(path, BATCHES[:1])
    with pytest.raises(NotALedger):
        Writer(path, "other.org/x")
    assert len(os.listdir("/proc/self/fd")) == open_handles


def test_one_run_a_commit_and_one_event_a_run_are_enough(path: Path) -> None:
    head = append_all(path, [[made_up_run("tiny", 1, seed=3)]])
    assert (head.commits, head.size) == (1, 1)
    assert verify(path).ok


@pytest.mark.parametrize("name", ["nodes", "index.jsonl"])
@pytest.mark.parametrize("put", [os.mkfifo, os.mkdir, lambda file: os.symlink("elsewhere", file)])
def test_a_derived_file_that_is_no_file_is_refused_at_once(path: Path, name: str, put: Callable[[Path], None]) -> None:
    """A pipe that is opened for writing waits until somebody reads it."""
    append_all(path, BATCHES[:1])
    (path / name).unlink()
    put(path / name)
    with pytest.raises(WriteFailed, match=f"{name} is a link or not a regular file; .* recover sets it aside"):
        append_all(path, BATCHES[1:2])
    assert recover(path).outcome == "mended"
    assert verify(path).ok
