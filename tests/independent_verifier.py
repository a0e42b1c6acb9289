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
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import independent_ed25519  # type: ignore[import-not-found]
import independent_parquet  # type: ignore[import-not-found]
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

MAX_INTEGER = 2**53 - 1
FOLDERS, FILES = {"commits", "segments", "staging", "tile"}, {"ledger.json", "checkpoint"}
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
MANIFEST = {"format": '"fsar-ledger"', "origin": TEXT, "version": "1"}
RECORD = dict.fromkeys(("number", "segment_bytes", "rows", "tree_size"), COUNT) | dict.fromkeys(
    ("first_run", "last_run", "note", "release"), TEXT
)
RECORD |= dict.fromkeys(("previous_sha256", "schema_sha256", "segment_sha256", "tree_root"), HASH) | {
    "frontier": rf"\[({HASH}(,(?!\])|(?=\])))*\]"
}


def read_json(path: Path, where: str, members: dict[str, str], commit: int | None = None) -> tuple[Row, str]:
    """Read an object with exactly these members, each of this pattern in canonical JSON, and hash it (section 2)."""
    try:
        data = read_file(path)
        found = json.loads(data.decode())
        if not isinstance(found, dict) or found.keys() != members.keys() or canonical(found) != data:
            raise ValueError("other members, or other bytes")
        wrong = [
            name for name, pattern in members.items() if not re.fullmatch(pattern, canonical(found[name]).decode())
        ]
        wrong += [
            name
            for name, value in found.items()
            if (isinstance(value, int) and value > MAX_INTEGER) or (name == "origin" and not is_name(value))
        ]
        if wrong or len(found.get("frontier", [])) != found.get("tree_size", 0).bit_count():
            raise ValueError(f"other values of {wrong or 'frontier'}")
    except (OSError, ValueError, RecursionError) as error:
        raise ProblemError(where, error, f"canonical JSON of {sorted(members)}", commit) from error
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


