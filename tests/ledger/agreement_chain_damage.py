"""Variants of good ledgers, and damage to them.

Each function makes one change, and tells what a verifier must find. It takes a ledger that it may change, a source of
draws, and a folder for files beside the ledger. It returns None if it does not apply. A damage to the end of the chain
or of the journal may pass for one that a crash leaves; then only agreement is asked.
"""

import random
import shutil
from pathlib import Path

from fsar_ledger.ledger.rows.schema import COLUMNS, ENVELOPE, LAYOUTS
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.paths import CHAIN, INDEX, JOURNAL, NODES, SEALING
from fsar_ledger.ledger.store.record import segment_of
from tests.ledger.agreement import KEY, STRANGER, Case, Make, files_of, note_of
from tests.ledger.agreement_chain import anchor_at, records_of, relink, rewrite, tables_of, tree_at, view_of
from tests.ledger.forgery import changed
from tests.ledger.samples import ORIGIN

HASH = "ab" * 32

# --- good ---


def as_it_is(path: Path, draw: random.Random, beside: Path) -> Case | None:
    return Case("as it is", path, True)


def with_its_key(path: Path, draw: random.Random, beside: Path) -> Case | None:
    commits = view_of(path).commits
    return Case("with the key", path, bool(commits and commits[-1].signature), KEY.verifier)


def with_an_anchor(path: Path, draw: random.Random, beside: Path) -> Case | None:
    size = draw.randint(0, view_of(path).head.size)
    anchor = anchor_at(path, size, draw.choice([KEY, STRANGER, None]), beside / "anchor")
    return Case("with an anchor of any size", path, True, None, anchor)


def a_segment_in_staging(path: Path, draw: random.Random, beside: Path) -> Case | None:
    if not (placed := view_of(path).chain.placed):
        return None
    one = draw.choice(placed)
    (path / segment_of(one)).rename(path / "staging" / f"{one.segment_sha256}.parquet")
    (path / "staging" / "half.tmp").write_bytes(b"half")
    return Case("a segment in staging", path, True)


def left_open(path: Path, draw: random.Random, beside: Path) -> Case | None:
    """Put the checkpoint back to that of any commit since which the journal holds all, and leave room behind it."""
    view = view_of(path)
    if not view.journal.frames or not view.chain.placed:
        return None
    back = draw.randint(0, len(view.journal.frames))
    (path / "checkpoint").write_text(str(view.commits[-back - 1].note(ORIGIN)), "utf-8")
    name = draw.choice([name for name in (JOURNAL, SEALING) if (path / name).exists()])
    (path / name).write_bytes((path / name).read_bytes() + bytes(draw.randrange(99)))
    return Case("left open", path, True)


def cut_short(path: Path, draw: random.Random, beside: Path) -> Case | None:
    """Take away what follows from the last append to the chain, or put anything in its place."""
    view = view_of(path)
    added = bool(view.chain.placements) and view.chain.placements[-1] == view.chain.added[-1]
    if not added or view.journal.frames:
        return None
    first, before = view.chain.added[-1].first, sum(one.index_bytes for one in view.chain.added[:-1])
    nodes = (path / NODES).read_bytes()[: _hashes(first) * 32] if (path / NODES).exists() else b""
    index = (path / INDEX).read_bytes()
    (path / NODES).write_bytes(nodes)
    (path / INDEX).write_bytes(index[:before] + draw.choice([b"", b"x" * 9, index[before:-3]]))
    notes = [str(one.note(ORIGIN)) for one in view.commits if one.tree_size >= first and one.tree_size]
    if draw.random() < 0.9 or not first:
        (path / "checkpoint").write_text(draw.choice(notes), "utf-8")
        is_behind = (path / "checkpoint").read_text("utf-8") != notes[-1]
        return Case("cut short, with a note", path, True if is_behind else None)
    (path / "checkpoint").unlink()
    return Case("cut short, without a note", path, first == 0)


