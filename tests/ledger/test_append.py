import os
import pickle
import shutil
from collections.abc import Callable
from pathlib import Path

import msgspec
import pyarrow as pa
import pytest

from fsar_ledger.errors import (
    FormatVersionMismatch,
    LedgerCorrupted,
    NotALedger,
    SequenceConflict,
    UnknownEventTag,
    UsageError,
    WriteFailed,
)
from fsar_ledger.ledger.log import merkle
from fsar_ledger.ledger.log.note import Note, checkpoint_of
from fsar_ledger.ledger.rows import canonical, segment
from fsar_ledger.ledger.rows.codec import encode_hashed
from fsar_ledger.ledger.store.append import Writer, stage
from fsar_ledger.ledger.store.read import EMPTY_HEAD, open_ledger
from fsar_ledger.ledger.store.record import Manifest, commit_path, segment_path, sha256_hex
from fsar_ledger.ledger.verify.verify import verify
from tests.ledger.forgery import changed, forge_segment, table_of
from tests.ledger.samples import ORIGIN, append_all, contents, made_up_batches, made_up_run

BATCHES = made_up_batches(4)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "out" / "ledger"


def test_a_new_ledger_is_empty(path: Path) -> None:
    with Writer(path, ORIGIN) as writer:
        assert writer.head == EMPTY_HEAD
    assert open_ledger(path).head == EMPTY_HEAD
    assert EMPTY_HEAD.root == "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"
    assert contents(path) == {"ledger.json": b'{"format":"fsar-ledger","origin":"example.org/fsar-test","version":1}'}
    assert verify(path).ok


def test_what_was_appended_is_read_back_in_order(path: Path) -> None:
    head = append_all(path, BATCHES)
    view = open_ledger(path)
    assert list(view.runs()) == [run for batch in BATCHES for run in batch]
    assert view.head == head
    assert (head.commits, head.size, head.last_run) == (4, 4 * 2 * 12, BATCHES[-1][-1].run_id)
    assert [table.num_rows for table in view.tables(["seq"])] == [24] * 4
    assert [file.name for file in view.segments()] == [f"{number:012d}.parquet" for number in range(4)]


def test_the_root_is_that_of_all_leaves(path: Path) -> None:
    head = append_all(path, BATCHES)
    leaves = b"".join(encode_hashed(batch)[1] for batch in BATCHES)
    assert head.root == merkle.Frontier().extend(leaves).root().hex()


def test_a_record_says_what_was_committed(path: Path) -> None:
    append_all(path, BATCHES)
    record = open_ledger(path).records[2]
    files = contents(path)
    assert (record.number, record.rows, record.first_run, record.last_run) == (2, 24, "run-0004", "run-0005")
    assert record.segment_bytes == len(files["segments/000000000002.parquet"])
    assert files["commits/000000000002.json"] == canonical.document(record)
    origin, size, root, empty, rest = record.note.split("\n")
    assert (origin, size, empty, rest) == (ORIGIN, "72", "", "")
    assert record.note == str(Note(checkpoint_of(ORIGIN, record.tree())))
    assert len(root) == 44


def test_a_ledger_written_in_parts_is_the_same_bytes(path: Path, tmp_path: Path) -> None:
    append_all(path, BATCHES)
    for batch in BATCHES:
        append_all(tmp_path / "parts", [batch])
    assert contents(path) == contents(tmp_path / "parts")


def test_staging_in_another_order_gives_the_same_bytes(path: Path, tmp_path: Path) -> None:
    append_all(path, BATCHES)
    other = tmp_path / "other"
    with Writer(other, ORIGIN) as writer:
        staged = [pickle.loads(pickle.dumps(stage(other, batch))) for batch in reversed(BATCHES)]
        assert open_ledger(other).head == EMPTY_HEAD
        for one in reversed(staged):
            writer.append(one)
    assert contents(path) == contents(other)


def test_appending_the_newest_batch_again_changes_nothing(path: Path) -> None:
    head = append_all(path, BATCHES[:2])
    before = contents(path)
    assert append_all(path, BATCHES[1:2]) == head
    assert contents(path) == before


def test_of_two_writers_one_wins_the_number_and_the_other_is_told(path: Path) -> None:
    with Writer(path, ORIGIN) as one, Writer(path, ORIGIN) as two:
        staged = stage(path, BATCHES[1])
        one.append(stage(path, BATCHES[0]))
        with pytest.raises(
            SequenceConflict,
            match=r"000000000000\.json: found a commit of another writer, expected number 0 to be free",
        ):
            two.append(staged)
        with pytest.raises(WriteFailed, match="broken"):
            two.append(staged)
        assert open_ledger(path).head.commits == 1
    append_all(path, BATCHES[1:2])
    assert list(open_ledger(path).runs()) == [run for batch in BATCHES[:2] for run in batch]
    assert verify(path).ok


def test_two_writers_with_the_same_batch_commit_it_once(path: Path) -> None:
    with Writer(path, ORIGIN) as one, Writer(path, ORIGIN) as two:
        staged = stage(path, BATCHES[0])
        assert one.append(staged) == two.append(staged)
        assert one.append(stage(path, BATCHES[1])).commits == 2
    assert verify(path).ok


