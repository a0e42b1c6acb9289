"""What commands write for people and for programs: answers on stdout, messages on stderr."""

import os
import sys

import typer


def show(text: str) -> None:
    """The text is on stdout; a reader that has had enough (`| head`) ends the command quietly."""
    try:
        sys.stdout.write(text)
        sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise typer.Exit(0) from None


def say(text: str) -> None:
    """The lines are on stderr, each after the name of the command."""
    sys.stderr.write("".join(f"fsar-ledger: {line}\n" for line in text.splitlines()))
