"""One batch of runs as one Parquet file: the same rows give the same bytes on one version of pyarrow."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from fsar_ledger.base.errors import LedgerCorrupted, SequenceConflict
from fsar_ledger.ledger.rows.bounds import MAX_TEXT_BYTES, has_more_text_than, text_bytes
from fsar_ledger.ledger.rows.grammar import HAS_STATISTICS, path_of
from fsar_ledger.ledger.rows.layout import Layout, check_layout, read_file
from fsar_ledger.ledger.rows.schema import CODED_SCHEMA, COLUMNS, SCHEMA, widened

_FEW_ROWS, _FEW_COLUMNS = 1 << 17, 8


# See docs/decisions/parquet-and-json-are-the-truth.md.
def to_parquet(table: pa.Table) -> pa.Buffer:
    """Write a segment: one row group, zstd-3, a dictionary for each string column, a checksum on each page.

    Args:
        table: Rows with the columns of one release, plain or coded as in `CODED_SCHEMA`. Both give the same bytes.
    """
    sink = pa.BufferOutputStream()
    pq.write_table(
        coded(table),
        sink,
        row_group_size=max(1, table.num_rows),
        compression="zstd",
        compression_level=3,
        use_dictionary=[path_of(name) for name in table.column_names if COLUMNS[name] in ("string", "strings")],
        column_encoding={
            name: "DELTA_BINARY_PACKED" for name in table.column_names if COLUMNS[name] == "integer"
        },  # most grow row by row, so differences are small
        write_statistics=list(HAS_STATISTICS),
        write_page_checksum=True,
        store_schema=False,
        version="2.6",
        write_batch_size=1 << 16,
    )
    return sink.getvalue()


def coded(table: pa.Table) -> pa.Table:
    """Return the table with its string columns coded as in `CODED_SCHEMA`."""
    schema = pa.schema([CODED_SCHEMA.field(name) for name in table.column_names])
    if table.schema.equals(schema):
        return table
    arrays = [_coded(column.combine_chunks()) if column.type == pa.string() else column for column in table.columns]
    return pa.Table.from_arrays(arrays, schema=schema)


def _coded(strings: pa.Array) -> pa.DictionaryArray:
    """Return the strings as codes into a sorted dictionary of their values."""
    encoded = strings.dictionary_encode()
    order = pc.sort_indices(encoded.dictionary).to_numpy()
    ranks = np.empty(len(order), np.int32)
    ranks[order] = np.arange(len(order))
    return pa.DictionaryArray.from_arrays(
        pa.array(ranks).take(encoded.indices), encoded.dictionary.take(pa.array(order))
    )


def read_table(path: Path, columns: list[str] | None = None) -> pa.Table:
    """Check the layout of a segment and read its rows with these columns of `SCHEMA` (None: all).

    Columns missing in its release are NULL.

    Raises:
        LedgerCorrupted: The file cannot be read, exceeds the `bounds`, or does not have the form of a segment (see
            `layout`).
    """
    try:
        data = read_file(path)
    except OSError as error:
        raise LedgerCorrupted(
            f"{path}: the segment cannot be read ({error.strerror}); permit reading or restore it"
        ) from error
    return _read(path, data, check_layout(path, data), columns, SCHEMA)


def read_coded(path: Path, data: bytes, layout: Layout, columns: list[str] | None = None) -> pa.Table:
    """Read the rows with these columns of `CODED_SCHEMA`, as stored in the file, without decoding every string.

    Takes the bytes and the layout of the file; otherwise as `read_table`.
    """
    return _read(path, data, layout, columns, CODED_SCHEMA)


def _read(path: Path, data: bytes, layout: Layout, columns: list[str] | None, target: pa.Schema) -> pa.Table:
    strings = [path_of(name) for name in layout.schema.names if COLUMNS[name] in ("string", "strings")]
    try:
        with pq.ParquetFile(pa.BufferReader(data), page_checksum_verification=True, read_dictionary=strings) as file:
            rows = _columns(file, columns or layout.schema.names, layout.rows)
        if has_more_text_than(rows, MAX_TEXT_BYTES):
            raise LedgerCorrupted(
                f"{path}: found strings of {text_bytes(rows)} bytes in {rows.num_rows} rows, expected at most "
                f"{MAX_TEXT_BYTES}; restore the file"
            )
        rows = rows.cast(pa.schema([target.field(name) for name in rows.column_names]))
        return widened(rows, columns or SCHEMA.names, target)
    except pa.ArrowMemoryError:
        raise  # not the file's fault
    except (OSError, pa.ArrowException) as error:
        raise LedgerCorrupted(
            f"{path}: the segment cannot be read ({error}); expected a Parquet file with valid page checksums; "
            "restore it"
        ) from error


def _columns(file: pq.ParquetFile, names: list[str], rows: int) -> pa.Table:
    """Read these columns of the file, a few at a time if there are many rows, to reuse the memory for decoding."""
    if rows <= _FEW_ROWS:
        return file.read(columns=names, use_threads=False)
    parts = [
        file.read(columns=names[first : first + _FEW_COLUMNS], use_threads=False)
        for first in range(0, len(names), _FEW_COLUMNS)
    ]
    columns = [column for part in parts for column in part.columns]
    return pa.Table.from_arrays(columns, schema=pa.schema([field for part in parts for field in part.schema]))


def first_damage(segments: Sequence[Path]) -> LedgerCorrupted | SequenceConflict | None:
    """Return the error of the first segment that cannot be read; None if all can.

    One that is gone was there when the ledger was opened: a compaction removes those that it has merged.
    """
    for path in segments:
        try:
            read_table(path)
        except LedgerCorrupted as damage:
            if path.exists():
                return damage
            return SequenceConflict(
                f"{path}: found no segment, expected the one that was there when the ledger was opened; a compaction "
                "has replaced it meanwhile: run the same command again, which says so if it is missing"
            )
    return None