@pytest.mark.parametrize("behind", [0, 1])
def test_a_writer_that_lags_behind_with_the_same_batches_takes_nothing_back(path: Path, behind: int) -> None:
    with Writer(path, ORIGIN) as one, Writer(path, ORIGIN) as two:
        for batch in BATCHES:
            one.append(stage(path, batch))
            if behind:
                two.append(stage(path, batch))
                behind -= 1
        before = contents(path)
        lagging = stage(path, BATCHES[two.head.commits])
        with pytest.raises(
            SequenceConflict,
            match=rf"found commits up to 3 of another writer, expected {two.head.commits} to be the newest",
        ):
            two.append(lagging)
        with pytest.raises(WriteFailed, match="broken"):
            two.append(lagging)
    Writer(path, ORIGIN).close()
    assert contents(path) == before
    assert verify(path).ok


def test_a_second_writer_leaves_the_staging_of_the_first_alone(path: Path) -> None:
    with Writer(path, ORIGIN) as one:
        staged = stage(path, BATCHES[0])
        Writer(path, ORIGIN).close()
        assert one.append(staged).commits == 1


def test_a_lone_writer_removes_leftovers_from_staging(path: Path) -> None:
    append_all(path, BATCHES[:1])
    before = contents(path)
    stage(path, BATCHES[1])
    (path / "staging" / "something.tmp").write_bytes(b"half")
    assert verify(path).ok
    Writer(path, ORIGIN).close()
    assert contents(path) == before


def test_a_committed_segment_still_in_staging_is_read_there_and_moved_by_the_next_writer(path: Path) -> None:
    append_all(path, BATCHES[:2])
    before = contents(path)
    record = open_ledger(path).records[1]
    (path / "segments" / "000000000001.parquet").rename(path / "staging" / f"{record.segment_sha256}.parquet")
    view = open_ledger(path)
    assert view.segment(1).parent.name == "staging"
    assert list(view.runs()) == [run for batch in BATCHES[:2] for run in batch]
    assert verify(path).ok
    Writer(path, ORIGIN).close()
    assert contents(path) == before


def _one_commit_behind(path: Path) -> None:
    """What a crash leaves between the third commit and what is derived from it."""
    append_all(path, BATCHES[:2])
    derived = {name: data for name, data in contents(path).items() if name == "checkpoint" or name.startswith("tile/")}
    append_all(path, BATCHES[2:3])
    shutil.rmtree(path / "tile")
    for name, data in derived.items():
        (path / name).parent.mkdir(parents=True, exist_ok=True)
        (path / name).write_bytes(data)


def test_a_writer_one_commit_behind_goes_on_to_the_same_bytes(path: Path, tmp_path: Path) -> None:
    _one_commit_behind(path)
    Writer(path, ORIGIN).close()
    append_all(tmp_path / "whole", BATCHES[:3])
    assert contents(path).items() >= contents(tmp_path / "whole").items()
    assert verify(path).ok