def _hashes(leaves: int) -> int:
    found, blocks = 0, leaves >> 4
    while blocks:
        found, blocks = found + blocks, blocks >> 2
    return found


def a_torn_end(path: Path, draw: random.Random, beside: Path) -> Case | None:
    """Put the beginning of a line or of a frame, or rubbish, behind the chain or the journal."""
    name = draw.choice([CHAIN, JOURNAL])
    if not (path / name).exists():
        return None
    data = (path / name).read_bytes()
    torn = draw.choice(
        [data[: draw.randrange(1, 200)].rstrip(b"\n"), b"\xa5rubbish\x00" * 3, b"{", b"\0\n\0", b"x\ny\n"]
    )
    (path / name).write_bytes(data + torn)
    return Case(f"a torn end of {name}: {torn!r:.60}", path, True)


def a_sealed_journal(path: Path, draw: random.Random, beside: Path) -> Case | None:
    if not view_of(path).journal.frames or (path / SEALING).exists():
        return None
    kept = {name: (path / name).read_bytes() for name in (JOURNAL, NODES, INDEX) if (path / name).exists()}
    is_compacted = draw.random() < 0.5
    with Writer(path, ORIGIN, adopts=True) as writer:
        writer.seal()
        if is_compacted:
            writer.compact()
    for name, data in kept.items():
        if name == JOURNAL or not is_compacted:  # what follows from sealing may be missing, but not after compaction
            (path / name).write_bytes(data)
    return Case("a sealed journal", path, True)


def a_journal_handed_over_and_sealed(path: Path, draw: random.Random, beside: Path) -> Case | None:
    if not (count := view_of(path).journal.sealing):
        return None
    kept = {name: (path / name).read_bytes() for name in (SEALING, NODES, INDEX) if (path / name).exists()}
    with Writer(path, ORIGIN, adopts=True) as writer, writer._turn:
        writer._seal(count)
    for name, data in kept.items():
        if name == SEALING or draw.random() < 0.5:
            (path / name).write_bytes(data)
    return Case("a journal handed over and sealed", path, True)


def superseded_segments(path: Path, draw: random.Random, beside: Path) -> Case | None:
    for file in (path / "segments").iterdir():
        shutil.copy(file, beside)
    with Writer(path, ORIGIN, adopts=True) as writer:
        if not writer.compact():
            return None
    for file in beside.iterdir():
        shutil.copy(file, path / "segments")
    return Case("superseded segments", path, True)


def another_history(path: Path, draw: random.Random, beside: Path) -> Case | None:
    """As in `agreement_good`."""
    tables = tables_of(path)
    if not tables:
        return None
    size, number = view_of(path).head.size, draw.randrange(len(tables))
    row = draw.randrange(tables[number].num_rows)
    first = sum(table.num_rows for table in tables[:number]) + row
    kept = draw.randint(0, size)
    anchor = anchor_at(path, kept, None, beside / "anchor")
    tables[number] = changed(tables[number], "time_us", row, -123456789)
    rewrite(path, tables, draw.choice([None, STRANGER]))
    how = draw.choice(["alone", "anchor", "key"])
    if how == "anchor":
        return Case("another history, with an anchor", path, kept <= first, None, anchor)
    return Case(f"another history, {how}", path, how == "alone", KEY.verifier if how == "key" else None)


# --- damaged ---


def a_flipped_bit(path: Path, draw: random.Random, beside: Path) -> Case | None:
    file = draw.choice([file for file in files_of(path) if file.stat().st_size])
    data = bytearray(file.read_bytes())
    at = draw.randrange(len(data))
    data[at] ^= 1 << draw.randrange(8)
    file.write_bytes(data)
    return Case(f"a flipped bit in byte {at} of {file.relative_to(path)}", path, None)


def a_cut_or_longer_file(path: Path, draw: random.Random, beside: Path) -> Case | None:
    file = draw.choice([file for file in files_of(path) if file.stat().st_size])
    data = file.read_bytes()
    others = [data[: draw.randrange(len(data))], data + b"\n", data + data, b"", bytes(len(data)), b"[" * 5000]
    file.write_bytes(draw.choice(others))
    return Case(f"another length of {file.relative_to(path)}", path, None)


