"""SQL that anyone may have written reads one ledger and reaches nothing else."""

import threading
import time
from pathlib import Path

import pyarrow as pa
import pytest

from fsar_ledger.base.errors import QueryFailed
from fsar_ledger.metrics import untrusted
from fsar_ledger.metrics.definitions import metrics
from fsar_ledger.metrics.sandbox import SLICE_BYTES, Limits, slices, weight
from fsar_ledger.metrics.untrusted import stream_untrusted
from tests.untrusted import run_untrusted


@pytest.mark.slow
def test_a_select_over_events_views_and_metrics_is_answered_with_the_head(ledger: Path) -> None:
    answer = run_untrusted(
        ledger, "SELECT architecture, count(*) AS runs, sum(seq) AS zero FROM run_started GROUP BY ALL ORDER BY ALL"
    )
    assert answer.columns == ["architecture", "runs", "zero"]
    assert answer.rows == [{"architecture": name, "runs": 2, "zero": 0} for name in ("cfc", "dhma", "fsar")]
    assert (answer.head.size, answer.head.commits) == (18, 2)
    means = run_untrusted(
        ledger,
        "select metric, mean from METRIC_SUMMARY where scenario is null and architecture = 'fsar' order by position",
    )
    assert [row["metric"] for row in means.rows] == [one.name for one in metrics()]


def test_an_empty_ledger_and_an_empty_answer_keep_their_columns(empty_ledger: Path) -> None:
    answer = run_untrusted(empty_ledger, "SELECT run_id, seq FROM events")
    assert (answer.columns, answer.rows) == (["run_id", "seq"], [])


def test_a_plan_may_be_asked_for(ledger: Path) -> None:
    assert run_untrusted(ledger, "EXPLAIN SELECT count(*) FROM events").rows


def test_too_few_open_files_are_said_and_no_reason_to_look_for_damage(
    ledger: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    none = "import resource; resource.setrlimit(resource.RLIMIT_NOFILE, (3, 3)); answer("
    monkeypatch.setattr(untrusted, "START", untrusted.START.replace("answer(", none))
    monkeypatch.setattr(untrusted, "first_damage", lambda _: pytest.fail("looked for damage"))
    with pytest.raises(QueryFailed, match="needed more than the 3 files it may have open; raise `ulimit -n`"):
        run_untrusted(ledger, "SELECT count(*), max(run_id) FROM events")


@pytest.mark.slow
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


def test_a_long_answer_comes_in_parts_and_in_order(ledger: Path) -> None:
    with stream_untrusted(ledger, "SELECT i, [i, i + 1] AS pair FROM range(50000) AS t(i)") as answer:
        assert answer.columns == ["i", "pair"]
        batches = list(answer.batches)
    assert len(batches) > 4
    assert [i for batch in batches for i in batch["i"].to_pylist()] == list(range(50_000))
    assert batches[-1].to_pylist()[-1] == {"i": 49_999, "pair": [49_999, 50_000]}


@pytest.mark.slow
def test_the_time_of_whoever_takes_the_answer_counts(ledger: Path) -> None:
    with stream_untrusted(ledger, "SELECT i FROM range(200000) AS t(i)", Limits(seconds=2)) as answer:
        next(answer.batches)
        time.sleep(2)
        with pytest.raises(QueryFailed, match="after 2 s, the limit"):
            next(answer.batches)


@pytest.mark.slow
def test_a_row_that_cannot_be_cut_has_a_limit(ledger: Path) -> None:
    with pytest.raises(QueryFailed, match="found a row that takes"):
        run_untrusted(ledger, "SELECT range(4300000) AS many")


def test_values_that_need_no_bytes_count_too() -> None:
    batch = pa.RecordBatch.from_arrays([pa.nulls(100_000)] * 20, names=[f"n{number}" for number in range(20)])
    assert batch.nbytes < 10
    parts = list(slices(batch))
    assert sum(part.num_rows for part in parts) == 100_000
    assert all(weight(part) <= SLICE_BYTES for part in parts)


def test_what_lists_maps_and_structs_hold_is_counted_in_each_part() -> None:
    schema = pa.schema(
        {"s": pa.struct({"l": pa.list_(pa.int8())}), "f": pa.bool_(), "m": pa.map_(pa.string(), pa.int8())}
    )
    batch = pa.RecordBatch.from_pylist([{"s": {"l": [1, 2]}, "f": True, "m": [("a", 1)]}] * 10, schema=schema)
    whole, half = weight(batch), weight(batch.slice(5))
    assert whole - batch.nbytes == 16 * 10 * (1 + 1 + 2 + 1 + 3)
    assert half - batch.slice(5).nbytes == 16 * 5 * 8
    assert weight(batch.slice(0, 0)) == batch.slice(0, 0).nbytes
