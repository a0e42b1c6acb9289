"""Show the progress of long work on a terminal: what is done of what, how fast, and how long the rest takes."""

import os
import sys
import time
from types import TracebackType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress as Bar

LINE_END = "\n"
EVERY_S = 0.1
"""Seconds between two states of the line."""


class Progress:
    """A line on stderr that is erased when the work ends; nothing if stderr is not a terminal that can erase it."""

    def __init__(self, verb: str, unit: str) -> None:
        """Begin work, named by a verb in the past tense and a unit: `simulated`, `batches`."""
        self._verb, self._unit = verb, unit
        self._is_shown = sys.stderr is not None and sys.stderr.isatty() and os.environ.get("TERM") != "dumb"
        self._bar: Bar | None = None
        self._last_s = time.monotonic()

    def __enter__(self) -> "Progress":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            sys.stderr.write("\r\x1b[K")
            sys.stderr.flush()

    def __call__(self, done: int, total: int) -> None:
        """Rewrite the line, unless it was written less than `EVERY_S` ago."""
        now_s = time.monotonic()
        if not self._is_shown or (now_s - self._last_s < EVERY_S and done < total):
            return
        self._last_s = now_s
        self._bar = self._bar or _bar(self._verb, self._unit)
        self._bar.update(self._bar.task_ids[0], completed=done, total=total)
        with self._bar.console.capture() as drawn:
            self._bar.console.print(self._bar.get_renderable())
        sys.stderr.write(f"\r\x1b[K{drawn.get().partition(LINE_END)[0]}")
        sys.stderr.flush()


def _bar(verb: str, unit: str) -> "Bar":
    """Return a bar of rich, which is imported only where somebody sees it.

    It is never started, only drawn: a started one has a thread, which processes that are forked would inherit, and
    hides the cursor, which stays hidden where the memory limit ends the process.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Task, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar
    from rich.text import Text

    class Rate(TextColumn):
        """How many units are done per second."""

        def __init__(self) -> None:
            super().__init__("", markup=False)

        def render(self, task: Task) -> Text:
            return Text("" if task.speed is None else f"{task.speed:,.3g} per second")

    bar = Bar(
        TextColumn(f"{verb} {{task.completed:,.0f}} of {{task.total:,.0f}} {unit}", markup=False),
        BarColumn(20),
        Rate(),
        TimeRemainingColumn(compact=True),
        TextColumn("left", markup=False),
        console=Console(file=sys.stderr, highlight=False),
        get_time=time.monotonic,
        auto_refresh=False,
    )
    bar.add_task("")
    return bar
