"""Table macros, a list of relations and a check of columns, for SQL that users write.

DuckDB's own list would be of the relations that some SQL has needed so far. So `SHOW TABLES` reads ours, which has all,
and `DESCRIBE NAME` of a macro describes a call of it.
"""

import re
from collections.abc import Iterator, Sequence
from itertools import chain, pairwise
from typing import NamedTuple

import duckdb
import pyarrow as pa

from fsar_ledger.base.errors import QueryFailed
from fsar_ledger.metrics.groups import listed
from fsar_ledger.metrics.library import Library, Query

LISTING = "relations"
"""The relation that `SHOW TABLES` reads."""
_DESCRIBE = {"describe": "DESCRIBE", "desc": "DESCRIBE", "show": "DESCRIBE", "summarize": "SUMMARIZE"}
_LACKING = re.compile(r"Table with name (\w+) does not exist")


class OwnSql(NamedTuple):
    """SQL as it is run, and the queries whose macros it calls; `lists` if it reads the list of relations."""

    sql: str
    macros: tuple[Query, ...]
    lists: bool


class _Token(NamedTuple):
    begin: int
    end: int
    text: str


def understood(sql: str, library: Library) -> OwnSql:
    """Return the SQL, which must parse, with `SHOW TABLES` and `DESCRIBE NAME` of a macro as DuckDB can answer them."""
    tokens = [*_tokens(sql), _Token(0, 0, ""), _Token(0, 0, "")]
    words = [token.text.strip('"').lower() for token in tokens]
    macros: dict[str, Query] = {}
    changes: list[tuple[int, int, str]] = []
    for at, word in enumerate(words[:-2]):
        query = library.relations.get(word)
        verb = _DESCRIBE.get(words[at - 1]) if at else None
        if words[at : at + 2] == ["show", "tables"] and words[at + 2] != "from":
            changes.append((tokens[at].begin, tokens[at + 1].end, f"FROM {LISTING}"))
        elif words[at : at + 3] == ["show", "all", "tables"]:
            changes.append((tokens[at].begin, tokens[at + 2].end, f"FROM {LISTING}"))
        elif query is not None and query.parameters and words[at + 1].startswith("("):
            macros[word] = query
        elif query is not None and query.parameters and verb is not None:
            macros[word] = query
            changes.append((tokens[at - 1].begin, tokens[at].end, f"{verb} FROM {_call(query)}"))
    data, ends = sql.encode(), [0, *(end for _, end, _ in changes)]
    kept = [data[end:begin].decode() for end, (begin, _, _) in zip(ends, changes, strict=False)]
    made = chain.from_iterable(zip(kept, (text for _, _, text in changes), strict=True))
    lists = LISTING in words or any(text == f"FROM {LISTING}" for _, _, text in changes)
    return OwnSql("".join(made) + data[ends[-1] :].decode(), tuple(macros.values()), lists)


def listing() -> pa.Table:
    """Return name, parameters and title of `events` and of all packaged queries, the views of events last in theirs."""
    queries = listed(events=True)
    return pa.table(
        {
            "name": ["events", *(query.relation for query in queries)],
            "parameters": [None, *(_parameters(query) for query in queries)],
            "title": ["Every event, with the columns of all types", *(query.header["Title"] for query in queries)],
        }
    )


def how_to_call(message: str, library: Library) -> str:
    """Return what to do where DuckDB misses a table that is a macro; nothing for another message."""
    found = _LACKING.search(message)
    query = library.relations.get(found[1].lower()) if found else None
    if query is None or not query.parameters:
        return ""
    return f"\n{query.relation} takes parameters: {_parameters(query)}; call it, as in FROM {_call(query)}"


def _parameters(query: Query) -> str | None:
    named = ((one.sql_name, one.default) for one in query.parameters.values())
    return ", ".join(f"{name} = {default}" if default else name for name, default in named) or None


def _call(query: Query) -> str:
    """Return a call of the macro, with NULL for each parameter that has no default."""
    needed = [f"{one.sql_name} := NULL" for one in query.parameters.values() if one.default is None]
    return f"{query.relation}({', '.join(needed)})"


def _tokens(sql: str) -> Iterator[_Token]:
    """Yield the tokens without comments, with their places in the UTF-8 of the SQL."""
    data = sql.encode()
    found: Sequence[tuple[int, object]] = duckdb.tokenize(sql)
    for (begin, kind), (after, _) in pairwise([*found, (len(data), None)]):
        text = data[begin:after].decode().rstrip()
        if kind != duckdb.token_type.comment and text:
            yield _Token(begin, begin + len(text.encode()), text)


_PARAMETER = re.compile(r"\$(\w+)")
FOR_OLDER = 'CREATE MACRO "if"(is_so, so, otherwise) AS CASE WHEN is_so THEN so ELSE otherwise END'
"""Makes the function that our queries call and the DuckDB before ours lacks."""

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
"""The run of this name or number; any other text is an error, because an empty answer would say that nothing was."""


def statements(query: Query) -> tuple[str, ...]:
    """Return the statements that make a macro of a query with parameters; it has their defaults.

    It takes only runs on record. A parameter hides the column of its name, so that a macro of its own holds the SELECT,
    with other names. DuckDB compares the names when it makes a macro, not when one is called, so that the SELECT comes
    last.
    """
    defaults = {one.sql_name: one.sql_default for one in query.parameters.values()}
    understood = ", ".join(
        f"run_named({one.sql_name})" if one.kind == "run" else one.sql_name for one in query.parameters.values()
    )
    taken = ", ".join(name if value is None else f"{name} := '{value}'" for name, value in defaults.items())
    inner = f"{query.relation}_given"
    whole = f"{inner}({', '.join(f'{name}_given' for name in defaults)})"
    sql = _PARAMETER.sub(r"\1_given", query.sql)
    return (
        _RUN_NAMED,
        f"CREATE MACRO {whole} AS TABLE SELECT NULL",
        f"CREATE MACRO {query.relation}({taken}) AS TABLE FROM {inner}({understood})",
        f"CREATE OR REPLACE MACRO {whole} AS TABLE\n{sql}",
    )


SHOWN = 200
"""Characters of a name or line that a message repeats."""
_NAME = re.compile(r"\"(?:[^\"]|\"\")*\"|'(?:[^']|'')*'")
_UNSHOWABLE = re.compile(r"\b(?:BIGNUM|BIT|GEOMETRY|TIME WITH TIME ZONE|UHUGEINT|UNION|VARIANT)\b")
"""Types whose values Arrow or Python would silently change, or cannot hold."""


def check_columns(names: Sequence[str], kinds: Sequence[str]) -> None:
    """Check that the columns have distinct names, and types whose values arrive unchanged.

    Raises: QueryFailed.
    """
    seen: set[str] = set()
    for name, kind in zip(names, kinds, strict=True):
        if name in seen:
            raise QueryFailed(f"SQL: found two columns named {name[:SHOWN]!r}; give one of them another name with AS")
        if found := _UNSHOWABLE.search(_NAME.sub(" ", kind)):
            raise QueryFailed(
                f"SQL: column {name[:SHOWN]!r} holds {found[0]}, which an answer cannot show as it is; make it text, "
                "as in CAST(... AS VARCHAR)"
            )
        seen.add(name)
