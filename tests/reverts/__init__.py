"""Fixes that can be taken out again, one a file, each with the test that must then fail.

`about` says what is wrong again. Each `[[change]]` replaces the text `now`, which stands once in its `file`, by
`before`. `make soak-reverts` takes each fix out alone and runs its test.
"""

import tomllib
from pathlib import Path

import msgspec

ROOT = Path(__file__).parents[2]


class Change(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One edit of one file, from the text that stands there `now` to what stood there `before`."""

    file: str
    now: str
    before: str


class Revert(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A fix that can be taken out: the line of the work that asked for it, what is wrong without it, and the test that
    says so."""

    line: str
    about: str
    test: str
    change: tuple[Change, ...]


def reverts() -> dict[str, Revert]:
    """Return every fix by the name of its file. Raises: msgspec.ValidationError for a file of another shape."""
    found = sorted(Path(__file__).parent.glob("*.toml"))
    return {path.stem: msgspec.convert(tomllib.loads(path.read_text("utf-8")), Revert) for path in found}


def reverted(text: str, change: Change) -> str:
    """Return the text without the fix. Raises: ValueError where the text of the fix does not stand exactly once."""
    if (times := text.count(change.now)) != 1:
        raise ValueError(
            f"{change.file}: found {times} times {change.now!r:.90}, expected once; follow the fix to where it "
            "stands now"
        )
    return text.replace(change.now, change.before)
