"""A live run that is cut goes on as another run: it decides as the uncut one, and is judged with it as one run."""

import random
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import pytest

import fsar_ledger
from fsar_ledger.events.command import CommandGiven
from fsar_ledger.events.fleet import RunContinued
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows.runs import LedgerRun
from fsar_ledger.ledger.store.locations import record_of
from fsar_ledger.runtime.federation import Federation
from tests.runtime.test_live_forks_at_random import busy

EPOCH_US = 1_772_359_200_000_000  # 2026-03-01T10:00:00Z
S = 1_000_000


class Day:
    """A federation whose clock is set to the time of each command. `run` is its name, `run.2` what continues it."""

    def __init__(self, ledger: Path, **given: Any) -> None:
        self.ledger, self.now_us, self._given = ledger, 0, given
        self.one = self.opened()

    def opened(self) -> Federation:
        clock = lambda: (EPOCH_US + self.now_us) * 1_000  # noqa: E731
        return fsar_ledger.federate(self.ledger, run="hall", clock=clock, **self._given)

    def plays(self, commands: Sequence[tuple[int, CommandGiven]], cuts: Iterable[int] = (), ends_us: int = 0) -> "Day":
        """Give the commands at their times; before these of them, by number, the run is cut."""
        held = set(cuts)
        for number, (time_us, command) in enumerate(commands):
            self.now_us = time_us
            if number in held:
                self.one.cut()
            self.one.decide(command)
            self.now_us = time_us + S // 2
            self.one.advance()
        self.now_us = max(self.now_us, ends_us)
        self.one.advance()
        self.one.close()
        return self

    @property
    def record(self) -> LedgerRun:
        return record_of(open_ledger(self.ledger), self.one.run)


def commands_of(seed: int) -> tuple[list[tuple[int, CommandGiven]], int]:
    """What everybody says in a busy fleet, and when the run has ended."""
    record = busy(seed).record
    pairs = zip(record.times_us, record.events, strict=True)
    return [(time_us, event) for time_us, event in pairs if isinstance(event, CommandGiven)], record.times_us[-1]


def without_cuts(record: LedgerRun) -> list[tuple[int, Any]]:
    pairs = zip(record.times_us, record.events, strict=True)
    return [(time_us, event) for time_us, event in pairs if not isinstance(event, RunContinued)]


@pytest.mark.parametrize("seed", range(1, 5))
def test_a_run_that_is_cut_anywhere_decides_as_the_uncut_one_and_both_replay(tmp_path: Path, seed: int) -> None:
    commands, ends_us = commands_of(seed)
    draw = random.Random(seed)
    cuts = sorted(draw.sample(range(1, len(commands)), 3))
    whole = Day(tmp_path / "whole").plays(commands, ends_us=ends_us)
    cut = Day(tmp_path / "cut").plays(commands, cuts, ends_us)
    assert cut.one.run == "hall.4"
    assert without_cuts(cut.record) == without_cuts(whole.record)
    assert len(cut.record.events) == len(whole.record.events) + 3
    for day in (whole, cut):
        assert fsar_ledger.Ledger(day.ledger).verify(replay=True).exit_code == 0
    print(fsar_ledger.Ledger(cut.ledger).verify(replay=True).replay)
