"""Encode runs of events as one Arrow table (`encode`), and decode them (`decode`).

Only current types are encoded; decoded events of retired types are upcast, so no other code sees them. Events are
processed by type and column, never row by row, which is fast.
"""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import chain, pairwise
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from fsar_ledger.base.errors import InvalidRun, LedgerCorrupted, UnknownEventTag
from fsar_ledger.events import EVENT_TYPES
from fsar_ledger.events.retired import UPCASTS
from fsar_ledger.ledger.log import hashing
from fsar_ledger.ledger.log.hashing import HASH_BYTES
from fsar_ledger.ledger.rows import canonical
from fsar_ledger.ledger.rows.check import first_flaw, run_starts
from fsar_ledger.ledger.rows.compiled import plain_rows, plain_table
from fsar_ledger.ledger.rows.runs import ALLOWED, CAUSE, TIME, are_allowed, first_unfit, refusal, require_runs
from fsar_ledger.ledger.rows.runs import LedgerRun as LedgerRun
from fsar_ledger.ledger.rows.schema import (
    ARROW_TYPES,
    CODED_SCHEMA,
    COLUMNS,
    ENVELOPE,
    LAYOUTS,
    MAX_INTEGER,
    PAYLOAD,
    STORED,
    StoredType,
)
from fsar_ledger.ledger.rows.schema import SCHEMA as SCHEMA

from . import Codes, Positions, Texts, Values, array_of, bits, require_exact

_LAYOUTS = tuple(LAYOUTS.values())
_CODES = {cls: code for code, cls in enumerate(EVENT_TYPES)}
_TAGS = tuple(LAYOUTS)
_PLACE = frozenset(field.name for field in ENVELOPE if field.name != "type")  # the same in every version of a type


class _Part(NamedTuple):
    """The values of one event type for one column, and their rows."""

    at: Positions
    values: Sequence[object]


