"""Every way out that we could think of is tried, one process each: it is refused for its reason, and nothing is left
behind."""

import os
import resource
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from pwd import getpwuid

import duckdb
import pyarrow as pa
import pytest

from fsar_ledger.base.errors import QueryFailed
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.metrics.database import from_rows
from fsar_ledger.metrics.sandbox import Limits
from fsar_ledger.metrics.untrusted import ENVIRONMENT, NEEDED
from tests.quick import few
from tests.untrusted import children, run_untrusted

from .conftest import record

MEMORY_BYTES = 1 << 30
PATIENT = Limits(seconds=60, memory_bytes=MEMORY_BYTES, rows=100_000, answer_bytes=8 << 20)
HASTY = Limits(seconds=1, memory_bytes=MEMORY_BYTES, rows=100_000, answer_bytes=8 << 20)

DISABLED = "disabled by configuration"
ONE = "expected exactly one SELECT"
MANY = "x" * 100

REACHES_OUT = {
    "read a csv": ("SELECT * FROM read_csv('secret.csv')", DISABLED),
    "read a text": ("SELECT content FROM read_text('{base}/secret.csv')", DISABLED),
    "read a blob": ("SELECT content FROM read_blob('/etc/passwd')", DISABLED),
    "read json": ("SELECT * FROM read_json('secret.csv')", DISABLED),
    "read the segments": ("SELECT * FROM read_parquet('{ledger}/segments/*.parquet')", DISABLED),
    "read a database": ("SELECT * FROM read_duckdb('secret.db', table_name = 'a')", DISABLED),
    "read by name": ("SELECT * FROM 'secret.csv'", DISABLED),
    "read by a name in a text": ("SELECT * FROM query_table('secret.csv')", DISABLED),
    "read where DuckDB spills": ("SELECT content FROM read_text('.tmp/secret.txt')", DISABLED),
    "guess a csv": ("SELECT * FROM sniff_csv('secret.csv')", DISABLED),
    "metadata of a segment": ("SELECT * FROM parquet_metadata('{ledger}/segments/000000000000.parquet')", DISABLED),
    "list a folder": ("SELECT * FROM glob('{ledger}/*')", DISABLED),
    "list what DuckDB has installed": ("SELECT * FROM duckdb_extensions()", DISABLED),
    "fetch": ("SELECT * FROM read_csv('http://127.0.0.1:9/x.csv')", DISABLED),
    "fetch by name": ("SELECT * FROM 'https://127.0.0.1:9/x.parquet'", DISABLED),
    "fetch from a bucket": ("SELECT * FROM read_parquet('s3://bucket/x.parquet')", DISABLED),
    "copy in a step": ("WITH x AS (COPY (SELECT 1) TO '{base}/out') SELECT * FROM x", DISABLED),
    "copy in a step over a segment": (
        "WITH x AS (COPY (SELECT 1) TO '{ledger}/segments/000000000000.parquet') FROM x",
        DISABLED,
    ),
    "copy in a step where DuckDB spills": ("WITH x AS (COPY (SELECT 1) TO '.tmp/out') SELECT * FROM x", DISABLED),
    "copy explained": ("EXPLAIN ANALYZE COPY (SELECT 1) TO '{base}/out'", DISABLED),
    "log to a file": ("SELECT * FROM enable_logging(storage = 'file', storage_path = '{base}/out')", "has been locked"),
    "profile to a file": ("SELECT * FROM enable_profiling(save_location = '{base}/out')", "has been locked"),
    "getenv": ("SELECT getenv('FSAR_LEDGER_KEY')", "getenv does not exist"),
    "a function that sets": ("SELECT set_config('threads', '8')", "set_config does not exist"),
    "a Python variable": ("SELECT * FROM question", "question does not exist"),
    "a pointer": ("SELECT * FROM arrow_scan(1::POINTER, 1::POINTER, 1::POINTER)", "POINTER does not exist"),
    "a Python function": ("SELECT * FROM python_map_function(1)", "Binder Error"),
    "insert in a step": (
        "WITH x AS (INSERT INTO run_metrics BY NAME SELECT 'r' AS run_id RETURNING *) SELECT * FROM x",
        "read-only mode",
    ),
    "delete in a step": ("WITH x AS (DELETE FROM run_metrics RETURNING *) SELECT count(*) FROM x", "read-only mode"),
    "insert explained": ("EXPLAIN ANALYZE INSERT INTO run_metrics BY NAME SELECT 'r' AS run_id", "read-only mode"),
    "statements as JSON": (
        "SELECT * FROM json_execute_serialized_sql(json_serialize_sql('COPY (SELECT 1) TO ''{base}/out'''))",
        "Only SELECT",
    ),
    "statements as text": ("SELECT * FROM query('COPY (SELECT 1) TO ''{base}/out''')", "single SELECT"),
    "force a checkpoint": ("SELECT * FROM force_checkpoint()", "Cannot FORCE CHECKPOINT"),
}

