"""One thing that `verify` doubts, with its place."""

import msgspec


class Problem(msgspec.Struct, frozen=True):
    """One doubt: where (a file within the ledger, and as much of commit, run, seq and field as is known), found, expected."""

    where: str
    found: str
    expected: str
    commit: int | None = None
    run: str | None = None
    seq: int | None = None
    field: str | None = None

    def __str__(self) -> str:
        place = [
            f"{name} {value}" for name, value in (("commit", self.commit), ("run", self.run), ("seq", self.seq), ("field", self.field)) if value is not None
        ]
        return f"{': '.join([self.where, ', '.join(place)] if place else [self.where])}: found {self.found}, expected {self.expected}"


def unexpected(where: str, commit: int | None, error: BaseException) -> Problem:
    """A check stopped with an exception: that is a finding, not an accident."""
    return Problem(where, f"{type(error).__name__}: {error!s:.300}", "data that can be checked", commit=commit)
