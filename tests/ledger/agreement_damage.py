"""Damage to a ledger: each function damages one thing, and tells whether a verifier must find it.

A function takes a ledger that it may change, a source of draws, and a folder for files beside the ledger. It returns
None if it does not apply.
"""

import os
import random
import shutil
from pathlib import Path
from typing import Any

from fsar_ledger.ledger.log.merkle import Frontier
from fsar_ledger.ledger.log.note import Note, Signature, checkpoint_of
from fsar_ledger.ledger.log.tiles import WIDTH, partial_tiles
from fsar_ledger.ledger.store.derived import tile_reader
from fsar_ledger.ledger.store.paths import commit_path, segment_path
from tests.ledger.agreement import (
    KEY,
    STRANGER,
    Case,
    Make,
    anchor_at,
    chain,
    files_of,
    newest_tiles,
    note_of,
    records_of,
    rewrite,
    tables_of,
    unchained,
)
from tests.ledger.agreement_rows import (
    a_broken_rule,
    a_flipped_bit_whose_hash_fits,
    an_altered_row,
    lying_statistics,
    other_parquet,
)
from tests.ledger.samples import ORIGIN

HASH = "ab" * 32


# --- damaged files ---


def a_flipped_bit(path: Path, draw: random.Random, beside: Path) -> Case | None:
    file = draw.choice(files_of(path))
    data = bytearray(file.read_bytes())
    at = draw.randrange(len(data))
    data[at] ^= 1 << draw.randrange(8)
    file.write_bytes(data)
    is_vouched = (
        file.name != "ledger.json" or len(files_of(path)) > 1
    )  # nothing vouches for the origin of an empty ledger
    return Case(f"a flipped bit in byte {at} of {file.relative_to(path)}", path, False if is_vouched else None)


def a_cut_or_longer_file(path: Path, draw: random.Random, beside: Path) -> Case | None:
    file = draw.choice(files_of(path))
    data = file.read_bytes()
    file.write_bytes(
        draw.choice([data[: draw.randrange(len(data))], data + b"\n", data + data, b"", bytes(len(data)), b"[" * 5000])
    )
    return Case(f"another length of {file.relative_to(path)}", path, False)


def a_file_gone_or_something_else(path: Path, draw: random.Random, beside: Path) -> Case | None:
    file = draw.choice([*files_of(path), path / "commits", path / "segments", path / "tile"])
    if not file.exists():
        return None
    shutil.move(file, beside / "aside")
    what = draw.randrange(4)
    if what == 1:
        file.symlink_to(beside / "aside")
    elif what == 2:
        file.mkdir() if (beside / "aside").is_file() else file.write_bytes(b"x")
    elif what == 3:
        os.mkfifo(file)
    return Case(f"{file.relative_to(path)} {('gone', 'a link', 'of another kind', 'a pipe')[what]}", path, None)


def a_stray_file(path: Path, draw: random.Random, beside: Path) -> Case | None:
    count = len(list((path / "commits").iterdir()))
    names = [
        "x",
        "tiles",
        "commits/x",
        f"commits/{count + 1:012d}.json",
        "commits/12.json",
        f"segments/{count:012d}.parquet",
        "segments/.x",
    ]
    names += [
        "tile/x",
        "tile/0/000.p/255.x",
        "tile/0/999",
        "tile/9/000",
        "tile/0/x000/000",
        "tile/0/000.p/0",
        "tile/0/0000",
        "tile/00/000",
        "tile/a/b/c",
    ]
    file = path / draw.choice(names)
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(draw.choice([b"", bytes(32), b"{}"]))
    return Case(f"a stray {file.relative_to(path)}", path, False)


def swapped_files(path: Path, draw: random.Random, beside: Path) -> Case | None:
    folder = draw.choice(["commits", "segments", "tile"])
    files = files_of(path / folder)
    if len(files) < 2:
        return None
    one, other = draw.sample(files, 2)
    data = one.read_bytes(), other.read_bytes()
    if data[0] == data[1]:
        return None
    one.write_bytes(data[1])
    if draw.random() < 0.5:
        other.write_bytes(data[0])
    return Case(f"{one.relative_to(path)} and {other.relative_to(path)} swapped", path, False)


