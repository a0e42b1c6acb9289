"""The columns of the ledger, derived from the event types: one row per event, one column per field name.

| column | type | NULL |
|---|---|---|
| `run_id` | string | never |
| `seq` | int64, from 0 within the run without gaps | never |
| `time_us` | int64, microseconds of run time | never |
| `caused_by` | int64, seq of the event that led to this one | for seq 0, and where the cause is unknown |
| `type` | string, name and version of the event type | never |
| every field of any event type, A to Z | string, int64, bool or list of string | the type has no such field, or None |

Also the columns that each release wrote. A commit record names the release of its events, so a reader can tell whether
it can read them. `columns/N.N.N.txt` holds the columns of one release as text; its SHA-256 is the `schema_sha256` of
the records that name the release. A release that changes no event type has no such file: its records name the earlier
release. Columns are added, and never changed or removed, so rows of an earlier release are current rows with NULL in
later columns.
"""

import hashlib
from collections.abc import Iterable, Sequence
from importlib.resources import files
from itertools import chain
from operator import attrgetter
from typing import Literal, get_origin

import msgspec
import pyarrow as pa
from msgspec import inspect

from fsar_ledger.events import ALONE, CONCERN_OF, EVENT_TYPES, Event
from fsar_ledger.events.envelope import Part
from fsar_ledger.events.retired import RETIRED_TYPES

Kind = Literal["string", "integer", "boolean", "strings"]

ARROW_TYPES: dict[Kind, pa.DataType] = {
    "string": pa.string(),
    "integer": pa.int64(),
    "boolean": pa.bool_(),
    "strings": pa.list_(pa.field("element", pa.string(), nullable=False)),
}

MAX_INTEGER = 2**53 - 1
"""The largest integer that every JSON reader preserves exactly (RFC 8785); the smallest is its negative."""


class Field(msgspec.Struct, frozen=True):
    """The stored form of one field of an event type. Only `values` are allowed; None allows any."""

    name: str
    kind: Kind
    is_nullable: bool
    values: frozenset[str] | None


class Member(msgspec.Struct, frozen=True):
    """One field of the struct of an event: a column, or a `part` that is stored as the columns of its own fields."""

    name: str
    part: type[Part] | None
    fields: tuple[Field, ...]


class StoredType(msgspec.Struct, frozen=True):
    """The stored form of one event type.

    `members` are in the order of its constructor; `fields` are the columns in which they are stored.
    """

    tag: str
    cls: type[Event]
    members: tuple[Member, ...]
    fields: tuple[Field, ...]

    def columns(self, events: Sequence[Event]) -> tuple[Sequence[object], ...]:
        """Return the values of events of this type, one sequence per column, in the order of `fields`.

        The inverse of `events`.

        Raises:
            TypeError: A part of an event is of another class.
        """
        columns: list[Sequence[object]] = []
        for member in self.members:
            values = list(map(attrgetter(member.name), events))
            if member.part is None:
                columns.append(values)
                continue
            if set(map(type, values)) != {member.part}:
                raise TypeError(f"{self.tag}: found {member.name} of another class, expected {member.part.__name__}")
            columns += [list(map(attrgetter(field.name), values)) for field in member.fields]
        return tuple(columns)

    def events(self, columns: Iterable[Iterable[object]], count: int) -> list[Event]:
        """Return `count` events of this type from the values of these columns, given in the order of `fields`."""
        values = iter(columns)
        members = [_joined(member, [next(values) for _ in member.fields]) for member in self.members]
        if not members:
            return [self.cls() for _ in range(count)]
        names = [member.name for member in self.members]
        return [self.cls(**dict(zip(names, row, strict=True))) for row in zip(*members, strict=True)]

    def event(self, values: Iterable[object]) -> Event:
        """Return the event of this type with these values, given in the order of `fields`."""
        (event,) = self.events([(value,) for value in values], 1)
        return event


def _joined(member: Member, columns: list[Iterable[object]]) -> Iterable[object]:
    """Return the values of a member from the columns in which it is stored."""
    if member.part is None:
        return columns[0]
    names = member.part.__struct_fields__
    return [member.part(**dict(zip(names, row, strict=True))) for row in zip(*columns, strict=True)]


ENVELOPE: tuple[Field, ...] = (
    Field("run_id", "string", False, None),
    Field("seq", "integer", False, None),
    Field("time_us", "integer", False, None),
    Field("caused_by", "integer", True, None),
    Field("type", "string", False, None),
)
"""The columns that every row has."""


def _alternatives(kind: inspect.Type) -> list[inspect.Type]:
    """Return the distinct types of a union. Robots and supervisors have types of their own, but both are strings."""
    alternatives: list[inspect.Type] = []
    for alternative in kind.types if isinstance(kind, inspect.UnionType) else (kind,):
        if alternative not in alternatives:
            alternatives.append(alternative)
    return alternatives


