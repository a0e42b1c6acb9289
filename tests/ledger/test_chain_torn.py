"""What no crash leaves of a ledger, what one may leave, and what a compaction takes from under a reader."""

import shutil
from pathlib import Path

import pytest

from fsar_ledger.base.errors import LedgerCorrupted
from fsar_ledger.ledger.opening import open_for_answers
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.paths import CHAIN, INDEX, JOURNAL, NODES
from fsar_ledger.ledger.store.read import View
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.ledger.verify import verify
from fsar_ledger.ledger.verify.chain import SEALED
from tests.ledger.agreement import Case, judged
from tests.ledger.agreement_chain import records_of, relink
from tests.ledger.crash_trials import Laboratory, write_with
from tests.ledger.damage import RUNS, piece, write_open
from tests.ledger.faults import Fault, FaultyOs, calls_of, in_place_of_os
from tests.ledger.power import choices
from tests.ledger.samples import ORIGIN, contents


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Return a ledger with one segment and three commits in its journal, which no checkpoint covers."""
    write_open(tmp_path / "ledger")
    return tmp_path / "ledger"


def flip(path: Path, name: str, after: bytes, bit: int = 1) -> None:
    """Flip a bit of the byte behind the first such bytes of the file; a digit of a hash stays one."""
    data = (path / name).read_bytes()
    at = data.index(after) + len(after)
    if data[at] in b"af" and bit == 1:
        bit = 2
    (path / name).write_bytes(data[:at] + bytes([data[at] ^ bit]) + data[at + 1 :])


@pytest.mark.parametrize("member", [b'"number":', b'"previous_sha256":"', b'"release":"0.', b'"rows":'])
def test_a_record_of_the_journal_that_can_be_read_and_contradicts_was_not_torn(path: Path, member: bytes) -> None:
    with Writer(path, ORIGIN, adopts=True) as writer:
        writer.seal()
        writer.add([piece(1, 6, 8)])
    (path / "checkpoint").write_text(str(open_for_answers(path).commits[-2].note(ORIGIN)))
    assert verify(path).ok
    flip(path, JOURNAL, member)
    before = contents(path)
    assert [problem.where for problem in verify(path).problems] == [JOURNAL]
    assert judged(Case("flipped", path, False)).difference == ""
    with pytest.raises(LedgerCorrupted, match=JOURNAL):
        Writer(path, ORIGIN, adopts=True)
    assert contents(path) == before


def test_a_flipped_number_does_not_make_a_journal_pass_for_sealed(path: Path) -> None:
    flip(path, JOURNAL, b'"number":')
    assert b'"number":0' in (path / JOURNAL).read_bytes()
    assert [problem.where for problem in verify(path).problems] == [JOURNAL]


def test_a_line_of_the_chain_that_can_be_read_and_contradicts_was_not_torn(path: Path) -> None:
    with Writer(path, ORIGIN, adopts=True) as writer:
        writer.seal()
    lines = (path / CHAIN).read_bytes().splitlines(keepends=True)
    (path / CHAIN).write_bytes(b"".join([*lines[:-2], lines[-1]]))
    found = verify(path).problems[0]
    assert (found.where, found.field) == (CHAIN, "previous_sha256")
    (path / CHAIN).write_bytes(b"".join([*lines[:-1], lines[-1][:-20]]))
    assert verify(path).problems[0].where != CHAIN  # it is torn, and something else shows that more was there


def test_a_sealed_journal_that_cannot_be_removed_leaves_nothing_in_the_next_one(tmp_path: Path) -> None:
    root = tmp_path / "root"
    root.mkdir()
    path = root / "ledger"

    def work() -> None:
        with Writer(path, ORIGIN, adopts=True) as writer:
            writer.add([RUNS[1]])
            writer.seal()
            writer.add([piece(3, 0, 1)])

    calls = calls_of(root, work)
    shutil.rmtree(path)
    at = max(number for number, name in enumerate(calls) if name == "unlink" and "pwrite" in calls[number:])
    with in_place_of_os(FaultyOs(root, Fault(at, "io-error"))) as faulty:
        work()
    assert faulty.was_hit
    assert (path / JOURNAL).read_bytes().count(b"\n") == 2
    assert verify(path).remarks == ()


@pytest.mark.parametrize("rubbish", [False, True])
def test_sealing_may_be_interrupted_when_the_checkpoint_covers_the_journal_already(path: Path, rubbish: bool) -> None:
    with Writer(path, ORIGIN, adopts=True) as writer:
        writer.add([RUNS[0]])
    before = contents(path)
    with Writer(path, ORIGIN, adopts=True) as writer:
        writer.seal()
    sealed = contents(path)
    (path / JOURNAL).write_bytes(before[JOURNAL])
    for name in (NODES, INDEX):
        size = len(sealed[name]) - len(before[name])
        (path / name).write_bytes(before[name] + b"x" * size * rubbish)
    report = verify(path)
    assert (report.problems, report.remarks) == ((), (SEALED,))
    assert judged(Case("sealed", path, True)).difference == ""
    Writer(path, ORIGIN, adopts=True).close()
    assert contents(path) == sealed
    assert verify(path).remarks == ()


@pytest.mark.slow
def test_a_checkpoint_outlives_no_power_failure_that_takes_the_files_before_it(tmp_path: Path) -> None:
    laboratory = Laboratory(tmp_path)
    root = tmp_path / "calls"
    root.mkdir()
    calls = calls_of(root, lambda: write_with(FaultyOs(root), root / "out" / "ledger", 1))
    last = max(number for number, name in enumerate(calls) if name == "replace")
    laboratory.trial([Fault(last + 1, "killed")], choices(0, 6)[4:])
    assert laboratory.tally.complaints == []


@pytest.mark.slow
def test_the_room_of_a_journal_that_could_not_be_synced_is_given_up(tmp_path: Path) -> None:
    laboratory = Laboratory(tmp_path)
    root = tmp_path / "calls"
    root.mkdir()
    calls = calls_of(root, lambda: write_with(FaultyOs(root), root / "out" / "ledger"))
    syncs = [number for number, name in enumerate(calls) if name == "fdatasync"]
    for at in syncs[3:5]:
        laboratory.trial([Fault(at, "disk-gone")])
    assert laboratory.tally.complaints == []


def test_a_reader_goes_on_reading_while_the_segments_are_compacted(path: Path) -> None:
    with Writer(path, ORIGIN, adopts=True) as writer:
        writer.seal()
        before, checked = open_for_answers(path), open_for_answers(path)
        assert isinstance(before, View)
        assert isinstance(checked, View)
        there = checked.segments()
        assert writer.compact() == 2
    assert not any(segment.exists() for segment in there)
    after = open_for_answers(path)
    assert len(before.releases) == 2
    assert list(before.runs()) == list(checked.runs()) == list(after.runs())
    assert [before.event(index) for index in range(15)] == [after.event(index) for index in range(15)]
    assert [segment.exists() for segment in checked.segments()] == [True, True]


def test_a_segment_that_no_compaction_took_is_missed(path: Path) -> None:
    with Writer(path, ORIGIN, adopts=True) as writer:
        writer.seal()
    view = open_for_answers(path)
    for segment in (path / "segments").iterdir():
        segment.unlink()
    with pytest.raises(LedgerCorrupted, match="found no segment"):
        list(view.runs())


@pytest.mark.parametrize("is_last", [False, True])
def test_a_forged_frontier_is_found_by_verify_and_by_whoever_would_go_on_from_it(path: Path, is_last: bool) -> None:
    with Writer(path, ORIGIN, adopts=True) as writer:
        writer.seal()
        writer.append(stage(path, RUNS[3:]))
    records, frames = records_of(path)
    placement = [record for record in records if record["kind"] == "placement"][-1 if is_last else 0]
    placement["frontier"] = ["0" * 64, *placement["frontier"][1:]]
    relink(path, records, frames)
    found = verify(path).problems[0]
    assert (found.where, found.field) == (CHAIN, "frontier")
    assert judged(Case("forged", path, False)).difference == ""
    if is_last:
        with pytest.raises(LedgerCorrupted, match="frontier"):
            open_for_answers(path)
        with pytest.raises(LedgerCorrupted, match="frontier"):
            Writer(path, ORIGIN, adopts=True)
