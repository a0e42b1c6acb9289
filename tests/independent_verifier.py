"""A second verifier, written from docs/ledger-format.md and the standards it names; it imports nothing of the package.

    python tests/independent_verifier.py LEDGER [--key VKEY] [--anchor FILE] [--event-types FILE]

It prints `consistent` or the first thing that is wrong, in the order of the document's section 11; exit code 0 or 3.
Its own files beside it read Parquet, to the last byte; a library does Ed25519, and another unpacks zstd.
"""

import argparse
import base64
import hashlib
import json
import os
import re
import stat
import sys
import unicodedata
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import independent_ed25519  # type: ignore[import-not-found]
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

MAX_INTEGER = 2**53 - 1
ENVELOPE = {
    "run_id": "string not null",
    "seq": "int64 not null",
    "time_us": "int64 not null",
    "caused_by": "int64",
    "type": "string not null",
}
TEXTS = {"string", "int64", "bool", "list<element: string not null>"}
Row = dict[str, Any]


class ProblemError(Exception):
    """The first thing that is wrong: the file, and commit, run and seq as far as they are known."""

    def __init__(
        self,
        where: str,
        found: object,
        expected: object,
        commit: int | None = None,
        run: str | None = None,
        seq: int | None = None,
    ):
        super().__init__(f"{where}: found {found!s:.300}, expected {expected!s:.300}")
        self.where, self.commit, self.run, self.seq = where, commit, run, seq


def read_file(path: Path, most: int = 1 << 20) -> bytes:
    """Read a regular file that is not larger than this. Raises OSError or ValueError."""
    with open(os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK), "rb") as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode) or len(data := file.read(most + 1)) > most:
            raise ValueError(f"no regular file of at most {most} bytes")
    return data


def canonical(value: object) -> bytes:
    return json.dumps(value, ensure_ascii=False, sort_keys=True, separators=(",", ":")).encode()


def is_name(value: object) -> bool:
    return (
        isinstance(value, str)
        and value != ""
        and not any(each == "+" or unicodedata.category(each)[0] in "CZ" for each in value)
    )


COUNT, TEXT, HASH = "0|[1-9][0-9]{0,15}", '(?s:".*")', '"[0-9a-f]{64}"'


def read_json(path: Path, where: str, members: dict[str, str]) -> tuple[Row, str]:
    """Read an object with exactly these members, each of this pattern in canonical JSON, and hash it (section 2)."""
    try:
        data = read_file(path)
        found = json.loads(data.decode())
        if not isinstance(found, dict) or found.keys() != members.keys() or canonical(found) != data:
            raise ValueError("other members, or other bytes")
        wrong = [
            name for name, pattern in members.items() if not re.fullmatch(pattern, canonical(found[name]).decode())
        ]
        wrong += [name for name, value in found.items() if name == "origin" and not is_name(value)]
        if wrong:
            raise ValueError(f"other values of {wrong}")
    except (OSError, ValueError, RecursionError) as error:
        raise ProblemError(where, error, f"canonical JSON of {sorted(members)}") from error
    return found, hashlib.sha256(data).hexdigest()


def sha256(*parts: bytes) -> bytes:
    return hashlib.sha256(b"".join(parts)).digest()


def root_of(frontier: Sequence[bytes]) -> bytes:
    root = frontier[-1] if frontier else sha256()
    for subtree in reversed(frontier[:-1]):
        root = sha256(b"\x01", subtree, root)
    return root


class Tree:
    """Every hash of a growing tree (section 7): `levels[h]` holds the roots of its complete subtrees of 2**h leaves."""

    def __init__(self) -> None:
        self.levels: list[list[bytes]] = [[] for _ in range(64)]

    def append(self, data: bytes) -> None:
        found = sha256(b"\x00", data)
        for level in self.levels:
            level.append(found)
            if len(level) % 2:
                return
            found = sha256(b"\x01", level[-2], level[-1])

    def frontier(self, size: int) -> list[bytes]:
        return [
            self.levels[height][(size >> height) - 1]
            for height in reversed(range(size.bit_length()))
            if size >> height & 1
        ]


Key = tuple[str, bytes, bytes]  # name, key id, public key


