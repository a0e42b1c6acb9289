"""The walk of `store/walk.py` with the rows: each segment is read and decoded, and gives the tree and the runs.

`verify` folds all of it; `recover` folds it up to the first finding.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import msgspec

from fsar_ledger.ledger.log import merkle
from fsar_ledger.ledger.log.hashing import HASH_BYTES
from fsar_ledger.ledger.log.merkle import Frontier
from fsar_ledger.ledger.log.tiles import Edge, Tile
from fsar_ledger.ledger.store.paths import commit_file
from fsar_ledger.ledger.store.problem import Problem
from fsar_ledger.ledger.store.record import CommitRecord
from fsar_ledger.ledger.store.walk import Commit
from fsar_ledger.ledger.verify.segment import SecondReader, SegmentFacts, examine_all


class Standing(msgspec.Struct, frozen=True):
    """What is at one commit, with its rows.

    `problems` are all of this commit: of its record, its segment, its rows, and what they add to the ledger. `edge` is
    that of the tree before its rows, None if unknown, and `made` are the tiles that they make.
    """

    commit: Commit
    facts: SegmentFacts
    problems: tuple[Problem, ...]
    edge: Edge | None
    made: dict[Tile, bytes]


class RowWalk:
    """One walk over the rows of a ledger.

    Args:
        ledger: Its folder.
        sizes: The sizes, in events, of the trees whose roots are wanted.
        is_quick: Read no rows, only hash the files.
    """

    def __init__(self, ledger: Path, sizes: set[int], *, is_quick: bool = False) -> None:
        self.ledger, self.sizes, self.is_quick = ledger, sizes, is_quick
        self.runs: set[str] = set()
        self.alone: set[str] = set()  # of these, single events that stand alone
        self.tree: Frontier | None = Frontier()  # by its rows or, if in doubt, by its record; None: unknown
        self.roots = {0: merkle.EMPTY_ROOT}  # of the wanted trees, by size
        self._edge: Edge | None = None if is_quick else Edge()  # None: unknown, because some rows were not read

    def over(
        self, commits: Sequence[Commit], workers: int = 1, second_reader: SecondReader | None = None
    ) -> Iterator[Standing]:
        """Yield what is at each of these commits, the first ones of the ledger.

        No rows are read of commits without a record.
        """
        segments = [(number, commit.record, None) for number, commit in enumerate(commits)]
        facts = examine_all(self.ledger, segments, workers, second_reader, is_quick=self.is_quick)
        for commit, found in zip(commits, facts, strict=True):
            yield self._stand(commit, found)

    def _stand(self, commit: Commit, facts: SegmentFacts) -> Standing:
        if commit.record is None:
            self.tree = self._edge = None
            return Standing(commit, facts, commit.problems, None, {})
        problems = [*commit.problems, *facts.problems]
        edge = self._edge
        made = self._grow(commit, commit.record, facts, problems)
        problems += self._check_runs(commit.number, commit.record, facts)
        return Standing(commit, facts, tuple(problems), edge, made)

    def _grow(
        self, commit: Commit, record: CommitRecord, facts: SegmentFacts, problems: list[Problem]
    ) -> dict[Tile, bytes]:
        """Add the leaves of a commit to the tree: those of its rows if they were read and agree, else as claimed.

        So each error is reported once.
        """
        claimed = self.tree = record.tree()
        made: dict[Tile, bytes] = {}
        if facts.leaves is None or commit.before is None:
            self._edge = None
            return made
        if self._edge is not None:  # of the tree before this commit
            self._look_back(self._edge, facts.leaves)
            self._edge, made = self._edge.extend(facts.leaves)
            tree = self._edge.frontier()
        else:
            tree = commit.before.extend(facts.leaves)
        if tree == claimed:
            return made
        self._edge = None
        if tree.size == claimed.size:  # another size contradicts the record, and is reported there
            found, expected = f"Merkle root {tree.root().hex()}", f"{record.tree_root} as committed: a row was altered"
            problems.append(Problem(facts.file, found, expected, commit=commit.number, field="tree_root"))
        return made

    def _look_back(self, edge: Edge, leaves: bytes) -> None:
        """Note the root of each wanted tree that ends within these leaves, or before them."""
        for size in self.sizes:
            wanted = size - edge.size
            if 0 <= wanted * HASH_BYTES <= len(leaves):
                self.roots[size] = edge.extend(leaves[: wanted * HASH_BYTES])[0].frontier().root()

    def _check_runs(self, number: int, record: CommitRecord, facts: SegmentFacts) -> Iterator[Problem]:
        """Yield a problem where the runs are not those of the record, or are in an earlier commit too."""
        if facts.runs is None:
            return
        for name, found, expected in (
            ("first_run", record.first_run, facts.runs[0]),
            ("last_run", record.last_run, facts.runs[-1]),
        ):
            if found != expected:
                yield Problem(commit_file(number), repr(found), repr(expected), commit=number, field=name)
        again = next((run for run in facts.runs if run in self.runs), None)
        if again is not None:
            found, expected = f"run {again} once more", "each run in one commit"
            yield Problem(facts.file, found, expected, commit=number, run=again, seq=0, field="run_id")
        self.runs.update(facts.runs)
        self.alone |= facts.alone
