"""How often a human stepped in: the calls are listed, and a share of runs is not told as a number of calls."""

from pathlib import Path

import pytest

from fsar_ledger import Ledger
from tests.cli.conftest import Call
from tests.cli.terminals import on_a_terminal_here
from tests.quick import few


@pytest.mark.slow
def test_the_runs_with_an_intervention_are_the_share_that_metrics_print(ledger: Path) -> None:
    opened = Ledger(ledger)
    shares = [row for row in opened.metrics().rows() if row["metric"] == "human_intervention"]
    calls = opened.query("interventions").rows()
    assert len({row["run_id"] for row in calls}) == sum(row["mean"] * row["n"] for row in shares) > 0


@pytest.mark.slow
def test_the_interventions_of_one_run_are_asked_for_by_its_number(call: Call, ledger: Path) -> None:
    opened = Ledger(ledger)
    calls = opened.query("interventions").rows()
    number = opened.numbers()[calls[0]["run_id"]]
    expected = [row for row in calls if row["run_id"] == calls[0]["run_id"]]
    assert opened.query("interventions", run=str(number)).rows() == expected
    listed = call("query", "interventions", ledger, "--param", f"run={number}", "--ndjson")
    assert len(listed.out.splitlines()) == len(expected)


@pytest.mark.parametrize("verb", few(["metrics", "statistics"], ["metrics"]))
def test_on_a_terminal_human_intervention_is_told_to_be_a_share_of_runs(call: Call, ledger: Path, verb: str) -> None:
    shown = on_a_terminal_here(200, verb, ledger)
    assert "human_intervention is the share of runs that called the fleet supervisor" in shown
    assert "share of runs" not in call(verb, ledger).out