class Tile(NamedTuple):
    """A tile of `width` hashes (section 8)."""

    level: int
    number: int
    width: int

    def __str__(self) -> str:
        groups = re.sub("(...)(?=.)", r"x\1/", str(self.number).zfill((len(str(self.number)) + 2) // 3 * 3))
        return f"tile/{self.level}/{groups}" + ("" if self.width == 256 else f".p/{self.width}")

    def is_outgrown(self, size: int) -> bool:
        return self.width < 256 and self.number < size >> 8 * self.level >> 8


def tiles_between(old: int, new: int) -> Iterator[Tile]:
    """Return the tiles that a commit adds to a tree of `old` leaves."""
    for level in range((new.bit_length() + 7) // 8):
        before, now = old >> 8 * level, new >> 8 * level
        yield from (Tile(level, number, 256) for number in range(before // 256, now // 256))
        if now > before and now % 256:
            yield Tile(level, now // 256, now % 256)


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
    if (cause is None) != (place == 0) or (cause is not None and not 0 <= cause < place):
        return "caused_by", "NULL at seq 0, else the seq of an earlier event"
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


def runs_of(where: str, rows: list[Row], number: int, types: Row | None) -> list[str]:
    """Return the runs, in order, of rows that are all right."""
    runs: list[str] = []
    place = 0
    alone = {name for name, own in types["types"].items() if own.get("alone")} if types is not None else set[str]()
    concerns = (
        {name: own["concern"] for name, own in types["types"].items() if "concern" in own}
        if types is not None
        else dict[str, str]()
    )
    observed = set(concerns.values())
    for at, row in enumerate(rows):
        is_new = row["run_id"] not in runs[-1:]
        place = 0 if is_new else place + 1
        flaw = flaw_of(row, place, is_new and row["run_id"] in runs, types)
        if (
            flaw is None
            and row["type"] in alone
            and (place > 0 or row["run_id"] in [other["run_id"] for other in rows[at + 1 : at + 2]])
        ):
            flaw = "type", "the only event of its run"
        if is_new:
            observed = set(row.get("observes", concerns.values()))
        if flaw is None and types is not None and not set(row.get("observes", [])) <= set(concerns.values()):
            flaw = "observes", "concerns that there are"
        if flaw is None and concerns.get(row["type"]) not in {None, *observed}:
            flaw = "type", "an event of a concern that its run observes"
        if flaw is not None:
            raise ProblemError(
                where, f"{flaw[0]} {row.get(flaw[0], 'NULL')!r}", flaw[1], number, row["run_id"], row["seq"]
            )
        runs += [row["run_id"]] * is_new
    return runs


class Verifier:
    """The verification of section 11; each step raises ProblemError for the first thing that is wrong."""

    def __init__(self, ledger: Path, key: Key | None = None, anchor: Path | None = None, types: Row | None = None):
        self.ledger, self.key, self.anchor, self.types = ledger, key, anchor, types
        self.tree, self.sizes, self.notes, self.runs = Tree(), [0], list[Note](), set[str]()

    def verify(self) -> tuple[int, str, str, list[str]]:
        """Verify the ledger; return its events, its root, whose signature it has, and what a crash left."""
        found = sorted(os.scandir(self.ledger), key=lambda entry: entry.name)
        for entry in found:
            if not (
                entry.is_dir(follow_symlinks=False)
                if entry.name in FOLDERS
                else entry.name in FILES and entry.is_file(follow_symlinks=False)
            ):
                raise ProblemError(entry.name, "something else, a link or an unknown name", f"only {FOLDERS | FILES}")
        for name in sorted({"ledger.json", "commits", "segments"} - {entry.name for entry in found}):
            raise ProblemError(name, "nothing", "it to be there")
        manifest, previous = read_json(self.ledger / "ledger.json", "ledger.json", MANIFEST)
        for record, digest in (records := self.read_records()):
            self.check_record(record, previous, manifest["origin"])
            self.check_segment(record)
            previous = digest
        for name in sorted(
            set(os.listdir(self.ledger / "segments")) - {f"{number:012d}.parquet" for number in range(len(self.notes))}
        ):
            raise ProblemError(f"segments/{name}", "a file of no commit", "only segments of commits")
        remarks = self.check_derived([None, *(record["note"] for record, _ in records)])
        signature = self.check_signatures()
        self.check_anchor(manifest["origin"])
        return self.sizes[-1], root_of(self.tree.frontier(self.sizes[-1])).hex(), signature, remarks

    def read_records(self) -> list[tuple[Row, str]]:
        names = sorted(os.listdir(self.ledger / "commits"))
        expected = [f"{number:012d}.json" for number in range(len(names))]
        for name in filter(lambda name: not re.fullmatch("[0-9]{12}[.]json", name), names):
            raise ProblemError(f"commits/{name}", "a stray file", "only records")
        for name in sorted(set(names) - set(expected)):
            raise ProblemError(f"commits/{name}", "a gap before it", "numbers without gaps", int(name[:12]))
        return [
            read_json(self.ledger / "commits" / name, f"commits/{name}", RECORD, number)
            for number, name in enumerate(expected)
        ]

    def check_record(self, record: Row, previous: str, origin: str) -> None:
        """Check the record against its place, the tree before it and itself."""
        number, root = len(self.notes), root_of([bytes.fromhex(subtree) for subtree in record["frontier"]])
        expected = {
            "number": number,
            "previous_sha256": previous,
            "rows": max(1, record["tree_size"] - self.sizes[-1]),
            "tree_root": root.hex(),
        }
        try:
            for name in [name for name, value in expected.items() if record[name] != value]:
                raise ValueError(f"{name} {record[name]}, not {expected[name]}")
            if self.types is not None and self.types["releases"].get(record["release"]) != record["schema_sha256"]:
                raise ValueError(f"release {record['release']}, schema_sha256 {record['schema_sha256']}")
            note = read_note(record["note"])
            is_own = len(note.signatures) <= 1 and all(
                name == origin and len(data) == 64 for name, _, data in note.signatures
            )
            if note[:3] != (origin, record["tree_size"], root) or not is_own:
                raise ValueError(f"note {note}")
        except ValueError as error:
            raise ProblemError(
                f"commits/{number:012d}.json", error, "what the other files and its own fields give", number
            ) from error
        self.notes.append(note)
        self.sizes.append(record["tree_size"])

    def check_segment(self, record: Row) -> None:
        """Check the segment, in place or in staging, against the record, and add its rows to the tree."""
        number = record["number"]
        where, staged = f"segments/{number:012d}.parquet", f"staging/{record['segment_sha256']}.parquet"
        if (
            not os.path.lexists(self.ledger / where)
            and (self.ledger / staged).is_file()
            and not (self.ledger / staged).is_symlink()
        ):
            where = staged
        try:
            rows, runs = self.read_segment(where, record)
        except (OSError, ValueError, KeyError, MemoryError) as error:
            raise ProblemError(
                where, f"{type(error).__name__}: {error}", "the segment of its record", number
            ) from error
        for row in rows:
            self.tree.append(canonical(row))
        if [each.hex() for each in self.tree.frontier(record["tree_size"])] != record["frontier"]:
            raise ProblemError(where, "other rows", "those of the tree", number)
        if (record["first_run"], record["last_run"]) != (runs[0], runs[-1]):
            raise ProblemError(f"commits/{number:012d}.json", "other runs", f"{runs[0]} to {runs[-1]}", number)
        for run in runs:
            if run in self.runs:
                raise ProblemError(where, f"run {run} once more", "each run in one commit", number, run, 0)
        self.runs.update(runs)

    def read_segment(self, where: str, record: Row) -> tuple[list[Row], list[str]]:
        data = read_file(self.ledger / where, record["segment_bytes"])
        if len(data) != record["segment_bytes"] or hashlib.sha256(data).hexdigest() != record["segment_sha256"]:
            raise ValueError("another size or SHA-256")
        count, columns, values = independent_parquet.read(data)
        own = columns[5:]
        if columns[:5] != list(ENVELOPE.items()) or own != sorted(own) or not {text for _, text in own} <= TEXTS:
            raise ValueError(f"columns {columns}")
        if (
            count != record["rows"]
            or sha256("".join(f"{name} {text}\n" for name, text in columns).encode()).hex() != record["schema_sha256"]
        ):
            raise ValueError("other rows, or another fingerprint")
        rows: list[Row] = [{} for _ in range(record["rows"])]
        for name, column in values.items():
            for row, value in zip(rows, column, strict=True):
                if value is not None:
                    row[name] = value
        return rows, runs_of(where, rows, record["number"], self.types)

    def check_derived(self, texts: list[str | None]) -> list[str]:
        """Check that the checkpoint is the newest note or the one before, and the tiles against the tree."""
        try:
            found = (
                read_file(self.ledger / "checkpoint").decode() if os.path.lexists(self.ledger / "checkpoint") else None
            )
            if found not in texts[-2:]:
                raise ValueError(f"{found!r}")
        except (OSError, ValueError) as error:
            raise ProblemError("checkpoint", error, "the newest note") from error
        made = [list(tiles_between(old, new)) for old, new in zip(self.sizes, self.sizes[1:], strict=False)]
        must = sorted(
            [tile for tiles in made for tile in tiles if not tile.is_outgrown(self.sizes[-1])],
            key=lambda tile: tile.width < 256,
        )
        may = [
            tile
            for tiles in made[:-1]
            for tile in tiles
            if tile.is_outgrown(self.sizes[-1]) and not tile.is_outgrown(self.sizes[-2])
        ]
        for tile in [tile for tile in must if not self.has_tile(tile)]:
            if found == texts[-1] or tile not in made[-1]:
                raise ProblemError(str(tile), "no file", f"{tile.width} hashes")
        left = [tile for tile in may if self.has_tile(tile)]
        files = {
            str(file.relative_to(self.ledger))
            for file in (self.ledger / "tile").rglob("*")
            if file.is_symlink() or not file.is_dir()
        }
        for name in sorted(files - set(map(str, must + left))):
            raise ProblemError(name, "a stray file", "only tiles of this tree")
        return ["one commit behind"] * (found != texts[-1]) + ["outgrown tiles"] * (found == texts[-1] and bool(left))

    def has_tile(self, tile: Tile) -> bool:
        """Return whether the tile exists; raise if it is wrong."""
        try:
            found = read_file(self.ledger / str(tile))
        except FileNotFoundError:
            return False
        except (OSError, ValueError) as error:
            raise ProblemError(str(tile), error, f"{tile.width} hashes") from error
        if found != b"".join(self.tree.levels[8 * tile.level][256 * tile.number : 256 * tile.number + tile.width]):
            raise ProblemError(str(tile), "other hashes", "those of the events")
        return True

    def check_signatures(self) -> str:
        """Return what the newest note's signature is worth."""
        if self.key is None:
            return "signer not checked" if self.notes and self.notes[-1].signatures else "unsigned"
        if not self.notes:
            raise ProblemError("ledger.json", "no commit", "a signed note")
        for number, note in enumerate(self.notes):
            if note.has(self.key) is False or (number == len(self.notes) - 1 and not note.has(self.key)):
                raise ProblemError(
                    f"commits/{number:012d}.json",
                    "no signature of the trusted key, or a wrong one",
                    self.key[0],
                    number,
                )
        return "signed"

    def check_anchor(self, origin: str) -> None:
        """Check that the ledger begins with the events of the earlier checkpoint."""
        if self.anchor is None:
            return
        try:
            note = read_note(read_file(self.anchor).decode())
            if note.origin != origin or (self.key is not None and not note.has(self.key)):
                raise ValueError("a checkpoint of another origin, or not signed by the trusted key")
        except (OSError, ValueError) as error:
            raise ProblemError(str(self.anchor), error, f"a checkpoint of {origin}") from error
        if note.size > self.sizes[-1] or root_of(self.tree.frontier(note.size)) != note.root:
            raise ProblemError(
                "commits", "fewer events than then, or others", f"the first {note.size} events of the anchor"
            )


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("ledger", type=Path)
    for option in ("--key", "--anchor", "--event-types"):
        parser.add_argument(option)
    asked = parser.parse_args(arguments)
    from independent_chain import verifier_of  # type: ignore[import-not-found]  # it needs this module

    key = read_key(Path(asked.key).read_text() if os.path.exists(asked.key) else asked.key) if asked.key else None
    types = json.loads(Path(asked.event_types).read_text()) if asked.event_types else None
    anchor = Path(asked.anchor) if asked.anchor else None
    try:
        print("consistent:", *verifier_of(asked.ledger, key, anchor, types).verify())
    except ProblemError as error:
        print(error)
        return 3
    return 0


if __name__ == "__main__":
    import independent_verifier  # type: ignore[import-not-found]

    sys.exit(independent_verifier.main(sys.argv[1:]))
