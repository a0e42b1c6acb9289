"""What commands write for people and for programs: answers on stdout, messages on stderr."""

import os
import sys

import typer


def escaped(text: str) -> str:
    """The text as it can be written in UTF-8: each byte of a file's name that is not is escaped, `\\udcff` for ff."""
    return text.encode("utf-8", "backslashreplace").decode()


def show(text: str) -> None:
    """The text is on stdout; a reader that has had enough (`| head`) ends the command quietly."""
    try:
        sys.stdout.write(escaped(text))
        sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise typer.Exit(0) from None


def say(text: str) -> None:
    """The lines are on stderr, each after the name of the command."""
    sys.stderr.write("".join(f"fsar-ledger: {line}\n" for line in escaped(text).splitlines()))
