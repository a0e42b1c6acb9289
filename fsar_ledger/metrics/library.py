"""Find the packaged queries by name, with their headers and dependencies.

A query file starts with comment lines `-- Name: text`. Title, Paper, Grain, Key, Units, NULL and Example are required.
`Key` lists the columns that identify a row, with `?` after one that may be NULL; or it is `one row`, or
`none, <reason>`. `Parameters: name: kind = default, ...` (`sql_values.py`) makes it a query that is run with
values instead of a view. `Stored: <reason>` keeps its rows, once computed, for the life of a connection. `Partial:
<reason>` means that its rows for all runs are the union of its rows for subsets of runs, so that a large ledger is
queried in slices.

A file in `readings/` is another reading of a relation: it reads that relation, has the same columns, and differs in
what `Title` says (`metrics/multiverse.py`). `Reading` is the number of our reading, `Replaces` the relation, `Moves`
the metrics that depend on it, `Question` what it answers differently, and `Why` the words of the paper that allow it.
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

from fsar_ledger.base import printable
from fsar_ledger.base.errors import InvalidQuery, UnknownQuery
from fsar_ledger.events import CONCERN_OF, CONCERNS
from fsar_ledger.events.world import WorldEvent
from fsar_ledger.ledger.rows.schema import COLUMNS, ENVELOPE, LAYOUTS, Field, Kind, StoredType

from . import definitions
from .sql_values import Parameter, parse_parameters

REQUIRED_KEYS = ("Title", "Paper", "Grain", "Key", "Units", "NULL", "Example")
READINGS = "readings/"
READING_KEYS = ("Reading", "Question", "Replaces", "Moves", "Why")
SQL_TYPES: dict[Kind, str] = {"string": "VARCHAR", "integer": "BIGINT", "boolean": "BOOLEAN", "strings": "VARCHAR[]"}
KEYS = (*REQUIRED_KEYS, *READING_KEYS, "Parameters", "Stored", "Partial")

_HEADER_LINE = re.compile(r"^-- (?:(\w+): )?\s*(.*)$")
_TEXT_OR_COMMENT = re.compile(r"'(?:[^']|'')*'|--[^\n]*|/\*.*?\*/", re.DOTALL)
_TEXT = re.compile(r"('(?:[^']|'')*')")
_SPACE = re.compile(r"\s+")
_SOURCE = re.compile(r"(?<!DISTINCT )\b(?:FROM|JOIN)\s+([a-z_][a-z0-9_]*)\b(?!\()", re.IGNORECASE)
_TEXT_OR_SOURCE = re.compile(rf"{_TEXT_OR_COMMENT.pattern}|(\b(?:FROM|JOIN)\s+)([a-z_]\w*)\b(\s+AS\b)?", re.DOTALL)
_WORD = re.compile(r"[a-z_][a-z0-9_]*", re.IGNORECASE)
_VERSIONED = re.compile(r"(?<=[a-z0-9])(?=[A-Z])")


class Query(msgspec.Struct, frozen=True):
    """One relation that SQL can name: a packaged file, or a view that is generated from an event type.

    `name` is `folder/relation`; `tags` are the event types of a view; `nothing` selects the same columns where no such
    event exists.
    """

    name: str
    sql: str
    header: dict[str, str]
    parameters: dict[str, Parameter] = {}
    tags: frozenset[str] = frozenset()
    nothing: str = ""

    @property
    def relation(self) -> str:
        """Return the last part of its name, by which SQL refers to it."""
        return self.name.rpartition("/")[2]

    @property
    def key(self) -> dict[str, bool] | None:
        """Return the columns that identify a row, and whether each may be NULL, which counts as a value.

        Empty: there is at most one row. None: rows may be equal, and each counts.
        """
        text = self.header["Key"]
        if text.startswith("none, "):
            return None
        columns = [] if text == "one row" else [column.strip() for column in text.split(",")]
        return {column.removesuffix("?"): column.endswith("?") for column in columns}

    @property
    def is_stored(self) -> bool:
        """Return whether its rows are computed once per connection."""
        return "Stored" in self.header

    @property
    def sha256(self) -> str:
        """Return the SHA-256 of its text, in hex."""
        return hashlib.sha256(self.sql.encode()).hexdigest()

    def sources(self) -> set[str]:
        """Return the names after FROM and JOIN: relations and its own steps."""
        return sources(self.sql)

    def reading_from(self, others: Mapping[str, str]) -> str:
        """Return its SQL reading other relations under the same names: `FROM others[name] AS name`."""

        def renamed(match: re.Match[str]) -> str:
            keyword, name, alias = match.groups()
            if name not in others or others[name] == name:
                return match[0]
            return f"{keyword}{others[name]}{alias or f' AS {name}'}"

        return _TEXT_OR_SOURCE.sub(renamed, self.sql)


def sources(sql: str) -> set[str]:
    """Return the names after FROM and JOIN: relations and the SELECT's own steps, but no functions."""
    return set(_SOURCE.findall(_TEXT_OR_COMMENT.sub(" ", sql)))


