"""One batch of runs as one Parquet file: the same rows give the same bytes on one version of pyarrow."""

from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from fsar_ledger.errors import LedgerCorrupted
from fsar_ledger.ledger.schema import COLUMNS, SCHEMA

_DELTA_CODED = ("seq", "time_us", "caused_by")  # they grow row by row, so differences are small
_PRUNED_BY = ("run_id", "seq", "time_us")  # statistics of the other columns spare no reader any work


def to_parquet(table: pa.Table) -> pa.Buffer:
    """The bytes of a segment: one row group, zstd-3, a dictionary for each column that repeats itself, a checksum on each page."""
    sink = pa.BufferOutputStream()
    pq.write_table(
        table,
        sink,
        row_group_size=max(1, table.num_rows),
        compression="zstd",
        compression_level=3,
        use_dictionary=[_leaf(name) for name in COLUMNS if name not in _DELTA_CODED and COLUMNS[name] != "boolean"],
        column_encoding=dict.fromkeys(_DELTA_CODED, "DELTA_BINARY_PACKED"),
        write_statistics=list(_PRUNED_BY),
        write_page_checksum=True,
        store_schema=False,
        version="2.6",
        write_batch_size=1 << 16,
    )
    return sink.getvalue()


def _leaf(name: str) -> str:
    """The Parquet path of a column: that of its elements for a list."""
    return f"{name}.list.element" if COLUMNS[name] == "strings" else name


def read_table(path: Path, columns: list[str] | None = None) -> pa.Table:
    """The rows of a segment, after its page checksums were verified.

    Raises:
        LedgerCorrupted: The file cannot be read, a checksum is wrong, or its columns are not those of `SCHEMA`.
    """
    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            schema = file.schema_arrow
            if not schema.equals(SCHEMA):
                raise LedgerCorrupted(f"{path}: {_difference(schema)}; restore the file, or read it with the version that wrote it")
            return file.read(columns=columns, use_threads=False)
    except (OSError, pa.ArrowException) as error:
        raise LedgerCorrupted(f"{path}: the segment cannot be read ({error}); expected a Parquet file with valid page checksums; restore it") from error


def _difference(schema: pa.Schema) -> str:
    """The first column in which this schema is not the one expected."""
    for at, expected in enumerate(SCHEMA):
        if at >= len(schema) or not schema.field(at).equals(expected):
            return f"column {at} is {schema.field(at) if at < len(schema) else 'missing'}, expected {expected}"
    return f"found {len(schema)} columns, expected {len(SCHEMA)}"
