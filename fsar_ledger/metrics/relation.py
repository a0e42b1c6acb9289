"""The relation `events` over segments of every release: each event once, as its newest version, with the columns of today.

Files are read in place. Columns that came after a segment was written are NULL; rows of retired types are left out
where they are and come from memory, upcast, which costs a ledger that holds some one reading of those segments.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow as pa
import pyarrow.compute as pc

from fsar_ledger.errors import LedgerCorrupted
from fsar_ledger.ledger.codec import upcast_rows
from fsar_ledger.ledger.releases import FINGERPRINTS, SCHEMAS
from fsar_ledger.ledger.schema import COLUMNS, RETIRED, Kind
from fsar_ledger.ledger.segment import read_table

if TYPE_CHECKING:
    from .database import Database

_SQL_TYPES: dict[Kind, str] = {"string": "VARCHAR", "integer": "BIGINT", "boolean": "BOOLEAN", "strings": "VARCHAR[]"}
_STORED, _UPCAST = "events_as_stored", "events_upcast"


def native_parts(segments: Sequence[Path], releases: Sequence[str]) -> list[str]:
    """One SELECT of all columns for the segments of each set of columns, given the release of each segment."""
    alike: dict[str, list[Path]] = {}
    for path, release in zip(segments, releases, strict=True):
        alike.setdefault(FINGERPRINTS[release], []).append(path)
    present = {FINGERPRINTS[release]: frozenset(SCHEMAS[release].names) for release in releases}
    return [_select(paths, present[fingerprint]) for fingerprint, paths in alike.items()]


def _select(paths: Sequence[Path], present: frozenset[str]) -> str:
    files = ", ".join("'" + str(path).replace("'", "''") + "'" for path in paths)
    columns = ", ".join(f'"{name}"' if name in present else f'CAST(NULL AS {_SQL_TYPES[kind]}) AS "{name}"' for name, kind in COLUMNS.items())
    return f"SELECT {columns} FROM read_parquet([{files}], hive_partitioning = false)"


def upcast(segments: Sequence[Path]) -> pa.Table | None:
    """The rows of retired types in these segments, as their newest versions; None if there are none.

    Raises:
        LedgerCorrupted: A segment that holds some cannot be read, or does not hold valid events.
    """
    tables = [rows for path in segments if (rows := _upcast_segment(path)) is not None] if RETIRED else []
    return pa.concat_tables(tables) if tables else None


def _upcast_segment(path: Path) -> pa.Table | None:
    if not pc.any(pc.is_in(read_table(path, ["type"]).column("type"), pa.array(list(RETIRED), pa.string()))).as_py():
        return None
    try:
        return upcast_rows(read_table(path))
    except LedgerCorrupted as error:
        raise type(error)(f"{path}: {error}") from error


def hold_events(database: "Database", parts: Sequence[str], newest: pa.Table | None) -> None:
    """The database's `events` are the rows of these SELECTs, but those of retired types are the ones given as their newest versions."""
    if newest is not None:
        database.hold(_UPCAST, newest)
        tags = ", ".join(f"'{tag}'" for tag in RETIRED)
        parts = [*(f"SELECT * FROM ({part}) WHERE type NOT IN ({tags})" for part in parts), f"SELECT * FROM {_UPCAST}"]
    database.define("events", "\nUNION ALL\n".join(parts))


def hold_dataset(database: "Database", stored: Any, newest: pa.Table | None) -> None:
    """As `hold_events`, for rows that an Arrow dataset or table holds with the columns of today."""
    if newest is None:
        database.hold("events", stored)
        return
    database.hold(_STORED, stored)
    hold_events(database, [f"SELECT * FROM {_STORED}"], newest)
