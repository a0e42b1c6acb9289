"""Keep a ledger of a release for ever: `python -m tests.ledger.keep_release 0.1.0`, once, when the release is made.

This adds `tests/ledgers/VERSION/`: `ledger/`, which later versions must open, and `log/`, which records its head as
that of a shard; `events.jsonl`, the event types as they are; `kept.json`, what the ledger is known to hold. If event
types changed since the release before, it also adds the columns to the package. It never overwrites anything.
"""

import os
import shutil
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import msgspec

import fsar_ledger
from fsar_ledger.designs.constants import Constants
from fsar_ledger.ledger.log.note import Signer
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows.runs import LedgerRun, piece
from fsar_ledger.ledger.rows.schema import LAYOUTS, RELEASE, SCHEMA, Field, StoredType, described
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.shards import ShardHead, record_of_head
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.runtime.experiment import Experiment
from fsar_ledger.runtime.federation import Federation
from fsar_ledger.runtime.simulation import RunSpec, plan_record, simulate_run
from tests.ledger.samples import run_of_every_type

ROOT = Path(__file__).resolve().parents[2]
LEDGERS = ROOT / "tests" / "ledgers"
COLUMNS = ROOT / "fsar_ledger" / "ledger" / "rows" / "columns"

ORIGIN = "example.org/kept"
SECRET = bytes(range(32))  # public: these signatures only show that old ones still verify
EPOCH_S = 1_772_359_200  # 2026-03-01T10:00:00Z


class Kept(msgspec.Struct, frozen=True):
    """What a kept ledger holds: counts, the Merkle root in hex, and the key that signed it.

    `continued`: those of the runs that another one of them continues.
    """

    commits: int
    events: int
    runs: tuple[str, ...]
    root: str
    key: str
    continued: tuple[str, ...] = ()


def stored_types(layouts: Iterable[StoredType]) -> dict[str, dict[str, str]]:
    """Describe how these event types are stored: by tag and field, the kind, the allowed values and whether NULL is
    allowed, as text."""
    return {
        layout.tag: {field.name: _stored(field) for field in sorted(layout.fields, key=lambda field: field.name)}
        for layout in layouts
    }


def _stored(field: Field) -> str:
    values = f" of {'|'.join(sorted(field.values))}" if field.values is not None else ""
    return f"{field.kind}{values}{' or NULL' if field.is_nullable else ''}"


def kept_runs() -> list[LedgerRun]:
    """Return what is kept: a plan, made-up events of every type, then simulated runs."""
    specs = (RunSpec(7, "fsar", "full", "failure-recovery-chain", 4, 0), RunSpec(7, "cfc", "full", "door-relay", 4, 0))
    runs = [run_of_every_type("made-up", seed=1), *(simulate_run(spec, Constants()) for spec in specs)]
    return [plan_record(Experiment(("fsar", "cfc"), ("failure-recovery-chain", "door-relay"), 1, 7).plan()), *runs]


def give_commands(hall: Federation, more: Iterable[tuple[str, str, dict[str, Any]]]) -> None:
    """Give these commands: who gives it, its name and fields. Raises: SystemExit if one is rejected."""
    for by, command, fields in more:
        if (reason := hall.give(command, by, **fields).rejected) is not None:
            raise SystemExit(f"{command} of {by}: found that it is rejected, {reason}; expected one that is decided")


