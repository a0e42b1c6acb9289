"""The agenda of a run: its pending commands, of which only those that are due soon are kept in order.

A fleet of thousands has hundreds of thousands of commands pending. In one heap of them all, each push and pop would
wait for memory. So what is due later lies unsorted, by the span of time in which it is due, and becomes the heap when
its span begins: a calendar queue. Source: R. Brown, "Calendar Queues", Communications of the ACM 31 (1988).
"""

import sys
from collections.abc import Iterable, Iterator
from heapq import heapify, heappop, heappush
from itertools import chain

from .handlers.commands import Scheduled

Pending = tuple[int, int, int, Scheduled]
"""Due time (or, for what is kept, the delay once it is released), serial, cause, command."""
_ROBOT_US = 1 << 23  # of one robot, a span of this length has a handful of commands


# See docs/decisions/pending-commands-are-a-calendar-queue.md.
class Agenda:
    """What is pending, in the order (due time, serial).

    `soon` is a heap of all that is due before `until_us`; `turn` makes it the next span's once it is empty. Done early,
    that would put everything until then into one heap.
    """

    __slots__ = ("_later", "_span_us", "_spans", "soon", "until_us")

    def __init__(self, robots: int) -> None:
        """Begin empty; the more robots, the shorter the spans."""
        self.soon: list[Pending] = []
        self.until_us = 0
        self._span_us = max(1, _ROBOT_US // max(1, robots))
        self._later: dict[int, list[Pending]] = {}  # by span
        self._spans: list[int] = []  # a heap

    def __bool__(self) -> bool:
        return bool(self.soon or self._spans)

    def __iter__(self) -> Iterator[Pending]:
        """Yield everything, in no order."""
        return chain(self.soon, *self._later.values())

    def turn(self, next_us: int = sys.maxsize) -> bool:
        """Return whether anything is pending that may be due by `next_us`; then the first of it is `soon[0]`."""
        if not self.soon and self._spans and self._spans[0] * self._span_us <= next_us:
            span = heappop(self._spans)
            self.soon += self._later.pop(span)
            heapify(self.soon)
            self.until_us = (span + 1) * self._span_us
        return bool(self.soon)

    def put(self, one: Pending) -> None:
        """Add a command."""
        if one[0] < self.until_us:
            heappush(self.soon, one)
            return
        span = one[0] // self._span_us
        if span in self._later:
            self._later[span].append(one)
        else:
            self._later[span] = [one]
            heappush(self._spans, span)

    def pop_before(self, time_us: int) -> Pending | None:
        """Take out the first command if it is due before this time, else None."""
        return heappop(self.soon) if self.turn(time_us) and self.soon[0][0] < time_us else None

    def replace(self, pending: Iterable[Pending]) -> None:
        """Hold just these commands from now on."""
        held = list(pending)
        self.soon.clear()
        self._later.clear()
        self._spans.clear()
        self.until_us = 0
        for one in held:
            self.put(one)
