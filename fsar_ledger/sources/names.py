"""Commitments in place of the names of people, whose table lies outside the ledger and can be erased.

A name becomes `supervisor/~` and 26 letters, the SHA-256 of the name and a random key of its own, which stands beside
it in the table. The ledger proves the same with and without the table; without a line of it nobody can tell the name,
nor test a guess. What stays is the pattern: that it is one person, when, and about what.
"""

import base64
import hashlib
import os
import secrets
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
    """A line of the table: the name, its key (hex), and what stands in the ledger in its place."""

    name: str
    key: str
    commitment: str

    @property
    def is_right(self) -> bool:
        """Whether the commitment is that of the name."""
        return self.commitment == committed(self.name, bytes.fromhex(self.key))


def committed(name: str, key: bytes) -> str:
    """Return the commitment to a name with this key."""
    digest = hashlib.sha256(key + name.encode()).digest()
    return "~" + base64.b32encode(digest[:16]).decode().rstrip("=").lower()


class PrivateNames:
    """The table of names, a file of JSON lines that only its owner can read; made if there is none.

    Raises:
        UsageError: The file holds something else, or a commitment that is not that of its name.
        WriteFailed: It cannot be read or written.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o600)
            lines = path.read_bytes().splitlines()
        except OSError as error:
            raise WriteFailed(f"{value(str(path))}: the table of names cannot be opened ({error.strerror})") from error
        self._known: dict[str, str] = {}
        for number, line in enumerate(lines, 1):
            try:
                one = msgspec.json.decode(line, type=NamedPerson)
                is_right = one.is_right
            except (msgspec.DecodeError, ValueError) as error:
                raise UsageError(
                    f"{value(str(path))}:{number}: {error!s:.200}; expected a line of a table of names"
                ) from error
            if not is_right:
                raise UsageError(f"{value(str(path))}:{number}: found another commitment than that of the name and key")
            self._known[one.name] = one.commitment

    def close(self) -> None:
        """Close the file."""
        os.close(self._file)

    def hidden(self, name: str) -> str:
        """Return the commitment to a name; a new one is in the table, on disk, before it is returned."""
        if name not in self._known:
            key = secrets.token_bytes(32)
            one = NamedPerson(name, key.hex(), committed(name, key))
            try:
                append_whole(self._file, msgspec.json.encode(one) + b"\n")
            except OSError as error:
                raise WriteFailed(f"{value(str(self._path))}: the name was not written ({error.strerror})") from error
            self._known[name] = one.commitment
        return self._known[name]

    def event(self, event: Event) -> Event:
        """Return the event with commitments in place of the names of supervisors, and of persons that it observes."""
        changes: dict[str, object] = {}
        for column, found in flat(event).items():
            if isinstance(found, str) and self._is_name(found):
                changes[column] = self._principal(found)
            elif isinstance(found, tuple) and any(map(self._is_name, found)):
                changes[column] = tuple(self._principal(one) if self._is_name(one) else one for one in found)
        if isinstance(event, Observed) and any(map(_is_person, event.qualifiers)):
            pairs = zip(event.objects, event.qualifiers, strict=True)
            changes["objects"] = tuple(self.hidden(one) if _is_person(part) else one for one, part in pairs)
        return with_columns(event, **changes) if changes else event

    def _principal(self, name: str) -> str:
        return KIND + self.hidden(name.removeprefix(KIND))

    @staticmethod
    def _is_name(text: str) -> bool:
        return text.startswith(KIND) and text != FLEET_SUPERVISOR and not text.startswith(f"{KIND}~")


def _is_person(part: str) -> bool:
    """Return whether an object plays the part of a person, perhaps beside others (`person, owner`)."""
    return PERSON in part.split(", ")
