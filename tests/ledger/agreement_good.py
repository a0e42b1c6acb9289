"""Variants of good ledgers, and changes whose verdict depends on the key or the anchor.

Each function makes one change, and tells what a verifier must find. It takes a ledger that it may change, a source of
draws, and a folder for files beside the ledger. It returns None if it does not apply.
"""

import random
import shutil
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from fsar_ledger.ledger.log.merkle import Frontier
from fsar_ledger.ledger.log.tiles import partial_tiles
from fsar_ledger.ledger.rows.grammar import path_of
from fsar_ledger.ledger.rows.schema import COLUMNS
from fsar_ledger.ledger.store.derived import tile_reader
from fsar_ledger.ledger.store.paths import segment_path, staged_path
from tests.ledger.agreement import (
    KEY,
    OTHER_VERSION,
    STRANGER,
    VERSION,
    Case,
    Make,
    anchor_at,
    newest_tiles,
    records_of,
    rewrite,
    tables_of,
    with_value,
)


def as_it_is(path: Path, draw: random.Random, beside: Path) -> Case | None:
    return Case("as it is", path, True)


def with_its_key(path: Path, draw: random.Random, beside: Path) -> Case | None:
    records = records_of(path)
    signed = bool(records) and "\u2014" in records[-1].note
    return Case("with the key that signed, or did not", path, signed, KEY.verifier)


def with_an_anchor(path: Path, draw: random.Random, beside: Path) -> Case | None:
    size = records_of(path)[-1].tree_size if records_of(path) else 0
    signer = draw.choice([KEY, STRANGER, None])
    return Case(
        "with an anchor of any size",
        path,
        True,
        None,
        anchor_at(path, draw.randint(0, size), signer, beside / "anchor"),
    )


def a_segment_in_staging(path: Path, draw: random.Random, beside: Path) -> Case | None:
    if not (records := records_of(path)):
        return None
    record = draw.choice(records)
    segment_path(path, record.number).rename(staged_path(path, record.segment_sha256))
    return Case("a segment in staging", path, True)


def junk_in_staging(path: Path, draw: random.Random, beside: Path) -> Case | None:
    if draw.random() < 0.5:
        shutil.rmtree(path / "staging")
        return Case("no staging", path, True)
    (path / "staging" / "half.tmp").write_bytes(b"half")
    (path / "staging" / "link").symlink_to("nowhere")
    return Case("junk in staging", path, True)


def one_commit_behind(path: Path, draw: random.Random, beside: Path) -> Case | None:
    records = records_of(path)
    if not records:
        return None
    before = records[-2].tree() if len(records) > 1 else Frontier()
    for name in newest_tiles(before.size, records[-1].tree_size):
        if draw.random() < 0.5:
            (path / name).unlink()
    if len(records) > 1:
        (path / "checkpoint").write_text(records[-2].note, "utf-8")
    else:
        (path / "checkpoint").unlink()
    return Case("derived files one commit behind", path, True)


def outgrown_tiles_left(path: Path, draw: random.Random, beside: Path) -> Case | None:
    """Leave partial tiles of the commit before the newest beside their full tile."""
    records = records_of(path)
    if len(records) < 2:
        return None
    newly = [
        tile
        for tile in partial_tiles(records[-2].tree_size)
        if tile.number < records[-1].tree_size >> 8 * tile.level >> 8
    ]
    for tile in newly:
        data = tile_reader(path)(tile)
        (path / tile.name).parent.mkdir(exist_ok=True)
        (path / tile.name).write_bytes(data)
    if newly and draw.random() < 0.3:
        (path / newly[0].name).write_bytes(bytes(32 * newly[0].width))
        return Case("a wrong outgrown tile", path, False)
    return Case("outgrown tiles left", path, True) if newly else None


def another_history(path: Path, draw: random.Random, beside: Path) -> Case | None:
    """Rewrite everything consistently from an altered row. This is good without a key or anchor, and with an anchor of
    what came before; otherwise it is damage."""
    tables = tables_of(path)
    if not tables:
        return None
    size = records_of(path)[-1].tree_size
    number = draw.randrange(len(tables))
    row = draw.randrange(tables[number].num_rows)
    first = sum(table.num_rows for table in tables[:number]) + row
    kept = draw.randint(0, size)
    anchor = anchor_at(path, kept, None, beside / "anchor")
    tables[number] = with_value(tables[number], "time_us", row, -123456789)
    rewrite(path, tables, draw.choice([None, STRANGER]))
    how = draw.choice(["alone", "anchor", "key"])
    if how == "alone":
        return Case("another history, alone", path, True)
    if how == "key":
        return Case("another history, with the key", path, False, KEY.verifier)
    return Case("another history, with an anchor", path, kept <= first, None, anchor)


def packed_otherwise(path: Path, draw: random.Random, beside: Path) -> Case | None:
    """Write the same rows as other Parquet, by an alleged other version of the library: other pages, other compression,
    fewer statistics."""
    level, pages, bounded = (
        draw.randrange(1, 10),
        draw.choice([100, 1 << 20]),
        draw.choice([[], ["run_id"], ["run_id", "seq", "time_us"]]),
    )
    has_index, has_order = draw.random() < 0.2, draw.random() < 0.2

    def pack(table: pa.Table) -> bytes:
        sink = pa.BufferOutputStream()
        pq.write_table(
            table,
            sink,
            compression="zstd",
            compression_level=level,
            data_page_size=pages,
            write_batch_size=16,
            use_dictionary=[path_of(name) for name, kind in COLUMNS.items() if kind in ("string", "strings")],
            column_encoding={name: "DELTA_BINARY_PACKED" for name, kind in COLUMNS.items() if kind == "integer"},
            write_page_checksum=True,
            write_page_index=has_index,
            sorting_columns=[pq.SortingColumn(draw.randrange(5))] if has_order else None,
            store_schema=False,
            write_statistics=bounded,
        )
        return bytes(sink.getvalue()).replace(VERSION, OTHER_VERSION)

    rewrite(path, tables_of(path), None, pack)
    name = f"packed otherwise{' with an index' * has_index}{' with an order of rows' * has_order}"
    return Case(name, path, not (has_index or has_order) or not records_of(path))


GOOD: tuple[Make, ...] = (
    as_it_is,
    with_its_key,
    with_an_anchor,
    a_segment_in_staging,
    junk_in_staging,
    one_commit_behind,
    outgrown_tiles_left,
    another_history,
    packed_otherwise,
)
