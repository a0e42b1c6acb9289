"""Logs of OCEL 2.0 (ocel-standard.org), JSON and SQLite: their objects, and their events in order of time."""

import heapq
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from itertools import groupby
from pathlib import Path
from typing import Any, Protocol
from urllib.parse import quote

import msgspec

from fsar_ledger.base.errors import UsageError
from fsar_ledger.base.printable import value

from .adapter import BROKEN, OBJECT, RAW_LIST, RAW_OBJECT, Input, Record, unreadable, utc_us

SQLITE = b"SQLite format 3\0"
TABLES = ("event", "event_map_type", "event_object", "object", "object_map_type", "object_object")
ENVELOPE = ("ocel_id", "ocel_time", "ocel_changed_field")
MAX_US = 4_000_000_000_000_000
"""More than a century around 1970: times further apart are no whole numbers that every reader of JSON keeps."""


class Item(msgspec.Struct, frozen=True):
    """An event, or an object, whose time is None. `attributes` are names and values, `related` ids and qualifiers."""

    id: str
    kind: str
    time_us: int | None
    attributes: tuple[tuple[str, Any], ...]
    related: tuple[tuple[str, str], ...]
    raw: bytes


class Log(Protocol):
    """A log that can be read more than once."""

    def event_types(self) -> list[str]:
        """Return the types of events that the log declares."""
        ...

    def objects(self) -> Iterator[Item | Record]:
        """Yield the objects, and a record for each that cannot be read."""
        ...

    def events(self) -> Iterator[Item | Record]:
        """Yield the events by time, and a record for each that cannot be read."""
        ...


def opened_log(one: Input) -> Log:
    """Return the log in this input, which is at its beginning before and after.

    Raises: UsageError for what is no such log, and for a database that comes from standard input.
    """
    begin = one.file.read(len(SQLITE)) if one.path is not None else b""
    if one.path is not None:
        one.file.seek(0)
        if begin == SQLITE:
            return SqliteLog(one.path)
    text = one.file.read()
    if one.path is not None:
        one.file.seek(0)
    elif text.startswith(SQLITE):
        raise UsageError("stdin: found an SQLite database, expected JSON; name the file of the database")
    return JsonLog(value(str(one.path or one.name)), text)


class JsonLog:
    """A log in JSON, with the memory of its text."""

    def __init__(self, name: str, text: bytes) -> None:
        expected = "expected a log of OCEL 2.0: an object with events and objects"
        try:
            top = RAW_OBJECT.decode(text)
        except BROKEN as error:
            raise UsageError(f"{name}: {error!s:.200}; {expected}, whole") from error
        if "ocel:events" in top:
            raise UsageError(f"{name}: found OCEL 1.0 (ocel:events), {expected}; convert it, as pm4py can")
        try:
            self._objects, self._events = (RAW_LIST.decode(top[part]) for part in ("objects", "events"))
            types = msgspec.json.decode(top.get("eventTypes", b"[]"), type=list[dict[str, Any]])
        except (KeyError, *BROKEN) as error:
            found = ", ".join(sorted(top)[:9])
            raise UsageError(f"{name}: found an object with {value(found)} ({error!s:.90}), {expected}") from error
        self._types = [one["name"] for one in types if isinstance(one.get("name"), str)]

    def event_types(self) -> list[str]:
        """Return the types of events that the log declares."""
        return self._types

    def objects(self) -> Iterator[Item | Record]:
        """Yield the objects, and a record for each that cannot be read."""
        return (_item(raw, is_event=False) for raw in self._objects)

    def events(self) -> Iterator[Item | Record]:
        """Yield the events by time, and a record for each that cannot be read; what has no time keeps its place."""
        times, last = [], 0
        for raw in self._events:
            last = found if (found := _time(raw)) is not None else last
            times.append(last)
        # Few logs have another order than that of time, and sorting keeps the order of what happens at once.
        return (_item(self._events[at], is_event=True) for at in sorted(range(len(times)), key=times.__getitem__))


