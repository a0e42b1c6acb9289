"""Resolve what a query names to the names in the ledger: runs, robots, actions, times and other parameters."""

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, timedelta
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from fsar_ledger.base import printable, utc
from fsar_ledger.base.errors import UsageError, option
from fsar_ledger.ledger.opening import open_for_answers
from fsar_ledger.ledger.store.locations import record_of, whole_of
from fsar_ledger.metrics.sql_values import FIXED, PRINCIPALS, TIME, Parameter, names_on_record, require_known
from fsar_ledger.metrics.verified import is_verified, is_verified_for_runs, require_runs

from .names import MAX_DIGITS, Place, Run, Time, known_name, microseconds, principal_named, run_named

if TYPE_CHECKING:
    from fsar_ledger.ledger.rows.codec import LedgerRun
    from fsar_ledger.ledger.store.read import View
    from fsar_ledger.metrics.database import Database
    from fsar_ledger.metrics.library import Query
    from fsar_ledger.metrics.provenance import Provenance

    from .ledger import Ledger

_EXTENT = "SELECT max(time_us) AS time_us, max(seq) AS seq FROM events WHERE $run IS NULL OR run_id = $run"
_WORDS = {"record": "kind of record", "case": "case number"}
_CLOCK = re.compile(r"\d{4}-\d\d-\d\d.*")


NOT_COMPARED = (
    "the rows that this rests on were not compared with the root of the ledger; `fsar-ledger verify` does that"
)


@contextmanager
def resting_on_rows(rows_verified: bool | None) -> Iterator[None]:
    """Add to an error about something missing from a ledger that its rows were not compared with the root, if so.

    None: there is no root.
    """
    try:
        yield
    except UsageError as error:
        if rows_verified is not False or f"{error}".endswith(NOT_COMPARED):
            raise
        raise UsageError(f"{error}; {NOT_COMPARED}") from error


class AboutRun(NamedTuple):
    """A requested run: a database over its events, its full name, and its number (None: it has none)."""

    database: "Database"
    run: str
    number: int | None


def resolve_run(view: "View", asked: object, demanded: str | None, *, is_whole: bool = False) -> str:
    """Return the full name of a run that is given by name, number or unique part; `is_whole`: of the last of its chain.

    Raises:
        UsageError: No run, or several, match, or it is neither text nor a whole number.
        SequenceConflict, LedgerCorrupted: As `is_verified_for_runs`, and `require_runs`.
    """
    with resting_on_rows(is_verified_for_runs(view, demanded)):
        if isinstance(asked, str) and view.has_run(asked):
            return whole_of(view, asked) if is_whole else asked
        names, way = view.run_names, f"`fsar-ledger query runs {printable.word(view.path)}` lists them"
        try:
            run = run_named(asked, names.runs, names.plans, way)
        except UsageError:
            require_runs(view)
            raise
        return whole_of(view, run) if is_whole else run


def no_run(ledger: Path) -> str:
    """Return the error text for a ledger without runs."""
    return f"{ledger}: found no run, so there is nothing to explain"


def resolve_or_first(view: "View", asked: object, demanded: str | None) -> str:
    """Return the full name of the requested run, or of the first, with those that continue it.

    Raises: UsageError if there is none, or as `is_verified`.
    """
    with resting_on_rows(is_verified_for_runs(view, demanded)):
        if isinstance(asked, str) and view.ordinal_of(asked):
            return asked
        if not view.run_names.runs:
            require_runs(view)
            raise UsageError(no_run(view.path))
        if asked is not None:
            return resolve_run(view, asked, demanded)
        return whole_of(view, view.run_names.runs[0])


@contextmanager
def about_run(view: "View", asked: object, demanded: str | None, *, is_whole: bool = False) -> Iterator[AboutRun]:
    """Yield a database about a run, by default the first; `is_whole`: with the runs that continue it.

    Raises:
        UsageError: As `resolve_or_first`.
        LedgerCorrupted, SequenceConflict: As `connect_run`.
    """
    from fsar_ledger.metrics.database import connect_run

    run = resolve_or_first(view, asked, demanded)
    run = whole_of(view, run) if is_whole else run
    with connect_run(view, run, demanded) as database:
        number = view.ordinal_of(run)
        yield AboutRun(database, run, number if number and not view.has_run(f"{number}") else None)


def robot_of(database: "Database", asked: str, run: str | None) -> str:
    """Return the full name of a robot of this run, or of any. Raises: UsageError if none matches."""
    return _name_on_record(database, "robot", asked, run)


def clock(started: object, time_us: int) -> str | None:
    """Return the time of day of a time in the run that this event begins; None if the event has no epoch."""
    epoch = getattr(started, "epoch", None)
    if epoch is None:
        return None
    when = utc.parsed(epoch) + timedelta(microseconds=time_us)
    return utc.iso_text(when.astimezone(UTC), "milliseconds")


