"""No query fans out or captures: its key tells rows apart, no star stands beside columns, few read all events.

None ends in ORDER BY either.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pytest

from fsar_ledger.ledger.rows.codec import LedgerRun, encode
from fsar_ledger.ledger.rows.schema import SCHEMA
from fsar_ledger.ledger.v1 import upgrade
from fsar_ledger.metrics.database import Database, connect, from_rows, from_table
from fsar_ledger.metrics.library import REQUIRED_KEYS, Library, Query, library
from tests.queries.histories import act, event, run
from tests.queries.keys import broken_keys
from tests.runtime.commanded import commanded

KEPT = sorted(
    (Path(__file__).parent.parent / "ledgers").glob("*/ledger"),
    key=lambda path: [int(number) for number in path.parent.name.split(".")],
)
FILES = {name: query for name, query in library().queries.items() if not query.tags}
CHEAP = ("facts/", "metrics/", "audit/", "invariants/", "readings/")
DRAWN = {query.name for query in FILES.values() if query.relation.startswith(("drawn_", "cluster_"))}
"""Millions of rows drawn from few: a second each."""
READ_ALL_EVENTS = {
    "facts/messages": "says any event in words, so that it needs every column",
    "facts/occurrences": "says in words what messages do not tell, so that it needs every column",
    "metrics/coordination_cost": "counts messages of forty types in one pass",
    "facts/action_records": "sums up all that happened to an action, whatever the type",
    "audit/supervisor_decisions": "finds what a supervisor decided by the decider, whatever the type",
    "facts/mechanism_decisions": "counts what events of eight concerns decided in one pass",
    "facts/supervision_ends": "finds whom the records of an action named last, whatever their type",
    "tables/mechanism_cells": "counts events of five concerns in one pass",
    "audit/events_by_day": "counts events of any type",
}
COMMENT = re.compile(r"--[^\n]*")
TEXT = re.compile(r"'(?:[^']|'')*'")
STAR = re.compile(r"(?:^|[\s.,(])\*(?=\s*(?:EXCLUDE\b|REPLACE\b|FROM\b|,|$))", re.MULTILINE)


def database_of_the_commanded_run() -> Database:
    kernel = commanded()
    return from_table(encode([LedgerRun("live", kernel.times_us, kernel.caused_by, kernel.events)]))


@pytest.mark.slow
def test_keys_tell_the_rows_of_the_commanded_run_apart() -> None:
    with database_of_the_commanded_run() as database:
        assert broken_keys(database, (query for name, query in FILES.items() if name.startswith(CHEAP))) == []


def database_of(kept: Path, place: Path) -> Database:
    """Open a kept ledger, upgraded there if a release before 0.9.0 wrote it."""
    if (kept / "commits").exists():
        upgrade(kept, place)
    return connect(place if place.exists() else kept)


@pytest.mark.slow
def test_keys_tell_the_rows_of_all_kept_ledgers_apart(tmp_path: Path) -> None:
    """In one database, with the runs of each ledger under its version: a query is planned once, and joins too much no
    less."""
    every = []
    for path in KEPT:
        with database_of(path, tmp_path / path.parent.name) as database:
            select = f"SELECT * REPLACE ('{path.parent.name} ' || run_id AS run_id) FROM events"
            every.append(database.table(select).select(SCHEMA.names))
    assert len(every) > 10
    with from_table(pa.concat_tables(every, promote_options="permissive")) as database:
        assert broken_keys(database, (query for name, query in FILES.items() if name not in DRAWN)) == []


def test_a_query_that_fans_out_is_found() -> None:
    header = dict.fromkeys(REQUIRED_KEYS, "something") | {"Key": "run_id, seq"}
    joined = "SELECT tasks.run_id, tasks.seq, steps.step FROM task_arrived AS tasks INNER JOIN step_began AS steps"
    planted = Query(
        "facts/planted", f"{joined} ON tasks.run_id = steps.run_id AND tasks.task_id = steps.task_id", header
    )
    history = run(
        event("TaskArrived", task_id="t"), act("StepBegan", 0, "t/1", step=1), act("StepBegan", 0, "t/2", step=2)
    )
    queries = Library([*library().queries.values(), planted])
    with from_rows(history) as database:
        database.library = queries
        assert broken_keys(database, iter([planted])) == ["facts/planted: 1 of 2 rows have the key of another"]
        planted.header["Key"] = "run_id, seq, step"
        assert broken_keys(database, iter([planted])) == []
        planted.header["Key"] = "run_id, seq, stage"
        assert broken_keys(database, iter([planted])) == ["facts/planted: key names stage, which is no column"]
        planted.header["Key"] = "one row"
        assert broken_keys(database, iter([planted])) == ["facts/planted: 2 rows, at most one expected"]


def test_a_key_column_that_is_null_is_found_unless_the_header_says_so() -> None:
    query = library().relations["supervisor_absences"]
    left = run(event("SupervisorLeft", supervisor=None))
    with from_rows(left) as database:
        header = query.header | {"Key": "run_id, supervisor"}
        altered = Query(query.name, query.sql, header)
        assert broken_keys(database, iter([altered])) == [f"{query.name}: supervisor is NULL"]
        header["Key"] = "run_id, supervisor?"
        assert broken_keys(database, iter([altered])) == []


# --- lints ---


@dataclass(frozen=True)
class Select:
    """The list of columns of one SELECT, with nothing in brackets but its own."""

    items: tuple[str, ...]


def selects(sql: str) -> Iterator[Select]:
    """Yield the column lists of every SELECT of this text, however deep."""
    text = TEXT.sub("''", COMMENT.sub("", sql))
    for found in re.finditer(r"\bSELECT\b(?:\s+DISTINCT\b)?", text):
        depth, items, begin = 0, [], found.end()
        for place in range(found.end(), len(text)):
            letter = text[place]
            depth += letter in "([{"
            depth -= letter in ")]}"
            ends = depth < 0 or (depth == 0 and re.match(r"\bFROM\b", text[place:]) is not None)
            if ends or (depth == 0 and letter == ","):
                items.append(text[begin:place].strip())
                begin = place + 1
            if ends:
                break
        else:
            items.append(text[begin:].strip())
        yield Select(tuple(items))


def starred(name: str, sql: str) -> list[str]:
    """Return the columns lists of a query in which a star stands beside a column, or computes one."""
    wrong = []
    for select in selects(sql):
        stars = [item for item in select.items if re.match(r"(?:\w+\.)?\*(?:\s|$)", item)]
        replaces = any("REPLACE" in star for star in stars) and not name.startswith("readings/")
        if stars and (len(select.items) > 1 or replaces):
            wrong.append(f"{name}: {stars[0]} stands beside other columns; name them")
    return wrong


def test_no_star_stands_beside_columns() -> None:
    """A reading is its relation with a column replaced, and has its columns by definition."""
    assert [fault for name, query in FILES.items() for fault in starred(name, query.sql)] == []


@pytest.mark.parametrize(
    "columns",
    ["*, 1 AS one", "a.*, b.x", "1 AS one, a.*", "* EXCLUDE (x), y", "* REPLACE (f(x, y) AS x)", "f(a, b), *"],
)
def test_a_star_beside_columns_is_found_wherever_it_stands(columns: str) -> None:
    assert len(starred("facts/x", f"SELECT {columns} FROM a")) == 1
    assert (
        len(starred("facts/x", f"WITH s AS (\n    SELECT\n        {columns}\n    FROM a\n)\n\nSELECT *\nFROM s")) == 1
    )
    assert starred("facts/x", f"-- SELECT {columns} FROM a\nSELECT ', *', count(*), 2 * 3 FROM a") == []
    assert starred("facts/x", "SELECT * EXCLUDE (x) FROM a UNION ALL SELECT b.* FROM b") == []


ORDERED = re.compile(r"^ORDER BY\b(?!.*\bLIMIT\b)", re.MULTILINE | re.DOTALL)
"""The last step of a query is not indented."""


def test_no_query_orders_its_rows_which_come_out_in_the_order_of_all_their_columns() -> None:
    assert [name for name, query in FILES.items() if ORDERED.search(COMMENT.sub("", query.sql))] == []
    assert ORDERED.search("SELECT a\nFROM b\nORDER BY a\n")
    assert not ORDERED.search("SELECT a\nFROM b\nORDER BY a\nLIMIT 1\n")
    assert not ORDERED.search("SELECT\n    sum(a) OVER (\n        ORDER BY b\n    )\nFROM b\n")


def test_only_staging_reads_all_events() -> None:
    found = {name for name, query in FILES.items() if "events" in query.sources() and not name.startswith("staging/")}
    assert found == READ_ALL_EVENTS.keys()
