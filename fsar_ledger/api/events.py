"""The events of a ledger by run, robot and time: as typed objects, as a table, or as lines of text.

The lines are rows of `queries/facts/log_lines.sql`. Those of all runs are read segment by segment, or by groups of
segments that share runs, with one in memory at a time.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import duckdb
import pyarrow as pa
import pyarrow.compute as pc

from fsar_ledger.base import printable
from fsar_ledger.base.errors import SequenceConflict, UsageError, option
from fsar_ledger.designs.registered import known_names
from fsar_ledger.events import CONCERNS, Event
from fsar_ledger.events.envelope import flat
from fsar_ledger.ledger.opening import Pause, growth, open_for_answers
from fsar_ledger.ledger.rows import codec
from fsar_ledger.ledger.rows.schema import COLUMNS, ENVELOPE, RELEASE, SCHEMA
from fsar_ledger.ledger.store.locations import chain_of, counted_rows, record_of, whole_groups, whole_runs, wholes_of
from fsar_ledger.ledger.store.read import View
from fsar_ledger.metrics import relation
from fsar_ledger.metrics.connection import Value
from fsar_ledger.metrics.cuts import carried_on
from fsar_ledger.metrics.database import Database, connect, from_table
from fsar_ledger.metrics.provenance import Provenance, of_rows
from fsar_ledger.metrics.verified import is_verified

from .log import ALL
from .lookup import resting_on_rows, robot_of, run_time
from .names import Time, microseconds, separated
from .table import Table

if TYPE_CHECKING:
    import polars as pl

_ENVELOPE = {field.name for field in ENVELOPE}
NAMING = {name: kind for name, kind in COLUMNS.items() if name not in _ENVELOPE and kind in ("string", "strings")}
"""The columns that can name a robot."""


class Filter(NamedTuple):
    """A filter of events; None takes all. Times are microseconds, from `since_us` and before `until_us`."""

    run: str | None = None
    since_us: int | None = None
    until_us: int | None = None
    robot: str | None = None

    def takes(self, time_us: int, event: Event) -> bool:
        """Return whether to take an event of the run."""
        return (
            (self.since_us is None or time_us >= self.since_us)
            and (self.until_us is None or time_us < self.until_us)
            and (self.robot is None or names(event, self.robot))
        )

    def sql(self) -> tuple[str, dict[str, str | int]]:
        """Return the same filter as a SELECT over `events`, and its parameters."""
        conditions: list[str] = []
        values: dict[str, str | int] = {}
        for name, value, condition in (
            ("run", self.run, "run_id = $run"),
            ("since", self.since_us, "time_us >= $since"),
            ("until", self.until_us, "time_us < $until"),
        ):
            if value is not None:
                conditions.append(condition)
                values[name] = value
        if self.robot is not None:
            values |= {"robot": self.robot, "agents": _agents(self.robot)}
            conditions.append(f"({' OR '.join(_naming(name, kind) for name, kind in NAMING.items())})")
        where = f" WHERE {' AND '.join(conditions)}" if conditions else ""
        return f"SELECT * FROM events{where} ORDER BY run_id, seq", values


def _naming(name: str, kind: str) -> str:
    if kind == "string":
        return f'"{name}" = $robot OR starts_with("{name}", $agents)'
    return f'len(list_filter("{name}", lambda one: one = $robot OR starts_with(one, $agents))) > 0'


def _agents(robot: str) -> str:
    """Return the prefix of the principals of a robot's agents (DHMA splits a robot into four)."""
    return f"agent/{robot.removeprefix('robot/')}/"


def names(event: Event, robot: str) -> bool:
    """Return whether a field of the event, or an item of one, is this robot or an agent of it."""
    agents = _agents(robot)
    for value in flat(event).values():
        for text in value if isinstance(value, tuple) else (value,):
            if isinstance(text, str) and (text == robot or text.startswith(agents)):
                return True
    return False


