"""SQL that anyone may have written reads one ledger and reaches nothing else."""

import threading
import time
from pathlib import Path

import pytest

from fsar_ledger.errors import LedgerCorrupted, NotALedger, QueryFailed
from fsar_ledger.metrics.untrusted import Limits, run_untrusted


def test_a_select_over_events_views_and_metrics_is_answered_with_the_head(ledger: Path) -> None:
    answer = run_untrusted(ledger, "SELECT architecture, count(*) AS runs, sum(seq) AS zero FROM run_started GROUP BY ALL ORDER BY ALL")
    assert answer.columns == ["architecture", "runs", "zero"]
    assert answer.rows == [{"architecture": name, "runs": 2, "zero": 0} for name in ("cfc", "dhma", "fsar")]
    assert (answer.head.size, answer.head.commits) == (18, 2)
    means = run_untrusted(ledger, "select metric, mean from METRIC_SUMMARY where scenario is null and architecture = 'fsar' order by position")
    assert len(means.rows) == 8


def test_an_empty_ledger_and_an_empty_answer_keep_their_columns(empty_ledger: Path) -> None:
    answer = run_untrusted(empty_ledger, "SELECT run_id, seq FROM events")
    assert (answer.columns, answer.rows) == (["run_id", "seq"], [])


def test_a_plan_may_be_asked_for(ledger: Path) -> None:
    assert run_untrusted(ledger, "EXPLAIN SELECT count(*) FROM events").rows


ESCAPES = {
    "copy": "COPY (SELECT 1) TO '{out}'",
    "copy in a step": "WITH x AS (COPY (SELECT 1) TO '{out}') SELECT * FROM x",
    "copy explained": "EXPLAIN ANALYZE COPY (SELECT 1) TO '{out}'",
    "attach": "ATTACH '{out}' AS other",
    "export": "EXPORT DATABASE '{out}'",
    "read a text": "SELECT * FROM read_text('{secret}')",
    "read a csv": "SELECT * FROM read_csv('{secret}')",
    "read by name": "SELECT * FROM '{secret}'",
    "list a folder": "SELECT * FROM glob('{ledger}/*')",
    "read the segments": "SELECT * FROM read_parquet('{ledger}/segments/*.parquet')",
    "fetch": "SELECT * FROM read_csv('http://127.0.0.1:9/x.csv')",
    "install": "INSTALL httpfs",
    "load": "LOAD httpfs",
    "set": "SET enable_external_access = true",
    "set in a function": "SELECT set_config('threads', '8')",
    "pragma": "PRAGMA database_list",
    "two statements": "SELECT 1; COPY (SELECT 1) TO '{out}'",
    "drop": "DROP VIEW events",
    "insert": "INSERT INTO events SELECT * FROM events",
    "python variable": "SELECT * FROM segments",
    "nothing": "  -- nothing\n",
    "syntax": "SELEC 1",
}


@pytest.mark.parametrize("escape", ESCAPES)
def test_what_reaches_outside_is_refused_and_leaves_no_trace(ledger: Path, tmp_path: Path, escape: str) -> None:
    out, secret = tmp_path / "out", tmp_path / "secret.csv"
    secret.write_text("a,b\n1,2\n")
    before = {path: path.read_bytes() for path in ledger.rglob("*") if path.is_file()}
    with pytest.raises(QueryFailed, match=r"^SQL: "):
        run_untrusted(ledger, ESCAPES[escape].format(out=out, secret=secret, ledger=str(ledger).replace("'", "''")))
    assert not out.exists()
    assert before == {path: path.read_bytes() for path in ledger.rglob("*") if path.is_file()}


def test_a_select_that_never_ends_is_ended(ledger: Path) -> None:
    began = time.monotonic()
    with pytest.raises(QueryFailed, match="after 2 s"):
        run_untrusted(ledger, "SELECT count(*) FROM range(1000000000000) AS a(x) WHERE x % 7 = 3", Limits(seconds=2))
    assert time.monotonic() - began < 10


def test_a_select_that_takes_all_memory_is_ended(ledger: Path) -> None:
    with pytest.raises(QueryFailed, match=r"^SQL: "):
        run_untrusted(ledger, "SELECT string_agg(repeat('x', 4000000000), '') FROM range(8)", Limits(seconds=20, memory_bytes=2 << 30))


def test_an_answer_with_too_many_rows_or_bytes_is_refused(ledger: Path) -> None:
    with pytest.raises(QueryFailed, match="more than 1,000 rows"):
        run_untrusted(ledger, "SELECT * FROM range(1001)", Limits(rows=1000))
    with pytest.raises(QueryFailed, match="size"):
        run_untrusted(ledger, "SELECT repeat('x', 100000) AS x", Limits(answer_bytes=50_000))


def test_a_missing_ledger_or_segment_is_said(ledger: Path, tmp_path: Path) -> None:
    with pytest.raises(NotALedger):
        run_untrusted(tmp_path / "nowhere", "SELECT 1")
    sorted((ledger / "segments").iterdir())[0].unlink()
    with pytest.raises(LedgerCorrupted):
        run_untrusted(ledger, "SELECT 1")


def test_several_may_ask_at_once(ledger: Path) -> None:
    answers: list[int] = []

    def ask(number: int) -> None:
        answers.append(run_untrusted(ledger, f"SELECT {number} AS x").rows[0]["x"])

    threads = [threading.Thread(target=ask, args=(number,)) for number in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(answers) == [0, 1, 2]
