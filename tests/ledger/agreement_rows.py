"""Damage to rows and Parquet files with matching hashes: each function damages one thing, and tells whether a verifier
must find it."""

import random
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from fsar_ledger.ledger.rows.schema import COLUMNS, ENVELOPE, LAYOUTS, SCHEMA
from fsar_ledger.ledger.rows.segment import to_parquet
from fsar_ledger.ledger.store.paths import segment_path
from fsar_ledger.ledger.store.record import sha256_hex
from tests.ledger.agreement import (
    KEY,
    OTHER_VERSION,
    VERSION,
    Case,
    chain,
    rewrite,
    tables_of,
    unchained,
    with_value,
)

# --- rows that break one rule, with all hashes matching ---


def a_broken_rule(path: Path, draw: random.Random, beside: Path) -> Case | None:
    tables = tables_of(path)
    if not tables:
        return None
    number = draw.randrange(len(tables))
    table = tables[number]
    row = draw.randrange(table.num_rows)
    layout = LAYOUTS[table.column("type")[row].as_py()]
    own = {field.name for field in layout.fields}
    integers = [
        name
        for name, kind in COLUMNS.items()
        if kind == "integer" and (name in own or name in ("time_us",)) and table.column(name)[row].is_valid
    ]
    kinds: dict[str, object] = {"string": "x", "integer": 1, "boolean": True, "strings": ["x"]}
    foreign = draw.choice(
        [name for name in COLUMNS if name not in own and name not in {field.name for field in ENVELOPE}]
    )
    rules: list[tuple[str, str, object]] = [
        ("seq", "seq", draw.choice([-1, 10**6, 2**60])),
        ("caused_by", "caused_by", draw.choice([10**6, -1, 2**60])),
        ("no cause, or one at the start", "caused_by", 0 if table.column("seq")[row].as_py() == 0 else None),
        ("type", "type", draw.choice(["RobotFlew.v1", "", layout.tag.replace(".v1", ".v2")])),
        ("a field that its type does not have", foreign, kinds[COLUMNS[foreign]]),
        ("a large integer", draw.choice(integers), draw.choice([2**53, -(2**53), 2**63 - 1, -(2**63)])),
        (
            "a run twice",
            "run_id",
            tables[0].column("run_id")[0].as_py()
            if row and tables[0].column("run_id")[0] != table.column("run_id")[row]
            else "other",
        ),
    ]
    rules += [("no value", field.name, None) for field in layout.fields if not field.is_nullable]
    rules += [("another value", field.name, "x") for field in layout.fields if field.values is not None] * 3
    name, column, value = draw.choice(rules)
    if table.column(column)[row].as_py() == value or (column == "run_id" and table.num_rows == 1):
        return None
    tables[number] = with_value(table, column, row, value)
    rewrite(path, tables, draw.choice([None, KEY]))
    return Case(f"{name} in {column}, commit {number}, row {row}", path, False)


def an_altered_row(path: Path, draw: random.Random, beside: Path) -> Case | None:
    """Alter a row and make the hash of its segment fit, but not the tree."""
    records, tables = unchained(path), tables_of(path)
    if not tables:
        return None
    number = draw.randrange(len(tables))
    how = draw.choice(["value", "fewer", "order"])
    table = tables[number]
    row = draw.randrange(table.num_rows)
    if how != "value" and table.num_rows < 3:
        return None
    other = {
        "value": lambda: with_value(table, "time_us", row, 4242),
        "fewer": lambda: table.slice(0, 2),
        "order": lambda: table.take(list(range(table.num_rows))[::-1]),
    }[how]()
    return forged_segment(path, records, number, bytes(to_parquet(other)), f"a row altered: {how}")


def forged_segment(path: Path, records: list[dict[str, Any]], number: int, data: bytes, name: str) -> Case:
    records[number] |= {"segment_sha256": sha256_hex(data), "segment_bytes": len(data)}
    segment_path(path, number).write_bytes(data)
    chain(path, records)
    return Case(name, path, False)


def other_parquet(path: Path, draw: random.Random, beside: Path) -> Case | None:
    """Write the right rows to a file that is not allowed: other columns, several row groups, false statistics."""
    records, tables = unchained(path), tables_of(path)
    if not tables:
        return None
    number = draw.randrange(len(tables))
    table = tables[number]
    renamed = ["reasons" if name == "reason" else name for name in table.column_names]
    at = SCHEMA.get_field_index("attempt")
    ways: dict[str, tuple[pa.Table, dict[str, Any]]] = {
        "a column less": (table.drop_columns(["robot"]), {}),
        "a column more": (table.append_column("zz", pa.array([None] * table.num_rows, pa.string())), {}),
        "a renamed column": (table.rename_columns(renamed), {}),
        "an integer as 32 bits": (table.set_column(at, "attempt", pa.array([None] * table.num_rows, pa.int32())), {}),
        "columns in another order": (table.select([*table.column_names[:5], *reversed(table.column_names[5:])]), {}),
        "a nullable seq": (table.set_column(1, pa.field("seq", pa.int64()), table.column("seq")), {}),
        "several row groups": (table, {"row_group_size": 1}),
    }
    name = draw.choice(sorted(ways))
    if name == "several row groups" and table.num_rows == 1:
        return None
    sink = pa.BufferOutputStream()
    pq.write_table(ways[name][0], sink, store_schema=False, **ways[name][1])
    return forged_segment(path, records, number, bytes(sink.getvalue()), name)


def a_flipped_bit_whose_hash_fits(path: Path, draw: random.Random, beside: Path) -> Case | None:
    """Flip a bit of a segment, in half of the cases of its footer.

    The result may say the same in other bytes, which the format allows and `verify` may doubt.
    """
    records = unchained(path)
    if not records:
        return None
    number = draw.randrange(len(records))
    data = bytearray(segment_path(path, number).read_bytes().replace(VERSION, draw.choice([VERSION, OTHER_VERSION])))
    footer = len(data) - int.from_bytes(data[-8:-4], "little") - 8
    at = draw.randrange(draw.choice([0, footer]), len(data))
    data[at] ^= 1 << draw.randrange(8)
    return forged_segment(
        path, records, number, bytes(data), f"a flipped bit in byte {at} of segment {number}, whose hash fits"
    )._replace(is_good=None)


def lying_statistics(path: Path, draw: random.Random, beside: Path) -> Case | None:
    records, tables = unchained(path), tables_of(path)
    number = draw.randrange(len(tables)) if tables else 0
    if not tables or len(set(tables[number].column("run_id").to_pylist())) < 2:
        return None
    data = segment_path(path, number).read_bytes()
    first, last = (tables[number].column("run_id")[at].as_py().encode() for at in (0, -1))
    footer = len(data) - int.from_bytes(data[-8:-4], "little")
    lying = data[:footer] + data[footer:].replace(last, first)
    if lying == data or len(first) != len(last):
        return None
    return forged_segment(
        path, records, number, draw.choice([lying, lying.replace(VERSION, OTHER_VERSION)]), "statistics that lie"
    )
