"""Own all DuckDB calls: a relation `events` and, over it, every packaged query.

Queries become views when first read, each after what it reads. Those whose header says `Stored` become tables, so that
the metrics are computed once per connection.
"""

import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import duckdb
import pyarrow as pa

from fsar_ledger.base import memory
from fsar_ledger.base.errors import FsarLedgerError, LimitReached, QueryFailed
from fsar_ledger.ledger.rows.segment import first_damage
from fsar_ledger.ledger.store.record import Head

from .library import Library, Query, library
from .own_sql import FOR_OLDER, FUNCTIONS, LOCK, check_columns, fault_of, first_lines, register, statements
from .sql_values import BATCH_ROWS, literal, quoted, values, with_all_columns

if TYPE_CHECKING:
    from .database import Slices

STORAGE = "v1.0.0"
"""The DuckDB version for which files are written: the oldest storage format that is still read."""

DUCKDB_SHARE = 0.75
"""The share of this process's memory that DuckDB may take."""

HELD_MIB = (256, 320, 640, 1_280)
"""DuckDB's memory limits over a sliced ledger, each raised to the next if it cannot spill enough, at last to all."""

OUT_OF_MEMORY = (duckdb.OutOfMemoryException, pa.ArrowMemoryError)
FAULTS_OF_SQL = (
    duckdb.ParserException,
    duckdb.BinderException,
    duckdb.CatalogException,
    duckdb.ConversionException,
    duckdb.OutOfRangeException,
    duckdb.PermissionException,
    duckdb.TransactionException,
    *OUT_OF_MEMORY,
)
"""DuckDB errors caused by the SQL or by this machine, never by a damaged segment."""

_Found = TypeVar("_Found")
_GIVEN = "given"
_relation = attrgetter("relation")
_CALL = re.compile(r"\b([a-z_0-9]+)\(")
Value = str | int | float | bool | None | list[str]


