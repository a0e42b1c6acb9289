"""Open a ledger to answer from it, after the checks of `verify --quick`.

The records, their chain and notes, and the file `checkpoint` are compared here; the bytes of a segment when it is
handed out (`View.segment`). Stray files are left to `verify`, because no answer reads a file that no record names.
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
"""Waits a moment; what it raises ends the waiting."""


def open_ledger(path: Path) -> View:
    """Open the ledger at this path: check its records against each other, without reading any events of segments.

    Raises:
        NotALedger: There is no ledger.
        FormatVersionMismatch: It was written in another format, or holds events of a later release.
        LedgerCorrupted: A record is missing, is not canonical, or contradicts the one before it.
    """
    return open_chain(path, read_manifest(path))


def open_for_answers(path: Path) -> View:
    """Open the ledger at this path as `open_checked` does; where it is the log of a federation, the federation.

    Raises:
        NotALedger, FormatVersionMismatch, LedgerCorrupted, UsageError: As `open_checked`, and as `_federation`.
    """
    view = open_checked(path)
    return _federation(view) if shards.is_log(view) else view


def open_checked(path: Path) -> View:
    """Open the ledger at this path, and compare its checkpoint with its newest commits.

    An older note is accepted where a crash may leave it: that of any commit since which the journal holds all. If they
    do not fit, both are read once more while any writer waits.

    Raises:
        NotALedger, FormatVersionMismatch, LedgerCorrupted: As `open_ledger`; LedgerCorrupted also for any other
            checkpoint, or none.
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
    """Yield the ledger as it is, then, with `pause`, each time it has grown; and the first event not yet yielded.

    Between two looks only the state of a few files is read.

    Raises:
        UsageError: It is a federation, and is to be watched as it grows.
        NotALedger, FormatVersionMismatch, LedgerCorrupted: As `open_for_answers` and `_require_same`.
    """
    state = _state(ledger)
    view = open_for_answers(ledger)
    if pause is not None and isinstance(view, shards.Federation):
        raise UsageError(f"{ledger}: found a federation, expected one ledger to follow; follow each of its shards")
    yield view, 0
    while pause is not None:
        pause()
        # A file system may give two changes in a row one time.
        if (found := _state(ledger)) == state and view.is_current():
            continue
        state, grown = found, open_for_answers(ledger)
        _require_same(view, grown)
        if grown.head.size > view.head.size:
            yield grown, view.head.size
        view = grown


def _state(ledger: Path) -> tuple[tuple[int, int, int] | None, ...]:
    """Return what changes when the ledger grows or is replaced; None for a file that is not there."""
    found: list[tuple[int, int, int] | None] = []
    for name in (MANIFEST, CHAIN, JOURNAL, CHECKPOINT):
        try:
            status = (ledger / name).stat()
        except OSError:
            found.append(None)
        else:
            found.append((status.st_ino, status.st_size, status.st_mtime_ns))
    return tuple(found)


def _require_same(view: View, grown: View) -> None:
    """Require that the ledger still begins with the commits that it had. Raises: LedgerCorrupted."""
    count = len(view.commits)
    if grown.manifest_sha256 != view.manifest_sha256 or grown.commits[count - 1 : count] != view.commits[-1:]:
        raise LedgerCorrupted(
            f"{view.path}: found another ledger of {len(grown.commits):,} commits, expected the one of {count:,} whose "
            "lines were told, or more of it; it was replaced; run fsar-ledger verify"
        )


def _federation(log: View) -> shards.Federation:
    """Return the federation of this log, with each shard at its recorded head.

    Raises:
        LedgerCorrupted: A shard is not as recorded, or the log contradicts itself.
        UsageError: A shard has grown since.
    """
    heads = shards.heads_of(log)
    for problem in shards.doubts(heads):
        raise _refusal(log, problem)
    found = []
    for head in shards.newest(heads):
        place = head.place(log.path)
        try:
            view = open_checked(place)
        except NotALedger as error:
            raise _refusal(log, shards.unreadable(head, place, error)) from error
        if (doubt := shards.doubt_of(head, view, heads)) is not None:
            raise _refusal(log, doubt)
        if view.head.size > head.shard_events:
            raise UsageError(
                f"{place}: found {view.head.size:,} events, expected the {head.shard_events:,} of {head} that the log "
                f"{log.path} has; it has grown: run fsar-ledger shards {printable.word(log.path)}, which records it"
            )
        found.append(shards.Shard(head, view))
    if (doubt := shards.twice({one.head.origin: one.view for one in found})) is not None:
        raise _refusal(log, doubt)
    return shards.joined(log, found)


def _refusal(log: View, problem: Problem) -> LedgerCorrupted:
    return LedgerCorrupted(f"{log.path}: {problem}; run fsar-ledger verify {printable.word(log.path)}, which names all")


def folders_of(ledger: Path) -> list[Path]:
    """Return where the shards of a federation are; nothing of any other ledger, or of one that cannot be read."""
    with suppress(FsarLedgerError, OSError):
        index = growing.read_at(ledger / INDEX, 0, 1 << 12)
        if index and not shards.names_head(index):
            return []  # to open it would take long where there are many commits
        log = open_ledger(ledger)
        return [head.place(ledger) for head in shards.newest(shards.heads_of(log))] if shards.is_log(log) else []
    return []


class Present(NamedTuple):
    """Heads to record, and the shards that can be read, by origin."""

    heads: list[shards.ShardHead]
    views: dict[str, View]


def present(log: Path, heads: Sequence[shards.ShardHead], places: Sequence[Path]) -> Present:
    """Return the present heads of the ledgers in these folders, those that the log in that folder lacks.

    `heads` are all that it has. Shards that are not among these ledgers are read, too, if they can be.

    Raises:
        UsageError: Two ledgers are one shard, hold one run, or one is a federation itself.
        LedgerCorrupted: A ledger does not go on from its recorded head.
        NotALedger, FormatVersionMismatch, LedgerCorrupted: As `open_checked`.
    """
    known = {head.origin: head for head in heads}
    views, found, given = dict[str, View](), list[shards.ShardHead](), {_real(place) for place in places}
    for head in known.values():
        with suppress(FsarLedgerError):
            other = None if _real(head.place(log)) in given else open_checked(head.place(log))
            if other is not None and other.manifest.origin == head.origin:
                views[head.origin] = other
    for place in places:
        view = open_checked(place)
        if shards.is_log(view):
            raise UsageError(f"{place}: found the log of other ledgers, {shards.NESTED}; record those ledgers")
        origin, real = view.manifest.origin, _real(place)
        if (other := views.get(origin)) is not None and _real(other.path) != real:
            raise UsageError(
                f"{place}: {shards.TWICE}: found a ledger of origin {printable.value(origin)}, which {other.path} has, "
                "too, expected an origin for each shard; make it under a name of its own (--origin), or record one"
            )
        before = next((one for one in known.values() if _real(one.place(log)) == real), known.get(origin))
        if before is not None and (problem := shards.doubt_of(before, view, heads)) is not None:
            raise LedgerCorrupted(f"{problem}; nothing was recorded")
        folder = os.path.relpath(real, os.path.realpath(log))
        head = shards.ShardHead(origin, folder, view.head.size, view.head.root, len(heads) + len(found))
        if before is None or msgspec.structs.replace(head, index=before.index) != before:
            found += [] if origin in views else [head]
        views[origin] = view
    if (problem := shards.twice(views)) is not None:
        raise UsageError(f"{problem}; nothing was recorded")
    return Present(found, {origin: views[origin] for origin in (*known, *views) if origin in views})


def _real(place: Path) -> str:
    return os.path.realpath(place)
