"""Commitments in place of the names of people, in a table that lies outside the ledger and can be erased.

A name becomes `supervisor/~` and 26 letters, the SHA-256 of the name and a random key of its own, which is beside it in
the table. The ledger proves the same with and without the table; without its line in the table, a name cannot be
recovered, nor a guess tested. What remains is the pattern: that it is one person, when, and about what.
"""

import base64
import fcntl
import hashlib
import os
import secrets
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import msgspec

from fsar_ledger.base.errors import UsageError, WriteFailed
from fsar_ledger.base.printable import value
from fsar_ledger.events import Event
from fsar_ledger.events.envelope import FLEET_SUPERVISOR, flat, with_columns
from fsar_ledger.events.source import Observed
from fsar_ledger.ledger.store.disk import append_whole

PERSON = "person"
"""The qualifier of an object of an observation that is a person."""
KIND = "supervisor/"


class NamedPerson(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A line of the table: the name, its key (hex), and its commitment, which the ledger has in its place."""

    name: str
    key: str
    commitment: str

    @property
    def is_right(self) -> bool:
        """Whether the commitment is that of the name and the key."""
        return self.commitment == committed(self.name, bytes.fromhex(self.key))


def committed(name: str, key: bytes) -> str:
    """Return the commitment to a name with this key."""
    digest = hashlib.sha256(key + name.encode()).digest()
    return "~" + base64.b32encode(digest[:16]).decode().rstrip("=").lower()


class PrivateNames:
    """The table of names, a file of JSON lines that only its owner can read; created if missing.

    Raises:
        UsageError: The file holds something else, or a commitment that is not that of its name.
        WriteFailed: It cannot be read or written.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        with self._table() as (_, lines):
            self._known = self._commitments(lines)

    def hidden(self, name: str) -> str:
        """Return the commitment to a name; a new one is on disk, in the table, before it is returned."""
        if name not in self._known:
            with self._table() as (file, lines):
                self._known = self._commitments(lines) | self._known  # recorders may share the table
                if name not in self._known:
                    self._known[name] = self._added(file, lines, name)
        return self._known[name]

    @contextmanager
    def _table(self) -> Iterator[tuple[int, list[bytes]]]:
        """Open the table and read its lines, under an exclusive lock where the file system has locks."""
        try:
            file = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o600)
        except OSError as error:
            raise self._failed("the table of names cannot be opened", error) from error
        try:
            with suppress(OSError):
                fcntl.flock(file, fcntl.LOCK_EX)
            with open(file, "rb", closefd=False) as table:
                lines = table.readlines()
            yield file, lines
        finally:
            os.close(file)

    def _commitments(self, lines: Sequence[bytes]) -> dict[str, str]:
        commitments: dict[str, str] = {}
        for number, line in enumerate(lines, 1):
            where = f"{value(str(self._path))}:{number}"
            try:
                person = msgspec.json.decode(line, type=NamedPerson)
                is_right = person.is_right
            except (msgspec.DecodeError, ValueError) as error:
                raise UsageError(f"{where}: {error!s:.200}; expected a line of a table of names") from error
            if not is_right:
                raise UsageError(f"{where}: found another commitment than that of the name and key")
            if commitments.setdefault(person.name, person.commitment) != person.commitment:
                raise UsageError(
                    f"{where}: found a second commitment to a name, expected one: they would be two people; keep the "
                    "line whose commitment the ledger has, and the other elsewhere"
                )
        return commitments

    def _added(self, file: int, lines: Sequence[bytes], name: str) -> str:
        key = secrets.token_bytes(32)
        person = NamedPerson(name, key.hex(), committed(name, key))
        gap = b"" if not lines or lines[-1].endswith(b"\n") else b"\n"  # an editor may have left the last line open
        try:
            append_whole(file, gap + msgspec.json.encode(person) + b"\n")
        except OSError as error:
            raise self._failed("the name was not written", error) from error
        return person.commitment

    def _failed(self, what: str, error: OSError) -> WriteFailed:
        return WriteFailed(f"{value(str(self._path))}: {what} ({error.strerror})")

    def ledger_name(self, principal: str) -> str:
        """Return the principal as the ledger names it, unchanged if the table has no line for the name."""
        commitment = self._known.get(principal.removeprefix(KIND)) if self._is_name(principal) else None
        return principal if commitment is None else KIND + commitment

    def event(self, event: Event) -> Event:
        """Return the event with commitments in place of the names of supervisors, and of persons that it observes."""
        changes: dict[str, object] = {}
        for column, content in flat(event).items():
            if isinstance(content, str) and self._is_name(content):
                changes[column] = self._principal(content)
            elif isinstance(content, tuple) and any(map(self._is_name, content)):
                changes[column] = tuple(self._principal(name) if self._is_name(name) else name for name in content)
        if isinstance(event, Observed) and any(map(_is_person, event.qualifiers)):
            pairs = zip(event.objects, event.qualifiers, strict=True)
            changes["objects"] = tuple(self.hidden(name) if _is_person(part) else name for name, part in pairs)
        return with_columns(event, **changes) if changes else event

    def _principal(self, name: str) -> str:
        return KIND + self.hidden(name.removeprefix(KIND))

    @staticmethod
    def _is_name(text: str) -> bool:
        return text.startswith(KIND) and text != FLEET_SUPERVISOR and not text.startswith(f"{KIND}~")


def _is_person(part: str) -> bool:
    """Return whether the part of an object is that of a person, perhaps beside others (`person, owner`)."""
    return PERSON in part.split(", ")
