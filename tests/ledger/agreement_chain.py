"""Ledgers for both verifiers: random histories, and what a forger who knows the format can do to one."""

import base64
import json
import random
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import pyarrow as pa

from fsar_ledger.ledger.log import pack
from fsar_ledger.ledger.log.hashing import leaves_of, sha256_hex
from fsar_ledger.ledger.log.merkle import Frontier
from fsar_ledger.ledger.log.note import Signer, checkpoint_of
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows import canonical, segment
from fsar_ledger.ledger.rows.runs import LedgerRun
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.derived import line_of
from fsar_ledger.ledger.store.paths import CHAIN, INDEX, JOURNAL, NODES, SEALING
from fsar_ledger.ledger.store.read import View
from fsar_ledger.ledger.store.record import Commit, Placement
from tests.ledger.agreement import KEY, note_of, odd_run
from tests.ledger.hostile import stage_anything
from tests.ledger.samples import ORIGIN, made_up_run

Record = dict[str, Any]
Frame = tuple[Record, list[bytes]]


def hand_over(writer: Writer) -> None:
    """Hand over the journal, though it is not full."""
    with writer._turn:
        writer._hand_over()


class History:
    """A random history: sessions of appends, commits to the journal, seals and compactions, of runs in parts."""

    def __init__(self, path: Path, draw: random.Random, signers: Sequence[Signer | None]) -> None:
        self.path, self._draw, self._signers = path, draw, signers
        self._begun: list[LedgerRun] = []  # what is left of each run that goes on
        self._runs = 0

    def go_on(self, sessions: int) -> None:
        """Open the ledger so often, take a few steps each time, and close it."""
        for _ in range(sessions):
            with Writer(self.path, ORIGIN, self._draw.choice(self._signers), adopts=True) as writer:
                for _ in range(self._draw.randrange(1, 6)):
                    self._step(writer)

    def leave_off(self, *, is_chained: bool) -> None:
        """Leave the ledger as a writer does that is killed while a journal is sealed, or the one before it was."""
        other = self.path.with_name(f"{self.path.name}-open")
        self.path.rename(other)
        with Writer(other, ORIGIN, self._signers[0], adopts=True) as writer:
            writer.add(self._parts())
            hand_over(writer)
            writer.add(self._parts())
            if is_chained:
                writer.settle()
                writer.add(self._parts())
                hand_over(writer)
                writer.add(self._parts())
            shutil.copytree(other, self.path)

    def _step(self, writer: Writer) -> None:
        how = self._draw.choices(("append", "odd", "add", "seal", "compact"), (3, 1, 6, 1, 1))[0]
        if how == "append":
            writer.append(stage_anything(self.path, self._parts()))
        elif how == "odd":
            self._runs += 1
            odd = odd_run(f"\u2028{self._runs}\x00\U0001f916", self._draw.randrange(1, 9), self._draw)
            writer.append(stage_anything(self.path, [odd]))
        elif how == "add":
            writer.add(self._parts())
        elif how == "seal":
            writer.seal()
        else:
            writer.compact()

    def _parts(self) -> list[LedgerRun]:
        """Return the next part of one or two runs."""
        found = []
        for run in [self._run() for _ in range(self._draw.randrange(1, 3))]:
            size, whole = self._draw.randrange(1, len(run.events) + 1), len(run.events)
            found.append(msgspec.structs.replace(part_of(run, 0, size), goes_on=size < whole))
            if size < whole:
                self._begun.append(part_of(run, size, whole))
        return found

    def _run(self) -> LedgerRun:
        """Return a new run, or what is left of one that goes on."""
        if self._begun and self._draw.random() < 0.6:
            return self._begun.pop(self._draw.randrange(len(self._begun)))
        self._runs += 1
        return made_up_run(f"run-{self._runs}", self._draw.choice((1, 2, 9, 16, 40)), self._draw.randrange(10**6))


def part_of(run: LedgerRun, first: int, end: int) -> LedgerRun:
    """Return these events of what is left of a run."""
    parts = run.times_us[first:end], run.caused_by[first:end], run.events[first:end]
    return LedgerRun(run.run_id, *parts, run.first + first)


def view_of(path: Path) -> View:
    view = open_ledger(path)
    assert isinstance(view, View)
    return view


def records_of(path: Path) -> tuple[list[Record], list[Frame]]:
    """Return the lines of the chain and the frames of the journal, as `relink` takes them."""
    view = view_of(path)
    lines = (path / CHAIN).read_bytes()[: view.followed.end].splitlines() if view.chain.placements else []
    records = [_unlinked(line) for line in lines]
    journal = view.journal
    known = [record for record in records if record["kind"] == "commit"][len(view.commits) - len(journal.frames) :]
    new = [_unlinked(frame.line) for frame in journal.frames[journal.chained :]]
    rows = [frame.rows.split(b"\n")[:-1] for frame in journal.frames]
    return records, list(zip([*known, *new], rows, strict=True))


