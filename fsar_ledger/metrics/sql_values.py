"""Values in SQL: the parameters of packaged queries, and values and file paths as text.

`Parameters: run: run = all, at: time = end` in the header of a query declares two. The kind decides how the text of a
value is parsed (`api/lookup.py`). Users give a time in seconds as `at`; the SQL gets microseconds as `$at_us`.

DuckDB reads many characters of file names as patterns or commands: in a path as text it expands `*`, `?`, `[...]` and a
leading `~`, and reads prefixes such as `file:` as a scheme.
"""

from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import pyarrow as pa

from fsar_ledger.base import printable
from fsar_ledger.base.errors import InvalidQuery, UnknownQuery
from fsar_ledger.events.configuration import ARCHITECTURES
from fsar_ledger.ledger.rows.schema import MAX_INTEGER, SCHEMA

NULLABLE = pa.schema([field.with_nullable(True) for field in SCHEMA])
BATCH_ROWS = 10_000
_PATTERNS = str.maketrans({character: f"[{character}]" for character in "*?["})


def literal(path: str | Path) -> str:
    """Return DuckDB's text of this path in `filename` columns, and in statements that expand no patterns.

    It never begins with `~` or a scheme.
    """
    text = str(path)
    return text if text.startswith("/") else f"./{text}"


def quoted(text: str) -> str:
    """Return a text as a SQL literal."""
    return "'" + text.replace("'", "''") + "'"


def sql_literal(value: Any) -> str:
    """Return a value as a SQL literal."""
    match value:
        case None:
            return "NULL"
        case str():
            return quoted(value)
        case tuple():
            return f"[{', '.join(map(sql_literal, value))}]"
        case _:
            return str(value).upper()


def listed(values: Iterable[Any]) -> str:
    """Return values as SQL literals, separated by commas."""
    return ", ".join(map(sql_literal, values))


def parquet(paths: Iterable[str | Path], *options: str, is_for_others: bool = False) -> str:
    """Return exactly these files as a SQL relation.

    Older DuckDB lacks the form that takes a path literally. With `is_for_others` the characters of patterns are escaped
    instead: then DuckDB lists the folders above, and reads nothing where a name in one of these begins with a
    backslash.
    """
    names = map(literal, paths)
    files = (
        [quoted(name.translate(_PATTERNS)) for name in names]
        if is_for_others
        else [f"{{'filename': {quoted(name)}}}" for name in names]
    )
    return f"read_parquet([{', '.join(files)}], {', '.join(('hive_partitioning = false', *options))})"


if TYPE_CHECKING:
    from .connection import Database

TIME, END = "time", "end"
KINDS = (
    *("run", "robot", "supervisor", "action", "capability", "context", "reason", "record", "architecture", "claim"),
    *("case", "period", "seq", TIME),
)
"""What a parameter can name. A context is a task, a record the kind of a coordination event, a case one of four, a
period a day or a part."""


class Parameter(msgspec.Struct, frozen=True):
    """A parameter of a query: its name for users, its kind, and its default (None: a value must be given)."""

    name: str
    kind: str
    default: str | None = None

    def __str__(self) -> str:
        return f"{self.name}={self.default or ''}"

    @property
    def sql_name(self) -> str:
        """Return the name after `$` in the SQL: a time is given in microseconds."""
        return f"{self.name}_us" if self.kind == TIME else self.name

    @property
    def sql_default(self) -> str | None:
        """Return the default for the SQL: the end of a run is after every time."""
        return str(MAX_INTEGER) if self.kind == TIME and self.default == END else self.default


def parse_parameters(query: str, text: str) -> dict[str, Parameter]:
    """Return the parameters in `name: kind = default, other: kind`, by name.

    Raises:
        InvalidQuery: A kind is missing or unknown, or a time has another default than the end of the run.
    """
    parameters: dict[str, Parameter] = {}
    for part in filter(None, (part.strip() for part in text.split(","))):
        named, equals, default = (piece.strip() for piece in part.partition("="))
        name, _, kind = (piece.strip() for piece in named.partition(":"))
        if kind not in KINDS:
            raise InvalidQuery(
                f"queries/{query}.sql: found {printable.value(part)} among the parameters, expected NAME: KIND or "
                f"NAME: KIND = DEFAULT{printable.did_you_mean(kind, KINDS) or ';'} a kind is one of {', '.join(KINDS)}"
            )
        if kind == TIME and equals and default != END:
            raise InvalidQuery(
                f"queries/{query}.sql: found {printable.value(part)} among the parameters, expected {name}: {TIME} = "
                f"{END} or {name}: {TIME}, a moment of the run; a duration is no parameter: write it into the SQL"
            )
        parameters[name] = Parameter(name, kind, default if equals else None)
    return parameters


