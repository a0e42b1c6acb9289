"""A ledger in the formats of other systems, as `export --as` writes them, and what the formats share.

This module has the folders: the rows as a Delta table (delta.io), and the hashes of the tree as C2SP tlog-tiles.

An event names robots and other principals, tasks, actions and requests, each in its role. Which columns name a
principal follows from the types of the events' fields; the others are listed.
"""

import os
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple, get_args, get_origin, get_type_hints

import msgspec

from fsar_ledger.base import printable, utc
from fsar_ledger.base.errors import LedgerCorrupted, UsageError, WriteFailed, option
from fsar_ledger.base.progress import Progress
from fsar_ledger.events import EVENT_TYPES
from fsar_ledger.events.envelope import Agent, Coordinator, Part, Robot, Service, Supervisor
from fsar_ledger.ledger.log.pack import WIDTH, Edge, Tile, partial_tiles
from fsar_ledger.ledger.rows import canonical
from fsar_ledger.ledger.store import disk
from fsar_ledger.ledger.store.paths import CHECKPOINT, require_outside, segment_name
from fsar_ledger.ledger.store.read import View
from fsar_ledger.ledger.store.shards import log_of, views_of


class ExportedFile(NamedTuple):
    """The number of events in a file, and notes about it, a line each."""

    events: int
    notes: tuple[str, ...]


def elements(documents: Iterable[object]) -> Iterator[bytes]:
    """Yield each document as an element of a JSON array, on a line of its own, without the brackets."""
    separator = b"\n"
    for document in documents:
        yield separator + msgspec.json.encode(document)
        separator = b",\n"


LATEST_YEAR = 9000
"""Leaves room for the longest run, of 2^53 microseconds, before the last year that a date can have."""
TOLD = "times count from 1970-01-01T00:00:00Z in runs whose first event names no epoch"


def epoch_us(run: str, epoch: str | None, earliest: datetime = utc.EPOCH) -> int:
    """Return run time 0 in microseconds since 1970, from the epoch that event 0 of a run names; 0 if it names none.

    Raises: UsageError if that is not a time in ISO 8601 from `earliest` to `LATEST_YEAR`; most formats count from 1970.
    """
    if epoch is None:
        return 0
    try:
        time = utc.parsed(epoch)
        if not earliest <= time <= datetime(LATEST_YEAR, 1, 1, tzinfo=UTC):
            raise ValueError("too early or too late")
    except ValueError as error:
        raise UsageError(
            f"run {printable.value(run)}: found the epoch {printable.value(epoch)}, expected a time in ISO 8601 "
            f"between {earliest.year} and {LATEST_YEAR}; name another run"
        ) from error
    return utc.microseconds(time)


def rfc3339(time_us: int) -> str:
    """Return a time in UTC from its microseconds since 1970."""
    return utc.shown_us(time_us, "microseconds")


PRINCIPALS = ("robot", "supervisor", "service", "agent", "coordinator")
"""The kinds of principals; a name says its kind before the first slash."""
OTHER = "principal"
"""The kind of a principal whose name, recorded by another system, begins with none of these."""

_COLUMNS = {
    "task_id": "task",
    "action_id": "action",
    "failed_action": "action",
    "preempted_by": "action",
    "parent": "action",
    "request_id": "request",
}
"""The kind of what each column names, if that is not a principal."""
_ROLES = {
    "requested_by": "requester",
    "executed_by": "executor",
    "supervised_by": "supervisor",
    "decided_by": "decider",
    "task_id": "task",
    "action_id": "action",
    "request_id": "request",
}
"""The role of what each column names, if that is not the name of the column."""
_PRINCIPAL_TYPES = {Robot, Supervisor, Service, Agent, Coordinator}


class Named(NamedTuple):
    """Something that an event names. `label` begins with the kind and a slash, so no two kinds share one."""

    kind: str
    label: str


def named_in(columns: Mapping[str, Any]) -> dict[Named, str]:
    """Return what the columns of an event name, with its role; several roles of one are joined by `, `."""
    roles: dict[Named, list[str]] = {}
    for column, value in columns.items():
        if column in NAMING and value is not None:
            for name in (value,) if isinstance(value, str) else value:
                roles.setdefault(_named_object(column, name), []).append(NAMING[column])
    return {named: ", ".join(dict.fromkeys(names)) for named, names in roles.items()}


def _named_object(column: str, name: str) -> Named:
    if column in _COLUMNS:
        return Named(_COLUMNS[column], f"{_COLUMNS[column]}/{name}")
    kind = name.partition("/")[0]
    return Named(kind, name) if kind in PRINCIPALS else Named(OTHER, f"{OTHER}/{name}")


def _hints(kind: type) -> Iterator[tuple[str, Any]]:
    """Yield the columns of an event type, or of a part of one, with the types of their values."""
    for name, hint in get_type_hints(kind).items():
        part = get_origin(hint) or hint
        if isinstance(part, type) and issubclass(part, Part):
            yield from _hints(part)
        else:
            yield name, hint


def _is_principal(hint: Any) -> bool:
    return hint in _PRINCIPAL_TYPES or any(map(_is_principal, get_args(hint)))


