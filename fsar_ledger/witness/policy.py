"""The auditor's policy (C2SP tlog-policy): logs, witnesses, groups, and how many of each must have cosigned.

```
log fsar-ledger/simulated+192e3659+AQ...
witness w1 example.org/w1+8d66cf3f+BA... http://127.0.0.1:8001
witness w2 example.net/w2+1f0ab2c3+BA... http://127.0.0.1:8002
witness w3 example.com/w3+77e01d4a+BA...
group two-of-three 2 w1 w2 w3
quorum two-of-three
```
"""

import os
import re
from collections.abc import Set as AbstractSet
from pathlib import Path

import msgspec

from fsar_ledger.base.errors import UsageError
from fsar_ledger.ledger.log.note import VerifierKey
from fsar_ledger.ledger.store import disk

from . import WitnessKey, parse_vkey

_NONE = "none"
_WHITE = " \t"
_DECIMAL = re.compile(r"[1-9][0-9]{0,8}")
_FORBIDDEN = re.compile(rb"[^\t\n\x20-\x7e\x80-\xff]")


class Witness(msgspec.Struct, frozen=True):
    """A witness: its name within the policy, its key, and its URL, if any."""

    name: str
    key: WitnessKey
    url: str | None = None


class Group(msgspec.Struct, frozen=True):
    """A group of witnesses and earlier groups, `threshold` of which must have cosigned."""

    name: str
    threshold: int
    members: tuple[str, ...]


class Policy(msgspec.Struct, frozen=True):
    """A parsed policy: logs, witnesses and groups in the order of the file.

    `quorum` is the name of the witness or group that must have cosigned; None if none is required.
    """

    file: str
    logs: tuple[VerifierKey, ...]
    witnesses: tuple[Witness, ...]
    groups: tuple[Group, ...]
    quorum: str | None

    def is_met(self, cosigned: AbstractSet[str]) -> bool:
        """Return whether the witnesses with these names meet the quorum."""
        if self.quorum is None:
            return True
        enough = {witness.name for witness in self.witnesses if witness.name in cosigned}
        for group in self.groups:  # each comes after its members
            if sum(1 for member in group.members if member in enough) >= group.threshold:
                enough.add(group.name)
        return self.quorum in enough

    def rule(self) -> str:
        """Return the quorum as text."""
        groups = {group.name: group for group in self.groups}
        if self.quorum not in groups:
            return f"that of {self.quorum}"
        group = groups[self.quorum]
        return f"{group.threshold} of {', '.join(group.members)}"


def read_policy(path: Path) -> Policy:
    """Read the policy in this file. Raises: UsageError if it is not a valid one."""
    try:
        return parse_policy(str(path), disk.read_document(Path(os.path.realpath(path))))
    except OSError as error:
        raise UsageError(
            f"{path}: the policy cannot be read ({error.strerror}), expected a C2SP tlog-policy"
        ) from error


def parse_policy(file: str, data: bytes) -> Policy:
    """Parse the bytes of a policy file.

    Raises:
        UsageError: A line is not valid in C2SP tlog-policy; the message names the line.
    """
    reader = _Reader(file)
    forbidden = _FORBIDDEN.search(data)
    if forbidden is not None:
        reader.number = data.count(b"\n", 0, forbidden.start()) + 1
        raise reader.wrong(f"byte {forbidden.group()[0]:#04x}", "text; of control characters only tabs and line feeds")
    *lines, rest = data.decode("utf-8", "surrogateescape").split("\n")
    for number, line in enumerate([*lines, rest] if rest else lines, 1):
        reader.number = number
        words = [word for word in re.split(f"[{_WHITE}]+", line.strip(_WHITE)) if word]
        if number > len(lines) and words:
            raise reader.wrong("a line without its line feed", "a whole file; the end of it may be missing")
        if words and not words[0].startswith("#"):
            reader.read(words)
    return reader.policy()


