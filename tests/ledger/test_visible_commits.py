"""A reader sees a commit when it is on disk, not before, and then for ever: whatever the disk refuses meanwhile."""

import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest

from fsar_ledger.base.errors import NotALedger, WriteFailed
from fsar_ledger.ledger.opening import open_for_answers, open_ledger
from fsar_ledger.ledger.rows.runs import piece
from fsar_ledger.ledger.store import disk, snapshot
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.paths import CHAIN, JOURNAL, SEGMENTS
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.ledger.verify import verify
from tests.ledger.agreement import Case, judged
from tests.ledger.crash_trials import write_with
from tests.ledger.faults import SYNCS, WRITES, Fault, FaultyOs
from tests.ledger.power import choices
from tests.ledger.samples import ORIGIN, made_up_run
from tests.quick import few

RUN = made_up_run("run-0", 60, 1)
KINDS = ("no-space", "io-error", "io-error-after", "disk-full", "disk-gone")
Roots = dict[int, str]
"""The root of the ledger by its number of events, after each of some commits."""


def roots_of(path: Path) -> Roots:
    """Return what a reader sees of a ledger; nothing where there is none yet."""
    try:
        view = open_for_answers(path)
    except NotALedger:
        return {}
    return {commit.tree_size: commit.tree_root for commit in view.commits if hasattr(commit, "tree_root")}


class WatchedOs(FaultyOs):
    """A disk beside which a reader looks at the ledger after each call that may change it, from this one on."""

    def __init__(self, path: Path, look: Callable[[Path], None], fault: Fault | None = None, first: int = 0) -> None:
        super().__init__(path.parent.parent, fault)
        self._path, self._look, self._first, self._is_looking = path, look, first, False

    def _call(self, name: str, arguments: tuple[Any, ...], options: dict[str, Any]) -> Any:
        if self._is_looking:
            return getattr(os, name)(*arguments, **options)
        try:
            return super()._call(name, arguments, options)
        finally:
            if name in (*WRITES, *SYNCS, "ftruncate", "rename", "unlink") and len(self.calls) > self._first:
                self._is_looking = True
                self._look(self._path)
                self._is_looking = False


@pytest.fixture(autouse=True)
def impatient() -> Iterator[None]:
    """Let readers not wait for a writer, which is in the same thread here and does not go on meanwhile."""
    with patch.object(snapshot, "_PATIENCE_S", 0.0):
        yield


@pytest.mark.parametrize("step", few([3, 23], [23], []))
def test_what_a_reader_sees_survives_a_power_failure(tmp_path: Path, step: int) -> None:
    root = tmp_path / "trial"
    root.mkdir()
    looks = heads = newest = 0
    lost: list[object] = []

    def look(path: Path) -> None:
        nonlocal looks, heads, newest
        looks += 1
        seen = roots_of(path)
        if looks % step and len(seen) == newest:
            return
        heads, newest = heads + 1, len(seen)
        for number, choice in enumerate(choices(looks, 1)):
            after = tmp_path / f"after-{number}"
            watched.disk.after_power_failure(choice, after)
            if not seen.items() <= roots_of(after / "out" / "ledger").items():
                lost.append((len(watched.calls), choice.names, choice.contents))
            shutil.rmtree(after)

    watched = WatchedOs(root / "out" / "ledger", look)
    assert write_with(watched, root / "out" / "ledger").error is None
    assert lost == []
    assert heads > newest > 5


@pytest.mark.parametrize("step", few([3, 31], [], [31]))
def test_what_a_reader_sees_beside_a_disk_that_refuses_stays(tmp_path: Path, calls: list[str], step: int) -> None:
    refused = heads = 0
    lost: list[object] = []
    trials = [(at, kind) for at, name in enumerate(calls) if name in (*WRITES, *SYNCS) for kind in KINDS]
    for at, kind in trials[::step]:
        root = tmp_path / f"{at}-{kind}"
        root.mkdir()
        path, seen = root / "out" / "ledger", Roots()

        def look(path: Path, seen: Roots = seen, trial: object = (at, kind)) -> None:
            now = roots_of(path)
            if not seen.items() <= now.items():
                lost.append((trial, max(seen), max(now)))
            seen |= now

        session = write_with(WatchedOs(path, look, Fault(at, kind), max(0, at - 4)), path)
        if isinstance(session.error, WriteFailed):
            refused += 1
            if (
                "this commit was not made" in str(session.error)
                and max(roots_of(path), default=0) > session.acknowledged
            ):
                lost.append(((at, kind), "refused, and there", str(session.error)))
        look(path)
        assert write_with(FaultyOs(root), path).error is None
        look(path)
        assert verify(path).ok
        heads += len(seen)
        shutil.rmtree(root)
    assert lost == []
    assert refused > len(trials) // step // 2
    assert heads > refused