def a_file_gone_or_swapped(path: Path, draw: random.Random, beside: Path) -> Case | None:
    file, other = draw.choice([*files_of(path), path / "segments"]), draw.choice(files_of(path))
    how = draw.choice(["gone", "a link", "a folder", "as another", "a stray"])
    if how == "a stray":
        stray = path / draw.choice(["x", "segments/x", "segments/000000000000-000000000001.parquet", "tile", "commits"])
        if not stray.exists():
            stray.write_bytes(b"x")
    elif how == "as another" and file.is_file():
        file.write_bytes(other.read_bytes())
    else:
        shutil.move(file, beside / "aside")
        if how == "a link":
            file.symlink_to(beside / "aside")
        elif how == "a folder" and not file.exists():
            file.mkdir()
    return Case(f"{file.relative_to(path)} {how} ({other.relative_to(path)})", path, None)


def lines_out_of_order(path: Path, draw: random.Random, beside: Path) -> Case | None:
    name = draw.choice([CHAIN, JOURNAL, SEALING])
    lines = (path / name).read_bytes().splitlines(keepends=True) if (path / name).exists() else []
    if not lines:
        return None
    at, to = draw.randrange(len(lines)), draw.randrange(len(lines))
    how = draw.choice(["gone", "twice", "elsewhere", "changed"])
    line = lines[at] if how == "twice" else lines.pop(at)
    if how == "changed":
        lines.insert(at, line.replace(b'"', b"'", 1) if draw.random() < 0.5 else line.upper())
    elif how != "gone":
        lines.insert(to, line)
    (path / name).write_bytes(b"".join(lines))
    return Case(f"line {at} of {name} {how} ({to})", path, None)


def a_forged_record(path: Path, draw: random.Random, beside: Path) -> Case | None:
    """Change a member of a record, and make the hashes of all records fit."""
    records, frames = records_of(path)
    every = [*records, *(record for record, _ in frames)]
    if not every:
        return None
    record = draw.choice(every)
    name = draw.choice([*sorted(record), "continues", "goes_on", "signature", "index_bytes", "extra"])
    others: list[object] = [0, 1, -1, 2**53, 1.0, True, None, "", "x", HASH.upper(), HASH, [], [HASH], ["x"], {}]
    others += [[["run-1", 1]]]
    others += [["run-1"], [["run-1", 0]], [["run-2", 1], ["run-1", 1]], record["rows"] + 1, "0.1.0", "commit", "A" * 92]
    value = draw.choice(others)
    if (
        (name == "previous_sha256" and value is None)
        or record.get(name) == value
        or (name == "extra" and value is None)
    ):
        return None
    if draw.random() < 0.2 and name in record and name != "previous_sha256":
        del record[name]
    else:
        record[name] = value
    try:
        relink(path, records, frames)
    except (TypeError, KeyError):
        return None
    return Case(f"a forged {name} of {record.get('kind')} {record.get('number')}: {value!r}", path, None)


def a_foreign_signature(path: Path, draw: random.Random, beside: Path) -> Case | None:
    """Let a stranger, or nobody, sign everything: damage if the key is trusted, never without."""
    tables = tables_of(path)
    if not tables:
        return None
    signer = draw.choice([STRANGER, None])
    rewrite(path, tables, signer)
    is_asked = draw.random() < 0.7
    return Case(f"signed by {signer is not None}, {is_asked}", path, not is_asked, KEY.verifier if is_asked else None)


def a_wrong_anchor(path: Path, draw: random.Random, beside: Path) -> Case | None:
    if not (size := view_of(path).head.size):
        return None
    tree = tree_at(path, size)
    text = note_of(tree, KEY)
    texts = [text.replace(ORIGIN, "example.org/other"), note_of(tree.extend(bytes(32)), KEY), text + "\n", "", "\x00"]
    (beside / "anchor").write_text(draw.choice(texts), "utf-8")
    return Case("a wrong anchor", path, False, None, beside / "anchor")


