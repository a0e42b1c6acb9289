"""Runs of events to one Arrow table and back; the inverse pair is `encode` and `decode`.

Events are taken by type and by column, never row by row: that is what makes it fast.
"""

from collections.abc import Iterator, Sequence
from itertools import chain, pairwise, repeat
from operator import attrgetter, itemgetter

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from fsar_ledger.errors import LedgerCorrupted, UnknownEventTag
from fsar_ledger.events import EVENT_TYPES, Event
from fsar_ledger.ledger import canonical
from fsar_ledger.ledger.check import first_flaw, run_starts
from fsar_ledger.ledger.merkle import HASH_BYTES
from fsar_ledger.ledger.schema import ARROW_TYPES, COLUMNS, ENVELOPE, LAYOUTS, MAX_INTEGER, PAYLOAD, SCHEMA, Layout

__all__ = ["SCHEMA", "RunRecord", "decode", "encode", "encode_hashed"]

_LAYOUTS = tuple(LAYOUTS.values())
_CODES = {cls: code for code, cls in enumerate(EVENT_TYPES)}
_GETTERS = {field.name: attrgetter(field.name) for layout in _LAYOUTS for field in layout.fields}


class RunRecord(msgspec.Struct, frozen=True):
    """One finished run in memory, columns beside structs. The seq of an event is its position."""

    run_id: str
    times_us: Sequence[int]
    caused_by: Sequence[int | None]
    events: Sequence[Event]


class _Rows:
    """The rows of several runs, envelope in order and events sorted by type."""

    def __init__(self, runs: Sequence[RunRecord]):
        sizes = [len(run.events) for run in runs]
        for run, size in zip(runs, sizes, strict=True):
            if not size == len(run.times_us) == len(run.caused_by) or not size:
                found = f"{size} events, {len(run.times_us)} times and {len(run.caused_by)} causes"
                raise ValueError(f"run {run.run_id}: found {found}; expected as many of each, at least 1")
        self.size = sum(sizes)
        self.run_ids = list(chain.from_iterable(repeat(run.run_id, size) for run, size in zip(runs, sizes, strict=True)))
        self.seqs = list(chain.from_iterable(map(range, sizes)))
        self.times_us = list(chain.from_iterable(run.times_us for run in runs))
        self.causes = list(chain.from_iterable(run.caused_by for run in runs))
        events = np.empty(self.size, object)
        events[:] = list(chain.from_iterable(run.events for run in runs))
        self.codes = np.fromiter(map(_CODES.__getitem__, map(type, events)), np.int64, self.size)
        self.order = np.argsort(self.codes, kind="stable")  # position of each row when rows are sorted by type
        counts = np.bincount(self.codes, minlength=len(EVENT_TYPES))
        ends = np.cumsum(counts)
        self.blocks: list[tuple[Layout, slice, dict[str, list[object]]]] = []
        events = events[self.order]
        for code in np.flatnonzero(counts):
            block = slice(int(ends[code] - counts[code]), int(ends[code]))
            bucket = events[block].tolist()
            self.blocks.append((_LAYOUTS[code], block, {field.name: list(map(_GETTERS[field.name], bucket)) for field in _LAYOUTS[code].fields}))

    def table(self) -> pa.Table:
        rank = np.empty(self.size, np.int64)
        rank[self.order] = np.arange(self.size)
        parts: dict[str, list[tuple[slice, pa.Array]]] = {}
        for layout, block, values in self.blocks:
            for field in layout.fields:
                column = pa.array(values[field.name], ARROW_TYPES[field.kind])
                if column.null_count and not field.is_nullable:
                    raise ValueError(f"{layout.tag}: field {field.name} is None, expected a value in every event")
                parts.setdefault(field.name, []).append((block, column))
        envelope = (self.run_ids, self.seqs, self.times_us, self.causes)
        arrays = [pa.array(values, ARROW_TYPES[field.kind]) for values, field in zip(envelope, ENVELOPE, strict=False)]
        arrays.append(pa.array(LAYOUTS, pa.string()).take(pa.array(self.codes)))
        arrays += [self._spread(name, parts.get(name, []), rank) for name in PAYLOAD]
        table = pa.Table.from_arrays(arrays, schema=SCHEMA)
        _require_integers(table)
        self._require_causes(table)
        return table

    def _require_causes(self, table: pa.Table) -> None:
        """Raises: ValueError unless every event but the first of a run was caused by an earlier one."""
        causes = table.column("caused_by").fill_null(-1).to_numpy()
        seqs = table.column("seq").to_numpy()
        is_wrong = np.where(seqs == 0, causes != -1, (causes < 0) | (causes >= seqs))
        if is_wrong.any():
            at = int(np.argmax(is_wrong))
            raise ValueError(f"run {self.run_ids[at]}, seq {seqs[at]}: found caused_by {self.causes[at]}, expected None at seq 0, else an earlier seq")

    def _spread(self, name: str, parts: list[tuple[slice, pa.Array]], rank: np.ndarray[tuple[int], np.dtype[np.int64]]) -> pa.Array:
        """The column in row order, NULL where the event type has no such field."""
        kind = ARROW_TYPES[COLUMNS[name]]
        if not parts:
            return pa.nulls(self.size, kind)
        at = np.full(self.size, -1, np.int32)
        filled = 0
        for block, column in parts:
            at[block] = np.arange(filled, filled + len(column), dtype=np.int32)
            filled += len(column)
        at = at[rank]
        return pa.concat_arrays([column for _, column in parts]).take(pa.array(at, mask=at < 0))

    def leaves(self) -> bytes:
        """The packed RFC 6962 leaf hashes in row order."""
        packed = np.empty((self.size, HASH_BYTES), np.uint8)
        envelope: tuple[Sequence[object], ...] = (self.run_ids, self.seqs, self.times_us, self.causes)
        for layout, block, values in self.blocks:
            at = self.order[block]
            pick = itemgetter(at[0], *at.tolist())  # the first once more, as a getter of one item gives no tuple
            columns: dict[str, Sequence[object]] = {**values}
            columns |= {field.name: pick(rows)[1:] for field, rows in zip(ENVELOPE, envelope, strict=False)}
            columns["type"] = [layout.tag] * len(at)
            hashed = canonical.hashes(canonical.lines(layout.tag, columns))
            packed[at] = np.frombuffer(b"".join(hashed), np.uint8).reshape(-1, HASH_BYTES)
        return packed.tobytes()


