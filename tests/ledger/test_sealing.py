"""A full journal becomes a segment while commits go on: what is there meanwhile, and what no crash leaves."""

import gc
import shutil
import tracemalloc
from collections.abc import Iterator
from pathlib import Path
from threading import Event
from typing import Any
from unittest.mock import patch

import msgspec
import pytest

from fsar_ledger.base.errors import FormatVersionMismatch, LedgerCorrupted
from fsar_ledger.ledger.opening import open_for_answers
from fsar_ledger.ledger.rows.codec import encode_lines
from fsar_ledger.ledger.rows.runs import piece as piece_of
from fsar_ledger.ledger.store import append, growing, prepare
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.paths import CHAIN, JOURNAL, SEALING, SEGMENTS
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.ledger.verify import verify
from tests.ledger.agreement import Case, judged
from tests.ledger.agreement_chain import hand_over, view_of
from tests.ledger.damage import piece, write_handed_over
from tests.ledger.faults import is_free
from tests.ledger.samples import ORIGIN, contents, made_up_run
from tests.quick import few

PARTS = [piece(1, 2 * number, 2 * number + 2) for number in range(6)]
ROWS = [row for part in PARTS for row in encode_lines([part])]


def rows_in(path: Path) -> list[bytes]:
    view = view_of(path)
    return view.rows(0, view.head.size)


@pytest.fixture
def held_back() -> Iterator[Event]:
    """Let the thread that makes a segment wait until this is set."""
    may_go_on = Event()
    made = prepare.sealed

    def later(*given: Any) -> Any:
        assert may_go_on.wait(60)
        return made(*given)

    with patch.object(prepare, "sealed", later), patch.object(append, "SEAL_ROWS", 5):
        yield may_go_on
        may_go_on.set()


@pytest.fixture
def chained(tmp_path: Path) -> Path:
    """Return a ledger whose journal was handed over, and then one more, of which the chain has the first commit."""
    write_handed_over(tmp_path / "ledger")
    return tmp_path / "ledger"


def test_commits_go_on_while_the_journal_before_is_sealed(tmp_path: Path, held_back: Event) -> None:
    path = tmp_path / "ledger"
    with Writer(path, ORIGIN, adopts=True) as writer:
        writer.add([PARTS[0]])
        writer.add([PARTS[1]])
        before = view_of(path)
        assert before.is_current()
        writer.add([PARTS[2]])  # a fifth event fits, a sixth does not
        assert {SEALING, JOURNAL} <= contents(path).keys()
        assert not before.is_current()
        assert rows_in(path) == ROWS[:6]
        assert verify(path).ok
        held_back.set()
        writer.settle()
        assert SEALING not in contents(path)
        view = view_of(path)
        assert (view.chain.placed_size, view.journal.chained, view.journal.rows) == (4, 1, 2)
        assert rows_in(path) == ROWS[:6]
        writer.add([PARTS[3]])
        assert verify(path).ok
    assert (rows_in(path), verify(path).remarks) == (ROWS[:8], ())
    with Writer(path, ORIGIN, adopts=True) as writer:
        writer.seal()
    assert [(one.first, one.end) for one in view_of(path).chain.placed] == [(0, 4), (4, 8)]


def test_another_writer_fills_the_next_journal_before_the_first_is_sealed(tmp_path: Path, held_back: Event) -> None:
    path = tmp_path / "ledger"
    with Writer(path, ORIGIN, adopts=True) as writer, Writer(path, ORIGIN) as other:
        for part in PARTS[:3]:
            writer.add([part])
        held_back.set()
        for part in PARTS[3:]:
            other.add([part])
        assert rows_in(path) == ROWS
    assert (rows_in(path), verify(path).ok) == (ROWS, True)
    assert [(one.first, one.end) for one in view_of(path).chain.placed] == [(0, 4), (4, 8)]


def test_a_writer_that_has_the_journal_open_sees_that_another_handed_it_over(tmp_path: Path, held_back: Event) -> None:
    path = tmp_path / "ledger"
    with Writer(path, ORIGIN, adopts=True) as writer, Writer(path, ORIGIN) as other:
        other.add([PARTS[0]])
        other.add([PARTS[1]])
        handed_over = (path / JOURNAL).stat().st_ino
        writer.add([PARTS[2]])
        assert (path / SEALING).stat().st_ino == handed_over
        assert (path / SEALING).read_bytes()[-1:] == b"\n"
        other.add([PARTS[3]])
        held_back.set()
    assert (rows_in(path), verify(path).ok) == (ROWS[:8], True)


def test_what_a_writer_left_is_read_verified_continued_and_sealed(chained: Path) -> None:
    view = view_of(chained)
    assert (view.journal.sealing, view.journal.chained, view.chain.placed_size) == (2, 1, 2)
    assert rows_in(chained) == ROWS[:8]
    assert [bytes(view.event(index)) for index in range(8)] == ROWS[:8]
    assert judged(Case("as it is", chained, True)).difference == ""
    with Writer(chained, ORIGIN, adopts=True) as writer:
        writer.add([PARTS[4]])
        writer.seal()
    assert (rows_in(chained), verify(chained).remarks) == (ROWS[:10], ())
    assert not {SEALING, JOURNAL} & contents(chained).keys()


