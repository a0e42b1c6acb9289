"""Other bytes in the place of a segment, with a placement that fits: each function makes one such change, and tells
whether a verifier must find it. Functions as in `agreement_chain_damage`."""

import random
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from fsar_ledger.ledger.log.hashing import sha256_hex
from fsar_ledger.ledger.rows.schema import SCHEMA
from fsar_ledger.ledger.rows.segment import to_parquet
from fsar_ledger.ledger.store.record import segment_of
from tests.ledger.agreement import OTHER_VERSION, VERSION, Case, Make
from tests.ledger.agreement_chain import records_of, relink, tables_of, view_of
from tests.ledger.forgery import changed
from tests.ledger.parquet_damage import DAMAGED
from tests.ledger.parts import two_faced


def forged_segment(path: Path, number: int, data: bytes, name: str) -> Case:
    """Put these bytes in the place of a segment in force."""
    records, frames = records_of(path)
    placement = view_of(path).chain.placed[number]
    (path / segment_of(placement)).write_bytes(data)
    [record] = [one for one in records if (one["kind"], one["number"]) == ("placement", placement.number)]
    record |= {"segment_sha256": sha256_hex(data), "segment_bytes": len(data)}
    relink(path, records, frames)
    return Case(name, path, False)


def drawn(path: Path, draw: random.Random) -> tuple[int, pa.Table, bytes] | None:
    """Draw a segment: its number, its rows, its bytes; None if there is none."""
    placed = view_of(path).chain.placed
    if not placed:
        return None
    number = draw.randrange(len(placed))
    return number, tables_of(path)[number], (path / segment_of(placed[number])).read_bytes()


def other_rows(path: Path, draw: random.Random, beside: Path) -> Case | None:
    """Store other rows, fewer, or the same in another order."""
    if (found := drawn(path, draw)) is None:
        return None
    number, table, _ = found
    how = draw.choice(["value", "fewer", "order"])
    if how != "value" and table.num_rows < 3:
        return None
    other = {
        "value": lambda: changed(table, "time_us", draw.randrange(table.num_rows), 4242),
        "fewer": lambda: table.slice(0, 2),
        "order": lambda: table.take(list(range(table.num_rows))[::-1]),
    }[how]()
    return forged_segment(path, number, bytes(to_parquet(other)), f"a row altered: {how}")


def other_parquet(path: Path, draw: random.Random, beside: Path) -> Case | None:
    """Write the right rows to a file that is not allowed: other columns, several row groups."""
    if (found := drawn(path, draw)) is None:
        return None
    number, table, _ = found
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
    return forged_segment(path, number, bytes(sink.getvalue()), name)


def a_flipped_bit_whose_hash_fits(path: Path, draw: random.Random, beside: Path) -> Case | None:
    """Flip a bit of a segment, in half of the cases of its footer.

    The result may say the same in other bytes, which the format allows and `verify` may doubt.
    """
    if (found := drawn(path, draw)) is None:
        return None
    number, _, good = found
    data = bytearray(good.replace(VERSION, draw.choice([VERSION, OTHER_VERSION])))
    footer = len(data) - int.from_bytes(data[-8:-4], "little") - 8
    at = draw.randrange(draw.choice([0, footer]), len(data))
    data[at] ^= 1 << draw.randrange(8)
    name = f"a flipped bit in byte {at} of segment {number}, whose hash fits"
    return forged_segment(path, number, bytes(data), name)._replace(is_good=None)


def lying_statistics(path: Path, draw: random.Random, beside: Path) -> Case | None:
    """Let the footer say that the last run is the first, so that a query engine skips its rows."""
    found = drawn(path, draw)
    if found is None or len(set(found[1].column("run_id").to_pylist())) < 2:
        return None
    number, table, data = found
    first, last = (table.column("run_id")[at].as_py().encode() for at in (0, -1))
    footer = len(data) - int.from_bytes(data[-8:-4], "little")
    lying = data[:footer] + data[footer:].replace(last, first)
    if lying == data or len(first) != len(last):
        return None
    lying = draw.choice([lying, lying.replace(VERSION, OTHER_VERSION)])
    return forged_segment(path, number, lying, "statistics that lie")


def two_faces(path: Path, draw: random.Random, beside: Path) -> Case | None:
    """Write a segment in which readers that begin at the data find the rows of the tree, and readers that begin at the
    dictionary find others; or the other way round."""
    if (found := drawn(path, draw)) is None:
        return None
    number, table, _ = found
    other = changed(table, "type", draw.randrange(table.num_rows), "Forged.v1")
    honest, forged = (bytes(to_parquet(one)) for one in (table, other))
    data = two_faced(*draw.choice([(honest, forged), (forged, honest)]), "type")
    return forged_segment(path, number, data, "a segment with two faces")


def a_structure_that_disagrees(path: Path, draw: random.Random, beside: Path) -> Case | None:
    """Say something twice in one of several ways, by this or an alleged other version of the library.

    Of few rows it may say the same.
    """
    if (found := drawn(path, draw)) is None:
        return None
    number, _, good = found
    name = draw.choice(sorted(DAMAGED))
    data = DAMAGED[name](good.replace(VERSION, draw.choice([VERSION, OTHER_VERSION])))
    return forged_segment(path, number, data, f"a segment with {name}")._replace(is_good=None)


FORGED: tuple[Make, ...] = (
    *(other_rows, other_parquet, a_flipped_bit_whose_hash_fits),
    *(lying_statistics, two_faces, a_structure_that_disagrees),
)
