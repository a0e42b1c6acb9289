"""Rows as a Delta table (delta.io) or an MCAP file (mcap.dev), and the hashes of their tree as C2SP tlog-tiles.

An MCAP file is for Foxglove and other programs that show recordings of robots. Its channel `/fsar/events` has every row
as it is stored; one for each principal, as `/fsar/robot/A1`, has a log message for each event that names it. All
messages are JSON. Times are nanoseconds.
"""

import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import pyarrow as pa

from fsar_ledger.base.errors import LedgerCorrupted, UsageError, WriteFailed, option
from fsar_ledger.base.progress import Progress
from fsar_ledger.ledger.log.pack import WIDTH, Edge, Tile, partial_tiles
from fsar_ledger.ledger.rows import canonical
from fsar_ledger.ledger.rows.schema import COLUMNS, ENVELOPE
from fsar_ledger.ledger.store import disk
from fsar_ledger.ledger.store.locations import counted_rows
from fsar_ledger.ledger.store.paths import CHECKPOINT, require_outside, segment_name
from fsar_ledger.ledger.store.read import View
from fsar_ledger.ledger.store.shards import log_of, views_of

from . import OTHER, PRINCIPALS, TOLD, ExportedFile, epoch_us, named_in

if TYPE_CHECKING:
    from mcap.writer import Writer

EVENTS = "/fsar/events"
INFO, WARNING = 2, 3
"""Levels of a log message, as `foxglove.Log` numbers them."""
WARNED = ("Abandoned", "Declined", "Denied", "Failed", "Rejected", "Unanswered", "Undelivered", "Voided", "Withdrawn")
"""The endings of the names of types whose messages are warnings."""
_TIME = {"type": "object", "title": "time", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}
LOG = {
    "title": "foxglove.Log",
    "type": "object",
    "properties": {
        "timestamp": _TIME,
        "level": {"type": "integer", "enum": [0, 1, 2, 3, 4, 5]},
        "message": {"type": "string"},
        "name": {"type": "string"},
        "file": {"type": "string"},
        "line": {"type": "integer", "minimum": 0},
    },
}
"""A log message: `name` is the principal, `file` the run, and `line` the number of the event in it."""
_KINDS: dict[str, dict[str, Any]] = {
    "strings": {"type": "array", "items": {"type": "string"}},
    **{kind: {"type": kind} for kind in ("string", "integer", "boolean")},
}
_ENVELOPE = {field.name for field in ENVELOPE}


def write_mcap(out: Path, view: View, tables: Iterable[pa.Table]) -> ExportedFile:
    """Write the rows of these tables of a ledger to this MCAP file, then its checkpoint and metadata.

    Memory holds one table. Raises: OSError, UsageError as `epoch_us`, ImportError without the library `mcap`.
    """
    from mcap.writer import Writer

    with out.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="", library="fsar-ledger")
        messages = _Messages(writer)
        for table in tables:
            positions = counted_rows(view, table.select(["run_id", "seq"])).to_pylist()
            for line, position in zip(canonical.from_table(table.combine_chunks()), positions, strict=True):
                messages.add(line, position["run_id"], position["seq"])
        note = view.note()
        if note is not None:
            writer.add_attachment(0, 0, "checkpoint", "text/plain", str(note).encode())
        about = {"root": view.head.root, "size": f"{view.head.size}", "origin": view.manifest.origin}
        runs = msgspec.json.encode([run for run in view.run_names.runs if run in messages.epochs_us]).decode()
        writer.add_metadata("fsar_ledger", {**about, "runs": runs})
        writer.finish()
    summary = f"{messages.logs:,} log messages in {len(messages.channels):,} channels of principals"
    return ExportedFile(messages.events, (f"{summary}; {messages.unnamed:,} events name none", TOLD))


class _Messages:
    """The channels written so far, with the counts of events and messages, and run time 0 of each run by name."""

    def __init__(self, writer: "Writer") -> None:
        self.channels: dict[str, int] = {}
        self.epochs_us: dict[str, int] = {}
        self.events = self.logs = self.unnamed = 0
        self._writer = writer
        columns = {name: _KINDS[kind] for name, kind in COLUMNS.items()}
        row = self._schema("fsar.Event", {"title": "fsar.Event", "type": "object", "properties": columns})
        self._log = self._schema("foxglove.Log", LOG)
        self._rows = writer.register_channel(EVENTS, "json", row)

    def _schema(self, name: str, schema: dict[str, Any]) -> int:
        number: int = self._writer.register_schema(name, "jsonschema", msgspec.json.encode(schema))
        return number

    def add(self, line: bytes, whole: str, seq: int) -> None:
        """Write the messages of one event, given as the canonical bytes of its row: event `seq` of the run `whole`."""
        row: dict[str, Any] = msgspec.json.decode(line)
        run = row["run_id"]
        if run not in self.epochs_us:
            self.epochs_us[run] = epoch_us(run, row.get("epoch"))
        time_ns = (self.epochs_us[run] + row["time_us"]) * 1_000
        self._writer.add_message(self._rows, time_ns, line, time_ns, row["seq"])
        self.events += 1
        fields = {name: value for name, value in row.items() if name not in _ENVELOPE}
        kind = row["type"].partition(".")[0]
        message = {
            "timestamp": {"sec": time_ns // 10**9, "nsec": time_ns % 10**9},
            "level": WARNING if kind.endswith(WARNED) else INFO,
            "message": " ".join([kind, *(f"{name}={_text(value)}" for name, value in fields.items())]),
            "file": whole,
            "line": seq,
        }
        names = [named.label for named in named_in(fields) if named.kind in (*PRINCIPALS, OTHER)]
        self.unnamed += not names
        self.logs += len(names)
        for name in names:
            data = msgspec.json.encode({**message, "name": name})
            self._writer.add_message(self._channel(name), time_ns, data, time_ns, seq)

    def _channel(self, name: str) -> int:
        if name not in self.channels:
            self.channels[name] = self._writer.register_channel(f"/fsar/{name}", "json", self._log)
        return self.channels[name]


def _text(value: Any) -> str:
    return value if isinstance(value, str) else msgspec.json.encode(value).decode()


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
