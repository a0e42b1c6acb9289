"""What people find of our SQL: the packaged queries by group; functions, macros, a list of relations for their own.

DuckDB's own list would be of the relations that some SQL has needed so far. So `SHOW TABLES` reads ours, which has all,
and `DESCRIBE NAME` of a macro describes a call of it. An answer's columns are checked.

The functions are tail probabilities and quantiles from scipy, a column at a time, and constants by name. NULL in, NULL
out. No p is 0: one that is too small for a double is the smallest normal one, 2.22507e-308.

| function | value |
|---|---|
| `t_sf2(t, df)` | two-sided p of Student's t |
| `t_quantile(p, df)` | the t below which a share p lies |
| `norm_sf2(z)` | two-sided p of a standard normal z |
| `norm_quantile(p)` | the z below which a share p lies |
| `gamma_quantile(p, shape)` | the quantile of the gamma distribution of scale 1: exact bounds of a Poisson count |
| `binomial_half_sf2(k, n)` | exact two-sided p of k of n fair coin tosses, k <= n/2 |
| `constants_of(parameters)` | name and value of each constant of a run, sorted by name; NULL where unreadable |
| `default_of(name)` | the value of a constant in a run that does not record it; NULL where there is no such constant |
"""

import re
from collections.abc import Callable, Iterator, Sequence
from functools import wraps
from inspect import signature
from itertools import chain, pairwise
from typing import Any, NamedTuple

import duckdb
import numpy as np
import pyarrow as pa
from duckdb.func import FunctionNullHandling, PythonUDFType

from fsar_ledger.base.errors import QueryFailed
from fsar_ledger.metrics.constant_names import constants_of, default_of
from fsar_ledger.metrics.library import Library, Query, library
from fsar_ledger.metrics.sql_values import ON_RECORD

GROUPS = {
    "audit": "what an auditor asks: who asked, who decided, under which authority and policy",
    "invariants": "every event that violates a rule, I1 to I5 and A1 to A5",
    "metrics": "what the metrics measure, and of which runs",
    "cases": "the paper's four cases, claim by claim, and the events behind each number",
    "facts": "what the events mean: failures, decisions, conflicts, policies in force",
    "statistics": "architectures compared over paired runs",
    "tables": "the paper's two tables of grades, and what each grade rests on",
    "readings": "relations as they are when the paper is read otherwise",
    "staging": "the runs, their settings and plans",
}
"""The folders of queries, in the order of printed lists, and what each answers."""


def group_of(query: Query) -> str:
    """Return the folder that the query is in: the first part of its name."""
    return query.name.partition("/")[0]


def is_event_view(query: Query) -> bool:
    """Return whether the query shows the events of one type or concern as recorded; it has no file."""
    return bool(query.tags)


def listed(*, events: bool) -> list[Query]:
    """Return the queries in the order of their groups; with `events`, also the event views, last in their groups."""
    order = {group: position for position, group in enumerate(GROUPS)}
    chosen = [query for query in library().queries.values() if events or not is_event_view(query)]
    return sorted(chosen, key=lambda query: (order.get(group_of(query), len(order)), is_event_view(query), query.name))


def text_of(name: str) -> str:
    """Return the header and the SQL of a query, as in its file; for one without a file, in the same form.

    Raises:
        UnknownQuery: There is no query of this name.
    """
    query = library().find(name)
    if query.sql.startswith("-- "):
        return query.sql
    return "".join(f"-- {key}: {value}\n" for key, value in query.header.items()) + query.sql


LISTING = "relations"
"""The relation that `SHOW TABLES` reads."""
_DESCRIBE = {"describe": "DESCRIBE", "desc": "DESCRIBE", "show": "DESCRIBE", "summarize": "SUMMARIZE"}
OF_THE_TEXT = (
    duckdb.ParserException,
    duckdb.BinderException,
    duckdb.CatalogException,
    duckdb.InvalidInputException,  # such as a parameter that the header does not name
)
"""DuckDB's errors about SQL that runs on no data at all."""
_LACKING = re.compile(r"Table with name (\w+) does not exist")


class OwnSql(NamedTuple):
    """SQL in the form to run, and the queries whose macros it calls; `lists` if it reads the list of relations."""

    sql: str
    macros: tuple[Query, ...]
    lists: bool


class _Token(NamedTuple):
    begin: int
    end: int
    text: str


