"""The service as a process under load for minutes: its memory does not grow with what it has done."""

import os
import signal
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fsar_ledger.service import add_principal
from fsar_ledger.service.client import Client
from tests.running import rss_kib
from tests.service.test_kills import Process

MINUTES = float(os.environ.get("MINUTES", "30"))
TEAMS = 16
KNOWN = 70_000
"""After so many commands the service knows as many keys and holds as many rows of its newest events as it ever will."""
MOST_KIB = 128.0
"""A thousand commands are 250 tasks, whose names take 50 until 65,536 are known. Half a KiB a command would be 500."""


class Load:
    """Robots of many teams, each with a line of its own, that play one task after another."""

    def __init__(self, url: str, tokens: dict[str, str]) -> None:
        self.given = 0
        self.rejected: list[str] = []
        self._url, self._tokens = url, tokens
        self._is_over = threading.Event()
        self._threads = [threading.Thread(target=self._play, args=(team,)) for team in range(1, TEAMS + 1)]

    def __enter__(self) -> "Load":
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._is_over.set()
        for thread in self._threads:
            thread.join(60)

    def _play(self, team: int) -> None:
        carrier, door = f"robot/A{team}", f"robot/B{team}"
        with Client(self._url, self._tokens[carrier]) as carries, Client(self._url, self._tokens[door]) as opens:
            number = 0
            while not self._is_over.is_set():
                number += 1
                task, action = f"t{team}-{number}", f"t{team}-{number}/1.1"
                steps, is_taken = ["A door.open.secure B"], number % 20 > 0
                budget_us = 60_000_000 if is_taken else 1_000_000  # what was denied is given up, and not asked again
                self._give(carries, "SubmitTask", robot=carrier, task_id=task, steps=steps, budget_us=budget_us)
                self._give(opens, "JudgeRequest", robot=door, action_id=action, accepts=is_taken)
                if is_taken:
                    self._give(opens, "ReportStart", robot=door, action_id=action)
                    self._give(opens, "ReportResult", executor=door, action_id=action, result="success")

    def _give(self, way: Client, command: str, **fields: Any) -> None:
        rejected = way.give(command, **fields).rejected
        if rejected is not None:
            self.rejected.append(rejected)
        self.given += 1


def _slope(samples: list[tuple[int, int]]) -> float:
    """How much memory a thousand commands took. Units: KiB."""
    commands, used = np.array(samples, float).T
    return float(np.polyfit(commands / 1_000, used, 1)[0])


@pytest.mark.soak
def test_minutes_of_load_leave_nothing_in_memory(tmp_path: Path) -> None:
    robots = [f"robot/{role}{team}" for team in range(1, TEAMS + 1) for role in "AB"]
    tokens = {name: add_principal(tmp_path / "principals", name) for name in robots}
    one = Process(tmp_path, 0, "--robots", 4 * TEAMS)
    samples: list[tuple[int, int]] = []
    begun = told = time.monotonic()
    try:
        with Load(one.url, tokens) as load:
            while (now := time.monotonic()) < begun + 60 * MINUTES:
                time.sleep(1)
                used = rss_kib(one.process.pid)
                if now - told > 15:
                    told = now
                    told_by = f"{load.given:9,} commands, {len(load.rejected)} rejected"
                    print(f"{now - begun:5.0f} s {told_by} {used / 1024:6.0f} MiB", flush=True)
                if now > begun + 12 * MINUTES and load.given > KNOWN:
                    samples.append((load.given, used))
    finally:
        code, _ = one.end(signal.SIGTERM)
    assert code == 0
    assert len(samples) > 60, "too short: give it more MINUTES"
    print(f"{_slope(samples):.1f} KiB for each thousand of {samples[-1][0] - samples[0][0]:,} commands")
    assert _slope(samples) < MOST_KIB
    assert len(load.rejected) < load.given / 1_000, load.rejected[-3:]