def plain_sql(sql: str) -> str:
    """Return the SQL without comments, with white space outside string literals collapsed to single spaces."""
    parts = _TEXT.split(_TEXT_OR_COMMENT.sub(lambda match: match[0] if match[0].startswith("'") else " ", sql))
    return "".join(part if part.startswith("'") else _SPACE.sub(" ", part) for part in parts).strip()


def parse(name: str, sql: str) -> Query:
    """Parse the text of a query file.

    Raises:
        InvalidQuery: A required key is missing or empty, a key is unknown or given twice, or a parameter has no kind.
    """
    header: dict[str, str] = {}
    last = None
    for number, line in enumerate(sql.splitlines(), start=1):
        if not (match := _HEADER_LINE.match(line)):
            break
        key, text = match.groups()
        if key is None and last is not None:
            header[last] += " " + text
            continue
        if key not in KEYS or key in header:
            expected = (
                f"each of {', '.join(KEYS)} at most once{printable.did_you_mean(str(key), set(KEYS) - header.keys())}"
            )
            observed = f"found {printable.value(line)} in the header"
            raise InvalidQuery(f"queries/{name}.sql:{number}: {observed}, expected {expected}")
        header[key] = text
        last = key
    required = (*REQUIRED_KEYS, *READING_KEYS) if name.startswith(READINGS) else REQUIRED_KEYS
    missing = [key for key in required if not header.get(key)]
    if missing:
        raise InvalidQuery(f"queries/{name}.sql:1: the header lacks {', '.join(missing)}")
    return Query(name, sql, header, parse_parameters(name, header.get("Parameters", "")))


def view_name(tag: str) -> str:
    """Return the name of an event type's view: `RequestIssued.v1` is `request_issued`."""
    return _VERSIONED.sub("_", tag.partition(".")[0]).lower()


def staging_sql(tag: str, source: str | None = "events") -> str:
    """Return the SELECT of one event type's envelope and fields from a relation with the columns of `events`.

    With `source` None it selects no rows, for a type without events.
    """
    return _select([*ENVELOPE, *LAYOUTS[tag].fields], [tag], source, without="type")


def _select(fields: Iterable[Field], tags: Iterable[str], source: str | None, without: str | None = None) -> str:
    """Return the SELECT of these columns of the events of these types."""
    names = [field.name for field in fields if field.name != without]
    if source is None:
        nothing = ", ".join(f'CAST(NULL AS {SQL_TYPES[COLUMNS[name]]}) AS "{name}"' for name in names)
        return f"SELECT {nothing}\nWHERE FALSE\n"
    columns = ", ".join(f'"{name}"' for name in names)
    quoted = [f"'{tag}'" for tag in tags]
    condition = f"IN ({', '.join(quoted)})" if len(quoted) > 1 else f"= {quoted[0]}"
    return f"SELECT {columns}\nFROM {source}\nWHERE type {condition}\n"


