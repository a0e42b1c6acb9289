"""Checks of stored rows, by column. The first flaw is reported with run, seq and field."""

from typing import TypeAlias

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from fsar_ledger.events import CONCERNS
from fsar_ledger.ledger.rows.runs import Flaw
from fsar_ledger.ledger.rows.schema import (
    CODED_SCHEMA,
    COLUMNS,
    CONCERNED,
    ENVELOPE,
    MAX_INTEGER,
    OPENINGS,
    PAYLOAD,
    RECORDS,
    SCHEMA,
    STANDS_ALONE,
    STORED,
    Field,
)

from . import Columns, Mask, as_columns, as_one_array, coded, numbers, places, validity

Integers: TypeAlias = "np.ndarray[tuple[int], np.dtype[np.int64]]"

_TAGS = tuple(STORED)
_UNKNOWN = len(_TAGS)  # the code of every type that is not in STORED
_FIELDS = tuple({field.name: field for field in layout.fields} for layout in STORED.values())


def _holders(name: str, *, required: bool) -> Mask:
    """Return for each type code whether its events have the column, or (`required`) must have a value in it."""
    holds = [name in fields and not (required and fields[name].is_nullable) for fields in _FIELDS]
    return np.array([*holds, False])


_ALLOWED = {name: _holders(name, required=False) for name in PAYLOAD}
_REQUIRED = {name: _holders(name, required=True) for name in PAYLOAD}
_NEEDED = np.array([_REQUIRED[name] for name in PAYLOAD])
_LITERALS: dict[str, list[tuple[int, Field]]] = {
    name: [(code, own[name]) for code, own in enumerate(_FIELDS) if name in own and own[name].values is not None]
    for name in PAYLOAD
}


def first_flaw(rows: pa.Table | Columns, *, is_whole: bool = True) -> Flaw | None:
    """Return the flaw in the earliest bad row; None if every row is a valid event of its type, retired or not.

    Takes a table or its columns; string columns may be dictionaries. Unless the table `is_whole`, its runs may begin or
    end elsewhere: then a block of rows of a run may begin with any seq, a run may have several blocks, and its concerns
    are not compared with its event 0 if that is elsewhere (see `blocks_of`).
    """
    decomposed = as_columns(rows)
    table, columns = decomposed.table, decomposed.arrays
    if not table.schema.equals(SCHEMA) and not table.schema.equals(CODED_SCHEMA):
        return Flaw(
            -1,
            None,
            None,
            None,
            f"columns {table.schema.names!r:.300}",
            "the columns of the ledger; the rows come from another version",
        )
    try:
        table.validate(full=True)
    except pa.ArrowInvalid as error:
        return Flaw(-1, None, None, None, f"{error!s:.300}", "valid Arrow data")
    if not table.num_rows:
        return None
    envelope = _envelope(columns, decomposed.valid, is_whole=is_whole)
    suspects = [*envelope, *_payload(decomposed), *_company(columns), *_unobserved(columns)]
    first = min(suspects, key=lambda suspect: suspect[0], default=None)
    if first is None:
        return None
    row, field, expected = first
    value = columns[field][row].as_py()
    return Flaw(
        row,
        columns["run_id"][row].as_py(),
        columns["seq"][row].as_py(),
        field,
        "NULL" if value is None else f"{value!r:.80}",
        expected,
    )


def unprintable(table: pa.Table) -> Flaw | None:
    """Return the first text that no writer stores, with a control or other unprintable character; None if all are fine.

    Readers accept it, because 0.1.0 stored it, and escape it on output. The table has the columns of `CODED_SCHEMA`;
    each distinct text is checked once.
    """
    for name, kind in COLUMNS.items():
        if kind not in ("string", "strings"):
            continue
        column = as_one_array(table.column(name))
        if column.null_count == len(column):  # true of most columns of a short run
            continue
        texts = (column.dictionary if kind == "string" else column.flatten().unique()).to_pylist()
        if "".join(texts).isprintable():
            continue
        bad = {text for text in texts if not text.isprintable()}
        row_texts = ([value] if kind == "string" else value or () for value in column.to_pylist())
        row, bad_text = next((index, text) for index, values in enumerate(row_texts) for text in values if text in bad)
        return Flaw(
            row,
            table.column("run_id")[row].as_py(),
            table.column("seq")[row].as_py(),
            name,
            f"{bad_text!r:.80}",
            "characters that can be printed",
        )
    return None


