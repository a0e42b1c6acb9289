"""Writers interrupted at any call, in any way, and the recovery from them; several at once, killed and
not; `python -m tests.ledger.crash_soak` tries all."""

import errno
import os
import random
import signal
from collections import Counter
from pathlib import Path

import pytest

from fsar_ledger.base.errors import FsarLedgerError, WriteFailed
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.staging import stage
from tests.ledger.crash_trials import ROWS, RUNS, Laboratory, write_with
from tests.ledger.crash_writer import Nursery, Order
from tests.ledger.crowd import NAMES, judge, part
from tests.ledger.faults import KINDS, REFUSED, Fault, FaultyOs, faults_at, one_fault_a_call
from tests.ledger.power import choices
from tests.ledger.readers_beside_soak import trial
from tests.ledger.samples import ORIGIN, append_all, contents
from tests.quick import few
from tests.running import files_of_at_most


@pytest.fixture
def laboratory(tmp_path: Path) -> Laboratory:
    return Laboratory(tmp_path)


@pytest.mark.parametrize("step", few([7, 61, 183], [183], [61]))
def test_a_fault_at_any_call_loses_nothing_acknowledged_and_the_power_may_fail_after_it(
    laboratory: Laboratory, calls: list[str], step: int
) -> None:
    for number, fault in enumerate(one_fault_a_call(calls)):
        if number % step == 0:
            laboratory.trial([fault], choices(number, 1)[number % 3 :: 3])
    assert laboratory.tally.complaints == []
    assert laboratory.tally.faults >= len(calls) // step
    assert laboratory.tally.power_failures > len(calls) // step


def says_what_to_do(error: FsarLedgerError, fault: Fault, path: Path) -> bool:
    """Return whether the message names a path, the disk's reason, and what to do."""
    code = REFUSED.get(fault.kind) or (
        errno.ENOSPC if fault.kind in ("disk-full", "short-write-no-space") else errno.EIO
    )
    message = str(error)
    again = ("run it again", "run the same command again", "append what it lacks")
    way_out = (*again, "restore it", "the next writer writes it")
    return message.startswith(str(path)) and os.strerror(code) in message and message.endswith(way_out)


@pytest.mark.parametrize("step", few([11, 101, 301], [301], [101]))
def test_every_kind_of_refusal_is_one_clear_error(tmp_path: Path, calls: list[str], step: int) -> None:
    met = Counter[str]()
    for number, fault in enumerate(fault for fault in faults_at(calls) if not fault.ends_the_process):
        if number % step:
            continue
        root = tmp_path / str(number)
        root.mkdir()
        session = write_with(FaultyOs(root, fault), root / "out" / "ledger")  # only our own errors may escape from it
        if session.error is not None:
            met[fault.kind] += 1
            assert says_what_to_do(session.error, fault, root), (fault, session.error)
        else:
            assert session.acknowledged == len(ROWS)
    assert met
    assert step > 41 or met.keys() == set(KINDS) - {"short-write", "killed", "killed-in-write"}


@pytest.mark.parametrize("pairs", few([3, 20], [], [3]))
def test_a_fault_during_the_recovery_loses_nothing_either(laboratory: Laboratory, calls: list[str], pairs: int) -> None:
    draw = random.Random(5)
    faults = list(faults_at(calls))
    for number in range(pairs):
        first, second = (
            draw.choice(faults),
            Fault(draw.randrange(50), draw.choice(("killed", "io-error", "disk-full", "io-error-after"))),
        )
        laboratory.trial([first, second], choices(number, 1)[-1:])
        laboratory.trial_after_power_failure(first, draw.choice(choices(number, 2)), second)
    assert laboratory.tally.complaints == []
    assert laboratory.tally.faults_in_recovery > pairs


@pytest.mark.parametrize("step", few([121, 363], [], [363]))
def test_a_fault_at_any_call_of_the_recovery_loses_nothing(laboratory: Laboratory, calls: list[str], step: int) -> None:
    for at in range(0, len(calls), step):
        laboratory.trials_of_recovery(Fault(at, "killed"), ("killed", "io-error", "killed-in-write", "disk-full"))
    assert laboratory.tally.complaints == []
    assert laboratory.tally.faults_in_recovery > (25 if step == 121 else 8)


