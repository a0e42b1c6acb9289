"""What holds for every packaged query: its header says what it is, it runs on an empty ledger, it repeats itself."""

import random
import re
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path

import duckdb
import pyarrow as pa
import pytest

from fsar_ledger.api.simulate import simulate
from fsar_ledger.base.errors import InvalidQuery
from fsar_ledger.ledger.rows.schema import COLUMNS, LAYOUTS
from fsar_ledger.metrics.database import Database, connect, from_rows
from fsar_ledger.metrics.library import KEYS, REQUIRED_KEYS, Library, Query, generated, library, parse, staging_query
from fsar_ledger.metrics.own_sql import is_event_view
from tests.queries.keys import required

FILES = sorted(Path(str(files("fsar_ledger.queries"))).rglob("*.sql"))
GENERATED = {query.name for query in generated()}
CONSTANT = {
    *(
        "facts/event_classes",
        "facts/judged_concerns",
        "facts/judged_records",
        "facts/message_words",
        "facts/occurrence_words",
    ),
    "facts/refusal_reasons",
    *("statistics/comparisons", "cases/case_definitions", "readings/denials_are_records"),
    *("readings/failures_by_run", "readings/published_convention", "readings/tasks_are_pooled"),
}
PACKAGED = [name for name in library().queries if name not in GENERATED]
HEADER = "".join(f"-- {key}: something\n" for key in REQUIRED_KEYS)


def test_every_file_is_in_the_library_under_its_folder_and_name() -> None:
    assert sorted(PACKAGED) == sorted(f"{path.parent.name}/{path.stem}" for path in FILES)


def test_the_example_of_a_query_calls_it() -> None:
    assert [name for name in PACKAGED if name not in library().find(name).header["Example"]] == []


@pytest.mark.parametrize("missing", REQUIRED_KEYS)
def test_header_without_a_required_key_is_refused(missing: str) -> None:
    text = "".join(line for line in HEADER.splitlines(keepends=True) if f"-- {missing}:" not in line)
    with pytest.raises(ValueError, match=missing):
        parse("facts/x", text + "SELECT 1")


def test_header_with_an_empty_unknown_or_repeated_key_is_refused() -> None:
    for text in (
        HEADER.replace("Grain: something", "Grain:"),
        HEADER + "-- Colour: red\n",
        HEADER + "-- Title: again\n",
    ):
        with pytest.raises(ValueError, match="header"):
            parse("facts/x", text + "SELECT 1")
    with pytest.raises(
        InvalidQuery, match=r"^queries/facts/x\.sql:4: found -- Keys: a in the header, .*; did you mean Key\?$"
    ):
        parse("facts/x", HEADER.replace("Key: something", "Keys: a"))
    assert "Parameters" in KEYS


def test_a_time_has_no_other_default_than_the_end_of_the_run() -> None:
    for default in ("5s", "5000000", "all"):
        with pytest.raises(InvalidQuery, match=f"found within: time = {default} among .* expected within: time = end"):
            parse("facts/x", f"{HEADER}-- Parameters: within: time = {default}\nSELECT 1")
    at = parse("facts/x", f"{HEADER}-- Parameters: at: time = end, since: time\nSELECT 1").parameters
    assert [str(one) for one in at.values()] == ["at=end", "since="]


def test_header_goes_on_over_several_lines() -> None:
    query = parse("facts/x", HEADER.replace("Units: something", "Units: one\n--        two") + "SELECT 1")
    assert query.header["Units"] == "one two"


@pytest.fixture(scope="module")
def empty() -> Iterator[Database]:
    """An empty ledger, one for all queries.

    What one made stands there for the next: whether each finds all that it reads is asked of DuckDB below.
    """
    with from_rows([]) as database:
        yield database


@pytest.mark.parametrize("name", PACKAGED)
def test_query_runs_on_an_empty_ledger(empty: Database, name: str) -> None:
    query = library().find(name)
    table = empty.query(name, required(query))
    constant = name in CONSTANT
    missing = (query.key or {}).keys() - set(table.column_names)
    assert not missing, f"queries/{name}.sql: Key names {', '.join(sorted(missing))}, which it has not"
    assert (table.num_rows > 0) == constant
    assert table.num_columns > 0


def is_plain(name: str, connection: duckdb.DuckDBPyConnection) -> bool:
    """Whether SQL can name a column, and a parameter of a macro, without quotes."""
    try:
        return len(connection.extract_statements(f"SELECT {name} AS {name} FROM f({name} := 1)")) == 1
    except duckdb.ParserException:
        return False


