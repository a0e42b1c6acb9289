"""One batch of runs as one Parquet file: the same rows give the same bytes on one version of pyarrow."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from fsar_ledger.errors import LedgerCorrupted
from fsar_ledger.ledger.bounds import MAX_TEXT_BYTES, Footer, check_bounds, text_bytes
from fsar_ledger.ledger.releases import FINGERPRINTS, widened
from fsar_ledger.ledger.schema import CODED_SCHEMA, COLUMNS, SCHEMA, fingerprint

_PRUNED_BY = ("run_id", "seq", "time_us")  # statistics of the other columns spare no reader any work


def _leaf(name: str) -> str:
    """The Parquet path of a column: that of its elements for a list."""
    return f"{name}.list.element" if COLUMNS[name] == "strings" else name


def to_parquet(table: pa.Table) -> pa.Buffer:
    """The bytes of a segment: one row group, zstd-3, a dictionary for each column of strings, a checksum on each page.

    Args:
        table: Rows with the columns of one release, plain or, ready to be written, as `CODED_SCHEMA` has them. Both give the same bytes.
    """
    sink = pa.BufferOutputStream()
    pq.write_table(
        coded(table),
        sink,
        row_group_size=max(1, table.num_rows),
        compression="zstd",
        compression_level=3,
        use_dictionary=[_leaf(name) for name in table.column_names if COLUMNS[name] in ("string", "strings")],
        column_encoding={
            name: "DELTA_BINARY_PACKED" for name in table.column_names if COLUMNS[name] == "integer"
        },  # most grow row by row, so differences are small
        write_statistics=list(_PRUNED_BY),
        write_page_checksum=True,
        store_schema=False,
        version="2.6",
        write_batch_size=1 << 16,
    )
    return sink.getvalue()


def coded(table: pa.Table) -> pa.Table:
    """The table with its columns of strings as `CODED_SCHEMA` has them."""
    schema = pa.schema([CODED_SCHEMA.field(name) for name in table.column_names])
    if table.schema.equals(schema):
        return table
    arrays = [_coded(column.combine_chunks()) if column.type == pa.string() else column for column in table.columns]
    return pa.Table.from_arrays(arrays, schema=schema)


def _coded(strings: pa.Array) -> pa.DictionaryArray:
    """The strings as codes into a sorted dictionary of them."""
    found = strings.dictionary_encode()
    order = pc.sort_indices(found.dictionary).to_numpy()
    places = np.empty(len(order), np.int32)
    places[order] = np.arange(len(order))
    return pa.DictionaryArray.from_arrays(pa.array(places).take(found.indices), found.dictionary.take(pa.array(order)))


def read_table(path: Path, columns: list[str] | None = None) -> pa.Table:
    """The rows of a segment, after its bounds and its page checksums were verified, with these columns of `SCHEMA` (all: None); NULL in those that came later.

    Raises:
        LedgerCorrupted: The file cannot be read, asks for more memory than a batch of runs needs, a checksum is wrong, or its
            columns are those of no release.
    """
    return _read(path, columns, None)


def read_coded(path: Path, footer: Footer) -> pa.Table:
    """As `read_table`, of a file with this footer, but with the columns of `CODED_SCHEMA`, as the file holds them: that spares the strings one by one."""
    return _read(path, None, footer)


def _read(path: Path, columns: list[str] | None, footer: Footer | None) -> pa.Table:
    try:
        metadata = (footer or check_bounds(path)).metadata
        schema = metadata.schema.to_arrow_schema()
        if fingerprint(schema) not in FINGERPRINTS.values():
            raise LedgerCorrupted(f"{path}: {_difference(schema)}; restore the file, or read it with the version that wrote it")
        strings = [_leaf(name) for name in schema.names if COLUMNS[name] in ("string", "strings")]
        with pq.ParquetFile(path, metadata=metadata, page_checksum_verification=True, read_dictionary=strings) as file:
            found = file.read(columns=columns, use_threads=False)
        if (texts := text_bytes(found)) > MAX_TEXT_BYTES:
            raise LedgerCorrupted(f"{path}: found strings of {texts} bytes in {found.num_rows} rows, expected at most {MAX_TEXT_BYTES}; restore the file")
        target = CODED_SCHEMA if footer else SCHEMA
        found = found.cast(pa.schema([target.field(name) for name in found.column_names]))
        return widened(found, columns or SCHEMA.names, target)
    except pa.ArrowMemoryError:
        raise  # the machine's fault
    except (OSError, pa.ArrowException) as error:
        raise LedgerCorrupted(f"{path}: the segment cannot be read ({error}); expected a Parquet file with valid page checksums; restore it") from error


def _difference(schema: pa.Schema) -> str:
    """The first column in which this schema, which is of no release, is not that of today."""
    for at, expected in enumerate(SCHEMA):
        if at >= len(schema) or not schema.field(at).equals(expected):
            return f"column {at} is {schema.field(at) if at < len(schema) else 'missing'}, expected {expected}"
    return f"found {len(schema)} columns, expected {len(SCHEMA)}"