def understood(sql: str, library: Library) -> OwnSql:
    """Return the SQL, which must parse, with `SHOW TABLES` and `DESCRIBE NAME` of a macro in a form DuckDB can run."""
    tokens = [*_tokens(sql), _Token(0, 0, ""), _Token(0, 0, "")]
    words = [token.text.strip('"').lower() for token in tokens]
    macros: dict[str, Query] = {}
    changes: list[tuple[int, int, str]] = []
    for index, word in enumerate(words[:-2]):
        query = library.relations.get(word)
        verb = _DESCRIBE.get(words[index - 1]) if index else None
        if words[index : index + 2] == ["show", "tables"] and words[index + 2] != "from":
            changes.append((tokens[index].begin, tokens[index + 1].end, f"FROM {LISTING}"))
        elif words[index : index + 3] == ["show", "all", "tables"]:
            changes.append((tokens[index].begin, tokens[index + 2].end, f"FROM {LISTING}"))
        elif query is not None and query.parameters and words[index + 1].startswith("("):
            macros[word] = query
        elif query is not None and query.parameters and verb is not None:
            macros[word] = query
            changes.append((tokens[index - 1].begin, tokens[index].end, f"{verb} FROM {_call(query)}"))
    data, ends = sql.encode(), [0, *(end for _, end, _ in changes)]
    kept = [data[end:begin].decode() for end, (begin, _, _) in zip(ends, changes, strict=False)]
    pieces = chain.from_iterable(zip(kept, (text for _, _, text in changes), strict=True))
    lists = LISTING in words or any(text == f"FROM {LISTING}" for _, _, text in changes)
    return OwnSql("".join(pieces) + data[ends[-1] :].decode(), tuple(macros.values()), lists)


def listing() -> pa.Table:
    """Return name, parameters and title of `events` and of all packaged queries, event views last in their groups."""
    queries = listed(events=True)
    return pa.table(
        {
            "name": ["events", *(query.relation for query in queries)],
            "parameters": [None, *(_parameters(query) for query in queries)],
            "title": ["Every event, with the columns of all types", *(query.header["Title"] for query in queries)],
        }
    )


def how_to_call(message: str, library: Library) -> str:
    """Return what to do if DuckDB reports a missing table that is a macro; empty for another message."""
    query = _lacking(message, library)
    if query is None:
        return ""
    return f"\n{query.relation} takes parameters: {_parameters(query)}; call it, as in FROM {_call(query)}"


def fault_of(error: Exception, query: Query | None, library: Library) -> str:
    """Return DuckDB's message with what it is about: users' SQL or, if its text is wrong, the file of `query`."""
    message = str(error)
    if query is None or not isinstance(error, OF_THE_TEXT):
        return f"SQL: {first_lines(message)}"
    fault = f"queries/{query.name}.sql: {first_lines(message)}"
    if (read := _lacking(message, library)) is None:
        return fault
    return f"{fault}\n{read.relation} takes parameters, so no query can read it; move what both need to queries/facts/"


def _lacking(message: str, library: Library) -> Query | None:
    """Return the query with parameters that DuckDB misses as a table, if it does."""
    match = _LACKING.search(message)
    query = library.relations.get(match[1].lower()) if match else None
    return query if query is not None and query.parameters else None


def _parameters(query: Query) -> str | None:
    named = ((parameter.sql_name, parameter.default) for parameter in query.parameters.values())
    return ", ".join(f"{name} = {default}" if default else name for name, default in named) or None


def _call(query: Query) -> str:
    """Return a call of the macro, with NULL for each parameter that has no default."""
    needed = [f"{parameter.sql_name} := NULL" for parameter in query.parameters.values() if parameter.default is None]
    return f"{query.relation}({', '.join(needed)})"


def _tokens(sql: str) -> Iterator[_Token]:
    """Yield the tokens without comments, with their byte offsets in the UTF-8 of the SQL."""
    data = sql.encode()
    tokens: Sequence[tuple[int, object]] = duckdb.tokenize(sql)
    for (begin, kind), (end, _) in pairwise([*tokens, (len(data), None)]):
        text = data[begin:end].decode().rstrip()
        if kind != duckdb.token_type.comment and text:
            yield _Token(begin, begin + len(text.encode()), text)


_PARAMETER = re.compile(r"\$(\w+)")
FOR_OLDER = 'CREATE MACRO "if"(is_so, so, otherwise) AS CASE WHEN is_so THEN so ELSE otherwise END'
"""Defines the function that our queries call and older DuckDB versions lack."""

