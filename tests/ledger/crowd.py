"""Several writers and readers of one ledger: what each does, and what must hold for the ledger at the end."""

import select
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path

from fsar_ledger.errors import FsarLedgerError, NotALedger
from fsar_ledger.ledger.rows import codec
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.store.append import Writer, stage
from fsar_ledger.ledger.store.paths import MANIFEST
from fsar_ledger.ledger.store.read import LedgerView, open_ledger
from fsar_ledger.ledger.verify.verify import verify
from tests.ledger.samples import ORIGIN, made_up_run

NAMES = ("anna", "bela", "carl", "dora", "emil", "fred", "gina", "hugo")


def batch_of(name: str, number: int) -> list[LedgerRun]:
    """Return the batch with this number of this writer: two runs that carry both in their ids."""
    return [made_up_run(f"{name}-{number:04d}-{run}", 12, seed=NAMES.index(name) * 1000 + number) for run in range(2)]


def own_commits(view: LedgerView, name: str) -> int:
    """Return how many batches of this writer the ledger holds."""
    return sum(record.first_run.startswith(f"{name}-") for record in view.records)


def write(path: Path, name: str, batches: int, say: Callable[[str, object], None]) -> None:
    """Append all batches of this writer, with one writer that takes turns with others. Each is acknowledged at once."""
    with Writer(path, ORIGIN) as writer:
        done = own_commits(open_ledger(path), name)
        say("acknowledged", done)
        for number in range(done, batches):
            writer.append(stage(path, batch_of(name, number)))
            say("acknowledged", number + 1)


def watch(path: Path, stop: int, say: Callable[[str, object], None]) -> None:
    """Check that every head is a whole commit and contains the one before, and that all its rows can be read."""
    before: LedgerView | None = None
    while True:
        is_last = bool(select.select([stop], [], [], 0)[0])
        try:
            view = open_ledger(path)
        except NotALedger:
            if before is not None:
                raise
        else:
            runs = [run.run_id for run in view.runs()]
            if runs != [f"{record.first_run[:-2]}-{run}" for record in view.records for run in range(2)]:
                say("wrong", f"a reader of {view.head.commits} commits saw the runs {runs}")
            if before is not None and view.records[: len(before.records)] != before.records:
                say(
                    "wrong",
                    f"a reader of {view.head.commits} commits no longer saw the {before.head.commits} that it had seen",
                )
            if before is None or view.head != before.head:
                say("head", view.head.commits)
                report = verify(path)
                if not report.ok:
                    say("wrong", f"verify, while others append: {'; '.join(map(str, report.problems))}")
            before = view
        if is_last:
            return


def judge(path: Path, acknowledged: Mapping[str, int]) -> list[str]:
    """Return what is wrong with the ledger that these writers shared: nothing if every acknowledged batch is there
    once, whole and in its writer's order."""
    if not (path / MANIFEST).exists():
        return ["lost: the ledger is gone"] if any(acknowledged.values()) else []
    complaints = []
    found = Counter[str]()
    try:
        view = open_ledger(path)
        for number, (record, table) in enumerate(zip(view.records, view.tables(), strict=True)):
            name = record.first_run.partition("-")[0]
            if list(codec.decode(table)) != batch_of(name, found[name]):
                complaints.append(f"torn: commit {number} does not hold batch {found[name]} of {name}")
            found[name] += 1
        report = verify(path)
    except FsarLedgerError as error:
        return [f"torn: a reader is told {error}"]
    complaints += [
        f"lost: {found[name]} of {count} acknowledged batches of {name} are there"
        for name, count in acknowledged.items()
        if found[name] < count
    ]
    if not report.ok:
        complaints.append(f"torn: verify found {'; '.join(map(str, report.problems))}")
    return complaints