def from_base64(text: str) -> bytes:
    data = base64.b64decode(text, validate=True)
    if base64.b64encode(data).decode() != text:
        raise ValueError(f"{text!r:.80} is not the one base64 of its bytes")
    return data


def read_key(text: str) -> Key:
    name, key_id, data = text.strip().split("+", 2)
    raw = from_base64(data)
    if (
        len(raw) != 33
        or raw[0] != 1
        or sha256(name.encode(), b"\n", raw)[:4].hex() != key_id
        or not independent_ed25519.is_key(raw[1:])
    ):
        raise ValueError(f"{text!r:.100} is no Ed25519 public key")
    return name, bytes.fromhex(key_id), raw[1:]


class Note(NamedTuple):
    """A note (section 9): its checkpoint, the signed text, and each signature's name, key id and bytes."""

    origin: str
    size: int
    root: bytes
    text: str
    signatures: list[tuple[str, bytes, bytes]]

    def has(self, key: Key) -> bool | None:
        """Return whether the key's signatures are right; None if there are none, or the origin is another."""
        own = [data for name, key_id, data in self.signatures if (name, key_id) == key[:2] and self.origin == name]
        try:
            for data in own:
                Ed25519PublicKey.from_public_bytes(key[2]).verify(data, self.text.encode())
        except (InvalidSignature, ValueError):
            return False
        return True if own else None


def read_note(text: str) -> Note:
    """Parse a note. Raises ValueError unless the text is one to the byte."""
    parts = re.fullmatch("(([^\n]*)\n(0|[1-9][0-9]{0,15})\n([^\n]{44})\n)\n((?:\u2014 [^\n ]+ [^\n ]+\n){0,16})", text)
    if parts is None:
        raise ValueError(f"{text!r:.200} is no note")
    signatures = [
        (name, from_base64(data)) for _, name, data in (line.split(" ") for line in parts[5].split("\n")[:-1])
    ]
    note = Note(
        parts[2],
        int(parts[3]),
        from_base64(parts[4]),
        parts[1],
        [(name, data[:4], data[4:]) for name, data in signatures],
    )
    if (
        len(note.root) != 32
        or not is_name(note.origin)
        or not all(is_name(name) and data for name, _, data in note.signatures)
    ):
        raise ValueError("a name, a root or a signature that cannot be")
    return note


def flaw_of(row: Row, place: int, is_again: bool, types: Row | None) -> tuple[str, object] | None:
    """Return what is wrong with a row at this place of its run's block: the field and what was expected (section 5).

    `types` is docs/event-types.json.
    """
    if row["seq"] != place or is_again:
        return ("seq", place) if row["seq"] != place else ("run_id", "each run in one block of rows")
    cause = row.get("caused_by")
    if cause is not None and not 0 <= cause < place:
        return "caused_by", "NULL, or the seq of an earlier event"
    large = [name for name, value in row.items() if type(value) is int and abs(value) > MAX_INTEGER]
    if large or types is None:
        return (large[0], "at most 2^53 - 1 in size") if large else None
    own = types["types"].get(row["type"])
    if own is None:
        return "type", "a type of the list"
    for name in sorted((row.keys() - ENVELOPE.keys()) | set(own["required"])):
        if (
            name not in row
            or name not in own["required"] + own["optional"]
            or row[name] not in own["values"].get(name, [row[name]])
        ):
            return name, f"what {row['type']} has there"
    return None


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("ledger", type=Path)
    for option in ("--key", "--anchor", "--event-types"):
        parser.add_argument(option)
    asked = parser.parse_args(arguments)
    from independent_chain import Verifier  # type: ignore[import-not-found]  # it needs this module

    key = read_key(Path(asked.key).read_text() if os.path.exists(asked.key) else asked.key) if asked.key else None
    types = json.loads(Path(asked.event_types).read_text()) if asked.event_types else None
    anchor = Path(asked.anchor) if asked.anchor else None
    try:
        print("consistent:", *Verifier(asked.ledger, key, anchor, types).verify())
    except ProblemError as error:
        print(error)
        return 3
    return 0


if __name__ == "__main__":
    import independent_verifier  # type: ignore[import-not-found]

    sys.exit(independent_verifier.main(sys.argv[1:]))
