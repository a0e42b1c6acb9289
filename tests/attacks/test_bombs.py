"""The cost of reading a hostile ledger: small files and short SELECTs took gigabytes, minutes, or never ended."""

from pathlib import Path

import pytest

from tests.ledger.bomb_trial import Cost, cost_of
from tests.ledger.bombs import BOMBS, base_ledger

from .conftest import attacked

PROCESSOR_S = 10
MEMORY_MIB = 1024
PART_MIB = 224


def exploded(place: Path, name: str, *call: str) -> Cost:
    """Measure this call in a folder with a ledger that holds the bomb."""
    base_ledger(place / "ledger")
    BOMBS[name].lay(place / "ledger")
    return cost_of(call, place, 60, attacked())


@pytest.mark.slow
def test_open_claims_cost_no_more_than_their_number(tmp_path: Path) -> None:
    cost = exploded(tmp_path, "200,000 open claims", "query", "conflicts", "ledger")
    assert cost.code == 0
    assert cost.processor_s < PROCESSOR_S


@pytest.mark.slow
def test_the_largest_number_of_a_run_does_not_hang_the_report(tmp_path: Path) -> None:
    cost = exploded(tmp_path, "numbers as large as there are", "report", "ledger", "--out", "out.pdf")
    assert cost.code in (0, 3)
    assert cost.processor_s < PROCESSOR_S


@pytest.mark.slow
def test_a_long_answer_is_held_in_parts(tmp_path: Path) -> None:
    base_ledger(tmp_path / "ledger")
    select = "SELECT [x, x] AS l FROM range(200000) AS t(x)"
    cost = cost_of(["sql", "ledger", select, "--json"], tmp_path, 120, attacked())
    assert cost.code == 0
    assert cost.memory_mib < PART_MIB  # an idle process takes 130


@pytest.mark.slow
def test_the_memory_of_a_reader_is_limited_and_the_limit_stated(tmp_path: Path) -> None:
    cost = exploded(tmp_path, "eight million names in lists", "verify", "ledger", "--workers", "1")
    assert cost.memory_mib < MEMORY_MIB
    assert cost.code in (2, 3)