def _unlinked(line: bytes) -> Record:
    return dict(json.loads(line)) | {"previous_sha256": None}


def relink(path: Path, records: Sequence[Record], frames: Sequence[Frame]) -> None:
    """Write these records, each with the hash of the one before it unless it names one itself.

    A frame whose record is one of the chain's has the same line; as many as before are in the file being sealed.
    """
    sealing = view_of(path).journal.sealing
    previous = sha256_hex((path / "ledger.json").read_bytes())
    chained = set(map(id, records))
    lines: dict[int, bytes] = {}
    for record in (*records, *(record for record, _ in frames if id(record) not in chained)):
        line = canonical.document(record | {"previous_sha256": record["previous_sha256"] or previous})
        lines[id(record)], previous = line, sha256_hex(line)
    if records:
        (path / CHAIN).write_bytes(b"".join(lines[id(record)] + b"\n" for record in records))
    held = [b"\n".join([lines[id(record)], *rows, b""]) for record, rows in frames]
    for name, own in ((SEALING, held[:sealing]), (JOURNAL, held[sealing:])):
        if own or (path / name).exists():
            (path / name).write_bytes(b"".join(own))


def tables_of(path: Path) -> list[pa.Table]:
    """Return the rows of each segment, and of the journal if it holds any."""
    return list(view_of(path).tables())


def rewrite(path: Path, tables: Sequence[pa.Table], signer: Signer | None = None) -> None:
    """Write the ledger again, from other rows of the same number, so that everything but the rows' sense fits."""
    view = view_of(path)
    for file in (path / "segments").iterdir():
        file.unlink()
    tree, nodes, index, records = Frontier(), b"", b"", list[Record]()
    frames: list[Frame] = []
    commits = iter(view.commits)
    for number, table in enumerate(tables):
        rows, first, at = canonical.from_table(table), tree.size, 0
        own: list[Record] = []
        while at < len(rows):
            commit = next(commits)
            tree, more = pack.grow(tree, leaves_of(rows[at : at + commit.rows]))
            own.append(_commit(commit, tree, signer))
            if number == len(view.chain.placed):
                frames.append((own[-1], rows[at : at + commit.rows]))
            else:
                nodes += more
            at += commit.rows
        if number < len(view.chain.placed):
            line = line_of(first, table)
            data = bytes(segment.to_parquet(table))
            records += [*own, _placement(view.chain.placed[number], number, data, tree, line)]
            (path / "segments" / f"{first:012d}-{tree.size:012d}.parquet").write_bytes(data)
            index += line
    relink(path, records, frames)
    for name, data in ((NODES, nodes), (INDEX, index)):
        if data or (path / name).exists():
            (path / name).write_bytes(data)
    if view.commits:
        (path / "checkpoint").write_text(note_of(tree, signer), "utf-8")


def _commit(commit: Commit, tree: Frontier, signer: Signer | None) -> Record:
    """Return the record of the same commit, of another tree."""
    signed = signer.sign(checkpoint_of(ORIGIN, tree)) if signer else None

    signature = base64.b64encode(signed.key_id + signed.data).decode() if signed else ""
    made = msgspec.structs.replace(commit, tree_root=tree.root().hex(), tree_size=tree.size, signature=signature)
    return _unlinked(canonical.document(made))


def _placement(old: Placement, number: int, data: bytes, tree: Frontier, line: bytes) -> Record:
    made = msgspec.structs.replace(
        old,
        number=number,
        segment_sha256=sha256_hex(data),
        segment_bytes=len(data),
        frontier=tuple(subtree.hex() for subtree in tree.subtrees),
        index_bytes=len(line),
        index_sha256=sha256_hex(line),
    )
    return _unlinked(canonical.document(made))


def tree_at(path: Path, size: int) -> Frontier:
    """Return the tree of the first so many events."""
    return Frontier().extend(leaves_of(view_of(path).rows(0, size)))


def anchor_at(path: Path, size: int, signer: Signer | None, to: Path) -> Path:
    """Write a checkpoint over the first this many events, as somebody may have kept it."""
    to.write_text(note_of(tree_at(path, size), signer), "utf-8")
    return to


def bases(folder: Path, count: int = 12) -> list[Path]:
    """Write ledgers of so many histories: of no commit, of few and of many, signed, half signed, and not."""
    found = [folder / "base-empty"]
    folder.mkdir(exist_ok=True)
    Writer(found[0], ORIGIN).close()
    for seed in range(count):
        found.append(folder / f"base-{seed}")
        signers: Sequence[Signer | None] = ([None], [KEY], [KEY, None])[seed % 3]
        history = History(found[-1], random.Random(seed), signers)
        history.go_on(1 + seed // 2)
        if seed % 3 == 1:
            history.leave_off(is_chained=seed % 2 == 1)
    return found
