"""Tell an end that a crash has torn from damage: more follows that was on disk only after what cannot be read.

What cannot be read may hold anything, so each byte is looked at a few times at most.
"""

import re
from collections.abc import Iterator

from fsar_ledger.ledger.store.record import LEAST_LINE_BYTES, Commit, Placement, Record, line_at, parse_line

_OF_COMMIT, _OF_PLACEMENT, _MORE = b'"kind":"commit"', b'"kind":"placement"', re.compile(rb"[^\n]")
_BEGINNINGS = (b'{"continues":', b'{"goes_on":', b'{"kind":"commit"')
"""What the record of a commit begins with: its first member in the order of names. None of these is within a record."""


# See docs/decisions/torn-ends-are-not-damage.md.
def has_later_append(data: bytes, start: int) -> bool:
    """Return whether anything follows a placement in these bytes of a chain, from here on."""
    return any(
        isinstance(_record(data, first, end), Placement) and _MORE.search(data, end)
        for first, end in _lines_with(_OF_PLACEMENT, data, start)
    )


def has_later_commit(text: bytes, start: int, expected: int) -> bool:
    """Return whether a line of a journal, from here on, ends with the record of a commit after the expected one.

    It may begin within the line: the line feed before it may be what was damaged.
    """
    for first, end in _lines_with(_OF_COMMIT, text, start):
        begins = max([text.rfind(beginning, first, end) for beginning in _BEGINNINGS])
        record = _record(text, begins, end) if begins >= 0 else None
        if isinstance(record, Commit) and record.number > expected:
            return True
    return False


def _lines_with(kind: bytes, text: bytes, start: int) -> Iterator[tuple[int, int]]:
    """Yield where each whole line begins and ends that has these bytes and may be a record."""
    at = text.find(kind, start)
    while at >= 0 and (end := text.find(b"\n", at)) >= 0:
        first = text.rfind(b"\n", start, at) + 1 or start
        if end - first > LEAST_LINE_BYTES:
            yield first, end
        start = end + 1
        at = text.find(kind, start)


def _record(text: bytes, first: int, end: int) -> Record | None:
    try:
        return parse_line(line_at(text, first, end))
    except ValueError:
        return None