def time_us(text: object) -> int | None:
    """Return a time in microseconds since 1970, None for what is none, or no time at which anything was recorded."""
    found = utc_us(text)
    return found if found is not None and abs(found) < MAX_US else None


def _time(raw: msgspec.Raw) -> int | None:
    try:
        return time_us(OBJECT.decode(raw).get("time"))
    except BROKEN:
        return None


def _item(raw: msgspec.Raw, *, is_event: bool) -> Item | Record:
    try:
        found = OBJECT.decode(raw)
        name, kind = found["id"], found["type"]
        attributes = tuple(
            (one["name"] if is_event or not _is_change(one) else f"{one['name']}@{one['time']}", one.get("value"))
            for one in found.get("attributes") or ()
        )
        related = tuple((one["objectId"], str(one.get("qualifier") or "")) for one in found.get("relationships") or ())
    except (KeyError, TypeError, AttributeError, *BROKEN) as error:
        return unreadable(bytes(raw), f"{type(error).__name__}: {error}")
    if not all(isinstance(one, str) for one in (name, kind, *(each for each, _ in (*attributes, *related)))):
        return unreadable(bytes(raw), "expected texts as id, type, and names of attributes and objects")
    return Item(name, kind, time_us(found.get("time")) if is_event else None, attributes, related, bytes(raw))


def _is_change(attribute: Any) -> bool:
    """Return whether the attribute of an object has its value from a later time on: the first has that of 1970."""
    return bool(attribute.get("time")) and utc_us(attribute["time"]) != 0


class SqliteLog:
    """A log in an SQLite database, which is read row by row; only its sorting takes temporary files."""

    def __init__(self, path: Path) -> None:
        self._path = path
        with self._opened() as database:
            there = {str(name) for (name,) in database.execute("SELECT name FROM sqlite_master")}
            if lacking := [name for name in TABLES if name not in there]:
                raise UsageError(
                    f"{value(str(path))}: found no table {lacking[0]}, expected the tables of OCEL 2.0: "
                    f"{', '.join(TABLES)}, and one for each type"
                )

    @contextmanager
    def _opened(self) -> Iterator[sqlite3.Connection]:
        try:
            with closing(sqlite3.connect(f"file:{quote(str(self._path.resolve()))}?mode=ro", uri=True)) as database:
                database.text_factory = lambda text: text.decode(errors="backslashreplace")
                database.execute("PRAGMA trusted_schema = OFF")
                yield database
        except (sqlite3.Error, UnicodeError) as error:
            raise UsageError(
                f"{value(str(self._path))}: {error!s:.200}; expected a whole SQLite database with the tables of "
                "OCEL 2.0; write it again, or copy it whole"
            ) from error

    def event_types(self) -> list[str]:
        """Return the types of events that the log declares."""
        with self._opened() as database:
            return [str(kind) for (kind,) in database.execute("SELECT ocel_type FROM event_map_type ORDER BY rowid")]

    def objects(self) -> Iterator[Item | Record]:
        """Yield the objects by type, in the order of their table."""
        with self._opened() as database:
            _index(database, "object_object", "ocel_source_id", "ocel_target_id")
            for kind, table in _types(database, "object"):
                for (_, name), rows in groupby(_rows(database, "object", kind, table), lambda row: row[:2]):
                    attributes = tuple(
                        (column if row[2] is None or utc_us(row[2]) == 0 else f"{column}@{row[2]}", one)
                        for row in rows
                        for column, one in row[3].items()
                    )
                    yield _made(database, str(name), kind, None, None, attributes)

    def events(self) -> Iterator[Item | Record]:
        """Yield the events by time, and by their place in their table where times are equal."""
        with self._opened() as database:
            _index(database, "event_object", "ocel_event_id", "ocel_object_id")
            tables = [_events(database, kind, table) for kind, table in _types(database, "event")]
            for text, _, name, kind, values in heapq.merge(*tables, key=lambda one: one[:2]):
                yield _made(database, name, kind, text or None, time_us(text), tuple(values.items()))