IS_NO_SELECT = {
    "copy": ("COPY (SELECT 1) TO '{base}/out'", "found COPY, " + ONE),
    "an open pivot": ("PIVOT events ON type USING count(*)", "two statements"),
    "only a comment": ("  -- nothing\n", "found no statement"),
    "syntax": ("SELEC 1", "syntax error"),
    "a NUL": ("SELECT 1 \0; DROP VIEW events", "NUL at character 10"),
    "half a character": ("SELECT '\udcff'", "not UTF-8 at character 9"),
    "ten million characters": ("SELECT '" + MANY * 100_000 + "'", "10,000,009 bytes"),
    "10,000 parentheses": ("SELECT " + "(" * 10_000 + "1" + ")" * 10_000, "depth limit"),
    "5,000 selects in each other": (
        "SELECT * FROM " + "(SELECT * FROM " * 5_000 + "events" + ")" * 5_000,
        "depth limit",
    ),
}

IS_OF_ANOTHER_KIND = {
    "set": ("SET enable_external_access = true", "found SET"),
    "two statements": ("SELECT 1; COPY (SELECT 1) TO '{base}/out'", "found SELECT, COPY"),
    "copy from": ("COPY run_metrics FROM 'secret.csv'", "found COPY"),
    "export": ("EXPORT DATABASE '{base}/out'", "found EXPORT"),
    "attach": ("ATTACH '{base}/out' AS other", "found ATTACH"),
    "install": ("INSTALL httpfs", "found LOAD"),
    "load": ("LOAD '{base}/secret.db'", "found LOAD"),
    "pragma": ("PRAGMA database_list", "found PRAGMA"),
    "reset": ("RESET enable_external_access", "found SET"),
    "call": ("CALL enable_logging()", "found CALL"),
    "create a table": ("CREATE TABLE x AS SELECT 1", "found CREATE"),
    "create a macro": ("CREATE MACRO abs(x) AS 1", "found CREATE"),
    "create a secret": ("CREATE SECRET s (TYPE http)", "found CREATE"),
    "drop": ("DROP VIEW events", "found DROP"),
    "insert": ("INSERT INTO events SELECT * FROM events", "found INSERT"),
    "update": ("UPDATE events SET seq = 0", "found UPDATE"),
    "prepare": ("PREPARE p AS SELECT 1", "found PREPARE"),
    "vacuum": ("VACUUM", "found VACUUM"),
    "two statements and a comment": ("SELECT 1 /* ; */ ; -- one\nDROP VIEW events", "found SELECT, DROP"),
}

