"""Each of thirty bombs against each command that touches it: a clear error or a right answer, within ten CPU seconds
and a gibibyte.

CPU seconds, because wall time depends on what else runs, and of a core that runs the yardstick of `bomb_trial` in its
time, because a slow or shared core takes more of them for the same work. A few small bombs are tried with every run of
the tests, the rest with the long ones.
"""

import shutil
from pathlib import Path

import pytest

from tests.ledger.bomb_trial import cost_of
from tests.ledger.bombs import BOMBS, LEDGER, base_ledger, committed, rows
from tests.quick import few

PROCESSOR_S = 10
MEMORY_MIB = 1024
ENOUGH = ("numbers as large as there are", "a parameter of 100 kB")
"""Bombs that are tried each time, with two calls each."""


@pytest.fixture(scope="module")
def intact(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("intact") / "ledger"
    base_ledger(path)
    return path


def explode(name: str, intact: Path, place: Path, most: int | None = None) -> None:
    """Put the bomb in place and make its first calls (None: all)."""
    shutil.copytree(intact, place / "ledger")
    bomb = BOMBS[name]
    bomb.lay(place / "ledger")
    for call in bomb.calls[:most]:
        cost = cost_of([word.replace(LEDGER, "ledger") for word in call], place)
        assert cost.code in (0, 1, 2, 3), (call, cost)
        assert "Traceback" not in cost.said, (call, cost)
        assert cost.said.startswith("fsar-ledger: ") or cost.code in (0, 1) or call[0] == "maintain", (call, cost)
        assert len(cost.said) < 200_000, (call, len(cost.said))
        assert cost.processor_s / cost.slowness < PROCESSOR_S, (call, cost)
        assert cost.memory_mib < MEMORY_MIB, (call, cost)
        assert call[0] != "verify" or cost.code != 0 or "beside" in call, (call, cost)


def test_there_are_thirty() -> None:
    assert len(BOMBS) == 30


@pytest.mark.parametrize("name", few(ENOUGH, ENOUGH[:1]))
def test_a_bomb_ends_in_a_clear_error_in_little_time_and_memory(intact: Path, tmp_path: Path, name: str) -> None:
    explode(name, intact, tmp_path, 2)


@pytest.mark.slow
@pytest.mark.parametrize("name", BOMBS)
def test_every_bomb_and_every_command(intact: Path, tmp_path: Path, name: str) -> None:
    explode(name, intact, tmp_path)


@pytest.mark.slow
def test_rows_that_an_invariant_does_not_judge_take_no_memory_to_audit(tmp_path: Path) -> None:
    base_ledger(tmp_path / "ledger")
    committed(lambda: rows(1 << 20, task_id="t"), 4)(tmp_path / "ledger")
    cost = cost_of(["audit", "ledger"], tmp_path)
    assert cost.code == 1, cost
    assert cost.memory_mib < 300, cost  # joined with what is judged they took 520 MiB
