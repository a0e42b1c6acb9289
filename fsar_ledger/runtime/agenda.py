"""The agenda of a run: its pending commands, of which only those due soon are kept in order.

A fleet of thousands has hundreds of thousands of commands pending. In a single heap, each push and pop would wait for
memory. So later commands are kept unsorted by the span of time in which they are due, and a span becomes the heap when
it begins: a calendar queue. Source: R. Brown, "Calendar Queues", Communications of the ACM 31 (1988).
"""

import sys
from collections.abc import Iterable, Iterator
from heapq import heapify, heappop, heappush
from itertools import chain

from .handlers.commands import Scheduled

Pending = tuple[int, int, int, Scheduled]
"""Due time (or, of a command held back, the delay once it is released), serial, cause, command."""
_ROBOT_US = 1 << 23  # one robot has a handful of commands in a span of this length


# See docs/decisions/pending-commands-are-a-calendar-queue.md.
class Agenda:
    """Pending commands in the order (due time, serial).

    `soon` is a heap of the commands due before `until_us`; `advance` fills it with the next span once it is empty. Any
    earlier, one heap would hold both spans.
    """

    __slots__ = ("_later", "_span_us", "_spans", "soon", "until_us")

    def __init__(self, robots: int) -> None:
        """Make an empty agenda; the more robots, the shorter the spans."""
        self.soon: list[Pending] = []
        self.until_us = 0
        self._span_us = max(1, _ROBOT_US // max(1, robots))
        self._later: dict[int, list[Pending]] = {}  # by span
        self._spans: list[int] = []  # a heap

    def __bool__(self) -> bool:
        return bool(self.soon or self._spans)

    def __iter__(self) -> Iterator[Pending]:
        """Yield every command, in no particular order."""
        return chain(self.soon, *self._later.values())

    def advance(self, next_us: int = sys.maxsize) -> bool:
        """Return whether a command may be due by `next_us`; the first one is `soon[0]` then."""
        if not self.soon and self._spans and self._spans[0] * self._span_us <= next_us:
            span = heappop(self._spans)
            self.soon += self._later.pop(span)
            heapify(self.soon)
            self.until_us = (span + 1) * self._span_us
        return bool(self.soon)

    def put(self, item: Pending) -> None:
        """Add a command."""
        if item[0] < self.until_us:
            heappush(self.soon, item)
            return
        span = item[0] // self._span_us
        if span in self._later:
            self._later[span].append(item)
        else:
            self._later[span] = [item]
            heappush(self._spans, span)

    def pop_before(self, time_us: int) -> Pending | None:
        """Remove and return the first command if it is due before this time, else None."""
        return heappop(self.soon) if self.advance(time_us) and self.soon[0][0] < time_us else None

    def replace(self, pending: Iterable[Pending]) -> None:
        """Replace all commands by these."""
        items = list(pending)
        self.soon.clear()
        self._later.clear()
        self._spans.clear()
        self.until_us = 0
        for item in items:
            self.put(item)
