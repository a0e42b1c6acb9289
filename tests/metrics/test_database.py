"""The database shows what is committed at one head, binds parameters, spills, and says what is wrong in one message."""

import tempfile
from contextlib import nullcontext
from pathlib import Path

import pyarrow as pa
import pytest

from fsar_ledger.base.errors import FsarLedgerError, LedgerCorrupted, QueryFailed, UnknownQuery
from fsar_ledger.events import CONCERNS
from fsar_ledger.ledger.rows.schema import LAYOUTS, SCHEMA
from fsar_ledger.metrics.database import Database, Value, connect, from_rows, from_table, plain_rows, table_of
from fsar_ledger.metrics.library import REQUIRED_KEYS, Library, Query, staging_sql, view_name
from fsar_ledger.metrics.sql_values import Parameter
from tests.metrics.conftest import record
from tests.untrusted import run_untrusted


def test_events_are_the_committed_rows_with_all_columns(ledger: Path) -> None:
    with connect(ledger) as database:
        table = database.table("SELECT * FROM events")
        assert database.head is not None
        assert database.head.size == table.num_rows == 18
    assert table.column_names == SCHEMA.names
    assert table.schema.types == [pa.list_(pa.string()) if pa.types.is_list(kind) else kind for kind in SCHEMA.types]


def test_a_reader_keeps_its_head_while_another_commits(ledger: Path) -> None:
    from fsar_ledger.ledger.store.append import Writer
    from fsar_ledger.ledger.store.staging import stage

    with connect(ledger) as database:
        with Writer(ledger, "test") as writer:
            writer.append(stage(ledger, [record("fsar", 9)]))
        assert database.rows("SELECT count(*) AS events FROM events") == [{"events": 18}]


def test_a_file_that_no_commit_names_is_not_read(ledger: Path) -> None:
    segments = ledger / "segments"
    first = sorted(segments.iterdir())[0]
    (segments / "stray.parquet").write_bytes(first.read_bytes())
    with connect(ledger) as database:
        assert database.rows("SELECT count(*) AS events FROM events") == [{"events": 18}]


def test_an_empty_ledger_has_all_relations_without_rows(empty_ledger: Path) -> None:
    with connect(empty_ledger) as database:
        assert database.table("SELECT * FROM events").schema.names == SCHEMA.names
        assert database.query("metrics/metric_summary").num_rows == 0


