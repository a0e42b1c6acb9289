"""Segments with the right rows and matching hashes that say something twice, or something that nobody reads.

Functions as in `agreement_damage`.
"""

import random
from pathlib import Path

from fsar_ledger.ledger.rows.segment import to_parquet
from fsar_ledger.ledger.store.paths import segment_path
from tests.ledger.agreement import OTHER_VERSION, VERSION, Case, Make, tables_of, unchained, with_value
from tests.ledger.agreement_rows import forged_segment
from tests.ledger.parquet_damage import DAMAGED
from tests.ledger.parts import two_faced


def a_segment_with_two_faces(path: Path, draw: random.Random, beside: Path) -> Case | None:
    """Write a segment in which readers that begin at the data find the rows of the tree, and readers that begin at the
    dictionary find others; or the other way round."""
    records, tables = unchained(path), tables_of(path)
    if not tables:
        return None
    number = draw.randrange(len(tables))
    row = draw.randrange(tables[number].num_rows)
    honest, other = (
        bytes(to_parquet(table)) for table in (tables[number], with_value(tables[number], "type", row, "Forged.v1"))
    )
    data = two_faced(*draw.choice([(honest, other), (other, honest)]), "type")
    return forged_segment(path, records, number, data, "a segment with two faces")


def a_structure_that_disagrees(path: Path, draw: random.Random, beside: Path) -> Case | None:
    """Say something twice in one of several ways, by this or an alleged other version of the library."""
    records = unchained(path)
    if not records:
        return None
    number, name = draw.randrange(len(records)), draw.choice(sorted(DAMAGED))
    data = segment_path(path, number).read_bytes().replace(VERSION, draw.choice([VERSION, OTHER_VERSION]))
    return forged_segment(path, records, number, DAMAGED[name](data), f"a segment with {name}")


STRUCTURES: tuple[Make, ...] = (a_segment_with_two_faces, a_structure_that_disagrees)
