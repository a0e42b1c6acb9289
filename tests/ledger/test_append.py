import os
import pickle
import select
from collections.abc import Callable
from pathlib import Path

import pyarrow as pa
import pytest

from fsar_ledger.base.errors import LedgerCorrupted, WriteFailed
from fsar_ledger.ledger.log import merkle
from fsar_ledger.ledger.log.note import Note, checkpoint_of
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows import canonical, segment
from fsar_ledger.ledger.rows.codec import encode_hashed
from fsar_ledger.ledger.store import disk, paths, prepare
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.record import EMPTY_HEAD
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.ledger.verify import verify
from tests.ledger.forgery import changed, forge_segment, segment_at, table_of
from tests.ledger.samples import ORIGIN, append_all, contents, made_up_batches

BATCHES = made_up_batches(4)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "out" / "ledger"


def test_a_new_ledger_is_empty(path: Path) -> None:
    with Writer(path, ORIGIN) as writer:
        assert writer.head == EMPTY_HEAD
    assert open_ledger(path).head == EMPTY_HEAD
    assert EMPTY_HEAD.root == "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"
    assert contents(path) == {"ledger.json": b'{"format":"fsar-ledger","origin":"example.org/fsar-test","version":2}'}
    assert verify(path).ok


def test_what_was_appended_is_read_back_in_order(path: Path) -> None:
    head = append_all(path, BATCHES)
    view = open_ledger(path)
    assert list(view.runs()) == [run for batch in BATCHES for run in batch]
    assert view.head == head
    assert (head.commits, head.size) == (4, 4 * 2 * 12)
    assert [table.num_rows for table in view.tables(["seq"])] == [24] * 4
    assert [file.name for file in view.segments()] == [f"{at:012d}-{at + 24:012d}.parquet" for at in range(0, 96, 24)]


def test_the_root_is_that_of_all_leaves(path: Path) -> None:
    head = append_all(path, BATCHES)
    leaves = b"".join(encode_hashed(batch)[1] for batch in BATCHES)
    assert head.root == merkle.Frontier().extend(leaves).root().hex()


def test_a_record_says_what_was_committed(path: Path) -> None:
    append_all(path, BATCHES)
    view, files = open_ledger(path), contents(path)
    commit, placement = view.commits[2], view.chain.placements[2]
    assert (commit.number, commit.rows, commit.tree_size) == (2, 24, 72)
    assert (placement.number, placement.rows, placement.first) == (2, 24, 48)
    assert placement.segment_bytes == len(files["segments/000000000048-000000000072.parquet"])
    assert files["chain.jsonl"].splitlines()[4:6] == [canonical.document(commit), canonical.document(placement)]
    assert str(commit.note(ORIGIN)) == str(Note(checkpoint_of(ORIGIN, placement.tree())))


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


def test_of_two_writers_one_wins_the_number_and_the_other_goes_on_from_it_with_what_it_staged(path: Path) -> None:
    with Writer(path, ORIGIN) as one, Writer(path, ORIGIN) as two:
        staged = [stage(path, batch) for batch in BATCHES]
        for number, writer in enumerate((one, two, two, one)):
            assert writer.append(staged[number]).commits == number + 1
    assert list(open_ledger(path).runs()) == [run for batch in BATCHES for run in batch]
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
        assert two.append(stage(path, BATCHES[two.head.commits])).commits == 4
    Writer(path, ORIGIN).close()
    assert contents(path) == before
    assert verify(path).ok


@pytest.mark.parametrize("moment", ["looks whether something else is there", "gives the manifest its name"])
def test_of_two_processes_that_create_a_ledger_the_slower_one_opens_it(
    path: Path, monkeypatch: pytest.MonkeyPatch, moment: str
) -> None:
    path.mkdir(parents=True)

    def after_the_quicker_one(step: Callable[..., object]) -> Callable[..., object]:
        def late(*arguments: object) -> object:
            monkeypatch.undo()
            append_all(path, BATCHES[:1])
            return step(*arguments)

        return late

    if moment == "gives the manifest its name":
        monkeypatch.setattr(os, "link", after_the_quicker_one(os.link))
    else:
        monkeypatch.setattr(prepare, "is_unfinished", after_the_quicker_one(paths.is_unfinished))
    with Writer(path, ORIGIN) as writer:
        assert writer.head.commits == 1