def _field(field: inspect.Field) -> Field:
    """Return the stored form of a struct field. Raises: TypeError for a type that a ledger cannot hold."""
    kinds = _alternatives(field.type)
    is_nullable = any(isinstance(kind, inspect.NoneType) for kind in kinds)
    kinds = [kind for kind in kinds if not isinstance(kind, inspect.NoneType)]
    match kinds:
        case (inspect.StrType(),):
            return Field(field.name, "string", is_nullable, None)
        case (inspect.LiteralType(values=values),) if all(isinstance(value, str) for value in values):
            return Field(field.name, "string", is_nullable, frozenset(map(str, values)))
        case (inspect.IntType(),):
            return Field(field.name, "integer", is_nullable, None)
        case (inspect.BoolType(),):
            return Field(field.name, "boolean", is_nullable, None)
        case (inspect.VarTupleType(item_type=item),) if _alternatives(item) == [inspect.StrType()]:
            return Field(field.name, "strings", is_nullable, None)
    found = " or ".join(type(kind).__name__.removesuffix("Type").removeprefix("Var").lower() for kind in kinds)
    raise TypeError(
        f"field {field.name}: found {found}, expected str, Literal of str, int, bool or tuple[str, ...], each or None, "
        "which a ledger holds; write a fraction as an integer of a smaller unit"
    )


def _member(field: inspect.Field) -> Member:
    """Return the stored form of a field of an event. Raises: TypeError as `_field`."""
    if isinstance(field.type, inspect.StructType):
        part = get_origin(field.type.cls) or field.type.cls
        if isinstance(part, type) and issubclass(part, Part):
            return Member(field.name, part, tuple(map(_field, field.type.fields)))
    return Member(field.name, None, (_field(field),))


def stored_type(cls: type[Event]) -> StoredType:
    """Return the stored form of this event type.

    Raises: TypeError for a field that a ledger cannot hold or that would hide an envelope column.
    """
    info = inspect.type_info(cls)
    assert isinstance(info, inspect.StructType)
    try:
        members = tuple(map(_member, info.fields))
    except TypeError as error:
        raise TypeError(f"{info.tag}: {error}") from None
    fields = tuple(chain.from_iterable(member.fields for member in members))
    hidden = {field.name for field in fields} & {field.name for field in ENVELOPE}
    if hidden:
        raise TypeError(f"{info.tag}: fields {sorted(hidden)} have the name of an envelope column; rename them")
    return StoredType(str(info.tag), cls, members, fields)


def columns(layouts: tuple[StoredType, ...]) -> dict[str, Kind]:
    """Return the kind of every column, envelope first, then alphabetically.

    Raises:
        TypeError: Two event types give one field name different kinds.
    """
    kinds: dict[str, Kind] = {field.name: field.kind for field in ENVELOPE}
    payload: dict[str, Kind] = {}
    for layout in layouts:
        for field in layout.fields:
            if payload.setdefault(field.name, field.kind) != field.kind:
                raise TypeError(
                    f"{layout.tag}: field {field.name} is {field.kind}, in another event type {payload[field.name]}; "
                    "one name is one column: rename it"
                )
    return kinds | dict(sorted(payload.items()))


LAYOUTS: dict[str, StoredType] = {layout.tag: layout for layout in map(stored_type, EVENT_TYPES)}
"""The stored form of each event type, by tag, in the order of `EVENT_TYPES`."""

RETIRED: dict[str, StoredType] = {layout.tag: layout for layout in map(stored_type, RETIRED_TYPES)}
"""The stored form of each event type of earlier versions, by tag; none is written any more."""

STORED: dict[str, StoredType] = LAYOUTS | RETIRED
"""The stored form of each event type that a ledger may hold, by tag."""

STANDS_ALONE: frozenset[str] = frozenset(tag for tag, layout in STORED.items() if layout.cls in ALONE)
"""The tags of events that must be the only one of their run."""

OPENINGS: frozenset[str] = STANDS_ALONE.union(tag for tag in STORED if tag.partition(".v")[0] == "RunStarted")
"""The tags, of any version, that event 0 of a run must have and no other event may have."""

CONCERNED: dict[str, str] = {tag: CONCERN_OF[name] for tag in STORED if (name := tag.partition(".v")[0]) in CONCERN_OF}
"""The concern of each event type, by tag. Events of types without one may be in every run."""

RECORDS: tuple[str, ...] = tuple(
    name
    for layout in LAYOUTS.values()
    for kind in [layout.tag.partition(".v")[0]]
    if kind in CONCERN_OF
    for name in (kind, *(f"{kind}.{field.name}" for field in layout.fields if field.is_nullable))
)
"""The names that a run can declare as recorded by its source: event types, and those of their nullable fields."""


