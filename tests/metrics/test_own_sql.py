"""SQL of one's own can call every query that takes parameters, and can ask what there is to ask."""

import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from scipy import stats

from fsar_ledger.base.errors import QueryFailed
from fsar_ledger.metrics.database import Database, connect, from_rows
from fsar_ledger.metrics.library import library
from fsar_ledger.metrics.own_sql import first_lines, listing, understood
from fsar_ledger.metrics.sandbox import prepared
from tests.queries.keys import required
from tests.untrusted import run_untrusted

MACROS = {name: query for name, query in library().relations.items() if query.parameters}


def called(name: str) -> str:
    given = ", ".join(f"{one} := {value}" for one, value in required(MACROS[name]).items())
    return f"{name}({given})"


@pytest.mark.slow
def test_every_query_with_parameters_can_be_called_by_any_sql(ledger: Path) -> None:
    counts = "\nUNION ALL ".join(f"SELECT '{name}' AS name, count(*) AS rows FROM {called(name)}" for name in MACROS)
    answer: object = None
    with suppress(QueryFailed):
        answer = {row["name"]: row["rows"] for row in run_untrusted(ledger, counts).rows}
    with connect(ledger) as database:
        assert answer == {name: len(database.query(name, required(query))) for name, query in MACROS.items()}


@pytest.mark.slow
def test_a_run_is_given_by_name_or_number_and_one_that_is_not_on_record_is_said(ledger: Path) -> None:
    sql = "SELECT run_id FROM decision_owner(seq := 1, {})"
    (by_number,) = run_untrusted(ledger, sql.format("run := 1")).rows
    assert run_untrusted(ledger, sql.format(f"run := '{by_number['run_id']}'")).rows == [by_number]
    with pytest.raises(QueryFailed, match=r"run 99: there is no such run.*SELECT number, run_id FROM run_numbers"):
        run_untrusted(ledger, sql.format("run := 99"))


@pytest.mark.slow
def test_a_table_that_is_a_macro_is_said_to_be_called(ledger: Path) -> None:
    with pytest.raises(QueryFailed, match=r"takes parameters: .*action = all.* as in FROM denials\(\)"):
        run_untrusted(ledger, "SELECT * FROM denials")


@pytest.mark.slow
def test_the_parameters_that_a_macro_has_are_named_without_a_tab_that_a_terminal_would_show_as_such() -> None:
    message = "Candidate macros:\n\tdenials(run := 'all')\n\n"
    assert first_lines(message) == "Candidate macros:\n    denials(run := 'all')"


def test_the_tables_are_shown_with_their_parameters_whatever_was_read_before(ledger: Path) -> None:
    (shown,) = run_untrusted(ledger, "SELECT list(name ORDER BY name) AS names FROM (SHOW TABLES)").rows
    assert shown["names"] == sorted(["events", *library().relations])
    found = {row["name"]: row["parameters"] for row in run_untrusted(ledger, "show all tables").rows}
    assert (found["denials"], found["events"]) == ("run = all, action = all, robot = all", None)
    assert {name for name, taken in found.items() if taken} == MACROS.keys()


@pytest.fixture(scope="module")
def empty() -> Iterator[Database]:
    with from_rows([]) as database:
        yield database


@pytest.mark.slow
def test_whatever_is_shown_can_be_described_and_read(empty: Database) -> None:
    for name in listing()["name"].to_pylist():
        described = rows(empty, f"DESCRIBE {name}")
        read = next(empty.batches(prepared(empty, f"FROM {called(name) if name in MACROS else name} LIMIT 0")))
        assert [row["column_name"] for row in described] == read.schema.names


@pytest.mark.parametrize("verb", ["DESCRIBE", "DESC", "SHOW", "SUMMARIZE"])
@pytest.mark.parametrize("name", ["denials", "DENIALS", '"denials"', "decision_owner", "run_started", "events"])
def test_a_relation_is_described_by_its_name_alone_and_within_a_select(empty: Database, verb: str, name: str) -> None:
    alone = rows(empty, f"/* é */ {verb} {name} -- of SHOW TABLES\n;")
    assert alone[0]["column_name"] == "run_id"
    assert rows(empty, f"SELECT column_name FROM ({verb} {name}) LIMIT 1") == [{"column_name": "run_id"}]


@pytest.mark.parametrize(
    "sql",
    [
        "SELECT 'SHOW TABLES', 'é', \"show tables\" FROM events",
        "WITH denials AS (SELECT 1 AS requests) SELECT requests FROM denials ORDER BY requests DESC",
        "SELECT 1 -- DESCRIBE denials",
        "SHOW TABLES FROM main",
        "DESCRIBE SELECT count(*) AS denials FROM request_denied",
        "",
    ],
)
def test_other_sql_is_run_as_it_is_and_makes_no_macro(sql: str) -> None:
    assert understood(sql, library()) == (sql, (), False)


def rows(database: Database, sql: str) -> list[dict[str, object]]:
    return [row for batch in database.batches(prepared(database, sql)) for row in batch.to_pylist()]


def test_no_p_is_zero_however_far_out(empty: Database) -> None:
    sql = "SELECT t_sf2(318.0, 999.0) AS t, norm_sf2(-60.0) AS z, binomial_half_sf2(0.0, 3000.0) AS tosses"
    (found,) = empty.rows(sql)
    assert set(found.values()) == {sys.float_info.min}
    (found,) = empty.rows("SELECT t_sf2(2.0, 9.0) AS t, norm_sf2(2.0) AS z, binomial_half_sf2(2.0, 9.0) AS tosses")
    expected = [2 * stats.t.sf(2, 9), 2 * stats.norm.sf(2), stats.binomtest(2, 9).pvalue]
    assert [*found.values()] == pytest.approx(expected, rel=1e-12)