def require_known(
    query: str, parameters: Mapping[str, Parameter], given: Collection[str], known: Collection[str]
) -> None:
    """Check that the given names are known ones of the query. Raises: UnknownQuery, with the nearest name."""
    unknown = sorted(set(given) - set(known))
    if not unknown:
        return
    times = [
        parameter.name for parameter in parameters.values() if parameter.sql_name in unknown and parameter.kind == TIME
    ]
    if times:
        hint = f"; {times[0]} is the time, as in {times[0]}=46.6, {times[0]}=46.6s or {times[0]}=46600ms"
    else:
        hint = printable.did_you_mean(unknown[0], known)
    named = ", ".join(map(printable.value, unknown))
    raise UnknownQuery(f"query {query}: found parameter {named}; it has these: {', '.join(known) or 'none'}{hint}")


def values(query: str, parameters: Mapping[str, Parameter], given: Mapping[str, str]) -> dict[str, str]:
    """Return the value of each `$name` of the query: the given one, else its default.

    Raises:
        UnknownQuery: A given name is not a parameter of the query, or one without default has no value.
    """
    defaults = {parameter.sql_name: parameter.sql_default for parameter in parameters.values()}
    require_known(query, parameters, given, defaults)
    filled = defaults | dict(given)
    if missing := [parameter.name for parameter in parameters.values() if filled[parameter.sql_name] is None]:
        raise UnknownQuery(
            f"query {query}: found no value of {', '.join(missing)}, which has no default; give one, as in "
            f"{missing[0]}=VALUE"
        )
    return {name: str(value) for name, value in filled.items()}


PRINCIPALS = ("robot", "supervisor")
FIXED = ("record", "claim", "case", "period")
"""Kinds whose names are the same whatever a ledger holds."""
ON_RECORD = {
    "robot": """
        SELECT unnest(
            [robot, peer, helper, on_behalf_of, relay, claimant, decided_by, requested_by, executed_by]
            || coalesce(candidates, []) || coalesce(rejected, [])
        ) AS name
        FROM events
        WHERE $run IS NULL OR run_id = $run
    """,
    "supervisor": """
        SELECT supervisor AS name FROM robot_joined WHERE $run IS NULL OR run_id = $run
        UNION ALL
        SELECT unnest([decided_by, supervised_by, supervisor]) AS name
        FROM events
        WHERE $run IS NULL OR run_id = $run
    """,
    "action": """
        SELECT action_id AS name FROM keyed_events WHERE $run IS NULL OR run_id = $run
        UNION ALL
        SELECT competing AS name FROM events WHERE $run IS NULL OR run_id = $run
    """,
    "capability": "SELECT capability AS name FROM events",
    "context": "SELECT unnest([task_id, context]) AS name FROM events WHERE $run IS NULL OR run_id = $run",
    "reason": "SELECT reason AS name FROM refusal_reasons UNION ALL SELECT reason AS name FROM events",
    "record": "SELECT record_kind AS name FROM event_classes",
    "architecture": f"SELECT architecture AS name FROM runs UNION ALL SELECT unnest({list(ARCHITECTURES)}) AS name",
    "claim": "SELECT claim AS name FROM case_definitions",
    "case": "SELECT case_number::VARCHAR AS name FROM case_definitions",
    "period": "SELECT unnest(['day', 'part']) AS name",
}
"""The SELECT of the known names of each kind: in this run, or in all where the kind is the same for every run.

A known name may have no row in an answer; any other is a typing error.
"""


def names_on_record(database: "Database", kind: str, run: str | None) -> list[str]:
    """Return the names that a parameter of this kind can have in this run, or in any, in order."""
    if kind == "run":
        return [str(row["run_id"]) for row in database.rows("SELECT run_id FROM run_numbers ORDER BY number")]
    sql = f"SELECT DISTINCT name FROM ({ON_RECORD[kind]}) WHERE name IS NOT NULL ORDER BY name"
    names = [str(row["name"]) for row in database.rows(sql, {"run": run} if "$run" in sql else None)]
    return [name for name in names if name.startswith(f"{kind}/")] if kind in PRINCIPALS else names


def plain_rows(table: pa.Table) -> list[dict[str, Any]]:
    """Return the rows as dictionaries; DuckDB's sums of integers, decimals in Arrow, become integers again."""
    integral = [field.name for field in table.schema if pa.types.is_decimal(field.type) and field.type.scale == 0]
    # In parts, so that the watch over this process's memory gets its turn between them.
    rows: list[dict[str, Any]] = [
        row for part in table.to_batches(max_chunksize=BATCH_ROWS) for row in part.to_pylist()
    ]
    for row in rows if integral else ():
        row.update({name: None if row[name] is None else int(row[name]) for name in integral})
    return rows


def with_all_columns(events: pa.Table) -> pa.Table:
    """Return the table with NULL in the columns that it lacks."""
    if events.column_names == SCHEMA.names:
        return events
    present = set(events.column_names)
    columns = [events[field.name] if field.name in present else pa.nulls(len(events), field.type) for field in SCHEMA]
    return pa.Table.from_arrays(columns, names=SCHEMA.names)