@pytest.mark.parametrize(("name", "kind"), [("fdatasync", "disk-gone"), ("close", "io-error-after")])
def test_no_commit_that_is_there_is_said_not_to_be_made_where_its_file_cannot_be_closed(
    tmp_path: Path, calls: list[str], name: str, kind: str
) -> None:
    path, synced = tmp_path / "out" / "ledger", calls.index("fdatasync")  # of the first line of the chain
    refused = calls.index(name, synced + (5 if name == "close" else 0))  # the folder is synced and closed between
    session = write_with(FaultyOs(tmp_path, Fault(refused, kind)), path)
    assert max(roots_of(path)) > session.acknowledged
    assert "it is unknown whether the commit is there" in str(session.error)


def hidden_frame(path: Path) -> None:
    """Leave a ledger as a writer does that ended when its newest commit was on disk and not visible yet."""
    with Writer(path, ORIGIN) as writer:
        writer.add([piece(RUN, 0, 10)])
    end, checkpoint = (path / JOURNAL).stat().st_size, (path / "checkpoint").read_bytes()
    with Writer(path, ORIGIN) as writer:
        writer.add([piece(RUN, 10, 25)])
    data = bytearray((path / JOURNAL).read_bytes())
    data[end] = 0
    (path / JOURNAL).write_bytes(data + bytes(1000))
    (path / "checkpoint").write_bytes(checkpoint)


def hidden_append(path: Path) -> None:
    """Leave a ledger as a writer does that ended when its newest segment was on disk and not visible yet."""
    with Writer(path, ORIGIN) as writer:
        writer.append(stage(path, [piece(RUN, 0, 10)]))
        checkpoint = (path / "checkpoint").read_bytes()
        writer.append(stage(path, [piece(RUN, 10, 25)]))
    (path / CHAIN).write_bytes((path / CHAIN).read_bytes()[:-1] + b"\0")
    (path / "checkpoint").write_bytes(checkpoint)


@pytest.mark.parametrize("leave", [hidden_frame, hidden_append])
def test_a_commit_that_was_on_disk_and_not_visible_counts_once_its_writer_is_gone(
    tmp_path: Path, leave: Callable[[Path], None]
) -> None:
    path = tmp_path / "ledger"
    leave(path)
    writer_at_it = disk.FolderLock(path / SEGMENTS)
    with writer_at_it:
        assert open_for_answers(path).head.size == 10
    writer_at_it.close()
    assert open_for_answers(path).head.size == 25
    report = verify(path)
    assert (report.ok, report.events) == (True, 25)
    assert any("makes it visible" in remark for remark in report.remarks)
    assert judged(Case("hidden", path, True)).difference == ""
    with Writer(path, ORIGIN) as writer:
        assert writer.head.size == 25
        writer.add([piece(RUN, 25, 40)])
    assert (verify(path).events, verify(path).remarks) == (40, ())


def test_the_frame_before_a_hidden_one_is_rewritten_with_it(tmp_path: Path) -> None:
    """Its first byte was to be synced with the hidden one, and that sync may have failed."""
    hidden_frame(tmp_path / "ledger")
    journal = open_ledger(tmp_path / "ledger").journal
    assert journal.hidden == (journal.last,)
    assert (journal.last > 0, journal.unsure) == (True, 0)


def test_two_commits_that_are_not_visible_count_where_the_power_failed_between_them(tmp_path: Path) -> None:
    path = tmp_path / "ledger"
    with Writer(path, ORIGIN) as writer:
        ends = []
        for first in (0, 10, 20):
            writer.add([piece(RUN, first, first + 10)])
            ends.append(len((path / JOURNAL).read_bytes().rstrip(b"\0")))
    (path / "checkpoint").unlink()  # it is written when a writer closes
    whole = (path / JOURNAL).read_bytes()
    for torn in (0, 1, 40):
        data = bytearray(whole[: len(whole) - torn] + bytes(torn))
        data[ends[0]] = data[ends[1]] = 0
        (path / JOURNAL).write_bytes(data)
        assert open_for_answers(path).head.size == (20 if torn else 30)
        assert judged(Case("two hidden", path, True)).difference == ""
