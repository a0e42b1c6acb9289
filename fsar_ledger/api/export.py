"""The verbs `export` and `open`: a ledger, or an answer, as files for other programs."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated

import msgspec

from fsar_ledger.base import printable
from fsar_ledger.base.errors import QueryFailed, UsageError, WriteFailed, option
from fsar_ledger.base.progress import Progress, each

from .answers import Answer, Screen
from .names import Place, Run
from .verbs import Option, ParameterOption, RawOption, Shows, declare, switch, verb

if TYPE_CHECKING:
    from fsar_ledger.metrics.database import Database
    from fsar_ledger.metrics.library import Query
    from fsar_ledger.metrics.provenance import Provenance

    from .ledger import Ledger


SUFFIX = ".duckdb"
HEAD = "ledger_head"
"""The table that identifies a file that `open` wrote."""


class ExportResult(Answer, msgspec.Struct, frozen=True):
    """The number of rows (or tiles, or events) that were written to a file, and their provenance.

    `notes` describe what else the file holds and what it lacks.
    """

    row_count: int
    provenance: "Provenance"
    file: Path
    what: str = "rows"
    notes: tuple[str, ...] = ()

    def text(self, _: Screen) -> Iterator[printable.SafeText]:
        """Yield what was written."""
        yield printable.lines(f"{self.file}: {self.row_count:,} {self.what}", *self.notes)


@verb(
    "export out/ledger --out out/events.parquet",
    "export out/ledger --query metrics/run_metrics --out out/run_metrics.csv",
    "export out/ledger --tiles --out out/tiles",
    "export out/ledger --as ocel --run 1 --out out/run_1.json",
    takes=("verified",),
)
def export(
    ledger: "Ledger",
    out: Annotated[
        Place,
        Option(
            "--out",
            "FILE",
            "A .csv, .parquet, .ndjson or .jsonl file; with --as, .json or .mcap. Replaced if it exists. With --tiles "
            "or --as delta, a new folder.",
        ),
    ],
    query: str | None = declare("NAME", "Export the answer to this query.", "every event", complete="queries"),
    parameters: ParameterOption = None,
    *,
    raw: RawOption = False,
    tiles: bool = switch("Write the hashes of the tree and the checkpoint instead, as C2SP tlog-tiles."),
    format: str | None = declare(
        "FORMAT",
        "Write the format of another system: ocel (process mining), otlp (OpenTelemetry), mcap (Foxglove), perfetto "
        "or delta (Delta Lake).",
        flag="--as",
    ),
    run: Run | None = declare(
        "RUN", "With --as, only this run: its number, its name, or a unique part of it.", "all", complete="runs"
    ),
    progress: Annotated[Progress | None, Shows("exported", "commits")] = None,
) -> ExportResult:
    """Write events, or the answer to a query, to a file.

    The name of the file decides the format: CSV, Parquet, or JSON with one row a line. In CSV, lists are JSON text, and
    text is made harmless for spreadsheets and terminals unless --raw is given. The other formats hold the values
    unchanged. With --as, write events in the format of another system (docs/exports.md has the mapping); the answer
    says what the file lacks. A run that was cut becomes one run there, whichever part is named; without --as, and in
    delta, its parts are separate, as they are stored.

    Raises:
        UsageError: The file has another suffix, or lies inside a ledger; there is no such run or format, or the library
            of the format is not installed; parameters do not fit each other.
        WriteFailed: The file cannot be written.
    """
    from .files import require_place, write_events, write_table

    file = Path(out)
    if format is not None:
        if query is not None or parameters or raw or tiles:
            raise UsageError(
                f"{option('format', format)}: found a query, parameters, raw text or tiles beside it, expected none of "
                "them; leave one out"
            )
        from .files import write_as

        written, provenance = write_as(ledger, file, format, run, progress)
        return ExportResult(written.events, provenance, file, "events", written.notes)
    if run is not None:
        raise UsageError(
            f"{option('run', run)}: found no format beside it, expected one; give {option('format', 'FORMAT')}, or "
            "select the run in a query"
        )
    if tiles:
        if query is not None or parameters or raw:
            raise UsageError("export: found tiles and a query, parameters or raw text, expected tiles alone")
        from fsar_ledger.exports.rows import write_tiles

        from .lookup import present

        view, provenance = present(ledger)
        return ExportResult(write_tiles(view, file, progress), provenance, file, "tiles")
    require_place(file)
    if query is not None:
        table = ledger.query(query, **(parameters or {}))
        return ExportResult(write_table(file, table.stored, raw=raw), table.provenance, file)
    if parameters:
        raise UsageError(f"export: found parameter {next(iter(parameters))} and no query, expected both or neither")
    return ExportResult(*write_events(ledger.path, file, raw=raw, demanded=ledger.demanded, progress=progress), file)


class OpenResult(Answer, msgspec.Struct, frozen=True):
    """The file, how many relations and macros it holds, which queries it does not, and the provenance."""

    file: Path
    relations: int
    macros: int
    not_included: tuple[str, ...]
    provenance: "Provenance"

    def text(self, _: Screen) -> Iterator[printable.SafeText]:
        """Yield what the file holds."""
        events = self.provenance.head.events if self.provenance.head else 0
        yield printable.lines(
            f"{self.file}: {self.relations:,} relations and {self.macros:,} macros over {events:,} events",
            "call a macro with its parameters, as in `FROM denials(run := 1)`",
        )
        if self.not_included:
            yield printable.line(f"not included: {', '.join(self.not_included)}, which need fsar-ledger itself")


@verb("open out/ledger --out out/ledger.duckdb", takes=("verified",))
def open(  # named as the command is
    ledger: "Ledger",
    out: Place | None = declare("FILE", "A .duckdb file; replaced if `open` wrote it.", "LEDGER.duckdb here"),
    *,
    progress: Annotated[Progress | None, Shows("written", "views and queries")] = None,
) -> OpenResult:
    """Write a small DuckDB file for other programs: every event view and query under its name.

    DuckDB, notebooks, Polars and BI tools read the ledger through it and can join tables of their own. It reads the
    segments in their present place, at the present head; run `open` again after the ledger has grown or moved.

    Raises:
        UsageError: The name does not end in .duckdb, lies inside a ledger, or is of a file that is not ours.
        WriteFailed: The file cannot be written.
        NotALedger, FormatVersionMismatch, LedgerCorrupted, SequenceConflict: As `connect`.
    """
    import duckdb

    from fsar_ledger.metrics.database import connect

    from .files import whole_file

    source = ledger.path.resolve()
    file = Path(f"{source.name}{SUFFIX}") if out is None else Path(out)
    _require_ours(file)
    with whole_file(file) as temporary, TemporaryDirectory(prefix="fsar-ledger-") as folder:
        temporary.touch()
        temporary.unlink()  # the system's error is clearer than DuckDB's if it cannot be made
        # DuckDB takes a `?` in a name for its end, and leaves its log under the shorter name.
        link = Path(folder) / f"ledger{SUFFIX}"
        link.symlink_to(temporary.absolute())
        try:
            with connect(source, 1, ledger.demanded, link) as database:
                return _fill(database, source, file, progress)
        except (duckdb.Error, QueryFailed) as problem:  # our own queries are correct
            reason = str(problem).removeprefix("SQL: ").partition("\n")[0]
            raise WriteFailed(
                f"{file}: cannot be written ({reason}); the file was not changed: make room or choose another place"
            ) from problem


def _fill(database: "Database", ledger: Path, file: Path, progress: Progress | None) -> OpenResult:
    """Create every relation and macro, and the tables that describe the file."""
    import pyarrow as pa

    from fsar_ledger.metrics.provenance import Provenance

    queries = sorted(database.library.queries.values(), key=lambda query: bool(query.parameters))
    left_out = []
    _hold_facts(database, queries)
    for query in each(queries, progress):
        if not query.parameters:
            database.prepare(query.relation)
        elif not database.macro(query):
            left_out.append(query)
    macro_count = sum(bool(query.parameters) for query in queries)
    head = database.head
    assert head is not None
    database.hold(
        HEAD,
        pa.table(
            {
                "path": [str(ledger)],
                "commits": [head.commits],
                "events": [head.events],
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
    return OpenResult(
        file, len(queries) - macro_count, macro_count - len(left_out), tuple(names.to_pylist()), provenance
    )


def _hold_facts(database: "Database", queries: "Sequence[Query]") -> None:
    """Store the facts about single runs of a large ledger slice by slice, so that memory does not grow with it."""
    if database.slices is None:
        return
    database.hold_rows_of_slices([query.relation for query in queries])
    facts = [one for one in queries if one.is_stored and one.name.startswith("facts/") and "Partial" not in one.header]
    for some_runs in database.slices:
        for fact in facts:
            database.hold(fact.relation, some_runs.table(f"SELECT * FROM {fact.relation}"))


def _require_ours(file: Path) -> None:
    import duckdb

    from fsar_ledger.ledger.store.paths import require_outside
    from fsar_ledger.metrics.sql_values import literal

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