def staging_query(tag: str) -> Query:
    """Return the view of one event type: its envelope and fields, one row per event."""
    return _generated(
        f"staging/{view_name(tag)}",
        staging_sql(tag),
        (LAYOUTS[tag].cls.__doc__ or tag).strip().splitlines()[0],
        grain=f"one row per {tag} event",
        units="microseconds in columns that end in _us",
        null="the record does not name it",
        paper="see the event type",
        tags=frozenset({tag}),
        nothing=staging_sql(tag, None),
    )


def _generated(
    name: str,
    sql: str,
    title: str,
    *,
    grain: str,
    key: str = "run_id, seq",
    units: str = "none",
    null: str = "never",
    paper: str = "sec:evaluation:metrics",
    tags: frozenset[str] = frozenset(),
    nothing: str = "",
) -> Query:
    """Return a query without a file, with the header that a file would have."""
    values = (title, paper, grain, key, units, null, f"fsar-ledger query {name} LEDGER")
    return Query(name, sql, dict(zip(REQUIRED_KEYS, values, strict=True)), tags=tags, nothing=nothing)


def concerns_query() -> Query:
    """Return the view of the concern of each event type."""
    rows = ",\n    ".join(
        f"('{tag}', '{CONCERN_OF[tag.partition('.')[0]]}')" for tag in LAYOUTS if tag.partition(".")[0] in CONCERN_OF
    )
    return _generated(
        "facts/event_concerns",
        f"WITH concerns (type, concern) AS (\n    VALUES\n    {rows}\n)\n\nSELECT *\nFROM concerns\n",
        "The concern of each event type; a run declares which concerns its source records",
        grain="one row per event type, but for those that say what a run is",
        key="type",
    )


def concern_sql(concern: str, source: str | None = "events") -> str:
    """Return the SELECT of what one concern's event types record, from a relation with the columns of `events`."""
    layouts = _layouts(concern)
    fields = {field.name: field for layout in layouts for field in layout.fields}
    ordered = [fields[name] for name in sorted(fields)]
    return _select([*ENVELOPE, *ordered], [layout.tag for layout in layouts], source)


def _layouts(concern: str) -> list[StoredType]:
    """Return the event types of a concern, in their newest versions."""
    return [layout for layout in LAYOUTS.values() if CONCERN_OF.get(layout.tag.partition(".")[0]) == concern]


def concern_query(concern: str) -> Query:
    """Return the view of every event of one concern."""
    return _generated(
        f"staging/{concern}_events",
        concern_sql(concern),
        f"Every event of the concern {concern}",
        grain="one row per event of a type of the concern (facts/event_concerns)",
        units="microseconds in columns that end in _us",
        null="the event's type has no such field, or the record does not name it",
        paper="see the event types",
        tags=frozenset(layout.tag for layout in _layouts(concern)),
        nothing=concern_sql(concern, None),
    )


def world_query() -> Query:
    """Return the view of the world's events of any type: one text per fact, equal for equal facts."""
    layouts = [layout for layout in LAYOUTS.values() if issubclass(layout.cls, get_args(WorldEvent))]
    fields = sorted({field.name for layout in layouts for field in layout.fields})
    values = ", ".join(f"'{name}=' || to_json(\"{name}\")::VARCHAR" for name in fields)
    tags = ", ".join(f"'{layout.tag}'" for layout in layouts)
    return _generated(
        "staging/world_facts",
        f"SELECT run_id, seq, time_us, type, concat_ws(' ', {values}) AS fact\nFROM events\nWHERE type IN ({tags})\n",
        "Facts of the world, whatever the architecture: events from draws or from outside",
        grain="one row per event of a type of the world",
        units="time_us microseconds; fact its fields as NAME=VALUE, the values as JSON",
        paper="see the event types",
    )


