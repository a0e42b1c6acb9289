"""Writers of format 2 interrupted at any call, in any way, and the recovery from them; several at once, killed and
not; `python -m tests.ledger.crash_soak` tries all."""

import random
from pathlib import Path

import pytest

from fsar_ledger.ledger.chain.append import ChainWriter
from tests.ledger.chain_crowd import judge, part
from tests.ledger.chain_trials import ROWS, ChainLaboratory, write_with
from tests.ledger.crash_writer import Nursery, Order
from tests.ledger.crowd import NAMES
from tests.ledger.faults import Fault, FaultyOs, calls_of, faults_at, one_fault_a_call
from tests.ledger.power import choices
from tests.ledger.readers_beside_soak import trial
from tests.ledger.samples import ORIGIN
from tests.quick import few


@pytest.fixture
def laboratory(tmp_path: Path) -> ChainLaboratory:
    return ChainLaboratory(tmp_path)


@pytest.fixture
def calls(tmp_path: Path) -> list[str]:
    root = tmp_path / "calls"
    root.mkdir()
    return calls_of(root, lambda: write_with(FaultyOs(root), root / "out" / "ledger"))


def test_without_faults_every_event_is_there(tmp_path: Path) -> None:
    root = tmp_path / "calm"
    root.mkdir()
    assert write_with(FaultyOs(root), root / "out" / "ledger").acknowledged == len(ROWS)


@pytest.mark.parametrize("step", few([7, 61], [61]))
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
    for number in range(20):
        first, second = (
            draw.choice(faults),
            Fault(draw.randrange(50), draw.choice(("killed", "io-error", "disk-full", "io-error-after"))),
        )
        laboratory.trial([first, second], choices(number, 1)[-1:])
        laboratory.trial_after_power_failure(first, draw.choice(choices(number, 2)), second)
    assert laboratory.tally.complaints == []
    assert laboratory.tally.faults_in_recovery > 20


@pytest.mark.slow
def test_a_fault_at_any_call_of_the_recovery_loses_nothing(laboratory: ChainLaboratory, calls: list[str]) -> None:
    for at in range(0, len(calls), 121):
        laboratory.trials_of_recovery(Fault(at, "killed"), ("killed", "io-error", "killed-in-write", "disk-full"))
    assert laboratory.tally.complaints == []
    assert laboratory.tally.faults_in_recovery > 25


@pytest.mark.parametrize("step", few([47, 151], [151]))
def test_a_process_really_killed_at_a_call_loses_nothing(
    nursery: Nursery, laboratory: ChainLaboratory, calls: list[str], tmp_path: Path, step: int
) -> None:
    for at in range(step // 2, len(calls), step):
        path = tmp_path / f"killed-{at}" / "out" / "ledger"
        path.parent.parent.mkdir()
        outcome = nursery(Order(str(path), fault_at=at, version=2))
        assert (outcome.killed, outcome.wrong) == (1, ())
        laboratory.finish(path, laboratory.judge(path, outcome.acknowledged.get("trial", 0), at), at)
    assert laboratory.tally.complaints == []


@pytest.mark.parametrize(
    ("writers", "steps"),
    [(2, 4), pytest.param(4, 12, marks=pytest.mark.slow), pytest.param(8, 6, marks=pytest.mark.slow)],
)
def test_what_several_writers_do_at_once_is_there_once_and_readers_see_whole_commits(
    nursery: Nursery, tmp_path: Path, writers: int, steps: int
) -> None:
    path = tmp_path / "ledger"
    outcome = nursery(Order(str(path), NAMES[:writers], steps, readers=1, version=2))
    assert outcome.wrong == ()
    assert outcome.acknowledged == dict.fromkeys(NAMES[:writers], steps)
    assert judge(path, outcome.acknowledged) == []
    assert outcome.heads >= 1


@pytest.mark.slow
def test_processes_killed_at_random_moments_lose_nothing_and_stop_nobody(nursery: Nursery, tmp_path: Path) -> None:
    moments, killed, path = random.Random(7), 0, tmp_path / "ledger"
    for steps in range(2, 12, 2):  # the ledger is killed again and again while it grows
        kill_after_us = tuple(moments.randrange(150_000) for _ in range(2))
        outcome = nursery(Order(str(path), NAMES[:3], steps, kill_after_us=kill_after_us, version=2))
        killed += outcome.killed
        assert outcome.wrong == ()
        assert judge(path, outcome.acknowledged) == []
        assert outcome.acknowledged[NAMES[2]] == steps
    assert killed > 2, "most processes had ended before they were killed; give them more to do"


@pytest.mark.slow
def test_readers_beside_killed_and_refused_writers_see_what_is_committed_once_and_for_ever(
    nursery: Nursery, tmp_path: Path
) -> None:
    tally = trial(nursery, tmp_path / "ledger", random.Random(3))
    assert tally.wrong == ()
    assert min(tally.kills, tally.refusals, tally.seen) > 1


def test_the_judge_of_the_crowd_sees_a_lost_step_and_one_out_of_order(tmp_path: Path) -> None:
    with ChainWriter(tmp_path / "lost", ORIGIN) as writer:
        writer.add([part("anna", 0)])
    assert judge(tmp_path / "lost", {"anna": 2}) == ["lost: 1 of 2 acknowledged steps of anna are there"]
    with ChainWriter(tmp_path / "swapped", ORIGIN) as writer:
        writer.add([part("anna", 3)])
        writer.add([part("anna", 0)])
    assert judge(tmp_path / "swapped", {"anna": 1})[0] == "torn: commit 0 does not hold step 0 of anna"
    assert judge(tmp_path / "nowhere", {"anna": 1}) == ["lost: the ledger is gone"]
