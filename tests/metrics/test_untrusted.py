"""SQL that anyone may have written reads one ledger and reaches nothing else."""

import threading
from pathlib import Path

import pytest

from fsar_ledger.errors import LedgerCorrupted, NotALedger
from fsar_ledger.metrics.untrusted import run_untrusted


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