_PRINCIPAL_COLUMNS = {name for kind in EVENT_TYPES for name, hint in _hints(kind) if _is_principal(hint)}
NAMING: Mapping[str, str] = {
    column: _ROLES.get(column, column.replace("_", " ")) for column in sorted(_PRINCIPAL_COLUMNS | _COLUMNS.keys())
}
"""The role of what each column names, of the columns that name something."""


_DELTA, _TILES, _OUTCOME = "writing a Delta table", "writing tiles", "nothing was left there"


def _require_free(out: Path) -> None:
    """Raise a UsageError if something is at this path, or it lies inside a ledger."""
    if os.path.lexists(out):
        raise UsageError(f"{option('out', out)}: found a file or folder, expected a free path for a new folder")
    require_outside(out, option("out", out))


@contextmanager
def _whole_folder(out: Path, doing: str) -> Iterator[Path]:
    """Yield a new folder, which is moved to this path once complete; else nothing is left. Raises: WriteFailed."""
    work = disk.temporary_name(out)
    try:
        with disk.refusals(out, doing, _OUTCOME):
            work.mkdir(parents=True)
        yield work
        with disk.refusals(out, doing, _OUTCOME):
            os.rename(work, out)
    except BaseException:
        shutil.rmtree(work, ignore_errors=True)
        raise


def write_delta(out: Path, view: View) -> ExportedFile:
    """Write a new folder with the segments of the ledger, one more of the rows of its journal, and `_delta_log`.

    The files of the table are the ledger's own segments, linked and not copied. Its log lies beside its files, and a
    ledger's folder holds only the ledger's files, so the table is a folder of its own. Segments never change, and
    removing a link leaves the other, so neither harms the other.

    Raises:
        UsageError: Something is at `out`, it lies inside a ledger, or the ledger has no events.
        LedgerCorrupted: A segment is not as committed.
        WriteFailed: The folder cannot be written; nothing is left there.
        ImportError: There is no library `deltalake`.
    """
    _require_free(out)
    if not view.head.events:
        raise UsageError(f"{view.path}: found no events, expected some: a Delta table has the columns of its files")
    with _whole_folder(out, _DELTA) as work:
        linked = sum(_put_segment(view, number, work, out) for number in range(len(view.releases)))
        _make_log(work, out, view.head.root)
    placed = sum(len(shard.chain.placed) for shard in views_of(view))
    journal = sum(shard.head.size - shard.chain.placed_size for shard in views_of(view))
    summary = f"{linked:,} segments are hard links into the ledger, {placed - linked:,} are copies"
    return ExportedFile(view.head.events, (summary, f"{journal:,} events of the journal are in a file of their own"))


def _put_segment(view: View, number: int, work: Path, out: Path) -> bool:
    """Put this segment into the folder; return whether it is a link into the ledger. Raises: As `write_delta`."""
    segment = view.segment(number)
    file = work / Path(segment_name(view.first(number), view.end(number))).name
    with disk.refusals(out, _DELTA, _OUTCOME):
        try:
            os.link(segment, file)
        except OSError:  # another file system, or one without links
            shutil.copyfile(segment, file)
            return False
    return any(segment.is_relative_to(shard.path) for shard in views_of(view))


def _make_log(work: Path, out: Path, root: str) -> None:
    """Make the log of the table of these files. Raises: WriteFailed, ImportError."""
    from deltalake import convert_to_deltalake
    from deltalake.exceptions import DeltaError

    try:
        convert_to_deltalake(work, name="events", description=f"The events of the ledger with the root {root}")
    except (DeltaError, OSError) as error:
        raise WriteFailed(
            f"{out}: cannot be written ({error}); nothing was left there: choose another place"
        ) from error


def write_tiles(view: View, out: Path, progress: Progress | None) -> int:
    """Write every tile of the tree, and its checkpoint, into a new folder; return how many.

    The hashes are those of the rows, each of which is read and hashed. `progress` is called with the segments that were
    hashed, and their number.

    Raises:
        UsageError: Something is at `out`, or it lies inside a ledger.
        LedgerCorrupted: The rows do not lead to the recorded root, or a segment is not as committed.
        WriteFailed: The folder cannot be written; nothing is left there.
    """
    _require_free(out)
    view = log_of(view)
    with _whole_folder(out, _TILES) as work:
        count, edge = 0, Edge()
        for done, table in enumerate(view.tables(), start=1):
            edge, tiles = edge.extend(canonical.leaves(table))
            count += _write_files(work, out, {tile: data for tile, data in tiles.items() if tile.width == WIDTH})
            if progress is not None:
                progress(done, len(view.releases))
        if edge.frontier().root().hex() != view.head.root:
            raise LedgerCorrupted(
                f"{view.path}: found rows that lead to root {edge.frontier().root().hex()}, expected "
                f"{view.head.root} as committed; run fsar-ledger verify"
            )
        count += _write_files(work, out, {tile: edge.partial[tile.level] for tile in partial_tiles(edge.size)})
        if (note := view.note()) is not None:
            with disk.refusals(out, _TILES, _OUTCOME):
                (work / CHECKPOINT).write_bytes(str(note).encode())
    return count


def _write_files(work: Path, out: Path, tiles: dict[Tile, bytes]) -> int:
    """Write these tiles. Raises: WriteFailed."""
    with disk.refusals(out, _TILES, _OUTCOME):
        for tile, data in tiles.items():
            file = work / tile.name
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(data)
    return len(tiles)