class _Rows:
    """The rows of several runs: the envelope in row order, events sorted by type.

    Raises: InvalidRun, or another error for a value that `first_unfit` identifies.
    """

    def __init__(self, runs: Sequence[LedgerRun]):
        require_runs(runs)
        self.sizes = [len(run.events) for run in runs]
        self.size = sum(self.sizes)
        self.runs = [run.run_id for run in runs]
        self.times_us = list(chain.from_iterable(run.times_us for run in runs))
        self.causes = list(chain.from_iterable(run.caused_by for run in runs))
        if not are_allowed(self.times_us, TIME) or not are_allowed(self.causes, CAUSE):
            raise ValueError("found times or causes that are no integers, expected integers")
        self.seqs = np.concatenate(
            [np.empty(0, np.int64), *(np.arange(run.first, run.first + len(run.events)) for run in runs)]
        )
        events = list(chain.from_iterable(run.events for run in runs))
        self.codes = np.fromiter(map(_CODES.__getitem__, map(type, events)), np.uint16, self.size)
        self.order = np.argsort(self.codes, kind="stable")  # position of each row when rows are sorted by type
        events = list(map(events.__getitem__, self.order.tolist()))
        self.blocks: list[tuple[StoredType, slice, tuple[Sequence[object], ...]]] = []
        start = 0
        for layout, rows in zip(_LAYOUTS, np.bincount(self.codes, minlength=len(_LAYOUTS)).tolist(), strict=True):
            if rows:
                block = slice(start, start + rows)
                columns = layout.columns(events[block])
                if not all(map(are_allowed, columns, ALLOWED[layout.tag])):
                    raise ValueError(
                        f"found values in events {layout.tag} that no row can hold, expected those of its fields"
                    )
                self.blocks.append((layout, block, columns))
                start += rows

    def table(self) -> pa.Table:
        """Return the rows with the columns of `CODED_SCHEMA`."""
        parts: defaultdict[str, list[_Part]] = defaultdict(list)
        for layout, block, columns in self.blocks:
            positions = self.order[block]
            for field, values in zip(layout.fields, columns, strict=True):
                parts[field.name].append(_Part(positions, values))
        present = [name for name in PAYLOAD if name in parts]  # a few events lack most columns
        arrays = {name: pa.nulls(self.size, CODED_SCHEMA.field(name).type) for name in PAYLOAD if name not in parts}
        arrays |= self._strings({name: parts[name] for name in present if COLUMNS[name] == "string"})
        arrays |= {name: self._lists(parts[name]) for name in present if COLUMNS[name] == "strings"}
        arrays |= {
            name: self._numbers(name, parts[name]) for name in present if COLUMNS[name] in ("integer", "boolean")
        }
        arrays |= self._integers()
        return pa.Table.from_arrays([arrays[name] for name in COLUMNS], schema=CODED_SCHEMA)

    def _integers(self) -> dict[str, pa.Array]:
        """Return the integer columns of the envelope.

        Raises: ValueError unless the cause of every event is an earlier one or None.
        """
        times_us, causes = pa.array(self.times_us, pa.int64()), pa.array(self.causes, pa.int64())
        numbers = causes.fill_null(-1).to_numpy()
        require_exact("time_us", times_us.to_numpy())
        if (np.asarray(causes.is_valid()) & ((numbers < 0) | (numbers >= self.seqs))).any():
            raise ValueError("found causes that are no earlier events, expected an earlier seq, or None")
        return {"seq": pa.array(self.seqs), "time_us": times_us, "caused_by": causes}

    def _strings(self, columns: dict[str, list[_Part]]) -> dict[str, pa.DictionaryArray]:
        """Return the string columns, including those of the envelope, each with a sorted dictionary of its values."""
        texts = Texts()
        all_rows: Positions = np.arange(self.size)
        coded = {"run_id": (all_rows, np.repeat(texts.codes(self.runs, len(self.runs)), self.sizes))}
        coded["type"] = (all_rows, texts.codes(_TAGS, len(_TAGS))[self.codes])
        for name, parts in columns.items():
            positions = _positions(parts)
            coded[name] = (positions, texts.codes(chain.from_iterable(part.values for part in parts), len(positions)))
        dictionary, ranks = texts.sorted()
        return {name: self._coded(positions, ranks[codes], dictionary) for name, (positions, codes) in coded.items()}

    def _coded(self, positions: Positions, ranks: Codes, dictionary: Values) -> pa.DictionaryArray:
        """Return a string column, given as indexes into the dictionary of all columns; index 0 is NULL."""
        is_used = np.zeros(len(dictionary), bool)
        is_used[ranks] = True
        is_used[0] = False
        codes = np.cumsum(is_used, dtype=np.int32) - 1  # -1 at index 0, which is never used
        indices = np.full(self.size, -1, np.int32)
        indices[positions] = codes[ranks]
        used = pa.array(dictionary[is_used], pa.string())
        # Unchecked: each code is less than the number of used strings.
        return pa.DictionaryArray.from_arrays(array_of(indices, indices >= 0), used, safe=False)

    def _numbers(self, name: str, parts: list[_Part]) -> pa.Array:
        """Return a column of integers or booleans, NULL if the event type has no such field."""
        positions, column = _joined(parts, ARROW_TYPES[COLUMNS[name]])
        values, is_valid = np.zeros(self.size, column.type.to_pandas_dtype()), np.zeros(self.size, bool)
        is_valid[positions] = column.is_valid() if column.null_count else True
        values[positions] = (column.fill_null(values.dtype.type(0)) if column.null_count else column).to_numpy(
            zero_copy_only=False
        )
        if COLUMNS[name] == "integer":
            require_exact(name, values)
        return array_of(values, is_valid)

    def _lists(self, parts: list[_Part]) -> pa.Array:
        """Return a column of lists of strings, NULL if the event type has no such field."""
        values = list(chain.from_iterable(part.values for part in parts))
        positions = _positions(parts)
        order = np.argsort(positions, kind="stable")
        positions, column = (
            positions[order],
            pa.array(list(map(values.__getitem__, order.tolist())), ARROW_TYPES["strings"]),
        )
        ends, is_valid = np.zeros(self.size + 1, np.int32), np.zeros(self.size, bool)
        ends[positions + 1] = np.diff(column.offsets.to_numpy())
        is_valid[positions] = column.is_valid() if column.null_count else True
        np.cumsum(ends, out=ends)
        return pa.Array.from_buffers(
            column.type, self.size, [bits(is_valid), pa.py_buffer(ends)], children=[column.flatten()]
        )

    def lines(self) -> list[bytes]:
        """Return the canonical bytes of the rows, in row order.

        Raises: ValueError for an integer beyond 2^53 - 1, or a cause that is not an earlier event.
        """
        self._require_exact()
        lines: list[bytes] = [b""] * self.size
        rows = b"".join(self._lines()).split(b"\n")
        for index, row in zip(self.order.tolist(), rows, strict=False):
            lines[index] = row
        return lines

    def _require_exact(self) -> None:
        """Check causes and integers as `table` does, fast for a few rows.

        Raises: ValueError for an integer beyond 2^53 - 1, or a cause that is not an earlier event.
        """
        for seq, cause in zip(self.seqs.tolist(), self.causes, strict=True):
            if cause is not None and not -1 < cause < seq:
                raise ValueError("found causes that are no earlier events, expected an earlier seq, or None")
        integers = [self.times_us]
        for layout, _, values in self.blocks:
            pairs = zip(layout.fields, values, strict=True)
            columns = (column for field, column in pairs if field.kind == "integer")
            integers += [[value for value in column if type(value) is int] for column in columns]
        for numbers in filter(None, integers):
            if min(numbers) < -MAX_INTEGER or max(numbers) > MAX_INTEGER:
                raise ValueError("found integers beyond 2^53 - 1 in size, expected none")

    def leaves(self) -> bytes:
        """Return the packed RFC 6962 leaf hashes in row order."""
        packed = np.empty((self.size, HASH_BYTES), np.uint8)
        hashed = map(hashing.leaves, self._lines())
        packed[self.order] = np.frombuffer(b"".join(hashed), np.uint8).reshape(-1, HASH_BYTES)
        return packed.tobytes()

    def _lines(self) -> Iterator[bytes]:
        """Yield the canonical bytes of the rows sorted by type, a few at a time, each followed by a line feed."""
        order = self.order.tolist()
        times_us, causes = (list(map(rows.__getitem__, order)) for rows in (self.times_us, self.causes))
        run_ids = list(
            map(self.runs.__getitem__, np.repeat(np.arange(len(self.runs)), self.sizes)[self.order].tolist())
        )
        seqs = self.seqs[self.order].tolist()
        for layout, block, values in self.blocks:
            columns = {field.name: column for field, column in zip(layout.fields, values, strict=True)}
            columns |= {
                "run_id": run_ids[block],
                "seq": seqs[block],
                "time_us": times_us[block],
                "caused_by": causes[block],
            }
            columns["type"] = [layout.tag] * (block.stop - block.start)
            yield from canonical.lines(layout.tag, columns)