def span(since: Time, until: Time) -> tuple[int | None, int | None]:
    """Return both times in microseconds. Raises: UsageError if one is not a time, or the second is not later."""
    since_us, until_us = microseconds(option("since"), since), microseconds(option("until"), until)
    if since_us is not None and until_us is not None and since_us >= until_us:
        raise UsageError(
            f"{option('since', since)} and {option('until', until)}: expected an earlier time first; the second itself "
            "is not included"
        )
    return since_us, until_us


class LoggedEvent(NamedTuple):
    """An event with its run, its seq there, its time, and the seq of the event that caused it (None: none did)."""

    run: str
    seq: int
    time_us: int
    caused_by: int | None
    event: Event

    @property
    def time_s(self) -> float:
        """Return the time in seconds of run time."""
        return self.time_us / 1_000_000


class Events:
    """A selection of a ledger's events; every method reads the ledger anew.

    Iterating yields a `LoggedEvent` for each, in the order of the ledger, with one segment in memory at a time: runs
    that were recorded at the same time are interleaved. Events of retired types are yielded as their newest version.
    If any run continues another, runs are yielded whole instead, a chain of them as one run with consecutive seqs.
    """

    def __init__(self, path: Path, meant: Filter, demanded: str | None = None) -> None:
        self._path, self._meant, self._demanded = path, meant, demanded

    def __iter__(self) -> Iterator[LoggedEvent]:
        view = open_for_answers(self._path)
        is_verified(view, self._demanded)
        for run in self._runs(view):
            rows = zip(run.times_us, run.caused_by, run.events, strict=True)
            for seq, (time_us, caused_by, event) in enumerate(rows, run.first):
                if self._meant.takes(time_us, event):
                    yield LoggedEvent(run.run_id, seq, time_us, caused_by, event)

    def _runs(self, view: View) -> Iterator[codec.LedgerRun]:
        """Yield the runs, whole or in the pieces that the ledger stores."""
        if self._meant.run is not None and len(chain_of(view, self._meant.run)) > 1:
            yield record_of(view, self._meant.run)
            return
        if self._meant.run is None and wholes_of(view):
            yield from whole_runs(view)
            return
        for table in view.tables():
            if self._meant.run is not None:
                table = table.filter(pc.equal(table.column("run_id"), self._meant.run))
            if table.num_rows:
                yield from codec.decode(table, is_whole=False)

    def table(self) -> Table:
        """Return a row for each event, by run and seq; columns that its type does not have are NULL."""
        sql, values = self._meant.sql()
        with connect(self._path, demanded=self._demanded) as database:
            return Table(database.table(sql, values).cast(SCHEMA), of_rows(database))

    def arrow(self) -> pa.Table:
        """Return `table` as an Arrow table."""
        return self.table().arrow()

    def polars(self) -> "pl.DataFrame":
        """Return `table` as a polars data frame."""
        return self.table().polars()

    def duckdb(self) -> duckdb.DuckDBPyRelation:
        """Return `table` as a DuckDB relation in a private, in-memory database."""
        return duckdb.connect(":memory:").from_arrow(self.arrow())


_QUERY = "facts/log_lines"
_PLURALS = {f"{name}s": name for name in CONCERNS} | {
    f"{name.removesuffix('y')}ies": name for name in CONCERNS if name.endswith("y")
}


class LogRequest(NamedTuple):
    """A request for log lines: of the events that the filter takes, those of these concerns (empty: of all)."""

    meant: Filter
    about: tuple[str, ...]


def asked_of(
    database: Database,
    run: str,
    since: Time,
    until: Time,
    robot: str | None,
    about: str | Sequence[str] | None,
    *,
    is_growing: bool = False,
) -> LogRequest:
    """Return the request with names in full, as that of the run is given; the run `all` selects every run.

    Raises:
        UsageError: There is no such robot or concern, or no such time in these runs. If the ledger is growing, any time
            is accepted.
    """
    concerns = concerns_of(about)
    name = None if run == ALL else run
    since, until = (run_time(database, option(side), time, name) for side, time in (("since", since), ("until", until)))
    since_us, until_us = span(since, until)
    if since_us is not None and not is_growing:
        with resting_on_rows(database.rows_verified):
            _require_in_run(database, name, since, since_us)
    full = None if robot is None else robot_of(database, robot, name)
    return LogRequest(Filter(name, since_us, until_us, full), concerns)