def metric_queries() -> list[Query]:
    """Return the relations made from `reports/metrics.toml`."""
    return [
        _generated(
            "metrics/metric_definitions",
            definitions.definitions_sql(),
            "The metrics: their order, their scale, which way is better, how runs are pooled, and whether the paper "
            "prints them",
            grain="one row per metric",
            key="metric",
            units="numerator_units, how many units of the numerator make one of the value; scale is share, count, "
            "seconds, or yes-no (0 or 1 for each run); better is higher or lower; undefined_value and "
            "published_value, what an undefined run counts as with us and in the paper, where a metric is not pooled",
            null="published_value where the metric is defined for every run; undefined_value where it does not count",
        ),
        _generated(
            "metrics/metric_concerns",
            definitions.concerns_sql(),
            "The concerns that each metric rests on; without them it cannot be judged",
            grain="one row per metric and concern",
            key="judge, concern",
        ),
        _generated(
            "metrics/metric_records",
            definitions.records_sql(),
            "The records that each metric rests on, in a run that declares its types and fields; a metric without "
            "a row needs all of its concerns",
            grain="one row per metric and record (an event type, or TYPE.FIELD)",
            key="judge, record",
        ),
        _generated(
            "metrics/metric_measurements",
            definitions.measured_sql(),
            "The measurements of every metric in each run",
            grain="one row per run and metric",
            key="run_id, metric",
            units="as in each metric's own query",
            null="as in each metric's own query",
        ),
    ]


def generated() -> list[Query]:
    """Return the queries without a file.

    They are a view of each event type and concern, the facts of the world, and the relations about metrics.
    """
    return [
        *map(staging_query, LAYOUTS),
        *map(concern_query, CONCERNS),
        concerns_query(),
        world_query(),
        *metric_queries(),
    ]


def _files(folder: Traversable, prefix: str = "") -> Iterator[tuple[str, str]]:
    """Yield the name and the text of every SQL file below the folder, sorted by name."""
    for entry in sorted(folder.iterdir(), key=lambda entry: entry.name):
        if entry.is_dir():
            yield from _files(entry, f"{prefix}{entry.name}/")
        elif entry.name.endswith(".sql"):
            yield prefix + entry.name.removesuffix(".sql"), entry.read_text("utf-8")


class Library:
    """All queries by name, with their dependencies."""

    def __init__(self, queries: Iterable[Query]):
        self.queries: dict[str, Query] = {query.name: query for query in queries}
        self.relations: dict[str, Query] = {query.relation: query for query in self.queries.values()}
        if hidden := sorted(self.queries.keys() - {query.name for query in self.relations.values()}):
            raise ValueError(
                f"queries {', '.join(hidden)}: found others of the same last name, by which SQL reads them; rename them"
            )

    def find(self, name: str) -> Query:
        """Return the query of this full name or unique last part.

        Raises:
            UnknownQuery: There is none; the message suggests the nearest names.
        """
        query = self.queries.get(name) or self.relations.get(name)
        if query is None:
            near = difflib.get_close_matches(name.rpartition("/")[2], self.relations, 3, 0.6)
            hint = (
                f"did you mean {' or '.join(self.relations[relation].name for relation in near)}?"
                if near
                else "`fsar-ledger query --list --all` shows all names."
            )
            raise UnknownQuery(f"query {name}: there is no query of that name; {hint}")
        return query

    def needs(self, names: Iterable[str], held: Collection[str] = ()) -> tuple[Query, ...]:
        """Return the queries that these relations are made of, including themselves, each after what it reads.

        Without names that are no relation, and without those in `held` and what only they read. Raises: ValueError if a
        query reads itself.
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

    def partial(self, names: Collection[str], held: Collection[str] = ()) -> list[Query]:
        """Return the first partial queries on each path down from these relations, except those held."""
        candidates = {
            name for name, query in self.relations.items() if "Partial" in query.header or name == "run_started"
        }
        candidates.difference_update(held)
        above = self.needs(names, {*held, *candidates})
        read = {*names}.union(*(query.sources() for query in above))
        return [self.relations[name] for name in sorted(candidates & read)]

    def mentioned(self, sql: str) -> set[str]:
        """Return the relations whose names occur anywhere in this SQL."""
        return {word.lower() for word in _WORD.findall(sql)} & self.relations.keys()


@cache
def library() -> Library:
    """Return the packaged and the generated queries."""
    packaged = [parse(name, sql) for name, sql in _files(files("fsar_ledger.queries"))]
    return Library([*generated(), *packaged])
