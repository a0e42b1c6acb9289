"""Trials as in `crash_trials`, of a ledger of format 2: appends, the journal, sealing and compaction."""

import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from unittest.mock import patch

from fsar_ledger.errors import FsarLedgerError
from fsar_ledger.ledger.chain import append
from fsar_ledger.ledger.chain.append import ChainWriter
from fsar_ledger.ledger.chain.journal import ALLOTTED
from fsar_ledger.ledger.chain.sealing import Sealing
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows import pieces
from fsar_ledger.ledger.rows.codec import encode_lines
from fsar_ledger.ledger.rows.runs import LedgerRun
from fsar_ledger.ledger.store import growing
from fsar_ledger.ledger.store.append import stage
from fsar_ledger.ledger.store.paths import MANIFEST
from fsar_ledger.ledger.verify.verify import verify
from tests.ledger.crash_trials import Laboratory, Session
from tests.ledger.faults import FaultyOs, Killed, in_place_of_os
from tests.ledger.samples import ORIGIN, made_up_run

RUNS = [made_up_run(f"run-{number}", 40, number) for number in range(5)]
MOST_ROWS = 30
"""Of a journal here; one that would hold more is handed over."""


def piece(run: int, first: int, end: int) -> LedgerRun:
    """Return these events of a run; it goes on unless they are its last."""
    return pieces.piece(RUNS[run], first, end)


Step = tuple[str, Sequence[LedgerRun]]
STEPS: list[Step] = [
    ("append", [RUNS[0]]),
    ("add", [piece(1, 0, 20)]),
    ("add", [piece(1, 20, 30), piece(2, 0, 5)]),  # hands over
    ("settle", []),
    ("add", [piece(1, 30, 40), piece(2, 5, 10)]),
    ("add", [piece(2, 10, 20)]),  # hands over
    ("append", [RUNS[3]]),
    ("compact", []),
    ("add", [piece(2, 20, 30)]),
    ("add", [piece(2, 30, 40), piece(4, 0, 15)]),  # hands over, and closes
]
"""What a writer does. The journal is sealed when it is full, on request, and by an append; segments are compacted."""

ROWS = [row for _, runs in STEPS for row in encode_lines(runs) if runs]
"""The canonical bytes of all events, in the order of the ledger."""


def sizes() -> list[int]:
    """Return the number of events after each step."""
    found: list[int] = []
    for _, runs in STEPS:
        found.append((found[-1] if found else 0) + sum(len(run.events) for run in runs))
    return found


def take(writer: ChainWriter, path: Path, step: Step) -> int:
    """Take one step, and return the number of events then."""
    what, runs = step
    if what == "append":
        writer.append(stage(path, runs))
    elif what == "add":
        writer.add(runs)
    elif what == "seal":
        writer.seal()
    elif what == "settle":
        writer.settle()
    else:
        writer.compact()
    return writer.head.size


@contextmanager
def one_way() -> Iterator[None]:
    """Let a small journal be full, and what is made of it be there when it is waited for, not at any time before.

    Room for a journal is made in two pieces, because a fault in any other is like one in these.
    """
    never = property(lambda _: False)
    with (
        patch.object(append, "SEAL_ROWS", MOST_ROWS),
        patch.object(Sealing, "is_done", never),
        patch.object(growing, "_ZEROS_AT_ONCE", ALLOTTED // 2),
    ):
        yield


def write_with(
    faulty: FaultyOs, path: Path, commits: int = len(STEPS), acknowledge: Callable[[int], None] | None = None
) -> Session:
    """Open the ledger in a process and take those of the first `commits` steps that it lacks.

    `acknowledged` counts events.
    """
    session = Session()

    def acknowledged(size: int) -> None:
        session.acknowledged = size
        if acknowledge is not None:
            acknowledge(size)

    try:
        with one_way(), in_place_of_os(faulty), ChainWriter(path, ORIGIN) as writer:
            acknowledged(writer.head.size)
            for step, size in list(zip(STEPS, sizes(), strict=True))[:commits]:
                if size > writer.head.size or (not step[1] and size == writer.head.size):
                    acknowledged(take(writer, path, step))
    except Killed:
        session.was_killed = True
    except FsarLedgerError as error:
        session.error = error
    return session


class ChainLaboratory(Laboratory):
    """Runs trials on ledgers of format 2; here `acknowledged` counts events."""

    append = staticmethod(write_with)

    def _prepare(self) -> None:
        """Nothing: what is read is compared with `ROWS`."""

    def _read(self, path: Path) -> tuple[int, list[str]]:
        if not (path / MANIFEST).exists():
            return 0, []
        complaints = []
        try:
            view = open_ledger(path)
            size = view.head.size
            if size not in (0, *sizes()):
                complaints.append(f"torn: {size} events are read, which no commit ends with")
            if [view.event(index) for index in range(0, size, 7)] != ROWS[:size:7]:
                complaints.append("torn: other events are read than were committed")
            if sum(len(run.events) for run in view.runs()) != size:
                complaints.append("torn: events are read twice, or not at all")
            report = verify(path)
        except FsarLedgerError as error:
            return 0, [f"torn: a reader is told {error}"]
        if not report.ok:
            complaints.append(f"torn: verify found {'; '.join(map(str, report.problems))}")
        return size, complaints

    def _go_on(self, path: Path) -> str | None:
        copy = path.with_name("going-on")
        shutil.copytree(path, copy) if path.exists() else None
        session = write_with(FaultyOs(path.parent.parent), copy)
        if session.error is not None:
            return f"the next writer is told {session.error}"
        size, complaints = self._read(copy)
        report = verify(copy)
        shutil.rmtree(copy)
        if complaints or report.remarks or size != len(ROWS):
            return f"after going on {size} events are there; {complaints} {report.remarks}"
        return None