def wrong_derived_files(path: Path, draw: random.Random, beside: Path) -> Case | None:
    view = view_of(path)
    if not view.commits:
        return None
    name = draw.choice([NODES, INDEX, "checkpoint"])
    data = (path / name).read_bytes() if (path / name).exists() else b""
    older = str(draw.choice(view.commits).note(ORIGIN)).encode()
    (path / name).write_bytes(draw.choice([data[32:], data[:-1], data + bytes(32), b"", older, b"\xff"]))
    return Case(f"another {name}", path, None)


def a_broken_rule(path: Path, draw: random.Random, beside: Path) -> Case | None:
    """Store a row that breaks a rule, with all hashes matching."""
    tables = tables_of(path)
    if not tables:
        return None
    number = draw.randrange(len(tables))
    table = tables[number]
    row = draw.randrange(table.num_rows)
    layout = LAYOUTS[table.column("type")[row].as_py()]
    own = {field.name for field in layout.fields}
    foreign = draw.choice([name for name in COLUMNS if name not in own and name not in {one.name for one in ENVELOPE}])
    kinds: dict[str, object] = {"string": "x", "integer": 1, "boolean": True, "strings": ["x"]}
    seq = table.column("seq")[row].as_py()
    rules: list[tuple[str, object]] = [
        ("seq", draw.choice([-1, seq + 1, seq - 1, 0, 2**60])),
        ("caused_by", draw.choice([10**6, -1, 2**60, seq])),
        ("type", draw.choice(["RobotFlew.v1", "", layout.tag.replace(".v1", ".v2")])),
        ("time_us", draw.choice([2**53, -(2**53), 2**63 - 1])),
        ("run_id", draw.choice(["other", "run-1", "run-2"])),
        (foreign, kinds[COLUMNS[foreign]]),
    ]
    rules += [(field.name, None) for field in layout.fields if not field.is_nullable]
    rules += [(field.name, "x") for field in layout.fields if field.values is not None]
    column, value = draw.choice(rules)
    if table.column(column)[row].as_py() == value:
        return None
    tables[number] = changed(table, column, row, value)
    try:
        rewrite(path, tables, draw.choice([None, KEY]))
    except (IndexError, KeyError, TypeError, ValueError, OverflowError):  # the index cannot be made of such rows
        return None
    is_name = column == "run_id"  # a run of one event may well have another name
    return Case(f"{value!r} in {column}, segment {number}, row {row}", path, None if is_name else False)


def a_run_again(path: Path, draw: random.Random, beside: Path) -> Case | None:
    """Say that a run that has ended begins again: rename the runs of one commit."""
    tables = tables_of(path)
    names = [set(table.column("run_id").to_pylist()) for table in tables]
    if len(tables) < 2 or names[0] & names[-1]:
        return None
    old, new = draw.choice(sorted(names[-1])), draw.choice(sorted(names[0]))
    values = [new if name == old else name for name in tables[-1].column("run_id").to_pylist()]
    table = tables[-1]
    for row, name in enumerate(values):
        table = changed(table, "run_id", row, name) if name != tables[-1].column("run_id")[row].as_py() else table
    tables[-1] = table
    rewrite(path, tables)
    return Case(f"{old} as {new}", path, False)


GOOD: tuple[Make, ...] = (
    *(as_it_is, with_its_key, with_an_anchor, a_segment_in_staging, left_open, cut_short, a_torn_end),
    *(a_sealed_journal, a_journal_handed_over_and_sealed, superseded_segments, another_history),
)
DAMAGED: tuple[Make, ...] = (
    *(a_flipped_bit, a_cut_or_longer_file, a_file_gone_or_swapped, lines_out_of_order),
    *(a_forged_record, a_forged_record, a_foreign_signature, a_wrong_anchor),
    *(wrong_derived_files, a_broken_rule, a_broken_rule, a_run_again),
)