def test_a_writer_derives_nothing_from_a_segment_that_was_altered_since_its_commit(path: Path) -> None:
    _one_commit_behind(path)
    data = bytearray(segment_path(path, 2).read_bytes())
    data[len(data) // 2] ^= 1
    segment_path(path, 2).write_bytes(data)
    before = contents(path)
    with pytest.raises(
        LedgerCorrupted, match=r"000000000002\.parquet: commit 2: found SHA-256 .* as committed; restore the file"
    ):
        Writer(path, ORIGIN)
    assert contents(path) == before


def test_a_writer_derives_nothing_from_rows_that_do_not_lead_to_the_root_as_committed(path: Path) -> None:
    _one_commit_behind(path)
    forge_segment(path, 2, changed(table_of(path, 2), "time_us", 3, 1))
    before = contents(path)
    with pytest.raises(
        LedgerCorrupted,
        match=r"000000000002\.parquet: commit 2: found rows that lead to root .* run fsar-ledger verify",
    ):
        Writer(path, ORIGIN)
    assert contents(path) == before


def test_a_segment_that_moves_into_place_while_it_is_read_is_found_there(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    append_all(path, BATCHES[:1])
    placed = path / "segments" / "000000000000.parquet"
    staged = path / "staging" / f"{open_ledger(path).records[0].segment_sha256}.parquet"
    placed.rename(staged)
    read_table = segment.read_table

    def moved_first(file: Path, columns: list[str] | None = None) -> pa.Table:
        if staged.exists():
            staged.rename(placed)
        return read_table(file, columns)

    monkeypatch.setattr(segment, "read_table", moved_first)
    assert list(open_ledger(path).runs()) == BATCHES[0]


def test_a_closed_writer_appends_nothing(path: Path) -> None:
    with Writer(path, ORIGIN) as writer:
        staged = stage(path, BATCHES[0])
    with pytest.raises(WriteFailed, match="closed"):
        writer.append(staged)


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


def test_staging_nothing_is_a_mistake(path: Path) -> None:
    with pytest.raises(ValueError, match="at least 1"):
        stage(path, [])


def test_staging_into_no_ledger_fails_clearly(tmp_path: Path) -> None:
    with pytest.raises(WriteFailed, match="No such file or directory"):
        stage(tmp_path / "nowhere", BATCHES[0])


@pytest.mark.parametrize("origin", ["", "two words", "a+b", "line\nfeed"])
def test_an_origin_that_no_note_can_carry_is_refused(path: Path, origin: str) -> None:
    with pytest.raises(ValueError, match="expected a printable name"):
        Writer(path, origin)
    assert not path.exists()


def test_what_is_not_a_ledger_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "photo.jpg").write_text("mine")
    (tmp_path / "json").mkdir()
    (tmp_path / "json" / "ledger.json").write_text('{"accounts":[]}')
    (tmp_path / "almost" / "commits").mkdir(parents=True)
    (tmp_path / "almost" / "commits" / "000000000000.json").write_text("{}")
    before = contents(tmp_path)
    for name in ("file", "full", "json", "almost"):
        with pytest.raises(NotALedger, match="expected"):
            Writer(tmp_path / name, ORIGIN)
    assert contents(tmp_path) == before


def test_an_empty_folder_or_a_half_made_ledger_becomes_one(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "half" / "commits").mkdir(parents=True)
    (tmp_path / "half" / "staging").mkdir()
    (tmp_path / "half" / "staging" / "ledger.json.17.tmp").write_text("{")
    for name in ("empty", "half"):
        append_all(tmp_path / name, BATCHES[:1])
        assert verify(tmp_path / name).ok
    assert contents(tmp_path / "empty") == contents(tmp_path / "half")


def test_what_an_interrupted_creation_left_is_no_damage(tmp_path: Path) -> None:
    (tmp_path / "half" / "commits").mkdir(parents=True)
    for look in (verify, open_ledger):
        with pytest.raises(NotALedger, match="creation was interrupted before anything was in it"):
            look(tmp_path / "half")


@pytest.mark.parametrize("place", ["another", "commits/another", "tile/0/another"])
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
    (path / "ledger.json").write_bytes(canonical.document(Manifest("fsar-ledger", ORIGIN, 2)))
    for opens in (lambda: Writer(path, ORIGIN), lambda: open_ledger(path)):
        with pytest.raises(FormatVersionMismatch, match="found format version 2, expected 1"):
            opens()


def test_a_path_without_a_ledger_is_not_opened(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    for name, found in (("nowhere", "no such path"), ("", r"no ledger\.json"), ("file", "a file")):
        with pytest.raises(NotALedger, match=found):
            open_ledger(tmp_path / name)


def test_a_missing_or_shortened_segment_is_named(path: Path) -> None:
    append_all(path, BATCHES)
    file = path / "segments" / "000000000001.parquet"
    data = file.read_bytes()
    file.write_bytes(data[:-1])
    with pytest.raises(LedgerCorrupted, match=r"000000000001\.parquet: commit 1: found \d+ bytes, expected"):
        open_ledger(path).segments()
    file.unlink()
    for opens in (lambda: list(open_ledger(path).runs()), lambda: Writer(path, ORIGIN)):
        with pytest.raises(LedgerCorrupted, match=r"000000000001\.parquet: commit 1: found no segment"):
            opens()


def test_a_row_that_cannot_be_read_is_named_with_its_file(path: Path) -> None:
    append_all(path, BATCHES[:2])
    file = path / "segments" / "000000000001.parquet"
    table = segment.read_table(file)
    changed = table.set_column(4, table.schema.field(4), pa.array(["RobotFlew.v1"] * table.num_rows))
    data = bytes(segment.to_parquet(changed))
    file.write_bytes(data)
    record = msgspec.structs.replace(
        open_ledger(path).records[1], segment_sha256=sha256_hex(data), segment_bytes=len(data)
    )
    commit_path(path, 1).write_bytes(canonical.document(record))
    with pytest.raises(
        UnknownEventTag,
        match=r"000000000001\.parquet: commit 1: run run-0002, seq 0, field type: found 'RobotFlew\.v1'",
    ):
        list(open_ledger(path).runs())


def test_a_missing_record_or_a_stray_file_among_them_is_named(path: Path) -> None:
    append_all(path, BATCHES)
    record = path / "commits" / "000000000001.json"
    record.rename(path / "aside")
    with pytest.raises(LedgerCorrupted, match=r"found '000000000002\.json', expected 000000000001\.json"):
        open_ledger(path)
    (path / "aside").rename(record)
    (path / "commits" / "notes.txt").write_text("x")
    with pytest.raises(LedgerCorrupted, match=r"found .notes\.txt."):
        open_ledger(path)


def test_a_record_that_contradicts_the_chain_is_named(path: Path) -> None:
    append_all(path, BATCHES)
    record = path / "commits" / "000000000001.json"
    record.write_bytes(record.read_bytes().replace(b"run-0003", b"run-0009"))
    with pytest.raises(LedgerCorrupted, match=r"000000000002\.json: field previous_sha256"):
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
