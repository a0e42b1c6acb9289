"""Write a file of DuckDB through which other programs read a ledger: every relation by its name, at one head."""

from pathlib import Path
from tempfile import TemporaryDirectory

import duckdb
import msgspec
import pyarrow as pa

from fsar_ledger.errors import QueryFailed, UsageError, WriteFailed, option
from fsar_ledger.ledger.store.paths import require_outside
from fsar_ledger.metrics.database import Database, connect
from fsar_ledger.metrics.paths import literal
from fsar_ledger.metrics.progress import Progress, each

from .files import whole_file
from .provenance import Provenance

SUFFIX = ".duckdb"
HEAD = "ledger_head"
"""The table by which a file of ours is known."""


class Opened(msgspec.Struct, frozen=True):
    """The file, how many relations and macros it holds, which queries it does not, and the provenance."""

    file: Path
    relations: int
    macros: int
    not_included: tuple[str, ...]
    provenance: Provenance


def write_database(
    ledger: Path, out: Path | None = None, demanded: str | None = None, progress: Progress | None = None
) -> Opened:
    """Write the file: views of the committed segments by their absolute paths, tables where views would be slow.

    `progress` is called with the queries that were written and their number.

    Raises:
        UsageError: The name does not end in .duckdb, lies inside a ledger, or is of a file that is not ours.
        WriteFailed: The file cannot be written.
        NotALedger, FormatVersionMismatch, LedgerCorrupted, SequenceConflict: As `connect`.
    """
    place = ledger.resolve()
    file = Path(f"{place.name}{SUFFIX}") if out is None else out
    _require_ours(file)
    with whole_file(file) as temporary, TemporaryDirectory(prefix="fsar-ledger-") as folder:
        temporary.touch()
        temporary.unlink()  # the system says better than DuckDB why there is no place for it
        # DuckDB takes a `?` in a name for the end of it, and leaves its log where the name then leads.
        link = Path(folder) / f"ledger{SUFFIX}"
        link.symlink_to(temporary.absolute())
        try:
            with connect(place, 1, demanded, link) as database:
                return _fill(database, place, file, progress)
        except (duckdb.Error, QueryFailed) as problem:  # our own queries have no mistakes
            said = str(problem).removeprefix("SQL: ").partition("\n")[0]
            raise WriteFailed(
                f"{file}: cannot be written ({said}); the file is as it was before: make room or choose another place"
            ) from problem


def _fill(database: Database, ledger: Path, file: Path, progress: Progress | None) -> Opened:
    """Make every relation and macro, and the tables that say what the file is."""
    found = sorted(database.library.queries.values(), key=lambda query: bool(query.parameters))
    left_out = []
    for query in each(found, progress):
        if not query.parameters:
            database.prepare(query.relation)
        elif not database.macro(query):
            left_out.append(query)
    asked = sum(bool(query.parameters) for query in found)
    head = database.head
    assert head is not None
    database.hold(
        HEAD,
        pa.table(
            {
                "path": [str(ledger)],
                "commits": [head.commits],
                "events": [head.size],
                "root": [head.root],
                "rows_verified": [database.rows_verified],
            }
        ),
    )
    names = pa.array([query.relation for query in left_out], pa.string())
    reasons = pa.array(["needs functions that only fsar-ledger has"] * len(left_out), pa.string())
    database.hold("not_included", pa.table({"name": names, "reason": reasons}))
    database.write_out()
    provenance = Provenance(head, database.rows_verified)
    return Opened(file, len(found) - asked, asked - len(left_out), tuple(names.to_pylist()), provenance)


def _require_ours(file: Path) -> None:
    if file.suffix != SUFFIX:
        raise UsageError(
            f"{file}: found a file name that ends in {file.suffix or 'nothing'!r}, expected {SUFFIX}; choose another "
            "name"
        )
    if "\\" in str(file.absolute()):
        raise UsageError(f"{file.absolute()}: found a backslash, which DuckDB takes for a slash; choose another place")
    require_outside(file, option("out", file))
    if file.is_dir():
        raise UsageError(f"{file}: found a folder, expected the name of a file; choose another name")
    if not file.exists():
        return
    try:
        with duckdb.connect(literal(file), read_only=True) as connection:
            is_ours = connection.execute(
                "SELECT count(*) FROM duckdb_tables() WHERE table_name = ?", [HEAD]
            ).fetchone() == (1,)
    except duckdb.Error:
        is_ours = False
    if not is_ours:
        raise UsageError(
            f"{file}: found a file that `open` has not written, or that another program has open; close it there, or "
            "choose another name"
        )
