"""The one place that prints: answers on stdout, messages on stderr.

Only text whose values are escaped (`SafeText`) can be shown, and it is checked once more here. On a terminal, a line
that is too long continues on the next one after a mark, so that no line of the screen begins with text that others
wrote.
"""

import io
import os
import select
import sys
import time
from contextlib import suppress
from typing import TextIO

from fsar_ledger.base import printable
from fsar_ledger.base.errors import WriteFailed
from fsar_ledger.base.printable import SafeText, columns_of

ON = "  | "
"""The mark before the rest of a line that is too long for the terminal."""

NARROWEST, USUAL = 20, 80
"""Columns: the fewest for which lines are folded, and those of a terminal that does not report them."""
MAX_LINES = 20
"""Lines of one message; DuckDB's have up to six."""


class OutputClosed(Exception):
    """The reader of the answer has closed it (`| head`)."""


def show(text: SafeText, *, raw: bool = False) -> None:
    """Write the text to stdout. `raw` text is for programs, and is not checked unless stdout is a terminal.

    Raises: OutputClosed if the reader has closed it; WriteFailed.
    """
    is_for_people = sys.stdout is not None and sys.stdout.isatty()
    _write(sys.stdout, text if raw and not is_for_people else printable.sanitized(text))


def has_keys() -> bool:
    """Return whether there are keys and a screen: stdin and stdout are both a terminal."""
    streams = (sys.stdin, sys.stdout)
    return all(stream is not None and stream.isatty() for stream in streams)


def pause(seconds: float) -> None:
    """Wait this long. Raises: OutputClosed as soon as the reader of stdout has closed it."""
    try:
        poller = select.poll()
        poller.register(sys.stdout.fileno(), 0)  # no event except that the other end has closed
    except (OSError, ValueError):
        time.sleep(seconds)
        return
    if poller.poll(seconds * 1_000):
        raise OutputClosed


def say(*messages: str) -> None:
    """Write the messages to stderr, each after the name of the command; further lines of a message follow a mark."""
    with suppress(OutputClosed, WriteFailed):
        _write(sys.stderr, "".join(map(_message, messages)))


def _message(text: str) -> SafeText:
    first, *more = text.split("\n", MAX_LINES)
    more[MAX_LINES - 1 :] = ["..."] if len(more) == MAX_LINES else []
    return printable.lines(f"fsar-ledger: {first}", *(f"{ON}{line}" for line in more))


def say_failure(trace: str) -> None:
    """Write the traceback of a bug to stderr, escaped, since it may quote a ledger."""
    with suppress(OutputClosed, WriteFailed):
        _write(sys.stderr, printable.sanitized(trace))


def _write(stream: TextIO | None, text: str) -> None:
    if stream is None:
        raise WriteFailed("stdout is closed; write the output to a file or a pipe")
    width = _width_of(stream)
    if width is not None:
        text = "\n".join(folded(line, width) for line in text.split("\n"))
    encoding = stream.encoding or "utf-8"
    try:
        _write_whole(stream, text.encode(encoding, "backslashreplace"), encoding)
    except BrokenPipeError:
        _divert(stream)
        raise OutputClosed from None
    except OSError as error:
        _divert(stream)
        raise WriteFailed(f"the output is incomplete ({error.strerror}); write it where there is free space") from error


def width_of_output() -> int | None:
    """Return the columns of the terminal at stdout; None if it is not one, or too narrow for any layout."""
    return None if sys.stdout is None else _width_of(sys.stdout)


def _width_of(stream: TextIO) -> int | None:
    try:
        width = (os.get_terminal_size(stream.fileno()).columns or USUAL) if stream.isatty() else 0
    except (OSError, ValueError):
        width = 0
    return width if width >= NARROWEST else None


def _write_whole(stream: TextIO, data: bytes, encoding: str) -> None:
    """Write all of the data.

    An unbuffered stream (PYTHONUNBUFFERED) may write less and return how much; Python's text layer ignores that.
    """
    raw = getattr(stream, "buffer", None)
    if not isinstance(raw, io.RawIOBase):
        stream.write(data.decode(encoding))
        stream.flush()
        return
    rest = memoryview(data)
    while rest:
        rest = rest[raw.write(rest) or 0 :]


def _divert(stream: TextIO) -> None:
    """Discard what is still buffered, so that it does not fail again when the process ends."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def folded(line: str, width: int) -> str:
    """Fold the line for a terminal of this width; each further part follows a mark.

    A line is cut after the last blank in the right half of the terminal, if there is one.
    """
    if len(line) <= width and line.isascii():
        return line
    parts, start, used, blank = [], 0, 0, 0
    for index, columns in enumerate(map(columns_of, line)):
        if used + columns > width:
            end = blank if blank > start else index
            parts.append(line[start:end])
            start, used = end, len(ON) + sum(map(columns_of, line[end:index]))
        used += columns
        if line[index] == " " and used > width // 2:
            blank = index + 1
    return f"\n{ON}".join([*parts, line[start:]])