TAKES_ALL_MEMORY = {
    "one text": ("SELECT length(printf('%2000000000d', 1))", "ran out of memory, the limit is 1,024 MiB"),
    "one text of 8 GB": ("SELECT repeat('x', 8000000000)", "Cannot create a string of size"),
    "a text of many": ("SELECT length(string_agg(repeat('x', 1000), '')) FROM range(100000000)", "ran out of memory"),
    "a list": ("SELECT len(range(1000000000))", "ran out of memory"),
    "a list of many": ("SELECT len(list(i)) FROM range(100000000000) AS t(i)", "ran out of memory"),
    "a recursion that grows": (
        "WITH RECURSIVE r(s) AS (SELECT 'x' UNION ALL SELECT s || s FROM r) SELECT max(length(s)) FROM r",
        "ran out of memory",
    ),
    "windows": (
        (
            "SELECT max(s) FROM (SELECT string_agg(repeat('x', 100), '') OVER (ORDER BY i) AS s FROM "
            "range(1000000) AS t(i))"
        ),
        "ran out of memory",
    ),
    "JSON that nests too deep": (
        "SELECT ((repeat('[', 100000) || repeat(']', 100000))::JSON::VARIANT)::VARCHAR AS x",
        "nested too deeply",
    ),
    "too many rows": ("SELECT * FROM range(100001)", "more than 100,000 rows"),
    "too many bytes": ("SELECT repeat('x', 1000) AS x FROM range(20000)", "more than 8,388,608 bytes"),
}

NEVER_ENDS = {
    "a cross join": "SELECT count(*) FROM range(1000000) AS a, range(1000000) AS b, range(1000000) AS c",
    "a recursion": "WITH RECURSIVE r(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM r) SELECT count(*) FROM r",
    "a long range": "SELECT sum(x % 7) FROM range(1000000000000) AS t(x)",
    "a replacement": "SELECT length(regexp_replace(repeat('a', 10000000), 'a', repeat('b', 1000), 'g'))",
    "one call": "SELECT levenshtein(repeat('a', 100000), repeat('b', 100000))",
    "steps that double": "WITH a0 AS NOT MATERIALIZED (SELECT 1 AS x UNION ALL SELECT 2), "
    + ", ".join(f"a{i + 1} AS NOT MATERIALIZED (SELECT p.x FROM a{i} AS p, a{i} AS q)" for i in range(40))
    + " SELECT count(*) FROM a40",
}

ENDED_ALIKE = ("a cross join", "a recursion", "a long range", "a replacement", "steps that double")
"""Left to `make test-all`, since each takes its second: one call, which nothing can interrupt, remains."""

CANNOT_BE_SHOWN = {
    "two columns of one name": ("SELECT 1 AS a, 2 AS a", "two columns named 'a'"),
    "a type that Arrow would change": (
        "SELECT 340282366920938463463374607431768211455::UHUGEINT AS x",
        "'x' holds UHUGEINT",
    ),
    "a type that Arrow would change, inside": ("SELECT [{{'k': '101'::BIT}}] AS x", "'x' holds BIT"),
    "a union": ("SELECT union_value(k := 1) AS x", "'x' holds UNION"),
    "a variant": ("SELECT 42::VARIANT AS x", "'x' holds VARIANT"),
    "a date beyond the calendar": ("SELECT DATE '5000000-01-01' AS x", "years 1 to 9999"),
}

REFUSED = REACHES_OUT | IS_NO_SELECT | TAKES_ALL_MEMORY | CANNOT_BE_SHOWN

READS = {"a name of one's own", "a summary", "a recursion that ends"}
"""What only reads and is asked each time; `make test-all` asks the rest."""

