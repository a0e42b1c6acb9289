"""Re-derive from the rows of a ledger all that its records claim: a part of `verify`."""

import os
import re
import stat
from collections.abc import Iterator, Sequence
from pathlib import Path

from fsar_ledger.base.errors import LedgerCorrupted
from fsar_ledger.base.progress import Progress
from fsar_ledger.ledger.log import merkle, pack
from fsar_ledger.ledger.log.hashing import HASH_BYTES
from fsar_ledger.ledger.log.merkle import Frontier
from fsar_ledger.ledger.log.note import VerifierKey
from fsar_ledger.ledger.rows.blocks import Block, Runs, blocks_of
from fsar_ledger.ledger.rows.check import first_flaw
from fsar_ledger.ledger.store import growing
from fsar_ledger.ledger.store.derived import derived_sizes, index_line, line_doubt
from fsar_ledger.ledger.store.journal import Frame
from fsar_ledger.ledger.store.links import Chain
from fsar_ledger.ledger.store.paths import (
    CHAIN,
    CHECKPOINT,
    INDEX,
    JOURNAL,
    MANIFEST,
    NODES,
    SEALING,
    SEGMENTS,
    STAGING,
)
from fsar_ledger.ledger.store.problem import Problem, refusal
from fsar_ledger.ledger.store.read import View, open_chain
from fsar_ledger.ledger.store.record import Commit, Placement, segment_of
from fsar_ledger.ledger.store.segments import MISSING, Names, check_manifest, names_in
from fsar_ledger.ledger.store.snapshot import behind, covered
from fsar_ledger.ledger.store.staging import table_of
from fsar_ledger.ledger.verify.report import (
    MAX_PROBLEMS,
    NOT_LOOKED_AT,
    Anchor,
    ByHashes,
    Signatures,
    VerifyOptions,
    VerifyReport,
    check_anchor,
    check_signatures,
    not_compared,
    root_by_hashes,
)
from fsar_ledger.ledger.verify.segment import SegmentFacts, examine_all

FOLDERS = frozenset({SEGMENTS, STAGING})
FILES = frozenset({MANIFEST, CHAIN, JOURNAL, SEALING, NODES, INDEX, CHECKPOINT})
BEHIND = (
    "the pack, the index and the checkpoint are behind the chain, as after a crash; the next writer, or fsar-ledger "
    "maintain recover, continues from there"
)
OPEN = "the checkpoint is behind the journal, as after a writer that was not closed"
SEALED = (
    "the journal is still there although it was sealed, and later steps may be missing, as after a crash; the next "
    "writer, or fsar-ledger maintain recover, continues from there"
)
HIDDEN = (
    "the newest commit is whole, but its writer was interrupted before making it visible; it counts, and the next "
    "writer makes it visible"
)
TORN = "an append was interrupted, and what is left of it is not a commit; the next writer removes it"
SUPERSEDED = "segments that were compacted are still there, as after a crash; the next writer removes them"
SEGMENT_NAME = re.compile(rf"{SEGMENTS}/[0-9]{{12,}}-[0-9]{{12,}}\.parquet")
_SYMBOLIC = "a link or not a regular file"


