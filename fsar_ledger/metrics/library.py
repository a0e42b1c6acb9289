"""The packaged queries: found by name, their headers read, their dependencies known.

A query file starts with comment lines `-- Key: text`. Title, Paper, Grain, Units, NULL and Example are required.
`Parameters: name = default, ...` makes it a query that is run with values instead of a view. `Stored: <reason>`
keeps its rows once computed for as long as a connection lives.

A file in `readings/` is another reading of a relation: it has its columns, reads it, and differs in the one thing that `Title`
says (`metrics/multiverse.py`). `Reading` is the number of ours, `Replaces` the relation, `Moves` the metrics that hang on it;
`Question` is what it answers otherwise than we do, and `Why` on what words of the paper.
"""

import difflib
import hashlib
import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable
from typing import get_args

import msgspec

from fsar_ledger.errors import UnknownQuery
from fsar_ledger.events.concerns import EVENTS_OF
from fsar_ledger.events.world import WorldEvent
from fsar_ledger.ledger.rows.schema import COLUMNS, ENVELOPE, LAYOUTS, Kind

REQUIRED_KEYS = ("Title", "Paper", "Grain", "Units", "NULL", "Example")
READINGS = "readings/"
READING_KEYS = ("Reading", "Question", "Replaces", "Moves", "Why")
SQL_TYPES: dict[Kind, str] = {"string": "VARCHAR", "integer": "BIGINT", "boolean": "BOOLEAN", "strings": "VARCHAR[]"}
KEYS = (*REQUIRED_KEYS, *READING_KEYS, "Parameters", "Stored")

_HEADER_LINE = re.compile(r"^-- (?:(\w+): )?\s*(.*)$")
_TEXT_OR_COMMENT = re.compile(r"'(?:[^']|'')*'|--[^\n]*|/\*.*?\*/", re.DOTALL)
_SOURCE = re.compile(r"\b(?:FROM|JOIN)\s+([a-z_][a-z0-9_]*)", re.IGNORECASE)
_TEXT_OR_SOURCE = re.compile(rf"{_TEXT_OR_COMMENT.pattern}|(\b(?:FROM|JOIN)\s+)([a-z_]\w*)\b(\s+AS\b)?", re.DOTALL)
_WORD = re.compile(r"[a-z_][a-z0-9_]*", re.IGNORECASE)
_VERSIONED = re.compile(r"(?<=[a-z0-9])(?=[A-Z])")


class Query(msgspec.Struct, frozen=True):
    """One relation that SQL can name: a packaged file, or a view that is generated from an event type.

    `name` is `folder/relation`; `parameters` maps names to defaults (None: a value must be given); `tag` is the event type whose view it is.
    """

    name: str
    sql: str
    header: dict[str, str]
    parameters: dict[str, str | None] = {}
    tag: str | None = None

    @property
    def relation(self) -> str:
        """The name by which SQL refers to it: the last part of its name."""
        return self.name.rpartition("/")[2]

    @property
    def is_stored(self) -> bool:
        """Whether its rows are computed once per connection."""
        return "Stored" in self.header

    @property
    def sha256(self) -> str:
        """The SHA-256 of its text, in hex."""
        return hashlib.sha256(self.sql.encode()).hexdigest()

    def sources(self) -> set[str]:
        """What stands behind FROM or JOIN: relations and its own steps."""
        return set(_SOURCE.findall(_TEXT_OR_COMMENT.sub(" ", self.sql)))

    def reading_from(self, others: Mapping[str, str]) -> str:
        """Its SQL, with other relations behind FROM and JOIN under the names that it knows: `FROM others[name] AS name`."""

        def renamed(match: re.Match[str]) -> str:
            before, name, alias = match.groups()
            if name not in others or others[name] == name:
                return match[0]
            return f"{before}{others[name]}{alias or f' AS {name}'}"

        return _TEXT_OR_SOURCE.sub(renamed, self.sql)