_Event = tuple[str, int, str, str, dict[str, Any]]


def _events(database: sqlite3.Connection, kind: str, table: str | None) -> Iterator[_Event]:
    for place, name, time, values in _rows(database, "event", kind, table):
        yield str(time or ""), place, str(name), kind, values


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"'


def _types(database: sqlite3.Connection, part: str) -> list[tuple[str, str | None]]:
    """Return each type of events or objects with its table; None where the log names none."""
    found = database.execute(
        f"SELECT kinds.ocel_type, map.ocel_type_map FROM (SELECT ocel_type FROM {part} UNION SELECT ocel_type "
        f"FROM {part}_map_type) AS kinds LEFT JOIN {part}_map_type AS map USING (ocel_type) ORDER BY 1"
    )
    return [(str(kind), None if name is None else _quoted(f"{part}_{name}")) for kind, name in found.fetchall()]


def _rows(
    database: sqlite3.Connection, part: str, kind: str, table: str | None
) -> Iterator[tuple[int, Any, Any, dict[str, Any]]]:
    """Yield place, id, time and attributes of each event, or of each state of an object, of a type, in order."""
    own = f"SELECT rowid AS place, ocel_id AS name FROM {part} WHERE ocel_type = ?"
    if table is None:
        found = database.execute(f"{own} ORDER BY 1", (kind,))
    else:
        (strays,) = database.execute(
            f"SELECT count(*) FROM {table} WHERE ocel_id NOT IN (SELECT ocel_id FROM {part})"
        ).fetchone()
        if strays:
            raise sqlite3.DatabaseError(f"found {strays} rows of {table} that {part} does not have")
        there = {str(name) for _, name, *_ in database.execute(f"PRAGMA table_info({table})")}
        order = "ocel_time, place" if part == "event" else "place, ocel_time" if "ocel_time" in there else "place"
        found = database.execute(
            f"SELECT * FROM ({own}) AS own LEFT JOIN {table} AS told ON own.name = told.ocel_id ORDER BY {order}",
            (kind,),
        )
    columns = [name for name, *_ in found.description]
    for row in found:
        values = dict(zip(columns, row, strict=True))
        place, name, time = values.pop("place"), values.pop("name"), values.get("ocel_time")
        yield (
            place,
            name,
            time,
            {one: _plain(it) for one, it in values.items() if it is not None and one not in ENVELOPE},
        )


def _plain(found: Any) -> Any:
    return found.hex() if isinstance(found, bytes) else found


def _index(database: sqlite3.Connection, table: str, own: str, other: str) -> None:
    """Copy a table of relations and index it, in a temporary file: writers leave it without an index."""
    database.execute(
        f"CREATE TEMP TABLE relation AS SELECT {own} AS own, {other} AS other, ocel_qualifier AS qualifier FROM {table}"
    )
    database.execute("CREATE INDEX temp.relations ON relation (own)")


def _made(
    database: sqlite3.Connection,
    name: str,
    kind: str,
    time: str | None,
    time_us: int | None,
    attributes: tuple[tuple[str, Any], ...],
) -> Item:
    """Return an item with its relations; its bytes are those that it has in JSON."""
    found = database.execute("SELECT other, qualifier FROM relation WHERE own = ? ORDER BY rowid", (name,))
    related = tuple((str(other), str(qualifier or "")) for other, qualifier in found)
    document: dict[str, Any] = {"id": name, "type": kind} | ({} if time is None else {"time": time})
    document |= {
        "attributes": [{"name": one, "value": it} for one, it in attributes],
        "relationships": [{"objectId": one, "qualifier": it} for one, it in related],
    }
    return Item(name, kind, time_us, attributes, related, msgspec.json.encode(document))