def _parameters(query: Query) -> list[str]:
    return [one.sql_name for one in query.parameters.values()]


@pytest.mark.slow
def test_no_column_and_no_parameter_needs_quotes_but_one_that_events_have_stored(empty: Database) -> None:
    with duckdb.connect() as connection:
        reserved = connection.execute("SELECT keyword_name FROM duckdb_keywords() WHERE keyword_category = 'reserved'")
        assert not any(is_plain(name, connection) for (name,) in reserved.fetchall())
        names = {
            (query.name, name)
            for query in library().queries.values()
            for name in (*empty.query(query.name, required(query)).column_names, *_parameters(query))
        }
        quoted = {(query, name) for query, name in names if not is_plain(name, connection)}
    assert {name for _, name in quoted} == {"window"} & set(COLUMNS)
    assert all(is_event_view(library().find(query)) for query, _ in quoted)


def relations_in(sql: str, connection: duckdb.DuckDBPyConnection) -> set[str]:
    """The relations that DuckDB's own parser finds in a SELECT, wherever they stand, its steps among them."""
    ((tree,),) = connection.execute("SELECT json_serialize_sql(?)", [sql]).fetchall()
    assert '"error":false' in tree, tree
    return set(re.findall(r'"table_name":"(\w+)"', tree))


def test_duckdb_reads_nothing_that_the_library_does_not_make_for_a_query() -> None:
    made = {query.relation for query in library().queries.values()} | {"events"}
    with duckdb.connect() as connection:
        found = relations_in("SELECT a.x FROM a, (SELECT y FROM b) WHERE x IN (SELECT z FROM c)", connection)
        assert found == {"a", "b", "c"}
        read = {name: relations_in(query.sql, connection) & made for name, query in library().queries.items()}
    assert [
        (name, unseen) for name, relations in read.items() if (unseen := relations - library().queries[name].sources())
    ] == []
    assert len([name for name, relations in read.items() if relations]) > 200


def test_every_event_type_has_a_view_with_its_fields_that_runs_on_an_empty_ledger() -> None:
    with from_rows([]) as database:
        for tag, layout in LAYOUTS.items():
            query = next(query for query in library().queries.values() if f"type = '{tag}'" in query.sql)
            table = database.query(query.name)
            found = table.column_names
            assert found == ["run_id", "seq", "time_us", "caused_by", *(field.name for field in layout.fields)]


def test_an_event_type_without_a_docstring_is_told_by_its_tag(monkeypatch: pytest.MonkeyPatch) -> None:
    """As every one is under `python -OO`, which leaves docstrings out."""
    monkeypatch.setattr(LAYOUTS["TaskCompleted.v1"].cls, "__doc__", None)
    assert staging_query("TaskCompleted.v1").header["Title"] == "TaskCompleted.v1"


def test_a_query_that_reads_itself_is_refused() -> None:
    header = dict.fromkeys(REQUIRED_KEYS, "x")
    looped = Library([Query("facts/a", "SELECT * FROM b", header), Query("facts/b", "SELECT * FROM a", header)])
    with pytest.raises(ValueError, match="a -> b -> a"):
        looped.needs(["a"])


def test_two_queries_with_one_last_name_are_refused() -> None:
    header = dict.fromkeys(REQUIRED_KEYS, "x")
    with pytest.raises(ValueError, match=r"facts/a: found others of the same last name, .* rename them"):
        Library([Query("facts/a", "SELECT 1", header), Query("metrics/a", "SELECT 1", header)])


def test_sources_are_what_stands_behind_from_and_join_and_not_in_texts_or_comments() -> None:
    query = Query("facts/a", "-- FROM x\nSELECT 'FROM y' FROM b JOIN c ON TRUE", {})
    assert query.sources() == {"b", "c"}


@pytest.mark.slow
def test_the_order_in_which_events_are_stored_changes_no_answer(tmp_path: Path) -> None:
    ledger = simulate(tmp_path / "ledger", scenario=["door-relay", "fleet-contention"], runs=2, seed=1).ledger
    with connect(ledger.path) as database:
        first, others = (database.table(f"SELECT * FROM events WHERE {one}") for one in ("seq = 0", "seq > 0"))
    mixed = others.take(random.Random(1).sample(range(len(others)), len(others)))
    with Database(None, (), is_small=True) as stored, Database(None, (), is_small=True) as shuffled:
        stored.refill(pa.concat_tables([first, others]))
        shuffled.refill(pa.concat_tables([first, mixed]))
        names = [name for name, query in library().queries.items() if not query.parameters]
        assert [name for name in names if not stored.query(name).equals(shuffled.query(name))] == []