def _require_integers(table: pa.Table) -> None:
    """Raises: ValueError for an integer beyond 2^53 - 1, which JSON readers may round, or a missing time."""
    for field in table.schema:
        column = table.column(field.name)
        if column.null_count and not field.nullable:
            raise ValueError(f"column {field.name}: found None, expected a value in every row")
        if field.type == pa.int64():
            span = pc.min_max(column).as_py()
            if span["min"] is not None and not -MAX_INTEGER <= span["min"] <= span["max"] <= MAX_INTEGER:
                raise ValueError(f"column {field.name}: found integers from {span['min']} to {span['max']}, expected at most 2^53 - 1 in size")


def encode(runs: Sequence[RunRecord]) -> pa.Table:
    """The rows of these runs in order (run, seq).

    Raises:
        ValueError: A run has no events, or not as many times and causes as events; an event other than the first
            is not caused by an earlier one; a field that must have a value is None; an integer lies beyond 2^53 - 1.
    """
    return _Rows(runs).table()


def encode_hashed(runs: Sequence[RunRecord]) -> tuple[pa.Table, bytes]:
    """As `encode`, with the packed RFC 6962 leaf hash of each row."""
    rows = _Rows(runs)
    return rows.table(), rows.leaves()


def decode(table: pa.Table) -> Iterator[RunRecord]:
    """Every run of the table, in order; the inverse of `encode`.

    Raises:
        UnknownEventTag: A row has a type that this version does not know.
        LedgerCorrupted: The columns are not those of `SCHEMA`; a row lacks a value that its type must have, has one
            that it cannot have, or a seq that does not follow the one before it.
    """
    flaw = first_flaw(table)
    if flaw is not None:
        raise (UnknownEventTag if flaw.field == "type" else LedgerCorrupted)(f"{flaw}; restore the segment")
    events = _events(table)
    run_ids = table.column("run_id").combine_chunks()
    times_us = table.column("time_us").to_pylist()
    causes = table.column("caused_by").to_pylist()
    for start, end in pairwise([*run_starts(run_ids).tolist(), table.num_rows]):
        yield RunRecord(run_ids[start].as_py(), times_us[start:end], causes[start:end], events[start:end].tolist())


def _events(table: pa.Table) -> "np.ndarray[tuple[int], np.dtype[np.object_]]":
    """The events of all rows, which were checked."""
    events = np.empty(table.num_rows, object)
    tags = table.column("type").combine_chunks().dictionary_encode()
    codes = tags.indices.to_numpy()
    for code, tag in enumerate(tags.dictionary.to_pylist()):
        at = np.flatnonzero(codes == code)
        layout = LAYOUTS[tag]
        columns = []
        for field in layout.fields:
            values = table.column(field.name).take(pa.array(at)).to_pylist()
            columns.append([None if value is None else tuple(value) for value in values] if field.kind == "strings" else values)
        made = list(map(layout.cls, *columns)) if columns else [layout.cls() for _ in at]
        for position, event in zip(at.tolist(), made, strict=True):
            events[position] = event
    return events