class Database:
    """A connection to a private in-memory DuckDB that holds nothing but views of `events`.

    Answers are bit-identical on any number of threads if queries sum integers, or floats in a fixed order; the packaged
    ones do.
    """

    def __init__(
        self,
        head: Head | None,
        segments: Sequence[Path],
        threads: int | None = None,
        queries: Library | None = None,
        *,
        rows_verified: bool | None = None,
        caches_files: bool = True,
        file: Path | None = None,
        slices: "Slices | None" = None,
        may_spill: bool = False,
        is_small: bool = False,
    ):
        self.head = head
        self.rows_verified = rows_verified
        """Whether a full verification compared the rows with the root of the head; None without a head."""
        self.is_for_others = file is not None
        """Whether the relations go to a file for other programs, which may read it with an older DuckDB."""
        self.library = queries or library()
        self.source: str | None = None
        """A relation with all columns and rows of `events`, except those of `changed`, that is cheaper to read.

        It reads segments, or rows as stored.
        """
        self.changed: frozenset[str] = frozenset()
        """Names, without version, of event types that differ between `events` and `source`."""
        self.absent: frozenset[str] = frozenset()
        """Event types known to have no row in `events`: their views read nothing."""
        self.slices = slices
        """The source of the rows of `Partial` queries; None where a ledger is not judged in slices."""
        # See docs/decisions/few-events-are-judged-from-tables.md.
        self.is_small = is_small
        """Whether events are few: then one thread is faster than two, and a table faster than planning nested views."""
        self._of_slices: set[str] = set()
        self._segments = tuple(segments)
        self._made: set[str] = set()
        self._macros: set[str] = set()
        self._given: dict[str, str] = {}  # kinds of the relations that no packaged query defines
        config: dict[str, Any] = {"threads": threads or 1} if threads or is_small else {}
        config |= {"storage_compatibility_version": STORAGE} if file else {}
        self._connection = duckdb.connect(literal(file) if file else ":memory:", config=config)
        if slices is not None and file is None:  # tables with a row per run then take a tenth of the memory
            self._connection.execute("ATTACH ':memory:' AS judged (COMPRESS)")
            self._connection.execute("USE judged")
        # The wide relation is read often: its files stay open. UTC and no progress bar make answers the same anywhere.
        for setting in (f"parquet_metadata_cache = {str(caches_files).lower()}", "TimeZone = 'UTC'"):
            self._connection.execute(f"SET {setting}")
        # In a notebook without ipywidgets the bar is off and rejects the setting.
        if self._connection.execute("SELECT current_setting('enable_progress_bar')").fetchone() != (False,):
            self._connection.execute("SET enable_progress_bar = false")
        # By default DuckDB would spill into `.tmp` of the working folder.
        self._closing = ExitStack()
        spilled = self._closing.enter_context(memory.folder_for_spilling()) if may_spill else ""
        self._connection.execute(f"SET temp_directory = {quoted(literal(Path(spilled)) if spilled else '')}")
        self._held_mib = [*HELD_MIB] if may_spill else []
        self._limit_memory()
        register(self._connection)

    def __enter__(self) -> "Database":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection; DuckDB complains at exit about an open one."""
        self._connection.close()
        self._closing.close()

    def hold(self, name: str, table: Any, *, is_copied: bool = False) -> None:
        """Make this Arrow table or dataset the relation of this name, or append a copy of it to earlier copies."""
        if not (is_copied or self.is_for_others):
            self._connection.register(name, table)
            self._made.add(name)
            self._given[name] = "held"
        else:
            self._connection.register(_GIVEN, table)
            if name in self._given:
                self._change(f"INSERT INTO {name} FROM {_GIVEN}")
            else:
                self.define(name, f"SELECT * FROM {_GIVEN}", is_stored=True)
            self._connection.unregister(_GIVEN)

    def refill(self, events: pa.Table) -> None:
        """Replace `events` by these few rows, in a DuckDB table; columns that they lack are NULL."""
        self.empty()
        self._connection.register(_GIVEN, with_all_columns(events))
        self._change(f"CREATE TABLE events AS SELECT * FROM {_GIVEN}")
        self._connection.unregister(_GIVEN)
        self._made.add("events")

    def empty(self) -> None:
        """Drop what was held, defined and stored; the views of queries stay, for new `events` of the same types."""
        for name, kind in sorted(self._given.items()):
            self.drop(name) if kind == "held" else self._change(f"DROP {kind} {name}")
            self._made.discard(name)
        self._given.clear()
        for name in sorted(self._made & {query.relation for query in self.library.queries.values() if query.is_stored}):
            self._change(f"DROP TABLE {name}")
            self._made.discard(name)
        self._change("DROP TABLE IF EXISTS events")

    def drop(self, name: str) -> None:
        """Drop the relation that `hold` made."""
        self._connection.unregister(name)
        self._made.discard(name)
        self._given.pop(name, None)

    def direct(self, sql: str) -> list[tuple[Any, ...]]:
        """Return the rows of one SELECT over files and the relations of this connection.

        It may not name packaged queries. Raises: as `table`.
        """
        with self._asking(UnicodeDecodeError):  # what a damaged file holds as text may be none
            return self._connection.execute(sql).fetchall()  # a relation would plan it twice

    def define(self, name: str, sql: str, *, is_stored: bool = False) -> None:
        """Make the SELECT, or with `is_stored` its current rows, the relation of this name.

        It replaces any packaged query. Raises: as `table`.
        """
        self._change(f"CREATE {'TABLE' if is_stored else 'VIEW'} {name} AS\n{sql}")
        self._made.add(name)
        self._given[name] = "TABLE" if is_stored else "VIEW"

    def undefine(self, name: str, *, is_stored: bool = False) -> None:
        """Drop the relation that `define` made."""
        self._change(f"DROP {'TABLE' if is_stored else 'VIEW'} {name}")
        self._made.discard(name)
        self._given.pop(name, None)

    def prepare(self, sql: str) -> None:
        """Create every relation that this SQL mentions, with everything that it reads."""
        mentioned = self.library.mentioned(sql)
        self.hold_rows_of_slices(mentioned)
        for query in self.library.needs(mentioned, self._given):
            if query.relation in self._made or query.parameters:
                continue
            is_table = self.keeps(query) or (self.is_small and not self.is_for_others)
            self._change(f"CREATE {'TABLE' if is_table else 'VIEW'} {query.relation} AS {self._body(query)}", query)
            self._made.add(query.relation)
            if is_table and self.slices is not None:
                self._change("CHECKPOINT")

    def hold_rows_of_slices(self, names: Collection[str]) -> None:
        """Hold the rows of the `Partial` queries that these relations read, unless a packaged query was replaced.

        Does nothing where a ledger is not judged in slices. Raises: As `table`.
        """
        if self.slices is None:
            return
        queries = self.library.partial(names, self._made)
        replaced = (self._given.keys() & self.library.relations.keys()) - self._of_slices - {"run_numbers"}
        whole = [one for one in queries if replaced.isdisjoint(map(_relation, self.library.needs([one.relation])))]
        for name, rows in self.slices.rows_of(whole) if whole else ():
            self.hold(name, rows, is_copied=True)  # which takes less memory
            self._of_slices.add(name)

    def keeps(self, query: Query) -> bool:
        """Return whether a query becomes a table here; in a file also if it calls our functions, which others lack."""
        if self.slices is not None and query.relation == "experiment_planned":  # few rows, read from all events
            return True
        return query.is_stored or (self.is_for_others and not FUNCTIONS.isdisjoint(_CALL.findall(query.sql)))

    def macro(self, query: Query) -> bool:
        """Make a query with parameters a table macro that takes them by name; False if it calls our functions."""
        if self.keeps(query):
            return False
        if query.relation in self._macros:
            return True
        self._macros.add(query.relation)
        for statement in statements(query):
            self.prepare(statement)
            self._change(statement)
        return True

    def write_out(self) -> None:
        """Write all that the file lacks; closing also does, but ignores errors. Raises: as `table`."""
        self._change(FOR_OLDER)
        self._change("CHECKPOINT")

    def _body(self, query: Query) -> str:
        """Return the SELECT of a packaged query, in the cheapest form here."""
        if query.tags and query.tags <= self.absent:
            return query.nothing
        is_changed = self.changed if not query.tags else self.changed & {tag.partition(".")[0] for tag in query.tags}
        if self.source is None or is_changed or not query.name.startswith("staging/"):
            return query.sql
        return query.reading_from({"events": self.source})

    def table(self, sql: str, params: Mapping[str, Value] | None = None) -> pa.Table:
        """Return the answer to one SELECT, with `$name` parameters bound.

        Raises:
            QueryFailed: DuckDB does not accept the SQL or its parameters, or it fails on the data.
            LedgerCorrupted: A segment cannot be read.
        """
        self.prepare(sql)
        return self._execute(sql, params)

    def rows(self, sql: str, params: Mapping[str, Value] | None = None) -> list[dict[str, Any]]:
        """Return the answer to one SELECT as dictionaries. Raises: as `table`."""
        self.prepare(sql)

        def fetch_rows() -> list[dict[str, Any]]:
            rows = list[dict[str, Any]]()
            cursor = self._connection.execute(sql, dict(params) if params else None)  # a relation would plan it twice
            names = [column[0] for column in cursor.description or ()]
            while batch := cursor.fetchmany(BATCH_ROWS):
                rows += [dict(zip(names, row, strict=True)) for row in batch]
            return rows

        with self._asking(UnicodeDecodeError):  # what a damaged file holds as text may be none
            return self._within(fetch_rows)

    def query(self, name: str, given: Mapping[str, str] | None = None) -> pa.Table:
        """Return the rows of a packaged query, sorted by all their columns from the left.

        Raises:
            UnknownQuery: There is no such query, or it has other parameters.
            QueryFailed: A value does not fit its parameter.
            LedgerCorrupted: A segment cannot be read.
        """
        query = self.library.find(name)
        bound = values(query.name, query.parameters, given or {})
        if not query.parameters:
            return self.table(f"SELECT * FROM {query.relation} ORDER BY ALL")
        self.prepare(query.sql)
        return self._execute(f"SELECT * FROM ({query.sql}\n) ORDER BY ALL", bound, query)

    def lock(self, seconds: int, memory_bytes: int) -> None:
        """Deny the connection access to all but what it holds; limit seconds and memory of a statement.

        An allow-list would permit writing, too. What DuckDB does not stop (a huge string) is the operating system's.
        """
        for setting in LOCK:
            self._connection.execute(f"SET {setting}")
        self._connection.execute(f"SET max_execution_time = {seconds * 1000}")
        self._connection.execute(f"SET memory_limit = '{memory_bytes} bytes'")
        self._connection.execute("SET lock_configuration = true")

    def only_read(self) -> None:
        """Forbid any further change to the relations, even by a SELECT whose steps insert or delete."""
        self._connection.execute("BEGIN TRANSACTION READ ONLY")

    def check_one_select(self, sql: str) -> None:
        """Check that the text is exactly one statement that only reads, judging by its type.

        Raises:
            QueryFailed: It is empty, does not parse, holds several statements, or one that is neither SELECT nor
                EXPLAIN.
        """
        try:
            statements = self._connection.extract_statements(sql)
        except duckdb.Error as error:
            raise QueryFailed(f"SQL: {first_lines(str(error))}") from error
        kinds = [statement.type.name for statement in statements]
        if kinds == ["MULTI"]:
            raise QueryFailed(
                "SQL: found a PIVOT that lists no values, which DuckDB does in two statements; name the values, as in "
                "PIVOT ... ON x IN ('a', 'b')"
            )
        if len(kinds) != 1 or kinds[0] not in ("SELECT", "EXPLAIN"):
            raise QueryFailed(
                f"SQL: found {', '.join(kinds[:5]) or 'no statement'}, expected exactly one SELECT or EXPLAIN; a "
                "ledger can only be read"
            )

    def batches(self, sql: str) -> Iterator[pa.RecordBatch]:
        """Yield the answer to one SELECT in batches; the first may be empty.

        The relations that it mentions must have been prepared.

        Raises:
            QueryFailed, LedgerCorrupted: As `table`; QueryFailed also for two columns of one name, or a type whose
                values cannot be passed on unchanged.
        """
        with self._asking(pa.ArrowException, OSError):
            relation = self._connection.sql(sql)
            check_columns(relation.columns, list(map(str, relation.types)))
            reader = relation.to_arrow_reader(BATCH_ROWS)
            yield pa.RecordBatch.from_pylist([], schema=reader.schema)
            yield from reader

    def _change(self, sql: str, query: Query | None = None) -> None:
        """Run a statement that makes or drops relations and has no answer; `query` is the packaged one in it."""
        with self._asking(query=query):
            # `sql` would make a relation of the empty answer, which takes as long as a small view.
            self._within(lambda: self._connection.execute(sql))

    def _execute(self, sql: str, params: Mapping[str, Value] | None, query: Query | None = None) -> pa.Table:
        """Return DuckDB's answer; its errors become ours."""
        with self._asking(query=query):
            return self._within(lambda: self._connection.sql(sql, params=dict(params or {}) or None).to_arrow_table())

    def _within(self, call: Callable[[], _Found]) -> _Found:
        """Call DuckDB, and again with more memory where it cannot spill enough."""
        while True:
            try:
                return call()
            except duckdb.OutOfMemoryException:
                if not self._held_mib:
                    raise
                del self._held_mib[0]
                self._limit_memory()

    def _limit_memory(self) -> None:
        limits = [] if (limit := memory.limit()) is None else [int(limit * DUCKDB_SHARE)]
        limits += [self._held_mib[0] << 20] if self._held_mib else []
        self._connection.execute(f"SET memory_limit = '{min(limits)} bytes'" if limits else "RESET memory_limit")

    @contextmanager
    def _asking(self, *others: type[Exception], query: Query | None = None) -> Iterator[None]:
        """Turn DuckDB's errors and these others into ours, and its error for Ctrl-C into KeyboardInterrupt."""
        handled: tuple[type[Exception], ...] = (duckdb.Error, *others)
        try:
            yield
        except handled as error:
            raise self._failure(error, query) from error
        except RuntimeError as error:
            if str(error) != "Query interrupted":
                raise
            raise KeyboardInterrupt from error

    def _failure(self, error: Exception, query: Query | None) -> FsarLedgerError:
        """Return the error to show a user.

        It blames the SQL, the text of `query` or, where the data may be the cause, the first unreadable segment.
        """
        if isinstance(error, OUT_OF_MEMORY) and memory.limit() is not None:
            return LimitReached(memory.exceeded_message())
        damage = None if isinstance(error, FAULTS_OF_SQL) else first_damage(self._segments)
        return damage or QueryFailed(fault_of(error, query, self.library))
