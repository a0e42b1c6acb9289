"""One trial: appends that a fault interrupts, perhaps a recovery that another interrupts, perhaps a power failure; then the judgement."""

import shutil
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from fsar_ledger.errors import FsarLedgerError
from fsar_ledger.ledger.append import Writer, stage
from fsar_ledger.ledger.read import open_ledger
from fsar_ledger.ledger.record import MANIFEST, commit_path
from fsar_ledger.ledger.verify import verify
from tests.ledger.faults import Fault, FaultyOs, Killed, in_place_of_os
from tests.ledger.power import Choice, Disk
from tests.ledger.samples import ORIGIN, append_all, contents, made_up_batches

COMMITS = 3
BATCHES = made_up_batches(COMMITS, size=70)
"""140 events a commit, so that the tree passes 256 leaves, a full tile, within the appends that are interrupted."""
INTERRUPTED = 2
"""So many commits are appended while things fail; one more shows that the ledger goes on."""


@dataclass
class Tally:
    """What was tried and what was found. `lost` and `torn` count trials; `complaints` says what was wrong in each."""

    faults: int = 0
    faults_in_recovery: int = 0
    power_failures: int = 0
    kills: int = 0
    lost: int = 0
    torn: int = 0
    complaints: list[str] = field(default_factory=list)

    @property
    def is_clean(self) -> bool:
        return not (self.lost or self.torn or self.complaints)

    def note(self, what: str, where: object) -> None:
        """Something was wrong there."""
        self.lost += what.startswith("lost")
        self.torn += what.startswith("torn")
        self.complaints.append(f"{where}: {what}")


@dataclass
class Session:
    """How far one process came. `acknowledged` is the number of commits that the ledger has told it were safe."""

    acknowledged: int = 0
    error: FsarLedgerError | None = None
    was_killed: bool = False


def append_with(faulty: FaultyOs, path: Path, commits: int = INTERRUPTED) -> Session:
    """A process opens the ledger and appends what it lacks, and the newest batch once more: it may not have been acknowledged."""
    session = Session()
    try:
        with in_place_of_os(faulty), Writer(path, ORIGIN) as writer:
            session.acknowledged = writer.head.commits
            for batch in BATCHES[max(0, session.acknowledged - 1) : commits]:
                session.acknowledged = writer.append(stage(path, batch)).commits
    except Killed:
        session.was_killed = True
    except FsarLedgerError as error:
        session.error = error
    return session


class Laboratory:
    """Makes trials in a folder of its own and keeps the tally."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.tally = Tally()
        append_all(folder / "reference", BATCHES)
        self.reference = contents(folder / "reference")
        self._number = 0

    def _fresh(self) -> Path:
        """A path where nothing is, two folders deep in an empty root."""
        self._number += 1
        root = self.folder / str(self._number)
        root.mkdir()
        return root / "out" / "ledger"

    def judge(self, path: Path, acknowledged: int, where: object) -> None:
        """Readers find every acknowledged commit, whole, and no half of another."""
        if not (path / MANIFEST).exists():
            if acknowledged:
                self.tally.note(f"lost: {acknowledged} acknowledged commits, the ledger is gone", where)
            return
        try:
            view = open_ledger(path)
            if view.head.commits < acknowledged:
                self.tally.note(f"lost: {view.head.commits} of {acknowledged} acknowledged commits are there", where)
            for number in range(view.head.commits):
                names = commit_path(path, number), view.segment(number)
                expected = self.reference[f"commits/{number:012d}.json"], self.reference[f"segments/{number:012d}.parquet"]
                if tuple(name.read_bytes() for name in names) != expected:
                    self.tally.note(f"torn: commit {number} has other bytes", where)
            if list(view.runs()) != [run for batch in BATCHES[: view.head.commits] for run in batch]:
                self.tally.note("torn: other runs are read than were committed", where)
            report = verify(path)
            if not report.ok:
                self.tally.note(f"torn: verify found {'; '.join(map(str, report.problems))}", where)
        except FsarLedgerError as error:
            self.tally.note(f"torn: a reader is told {error}", where)

    def finish(self, path: Path, where: object) -> None:
        """Without faults a writer goes on, and the ledger ends up as if nothing had happened."""
        session = append_with(FaultyOs(path.parent.parent), path, COMMITS)
        if session.error is not None:
            self.tally.note(f"torn: a writer is told {session.error}", where)
        elif contents(path) != self.reference:
            found = contents(path)
            names = sorted(name for name in found.keys() | self.reference.keys() if found.get(name) != self.reference.get(name))
            self.tally.note(f"torn: after going on other bytes are in {', '.join(names)}", where)

    def trial(self, faults: Sequence[Fault], choices: Sequence[Choice] = ()) -> list[Session]:
        """Each fault interrupts one process, each process recovering from the one before; then the power fails in each of these ways."""
        path = self._fresh()
        root = path.parent.parent
        disk = Disk(root)
        acknowledged = 0
        sessions = []
        for number, fault in enumerate(faults):
            faulty = FaultyOs(root, fault, disk)
            session = append_with(faulty, path)
            sessions.append(session)
            acknowledged = max(acknowledged, session.acknowledged)
            self.tally.faults += faulty.was_hit and not number
            self.tally.faults_in_recovery += faulty.was_hit and number > 0
            self.judge(path, acknowledged, (*faults[: number + 1],))
        self._fail_power(disk, acknowledged, choices, (*faults, "power failure"))
        recovered = append_with(FaultyOs(root, disk=disk), path)
        self._fail_power(disk, recovered.acknowledged, choices[:3], (*faults, "recovery", "power failure"))
        self.finish(path, (*faults,))
        shutil.rmtree(root)
        return sessions

    def _fail_power(self, disk: Disk, acknowledged: int, choices: Sequence[Choice], where: object) -> None:
        for choice in choices:
            path = self._after_power_failure(disk, choice)
            self.tally.power_failures += 1
            self.judge(path, acknowledged, (where, choice.names, choice.contents))
            self.finish(path, (where, choice.names, choice.contents))
            shutil.rmtree(path.parent.parent)

    def _after_power_failure(self, disk: Disk, choice: Choice) -> Path:
        self._number += 1
        root = self.folder / str(self._number)
        disk.after_power_failure(choice, root)
        return root / "out" / "ledger"

    def trial_after_power_failure(self, first: Fault, choice: Choice, second: Fault) -> None:
        """The first fault, the power fails, and the recovery after it is interrupted too."""
        path = self._fresh()
        disk = Disk(path.parent.parent)
        session = append_with(FaultyOs(path.parent.parent, first, disk), path)
        restarted = self._after_power_failure(disk, choice)
        self.tally.faults += 1
        self.tally.power_failures += 1
        root = restarted.parent.parent
        faulty = FaultyOs(root, second)
        again = append_with(faulty, restarted)
        self.tally.faults_in_recovery += faulty.was_hit
        where = (first, choice.names, choice.contents, second)
        self.judge(restarted, max(session.acknowledged, again.acknowledged), where)
        self._fail_power(faulty.disk, max(session.acknowledged, again.acknowledged), [choice], where)
        self.finish(restarted, where)
        shutil.rmtree(root)
        shutil.rmtree(path.parent.parent)
