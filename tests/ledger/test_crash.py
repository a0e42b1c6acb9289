"""Appends interrupted at any call, in any way, and the recovery from them; `python -m tests.ledger.crash_soak` tries
all."""

import errno
import os
import random
import resource
import signal
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from fsar_ledger.errors import FsarLedgerError, WriteFailed
from fsar_ledger.ledger.store import append
from fsar_ledger.ledger.store.append import Writer, stage
from tests.ledger.crash_trials import BATCHES, COMMITS, INTERRUPTED, Laboratory, Session, append_with
from tests.ledger.crash_writer import Nursery, Order
from tests.ledger.crowd import NAMES, judge
from tests.ledger.faults import KINDS, REFUSED, Fault, FaultyOs, calls_of, faults_at, one_fault_a_call
from tests.ledger.power import choices
from tests.ledger.samples import ORIGIN, append_all, contents
from tests.quick import few


@pytest.fixture
def laboratory(tmp_path: Path) -> Laboratory:
    return Laboratory(tmp_path)


@pytest.fixture
def calls(tmp_path: Path) -> list[str]:
    """Return the calls of two appends to a new ledger."""
    root = tmp_path / "calls"
    root.mkdir()
    return calls_of(root, lambda: append_with(FaultyOs(root), root / "out" / "ledger"))


def says_what_to_do(error: FsarLedgerError, fault: Fault, path: Path) -> bool:
    """Return whether the message names a path, the disk's reason, and what to do."""
    code = REFUSED.get(fault.kind) or (
        errno.ENOSPC if fault.kind in ("disk-full", "short-write-no-space") else errno.EIO
    )
    message = str(error)
    way_out = ("run it again", "run the same command again", "restore it")
    return message.startswith(str(path)) and os.strerror(code) in message and message.endswith(way_out)


@pytest.mark.slow
def test_a_fault_at_any_call_loses_nothing_acknowledged_and_the_power_may_fail_after_it(
    laboratory: Laboratory, calls: list[str]
) -> None:
    for number, fault in enumerate(one_fault_a_call(calls)):
        (session,) = laboratory.trial([fault], choices(number, 1)[number % 3 :: 3])
        assert session.was_killed == fault.ends_the_process
    assert laboratory.tally.complaints == []
    assert laboratory.tally.faults == len(calls)
    assert laboratory.tally.power_failures > 2 * len(calls)


@pytest.mark.slow
def test_a_fault_during_the_recovery_loses_nothing_either(laboratory: Laboratory, calls: list[str]) -> None:
    draw = random.Random(5)
    faults = list(faults_at(calls))
    for number in range(40):
        first, second = (
            draw.choice(faults),
            Fault(draw.randrange(50), draw.choice(("killed", "io-error", "disk-full", "io-error-after"))),
        )
        laboratory.trial([first, second], choices(number, 1)[-1:])
        laboratory.trial_after_power_failure(first, draw.choice(choices(number, 2)), second)
    assert laboratory.tally.complaints == []
    assert laboratory.tally.faults_in_recovery > 50


@pytest.mark.parametrize("step", few([5, 11], [11]))
def test_every_kind_of_refusal_is_one_clear_error(tmp_path: Path, calls: list[str], step: int) -> None:
    met = Counter[str]()
    for number, fault in enumerate(fault for fault in faults_at(calls) if not fault.ends_the_process):
        if number % step:
            continue
        root = tmp_path / str(number)
        root.mkdir()
        session: Session = append_with(
            FaultyOs(root, fault), root / "out" / "ledger"
        )  # anything but our own errors escapes from it
        if session.error is not None:
            met[fault.kind] += 1
            assert says_what_to_do(session.error, fault, root), (fault, session.error)
        else:
            assert session.acknowledged == INTERRUPTED
    assert met.keys() == set(KINDS) - {"short-write", "killed", "killed-in-write"}
    assert min(met.values()) >= 1


def test_a_write_that_the_disk_takes_in_parts_is_continued(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write = os.write
    monkeypatch.setattr(os, "write", lambda handle, data: write(handle, bytes(data)[:1000]))
    append_all(tmp_path / "parts", BATCHES[:1])
    monkeypatch.undo()
    append_all(tmp_path / "whole", BATCHES[:1])
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


@pytest.mark.parametrize("step", few([7, 20], [20]))
def test_a_process_really_killed_at_a_call_loses_nothing(
    nursery: Nursery, laboratory: Laboratory, calls: list[str], tmp_path: Path, step: int
) -> None:
    for at in range(0, len(calls), step):
        path = tmp_path / f"killed-{at}" / "out" / "ledger"
        path.parent.parent.mkdir()
        outcome = nursery(Order(str(path), fault_at=at))
        assert (outcome.killed, outcome.wrong) == (1, ())
        state = laboratory.judge(path, outcome.acknowledged.get("trial", 0), at)
        laboratory.finish(path, state, at)
    assert laboratory.tally.complaints == []


@pytest.mark.slow
def test_processes_killed_at_random_moments_lose_nothing(tmp_path: Path) -> None:
    moments = random.Random(7)
    killed = 0
    with Nursery() as nursery:
        for ledger in range(4):
            path = tmp_path / str(ledger)
            for batches in range(2, 10, 2):  # the ledger is killed again and again while it grows
                order = Order(
                    str(path),
                    NAMES[:2],
                    batches,
                    kill_after_us=(moments.randrange(150_000), moments.randrange(150_000)),
                )
                outcome = nursery(order)
                killed += outcome.killed
                assert outcome.wrong == ()
                assert judge(path, outcome.acknowledged) == []
    assert killed > 5, "most processes had ended before they were killed; give them more to do"


@contextmanager
def files_of_at_most(size_bytes: int) -> Iterator[None]:
    """Make the kernel refuse to write a file beyond this size (EFBIG)."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_segment_that_the_disk_has_no_room_for_leaves_nothing_behind(tmp_path: Path) -> None:
    path = tmp_path / "ledger"
    append_all(path, BATCHES[:1])
    before = contents(path)
    with Writer(path, ORIGIN):
        with files_of_at_most(4096), pytest.raises(WriteFailed, match="writing a segment failed: File too large"):
            stage(path, BATCHES[1])
        assert contents(path) == before


def test_a_record_that_the_disk_has_no_room_for_commits_nothing(laboratory: Laboratory, tmp_path: Path) -> None:
    path = tmp_path / "ledger"
    append_all(path, BATCHES[:1])
    before = contents(path)
    with Writer(path, ORIGIN) as writer:
        staged = stage(path, BATCHES[1])
        with files_of_at_most(100), pytest.raises(WriteFailed, match="writing a commit record failed: File too large"):
            writer.append(staged)
        with pytest.raises(WriteFailed, match="broken"):
            writer.append(staged)
    assert {name: data for name, data in contents(path).items() if not name.startswith("staging/")} == before
    append_all(path, BATCHES[1:COMMITS])
    assert contents(path) == laboratory.reference


def test_a_ledger_that_the_disk_has_no_room_for_can_be_created_later(laboratory: Laboratory, tmp_path: Path) -> None:
    path = tmp_path / "ledger"
    with files_of_at_most(10), pytest.raises(WriteFailed, match="creating a ledger failed: File too large"):
        append.Writer(path, ORIGIN)
    assert contents(path) == {}
    append_all(path, BATCHES)
    assert contents(path) == laboratory.reference