class _Reader:
    """The parser of a policy, one line at a time."""

    def __init__(self, file: str) -> None:
        self.file, self.number = file, 0
        self.logs: list[VerifierKey] = []
        self.witnesses: list[Witness] = []
        self.groups: list[Group] = []
        self.names: set[str] = {_NONE}
        self.members: set[str] = set()
        self.quorum: str | None = None

    def wrong(self, found: str, expected: str) -> UsageError:
        """Return the error for the current line."""
        return UsageError(f"{self.file}: line {self.number}: found {found}, expected {expected}")

    def read(self, words: list[str]) -> None:
        """Parse one more line. Raises: UsageError."""
        match words:
            case ["log", key] | ["log", key, _]:
                self._log(self._key(key))
            case ["witness", name, key]:
                self._witness(name, self._key(key), None)
            case ["witness", name, key, url]:
                self._witness(name, self._key(key), url)
            case ["group", name, threshold, _, *_]:
                self._group(name, threshold, words[3:])
            case ["quorum", name]:
                if self.quorum is not None:
                    raise self.wrong("a second quorum", "one")
                self.quorum = self._require_known_name(name, is_quorum=True)
            case _:
                raise self.wrong(
                    f"{' '.join(words)!a:.60}",
                    "log KEY [URL], witness NAME KEY [URL], group NAME K MEMBER..., or quorum NAME",
                )

    def _key(self, text: str) -> VerifierKey | WitnessKey:
        try:
            return parse_vkey(text)
        except ValueError as error:
            raise UsageError(f"{self.file}: line {self.number}: {error}") from error

    def _log(self, key: VerifierKey | WitnessKey) -> None:
        if not isinstance(key, VerifierKey):
            raise self.wrong("the key of a witness (0x04)", "that of a log, as `fsar-ledger key new` prints it")
        if any(log.public == key.public for log in self.logs):
            raise self.wrong("the key of a log that was given before", "each log once")
        self.logs.append(key)

    def _witness(self, name: str, key: VerifierKey | WitnessKey, url: str | None) -> None:
        if not isinstance(key, WitnessKey):
            raise self.wrong("the key of a log (0x01)", "that of a witness, as `fsar-ledger witness new` prints it")
        if any(witness.key.public == key.public for witness in self.witnesses):
            raise self.wrong(
                "the key of a witness that was given before", "each witness once; under two names it would count twice"
            )
        self.witnesses.append(Witness(self._new(name), key, url))

    def _group(self, name: str, threshold: str, members: list[str]) -> None:
        for member in members:
            self._require_known_name(member)
            if member in self.members:
                raise self.wrong(
                    f"{member!a:.60} in a second place",
                    "each witness and group in one group at most, and once; else it would count twice",
                )
            self.members.add(member)
        words = {"any": 1, "all": len(members)}
        count = words.get(threshold, int(threshold) if _DECIMAL.fullmatch(threshold) else 0)
        if not 1 <= count <= len(members):
            raise self.wrong(
                f"{threshold!a:.60}", f"any, all, or a number from 1 to {len(members)}, the members of the group"
            )
        self.groups.append(Group(self._new(name), count, tuple(members)))

    def _new(self, name: str) -> str:
        if name in self.names:
            raise self.wrong(f"a second {name!a:.60}", "a name that is not taken yet")
        self.names.add(name)
        return name

    def _require_known_name(self, name: str, *, is_quorum: bool = False) -> str:
        if name not in self.names or (name == _NONE and not is_quorum):
            raise self.wrong(f"{name!a:.60}", "a witness or a group of a line before")
        return name

    def policy(self) -> Policy:
        """Return the parsed policy. Raises: UsageError if it has no quorum."""
        if self.quorum is None:
            raise UsageError(
                f"{self.file}: found no quorum, expected a line with the witness or group that must have cosigned"
            )
        quorum = None if self.quorum == _NONE else self.quorum
        return Policy(self.file, tuple(self.logs), tuple(self.witnesses), tuple(self.groups), quorum)
