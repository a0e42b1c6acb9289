"""One trial: a writer that a fault interrupts, perhaps a recovery that another fault interrupts, perhaps a power
failure, and then the verdict. It appends, writes to the journal, seals and compacts."""

import hashlib
import re
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from unittest.mock import patch

from fsar_ledger.base.errors import FsarLedgerError
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows.codec import encode_lines
from fsar_ledger.ledger.rows.runs import LedgerRun
from fsar_ledger.ledger.rows.runs import piece as piece_of
from fsar_ledger.ledger.store import append, growing
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.journal import ALLOTTED
from fsar_ledger.ledger.store.paths import MANIFEST
from fsar_ledger.ledger.store.prepare import Sealing
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.ledger.verify import verify
from tests.ledger.faults import Fault, FaultyOs, Killed, in_place_of_os
from tests.ledger.power import Choice, Disk, choices
from tests.ledger.samples import ORIGIN, contents, made_up_run

TOKEN = re.compile(r"[0-9a-f]{16}(?=\.tmp$)")
RUNS = [made_up_run(f"run-{number}", 40, number) for number in range(5)]
MOST_ROWS = 30
"""Of a journal here; one that would hold more is handed over."""


def piece(run: int, first: int, end: int) -> LedgerRun:
    """Return these events of a run; it goes on unless they are its last."""
    return piece_of(RUNS[run], first, end)


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


def take(writer: Writer, path: Path, step: Step) -> int:
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


@dataclass
class Tally:
    """What was tried and found. `lost` and `torn` count trials; `complaints` describe what was wrong in each.

    Each complaint goes to `tells` when it is made.
    """

    faults: int = 0
    faults_in_recovery: int = 0
    power_failures: int = 0
    kills: int = 0
    lost: int = 0
    torn: int = 0
    complaints: list[str] = field(default_factory=list)
    tells: Callable[[str], None] | None = None

    @property
    def is_clean(self) -> bool:
        return not (self.lost or self.torn or self.complaints)

    def note(self, what: str, where: object) -> None:
        """Note that something was wrong there."""
        self.lost += what.startswith("lost")
        self.torn += what.startswith("torn")
        self.complaints.append(f"{where}: {what}")
        if self.tells is not None:
            self.tells(self.complaints[-1])


def _state(path: Path) -> str:
    """Return one name for each state of the files, whatever their temporary names are."""
    files = sorted((TOKEN.sub("", name), data) for name, data in contents(path).items())
    folders = sorted(str(folder.relative_to(path)) for folder in path.rglob("*") if folder.is_dir())
    return hashlib.sha256(repr((path.exists(), folders, files)).encode()).hexdigest()


@dataclass
class Session:
    """How far one process came. `acknowledged` is the number of events that the ledger reported as safe."""

    acknowledged: int = 0
    error: FsarLedgerError | None = None
    was_killed: bool = False


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
        with one_way(), in_place_of_os(faulty), Writer(path, ORIGIN) as writer:
            acknowledged(writer.head.size)
            for step, size in list(zip(STEPS, sizes(), strict=True))[:commits]:
                if size > writer.head.size or (not step[1] and size == writer.head.size):
                    acknowledged(take(writer, path, step))
    except Killed:
        session.was_killed = True
    except FsarLedgerError as error:
        session.error = error
    return session