@pytest.mark.parametrize("step", few([47, 151], [], [151]))
def test_a_process_really_killed_at_a_call_loses_nothing(
    nursery: Nursery, laboratory: Laboratory, calls: list[str], tmp_path: Path, step: int
) -> None:
    for at in range(step // 2, len(calls), step):
        path = tmp_path / f"killed-{at}" / "out" / "ledger"
        path.parent.parent.mkdir()
        outcome = nursery(Order(str(path), fault_at=at))
        assert (outcome.killed, outcome.wrong) == (1, ())
        laboratory.finish(path, laboratory.judge(path, outcome.acknowledged.get("trial", 0), at), at)
    assert laboratory.tally.complaints == []


@pytest.mark.parametrize(
    ("writers", "steps"),
    [(2, 4), pytest.param(4, 12, marks=pytest.mark.soak), pytest.param(8, 6, marks=pytest.mark.slow)],
)
def test_what_several_writers_do_at_once_is_there_once_and_readers_see_whole_commits(
    nursery: Nursery, tmp_path: Path, writers: int, steps: int
) -> None:
    path = tmp_path / "ledger"
    outcome = nursery(Order(str(path), NAMES[:writers], steps, readers=1))
    assert outcome.wrong == ()
    assert outcome.acknowledged == dict.fromkeys(NAMES[:writers], steps)
    assert judge(path, outcome.acknowledged) == []
    assert outcome.heads >= 1


@pytest.mark.slow
def test_processes_killed_at_random_moments_lose_nothing_and_stop_nobody(nursery: Nursery, tmp_path: Path) -> None:
    moments, killed, path = random.Random(7), 0, tmp_path / "ledger"
    for steps in range(2, 12, 2):  # the ledger is killed again and again while it grows
        kill_after_us = tuple(moments.randrange(150_000) for _ in range(2))
        outcome = nursery(Order(str(path), NAMES[:3], steps, kill_after_us=kill_after_us))
        killed += outcome.killed
        assert outcome.wrong == ()
        assert judge(path, outcome.acknowledged) == []
        assert outcome.acknowledged[NAMES[2]] == steps
    assert killed > 2, "most processes had ended before they were killed; give them more to do"


@pytest.mark.parametrize("rounds", few([3, 8], [], [3]))
def test_readers_beside_killed_and_refused_writers_see_what_is_committed_once_and_for_ever(
    nursery: Nursery, tmp_path: Path, rounds: int
) -> None:
    tally = trial(nursery, tmp_path / "ledger", random.Random(3), rounds)
    assert tally.wrong == ()
    assert min(tally.kills, tally.refusals, tally.seen) > 1


def test_the_judge_of_the_crowd_sees_a_lost_step_and_one_out_of_order(tmp_path: Path) -> None:
    with Writer(tmp_path / "lost", ORIGIN) as writer:
        writer.add([part("anna", 0)])
    assert judge(tmp_path / "lost", {"anna": 2}) == ["lost: 1 of 2 acknowledged steps of anna are there"]
    with Writer(tmp_path / "swapped", ORIGIN) as writer:
        writer.add([part("anna", 3)])
        writer.add([part("anna", 0)])
    assert judge(tmp_path / "swapped", {"anna": 1})[0] == "torn: commit 0 does not hold step 0 of anna"
    assert judge(tmp_path / "nowhere", {"anna": 1}) == ["lost: the ledger is gone"]


BATCHES = [[run] for run in RUNS]


def test_a_write_that_the_disk_takes_in_parts_is_continued(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write = os.write
    monkeypatch.setattr(os, "write", lambda handle, data: write(handle, bytes(data)[:1000]))
    append_all(tmp_path / "parts", BATCHES[:2])
    monkeypatch.undo()
    append_all(tmp_path / "whole", BATCHES[:2])
    assert contents(tmp_path / "parts") == contents(tmp_path / "whole")


def test_a_disk_that_takes_nothing_and_says_nothing_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "write", lambda handle, data: 0)
    with pytest.raises(WriteFailed, match="the disk took no more bytes"):
        Writer(tmp_path / "ledger", ORIGIN)


def test_signals_interrupt_no_append(tmp_path: Path) -> None:
    rings = Counter[int]()
    before = signal.signal(signal.SIGALRM, lambda number, frame: rings.update([number]))
    signal.setitimer(signal.ITIMER_REAL, 0.0005, 0.0005)
    try:
        append_all(tmp_path / "interrupted", BATCHES)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    append_all(tmp_path / "calm", BATCHES)
    assert rings[signal.SIGALRM] > 10
    assert contents(tmp_path / "interrupted") == contents(tmp_path / "calm")


def test_a_segment_that_the_disk_has_no_room_for_leaves_nothing_behind(tmp_path: Path) -> None:
    path = tmp_path / "ledger"
    append_all(path, BATCHES[:1])
    before = contents(path)
    with Writer(path, ORIGIN):
        with files_of_at_most(4096), pytest.raises(WriteFailed, match="writing a segment failed: File too large"):
            stage(path, BATCHES[1])
        assert contents(path) == before


def test_records_that_the_disk_has_no_room_for_commit_nothing(tmp_path: Path) -> None:
    path = tmp_path / "ledger"
    append_all(path, BATCHES[:1])
    before = contents(path)
    with Writer(path, ORIGIN) as writer:
        staged = stage(path, BATCHES[1])
        with files_of_at_most(100), pytest.raises(WriteFailed, match="writing to the chain failed: File too large"):
            writer.append(staged)
        with pytest.raises(WriteFailed, match="broken"):
            writer.append(staged)
    assert {name: data for name, data in contents(path).items() if not name.startswith("staging/")} == before
    append_all(path, BATCHES[1:])
    append_all(tmp_path / "calm", BATCHES)
    assert contents(path) == contents(tmp_path / "calm")


def test_a_ledger_that_the_disk_has_no_room_for_can_be_created_later(tmp_path: Path) -> None:
    path = tmp_path / "ledger"
    with files_of_at_most(10), pytest.raises(WriteFailed, match="creating a ledger failed: File too large"):
        Writer(path, ORIGIN)
    assert contents(path) == {}
    append_all(path, BATCHES)
    append_all(tmp_path / "calm", BATCHES)
    assert contents(path) == contents(tmp_path / "calm")


def test_a_ledger_that_cannot_be_written_to_is_not_said_to_be_interrupted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, opens = tmp_path / "ledger", os.open
    append_all(path, BATCHES)

    def read_only(name: str | Path, flags: int, mode: int = 0o777) -> int:
        if flags & (os.O_WRONLY | os.O_RDWR):
            raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(name))
        return opens(name, flags, mode)

    monkeypatch.setattr(os, "open", read_only)
    with pytest.raises(WriteFailed) as refused:
        Writer(path, ORIGIN)
    assert f"{path}: opening it for writing failed: {os.strerror(errno.EROFS)}; " in str(refused.value)