_RUN_NAMED = """
CREATE MACRO IF NOT EXISTS run_named(asked) AS coalesce(
    (SELECT max(run_id) FROM run_numbers WHERE run_id = asked::VARCHAR),
    (SELECT max(run_id) FROM experiment_planned WHERE run_id = asked::VARCHAR),
    (SELECT max(run_id) FROM run_numbers WHERE number::VARCHAR = asked::VARCHAR),
    if(asked::VARCHAR = 'all', 'all', error(
        'run ' || coalesce(asked::VARCHAR, 'NULL') || ': there is no such run, expected a whole name or a number; '
        || '`SELECT number, run_id FROM run_numbers` lists them'
    ))
)
"""
"""The run of this name or number; any other text is an error, because an empty answer would claim that nothing was."""

_NAMED = """
CREATE MACRO IF NOT EXISTS {kind}_named(asked) AS coalesce(
    if(asked::VARCHAR = 'all', 'all', NULL),
    (
        SELECT max(name) FROM ({names})
        WHERE asked::VARCHAR <> 'all' AND name IN (asked::VARCHAR, '{kind}/' || asked::VARCHAR)
    ),
    error(
        '{kind} ' || coalesce(asked::VARCHAR, 'NULL') || ': there is no such {kind}, expected the name of one on record'
    )
)
"""
"""The entry of this name; any other text is an error for the same reason."""

_SEQ_NAMED = """
CREATE MACRO IF NOT EXISTS seq_named(asked) AS if(asked IS NULL, NULL, coalesce(
    (SELECT max(seq) FROM event_principals WHERE seq = asked::BIGINT),
    error('seq ' || asked::VARCHAR || ': there is no such event of any run')
))
"""
"""The same for a seq; NULL for NULL, as in `SUMMARIZE decision_owner`."""
_FOUND = frozenset({"robot", "supervisor", "action", "capability", "context", "reason", "record", "seq"})


def _name_macro(kind: str) -> str:
    """Return the statement that makes the macro that finds a name of this kind in any run."""
    return _SEQ_NAMED if kind == "seq" else _NAMED.format(kind=kind, names=ON_RECORD[kind].replace("$run", "NULL"))


def statements(query: Query) -> tuple[str, ...]:
    """Return the statements that make a macro of a query with parameters and their defaults.

    It takes only names on record. A parameter hides the column of its name, so a separate macro with other names holds
    the SELECT. DuckDB resolves names when it makes a macro, not when one is called, so the SELECT comes last. Where the
    SELECT reads no row, DuckDB would look up no name: the other half of the union, which has no row, does.
    """
    defaults = {parameter.sql_name: parameter.sql_default for parameter in query.parameters.values()}
    understood = ", ".join(
        f"{parameter.kind}_named({parameter.sql_name})" if parameter.kind in ("run", *_FOUND) else parameter.sql_name
        for parameter in query.parameters.values()
    )
    declared = ", ".join(name if value is None else f"{name} := '{value}'" for name, value in defaults.items())
    inner = f"{query.relation}_given"
    macro = f"{inner}({', '.join(f'{name}_given' for name in defaults)})"
    sql = _PARAMETER.sub(r"\1_given", query.sql)
    return (
        _RUN_NAMED,
        *map(_name_macro, sorted(_FOUND & {parameter.kind for parameter in query.parameters.values()})),
        f"CREATE MACRO {macro} AS TABLE SELECT NULL",
        f"CREATE MACRO {query.relation}({declared}) AS TABLE FROM {inner}({understood})",
        f"CREATE OR REPLACE MACRO {macro} AS TABLE\nWITH answer AS NOT MATERIALIZED (\n{sql}\n)\nFROM answer UNION ALL "
        "SELECT none.* FROM (SELECT 1) LEFT JOIN (FROM answer LIMIT 0) AS none ON TRUE "
        f"WHERE length(concat({', '.join(f'{name}_given' for name in defaults)})) < 0",
    )


LOCK = (
    "threads = 1",
    "temp_directory = ''",  # SQL can read and write where DuckDB may spill: `.tmp` of the working folder
    "max_temp_directory_size = '0KB'",
    "home_directory = ''",
    "secret_directory = ''",
    "python_enable_replacements = false",
    "autoinstall_known_extensions = false",
    "autoload_known_extensions = false",
    "allow_persistent_secrets = false",
    "enable_external_access = false",
)