def _positions(parts: list[_Part]) -> Positions:
    """Return the rows of all parts, concatenated."""
    return np.concatenate([part.at for part in parts]) if parts else np.empty(0, np.int64)


def _joined(parts: list[_Part], kind: pa.DataType) -> tuple[Positions, pa.Array]:
    """Return the rows and the values of all parts, concatenated."""
    return _positions(parts), pa.array(list(chain.from_iterable(part.values for part in parts)), kind)


@contextmanager
def _refusals(runs: Sequence[LedgerRun]) -> Iterator[None]:
    """Convert an error into InvalidRun for the first bad value; reraise it if there is none."""
    try:
        yield
    except InvalidRun:
        raise
    except (LookupError, TypeError, ValueError, OverflowError) as error:
        flaw = first_unfit(runs)
        if flaw is None:
            raise
        raise refusal(flaw) from error


def encode(runs: Sequence[LedgerRun]) -> pa.Table:
    """Encode these runs as rows in order (run, seq), with the columns of `SCHEMA`.

    Raises:
        InvalidRun: A run has no events, not as many times and causes as events, or the name of another run; the cause
            of an event is not an earlier one; the type of an event is not current; a value is not exactly of the class
            of its field (msgspec constructors do not check), not in its closed list, an integer beyond 2^53 - 1, or
            text with surrogates.
    """
    with _refusals(runs):
        return _Rows(runs).table().cast(SCHEMA)