def concerns_of(about: str | Sequence[str] | None) -> tuple[str, ...]:
    """Return the concerns of these words, which may be plural and separated by commas. Raises: As `known_names`."""
    return known_names("concern", [_PLURALS.get(word, word) for word in separated(about)], CONCERNS)


def timeline(database: Database, asked: LogRequest) -> Table:
    """Return the requested lines, by run and seq, with their provenance. Raises: As `Database.table`."""
    return Table(_lines(database, asked), about_of(database, asked))


def about_of(database: Database, asked: LogRequest) -> Provenance:
    """Return the provenance of these lines, with `not_observed` limited to the requested concerns."""
    provenance = of_rows(database, database.library.find(_QUERY), asked.meant.run)
    missing = tuple(gap for gap in provenance.not_observed if not asked.about or gap.concern in asked.about)
    return Provenance(provenance.head, provenance.rows_verified, None, missing)


def stream(
    ledger: Path, asked: LogRequest, about: Provenance, demanded: str | None, pause: Pause | None
) -> Iterator[Table]:
    """Yield the lines of all runs in batches; with `pause`, continue with later commits as they appear.

    Args:
        ledger: Its folder.
        asked: The requested lines.
        about: The provenance, except for head and rows.
        demanded: As in `connect`.
        pause: Called before each check for more commits; None: end after the present ones.

    Raises:
        LedgerCorrupted: The ledger is damaged, or no longer the one whose lines were yielded.
    """
    carried: _Carried | None = None
    threshold = AFRESH
    for view, first in growth(ledger, pause):
        provenance = Provenance(view.head, is_verified(view, demanded), None, about.not_observed)
        is_long = pause is not None and view.head.size >= threshold
        threshold = view.head.size + AFRESH if is_long else threshold
        if (rows := None if carried is None else _later(view, carried)) is not None:
            with from_table(rows) as database:
                lines = _lines(database, asked, _untold(view, first))
                carried = _carried(database, view) if is_long else carried
            yield Table(lines, provenance)
            continue
        carried = None
        for group in whole_groups(view):
            if view.end(group[-1]) > first:
                untold = _untold(view, first) if view.first(group[0]) < first else None
                carries = is_long and group[-1] == len(view.releases) - 1
                try:
                    lines, carried = _lines_of(view, group, asked, untold, carries)
                except SequenceConflict:  # a compaction replaced a segment; the view now has a copy of its rows
                    lines, carried = _lines_of(view, group, asked, untold, carries)
                yield Table(lines, provenance)


AFRESH = 20_000
"""The number of new events after which a followed ledger is reduced to the events that later lines may need."""
_BEGINNINGS = ("TaskArrived.v1", "OutsiderRequestInjected.v1")


class _Carried(NamedTuple):
    """The events before index `until` of the ledger that later lines of its only run may need.

    `begins` is the first of the runs that the run consists of.
    """

    begins: str
    events: pa.Table
    until: int


def _carried(database: Database, view: View) -> _Carried | None:
    """Return the events to carry over; None if there are several runs, or an incomplete one."""
    runs = database.table("SELECT DISTINCT run_id FROM events")["run_id"].to_pylist()
    if len(runs) != 1:
        return None
    events = carried_on(database)
    return None if events is None else _Carried(chain_of(view, runs[0])[0], events.select(SCHEMA.names), view.head.size)


