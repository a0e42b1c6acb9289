"""`verify --replay`: the runs are played again where `verify` found nothing, and both findings are one answer."""

from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from . import output
from .progress import Progress

if TYPE_CHECKING:
    from fsar_ledger.ledger.verify import VerifyReport
    from fsar_ledger.runtime.replay import ReplayReport


def replayed(ledger: Path, report: "VerifyReport", workers: int) -> "ReplayReport":
    """The report on every run that `verify` went through; `NOT_REPLAYED` where it found a problem.

    Raises:
        LedgerCorrupted: the ledger was damaged in between.
    """
    from fsar_ledger.runtime.replay import NOT_REPLAYED, replay

    if not report.ok:
        return NOT_REPLAYED
    with Progress("replayed", "segments") as progress:
        return replay(ledger, workers, progress, report.commits)


def verdict_text(ledger: Path, report: "VerifyReport", again: "ReplayReport | None") -> str:
    """What was found, for people; `again` is None where no replay was asked for."""
    text = output.verdict_text(ledger, report)
    if again is None:
        return text
    if not report.ok:
        return f"{text}\n{ledger}: not replayed, as its rows are in doubt"
    if again.ok:
        lines = [f"replayed: all {again.events:,} events of {again.runs:,} runs are as the world and the handlers make them", *again.remarks]
        return text + "".join(f"{line}\n" for line in lines)
    count = f"{report.runs - again.runs:,} of {report.runs:,} runs"
    return "\n".join([*map(str, again.differences), f"{ledger}: consistent, but replay doubts {count}; do not rely on what they say happened and was decided"])


def verdict_json(report: "VerifyReport", again: "ReplayReport | None") -> str:
    """What was found, for programs: with a replay, `ok` is true when both found nothing, and `replay` holds the differences."""
    document = output.verdict_json(report)
    if again is None:
        return document
    both = {**msgspec.json.decode(document), "ok": report.ok and again.ok, "replay": again}
    return msgspec.json.format(msgspec.json.encode(both), indent=2).decode() + "\n"
