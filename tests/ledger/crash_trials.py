"""One trial: appends that a fault interrupts, perhaps a recovery that another fault interrupts, perhaps a power
failure, and then the verdict."""

import hashlib
import re
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import pyarrow as pa
import pytest

from fsar_ledger.errors import FsarLedgerError
from fsar_ledger.ledger.rows import segment
from fsar_ledger.ledger.rows.codec import encode, encode_hashed
from fsar_ledger.ledger.store import append
from fsar_ledger.ledger.store.append import Writer, stage
from fsar_ledger.ledger.store.paths import MANIFEST, commit_path
from fsar_ledger.ledger.store.read import open_ledger
from fsar_ledger.ledger.store.record import sha256_hex
from fsar_ledger.ledger.verify.verify import verify
from tests.ledger.faults import Fault, FaultyOs, Killed, in_place_of_os
from tests.ledger.forgery import Examined, examined_once
from tests.ledger.power import Choice, Disk, choices
from tests.ledger.samples import ORIGIN, append_all, contents, made_up_batches

COMMITS = 3
BATCHES = made_up_batches(COMMITS, size=70)
"""140 events per commit, so that the tree passes 256 leaves, a full tile, within the interrupted appends."""
INTERRUPTED = 2
"""How many commits are appended while things fail; one more shows that the ledger goes on."""
READ_TABLE = segment.read_table
TOKEN = re.compile(r"[0-9a-f]{16}(?=\.tmp$)")


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


@cache
def _encoded(first_run: str) -> tuple[pa.Table, bytes]:
    return encode_hashed(next(batch for batch in BATCHES if batch[0].run_id == first_run))


@cache
def _parquet(first_run: str) -> pa.Buffer:
    return segment.to_parquet(_encoded(first_run)[0])


def _written(table: pa.Table) -> pa.Buffer:
    return _parquet(table.column("run_id")[0].as_py())


def encode_all() -> None:
    """Encode and decode every batch once, for this process and those that it forks."""
    for batch in BATCHES:
        _parquet(batch[0].run_id)
    _decoded()


@cache
def _decoded() -> dict[str, pa.Table]:
    """Return the rows of each batch by the SHA-256 of its segment."""
    return {sha256_hex(_parquet(batch[0].run_id)): encode(batch) for batch in BATCHES}


def _read(path: Path, columns: list[str] | None = None) -> pa.Table:
    """As `segment.read_table`."""
    try:
        table = _decoded().get(sha256_hex(path.read_bytes()))
    except OSError:
        table = None
    return READ_TABLE(path, columns) if table is None else table.select(columns or table.column_names)


@contextmanager
def encoded_once() -> Iterator[None]:
    """Encode each batch and decode its segment only once.

    Both write nothing, and would take most of the time of a trial.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(segment, "read_table", _read)
        patch.setattr(append, "encode_hashed", lambda runs: _encoded(runs[0].run_id))
        patch.setattr(append, "segment", SimpleNamespace(to_parquet=_written))
        yield


@dataclass
class Session:
    """How far one process came. `acknowledged` is the number of commits that the ledger reported as safe."""

    acknowledged: int = 0
    error: FsarLedgerError | None = None
    was_killed: bool = False


def append_with(
    faulty: FaultyOs, path: Path, commits: int = INTERRUPTED, acknowledge: Callable[[int], None] | None = None
) -> Session:
    """Open the ledger in a process and append what it lacks, and the newest batch again, which may not have been
    acknowledged."""
    session = Session()

    def acknowledged(count: int) -> None:
        session.acknowledged = count
        if acknowledge is not None:
            acknowledge(count)

    try:
        with encoded_once(), in_place_of_os(faulty), Writer(path, ORIGIN) as writer:
            acknowledged(writer.head.commits)
            for batch in BATCHES[max(0, session.acknowledged - 1) : commits]:
                acknowledged(writer.append(stage(path, batch)).commits)
    except Killed:
        session.was_killed = True
    except FsarLedgerError as error:
        session.error = error
    return session


class Laboratory:
    """Runs trials in a folder of its own and keeps the tally."""

    append = staticmethod(append_with)

    def __init__(self, folder: Path):
        self.folder = folder
        self.tally = Tally()
        self._number = 0
        self._judged: dict[str, tuple[int, list[str]]] = {}
        self._finished: dict[str, str | None] = {}
        self._recovered: set[str] = set()
        self._prepare()

    def _prepare(self) -> None:
        """Write what later ledgers are compared with."""
        append_all(self.folder / "reference", BATCHES)
        self.reference = contents(self.folder / "reference")
        self._examined = Examined(self.folder / "reference")

    def _fresh(self) -> Path:
        """Return an unused path, two folders deep in an empty root."""
        self._number += 1
        root = self.folder / str(self._number)
        root.mkdir()
        return root / "out" / "ledger"

    def judge(self, path: Path, acknowledged: int, where: object) -> str:
        """Check that readers find every acknowledged commit whole, and no part of another.

        Returns the name of the state that the ledger is in.
        """
        state = _state(path)
        commits, complaints = self._judged.get(state) or self._judged.setdefault(state, self._read(path))
        if commits < acknowledged:
            self.tally.note(f"lost: {commits} of {acknowledged} acknowledged commits are there", where)
        for complaint in complaints:
            self.tally.note(complaint, where)
        return state

    def _read(self, path: Path) -> tuple[int, list[str]]:
        """Return how many commits readers see, and what is wrong with them. The same files give the same answer."""
        if not (path / MANIFEST).exists():
            return 0, []
        complaints = []
        try:
            view = open_ledger(path)
            for number in range(view.head.commits):
                names = commit_path(path, number), view.segment(number)
                expected = (
                    self.reference[f"commits/{number:012d}.json"],
                    self.reference[f"segments/{number:012d}.parquet"],
                )
                if tuple(name.read_bytes() for name in names) != expected:
                    complaints.append(f"torn: commit {number} has other bytes")
            with encoded_once(), examined_once(self._examined):
                if list(view.runs()) != [run for batch in BATCHES[: view.head.commits] for run in batch]:
                    complaints.append("torn: other runs are read than were committed")
                report = verify(path)
        except FsarLedgerError as error:
            return 0, [f"torn: a reader is told {error}"]
        if not report.ok:
            complaints.append(f"torn: verify found {'; '.join(map(str, report.problems))}")
        return view.head.commits, complaints

    def finish(self, path: Path, state: str, where: object) -> None:
        """Continue without faults, and check that the ledger ends up as if nothing had happened.

        This is tried once from each state.
        """
        if state not in self._finished:
            self._finished[state] = self._go_on(path)
        if self._finished[state] is not None:
            self.tally.note(f"torn: {self._finished[state]}", where)

    def _go_on(self, path: Path) -> str | None:
        session = append_with(FaultyOs(path.parent.parent), path, COMMITS)
        if session.error is not None:
            return f"the next writer is told {session.error}"
        found = contents(path)
        names = sorted(
            name for name in found.keys() | self.reference.keys() if found.get(name) != self.reference.get(name)
        )
        return f"after going on other bytes are in {', '.join(names)}" if names else None

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
