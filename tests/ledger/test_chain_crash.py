"""Writers of format 2 interrupted at any call, in any way, and the recovery from them."""

import random
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.ledger.chain_trials import ROWS, ChainLaboratory, write_with
from tests.ledger.faults import KINDS, OF_WRITES, WRITES, Fault, FaultyOs, calls_of, faults_at
from tests.ledger.power import choices
from tests.quick import few


@pytest.fixture
def laboratory(tmp_path: Path) -> ChainLaboratory:
    return ChainLaboratory(tmp_path)


@pytest.fixture
def calls(tmp_path: Path) -> list[str]:
    root = tmp_path / "calls"
    root.mkdir()
    return calls_of(root, lambda: write_with(FaultyOs(root), root / "out" / "ledger"))


def one_fault_a_call(calls: list[str]) -> Iterator[Fault]:
    """Yield, for each call, a kill or another kind of fault in turn."""
    for at, name in enumerate(calls):
        kinds = [kind for kind in KINDS if name in WRITES or kind not in OF_WRITES]
        yield Fault(at, kinds[at // 2 % len(kinds)] if at % 2 else "killed")


def test_without_faults_every_event_is_there(tmp_path: Path) -> None:
    root = tmp_path / "calm"
    root.mkdir()
    assert write_with(FaultyOs(root), root / "out" / "ledger").acknowledged == len(ROWS)


@pytest.mark.parametrize("step", few([1, 29], [29]))
def test_a_fault_at_any_call_loses_nothing_acknowledged_and_the_power_may_fail_after_it(
    laboratory: ChainLaboratory, calls: list[str], step: int
) -> None:
    for number, fault in enumerate(one_fault_a_call(calls)):
        if number % step == 0:
            laboratory.trial([fault], choices(number, 1)[number % 3 :: 3])
    assert laboratory.tally.complaints == []
    assert laboratory.tally.faults >= len(calls) // step
    assert laboratory.tally.power_failures > len(calls) // step


@pytest.mark.slow
def test_a_fault_during_the_recovery_loses_nothing_either(laboratory: ChainLaboratory, calls: list[str]) -> None:
    draw = random.Random(5)
    faults = list(faults_at(calls))
    for number in range(40):
        first, second = (
            draw.choice(faults),
            Fault(draw.randrange(50), draw.choice(("killed", "io-error", "disk-full", "io-error-after"))),
        )
        laboratory.trial([first, second], choices(number, 1)[-1:])
        laboratory.trial_after_power_failure(first, draw.choice(choices(number, 2)), second)
    assert laboratory.tally.complaints == []
    assert laboratory.tally.faults_in_recovery > 40
