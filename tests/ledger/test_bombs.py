"""Each of thirty bombs against commands that touch it: a clear error or a right answer, within ten CPU seconds and a
gibibyte.

CPU seconds, because wall time depends on what else runs, and of a core that runs the yardstick of `bomb_trial` in its
time, because a slow or shared core takes more of them for the same work. A small bomb is tried with every run of the
tests, each bomb with a few commands in the slow ones, and with every command in the soak.
"""

import shutil
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.ledger.bomb_trial import cost_of
from tests.ledger.bombs import BOMBS, IN_TURN, LEDGER, READERS, base_ledger, calls_in_turn, committed, rows

PROCESSOR_S = 10
MEMORY_MIB = 1024
ENOUGH = "numbers as large as there are"
"""The bomb that is tried each time, with two calls."""


@pytest.fixture(scope="module")
def intact(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("intact") / "ledger"
    base_ledger(path)
    return path


def explode(name: str, intact: Path, place: Path, calls: Sequence[tuple[str, ...]]) -> None:
    """Put the bomb in place and make these calls."""
    shutil.copytree(intact, place / "ledger")
    BOMBS[name].lay(place / "ledger")
    for call in calls:
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


def test_each_bomb_meets_commands_in_turn_and_each_command_several_bombs() -> None:
    assert IN_TURN.keys() <= BOMBS.keys()
    left = [name for name in BOMBS if not calls_in_turn(name)]
    assert left == ["fifty million rows", "a million open claims of two"]
    for name, begun in IN_TURN.items():
        assert len(calls_in_turn(name)) == len(begun) != 1, name
    met = Counter(call for name in BOMBS for call in calls_in_turn(name))
    assert {call for call in READERS if met[call] < 2} == set()


@pytest.mark.slow
def test_a_bomb_ends_in_a_clear_error_in_little_time_and_memory(intact: Path, tmp_path: Path) -> None:
    explode(ENOUGH, intact, tmp_path, BOMBS[ENOUGH].calls[:2])


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in BOMBS if calls_in_turn(name)])
def test_every_bomb_and_commands_in_turn(intact: Path, tmp_path: Path, name: str) -> None:
    explode(name, intact, tmp_path, calls_in_turn(name))


@pytest.mark.soak
@pytest.mark.parametrize("name", BOMBS)
def test_every_bomb_and_every_command(intact: Path, tmp_path: Path, name: str) -> None:
    explode(name, intact, tmp_path, BOMBS[name].calls)


@pytest.mark.slow
def test_rows_that_an_invariant_does_not_judge_take_no_memory_to_audit(tmp_path: Path) -> None:
    base_ledger(tmp_path / "ledger")
    committed(lambda: rows(1 << 20, task_id="t"), 4)(tmp_path / "ledger")
    cost = cost_of(["audit", "ledger"], tmp_path)
    assert cost.code == 1, cost
    assert cost.memory_mib < 300, cost  # joined with what is judged they took 520 MiB