@pytest.mark.parametrize("is_cut", [False, True])
@pytest.mark.parametrize("step", few([23, 61, 241], [241], [61]))
def test_a_flipped_bit_or_a_cut_in_what_is_being_sealed_is_never_a_torn_end(
    chained: Path, step: int, is_cut: bool
) -> None:
    data = (chained / SEALING).read_bytes().rstrip(b"\0")
    for at in range(is_cut, len(data), step):
        (chained / SEALING).write_bytes(data[:at] + (b"" if is_cut else bytes([data[at] ^ 2]) + data[at + 1 :]))
        problem, *others = verify(chained).problems
        assert is_cut or not others
        for one in (problem, *others):
            assert one.where in (SEALING, JOURNAL), at  # a record may have another hash than the next one says
        assert judged(Case(f"changed at {at}", chained, False)).difference == ""
        with pytest.raises((LedgerCorrupted, FormatVersionMismatch), match=problem.where):  # a later release, perhaps
            open_for_answers(chained)


@pytest.mark.parametrize("name", [SEALING, JOURNAL])
def test_commits_of_the_chain_without_rows_are_damage(tmp_path: Path, chained: Path, name: str) -> None:
    if name == JOURNAL:  # whose frame the chain has
        with Writer(chained, ORIGIN, adopts=True) as writer:
            writer.settle()
            shutil.copytree(chained, tmp_path / "settled")
        chained = tmp_path / "settled"
        assert view_of(chained).journal.chained == 1
    (chained / name).unlink()
    assert [problem.where for problem in verify(chained).problems] == [JOURNAL]
    assert judged(Case("gone", chained, False)).difference == ""
    with pytest.raises(LedgerCorrupted, match=JOURNAL):
        Writer(chained, ORIGIN, adopts=True)


@pytest.mark.parametrize("step", few([43, 97], [97], []))
def test_a_frame_that_the_chain_has_cannot_be_torn(tmp_path: Path, chained: Path, step: int) -> None:
    with Writer(chained, ORIGIN, adopts=True) as writer:
        writer.settle()
        shutil.copytree(chained, tmp_path / "settled")
    data = (tmp_path / "settled" / JOURNAL).read_bytes().rstrip(b"\0")
    for at in range(0, len(data), step):
        (tmp_path / "settled" / JOURNAL).write_bytes(data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :])
        assert [problem.where for problem in verify(tmp_path / "settled").problems] == [JOURNAL], at
        assert judged(Case(f"flipped {at}", tmp_path / "settled", False)).difference == ""


def test_a_journal_that_is_renamed_between_two_looks_is_read_once(tmp_path: Path) -> None:
    path = tmp_path / "ledger"
    with Writer(path, ORIGIN, adopts=True) as writer:
        writer.add([PARTS[0]])
        real = growing.read_whole

        def renamed_after(file: Path, *given: int) -> bytes:
            data = real(file, *given)
            if file.name == JOURNAL and not (path / SEALING).exists():
                hand_over(writer)
                writer.add([PARTS[1]])
            return data

        with patch.object(growing, "read_whole", renamed_after):
            view = view_of(path)
        assert view.rows(0, view.head.size) == ROWS[:2]
        assert not view.is_current()
        assert rows_in(path) == ROWS[:4]


@pytest.mark.slow
def test_a_reader_beside_a_writer_that_never_rests_gets_an_answer(tmp_path: Path) -> None:
    path = tmp_path / "ledger"
    run = made_up_run("never-rests", 40, 3)
    parts = iter([piece_of(run, at, at + 1) for at in range(40)])
    with Writer(path, ORIGIN, adopts=True) as writer:
        writer.add([next(parts)])
        real = growing.read_whole
        reads = 0

        def beside(file: Path, *given: int) -> bytes:
            nonlocal reads
            data = real(file, *given)
            if file.name == CHAIN and reads < 15 and is_free(path / SEGMENTS):
                reads += 1
                writer.append(stage(path, [next(parts)]))
                writer.add([next(parts)])
            return data

        with patch.object(growing, "read_whole", beside):
            assert open_for_answers(path).head.size == 31
    assert reads == 15
    assert verify(path).ok


def test_a_placement_that_is_lost_takes_nothing_of_the_journal_with_it(chained: Path) -> None:
    lines = (chained / CHAIN).read_bytes().splitlines(keepends=True)
    (chained / CHAIN).write_bytes(b"".join(lines[:-1]))
    assert not verify(chained).ok
    assert judged(Case("without its placement", chained, False)).difference == ""


@pytest.mark.slow
def test_a_writer_keeps_nothing_of_commits_that_segments_hold_and_appends_the_same(tmp_path: Path) -> None:
    whole = made_up_run("r", 2_400, 1)
    path = tmp_path / "ledger"
    sizes = []
    tracemalloc.start()
    try:
        with Writer(path, ORIGIN, adopts=True) as writer:
            for at in range(2_400):
                writer.add([piece_of(msgspec.structs.replace(whole, goes_on=True), at, at + 1)])
                if at % 800 == 799:
                    writer.seal()
                    gc.collect()  # the session collects seldom: what is garbage is not kept
                    sizes.append(tracemalloc.get_traced_memory()[0])
            assert writer.head.commits == 2_400
    finally:
        tracemalloc.stop()
    assert sizes[2] - sizes[1] < 800 * 32, f"{(sizes[2] - sizes[1]) / 800:.0f} bytes for each commit"
    assert verify(path).ok
    with Writer(path, ORIGIN, adopts=True) as writer:
        assert (writer.head, writer.unfinished_runs()) == (view_of(path).head, {"r": 2_400})
