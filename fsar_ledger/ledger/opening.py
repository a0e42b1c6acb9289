"""Open a ledger for queries, after the checks of `verify --quick`.

The records, their chain and notes, and the file `checkpoint` are compared here; the bytes of a segment when it is
handed out (`View.segment`). Stray files are left to `verify`, because no query reads a file that no record names.
So are the derived hashes, except those of a proof, which is checked against the root, and of the index, whose lines are
compared with their records.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import msgspec

from fsar_ledger.base import printable
from fsar_ledger.base.errors import FsarLedgerError, LedgerCorrupted, NotALedger, UsageError
from fsar_ledger.ledger.store import disk, growing, shards
from fsar_ledger.ledger.store.manifest import read_manifest
from fsar_ledger.ledger.store.paths import CHAIN, CHECKPOINT, INDEX, JOURNAL, MANIFEST, SEGMENTS
from fsar_ledger.ledger.store.problem import Problem
from fsar_ledger.ledger.store.read import View, open_chain
from fsar_ledger.ledger.store.snapshot import check_chain_checkpoint

Pause = Callable[[], None]
"""Sleeps briefly; an exception it raises ends the polling."""


def open_ledger(path: Path) -> View:
    """Open the ledger at this path: check its records against each other, without reading any events of segments.

    Raises:
        NotALedger: The path is not a ledger.
        FormatVersionMismatch: It was written in another format, or holds events of a later release.
        LedgerCorrupted: A record is missing, is not canonical, or contradicts the one before it.
    """
    return open_chain(path, read_manifest(path))


def open_for_answers(path: Path) -> View:
    """Open the ledger at this path as `open_checked` does; if it is the log of a federation, return the federation.

    Raises:
        NotALedger, FormatVersionMismatch, LedgerCorrupted, UsageError: As `open_checked` and `_federation`.
    """
    view = open_checked(path)
    return _federation(view) if shards.is_log(view) else view


def open_checked(path: Path) -> View:
    """Open the ledger at this path, and compare its checkpoint with its newest commits.

    An older note is accepted where a crash may leave one: that of any commit after which all commits are in the
    journal. On a mismatch both are read once more under a lock that keeps writers out.

    Raises:
        NotALedger, FormatVersionMismatch, LedgerCorrupted: As `open_ledger`; LedgerCorrupted also if the checkpoint is
            any other, or missing.
    """
    view = open_ledger(path)
    problems = check_chain_checkpoint(view)
    if problems:
        with disk.shared_lock(path / SEGMENTS):
            view = open_ledger(path)
            problems = check_chain_checkpoint(view)
    for problem in problems:
        raise LedgerCorrupted(
            f"{path}/{problem}: commits were removed, or the file was altered; run fsar-ledger verify, and "
            "fsar-ledger maintain recover if it says so"
        )
    return view


def growth(ledger: Path, pause: Pause | None) -> Iterator[tuple[View, int]]:
    """Yield the ledger and the first event not yet yielded; with `pause`, again each time the ledger has grown.

    Between yields only the status of a few files is read.

    Raises:
        UsageError: It is a federation, and `pause` is given.
        NotALedger, FormatVersionMismatch, LedgerCorrupted: As `open_for_answers` and `_require_same`.
    """
    state = _state(ledger)
    view = open_for_answers(ledger)
    if pause is not None and isinstance(view, shards.Federation):
        raise UsageError(f"{ledger}: found a federation, expected one ledger to follow; follow each of its shards")
    yield view, 0
    while pause is not None:
        pause()
        # A file system may give two consecutive changes the same timestamp.
        if (latest := _state(ledger)) == state and view.is_current():
            continue
        state, grown = latest, open_for_answers(ledger)
        _require_same(view, grown)
        if grown.head.size > view.head.size:
            yield grown, view.head.size
        view = grown


def _state(ledger: Path) -> tuple[tuple[int, int, int] | None, ...]:
    """Return the inode, size and mtime of each file that growth or replacement changes; None for a missing file."""
    stamps: list[tuple[int, int, int] | None] = []
    for name in (MANIFEST, CHAIN, JOURNAL, CHECKPOINT):
        try:
            status = (ledger / name).stat()
        except OSError:
            stamps.append(None)
        else:
            stamps.append((status.st_ino, status.st_size, status.st_mtime_ns))
    return tuple(stamps)


def _require_same(view: View, grown: View) -> None:
    """Require that the grown ledger still begins with the commits of `view`. Raises: LedgerCorrupted."""
    count = len(view.commits)
    if grown.manifest_sha256 != view.manifest_sha256 or grown.commits[count - 1 : count] != view.commits[-1:]:
        raise LedgerCorrupted(
            f"{view.path}: found another ledger of {len(grown.commits):,} commits, expected the one of {count:,} that "
            "was followed, or a longer one; it was replaced; run fsar-ledger verify"
        )


def _federation(log: View) -> shards.Federation:
    """Return the federation of this log, with each shard at its recorded head.

    Raises:
        LedgerCorrupted: A shard is not as recorded, or the log contradicts itself.
        UsageError: A shard has grown since it was recorded.
    """
    heads = shards.heads_of(log)
    for problem in shards.doubts(heads):
        raise _refusal(log, problem)
    found_shards = []
    for head in shards.newest(heads):
        folder = head.place(log.path)
        try:
            view = open_checked(folder)
        except NotALedger as error:
            raise _refusal(log, shards.unreadable(head, folder, error)) from error
        if (doubt := shards.doubt_of(head, view, heads)) is not None:
            raise _refusal(log, doubt)
        if view.head.size > head.shard_events:
            raise UsageError(
                f"{folder}: found {view.head.size:,} events, expected the {head.shard_events:,} of {head} recorded in "
                f"the log {log.path}; it has grown: run fsar-ledger shards {printable.word(log.path)} to record it"
            )
        found_shards.append(shards.Shard(head, view))
    if (doubt := shards.twice({shard.head.origin: shard.view for shard in found_shards})) is not None:
        raise _refusal(log, doubt)
    return shards.joined(log, found_shards)


def _refusal(log: View, problem: Problem) -> LedgerCorrupted:
    return LedgerCorrupted(f"{log.path}: {problem}; run fsar-ledger verify {printable.word(log.path)}, which names all")


def folders_of(ledger: Path) -> list[Path]:
    """Return the folders of a federation's shards; none for any other ledger, or one that cannot be read."""
    with suppress(FsarLedgerError, OSError):
        index = growing.read_at(ledger / INDEX, 0, 1 << 12)
        if index and not shards.names_head(index):
            return []  # opening it would be slow if there are many commits
        log = open_ledger(ledger)
        return [head.place(ledger) for head in shards.newest(shards.heads_of(log))] if shards.is_log(log) else []
    return []