def a_lost_tail(path: Path, draw: random.Random, beside: Path) -> Case | None:
    """Remove the newest commits and restore the derived files of that time: only an anchor finds it."""
    records = records_of(path)
    if not records:
        return None
    kept = draw.randrange(len(records))
    anchor = anchor_at(path, records[-1].tree_size, KEY, beside / "anchor")
    rewrite(path, tables_of(path)[:kept])
    for number in range(kept, len(records)):
        commit_path(path, number).unlink()
        if draw.random() < 0.9:
            segment_path(path, number).unlink()
    is_whole = not any(segment_path(path, number).exists() for number in range(kept, len(records)))
    return (
        Case("a lost tail", path, False, None, anchor)
        if draw.random() < 0.5
        else Case("a lost tail without an anchor", path, is_whole)
    )


# --- damaged records, notes and derived files with matching hashes ---


def a_forged_record(path: Path, draw: random.Random, beside: Path) -> Case | None:
    records = unchained(path)
    if not records:
        return None
    record = draw.choice(records)
    name = draw.choice(sorted(record))
    others: list[Any] = [
        0,
        1,
        -1,
        2**53,
        1.0,
        1e300,
        True,
        None,
        "",
        "x",
        "0" * 64,
        HASH.upper(),
        HASH,
        [],
        [HASH],
        ["x"],
        {},
        "\ud7ff\U0001f916",
        record["rows"] + 1,
    ]
    value = draw.choice(
        [other for other in others if other != records[record["number"]][name] or isinstance(other, bool)]
    )
    if name == "previous_sha256" and value is None:
        return None
    record[name] = value
    if draw.random() < 0.1:
        record[draw.choice(["extra", "a", "zz"])] = 1
    try:
        chain(path, records)
    except (TypeError, KeyError):
        return None
    return Case(f"a forged {name}: {value!r}", path, False)


def a_forged_note(path: Path, draw: random.Random, beside: Path) -> Case | None:
    records = unchained(path)
    if not records:
        return None
    record = draw.choice(records)
    tree = records_of(path)[records.index(record)].tree()
    body = checkpoint_of(ORIGIN, tree)
    text, mine = note_of(tree, KEY), KEY.sign(body).line()
    notes = {
        "two signatures": text + STRANGER.sign(body).line(),
        "the same signature twice": text + mine,
        "no empty line": text.replace("\n\n", "\n"),
        "an extension line": text.replace("\n\n", "\nmore\n\n"),
        "another origin": str(Note(checkpoint_of(ORIGIN + "x", tree))),
        "another size": str(Note(checkpoint_of(ORIGIN, Frontier(tree.size + 1, tree.packed)))),
        "another root": text.replace(text.split("\n")[2], "A" * 43 + "="),
        "other base64": text.replace("=\n\n", "\n\n"),
        "a leading zero": text.replace(f"\n{tree.size}\n", f"\n0{tree.size}\n"),
        "a hyphen": text.replace("\u2014", "-"),
        "a short signature": str(Note(body, (Signature(ORIGIN, KEY.verifier.key_id, bytes(63)),))),
        "a signature of another name": str(Note(body, (Signature(ORIGIN + "x", KEY.verifier.key_id, bytes(64)),))),
        "an empty signature": str(Note(body)) + f"\u2014 {ORIGIN} AAAAAA==\n",
        "a line feed too many": text + "\n",
        "a line feed too few": text[:-1],
        "carriage returns": text.replace("\n", "\r\n"),
        "nothing": "",
    }
    name = draw.choice(sorted(notes))
    record["note"] = notes[name]
    chain(path, records)
    (path / "checkpoint").write_text(records[-1]["note"], "utf-8", newline="")
    return Case(f"a note with {name}", path, False)