def disordered(table: pa.Table) -> Flaw | None:
    """Return an order of events that no writer stores: a wrong or second beginning of a run, or time going backwards.

    None if there is none. Readers accept both, because 0.1.0 stored them. They do not accept a longer run with an event
    that must stand alone, or an event of a concern that its run does not observe. The rows have the columns of
    `CODED_SCHEMA`, each run in one block.
    """
    columns = {name: as_one_array(table.column(name)) for name in ("run_id", "type", "time_us", "observes", "records")}
    starts = run_starts(columns["run_id"])
    is_first, begins = np.zeros(len(table), bool), np.zeros(len(table), bool)
    is_first[starts] = True
    begins[starts] = numbers(as_one_array(table.column("seq")))[starts] == 0
    types, times_us = columns["type"], numbers(columns["time_us"])
    is_opening = np.array([tag in OPENINGS for tag in types.dictionary.to_pylist()])[numbers(types.indices)]
    suspects = [
        *_first(begins & ~is_opening, "type", f"one of {sorted(OPENINGS)}, with which a run begins"),
        *_first(is_opening & ~begins, "type", "no second beginning of a run"),
        *_first(
            (np.diff(times_us, prepend=times_us[:1]) < 0) & ~is_first, "time_us", "no less than at the event before"
        ),
        *_company(columns),
        *_unobserved(columns),
    ]
    if not suspects:
        return None
    row, field, expected = min(suspects, key=lambda suspect: suspect[0])
    return Flaw(
        row,
        columns["run_id"][row].as_py(),
        table.column("seq")[row].as_py(),
        field,
        f"{columns[field][row].as_py()!r:.80}",
        expected,
    )


def run_starts(run_ids: pa.Array) -> Integers:
    """Return the index of the first row of each run."""
    codes = places(coded(run_ids))
    return np.flatnonzero(np.concatenate([np.ones(min(1, len(codes)), bool), codes[1:] != codes[:-1]]))


def standing_alone(types: pa.Array) -> Mask:
    """Return the mask of rows whose type must be the only event of its run."""
    tags = coded(types)
    alone: Mask = np.array([*(tag in STANDS_ALONE for tag in tags.dictionary.to_pylist()), False])[places(tags)]
    return alone


def _first(bad: Mask, field: str, expected: str) -> list[tuple[int, str, str]]:
    """Return a list of the first bad row as a suspect; empty if there is none."""
    return [(int(np.argmax(bad)), field, expected)] if bad.any() else []


def _envelope(columns: dict[str, pa.Array], valid: dict[str, Mask], *, is_whole: bool) -> list[tuple[int, str, str]]:
    suspects = [
        suspect
        for field in ENVELOPE
        if not field.is_nullable
        for suspect in _first(~valid[field.name], field.name, "a value")
    ]
    if suspects:
        return suspects
    starts = run_starts(columns["run_id"])
    sizes = np.diff(starts, append=len(columns["run_id"]))
    expected_seqs = np.arange(len(columns["run_id"])) - np.repeat(starts, sizes)
    seqs = columns["seq"].to_numpy()
    if not is_whole:
        expected_seqs += np.repeat(np.maximum(0, seqs[starts]), sizes)
    is_wrong = seqs != expected_seqs
    if is_wrong.any():
        suspects += _first(is_wrong, "seq", f"{expected_seqs[np.argmax(is_wrong)]}")
    seen: set[str] = set()
    for start in starts.tolist() if is_whole else ():
        run = columns["run_id"][start].as_py()
        if run in seen:
            suspects.append((start, "run_id", "each run in one block of rows"))
            break
        seen.add(run)
    causes = columns["caused_by"].fill_null(-1).to_numpy()
    suspects += _first(valid["caused_by"] & (expected_seqs == 0), "caused_by", "NULL at seq 0")
    suspects += _first(
        valid["caused_by"] & ((causes < 0) | (causes >= expected_seqs)) & (expected_seqs > 0),
        "caused_by",
        "the seq of an earlier event",
    )
    for name in COLUMNS:
        if COLUMNS[name] == "integer" and columns[name].null_count < len(columns[name]):
            values = numbers(columns[name])
            is_large = (values > MAX_INTEGER) | (values < -MAX_INTEGER)
            suspects += _first(is_large & valid[name], name, "an integer of at most 2^53 - 1 in size")
    return suspects


def _company(columns: dict[str, pa.Array]) -> list[tuple[int, str, str]]:
    """Find rows of types that must stand alone, in runs that have other rows."""
    is_alone = standing_alone(columns["type"])
    if not is_alone.any():
        return []
    sizes = np.diff(run_starts(columns["run_id"]), append=len(is_alone))
    has_company = np.repeat(sizes > 1, sizes)
    return _first(is_alone & has_company, "type", "the only event of its run, as this type is")