def test_a_type_without_rows_is_looked_for_nowhere(ledger: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fsar_ledger.metrics.database.SMALL", 0)  # the rows of a small ledger are copied, of every type
    with connect(ledger) as database:
        held = {row["type"] for row in database.rows("SELECT DISTINCT type FROM events")}
        assert held == LAYOUTS.keys() - database.absent
        for tag in LAYOUTS:
            view = f"SELECT * FROM {view_name(tag)}"
            plan = "".join(str(row) for row in database.rows(f"EXPLAIN {view}"))
            assert ("PARQUET" in plan) == (tag in held), (tag, plan)
            assert database.rows(f"DESCRIBE {view}") == database.rows(f"DESCRIBE {staging_sql(tag)}")


def damaged(ledger: Path, place: str) -> str:
    """The name of a segment whose first pages or footer are now nonsense."""
    segment = sorted((ledger / "segments").iterdir())[1]
    data = bytearray(segment.read_bytes())
    span = slice(4, 2000) if place == "pages" else slice(-8, None)
    data[span] = b"X" * len(data[span])
    segment.write_bytes(bytes(data))
    return segment.name


@pytest.mark.parametrize("place", ["pages", "footer"])
def test_an_unreadable_segment_is_named(ledger: Path, place: str) -> None:
    name = damaged(ledger, place)
    with pytest.raises(LedgerCorrupted, match=name), connect(ledger) as database:
        database.rows("SELECT * FROM events")


@pytest.mark.parametrize("place", ["pages", "footer"])
def test_an_unreadable_segment_is_named_to_untrusted_sql_too(ledger: Path, place: str) -> None:
    name = damaged(ledger, place)
    with pytest.raises(LedgerCorrupted, match=name):
        run_untrusted(ledger, "SELECT * FROM events")


@pytest.mark.parametrize(
    "sql", ["SELEC 1", "SELECT nothing FROM events", "SELECT * FROM nowhere", "SELECT 'x'::INTEGER", "SELECT $a"]
)
def test_wrong_sql_is_one_message_of_a_few_lines(sql: str) -> None:
    with from_rows([]) as database, pytest.raises(QueryFailed, match=r"^SQL: ") as caught:
        database.rows(sql)
    assert len(str(caught.value).splitlines()) <= 6


def test_parameters_are_bound_and_not_pasted() -> None:
    with from_rows([{"run_id": "it's"}]) as database:
        assert database.rows("SELECT run_id FROM events WHERE run_id = $run", {"run": "it's"}) == [{"run_id": "it's"}]
        assert database.rows("SELECT run_id FROM events WHERE run_id = $run", {"run": "x' OR TRUE --"}) == []


def test_sums_of_integers_are_integers() -> None:
    with from_rows([{"seq": 1}, {"seq": 2}]) as database:
        (row,) = database.rows("SELECT sum(seq) AS total, sum(time_us) AS nothing FROM events")
    assert row == {"total": 3, "nothing": None}
    assert type(row["total"]) is int


def test_a_query_is_found_by_its_name_or_last_part_and_sorted() -> None:
    rows = [{"type": "TaskCompleted.v1", "run_id": run_id} for run_id in ("b", "a")]
    with from_rows(rows) as database:
        assert database.query("staging/task_completed").to_pylist() == database.query("task_completed").to_pylist()
        assert [row["run_id"] for row in database.query("task_completed").to_pylist()] == ["a", "b"]


def test_an_unknown_query_is_answered_with_the_nearest_names() -> None:
    with from_rows([]) as database:
        with pytest.raises(UnknownQuery, match="metrics/policy_violations"):
            database.query("policy_violation")
        with pytest.raises(UnknownQuery, match="query --list"):
            database.query("xyzzy")


HEADER = dict.fromkeys(REQUIRED_KEYS, "x")
AUDIT = Query(
    "audit/of_run",
    "SELECT seq FROM events WHERE run_id = $run AND seq >= $from::BIGINT",
    HEADER,
    {"run": Parameter("run", "run"), "from": Parameter("from", "seq", "0")},
)


def audited(parameters: dict[str, str]) -> list[int]:
    database = Database(None, (), queries=Library([AUDIT]))
    with database:
        database.hold("events", from_rows_table())
        return [row["seq"] for row in database.query("of_run", parameters).to_pylist()]


@pytest.mark.parametrize(
    ("sql", "said"),
    [
        ("SELECT seq\nFROM of_run", r"\nLINE 2: FROM of_run\n.*\nof_run takes parameters, .* move what both need to "),
        ("SELECT seq,\n    nothing\nFROM events", r"\nLINE 2:     nothing\n"),
        ("SELECT seq FROM\nWHERE TRUE", r"\nLINE 2: WHERE TRUE\n"),
    ],
)
@pytest.mark.parametrize("name", ["facts/wrong", "audit/above"])
def test_a_packaged_query_that_cannot_run_is_named_with_its_line_also_below_another(
    sql: str, said: str, name: str
) -> None:
    queries = [Query("facts/wrong", sql, HEADER), Query("audit/above", "SELECT seq FROM wrong", HEADER)]
    with Database(None, (), queries=Library([AUDIT, *queries])) as database:
        database.hold("events", from_rows_table())
        with pytest.raises(QueryFailed, match=rf"^queries/facts/wrong\.sql: \w+ Error: (?s:.*){said}"):
            database.query(name)


@pytest.mark.parametrize(
    ("sql", "found"),
    [
        ("SELECT $run AS nothing FROM nowhere", "Catalog Error: .* nowhere does not exist"),
        ("SELECT seq FROM events WHERE run_id = $rum", "Invalid Input Error: .*: rum"),
    ],
)
def test_a_packaged_query_with_parameters_that_cannot_run_is_named(sql: str, found: str) -> None:
    wrong = Query("audit/wrong", sql, HEADER, {"run": Parameter("run", "run", "all")})
    with Database(None, (), queries=Library([wrong])) as database:
        database.hold("events", from_rows_table())
        with pytest.raises(QueryFailed, match=rf"^queries/audit/wrong\.sql: {found}"):
            database.query("wrong")


def from_rows_table() -> pa.Table:
    return pa.table({"run_id": ["a", "a", "b"], "seq": [1, 2, 3]})


def test_a_query_with_parameters_runs_with_their_values_or_defaults() -> None:
    assert audited({"run": "a"}) == [1, 2]
    assert audited({"run": "a", "from": "2"}) == [2]


def test_a_missing_unknown_or_unfit_parameter_is_said() -> None:
    with pytest.raises(UnknownQuery, match="found no value of run, which has no default"):
        audited({})
    with pytest.raises(UnknownQuery, match=r"found parameter colour.*run, from"):
        audited({"run": "a", "colour": "red"})
    with pytest.raises(QueryFailed, match="Conversion Error"):
        audited({"run": "a", "from": "soon"})


def test_rows_with_unknown_columns_are_refused() -> None:
    with pytest.raises(ValueError, match="colour"):
        from_rows([{"colour": "red"}])


def test_tables_with_some_columns_have_the_others_as_null() -> None:
    with from_table(pa.table({"run_id": ["a"]})) as database:
        assert database.rows("SELECT run_id, seq, path FROM events") == [{"run_id": "a", "seq": None, "path": None}]


def test_a_held_table_replaces_the_query_of_its_name() -> None:
    with from_rows([]) as database:
        database.hold("runs", pa.table({"run_id": ["held"]}))
        assert database.rows("SELECT run_id FROM runs") == [{"run_id": "held"}]


def test_a_stored_relation_is_computed_once_and_a_view_each_time() -> None:
    stored = Query("x/stored", "SELECT random() AS x", HEADER | {"Stored": "drawn once"})
    view = Query("x/view", "SELECT random() AS x", HEADER)
    with Database(None, (), queries=Library([stored, view])) as database:
        assert database.rows("SELECT x FROM stored") == database.rows("SELECT x FROM stored")
        assert database.rows('SELECT x FROM "view"') != database.rows('SELECT x FROM "view"')


def test_a_refilled_database_answers_of_its_new_rows_alone() -> None:
    started: dict[str, Value] = {
        "type": "RunStarted.v2",
        "seq": 0,
        "time_us": 0,
        "observes": list(CONCERNS),
        "parameters": "{}",
        "kind": "simulated",
    }
    with from_rows([{**started, "run_id": "old"}]) as database:
        assert [row["run_id"] for row in database.rows("SELECT DISTINCT run_id FROM run_metrics")] == ["old"]
        database.refill(table_of([{**started, "run_id": "new"}, {**started, "run_id": "newer"}]))
        for relation in ("events", "run_started", "runs", "run_metrics"):
            assert [row["run_id"] for row in database.rows(f"SELECT DISTINCT run_id FROM {relation} ORDER BY ALL")] == [
                "new",
                "newer",
            ], relation


def test_rows_are_those_of_the_table_whatever_their_types() -> None:
    sql = (
        "SELECT sum(i) AS whole, avg(i) AS mean, list(i) AS many, {'a': max(i)} AS one, NULL AS nothing, 1.50 AS "
        "money FROM range(3) AS t(i)"
    )
    with from_rows([]) as database:
        assert repr(database.rows(sql)) == repr(plain_rows(database.table(sql)))


def test_a_refilled_database_has_forgotten_what_was_defined_and_held_in_it() -> None:
    with from_rows([]) as database:
        database.define("runs", "SELECT 1 AS run_id")
        database.hold("conflicts", pa.table({"run_id": ["mine"]}))
        found = [database.rows(f"SELECT count(*) AS n FROM {name}") for name in ("runs", "conflicts")]
        assert found == [[{"n": 1}], [{"n": 1}]]
        database.refill(pa.table({"run_id": pa.array([], pa.string())}))
        told = [database.rows(f"SELECT count(*) AS n FROM {name}") for name in ("runs", "conflicts")]
        assert told == [[{"n": 0}], [{"n": 0}]]


LARGE = "SELECT max(word) AS word FROM (SELECT hash(range)::VARCHAR AS word FROM range(1000000) ORDER BY word OFFSET 1)"


@pytest.mark.parametrize("may_spill", [False, True])
def test_only_a_database_that_may_spill_puts_into_files_what_does_not_fit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, may_spill: bool
) -> None:
    folder = tmp_path / "it's temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    with Database(None, (), may_spill=may_spill) as database:
        database._connection.execute("SET memory_limit = '50MB'")
        with nullcontext() if may_spill else pytest.raises(FsarLedgerError, match="memory"):
            assert len(database.rows(LARGE)) == 1
        assert bool([*folder.glob("*/*")]) == may_spill
    assert not [*folder.iterdir()]