def encode_coded(runs: Sequence[LedgerRun]) -> pa.Table:
    """Encode these runs with the columns of `CODED_SCHEMA`: text as dictionaries, faster to make and to query.

    Otherwise as `encode`.
    """
    with _refusals(runs):
        return _Rows(runs).table()


def encode_hashed(runs: Sequence[LedgerRun]) -> tuple[pa.Table, bytes]:
    """Encode these runs with the columns of `CODED_SCHEMA`; also return the packed leaf hashes of the rows.

    Otherwise as `encode`.
    """
    with _refusals(runs):
        require_runs(runs)
        plain = plain_rows(runs)
        if plain is not None and (table := plain_table(plain.rows)) is not None:
            return table, hashing.leaves(plain.rows)
        rows = _Rows(runs)
        return rows.table(), rows.leaves()


def encode_lines(runs: Sequence[LedgerRun]) -> list[bytes]:
    """Encode these runs as the canonical bytes of their rows. Raises: As `encode`."""
    with _refusals(runs):
        return _Rows(runs).lines()


def decode(table: pa.Table, *, is_whole: bool = True) -> Iterator[LedgerRun]:
    """Decode every run of the table, in order, upcasting events of retired types; the inverse of `encode`.

    Unless the table `is_whole`, its runs may begin or end elsewhere, and each block of rows of a run is yielded.

    Raises:
        UnknownEventTag: A row has a type that is unknown to this version.
        LedgerCorrupted: The columns are not those of `SCHEMA`; a row lacks a value that its type requires, has one that
            it does not allow, or has a seq that does not follow the one before.
    """
    _require_valid(table, is_whole=is_whole)
    events = _events(table)
    seqs = table.column("seq").to_pylist()
    run_ids = table.column("run_id").combine_chunks()
    times_us = table.column("time_us").to_pylist()
    causes = table.column("caused_by").to_pylist()
    for start, end in pairwise([*run_starts(run_ids).tolist(), table.num_rows]):
        yield LedgerRun(
            run_ids[start].as_py(), times_us[start:end], causes[start:end], events[start:end].tolist(), seqs[start]
        )


def upcast_rows(table: pa.Table, tags: Sequence[str]) -> pa.Table | None:
    """Return the rows of these retired types as stored in their newest version; None if there are none.

    Raises: As `decode`.
    """
    stored = table.filter(pc.is_in(table.column("type"), pa.array(tags, pa.string())))
    if not stored.num_rows:
        return None
    _require_valid(table, is_whole=False)  # interleaved runs are in pieces
    times_us, causes = range(stored.num_rows), [None, *range(stored.num_rows - 1)]  # replaced by the stored ones below
    rows = encode([LedgerRun("", times_us, causes, _events(stored).tolist())])
    return pa.Table.from_arrays(
        [(stored if name in _PLACE else rows).column(name) for name in SCHEMA.names], schema=SCHEMA
    )


def _require_valid(table: pa.Table, *, is_whole: bool = True) -> None:
    """Check the rows. Raises: As `decode`."""
    flaw = first_flaw(table, is_whole=is_whole)
    if flaw is not None:
        if flaw.field == "type":
            raise UnknownEventTag(f"{flaw}; read it with the version that wrote it, or restore the segment")
        raise LedgerCorrupted(f"{flaw}; restore the segment")


def _events(table: pa.Table) -> "np.ndarray[tuple[int], np.dtype[np.object_]]":
    """Return the events of all rows, already checked, as their newest versions."""
    events = np.empty(table.num_rows, object)
    tags = table.column("type").combine_chunks().dictionary_encode()
    codes = tags.indices.to_numpy()
    for code, tag in enumerate(tags.dictionary.to_pylist()):
        rows = np.flatnonzero(codes == code)
        layout = STORED[tag]
        columns = []
        for field in layout.fields:
            values = table.column(field.name).take(pa.array(rows)).to_pylist()
            columns.append(
                [None if value is None else tuple(value) for value in values] if field.kind == "strings" else values
            )
        events_of_type = layout.events(columns, len(rows))
        for change in UPCASTS.get(layout.cls, ()):
            events_of_type = list(map(change, events_of_type))
        for position, event in zip(rows.tolist(), events_of_type, strict=True):
            events[position] = event
    return events