def test_a_second_writer_leaves_the_staging_of_the_first_alone(path: Path) -> None:
    with Writer(path, ORIGIN) as one:
        staged = stage(path, BATCHES[0])
        Writer(path, ORIGIN).close()
        assert one.append(staged).commits == 1


def test_a_lone_writer_removes_leftovers_from_staging(path: Path) -> None:
    append_all(path, BATCHES[:1])
    before = contents(path)
    stage(path, BATCHES[0])  # which is committed
    stage(path, BATCHES[1])
    (path / "staging" / "something.tmp").write_bytes(b"half")
    assert verify(path).ok
    Writer(path, ORIGIN).close()
    assert contents(path) == before


def test_a_committed_segment_still_in_staging_is_read_there_and_moved_by_the_next_writer(path: Path) -> None:
    append_all(path, BATCHES[:2])
    before = contents(path)
    placement = open_ledger(path).chain.placements[1]
    segment_at(path, 1).rename(path / "staging" / f"{placement.segment_sha256}.parquet")
    view = open_ledger(path)
    assert view.segment(1).parent.name == "staging"
    assert list(view.runs()) == [run for batch in BATCHES[:2] for run in batch]
    assert verify(path).ok
    Writer(path, ORIGIN).close()
    assert contents(path) == before


def _one_commit_behind(path: Path) -> None:
    """Leave what a crash leaves between the third commit and its derived files."""
    append_all(path, BATCHES[:2])
    derived = {name: data for name, data in contents(path).items() if name in ("checkpoint", "nodes", "index.jsonl")}
    append_all(path, BATCHES[2:3])
    for name, data in derived.items():
        (path / name).write_bytes(data)


def test_a_writer_one_commit_behind_goes_on_to_the_same_bytes(path: Path, tmp_path: Path) -> None:
    _one_commit_behind(path)
    Writer(path, ORIGIN).close()
    append_all(tmp_path / "whole", BATCHES[:3])
    assert contents(path).items() >= contents(tmp_path / "whole").items()
    assert verify(path).ok


def test_a_writer_derives_nothing_from_a_segment_that_was_altered_since_its_commit(path: Path) -> None:
    _one_commit_behind(path)
    data = bytearray(segment_at(path, 2).read_bytes())
    data[len(data) // 2] ^= 1
    segment_at(path, 2).write_bytes(data)
    before = contents(path)
    with pytest.raises(
        LedgerCorrupted,
        match=r"000000000072\.parquet: commit 2, field segment_sha256: found SHA-256 .* says; restore the file",
    ):
        Writer(path, ORIGIN)
    assert contents(path) == before


def test_a_writer_derives_nothing_from_rows_that_do_not_lead_to_the_root_as_committed(path: Path) -> None:
    _one_commit_behind(path)
    forge_segment(path, 2, changed(table_of(path, 2), "time_us", 3, 1))
    before = contents(path)
    with pytest.raises(
        LedgerCorrupted, match=r"000000000072\.parquet: found rows that lead to root .* run fsar-ledger verify"
    ):
        Writer(path, ORIGIN)
    assert contents(path) == before


def test_a_segment_that_moves_into_place_while_it_is_read_is_found_there(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    append_all(path, BATCHES[:1])
    placed = segment_at(path, 0)
    staged = path / "staging" / f"{open_ledger(path).chain.placements[0].segment_sha256}.parquet"
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


def test_a_process_that_was_forked_waits_for_its_turn_as_any_other_does(tmp_path: Path) -> None:
    """A lock is of an open file, which a fork shares: both processes wrote at once, and lost what one had been told."""
    turn = disk.FolderLock(tmp_path)
    heard, tells = os.pipe()
    with turn:
        if not (child := os.fork()):
            try:
                with turn:
                    os.write(tells, b"x")
            finally:
                os._exit(0)
        assert select.select([heard], [], [], 0.1) == ([], [], [])
    assert select.select([heard], [], [], 30)[0] == [heard]
    os.waitpid(child, 0)
    turn.close()
    os.close(heard)
    os.close(tells)