def parse(name: str, sql: str) -> Query:
    """The query of this text.

    Raises:
        ValueError: A required key is missing or empty, or a key is unknown or given twice.
    """
    header: dict[str, str] = {}
    last = None
    for line in sql.splitlines():
        if not (match := _HEADER_LINE.match(line)):
            break
        key, text = match.groups()
        if key is None and last is not None:
            header[last] += " " + text
            continue
        if key not in KEYS or key in header:
            raise ValueError(f"{name}: header line {line!r}: expected each of {', '.join(KEYS)} at most once")
        header[key] = text
        last = key
    required = (*REQUIRED_KEYS, *READING_KEYS) if name.startswith(READINGS) else REQUIRED_KEYS
    missing = [key for key in required if not header.get(key)]
    if missing:
        raise ValueError(f"{name}: header lacks {', '.join(missing)}")
    return Query(name, sql, header, _parameters(header.get("Parameters", "")))


def _parameters(text: str) -> dict[str, str | None]:
    """Names and defaults of `name = default, other`."""
    parameters: dict[str, str | None] = {}
    for part in filter(None, (part.strip() for part in text.split(","))):
        name, equals, default = (piece.strip() for piece in part.partition("="))
        parameters[name] = default if equals else None
    return parameters


def view_name(tag: str) -> str:
    """The name of an event type's view: `RequestIssued.v1` is `request_issued`."""
    return _VERSIONED.sub("_", tag.partition(".")[0]).lower()


def staging_sql(tag: str, source: str | None = "events") -> str:
    """The SELECT of one event type's envelope and fields, from whatever has all columns of `events`; None: from nowhere, where there is no such event."""
    fields = [field for field in (*ENVELOPE, *LAYOUTS[tag].fields) if field.name != "type"]
    if source is None:
        nothing = ", ".join(f'CAST(NULL AS {SQL_TYPES[COLUMNS[field.name]]}) AS "{field.name}"' for field in fields)
        return f"SELECT {nothing}\nWHERE FALSE\n"
    names = [f'"{field.name}"' for field in fields]
    return f"SELECT {', '.join(names)}\nFROM {source}\nWHERE type = '{tag}'\n"


def staging_query(tag: str) -> Query:
    """The view of one event type: the envelope and the fields of the type, one row an event."""
    layout = LAYOUTS[tag]
    title = (layout.cls.__doc__ or "").strip().splitlines()[0]
    header = {
        "Title": title,
        "Paper": "see the event type",
        "Grain": f"one row per {tag} event",
        "Units": "microseconds in columns that end in _us",
        "NULL": "the record does not name it",
        "Example": f"fsar-ledger query staging/{view_name(tag)} LEDGER",
    }
    return Query(f"staging/{view_name(tag)}", staging_sql(tag), header, tag=tag)


def concerns_query() -> Query:
    """The concern of each event type, as `events/concerns.py` has it."""
    found = {name: concern for concern, names in EVENTS_OF.items() for name in names}
    rows = ",\n    ".join(
        f"('{tag}', '{found[tag.partition('.')[0]]}')" for tag in LAYOUTS if tag.partition(".")[0] in found
    )
    sql = f"WITH concerns (type, concern) AS (\n    VALUES\n    {rows}\n)\n\nSELECT *\nFROM concerns\n"
    header = {
        "Title": "Which concern each event type belongs to; a run says which concerns its source records",
        "Paper": "sec:evaluation:metrics",
        "Grain": "one row per event type, but for those that say what a run is",
        "Units": "none",
        "NULL": "never",
        "Example": "fsar-ledger query facts/event_concerns LEDGER",
    }
    return Query("facts/event_concerns", sql, header)