def run_time(database: "Database", what: str, asked: Time, run: str | None) -> Time:
    """Return a time of day, such as `2026-03-01T10:00Z`, as seconds of run time; any other time as it is.

    Raises: UsageError if the run has no epoch, or began later.
    """
    if not isinstance(asked, str) or not _CLOCK.fullmatch(asked.strip()):
        return asked
    text = printable.value(asked, 80)
    try:
        when = utc.parsed(asked.strip())
    except ValueError as error:
        raise UsageError(f"{what}: found {text}, expected a time such as 2026-03-01T10:00Z") from error
    rows = database.rows("SELECT epoch FROM run_epochs WHERE run_id = $run", {"run": run})
    if not rows:
        of = "every run" if run is None else f"run {printable.value(run)}, which does not know when it began"
        raise UsageError(f"{what}: found the time of day {text} for {of}; expected seconds of run time, as 46.6s")
    epoch = rows[0]["epoch"].replace(tzinfo=UTC)
    seconds = (when - epoch) / timedelta(seconds=1)
    if seconds < 0:
        raise UsageError(f"{what}: found {text}, expected a time after the run began, {epoch.isoformat()}")
    return f"{seconds:.6f}"


def time_of(database: "Database", what: str, asked: Time, run: str | None) -> int | None:
    """Return a time in the run, or in the longest of all, in microseconds; None stays None.

    Raises:
        UsageError: It is not a time, or later than the last event.
    """
    time_us = microseconds(what, run_time(database, what, asked, run))
    (extent,) = database.rows(_EXTENT, {"run": run})
    if time_us is not None and extent["time_us"] is not None and time_us > extent["time_us"]:
        of = "the longest run" if run is None else f"run {printable.value(run)}"
        last = f"{extent['time_us'] / 1_000_000:.6f} s, the last event of {of}"
        with resting_on_rows(database.rows_verified):
            raise UsageError(f"{what}: found {time_us / 1_000_000:.6f} s, expected at most {last}")
    return time_us


def parameters_of(database: "Database", query: "Query", given: Mapping[str, object]) -> dict[str, str]:
    """Return the SQL values of these parameters of a query, each interpreted by its kind; None: its default.

    A run is given by its full name.

    Raises:
        UnknownQuery: The query has no parameter of a name.
        UsageError: A value names nothing in the ledger, or is not a time of the run.
    """
    require_known(query.name, query.parameters, given, query.parameters)
    texts = {
        name: value if isinstance(value, str) else f"{value!r}" for name, value in given.items() if value is not None
    }
    run = None
    values: dict[str, str] = {}
    for parameter in sorted(query.parameters.values(), key=lambda parameter: parameter.kind != "run"):
        text = texts.get(parameter.name, parameter.default)
        if text is None or text == parameter.default:
            continue
        if parameter.kind == "run":
            values[parameter.sql_name] = run = text
        else:
            values[parameter.sql_name] = _value(database, parameter, text, run)
    return values


def _name_on_record(database: "Database", kind: str, name: str, run: str | None) -> str:
    names, what = names_on_record(database, kind, run), _WORDS.get(kind, kind)
    with resting_on_rows(None if kind in FIXED else database.rows_verified):
        return principal_named(what, name, names) if kind in PRINCIPALS else known_name(what, name, names)


def _value(database: "Database", parameter: Parameter, text: str, run: str | None) -> str:
    """Return the SQL value of this text of a parameter. Raises: UsageError."""
    if parameter.kind == TIME:
        return str(time_of(database, parameter.name, text, run))
    if parameter.kind == "seq":
        return _seq(database, text, run)
    return _name_on_record(database, parameter.kind, text, run)


def _seq(database: "Database", text: str, run: str | None) -> str:
    """Return the seq of an event of this run, or of any. Raises: UsageError if there is none."""
    (extent,) = database.rows(_EXTENT, {"run": run})
    last = -1 if extent["seq"] is None else extent["seq"]
    if not (text.isascii() and text.isdecimal() and len(text) <= MAX_DIGITS and int(text) <= last):
        expected = f"a number from 0 to {last}" if last >= 0 else "none: there is no event"
        of = "of any run" if run is None else f"of run {printable.value(run)}"
        with resting_on_rows(database.rows_verified):
            raise UsageError(f"seq {printable.value(text)}: there is no such event {of}, expected {expected}")
    return text


def present(ledger: "Ledger") -> "tuple[View, Provenance]":
    """Return the ledger at its present head, and the provenance of an answer about it. Raises: As `open_ledger`."""
    from fsar_ledger.metrics.provenance import Provenance

    view = open_for_answers(ledger.path)
    return view, Provenance(view.head, is_verified(view, ledger.demanded))


def recorded(ledger: "Ledger", view: "View", run: Run, *, is_whole: bool = False) -> "LedgerRun":
    """Return the record of a run; `is_whole`: with the runs that continue it.

    Raises: UsageError if there is no such run.
    """
    return record_of(view, resolve_run(view, run, ledger.demanded, is_whole=is_whole))


def ledgers_of(ledger: "Ledger", other: "Ledger | Place | None") -> "list[Ledger]":
    """Return the ledger, and the other one if it is given, opened. Raises: UsageError unless that is a ledger."""
    if other is None:
        return [ledger]
    if not isinstance(other, str | PathLike | type(ledger)):
        raise UsageError(f"{option('other')}: found {other!r:.80}, expected a ledger, or its path")
    return [ledger, type(ledger)(other) if isinstance(other, str | PathLike) else other]
