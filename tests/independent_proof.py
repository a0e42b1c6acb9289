"""A second verifier of proofs, written from docs/shards.md and the C2SP text; it imports nothing of the package.

    python tests/independent_proof.py FILE [--key VKEY]

It prints what is proven, step by step, or the first thing that is wrong; exit code 0 or 3. A key is that of the ledger
with the last checkpoint.
"""

import argparse
import json
import sys
from pathlib import Path

from independent_verifier import (  # type: ignore[import-not-found]
    Note,
    canonical,
    from_base64,
    read_key,
    read_note,
    sha256,
)

TITLE = "c2sp.org/tlog-proof@v1\n"


def root_of(leaf: bytes, index: int, size: int, path: list[bytes]) -> bytes:
    """Return the root that this way leads to (RFC 9162, section 2.1.3.2). Raises ValueError if it leads nowhere."""
    if not 0 <= index < size:
        raise ValueError(f"index {index} in a tree of {size}")
    at, last, found = index, size - 1, leaf
    for other in path:
        if last == 0:
            raise ValueError("more hashes than the way has")
        if at & 1 or at == last:
            found = sha256(b"\x01", other, found)
            while not at & 1 and at:
                at, last = at >> 1, last >> 1
        else:
            found = sha256(b"\x01", found, other)
        at, last = at >> 1, last >> 1
    if last:
        raise ValueError("fewer hashes than the way has")
    return found


def step(text: str) -> tuple[dict[str, object], Note]:
    """Check one tlog-proof; return its event and its note. Raises ValueError."""
    head, _, note_text = text.partition("\n\n")
    title, extra, index, *hashes = head.split("\n")
    if title + "\n" != TITLE or not extra.startswith("extra ") or not index.startswith("index "):
        raise ValueError(f"{head!r:.80} is no tlog-proof")
    note: Note = read_note(note_text)
    data = from_base64(extra.removeprefix("extra "))
    root = root_of(sha256(b"\x00", data), int(index.removeprefix("index ")), note.size, list(map(from_base64, hashes)))
    if root != note.root:
        raise ValueError(f"a way to {root.hex()}, and the checkpoint has {note.root.hex()}")
    event: dict[str, object] = json.loads(data)
    if canonical(event) != data:
        raise ValueError("an event that is not canonical")
    return event, note


def verify(text: str, key_text: str | None = None) -> list[str]:
    """Return a line for each step that is proven. Raises ValueError."""
    first, *others = text.split("\n\n" + TITLE)
    if len(others) > 1:
        raise ValueError(f"{1 + len(others)} steps")
    event, note = step(first + "\n" if others else first)
    lines = [f"{event['run_id']}:{event['seq']} is one of {note.size} events of {note.origin}"]
    if others:
        head, log = step(TITLE + others[0])
        if head["type"] != "ShardRecorded.v1":
            raise ValueError(f"{head['type']} is no head of a shard")
        if (head["origin"], head["shard_events"], head["shard_root"]) != (note.origin, note.size, note.root.hex()):
            raise ValueError("the log has another head of the shard")
        lines, note = [*lines, f"that head is one of {log.size} in {log.origin}"], log
    if key_text is not None and note.has(read_key(key_text)) is not True:
        raise ValueError("the key did not sign the last checkpoint")
    return lines


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("file", type=Path)
    parser.add_argument("--key")
    asked = parser.parse_args(arguments)
    try:
        print("\n".join(verify(asked.file.read_text(), asked.key)))
    except (ValueError, KeyError, TypeError) as error:
        print(f"{asked.file}: {error}")
        return 3
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