OFTEN = {
    *("read a csv", "fetch", "log to a file", "a NUL", "half a character", "one text"),
    *("JSON that nests too deep", "too many bytes", "a date beyond the calendar"),
}
"""Ways that are tried in a process each time. The others, which one lock or one limit stops with these, `make test-all`
tries: those that reach out all on the locks, in one process (`test_duckdbs_locks_hold_by_themselves`), the rest in a
process each. The soak tries every one in a process."""


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a ledger, whose path has a quote, and beside it what must not be read: a secret, also where DuckDB
    would spill."""
    base = tmp_path_factory.mktemp("escapes")
    ledger = base / "the auditor's ledger"
    with Writer(ledger, "test") as writer:
        writer.append(stage(ledger, [record(architecture, 1) for architecture in ("fsar", "cfc", "dhma")]))
    (base / "home").mkdir()
    (base / ".tmp").mkdir()
    (base / ".tmp" / "secret.txt").write_text("hush")
    (base / "secret.csv").write_text("a,b\n1,2\n")
    (base / "secret.db").write_bytes(b"")
    return base


@pytest.fixture
def surrounded(base: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """That folder as the working folder of a caller with a secret in its environment; afterwards everything is as it
    was, and no process more runs."""
    monkeypatch.chdir(base)
    monkeypatch.setenv("HOME", str(base / "home"))
    monkeypatch.setenv("FSAR_LEDGER_KEY", "hush")
    before, alive, memory = contents(base), children(), resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    yield base
    assert contents(base) == before
    assert children() == alive
    own = resource.getrusage(
        resource.RUSAGE_SELF
    ).ru_maxrss  # a new process starts with the peak of the one that made it
    assert resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss <= max(memory, own, MEMORY_BYTES >> 10)


def contents(folder: Path) -> dict[Path, bytes | None]:
    return {path: path.read_bytes() if path.is_file() else None for path in folder.rglob("*")}


def filled(sql: str, base: Path) -> str:
    return (
        sql.format(base=str(base).replace("'", "''"), ledger=str(ledger_in(base)).replace("'", "''"))
        if "{" in sql
        else sql
    )


def ledger_in(base: Path) -> Path:
    return base / "the auditor's ledger"


@pytest.mark.parametrize("escape", few(REFUSED, OFTEN, REFUSED.keys() - REACHES_OUT.keys() - OFTEN))
def test_it_is_refused_for_its_reason_and_leaves_no_trace(surrounded: Path, escape: str) -> None:
    sql, reason = REFUSED[escape]
    with pytest.raises(QueryFailed) as refused:
        run_untrusted(ledger_in(surrounded), filled(sql, surrounded), PATIENT)
    message = str(refused.value)
    assert message.startswith(("SQL: ", "the answer: "))
    assert reason in message
    assert len(message) < 2_000


@pytest.mark.parametrize("escape", IS_OF_ANOTHER_KIND)
def test_a_statement_of_another_kind_is_refused_before_it_runs(surrounded: Path, escape: str) -> None:
    sql, reason = IS_OF_ANOTHER_KIND[escape]
    with from_rows([]) as database, pytest.raises(QueryFailed, match=f"^SQL: {reason}.*, {ONE}"):
        database.check_one_select(filled(sql, surrounded))


@pytest.mark.parametrize("escape", few(NEVER_ENDS, NEVER_ENDS.keys() - set(ENDED_ALIKE)))
def test_what_never_ends_is_ended_in_time(surrounded: Path, escape: str) -> None:
    began = time.monotonic()
    with pytest.raises(QueryFailed, match=r"^SQL: found no answer after 1 s, the limit"):
        run_untrusted(ledger_in(surrounded), NEVER_ENDS[escape], HASTY)
    assert time.monotonic() - began < 60  # each of them would take hours


ALLOWED = {
    "a name of one's own": "WITH events AS (SELECT 1 AS seq) SELECT seq FROM events",
    "the source first": "FROM events SELECT count(*) AS n",
    "a pivot that lists its values": "PIVOT events ON type IN ('RunStarted.v2') USING count(*)",
    "a summary": "SUMMARIZE events",
    "a description": "DESCRIBE run_started",
    "a plan with times": "EXPLAIN ANALYZE SELECT count(*) FROM events",
    "a SELECT in a text": "SELECT * FROM query('SELECT count(*) AS n FROM events')",
    "a recursion that ends": (
        "WITH RECURSIVE r(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM r WHERE n < 9) SELECT max(n) AS n FROM r"
    ),
}


@pytest.mark.parametrize("question", few(ALLOWED, READS))
def test_what_only_reads_is_answered(surrounded: Path, question: str) -> None:
    assert run_untrusted(ledger_in(surrounded), ALLOWED[question], PATIENT).rows


def test_what_can_be_learnt_of_the_machine_names_no_place_and_no_user(surrounded: Path) -> None:
    lists = {
        "settings": "name, value",
        "views": "view_name, sql",
        "databases": "database_name, path",
        "temporary_files": "'', path",
    }
    asked = " UNION ALL ".join(f"SELECT {columns} FROM duckdb_{name}()" for name, columns in lists.items())
    rows = run_untrusted(ledger_in(surrounded), f"{asked} UNION ALL SELECT 'user', current_user", PATIENT).rows
    learnt = {str(value) for row in rows for value in row.values() if value is not None}
    assert {"enable_external_access", "events", "duckdb"} <= learnt
    assert [
        text
        for text in learnt
        if any(place in text for place in (str(surrounded), getpwuid(os.getuid()).pw_dir, ".duckdb", "hush"))
    ] == []


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="only Linux shows what a process may do")
def test_the_process_has_nothing_of_the_callers_and_may_not_write(surrounded: Path) -> None:
    def ask() -> None:
        with pytest.raises(QueryFailed, match="killed"):
            run_untrusted(ledger_in(surrounded), NEVER_ENDS["a long range"], Limits(seconds=120))

    asking = threading.Thread(target=ask)
    before = children()
    asking.start()
    while not (started := children() - before):
        time.sleep(0.01)
    process = Path("/proc") / started.pop()
    while "Max processes 0" not in (may := " ".join((process / "limits").read_text().split())):
        time.sleep(0.01)
    environment = (process / "environ").read_text().rstrip("\0").split("\0")
    place = (process / "cwd").readlink()
    os.kill(int(process.name), signal.SIGKILL)
    asking.join()
    assert {line.partition("=")[0] for line in environment} <= {*ENVIRONMENT, *NEEDED}
    assert place == Path("/")
    assert "Max file size 0 0" in may
    assert "Max open files 1024 1024" in may
    assert f"Max address space {4 << 30} {4 << 30}" in may


def test_variables_of_python_are_no_tables_once_it_is_locked() -> None:
    secret = pa.table({"word": ["hush"]})
    with from_rows([]) as database:
        assert database._connection.sql("SELECT * FROM secret").fetchall() == [tuple(secret["word"].to_pylist())]
    with from_rows([]) as database:
        database.lock(10, MEMORY_BYTES)
        with pytest.raises(duckdb.CatalogException, match="secret does not exist"):
            database._connection.sql("SELECT * FROM secret")


@pytest.mark.slow
def test_duckdbs_locks_hold_by_themselves_where_the_caller_works(surrounded: Path) -> None:
    escaped = []
    for name, (sql, reason) in REACHES_OUT.items():
        with from_rows([]) as database:
            database.lock(10, MEMORY_BYTES)
            database.prepare(sql)
            database.only_read()
            try:
                database.rows(filled(sql, surrounded))
            except QueryFailed as refusal:
                said = str(refusal)
                if reason in said and said.startswith("SQL: ") and len(said) < 2_000:
                    continue
            escaped.append(name)
    assert escaped == []


def test_without_the_locks_these_escape(surrounded: Path) -> None:
    escaped = set()
    for name, (sql, _) in REACHES_OUT.items():
        if "fetch" in name or "over a segment" in name:
            continue
        with duckdb.connect() as connection:
            question = pa.table({"secret": [1]})  # noqa: F841  DuckDB finds Python's variables
            connection.execute("CREATE TABLE run_metrics AS SELECT 'a' AS run_id")
            try:
                connection.execute(filled(sql, surrounded)).fetchall()
            except duckdb.Error:
                continue
            escaped.add(name)
    for path in (surrounded / "out", surrounded / ".tmp" / "out"):
        path.unlink()
    assert escaped >= {
        *("read a csv", "read by name", "read a blob", "list a folder"),
        *("copy in a step", "copy in a step where DuckDB spills"),
    }
    assert escaped >= {
        "copy explained",
        "insert in a step",
        "delete in a step",
        "read the segments",
        "a Python variable",
    }
