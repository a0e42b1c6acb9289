"""The relation `events` over segments of every release: each event once, as its newest version, with the columns of today.

Files are read in place. Columns that came after a segment was written are NULL; rows of retired types are left out
where they are and come from memory, upcast, which costs a ledger that holds some one reading of those segments.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow as pa

from fsar_ledger.errors import FsarLedgerError, LedgerCorrupted
from fsar_ledger.ledger.codec import upcast_rows
from fsar_ledger.ledger.releases import FINGERPRINTS, RELEASE, SCHEMAS
from fsar_ledger.ledger.schema import COLUMNS, RETIRED, Kind
from fsar_ledger.ledger.segment import read_table

if TYPE_CHECKING:
    from .database import Database

_SQL_TYPES: dict[Kind, str] = {"string": "VARCHAR", "integer": "BIGINT", "boolean": "BOOLEAN", "strings": "VARCHAR[]"}
_STORED, _UPCAST = "events_as_stored", "events_upcast"


def hold_segments(database: "Database", segments: Sequence[Path], releases: Sequence[str]) -> None:
    """The database's `events` are the rows of these segments, given the release of each. Raises: as `upcast`."""
    newest = upcast(database, segments)
    alike: dict[str, list[Path]] = {}
    for path, release in zip(segments, releases, strict=True):
        alike.setdefault(FINGERPRINTS[release], []).append(path)
    present = {FINGERPRINTS[release]: frozenset(SCHEMAS[release].names) for release in releases}
    hold_events(database, [_select(paths, present[fingerprint]) for fingerprint, paths in alike.items()], newest)
    if newest is None and alike.keys() == {FINGERPRINTS[RELEASE]}:
        database.source = _parquet(segments)


def _select(paths: Sequence[Path], present: frozenset[str]) -> str:
    columns = ", ".join(f'"{name}"' if name in present else f'CAST(NULL AS {_SQL_TYPES[kind]}) AS "{name}"' for name, kind in COLUMNS.items())
    return f"SELECT {columns} FROM {_parquet(paths)}"


def _parquet(paths: Sequence[Path], *options: str) -> str:
    """These files as SQL reads them."""
    files = ", ".join("'" + str(path).replace("'", "''") + "'" for path in paths)
    return f"read_parquet([{files}], {', '.join(('hive_partitioning = false', *options))})"


def upcast(database: "Database", segments: Sequence[Path]) -> pa.Table | None:
    """The rows of retired types in these segments, as their newest versions; None if there are none. The database looks which segments hold some.

    Raises:
        LedgerCorrupted: A segment that holds some cannot be read, or does not hold valid events.
    """
    if not RETIRED or not segments:
        return None
    tables = [rows for path in _holding(database, segments) if (rows := _upcast_segment(path)) is not None]
    return pa.concat_tables(tables) if tables else None


def _holding(database: "Database", segments: Sequence[Path]) -> Sequence[Path]:
    """The segments that hold rows of retired types; all of them where one cannot be read, so that reading it says what is wrong."""
    try:
        found = database.direct(f"SELECT DISTINCT filename FROM {_parquet(segments, 'filename = true')} WHERE type IN ({_tags()})")
    except FsarLedgerError:
        return segments
    return [path for path in segments if (str(path),) in found]


def _tags() -> str:
    """The retired types as SQL lists them."""
    return ", ".join(f"'{tag}'" for tag in RETIRED)


def _upcast_segment(path: Path) -> pa.Table | None:
    try:
        return upcast_rows(read_table(path))
    except LedgerCorrupted as error:
        raise type(error)(f"{path}: {error}") from error


def hold_events(database: "Database", parts: Sequence[str], newest: pa.Table | None) -> None:
    """The database's `events` are the rows of these SELECTs, but those of retired types are the ones given as their newest versions."""
    if newest is not None:
        database.hold(_UPCAST, newest)
        parts = [*(f"SELECT * FROM ({part}) WHERE type NOT IN ({_tags()})" for part in parts), f"SELECT * FROM {_UPCAST}"]
    database.define("events", "\nUNION ALL\n".join(parts))


def hold_dataset(database: "Database", stored: Any, newest: pa.Table | None) -> None:
    """As `hold_events`, for rows that an Arrow dataset or table holds with the columns of today."""
    if newest is None:
        database.hold("events", stored)
        return
    database.hold(_STORED, stored)
    hold_events(database, [f"SELECT * FROM {_STORED}"], newest)
