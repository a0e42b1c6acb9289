"""The lines of runs: one that people read for each event, as rows of `queries/facts/log_lines.sql`.

The lines of all runs are told segment by segment, or by groups of those that share runs, with one in memory at a time.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import pyarrow as pa

from fsar_ledger.api.events import Filter
from fsar_ledger.base import printable
from fsar_ledger.base.errors import UsageError, option
from fsar_ledger.designs.registered import known
from fsar_ledger.events import CONCERNS
from fsar_ledger.ledger.opening import Pause, growth
from fsar_ledger.ledger.store.read import View
from fsar_ledger.metrics import relation
from fsar_ledger.metrics.connection import Value
from fsar_ledger.metrics.database import Database
from fsar_ledger.metrics.provenance import Provenance, of_rows
from fsar_ledger.metrics.verified import is_verified

from .events import span
from .log import ALL
from .lookup import resting_on_rows, robot_of, run_of, run_time
from .names import Run, Time, names_of
from .table import Table

_QUERY = "facts/log_lines"
_PLURALS = {f"{name}s": name for name in CONCERNS} | {
    f"{name.removesuffix('y')}ies": name for name in CONCERNS if name.endswith("y")
}


class LogRequest(NamedTuple):
    """Which lines to tell: of the events that the filter takes, those of these concerns (empty: of all)."""

    meant: Filter
    about: tuple[str, ...]


def asked_of(
    database: Database,
    ledger: Path,
    run: Run,
    since: Time,
    until: Time,
    robot: str | None,
    about: str | Sequence[str] | None,
    *,
    is_growing: bool = False,
) -> LogRequest:
    """Return what a person asks for, with full names; the run is `all` for every one.

    Raises:
        UsageError: There is no such run, robot or concern, or no such time in these runs. If the ledger is growing, any
            time may come.
    """
    concerns = concerns_of(about)
    name = None if run == ALL else run_of(database, run, ledger)
    since, until = (
        run_time(database, option(side), asked, name) for side, asked in (("since", since), ("until", until))
    )
    since_us, until_us = span(since, until)
    if since_us is not None and not is_growing:
        with resting_on_rows(database.rows_verified):
            _require_in_run(database, name, since, since_us)
    full = None if robot is None else robot_of(database, robot, name)
    return LogRequest(Filter(name, since_us, until_us, full), concerns)


def concerns_of(about: str | Sequence[str] | None) -> tuple[str, ...]:
    """Return the concerns of these words, which may be plural and parted by commas. Raises: As `known`."""
    words = [word.strip() for text in names_of(about) or () for word in text.split(",")]
    return known("concern", [_PLURALS.get(word, word) for word in words], CONCERNS)


def timeline(database: Database, asked: LogRequest) -> Table:
    """Return the lines asked for, by run and seq, with their provenance. Raises: As `Database.table`."""
    return Table(_lines(database, asked), about_of(database, asked))


def about_of(database: Database, asked: LogRequest) -> Provenance:
    """Return the provenance of these lines; of what is not observed only what is asked about."""
    found = of_rows(database, database.library.find(_QUERY), asked.meant.run)
    missing = tuple(one for one in found.not_observed if not asked.about or one.concern in asked.about)
    return Provenance(found.head, found.rows_verified, None, missing)


def stream(
    ledger: Path, asked: LogRequest, about: Provenance, demanded: str | None, pause: Pause | None
) -> Iterator[Table]:
    """Yield the lines of all runs, some at a time; with `pause`, go on with later commits as they come.

    Args:
        ledger: Its folder.
        asked: What to tell.
        about: The provenance, but for head and rows.
        demanded: As in `connect`.
        pause: Called before each look for more commits; None: end after those that are there.

    Raises:
        LedgerCorrupted: The ledger is damaged, or no longer the one whose lines were told.
    """
    for view, first in growth(ledger, pause):
        provenance = Provenance(view.head, is_verified(view, demanded), None, about.not_observed)
        for group in view.groups():
            if view.end(group[-1]) > first:
                yield Table(_lines_in(view, group, asked, first), provenance)


def _lines(database: Database, asked: LogRequest, *conditions_too: str) -> pa.Table:
    """Return the lines asked for of all runs here, in the order of the ledger."""
    meant, values = asked.meant.sql()
    bound: dict[str, Value] = dict(values)
    conditions = [*conditions_too, *(["run_id = $run"] if asked.meant.run is not None else [])]
    if asked.about:
        conditions.append("list_contains($about, concern)")
        bound["about"] = list(asked.about)
    if values.keys() - {"run"}:
        conditions.append(f"(run_id, seq) IN (SELECT run_id, seq FROM ({meant}))")
    bound["runs"] = [row["run_id"] for row in database.rows("SELECT run_id FROM events WHERE seq = 0")]
    where = f"WHERE {' AND '.join(conditions)}" if conditions else ""
    return database.table(f"SELECT * FROM log_lines {where} ORDER BY list_position($runs, run_id), seq", bound)


def _lines_in(view: View, group: Sequence[int], asked: LogRequest, first: int) -> pa.Table:
    """Return the lines of the events in these segments from this index on."""
    segments, releases = [view.segment(number) for number in group], view.releases
    with Database(view.head, segments) as database:
        relation.hold_segments(database, segments, [releases[number] for number in group])
        if view.first(group[0]) >= first:
            return _lines(database, asked)
        database.hold("untold", pa.concat_tables(view.tables_from(first, ["run_id", "seq"])))
        return _lines(database, asked, "(run_id, seq) IN (SELECT run_id, seq FROM untold)")


def _require_in_run(database: Database, run: str | None, since: Time, since_us: int) -> None:
    """Require that the run, or any if it is None, has not ended before this time. Raises: UsageError."""
    sql = "SELECT max(time_us) AS end_us FROM events WHERE $run IS NULL OR run_id = $run"
    ((end_us),) = (row["end_us"] for row in database.rows(sql, {"run": run}))
    if end_us is None or since_us <= end_us:
        return
    where = "the last of all runs" if run is None else f"run {printable.value(run)}"
    raise UsageError(f"{option('since', since)}: {where} ends at {end_us / 1_000_000:.3f} s, expected an earlier time")