def _later(view: View, carried: _Carried) -> pa.Table | None:
    """Return the carried events and those since, as events of the whole run.

    None if some are of other runs, or about a task that was not carried.
    """
    ends = [view.end(number) for number in range(len(view.releases))]
    if any(end > carried.until and release != RELEASE for end, release in zip(ends, view.releases, strict=True)):
        return None
    rows = _from(view, carried.until, SCHEMA.names)
    names = rows["run_id"].unique().to_pylist()
    whole = wholes_of(view).get(names[-1], names[-1])
    if (chain := chain_of(view, whole))[0] != carried.begins or not {*names} <= {*chain}:
        return None
    rows = rows.filter(pc.greater(rows["seq"], 0))  # event 0 of each part repeats that of the first
    counted = counted_rows(view, rows.select(["run_id", "seq"]))
    cause = rows["caused_by"]
    causes = pc.if_else(pc.equal(cause, 0), 0, pc.add(cause, pc.subtract(counted["seq"], rows["seq"])))
    parts = [(carried.events, {"run_id": pa.array([whole] * len(carried.events))})]
    parts += [(rows, {"run_id": counted["run_id"], "seq": counted["seq"], "caused_by": causes})]
    events = pa.concat_tables(
        pa.table([new.get(name, table[name]) for name in SCHEMA.names], schema=SCHEMA) for table, new in parts
    )
    begun = events.filter(pc.is_in(events["type"], pa.array(_BEGINNINGS)))["task_id"]
    forgotten = pc.invert(pc.is_in(rows["task_id"].drop_null(), begun.combine_chunks()))
    return None if pc.any(forgotten, min_count=0).as_py() else events


def _lines(database: Database, request: LogRequest, untold: pa.Table | None = None) -> pa.Table:
    """Return the requested lines of all runs here, of the events `untold` alone if given, in ledger order."""
    select, values = request.meant.sql()
    bound: dict[str, Value] = dict(values)
    conditions = ["run_id = $run"] if request.meant.run is not None else []
    if request.about:
        conditions.append("list_contains($about, concern)")
        bound["about"] = list(request.about)
    if values.keys() - {"run"}:
        conditions += _among(database, f"SELECT run_id, seq FROM ({select})", values)
    if untold is not None:
        database.hold("untold", untold)
        conditions += _among(database, "SELECT run_id, seq FROM untold")
    bound["runs"] = [row["run_id"] for row in database.rows("SELECT run_id FROM events WHERE seq = 0")]
    where = f"WHERE {' AND '.join(conditions)}" if conditions else ""
    return database.table(f"SELECT * FROM log_lines {where} ORDER BY list_position($runs, run_id), seq", bound)


def _among(database: Database, chosen: str, values: Mapping[str, Value] | None = None) -> list[str]:
    """Return the conditions that an event is among the `chosen` ones.

    Only the second reaches the scans of the events, so that a moment of a long run is not as slow as all of it.
    """
    span = f"SELECT coalesce(min(seq), 0) AS first, coalesce(max(seq), -1) AS last FROM ({chosen})"
    [bounds] = database.rows(span, values)
    return [f"(run_id, seq) IN ({chosen})", f"seq BETWEEN {bounds['first']} AND {bounds['last']}"]


def _lines_of(
    view: View, group: Sequence[int], asked: LogRequest, untold: pa.Table | None, carries: bool
) -> tuple[pa.Table, _Carried | None]:
    """Return the requested lines of these segments, and what later lines may need if it `carries` something over."""
    segments, releases = [view.segment(number) for number in group], view.releases
    with Database(view.head, segments) as database:
        relation.hold_segments(database, segments, [releases[number] for number in group])
        return _lines(database, asked, untold), _carried(database, view) if carries else None


def _untold(view: View, first: int) -> pa.Table:
    """Return the run and seq of the events from this index on, as counted in whole runs."""
    return counted_rows(view, _from(view, first, ["run_id", "seq"]))


def _from(view: View, first: int, columns: list[str]) -> pa.Table:
    """Return these columns of the events from this index on, from segments and the journal."""
    schema = pa.schema([SCHEMA.field(name) for name in columns])
    return pa.concat_tables(table.cast(schema) for table in view.tables_from(first, columns))


def _require_in_run(database: Database, run: str | None, since: Time, since_us: int) -> None:
    """Require that the run, or any if it is None, has not ended before this time. Raises: UsageError."""
    sql = "SELECT max(time_us) AS end_us FROM events WHERE $run IS NULL OR run_id = $run"
    ((end_us),) = (row["end_us"] for row in database.rows(sql, {"run": run}))
    if end_us is None or since_us <= end_us:
        return
    where = "the last of all runs" if run is None else f"run {printable.value(run)}"
    raise UsageError(f"{option('since', since)}: {where} ends at {end_us / 1_000_000:.3f} s, expected an earlier time")
