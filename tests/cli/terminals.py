"""Real terminals of a given width: for a process, or for a command in this one."""

import fcntl
import os
import pty
import struct
import subprocess
import sys
import termios
from collections.abc import Mapping
from contextlib import redirect_stderr, redirect_stdout, suppress
from threading import Thread

from fsar_ledger.cli import app


def _terminal(width: int) -> tuple[int, int]:
    """Open a terminal of this width; return its two ends."""
    here, there = pty.openpty()
    fcntl.ioctl(there, termios.TIOCSWINSZ, struct.pack("HHHH", 40, width, 0, 0))
    return here, there


def _read(end: int, stream: bytearray) -> None:
    with suppress(OSError):  # all is read
        while data := os.read(end, 1 << 16):
            stream.extend(data)
    os.close(end)


def _text(stream: bytearray, code: int) -> str:
    """Return all that was written, as text; the command must have done its work."""
    text = stream.decode().replace("\r\n", "\n")
    assert code in (0, 1), text
    return text


def _left(text: str) -> str:
    """Return what stays there, after the progress that is erased."""
    return text.rpartition("\r\x1b[K")[2]


def on_a_terminal(width: int, *arguments: object, surroundings: Mapping[str, str] = {}) -> tuple[str, str]:
    """Run Python with these arguments in a terminal of this width; return what it leaves there, and all it wrote."""
    here, there = _terminal(width)
    stream = bytearray()
    command = [sys.executable, *map(str, arguments)]
    with subprocess.Popen(command, stdout=there, stderr=there, env={**os.environ, **surroundings}) as child:
        os.close(there)
        _read(here, stream)
    text = _text(stream, child.returncode)
    return _left(text), text


def on_a_terminal_here(width: int, *arguments: object) -> str:
    """Run a command of the ledger in this process, its output a terminal of this width; return what it leaves there."""
    here, there = _terminal(width)
    stream = bytearray()
    reader = Thread(target=_read, args=(here, stream))
    reader.start()
    with os.fdopen(there, "w", encoding="utf-8") as screen, redirect_stdout(screen), redirect_stderr(screen):
        code = app.run([str(argument) for argument in arguments])
    reader.join()
    return _left(_text(stream, code))
