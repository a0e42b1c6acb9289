"""The events of a ledger by run, robot and time, as typed objects or as a table."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import pyarrow as pa
import pyarrow.compute as pc

from fsar_ledger.base.errors import UsageError, option
from fsar_ledger.events import Event
from fsar_ledger.events.envelope import flat
from fsar_ledger.ledger.opening import open_for_answers
from fsar_ledger.ledger.rows import codec
from fsar_ledger.ledger.rows.schema import COLUMNS, ENVELOPE, SCHEMA
from fsar_ledger.metrics.database import connect
from fsar_ledger.metrics.provenance import of_rows
from fsar_ledger.metrics.verified import is_verified

from .names import Time, microseconds
from .table import Table

if TYPE_CHECKING:
    import duckdb
    import polars as pl

_ENVELOPE = {field.name for field in ENVELOPE}
NAMING = {name: kind for name, kind in COLUMNS.items() if name not in _ENVELOPE and kind in ("string", "strings")}
"""The columns that can name a robot."""


class Filter(NamedTuple):
    """Which events to take; None takes all. Times are microseconds, from `since_us` and before `until_us`."""

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
    """Return both times in microseconds. Raises: UsageError if one is no time, or the second is not later."""
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
    """Some events of a ledger; every method reads the ledger anew.

    Iterating yields a `LoggedEvent` for each, run by run in commit order, with one commit in memory at a time. Events
    of retired types come as their newest version.
    """

    def __init__(self, path: Path, meant: Filter, demanded: str | None = None) -> None:
        self._path, self._meant, self._demanded = path, meant, demanded

    def __iter__(self) -> Iterator[LoggedEvent]:
        view = open_for_answers(self._path)
        is_verified(view, self._demanded)
        for table in view.tables():
            if self._meant.run is not None:
                table = table.filter(pc.equal(table.column("run_id"), self._meant.run))
                if not table.num_rows:
                    continue
            for run in codec.decode(table):
                rows = zip(run.times_us, run.caused_by, run.events, strict=True)
                for seq, (time_us, caused_by, event) in enumerate(rows):
                    if self._meant.takes(time_us, event):
                        yield LoggedEvent(run.run_id, seq, time_us, caused_by, event)

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

    def duckdb(self) -> "duckdb.DuckDBPyRelation":
        """Return `table` as a DuckDB relation in a private, in-memory database."""
        import duckdb

        return duckdb.connect(":memory:").from_arrow(self.arrow())
