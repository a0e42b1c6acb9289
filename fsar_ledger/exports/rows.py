"""Rows as messages of an MCAP file (mcap.dev), for Foxglove and other programs that show recordings of robots.

The channel `/fsar/events` has every row as it is stored; one for each principal, as `/fsar/robot/A1`, has a log message
for each event that names it. All messages are JSON. Times are nanoseconds.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import pyarrow as pa

from fsar_ledger.ledger.rows import canonical
from fsar_ledger.ledger.rows.schema import COLUMNS, ENVELOPE
from fsar_ledger.ledger.store.locations import counted_rows
from fsar_ledger.ledger.store.read import View

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


def write(out: Path, view: View, tables: Iterable[pa.Table]) -> ExportedFile:
    """Write the rows of these tables of a ledger to this path, then its checkpoint and metadata.

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
