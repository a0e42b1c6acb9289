"""Show the progress of long work on a terminal."""

import sys
import time
from types import TracebackType


class Progress:
    """A line on stderr that is erased when the work ends; nothing if stderr is not a terminal."""

    def __init__(self, verb: str, unit: str) -> None:
        """Begin work, named by a verb in the past tense and a unit: `simulated`, `batches`."""
        self._verb, self._unit = verb, unit
        self._is_shown = sys.stderr.isatty()
        self._began_s = self._last_s = time.monotonic()

    def __enter__(self) -> "Progress":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._is_shown:
            sys.stderr.write("\r\x1b[K")

    def __call__(self, done: int, total: int) -> None:
        """Rewrite the line, unless it was written less than 0.1 s ago."""
        now_s = time.monotonic()
        if not self._is_shown or (now_s - self._last_s < 0.1 and done < total):
            return
        self._last_s = now_s
        left_s = (now_s - self._began_s) * (total - done) / done if done else 0.0
        sys.stderr.write(f"\r\x1b[K{self._verb} {done:,} of {total:,} {self._unit}, about {left_s:.0f} s left")
        sys.stderr.flush()
