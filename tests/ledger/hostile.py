"""Files made to harm whoever reads them: JSON, notes and Parquet, and ledgers with any text in them."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from fsar_ledger.events.envelope import flat, with_columns
from fsar_ledger.ledger.rows import canonical, segment
from fsar_ledger.ledger.rows.codec import LedgerRun, encode_hashed
from fsar_ledger.ledger.rows.grammar import path_of
from fsar_ledger.ledger.rows.schema import CODED_SCHEMA, COLUMNS, LAYOUTS, MAX_INTEGER, SCHEMA
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.staging import Staged, stage, stage_rows
from tests.ledger.samples import ORIGIN

MIB = 1 << 20


def documents(good: bytes) -> Iterator[tuple[str, bytes]]:
    """Yield what may be in place of a JSON file or a note."""
    yield from {
        "nothing": b"",
        "null": b"null",
        "a number": b"1e400",
        "a number of 100,000 digits": b"9" * 100_000,
        "a string": b'"x"',
        "100,000 lists in each other": b"[" * 100_000 + b"]" * 100_000,
        "100,000 objects in each other": b'{"a":' * 100_000 + b"1" + b"}" * 100_000,
        "a megabyte of blanks": b" " * MIB,
        "more than a megabyte": b"[" + b"1," * MIB + b"1]",
        "a million names": b"{" + b",".join(b'"%d":0' % number for number in range(80_000)) + b"}",
        "a byte order mark": b"\xef\xbb\xbf" + good,
        "UTF-16": good.decode().encode("utf-16"),
        "bytes that are no UTF-8": good.replace(b"e", b"\xff", 1),
        "an overlong NUL": good.replace(b"e", b"\xc0\x80", 1),
        "a NUL": good.replace(b"e", b"\0", 1),
        "a NUL at the end": good + b"\0",
        "a lone surrogate": good.replace(b'":"', b'":"\\ud800', 1).replace(b"\n", b"\\ud800\n", 1),
        "an escape that JSON need not make": good.replace(b"e", b"\\u0065", 1),
        "lines that end in CR LF": good.replace(b"\n", b"\r\n") + b"\r\n",
        "the same twice": good + good,
        "a name twice": good[:-1] + b"," + good[1:],
        "a name too many": good[:-1] + b',"zzz":1}',
        "a float": good.replace(b":1", b":1.0", 1).replace(b":0", b":0.0", 1),
        "a negative zero": good.replace(b":0", b":-0", 1).replace(b":1", b":-1", 1).replace(b"\n3\n", b"\n-3\n", 1),
        "a megabyte in a string": good.replace(b"example", b"x" * (MIB - 3000), 1),
    }.items()


def records(good: dict[str, object]) -> Iterator[tuple[str, bytes]]:
    """Yield records of a chain as a forger may write them: canonical JSON with impossible content."""
    fields: list[dict[str, object]] = [
        {name: value}
        for name in ("number", "rows", "segment_bytes", "tree_size", "first", "index_bytes")
        for value in (MAX_INTEGER, -1, 10**30, True, "3")
    ]
    fields += [
        {"rows": 0},
        {"segment_bytes": 0},
        {"frontier": ["0" * 64] * 10_000},
        {"frontier": [[]]},
        {"continues": [["run", 1]] * 10_000},
        {"continues": [[]]},
        {"goes_on": [1]},
        {"kind": "page"},
        {"signature": "!"},
        {"signature": "A" * 92},
    ]
    for name in ("segment_sha256", "tree_root", "release", "schema_sha256", "index_sha256", "previous_sha256"):
        fields += [
            {name: text}
            for text in (
                "../../../../etc/passwd",
                "/dev/zero",
                "\x00",
                "\x1b[2J\x1b[31m",
                "a\nb",
                "x" * 900_000,
                "",
                "\u202e",
            )
        ]
    for change in fields:
        name, value = next(iter(change.items()))
        if name in good or name in ("continues", "goes_on", "signature"):
            yield f"{name} {str(value)[:20]!r}", canonical.document(good | change)


def parquets(table: pa.Table, good: bytes) -> Iterator[tuple[str, bytes]]:
    """Yield what may be in place of a segment with these rows, each small enough to be sent by mail."""
    footer = len(good) - 8 - int.from_bytes(good[-8:-4], "little")
    for length in (0, 1, footer - 1, len(good), 2**31 - 1, 2**32 - 1):
        yield f"a footer that says to have {length} bytes", good[:-8] + length.to_bytes(4, "little") + good[-4:]
    yield from (
        (f"cut to {length} bytes", good[:length])
        for length in (1, 4, 8, 11, 12, footer, len(good) - 8, len(good) - 4, len(good) - 1)
    )
    yield "an encrypted file", b"PARE" + good[4:-4] + b"PARE"
    yield "other data before its footer", bytes(footer) + good[footer:]
    yield "twice", good + good
    writings: dict[str, Callable[[], pa.Table]] = {
        "no rows": lambda: table.slice(0, 0),
        "a column too many": lambda: table.append_column("zzz", pa.nulls(len(table), pa.string())),
        "a column too few": lambda: table.drop_columns(["robot"]),
        "the columns in another order": lambda: table.select(table.column_names[::-1]),
        "a nested column": lambda: table.set_column(0, "run_id", pa.array([{"a": [{"b": "x"}]}] * len(table))),
        "seq as a float": lambda: table.set_column(1, "seq", table.column("seq").cast(pa.float64())),
        "a column twice": lambda: table.append_column("seq", table.column("seq")),
        "a string in 1000 rows that together are a gigabyte": lambda: _repeated("x" * MIB),
        "more rows than any batch": lambda: pa.table({"a": pa.nulls((1 << 20) + 1, pa.null())}),
    }
    for name, make in writings.items():
        yield name, written(make())
    yield "no compression", written(table, compression="none")
    yield "two row groups", written(table, row_group_size=max(1, len(table) // 2))
    yield "a row group for each row", written(table, row_group_size=1)
    yield "front-coded strings", written(table, use_dictionary=False, column_encoding={"run_id": "DELTA_BYTE_ARRAY"})
    yield "strings that are stored whole", written(table, use_dictionary=False)
    yield "no checksums", written(table, write_page_checksum=False)
    yield "other pages", written(table, data_page_version="2.0")
    yield "pages that unpack to 600 MB", _unpacks_to(600)


def written(table: pa.Table, **options: object) -> bytes:
    """Return the table as a Parquet file with these options."""
    sink = pa.BufferOutputStream()
    pq.write_table(
        table, sink, **{"compression": "zstd", "store_schema": False, "write_page_checksum": True, **options}
    )
    return bytes(sink.getvalue())


AS_OURS: dict[str, object] = {
    "use_dictionary": [path_of(name) for name, kind in COLUMNS.items() if kind in ("string", "strings")],
    "column_encoding": {name: "DELTA_BINARY_PACKED" for name, kind in COLUMNS.items() if kind == "integer"},
    "write_statistics": ["run_id", "seq", "time_us"],
}


def packed(table: pa.Table, **options: object) -> bytes:
    """Write a segment as `segment.to_parquet` does, except for these options."""
    return written(table, **{**AS_OURS, **options})


def _repeated(text: str, rows: int = 1000) -> pa.Table:
    """Return identical rows with one long string."""

    def column(field: pa.Field) -> pa.Array:
        if COLUMNS[field.name] == "string" and not field.nullable:
            return pa.DictionaryArray.from_arrays(pa.array(np.zeros(rows, np.int32)), pa.array([text]))
        return pa.nulls(rows, field.type) if field.nullable else pa.array(np.zeros(rows, np.int64))

    return pa.Table.from_arrays([column(field) for field in CODED_SCHEMA], schema=CODED_SCHEMA)


def _unpacks_to(mebibytes: int) -> bytes:
    """Return one column of text that is all blanks."""
    batch = pa.record_batch({"a": pa.array([" " * MIB])})
    sink = pa.BufferOutputStream()
    with pq.ParquetWriter(
        sink, batch.schema, compression="zstd", use_dictionary=False, write_statistics=False
    ) as writer:
        for _ in range(mebibytes):
            writer.write_batch(batch)
    return bytes(sink.getvalue())


def lying_pages(table: pa.Table) -> Iterator[tuple[str, bytes]]:
    """Yield segments in which the header of one page contradicts the footer: other numbers in as many bytes."""
    good = bytes(segment.to_parquet(table))
    assert table.schema == SCHEMA
    column = pq.read_metadata(pa.BufferReader(good)).row_group(0).column(SCHEMA.get_field_index("time_us"))
    at = column.data_page_offset
    header = good[at : at + 40]
    rows = _zigzag(len(table))
    for name, value in (
        ("values", _zigzag((1 << 7 * len(rows) - 1) - 1)),
        ("a count below zero", _zigzag(-(1 << 7 * len(rows) - 1))),
    ):
        yield f"a page that lies about its {name}", good[:at] + header.replace(rows, value) + good[at + 40 :]


def _zigzag(number: int) -> bytes:
    """Encode a Thrift compact integer."""
    rest, found = number << 1 if number >= 0 else ~(number << 1), []
    while rest > 0x7F:
        found.append(rest & 0x7F | 0x80)
        rest >>= 7
    return bytes([*found, rest])


def stage_anything(path: Path, runs: Sequence[LedgerRun]) -> Staged:
    """Stage the runs as 0.1.0 did: with any names, in any order."""
    return stage_rows(path, runs, *encode_hashed(runs))


class TrustingWriter(Writer):
    """Commits what 0.1.0 committed, including runs that the ledger already holds."""

    def _continued(self, staged: Staged) -> tuple[tuple[str, int], ...]:
        return ()


def append_again(path: Path, runs: Sequence[LedgerRun]) -> None:
    """Append one more commit, of these runs, which the ledger may already hold."""
    with TrustingWriter(path, ORIGIN) as writer:
        writer.append(stage(path, runs))


def relabelled(run: LedgerRun, name: Callable[[str], str]) -> LedgerRun:
    """Return the same run with another text in every field that takes any text, except `parameters` and `observes`.
    Equal texts stay equal."""
    events = []
    for event in run.events:
        free = [
            field
            for field in LAYOUTS[str(event.__struct_config__.tag)].fields
            if field.values is None and field.name not in ("parameters", "observes", "records")
        ]
        values = flat(event)
        changes: dict[str, object] = {
            field.name: name(values[field.name]) for field in free if isinstance(values[field.name], str)
        }
        changes |= {
            field.name: tuple(map(name, values[field.name])) for field in free if isinstance(values[field.name], tuple)
        }
        events.append(with_columns(event, **changes))
    return LedgerRun(name(run.run_id), run.times_us, run.caused_by, events)
