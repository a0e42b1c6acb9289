"""Simulate batches of runs and stage them, in this process or in worker processes."""

from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from itertools import groupby
from pathlib import Path
from typing import TypeAlias

import msgspec

from fsar_ledger.base.errors import CommitTooLarge
from fsar_ledger.base.memory import without_collection
from fsar_ledger.base.workers import WorkerPool
from fsar_ledger.designs.constants import Constants
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.rows.runs import joined, piece
from fsar_ledger.ledger.store.staging import Staged, stage
from fsar_ledger.runtime.simulation import RunSpec, simulate_slices

IN_FLIGHT = 2
"""Batches in progress per worker at most, so that memory stays flat."""
# See docs/decisions/commits-hold-16384-events.md.
COMMIT_EVENTS = 1 << 14
"""Events of a commit; independent of the number of workers."""

Batch: TypeAlias = tuple[RunSpec, ...]


class Staging(msgspec.Struct, frozen=True):
    """Makes the runs of batches and stages them for the ledger `out`.

    `held` says of each run that the ledger holds in part how many events. A batch is staged as segments of at most
    `COMMIT_EVENTS` events.
    """

    out: Path
    constants: Constants
    held: Mapping[str, int]

    def of_all(self, batches: Sequence[Batch], workers: int | WorkerPool) -> Iterator[Iterable[Staged]]:
        """Yield what is staged of each batch, in order, made by this process, so many worker processes, or this pool.

        In this process a batch is made while what is yielded is consumed.
        """
        most = min(workers.workers if isinstance(workers, WorkerPool) else workers, len(batches))
        if most <= 1:
            yield from map(self._stream, batches)
        elif isinstance(workers, WorkerPool):
            yield from self._of_pool(batches, workers)
        else:
            with WorkerPool(most) as pool:
                yield from self._of_pool(batches, pool)

    def _of_pool(self, batches: Sequence[Batch], pool: WorkerPool) -> Iterator[Iterable[Staged]]:
        queue: deque[Future[Sequence[Staged]]] = deque()
        for batch in batches:
            queue.append(pool.submit(self.of, batch))
            if len(queue) >= IN_FLIGHT * pool.workers:
                yield queue.popleft().result()
        while queue:
            yield queue.popleft().result()

    def of(self, batch: Batch) -> Sequence[Staged]:
        """Simulate and stage the batch."""
        return list(self._stream(batch))

    def _stream(self, batch: Batch) -> Iterator[Staged]:
        """As `of`, one segment after the other, without garbage collection: a run makes no cyclic garbage."""
        with without_collection():
            for part in self._parts(batch):
                yield from self._fitted(part)

    def _parts(self, batch: Batch) -> Iterator[list[LedgerRun]]:
        """Yield the runs of the batch in parts of `COMMIT_EVENTS` events, the last one of what remains."""
        part: list[LedgerRun] = []
        room = COMMIT_EVENTS
        for spec in batch:
            for run in simulate_slices(spec, self.constants, COMMIT_EVENTS):
                at, end = max(0, self.held.get(run.run_id, 0) - run.first), len(run.events)
                while at < end:
                    stop = min(end, at + room)
                    part.append(piece(run, at, stop))
                    room -= stop - at
                    at = stop
                    if not room:
                        yield joined_parts(part)
                        part, room = [], COMMIT_EVENTS
        if part:
            yield joined_parts(part)

    def _fitted(self, part: list[LedgerRun]) -> Iterator[Staged]:
        """Stage the part; in halves, if a segment cannot hold it."""
        try:
            yield stage(self.out, part)
        except CommitTooLarge:
            events = sum(len(run.events) for run in part)
            if events < 2:
                raise
            for half in _halves(part, events // 2):
                yield from self._fitted(half)


def joined_parts(part: Sequence[LedgerRun]) -> list[LedgerRun]:
    """Return the runs of a part, each in one piece."""
    return [joined(list(pieces)) for _, pieces in groupby(part, key=lambda one: one.run_id)]


def _halves(part: Sequence[LedgerRun], events: int) -> tuple[list[LedgerRun], list[LedgerRun]]:
    """Divide these runs after so many events."""
    first: list[LedgerRun] = []
    second: list[LedgerRun] = []
    for run in part:
        size = len(run.events)
        if events > 0:
            first.append(piece(run, 0, min(size, events)))
        if size > events:
            second.append(piece(run, max(0, events), size))
        events -= size
    return first, second