SHOWN = 200
MESSAGE_LINES = 6
"""Limits on what a message repeats: characters of a name or line, and lines."""
_NAME = re.compile(r"\"(?:[^\"]|\"\")*\"|'(?:[^']|'')*'")
_UNSHOWABLE = re.compile(r"\b(?:BIGNUM|BIT|GEOMETRY|TIME WITH TIME ZONE|UHUGEINT|UNION|VARIANT)\b")
"""Types whose values Arrow or Python would silently change, or cannot represent."""


def check_columns(names: Sequence[str], kinds: Sequence[str]) -> None:
    """Check that the columns have distinct names, and types whose values are passed on unchanged.

    Raises: QueryFailed.
    """
    seen: set[str] = set()
    for name, kind in zip(names, kinds, strict=True):
        if name in seen:
            raise QueryFailed(f"SQL: found two columns named {name[:SHOWN]!r}; give one of them another name with AS")
        if match := _UNSHOWABLE.search(_NAME.sub(" ", kind)):
            raise QueryFailed(
                f"SQL: column {name[:SHOWN]!r} holds {match[0]}, which an answer cannot show as it is; make it text, "
                "as in CAST(... AS VARCHAR)"
            )
        seen.add(name)


_CONSTANTS = pa.list_(pa.struct([("name", pa.string()), ("value", pa.string())]))


def _scipy() -> Any:
    """Import scipy.special when a query first needs it, since that takes 0.3 s."""
    from scipy import special

    return special


def _positive(p: Any) -> Any:
    return np.maximum(p, np.finfo(np.float64).tiny)


# See docs/decisions/intervals-keep-their-coverage.md.
NUMERIC: dict[str, Callable[..., Any]] = {
    "t_sf2": lambda t, df: _positive(2.0 * _scipy().stdtr(df, -np.abs(t))),
    "t_quantile": lambda p, df: _scipy().stdtrit(df, p),
    "norm_sf2": lambda z: _positive(2.0 * _scipy().ndtr(-np.abs(z))),
    "norm_quantile": lambda p: _scipy().ndtri(p),
    "gamma_quantile": lambda p, shape: _scipy().gammaincinv(shape, p),
    "binomial_half_sf2": lambda k, n: _positive(np.minimum(1.0, 2.0 * _scipy().bdtr(k, n.astype(np.int64), 0.5))),
}
"""The functions of numbers, each on numpy vectors; the module docstring defines them."""

BY_NAME: dict[str, tuple[Callable[[Any], Any], str, pa.DataType]] = {
    "constants_of": (constants_of, "STRUCT(name VARCHAR, value VARCHAR)[]", _CONSTANTS),
    "default_of": (default_of, "VARCHAR", pa.string()),
}
"""The functions of texts, each on one Python value, and the type of the answer in SQL and in Arrow."""

FUNCTIONS = frozenset((*NUMERIC, *BY_NAME))
"""Functions that SQL can call only over a connection that has registered them."""


def _of_numbers(function: Callable[..., Any]) -> Callable[..., pa.Array]:
    """Lift a function of vectors to Arrow columns; DuckDB counts the wrapped function's arguments."""

    @wraps(function)
    def lifted(*columns: pa.Array) -> pa.Array:
        vectors = [np.asarray(column.to_numpy(zero_copy_only=False), dtype=np.float64) for column in columns]
        return pa.array(np.asarray(function(*vectors), dtype=np.float64))

    return lifted


def _of_texts(function: Callable[[Any], Any], kind: pa.DataType) -> Callable[[pa.Array], pa.Array]:
    return lambda column: pa.array(map(function, column.to_pylist()), kind)


def register(connection: duckdb.DuckDBPyConnection) -> None:
    """Register all functions with the connection."""
    for name, function in NUMERIC.items():
        arguments: list[Any] = ["DOUBLE"] * len(signature(function).parameters)
        connection.create_function(name, _of_numbers(function), arguments, "DOUBLE", type=PythonUDFType.ARROW)
    for name, (of_text, sql_type, arrow_type) in BY_NAME.items():
        connection.create_function(
            name,
            _of_texts(of_text, arrow_type),
            ["VARCHAR"],
            sql_type,
            type=PythonUDFType.ARROW,
            null_handling=FunctionNullHandling.SPECIAL,
        )


def first_lines(text: str) -> str:
    """Return the beginning of DuckDB's message, without tabs and blank lines and with long ones cut."""
    every = (line for line in text.expandtabs(4).splitlines() if line.strip())
    lines = [line if len(line) <= SHOWN else f"{line[:SHOWN]}..." for line in every]
    return "\n".join(lines[:MESSAGE_LINES])