def concerns_admitted(observes: Sequence[str] | None, records: Sequence[str] | None) -> tuple[str, ...] | None:
    """Return the concerns of which a run may have events, by these fields of its event 0; None if all are allowed."""
    if observes is None:
        return None
    kinds = (record.partition(".")[0] for record in records or ())
    return (*observes, *(CONCERN_OF[kind] for kind in kinds if kind in CONCERN_OF))


COLUMNS: dict[str, Kind] = columns(tuple(STORED.values()))
"""The kind of every column, in stored order, including columns used only by retired types."""

PAYLOAD: tuple[str, ...] = tuple(COLUMNS)[len(ENVELOPE) :]
"""The columns that come from fields of event types."""

_REQUIRED = frozenset(field.name for field in ENVELOPE if not field.is_nullable)

SCHEMA: pa.Schema = pa.schema(
    [pa.field(name, ARROW_TYPES[kind], nullable=name not in _REQUIRED) for name, kind in COLUMNS.items()]
)
"""The Arrow schema of every segment that is written, and of every table that is read; segments of earlier releases may
lack columns.
"""

CODED_SCHEMA: pa.Schema = pa.schema(
    [field.with_type(pa.dictionary(pa.int32(), field.type)) if field.type == pa.string() else field for field in SCHEMA]
)
"""`SCHEMA` in memory before it is written: each string column as codes into a sorted dictionary of its values."""


def described(schema: pa.Schema) -> str:
    """Return the columns as text, one per line: `name type` or `name type not null`."""
    return "".join(f"{field.name} {field.type}{'' if field.nullable else ' not null'}\n" for field in schema)


def fingerprint(schema: pa.Schema) -> str:
    """Return the SHA-256, in hex, of the columns as text."""
    return hashlib.sha256(described(schema).encode()).hexdigest()


FINGERPRINT: str = fingerprint(SCHEMA)
"""The fingerprint of `SCHEMA`, which changes when the fields of events change."""


RELEASE = "0.14.0"
"""The first release with the current event types. Any change to them makes this the next release."""


def parse_columns(where: str, text: str) -> pa.Schema:
    """Parse the columns in this text, which must be among the current ones.

    Raises:
        TypeError: The current columns lack one of them or changed it, so ledgers of that release could not be read.
    """
    names = [line.partition(" ")[0] for line in text.splitlines()]
    schema = pa.schema([SCHEMA.field(name) for name in SCHEMA.names if name in names])
    if described(schema) != text:
        changed = sorted(set(text.splitlines()) - set(described(schema).splitlines())) or [
            "the columns in another order"
        ]
        raise TypeError(
            f"{where}: found {changed[0]}, which today's columns do not have; keep each column as it was, and its "
            "event type in RETIRED_TYPES"
        )
    return schema


def _number(release: str) -> tuple[int, ...] | None:
    """Return the three numbers of a release; None for any other text."""
    parts = release.split(".")
    if len(parts) != 3 or not all(
        part.isascii() and part.isdecimal() and len(part) < 10 and part == str(int(part)) for part in parts
    ):
        return None
    return tuple(map(int, parts))


def _released() -> dict[str, pa.Schema]:
    """Return the columns of every release that has a file, earliest release first."""
    paths = {file.name.removesuffix(".txt"): file for file in (files("fsar_ledger.ledger.rows") / "columns").iterdir()}
    return {
        release: parse_columns(paths[release].name, paths[release].read_text("utf-8"))
        for release in sorted(paths, key=lambda release: _number(release) or ())
    }


SCHEMAS: dict[str, pa.Schema] = _released() | {RELEASE: SCHEMA}
"""The columns of every release that this version reads, including its own."""

FINGERPRINTS: dict[str, str] = {release: fingerprint(schema) for release, schema in SCHEMAS.items()}
"""The fingerprint of the columns of each release; several may have the same."""


def is_later(release: str) -> bool:
    """Return whether this is the name of a release later than `RELEASE`."""
    number = _number(release)
    current = _number(RELEASE)
    return number is not None and current is not None and number > current


def widened(table: pa.Table, names: Sequence[str], schema: pa.Schema) -> pa.Table:
    """Return the rows with those columns of `schema` that are in `names`, in its order, with NULL in missing ones."""
    fields = [field for field in schema if field.name in names]
    present = set(table.column_names)
    if len(present) == len(fields):
        return table
    columns = [
        table.column(field.name) if field.name in present else pa.nulls(table.num_rows, field.type) for field in fields
    ]
    return pa.Table.from_arrays(columns, schema=pa.schema(fields))