def keep_live_run(path: Path, signer: Signer) -> tuple[str, ...]:
    """Append a live run that is cut while an action is recovered, another is asked for and a task is due later.

    Returns the names of its two parts.
    """
    carrier, door, now_s = "robot/A1", "robot/B1", EPOCH_S

    def clock() -> int:
        return now_s * 1_000_000_000

    def brings(task: str, step: str, budget_s: int) -> tuple[str, str, dict[str, Any]]:
        fields = {"robot": carrier, "task_id": task, "steps": [step], "budget_us": budget_s * 1_000_000}
        return carrier, "SubmitTask", fields

    def says(who: str, command: str, task: str, **fields: Any) -> tuple[str, str, dict[str, Any]]:
        role = "executor" if command == "ReportResult" else "robot"
        return who, command, {role: who, "action_id": f"{task}/1.1", **fields}

    with Federation(path, "live", Constants(), 4, clock, signer=signer) as hall:
        give_commands(hall, [brings("t1", "A door.open.secure B", 600)])
        give_commands(hall, [says(door, "JudgeRequest", "t1", accepts=True), says(door, "ReportStart", "t1")])
        give_commands(hall, [says(door, "ReportFailure", "t1", cause="hinge jammed")])
        give_commands(hall, [brings("t2", "A navigate.indoor", 60), brings("t3", "A door.open.secure B", 600)])
        before, now_s = hall.run, now_s + 2
        after = hall.cut()
        give_commands(hall, [says(door, "JudgeRequest", "t3", accepts=True)])
        give_commands(hall, [says(door, "ReportAttempt", "t1", succeeded=True)])
        give_commands(hall, [says(door, "ReportResult", "t1", result="success"), says(door, "ReportStart", "t3")])
        now_s += 130  # t2 was never begun
        give_commands(hall, [says(door, "ReportResult", "t3", result="success")])
    shutil.rmtree(path.with_name(f"{path.name}.snapshots"))
    return before, after


def kept_of(version: str) -> Kept:
    """Return what is known of the ledger that this version keeps."""
    return msgspec.json.decode((LEDGERS / version / "kept.json").read_bytes(), type=Kept)


def write_ledger(path: Path) -> Kept:
    """Write a small signed ledger: a run that spans commits, compacted segments, a journal, and a live run in it."""
    *whole, cut, last = kept_runs()
    half, signer = len(cut.events) // 2, Signer(ORIGIN, SECRET)
    with Writer(path, ORIGIN, signer) as writer:
        for run in (*whole, piece(cut, 0, half)):
            writer.append(stage(path, [run]))
        writer.compact()
        writer.add([piece(cut, half, half + 20)])
        writer.add([piece(cut, half + 20, len(cut.events))])
        writer.seal()
        for at in range(0, len(last.events), 50):
            writer.add([piece(last, at, at + 50)])
    live = keep_live_run(path, signer)
    names, head = (*(run.run_id for run in (*whole[1:], cut, last)), *live), open_ledger(path).head
    return Kept(head.commits, head.size, names, head.root, str(signer.verifier), live[:-1])


def write_log(path: Path, shard: Path, kept: Kept) -> None:
    """Write a signed log with the head of this ledger."""
    head = ShardHead(ORIGIN, os.path.relpath(shard, path), kept.events, kept.root, 0)
    with Writer(path, f"{ORIGIN}/log", Signer(f"{ORIGIN}/log", SECRET)) as writer:
        writer.append(stage(path, [record_of_head(head)]))


def keep(version: str, ledgers: Path = LEDGERS, columns: Path = COLUMNS) -> None:
    """Keep the ledger, the event types and, if they are new, the columns of this release.

    Raises: SystemExit if one would be overwritten.
    """
    folder = ledgers / version
    if version != fsar_ledger.__version__:
        raise SystemExit(
            f"found version {fsar_ledger.__version__} in fsar_ledger/__init__.py, expected {version}; set it first"
        )
    if folder.exists():
        raise SystemExit(f"{folder}: found what was kept of {version}; a release is kept once, choose the next number")
    text = columns / f"{RELEASE}.txt"
    if text.exists() and text.read_text("utf-8") != described(SCHEMA):
        raise SystemExit(
            f"{text}: found other columns than today's, expected them unchanged since release {RELEASE}; set "
            f"RELEASE to {version}"
        )
    kept = write_ledger(folder / "ledger")
    write_log(folder / "log", folder / "ledger", kept)
    lines = [msgspec.json.encode({tag: fields}) + b"\n" for tag, fields in stored_types(LAYOUTS.values()).items()]
    (folder / "events.jsonl").write_bytes(b"".join(lines))
    (folder / "kept.json").write_bytes(msgspec.json.format(msgspec.json.encode(kept)) + b"\n")
    text.write_text(described(SCHEMA), "utf-8")


if __name__ == "__main__":
    keep(sys.argv[1])