class Laboratory:
    """Runs trials in a folder of its own and keeps the tally; `acknowledged` counts events."""

    append = staticmethod(write_with)

    def __init__(self, folder: Path):
        self.folder = folder
        self.tally = Tally()
        self._number = 0
        self._judged: dict[str, tuple[int, list[str]]] = {}
        self._finished: dict[str, str | None] = {}
        self._recovered: set[str] = set()

    def _fresh(self) -> Path:
        """Return an unused path, two folders deep in an empty root."""
        self._number += 1
        root = self.folder / str(self._number)
        root.mkdir()
        return root / "out" / "ledger"

    def judge(self, path: Path, acknowledged: int, where: object) -> str:
        """Check that readers find every acknowledged event, in whole commits.

        Returns the name of the state that the ledger is in.
        """
        state = _state(path)
        size, complaints = self._judged.get(state) or self._judged.setdefault(state, self._read(path))
        if size < acknowledged:
            self.tally.note(f"lost: {size} of {acknowledged} acknowledged events are there", where)
        for complaint in complaints:
            self.tally.note(complaint, where)
        return state

    def _read(self, path: Path) -> tuple[int, list[str]]:
        """Return how many events readers see, and what is wrong with them. The same files give the same answer."""
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

    def finish(self, path: Path, state: str, where: object) -> None:
        """Continue without faults, and check that the ledger ends up as if nothing had happened.

        This is tried once from each state.
        """
        if state not in self._finished:
            self._finished[state] = self._go_on(path)
        if self._finished[state] is not None:
            self.tally.note(f"torn: {self._finished[state]}", where)

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

    def trial(self, faults: Sequence[Fault], choices: Sequence[Choice] = ()) -> list[Session]:
        """Let each fault interrupt one process, each recovering from the one before; then let the power fail in each of
        these ways."""
        path = self._fresh()
        root = path.parent.parent
        disk = Disk(root)
        acknowledged = 0
        sessions = []
        for number, fault in enumerate(faults):
            faulty = FaultyOs(root, fault, disk)
            session = self.append(faulty, path)
            sessions.append(session)
            acknowledged = max(acknowledged, session.acknowledged)
            self.tally.faults += faulty.was_hit and not number
            self.tally.faults_in_recovery += faulty.was_hit and number > 0
            self.judge(path, acknowledged, faults[: number + 1])
        self._fail_power(disk, acknowledged, choices, (*faults, "power failure"))
        recovered = self.append(FaultyOs(root, disk=disk), path)
        if recovered.error is not None:
            self.tally.note(f"torn: the next writer is told {recovered.error}", faults)
        self._fail_power(disk, recovered.acknowledged, choices[:3], (*faults, "recovery", "power failure"))
        self.finish(path, self.judge(path, recovered.acknowledged, faults), faults)
        shutil.rmtree(root)
        return sessions

    def _fail_power(self, disk: Disk, acknowledged: int, choices: Sequence[Choice], where: object) -> None:
        for choice in choices:
            path = self._after_power_failure(disk, choice)
            self.tally.power_failures += 1
            state = self.judge(path, acknowledged, (where, choice.names, choice.contents))
            self.finish(path, state, (where, choice.names, choice.contents))
            shutil.rmtree(path.parent.parent)

    def _after_power_failure(self, disk: Disk, choice: Choice) -> Path:
        self._number += 1
        root = self.folder / str(self._number)
        disk.after_power_failure(choice, root)
        return root / "out" / "ledger"

    def trials_of_recovery(self, first: Fault, kinds: Sequence[str]) -> None:
        """Let the first fault happen and, unless that was tried from the same state, let each call of the recovery fail
        in turn, in one of these ways; then let the power fail."""
        path = self._fresh()
        root = path.parent.parent
        acknowledged = self.append(FaultyOs(root, first), path).acknowledged
        self.tally.faults += 1
        if (state := _state(path)) not in self._recovered:
            self._recovered.add(state)
            at, is_at_end = 0, False
            while not is_at_end:
                again = self.folder / f"{root.name}-{at}"
                shutil.copytree(root, again)
                fault = Fault(at, kinds[at % len(kinds)])
                is_at_end = self._recover(again, path.relative_to(root), fault, acknowledged, (first, fault))
                shutil.rmtree(again)
                at += 1
        shutil.rmtree(root)

    def _recover(self, root: Path, name: Path, fault: Fault, acknowledged: int, where: object) -> bool:
        """Open the ledger and close it, with this fault. Returns whether that was done before the fault."""
        faulty = FaultyOs(root, fault)
        acknowledged = max(acknowledged, self.append(faulty, root / name, 0).acknowledged)
        self.tally.faults_in_recovery += faulty.was_hit
        self.finish(root / name, self.judge(root / name, acknowledged, where), where)
        self._fail_power(faulty.disk, acknowledged, choices(fault.at, 1)[fault.at % 5 :: 3], where)
        return len(faulty.calls) <= fault.at

    def trial_after_power_failure(self, first: Fault, choice: Choice, second: Fault) -> None:
        """Let the first fault happen, then a power failure, then a second fault during the recovery."""
        path = self._fresh()
        disk = Disk(path.parent.parent)
        session = self.append(FaultyOs(path.parent.parent, first, disk), path)
        restarted = self._after_power_failure(disk, choice)
        self.tally.faults += 1
        self.tally.power_failures += 1
        root = restarted.parent.parent
        faulty = FaultyOs(root, second)
        again = self.append(faulty, restarted)
        self.tally.faults_in_recovery += faulty.was_hit
        where = (first, choice.names, choice.contents, second)
        state = self.judge(restarted, max(session.acknowledged, again.acknowledged), where)
        self._fail_power(faulty.disk, max(session.acknowledged, again.acknowledged), [choice], where)
        self.finish(restarted, state, where)
        shutil.rmtree(root)
        shutil.rmtree(path.parent.parent)