def world_query() -> Query:
    """The view of what the world did, whatever its type: one text for each fact, alike for facts that are alike."""
    layouts = [layout for layout in LAYOUTS.values() if issubclass(layout.cls, get_args(WorldEvent))]
    fields = sorted({field.name for layout in layouts for field in layout.fields})
    values = ", ".join(f"'{name}=' || to_json(\"{name}\")::VARCHAR" for name in fields)
    tags = ", ".join(f"'{layout.tag}'" for layout in layouts)
    sql = f"SELECT run_id, seq, time_us, type, concat_ws(' ', {values}) AS fact\nFROM events\nWHERE type IN ({tags})\n"
    header = {
        "Title": "What the world did, whoever governed it: facts that come from draws or from outside",
        "Paper": "see the event types",
        "Grain": "one row per event of a type of the world",
        "Units": "time_us microseconds; fact its fields as NAME=VALUE, the values as JSON",
        "NULL": "never",
        "Example": "fsar-ledger query staging/world_facts LEDGER",
    }
    return Query("staging/world_facts", sql, header)


def _files(folder: Traversable, prefix: str = "") -> Iterator[tuple[str, str]]:
    """Name and text of every SQL file below the folder, sorted by name."""
    for entry in sorted(folder.iterdir(), key=lambda entry: entry.name):
        if entry.is_dir():
            yield from _files(entry, f"{prefix}{entry.name}/")
        elif entry.name.endswith(".sql"):
            yield prefix + entry.name.removesuffix(".sql"), entry.read_text("utf-8")


class Library:
    """All queries by name, with what each reads."""

    def __init__(self, queries: Iterable[Query]):
        self.queries: dict[str, Query] = {query.name: query for query in queries}
        self.relations: dict[str, Query] = {query.relation: query for query in self.queries.values()}
        if len(self.relations) < len(self.queries):
            raise ValueError("two queries have the same last part in their names; SQL could not tell them apart")

    def find(self, name: str) -> Query:
        """The query of this full name or unique last part.

        Raises:
            UnknownQuery: There is none; the message suggests the nearest names.
        """
        query = self.queries.get(name) or self.relations.get(name)
        if query is None:
            near = difflib.get_close_matches(name.rpartition("/")[2], self.relations, 3, 0.6)
            hint = (
                f"did you mean {' or '.join(self.relations[one].name for one in near)}?"
                if near
                else "`fsar-ledger query --list` shows all names."
            )
            raise UnknownQuery(f"query {name}: there is no query of that name; {hint}")
        return query

    def needs(self, names: Iterable[str], held: Collection[str] = ()) -> tuple[Query, ...]:
        """The queries that these relations are made of, themselves included, each after what it reads.

        Names that are no relation are left out, and those that are held already, with what only they read. Raises: ValueError if a query reads itself.
        """
        order: dict[str, Query] = {}

        def visit(name: str, above: tuple[str, ...]) -> None:
            if name in above:
                raise ValueError(f"query {name} reads itself: {' -> '.join((*above, name))}")
            query = self.relations.get(name)
            if query is None or name in order or name in held:
                return
            for source in sorted(query.sources()):
                visit(source, (*above, name))
            order[name] = query

        for name in sorted(names):
            visit(name, ())
        return tuple(order.values())

    def mentioned(self, sql: str) -> set[str]:
        """The relations whose names occur in this SQL, wherever they stand."""
        return {word.lower() for word in _WORD.findall(sql)} & self.relations.keys()


def values(query: Query, given: Mapping[str, str]) -> dict[str, str]:
    """The value of every parameter of the query: the given one, else its default.

    Raises:
        UnknownQuery: A given name is no parameter of the query, or a parameter without default has no value.
    """
    known = ", ".join(query.parameters) or "none"
    if unknown := sorted(given.keys() - query.parameters.keys()):
        raise UnknownQuery(f"query {query.name}: found parameter {', '.join(unknown)}; it has these: {known}")
    filled = query.parameters | dict(given)
    if missing := sorted(name for name, value in filled.items() if value is None):
        raise UnknownQuery(
            f"query {query.name}: parameter {', '.join(missing)} has no value; give it with --param {missing[0]}=VALUE"
        )
    return {name: str(value) for name, value in filled.items()}


@cache
def library() -> Library:
    """The packaged queries, one view per event type, the concerns of these types, and one view of what the world did."""
    packaged = [parse(name, sql) for name, sql in _files(files("fsar_ledger.queries"))]
    return Library([*map(staging_query, LAYOUTS), concerns_query(), world_query(), *packaged])
