"""What SQL of anyone asks for beside views: table macros, and what there is to ask.

DuckDB's own list would be of the relations that some SQL has needed so far. So `SHOW TABLES` reads ours, which has all,
and `DESCRIBE NAME` of a macro describes a call of it.
"""

import re
from collections.abc import Iterator, Sequence
from itertools import chain, pairwise
from typing import NamedTuple

import duckdb
import pyarrow as pa

from .groups import listed
from .library import Library, Query

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
