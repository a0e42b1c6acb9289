"""A walk through a run: by a script, and by the keys of its screen."""

import asyncio
import fcntl
import os
import pty
import struct
import subprocess
import sys
import termios
from collections.abc import Callable
from pathlib import Path

import pytest
from textual.pilot import Pilot
from textual.widgets import Input, Static

from fsar_ledger import open_ledger
from fsar_ledger.api.state import Steps
from fsar_ledger.cli.stepper import Stepper
from fsar_ledger.events.envelope import flat
from fsar_ledger.events.request import RequestDenied
from tests.cli.conftest import Call, one_message


@pytest.fixture
def steps(ledger: Path) -> Steps:
    return open_ledger(ledger).step(1)


def landed(call: Call, ledger: Path, script: str, run: str = "1") -> list[int]:
    answer = call("step", str(ledger), "--run", run, "--script", script)
    assert answer.code == 0, answer.err
    return [int(line.split()[0]) for line in answer.out.splitlines()]


def test_a_script_shows_where_each_move_lands(call: Call, ledger: Path) -> None:
    last = len(steps_of(ledger).words) - 1
    assert landed(call, ledger, "next; next; previous; last; first; go 7") == [1, 2, 1, last, 0, 7]


def steps_of(ledger: Path, run: int = 1) -> Steps:
    return open_ledger(ledger).step(run)


def test_moves_lead_to_what_they_say(ledger: Path) -> None:
    record = open_ledger(ledger).record(1)
    walk = steps_of(ledger)
    assert walk.move("go", "40s") is None
    assert record.times_us[walk.seq] <= 40_000_000 < record.times_us[walk.seq + 1]
    here = walk.seq
    assert walk.move("next-decision") is None
    assert flat(record.events[walk.seq])["decided_by"] is not None
    assert all(flat(record.events[seq]).get("decided_by") is None for seq in range(here + 1, walk.seq))
    assert walk.move("cause") is None
    here = walk.seq
    assert walk.move("next-of", "B1") is None
    assert "robot/B1" in str(flat(record.events[walk.seq]))
    assert walk.seq > here
    walk.move("first")
    found = []
    while walk.move("next-refusal") is None:
        found.append(walk.seq)
    denied = [seq for seq, event in enumerate(record.events) if isinstance(event, RequestDenied)]
    assert set(denied) <= set(found)
    walk.move("first")
    assert walk.move("find", "RECEIVES task") is None
    assert "receives task" in walk.words[walk.seq]
    assert walk.move("previous-decision") is None


def test_a_move_that_leads_nowhere_stays_and_says_so(ledger: Path) -> None:
    walk = steps_of(ledger)
    for name, about in (("previous", ""), ("cause", ""), ("find", "no such words"), ("next-of", "Z9"), ("go", "99999")):
        assert walk.move(name, about) is not None
        assert walk.seq == 0


def test_a_script_shows_the_state_and_the_record(call: Call, ledger: Path) -> None:
    answer = call("step", str(ledger), "--run", "1", "--at", "40s", "--script", "state; record")
    assert "robot/B1  role B" in answer.out
    assert "    type = " in answer.out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--script", "nxt"), "did you mean next"),
        (("--script", "go"), "expected what to look for"),
        (("--script", "go soon"), "expected seconds"),
        (("--at", "9000s", "--script", "next"), "expected at most"),
        ((), "found no terminal to walk on"),
    ],
)
def test_a_walk_that_cannot_be_taken_is_an_error(
    call: Call, ledger: Path, words: tuple[str, ...], message: str
) -> None:
    one_message(call("step", str(ledger), "--run", "1", *words), 2, message)


def played(steps: Steps, play: "Callable[[Pilot[None], Stepper], object]", *keys: str) -> None:
    """Press the keys on the screen, and look at it."""

    async def run() -> None:
        app = Stepper(steps, "run 1")
        async with app.run_test(size=(120, 40)) as pilot:
            await pilot.press(*keys)
            await pilot.pause()
            play(pilot, app)

    asyncio.run(run())


def text_of(app: Stepper, name: str) -> str:
    return str(app.query_one(f"#{name}", Static).render())


def test_keys_walk_and_the_screen_follows(steps: Steps) -> None:
    def look(_: "Pilot[None]", app: Stepper) -> None:
        assert steps.seq == 2
        assert f">{2:>6}" in text_of(app, "list")
        assert "type = " in text_of(app, "event")
        assert "robot/A1" in text_of(app, "state")

    played(steps, look, "right", "down", "n", "left")


def test_a_key_that_asks_takes_an_answer(steps: Steps) -> None:
    def look(_: "Pilot[None]", app: Stepper) -> None:
        assert steps.seq == 30
        assert not app.query_one("#asked", Input).has_class("shown")

    played(steps, look, "g", "3", "0", "enter")


def test_a_wrong_answer_is_said_and_nothing_moves(steps: Steps) -> None:
    def look(_: "Pilot[None]", app: Stepper) -> None:
        assert steps.seq == 0
        assert "expected seconds" in text_of(app, "said")

    played(steps, look, "g", "x", "enter")


@pytest.mark.slow
def test_every_key_leads_where_it_says(steps: Steps) -> None:
    for keys, name, about in (
        (("d",), "next-decision", ""),
        (("r",), "next-refusal", ""),
        (("end",), "last", ""),
        (("b", "B", "1", "enter"), "next-of", "B1"),
        (("slash", "t", "a", "s", "k", "enter"), "find", "task"),
    ):
        steps.move("first")
        steps.move(name, about)
        expected = steps.seq
        steps.move("first")
        played(steps, lambda _, __: None, *keys)
        assert steps.seq == expected
    played(steps, lambda _, __: None, "c")
    assert steps.seq < expected


def test_text_from_a_ledger_is_no_markup(steps: Steps) -> None:
    steps.words[0] = "[bold red]alarm[/] \x1b[31m"

    def look(_: "Pilot[None]", app: Stepper) -> None:
        assert "[bold red]alarm[/] \\x1b[31m" in text_of(app, "list")

    played(steps, look)


def test_on_a_terminal_it_starts_and_q_ends_it(ledger: Path) -> None:
    owner, terminal = pty.openpty()
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", 40, 120, 0, 0))
    process = subprocess.Popen(
        [sys.executable, "-m", "fsar_ledger", "step", str(ledger), "--run", "1"],
        stdin=terminal,
        stdout=terminal,
        stderr=terminal,
        env={**os.environ, "TERM": "xterm-256color", "COLUMNS": "120", "LINES": "40"},
    )
    os.close(terminal)
    shown = b""
    try:
        while b"quit" not in shown:
            shown += os.read(owner, 65_536)
        os.write(owner, b"q")
        while process.poll() is None:
            try:
                shown += os.read(owner, 65_536)
            except OSError:
                break
        assert process.wait(20) == 0
    finally:
        process.kill()
        os.close(owner)