def _unobserved(columns: dict[str, pa.Array]) -> list[tuple[int, str, str]]:
    """Find rows with unknown names, and rows that their run, by its seq 0, neither observes nor records."""
    observes, types = columns["observes"], coded(columns["type"])
    if observes.null_count == len(observes):
        return []
    rows, names = _name_indexes(observes, CONCERNS)
    suspects = [(int(rows[np.argmax(names < 0)]), "observes", f"some of {list(CONCERNS)}")] if (names < 0).any() else []
    if columns["records"].null_count < len(observes):
        record_rows, record_names = _name_indexes(columns["records"], RECORDS)
        expected = "event types, and fields of them that may be NULL, as in ExecutionStarted.requested_by"
        suspects += (
            [(int(record_rows[np.argmax(record_names < 0)]), "records", expected)] if (record_names < 0).any() else []
        )
    starts = run_starts(columns["run_id"])
    run_of: Integers = np.repeat(np.arange(len(starts)), np.diff(starts, append=len(observes)))
    is_first = np.zeros(len(observes), bool)
    is_first[starts] = True
    first_rows = is_first[rows]
    is_observed = np.zeros((len(starts), len(CONCERNS) + 1), bool)
    is_observed[run_of[rows[first_rows]], names[first_rows]] = True
    is_observed[~validity(observes)[starts]] = True  # the run does not restrict them
    is_observed[:, -1] = True  # types without a concern
    if is_observed.all():
        return suspects
    concerns = [CONCERNS.index(CONCERNED[tag]) if tag in CONCERNED else -1 for tag in types.dictionary.to_pylist()]
    is_bad = ~is_observed[run_of, np.array([*concerns, -1])[places(types)]]
    for number in np.flatnonzero(validity(columns["records"])[starts]).tolist():
        kinds = {f"{name}.v" for name in columns["records"][int(starts[number])].as_py()}
        in_run = run_of == number
        is_recorded = np.array([tag.rstrip("0123456789") in kinds for tag in types.dictionary.to_pylist()] + [False])
        is_bad[in_run] &= ~is_recorded[places(types)[in_run]]
    return [
        *suspects,
        *_first(
            is_bad, "type", "an event of a concern that its run observes, or of a type that it records, as event 0 says"
        ),
    ]


def _name_indexes(lists: pa.Array, known: tuple[str, ...]) -> tuple[Integers, Integers]:
    """Return the row of each name in these lists, and its index in `known`, -1 if it is not there."""
    sizes: Integers = lists.value_lengths().fill_null(0).to_numpy().astype(np.int64)
    indexes: Integers = (
        pc.index_in(lists.flatten(), pa.array(known, pa.string())).fill_null(-1).to_numpy().astype(np.int64)
    )
    return np.repeat(np.arange(len(lists)), sizes), indexes


def _payload(columns: Columns) -> list[tuple[int, str, str]]:
    known: Integers = (
        pc.index_in(columns.coded["type"].dictionary, pa.array(_TAGS, pa.string()))
        .fill_null(_UNKNOWN)
        .to_numpy()
        .astype(np.int64)
    )
    codes = np.append(known, _UNKNOWN)[columns.places["type"]]
    suspects = _first(codes == _UNKNOWN, "type", "an event type that this version of fsar-ledger knows")
    is_known = codes != _UNKNOWN
    rows = np.bincount(codes, minlength=_UNKNOWN + 1)
    is_needed = np.asarray(_NEEDED[:, rows > 0].any(axis=1))
    for name, needs_values in zip(PAYLOAD, is_needed, strict=True):
        if not needs_values and columns.arrays[name].null_count == len(codes):
            continue  # true of most columns of a few rows; a journal is checked commit by commit
        valid = columns.valid[name]
        filled = (
            np.bincount(codes[valid], minlength=_UNKNOWN + 1)
            if columns.arrays[name].null_count < len(codes)
            else np.zeros_like(rows)
        )
        if (filled < rows)[_REQUIRED[name]].any():
            suspects += _first(_REQUIRED[name][codes] & ~valid, name, "a value")
        if filled[:_UNKNOWN][~_ALLOWED[name][:_UNKNOWN]].any():
            suspects += _first(valid & ~_ALLOWED[name][codes] & is_known, name, "NULL, as its type has no such field")
        if filled.any():
            suspects += _literals(name, columns, codes)
    return suspects


def _literals(name: str, columns: Columns, codes: Integers) -> list[tuple[int, str, str]]:
    """Find rows with a value outside the closed list of their type's field."""
    suspects: list[tuple[int, str, str]] = []
    if not _LITERALS[name]:
        return suspects
    values = columns.texts[name]
    for code, field in _LITERALS[name]:
        assert field.values is not None
        is_other = np.array([value not in field.values for value in values] + [False])
        if is_other.any():
            suspects += _first((codes == code) & is_other[columns.places[name]], name, f"one of {sorted(field.values)}")
    return suspects