class Verification:
    """A single verification of a ledger, segment by segment."""

    def __init__(self, path: Path, asked: VerifyOptions) -> None:
        self.path, self.asked = path, asked
        self.names: list[Problem] = []  # unknown files, and links
        self.problems: list[Problem] = []
        self.told = self.events = self.done = 0  # `told`: problems of the records, which frames before them do not have
        self.checkpoint: Problem | None = None  # only if the records themselves are whole
        self.derived: list[Problem] = []  # the first one of the pack, and of the index
        self.index: list[bytes] = []  # its lines; each empty if it differs from its placement
        self.trusted = (0, 0)  # placements, and commits, before the first doubt about one
        self.runs = Runs()
        self.tree: Frontier | None = Frontier()  # from the rows; None: unknown, because some were not read
        self.roots: dict[int, bytes] = {0: merkle.EMPTY_ROOT}  # from the rows, at the end of each commit and anchor

    def run(self, workers: int, progress: Progress | None, document: bytes | None = None) -> VerifyReport:
        """Verify the whole ledger; with `document`, use these bytes in place of ledger.json."""
        self.names = list(_check_names(self.path))
        if document is None:
            _, document, doubt = check_manifest(self.path)
            if document is None or doubt is not None:
                self.problems = self.names + ([doubt] if doubt is not None else [])
                return VerifyReport(False, tuple(self.problems[:MAX_PROBLEMS]), 0, 0, 0, None)
        view = open_chain(self.path, document, is_damage_told=False)
        chain = view.chain
        self.problems += [problem for problem in (view.followed.problem, view.journal.problem) if problem is not None]
        self.told = len(self.problems)
        segments = [(placement.number, placement, Names(segment_of(placement), CHAIN)) for placement in chain.placed]
        facts = examine_all(self.path, segments, workers, self.asked.second_reader, is_quick=self.asked.is_quick)
        self.index = list(chain.index_lines(self._index_bytes(chain)))
        is_behind = self._is_behind(view) or bool(view.journal.sealed)
        for number, segment_facts in enumerate(facts):
            self._add(view, number, segment_facts, is_behind=is_behind)
            if progress is not None:
                progress(number + 1, len(chain.placed))
        if self.asked.is_quick:
            self.tree = chain.tree()
        for number, frame in enumerate(view.journal.frames):
            self._add_frame(frame, SEALING if number < view.journal.sealing else JOURNAL)
        strays = [
            Problem(name, "a file of no placement", f"segments that the chain names; {_of_stray(name)}")
            for name in unplaced(view)
        ]
        checkpoint = [self.checkpoint] if self.checkpoint is not None else []
        # An unknown name, and a checkpoint ahead of the records, say more than the problems that they cause.
        self.problems = [*self.names, *checkpoint, *self.problems, *strays, *dict.fromkeys(self.derived)]
        remarks = self._check_derived(view, is_behind=is_behind)
        return self._report(view, remarks)

    def _is_behind(self, view: View) -> bool:
        """Return whether the checkpoint is from before the last append to the chain."""
        lag = covered(view)
        if isinstance(lag, Problem):
            self.checkpoint = None if self.problems else lag
            return False
        size = view.commits[-lag - 1].tree_size if lag < len(view.commits) else 0
        return lag > 0 and size < view.chain.placed_size

    def _add(self, view: View, number: int, facts: SegmentFacts, *, is_behind: bool) -> None:
        """Add one segment: its rows to the tree, its blocks to the runs."""
        placement = view.chain.placed[number]
        self.problems += facts.problems
        if self.asked.is_quick:
            self.events += facts.rows if not facts.problems else 0
            return
        if facts.leaves is None or self.tree is None or len(facts.leaves) != placement.rows * HASH_BYTES:
            self.tree = None
            return
        commits = view.commits.within(placement.first, placement.end)
        problem_count = len(self.problems)
        nodes = self._grow(facts, facts.leaves, placement, commits)
        if len(self.problems) == problem_count and not facts.problems:
            is_needed = not (is_behind and placement.first >= view.chain.settled)
            self._compare_nodes(placement.first, nodes, is_needed=is_needed)
            self._follow(facts.file, facts.blocks, commits, placement.first)
        if len(self.problems) == problem_count and not facts.problems:
            self._compare_index(view, number, facts.blocks, is_needed=is_needed)
        if len(self.problems) == problem_count:
            self.events += placement.rows
            self.done += len(commits)
            if self.done == commits[-1].number + 1:
                self.trusted = (self.trusted[0] + 1, self.done)

    def _grow(self, facts: SegmentFacts, leaves: bytes, placement: Placement, commits: Sequence[Commit]) -> bytes:
        """Add the leaves of a segment to the tree, compare the roots, and return the hashes added to the pack."""
        assert self.tree is not None
        by_size = {commit.tree_size: commit for commit in commits}
        anchor_sizes = {size for size in self.asked.sizes() if placement.first < size < placement.end}
        sizes = sorted(anchor_sizes.union(by_size) - {placement.end})
        for size, root in zip(sizes, self.tree.roots(leaves, sizes), strict=True):
            self._compare_root(size, root, by_size.get(size), facts.file)
        self.tree, nodes = pack.grow(self.tree, leaves)
        self._compare_root(placement.end, self.tree.root(), by_size.get(placement.end), facts.file)
        return nodes

    def _compare_root(self, size: int, root: bytes, commit: Commit | None, file: str) -> None:
        self.roots[size] = root
        if commit is not None and root.hex() != commit.tree_root:
            expected = f"{commit.tree_root} as committed: a row was altered"
            self.problems.append(
                Problem(file, f"Merkle root {root.hex()}", expected, commit=commit.number, field="tree_root")
            )

    def _follow(self, file: str, blocks: Sequence[Block], commits: Sequence[Commit], first: int) -> None:
        """Compare the blocks with earlier ones, and with the runs that each commit claims to continue."""
        offset, index = first, 0
        continued: dict[int, list[tuple[str, int]]] = {}
        seen: set[tuple[int, str]] = set()
        for block in blocks:
            if (flaw := self.runs.flaw(block)) is not None:
                self.problems.append(
                    Problem(file, flaw.found, flaw.expected, commits[index].number, flaw.run, flaw.seq, flaw.field)
                )
                return
            self.runs.add(block)
            seq, end = block.first, offset + block.rows
            while offset < end:
                commit = commits[index]
                if (commit.number, block.run) in seen:
                    self.problems.append(
                        Problem(
                            file, "a second block of rows", "each run in one", commit.number, block.run, seq, "run_id"
                        )
                    )
                    return
                seen.add((commit.number, block.run))
                if seq:
                    continued.setdefault(commit.number, []).append((block.run, seq))
                step = min(end, commit.tree_size) - offset
                offset, seq = offset + step, seq + step
                index += offset == commit.tree_size
        source = file if file in (JOURNAL, SEALING) else CHAIN
        for commit in commits:
            continues = tuple(sorted(continued.get(commit.number, ())))
            if continues != commit.continues:
                self.problems.append(
                    Problem(source, f"{commit.continues!r}", f"{continues!r}", commit.number, field="continues")
                )
                return
            if absent := [run for run in commit.goes_on if (commit.number, run) not in seen]:
                expected = "runs of which the commit holds events"
                self.problems.append(Problem(source, f"{absent[0]!r}", expected, commit.number, field="goes_on"))
                return

    def _add_frame(self, frame: Frame, file: str) -> None:
        """Add one commit of the journal, from this file."""
        commit = frame.commit
        if self.tree is not None:
            first = self.tree.size
            for size in self.asked.sizes():
                if first < size < commit.tree_size:
                    self.roots[size] = self.tree.extend(frame.leaves[: (size - first) * HASH_BYTES]).root()
            self.tree = self.tree.extend(frame.leaves)
            self._compare_root(self.tree.size, self.tree.root(), commit, file)
        if self.asked.is_quick or len(self.problems) > self.told:
            return
        try:
            table = table_of(Path(file), frame.rows)
        except LedgerCorrupted as error:
            reason = refusal(file, error)[1:-1].removeprefix("found ")
            self.problems.append(Problem(file, reason, "rows as they are written", commit=commit.number))
            return
        flaw = first_flaw(table, is_whole=False)
        if flaw is not None:
            self.problems.append(
                Problem(file, flaw.found, flaw.expected, commit.number, flaw.run, flaw.seq, flaw.field)
            )
            return
        self._follow(file, list(blocks_of(table)), [commit], commit.tree_size - commit.rows)
        if len(self.problems) == self.told:
            self.events, self.done = self.events + commit.rows, self.done + 1
            if self.done == commit.number + 1:
                self.trusted = (self.trusted[0], self.done)

    def _index_bytes(self, chain: Chain) -> bytes:
        if self.asked.is_quick:
            return b""
        try:
            return growing.read_at(self.path / INDEX, 0, derived_sizes(chain)[INDEX])
        except OSError as error:
            self.derived.append(Problem(INDEX, f"an unreadable file ({error.strerror})", "the index"))
            return b""

    def _compare_nodes(self, first: int, nodes: bytes, *, is_needed: bool) -> None:
        """Compare these hashes with those in the pack from event `first` on."""
        start = pack.count(first) * HASH_BYTES
        try:
            actual = growing.read_at(self.path / NODES, start, len(nodes))
        except OSError as error:
            self.derived.append(Problem(NODES, f"an unreadable file ({error.strerror})", "the pack of the tree"))
            return
        if actual == nodes or not is_needed or any(problem.where == NODES for problem in self.derived):
            return
        mismatch = next(
            offset
            for offset in range(0, len(nodes), HASH_BYTES)
            if actual[offset : offset + HASH_BYTES] != nodes[offset : offset + HASH_BYTES]
        )
        actual_hash, expected = (data[mismatch : mismatch + HASH_BYTES].hex() or "nothing" for data in (actual, nodes))
        self.derived.append(Problem(NODES, actual_hash, expected, field=f"hash {(start + mismatch) // HASH_BYTES}"))

    def _compare_index(self, view: View, number: int, blocks: Sequence[Block], *, is_needed: bool) -> None:
        """Compare this segment's lines of the index with their placements, and with the file."""
        chain = view.chain
        placement, indexes = chain.placed[number], chain.added_in(number)
        is_whole = [chain.added[index] for index in indexes] == [placement]
        lines = [index_line(placement.first, blocks)] if is_whole else view.index_lines(number)
        for index, line in zip(indexes, lines, strict=True):
            if (problem := line_doubt(chain.added[index], line)) is not None:
                self.problems.append(problem)
                return
            if not self.index[index] and is_needed and not any(problem.where == INDEX for problem in self.derived):
                actual, expected = "another line, or none", f"{line!r:.200}"
                self.derived.append(Problem(INDEX, actual, expected, field=f"line {index + 1}"))

    def _check_derived(self, view: View, *, is_behind: bool) -> tuple[str, ...]:
        """Compare the sizes of the derived files; return the remarks on leftovers of a crash."""
        if self.problems:
            return ()
        for name, expected in derived_sizes(view.chain).items():
            size = growing.size_of(self.path / name)
            if size > expected or (size < expected and not is_behind):
                self.problems.append(Problem(name, f"{size} bytes", f"{expected}, for {view.chain.placed_size} events"))
                return ()
        lag = behind(view)
        placed = {segment_of(placement) for placement in view.chain.placed}
        has_superseded = any(f"{SEGMENTS}/{name}" not in placed for name in names_in(self.path / SEGMENTS))
        return (
            *((SEALED,) if view.journal.sealed else (BEHIND,) if is_behind else (OPEN,) if lag else ()),
            *((HIDDEN,) if view.followed.is_hidden or view.journal.hidden else ()),
            *((TORN,) if view.followed.torn or view.journal.torn else ()),
            *((SUPERSEDED,) if has_superseded else ()),
        )

    def check_signatures(self, view: View) -> tuple[list[Problem], Signatures]:
        """Return the problems with the signatures of the commits, and a summary of the signatures."""
        chained = len(view.commits) - len(view.journal.frames) + view.journal.chained
        judged = self._to_judge(view.commits)
        return check_signatures(
            [commit.note(view.manifest.origin) for commit in judged],
            lambda at: CHAIN if judged[at].number < chained else JOURNAL,
            self.asked.trusted,
        )

    def _report(self, view: View, remarks: tuple[str, ...]) -> VerifyReport:
        signed = Signatures("signer not checked")
        if not self.problems:
            doubts, signed = self.check_signatures(view)
            self.problems += doubts
        anchored = self._check_anchors(view)
        ok = not self.problems
        quick = self.asked.is_quick
        if ok and quick:
            remarks += (not_compared(anchored),)
        return VerifyReport(
            ok,
            tuple(self.problems[:MAX_PROBLEMS]),
            len(view.commits) if quick and ok else self.done,
            view.head.size if quick and ok else self.events,
            sum(not state.is_alone for state in self.runs.known.values()),
            view.head.root if ok else None,
            signature=signed.state,
            signer=signed.signer,
            signed=signed.commits,
            is_quick=quick,
            anchored=anchored if ok else None,
            remarks=remarks,
            record_sha256=view.record_sha256 if ok else None,
            not_looked_at=NOT_LOOKED_AT if quick else (),
        )

    def _to_judge(self, commits: Sequence[Commit]) -> list[Commit]:
        """Return the commits whose notes matter: without a key, those that are signed, and the newest."""
        if self.asked.trusted is not None:
            return list(commits)
        return [*(commit for commit in commits[:-1] if commit.signature), *commits[-1:]]

    def _check_anchors(self, view: View) -> int | None:
        """Check the anchors; return the number of events for which the user's anchor vouches."""
        for witnessed in self.asked.witnessed:
            self._check_anchor(view, witnessed, None)
        if (anchor := self.asked.anchor) is None:
            return None
        self._check_anchor(view, anchor, self.asked.trusted)
        return anchor.note.checkpoint.size if anchor.note is not None else None

    def _check_anchor(self, view: View, anchor: Anchor, trusted: VerifierKey | None) -> None:
        origin, size, by_hashes = view.manifest.origin, view.head.size, self._look_then(view, anchor)
        self.problems += check_anchor(anchor, origin, size, by_hashes.root, trusted, by_hashes.missing)

    def _look_then(self, view: View, anchor: Anchor) -> ByHashes:
        """Return the root of the ledger at the size of the anchor, if it is known."""
        checkpoint = anchor.note.checkpoint if anchor.note is not None else None
        if checkpoint is None or checkpoint.size > view.head.size:
            return ByHashes()
        if checkpoint.size in self.roots or not self.asked.is_quick:
            return ByHashes(self.roots.get(checkpoint.size))
        return root_by_hashes(view.path, view.node, checkpoint, view.head.size, bytes.fromhex(view.head.root))


def _check_names(path: Path) -> Iterator[Problem]:
    """Yield a problem for each name in the ledger's folder that is unknown, missing or a link."""
    for name in names_in(path):
        if name not in FOLDERS | FILES:
            yield Problem(name, "an unknown file", f"only {', '.join(sorted(FOLDERS | FILES))}; remove it")
            continue
        mode = os.lstat(path / name).st_mode
        if name in FOLDERS and not stat.S_ISDIR(mode):
            yield Problem(name, "a link or not a folder", "a folder of the ledger")
        elif name in FILES and not stat.S_ISREG(mode):
            yield Problem(name, _SYMBOLIC, "a file of the ledger")
    if not os.path.lexists(path / SEGMENTS):
        yield Problem(SEGMENTS, MISSING, "a folder of the ledger")


def _of_stray(name: str) -> str:
    if SEGMENT_NAME.fullmatch(name) is None:
        return "remove it"
    return "keep it: either newer commits were removed, or the ledger was copied while it was being written"


def unplaced(view: View) -> list[str]:
    """Return the files in the segments folder that no placement names."""
    listed = {segment_of(placement) for placement in view.chain.placements}
    return [name for file in names_in(view.path / SEGMENTS) if (name := f"{SEGMENTS}/{file}") not in listed]