class Present(NamedTuple):
    """The heads to record, and the shards that can be read, by origin."""

    heads: list[shards.ShardHead]
    views: dict[str, View]


def present(log: Path, heads: Sequence[shards.ShardHead], places: Sequence[Path]) -> Present:
    """Return those present heads of the ledgers in folders `places` that the log in folder `log` lacks.

    `heads` are all that the log has. Its other shards are read, too, if they can be.

    Raises:
        UsageError: Two ledgers are one shard or hold the same run, or one is itself a federation.
        LedgerCorrupted: A ledger does not continue from its recorded head.
        NotALedger, FormatVersionMismatch, LedgerCorrupted: As `open_checked`.
    """
    recorded = {head.origin: head for head in heads}
    at_place = {_real(head.place(log)): head for head in reversed(recorded.values())}
    views, missing, given_folders = dict[str, View](), list[shards.ShardHead](), {_real(folder) for folder in places}
    for head in recorded.values():
        with suppress(FsarLedgerError):
            other = None if _real(head.place(log)) in given_folders else open_checked(head.place(log))
            if other is not None and other.manifest.origin == head.origin:
                views[head.origin] = other
    for folder in places:
        try:
            view = open_checked(folder)
        except NotALedger as error:
            if (lost := at_place.get(_real(folder))) is None:
                raise
            raise LedgerCorrupted(f"{shards.unreadable(lost, folder, error)}; nothing was recorded") from error
        if shards.is_log(view):
            raise UsageError(f"{folder}: found the log of other ledgers, {shards.NESTED}; record those ledgers")
        origin, real = view.manifest.origin, _real(folder)
        if (other := views.get(origin)) is not None and _real(other.path) != real:
            raise UsageError(
                f"{folder}: {shards.TWICE}: found a ledger of origin {printable.value(origin)}, which {other.path} "
                "also has, expected an origin for each shard; make it under a name of its own (--origin), or record one"
            )
        recorded_head = at_place.get(real, recorded.get(origin))
        if recorded_head is not None and (problem := shards.doubt_of(recorded_head, view, heads)) is not None:
            raise LedgerCorrupted(f"{problem}; nothing was recorded")
        relative = os.path.relpath(real, os.path.realpath(log))
        head = shards.ShardHead(origin, relative, view.head.size, view.head.root, len(heads) + len(missing))
        if recorded_head is None or msgspec.structs.replace(head, index=recorded_head.index) != recorded_head:
            missing += [] if origin in views else [head]
        views[origin] = view
    if (problem := shards.twice(views)) is not None:
        raise UsageError(f"{problem}; nothing was recorded")
    return Present(missing, {origin: views[origin] for origin in (*recorded, *views) if origin in views})


def _real(folder: Path) -> str:
    return os.path.realpath(folder)
