"""One problem that `verify` found, with its location."""

from pathlib import Path

import msgspec

from fsar_ledger.base import printable
from fsar_ledger.base.errors import FsarLedgerError, InvalidQuery, UsageError

MAX_TEXT = 600
"""The most characters of a file that a message shows. A note takes some 300."""


class Problem(msgspec.Struct, frozen=True):
    """One problem: its location, what was found and what was expected.

    The location is a file within the ledger, and the commit, run, seq and field if known. Whatever a file or its name
    holds, each text is one printable line with at most `MAX_TEXT` characters of it, except `run`, which is as stored.
    """

    where: str
    found: str
    expected: str
    commit: int | None = None
    run: str | None = None
    seq: int | None = None
    field: str | None = None

    def __post_init__(self) -> None:
        for name in ("where", "found", "expected"):
            text = getattr(self, name)
            if not (text.isprintable() and len(text) <= MAX_TEXT):
                msgspec.structs.force_setattr(self, name, _printable(text))

    def __str__(self) -> str:
        run = None if self.run is None else printable.value(self.run, MAX_TEXT)
        where = [
            f"{name} {value}"
            for name, value in (("commit", self.commit), ("run", run), ("seq", self.seq), ("field", self.field))
            if value is not None
        ]
        return (
            f"{': '.join([self.where, ', '.join(where)] if where else [self.where])}: found {self.found}, expected "
            f"{self.expected}"
        )


class LaterRelease(Problem, frozen=True):
    """A record of a release after this one: this version cannot judge it."""


def _printable(text: str) -> str:
    cut = text if len(text) <= MAX_TEXT else text[:MAX_TEXT] + "..."
    return "".join(
        character if character.isprintable() else character.encode("unicode_escape", "surrogatepass").decode("ascii")
        for character in cut
    )


def refusal(place: str | Path, error: FsarLedgerError) -> str:
    """Return the message of a reader's error, in brackets and without the location, which the caller names."""
    return f"({str(error).removeprefix(f'{place}: ')})"


def unexpected(where: str, commit: int | None, error: BaseException) -> Problem:
    """Turn an exception that stopped a check into a problem.

    Raises: `error` unchanged if it is not the ledger's fault: too little memory, a missing module, or a wrong query or
        registry in the installation.
    """
    if isinstance(error, (MemoryError, ImportError, InvalidQuery)) or type(error) is UsageError:
        raise error
    what = "" if isinstance(error, FsarLedgerError) else f"{type(error).__name__}: "
    return Problem(where, f"{what}{error!s:.300}", "data that can be checked", commit=commit)