def a_foreign_signature(path: Path, draw: random.Random, beside: Path) -> Case | None:
    """Add signatures of a stranger, of nobody, or broken ones of the trusted key: damage if that key is trusted, never
    without."""
    records = unchained(path)
    if not records:
        return None
    at = draw.randrange(len(records))
    tree = records_of(path)[at].tree()
    broken = Note(checkpoint_of(ORIGIN, tree), (KEY.sign(checkpoint_of(ORIGIN, Frontier())),))
    how = draw.choice(["stranger", "nobody", "broken"])
    records[at]["note"] = str(broken) if how == "broken" else note_of(tree, STRANGER if how == "stranger" else None)
    chain(path, records)
    (path / "checkpoint").write_text(records[-1]["note"], "utf-8")
    if draw.random() < 0.3:
        return Case(f"a signature of {how}, not asked for", path, True)
    is_good = False if how == "broken" or at == len(records) - 1 else "\u2014" in records[-1]["note"]
    return Case(f"a signature of {how} in commit {at}", path, is_good, KEY.verifier)


def a_wrong_anchor(path: Path, draw: random.Random, beside: Path) -> Case | None:
    records = records_of(path)
    if not records:
        return None
    tree = records[-1].tree()
    text = note_of(tree, KEY)
    texts = [
        text.replace(ORIGIN, "example.org/other"),
        note_of(tree.extend(bytes(32)), KEY),
        note_of(Frontier().extend(bytes(32)), KEY),
        f"{ORIGIN}\n0\n{text.split(chr(10))[2]}\n\n",
        text + "\n",
        "",
        "\x00",
    ]
    (beside / "anchor").write_text(draw.choice(texts), "utf-8")
    return Case(
        "a wrong anchor",
        path,
        False,
        draw.choice([None, KEY.verifier]) if "\u2014" in records[-1].note else None,
        beside / "anchor",
    )


def wrong_derived_files(path: Path, draw: random.Random, beside: Path) -> Case | None:
    records = records_of(path)
    if not records:
        return None
    tiles = files_of(path / "tile")
    file = draw.choice(tiles)
    how = draw.randrange(6)
    if how == 0:
        file.unlink()
        return Case(f"{file.relative_to(path)} gone", path, False)
    if how == 1 and len(records) > 2:
        (path / "checkpoint").write_text(records[-3].note, "utf-8")
        return Case("a checkpoint two commits behind", path, False)
    if how == 2:
        (path / "checkpoint").write_bytes(
            draw.choice([b"\xff", b"", b"x", records[-1].note.encode()[:-1], bytes(2 << 20)])
        )
        return Case("another checkpoint", path, False)
    if how == 3 and len(records) > 1:  # one behind, but an older tile is missing
        older = [
            tile
            for tile in tiles
            if str(tile.relative_to(path)) not in newest_tiles(records[-2].tree_size, records[-1].tree_size)
        ]
        (path / "checkpoint").write_text(records[-2].note, "utf-8")
        if not older:
            return None
        draw.choice(older).unlink()
        return Case("one commit behind, and an older tile gone", path, False)
    if how == 4:
        (path / "tile" / "0" / "000.p").mkdir(exist_ok=True)
        width = draw.randrange(1, WIDTH)
        if width in [record.tree_size for record in records]:
            return None
        (path / "tile" / "0" / "000.p" / f"{width}").write_bytes(
            tile_reader(path)(partial_tiles(records[0].tree_size)[0])[: 32 * width] or b"x"
        )
        return Case("a tile of a size that was never published", path, False)
    shutil.rmtree(path / "tile")
    return Case("no tiles", path, False)


DAMAGED: tuple[Make, ...] = (
    a_flipped_bit,
    a_cut_or_longer_file,
    a_file_gone_or_something_else,
    a_stray_file,
    swapped_files,
    a_lost_tail,
    a_forged_record,
    a_forged_note,
    a_foreign_signature,
    a_wrong_anchor,
    wrong_derived_files,
    a_broken_rule,
    an_altered_row,
    other_parquet,
    a_flipped_bit_whose_hash_fits,
    lying_statistics,
)
