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

from fsar_ledger.base import utc
from fsar_ledger.base.errors import UsageError
from fsar_ledger.base.printable import value

from .adapter import BROKEN, OBJECT, RAW_LIST, RAW_OBJECT, Input, Record, json_object, unreadable

SQLITE = b"SQLite format 3\0"
TABLES = ("event", "event_map_type", "event_object", "object", "object_map_type", "object_object")
ENVELOPE = ("ocel_id", "ocel_time", "ocel_changed_field")
TIME_ORDER = "utc_us(CASE typeof(ocel_time) WHEN 'text' THEN CAST(ocel_time AS BLOB) ELSE ocel_time END)"
NO_TIME = -(1 << 62)
"""Before every time, as NULL is in SQLite."""
MAX_US = 4_000_000_000_000_000
"""More than a century around 1970: not every reader of JSON keeps larger whole numbers."""


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

    Raises: UsageError if it is not such a log, or a database from standard input.
    """
    head = one.file.read(len(SQLITE)) if one.path is not None else b""
    if one.path is not None:
        one.file.seek(0)
        if head == SQLITE:
            return SqliteLog(one.path)
    text = one.file.read()
    if one.path is not None:
        one.file.seek(0)
    elif text.startswith(SQLITE):
        raise UsageError("stdin: found an SQLite database, expected JSON; name the file of the database")
    return JsonLog(value(str(one.path or one.name)), text)


class JsonLog:
    """A log in JSON, whose text is kept in memory."""

    def __init__(self, name: str, text: bytes) -> None:
        expected = "expected a log of OCEL 2.0: an object with events and objects"
        if text.lstrip().startswith(b"<"):
            raise UsageError(f"{name}: found XML, expected OCEL 2.0 in JSON or SQLite; convert it, as pm4py can")
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
            keys = ", ".join(sorted(top)[:9])
            raise UsageError(f"{name}: found an object with {value(keys)} ({error!s:.90}), {expected}") from error
        self._types = [entry["name"] for entry in types if isinstance(entry.get("name"), str)]

    def event_types(self) -> list[str]:
        """Return the types of events that the log declares."""
        return self._types

    def objects(self) -> Iterator[Item | Record]:
        """Yield the objects, and a record for each that cannot be read."""
        return (_item(raw, is_event=False) for raw in self._objects)

    def events(self) -> Iterator[Item | Record]:
        """Yield the events by time, and a record for each unreadable one; an event without a time keeps its place."""
        times, last = [], 0
        for raw in self._events:
            last = time if (time := _time(raw)) is not None else last
            times.append(last)
        # Most logs are in order of time already, and the sort is stable.
        return (_item(self._events[index], is_event=True) for index in sorted(range(len(times)), key=times.__getitem__))


def time_us(text: object) -> int | None:
    """Return a time in microseconds since 1970; None if it is not a time, or not one within `MAX_US`."""
    time = utc.read_us(text)
    return time if time is not None and abs(time) < MAX_US else None


def _time(raw: msgspec.Raw) -> int | None:
    try:
        return time_us(OBJECT.decode(raw).get("time"))
    except BROKEN:
        return None


def _item(raw: msgspec.Raw, *, is_event: bool) -> Item | Record:
    try:
        document = json_object(raw)
        name, kind = document["id"], document["type"]
        attributes = tuple(
            (
                entry["name"] if is_event or not _is_change(entry) else f"{entry['name']}@{entry['time']}",
                entry.get("value"),
            )
            for entry in document.get("attributes") or ()
        )
        related = tuple(
            (entry["objectId"], str(entry.get("qualifier") or "")) for entry in document.get("relationships") or ()
        )
    except (KeyError, TypeError, AttributeError, *BROKEN) as error:
        return unreadable(bytes(raw), f"{type(error).__name__}: {error}")
    if not all(isinstance(entry, str) for entry in (name, kind, *(label for label, _ in (*attributes, *related)))):
        return unreadable(bytes(raw), "expected texts as id, type, and names of attributes and objects")
    return Item(name, kind, time_us(document.get("time")) if is_event else None, attributes, related, bytes(raw))


def _is_change(attribute: Any) -> bool:
    """Return whether the attribute is a later change of its value; the first value has the time 1970."""
    return bool(attribute.get("time")) and utc.read_us(attribute["time"]) != 0


class SqliteLog:
    """A log in an SQLite database, which is read row by row; only sorting uses temporary files."""

    def __init__(self, path: Path) -> None:
        self._path = path
        with self._opened() as database:
            tables = {str(name) for (name,) in database.execute("SELECT name FROM sqlite_master")}
            if lacking := [name for name in TABLES if name not in tables]:
                raise UsageError(
                    f"{value(str(path))}: found no table {lacking[0]}, expected the tables of OCEL 2.0: "
                    f"{', '.join(TABLES)}, and one for each type"
                )

    @contextmanager
    def _opened(self) -> Iterator[sqlite3.Connection]:
        try:
            with closing(sqlite3.connect(f"file:{quote(str(self._path.resolve()))}?mode=ro", uri=True)) as database:
                database.text_factory = lambda text: text.decode(errors="backslashreplace")
                database.create_function("utc_us", 1, _stored_us, deterministic=True)
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
                        (column if row[2] is None or utc.read_us(row[2]) == 0 else f"{column}@{row[2]}", attribute)
                        for row in rows
                        for column, attribute in row[3].items()
                    )
                    yield _item_with_relations(database, str(name), kind, None, None, attributes)

    def events(self) -> Iterator[Item | Record]:
        """Yield the events by time, those without one first, and by their position where times are equal."""
        with self._opened() as database:
            _index(database, "event_object", "ocel_event_id", "ocel_object_id")
            tables = [_events(database, kind, table) for kind, table in _types(database, "event")]
            for time, _, name, kind, text, values in heapq.merge(*tables, key=lambda row: row[:2]):
                own_us = None if time == NO_TIME else time
                yield _item_with_relations(database, name, kind, text or None, own_us, tuple(values.items()))


_Event = tuple[int, int, str, str, str, dict[str, Any]]


def _events(database: sqlite3.Connection, kind: str, table: str | None) -> Iterator[_Event]:
    for position, name, time, values in _rows(database, "event", kind, table):
        own_us = time_us(time)
        yield NO_TIME if own_us is None else own_us, position, str(name), kind, str(time or ""), values


def _stored_us(time: object) -> int | None:
    """Return the time of a column; its text comes as bytes, since it may be no UTF-8."""
    return time_us(time.decode(errors="replace") if isinstance(time, bytes) else time)


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"'


def _types(database: sqlite3.Connection, part: str) -> list[tuple[str, str | None]]:
    """Return each type of events or objects with its table; None if the log names none."""
    rows = database.execute(
        f"SELECT kinds.ocel_type, map.ocel_type_map FROM (SELECT ocel_type FROM {part} UNION SELECT ocel_type "
        f"FROM {part}_map_type) AS kinds LEFT JOIN {part}_map_type AS map USING (ocel_type) ORDER BY 1"
    )
    return [(str(kind), None if name is None else _quoted(f"{part}_{name}")) for kind, name in rows.fetchall()]


def _rows(
    database: sqlite3.Connection, part: str, kind: str, table: str | None
) -> Iterator[tuple[int, Any, Any, dict[str, Any]]]:
    """Yield position, id, time and attributes of each event, or of each state of an object, of a type, in order."""
    query = f"SELECT rowid AS place, ocel_id AS name FROM {part} WHERE ocel_type = ?"
    if table is None:
        cursor = database.execute(f"{query} ORDER BY 1", (kind,))
    else:
        (strays,) = database.execute(
            f"SELECT count(*) FROM {table} WHERE ocel_id NOT IN (SELECT ocel_id FROM {part})"
        ).fetchone()
        if strays:
            raise sqlite3.DatabaseError(f"found {strays} rows of {table} that {part} does not have")
        table_columns = {str(name) for _, name, *_ in database.execute(f"PRAGMA table_info({table})")}
        order = f"{TIME_ORDER}, place" if part == "event" else "place"
        order += f", {TIME_ORDER}" if part == "object" and "ocel_time" in table_columns else ""
        cursor = database.execute(
            f"SELECT * FROM ({query}) AS own LEFT JOIN {table} AS told ON own.name = told.ocel_id ORDER BY {order}",
            (kind,),
        )
    columns = [name for name, *_ in cursor.description]
    for row in cursor:
        values = dict(zip(columns, row, strict=True))
        position, name, time = values.pop("place"), values.pop("name"), values.get("ocel_time")
        yield (
            position,
            name,
            time,
            {
                column: _plain(attribute)
                for column, attribute in values.items()
                if attribute is not None and column not in ENVELOPE
            },
        )


def _plain(attribute: Any) -> Any:
    return attribute.hex() if isinstance(attribute, bytes) else attribute


def _index(database: sqlite3.Connection, table: str, source: str, target: str) -> None:
    """Copy a table of relations and index it, in a temporary file: writers leave it without an index."""
    database.execute(
        f"CREATE TEMP TABLE relation AS SELECT {source} AS own, {target} AS other, ocel_qualifier AS qualifier "
        f"FROM {table}"
    )
    database.execute("CREATE INDEX temp.relations ON relation (own)")


def _item_with_relations(
    database: sqlite3.Connection,
    name: str,
    kind: str,
    time: str | None,
    time_us: int | None,
    attributes: tuple[tuple[str, Any], ...],
) -> Item:
    """Return an item with its relations; its raw bytes are its JSON."""
    rows = database.execute("SELECT other, qualifier FROM relation WHERE own = ? ORDER BY rowid", (name,))
    related = tuple((str(other), str(qualifier or "")) for other, qualifier in rows)
    document: dict[str, Any] = {"id": name, "type": kind} | ({} if time is None else {"time": time})
    document |= {
        "attributes": [{"name": label, "value": content} for label, content in attributes],
        "relationships": [{"objectId": label, "qualifier": content} for label, content in related],
    }
    return Item(name, kind, time_us, attributes, related, msgspec.json.encode(document))
