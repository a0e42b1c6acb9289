"""What a forger does to a ledger: change records of its chain, and chain and hash them again."""

import json
from pathlib import Path
from typing import Any

import pyarrow as pa

from fsar_ledger.ledger.log.hashing import sha256_hex
from fsar_ledger.ledger.rows import canonical, segment
from fsar_ledger.ledger.rows.schema import SCHEMA
from fsar_ledger.ledger.store.paths import CHAIN


def segment_at(path: Path, number: int) -> Path:
    """Return the segment of this number; each commit of `append_all` has one."""
    return sorted((path / "segments").iterdir())[number]


def staged_at(path: Path, number: int) -> Path:
    """Return where this segment is before it is moved into place."""
    return path / "staging" / f"{records_in(path, 'placement')[number]['segment_sha256']}.parquet"


def records_in(path: Path, kind: str) -> list[dict[str, Any]]:
    """Return the records of this kind, unchecked."""
    return [one for one in _lines(path) if one["kind"] == kind]


def _lines(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (path / CHAIN).read_bytes().splitlines()]


def forge(path: Path, kind: str, number: int, /, **changes: object) -> None:
    """Change one record of this kind, or remove what is None, and chain all later ones to it again."""
    lines = _lines(path)
    [own] = [one for one in lines if (one["kind"], one["number"]) == (kind, number)]
    previous, written = sha256_hex((path / "ledger.json").read_bytes()), b""
    for one in lines:
        one |= {"previous_sha256": previous} | (changes if one is own else {})
        data = canonical.document({name: value for name, value in one.items() if value is not None})
        written, previous = written + data + b"\n", sha256_hex(data)
    (path / CHAIN).write_bytes(written)


def forge_segment(path: Path, number: int, table: pa.Table | bytes) -> None:
    """Put other rows into the segment and make its placement fit the file, but not the tree."""
    data = table if isinstance(table, bytes) else bytes(segment.to_parquet(table))
    segment_at(path, number).write_bytes(data)
    forge(path, "placement", number, segment_sha256=sha256_hex(data), segment_bytes=len(data))


def table_of(path: Path, number: int) -> pa.Table:
    """Return the rows of this segment."""
    return segment.read_table(segment_at(path, number))


def changed(table: pa.Table, name: str, row: int, value: object) -> pa.Table:
    """Return the same rows except for one value."""
    values = table.column(name).to_pylist()
    values[row] = value
    at = SCHEMA.get_field_index(name)
    return table.set_column(at, SCHEMA.field(name), pa.array(values, SCHEMA.field(name).type))
