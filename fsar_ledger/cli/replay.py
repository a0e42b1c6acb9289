"""`verify --replay`: the runs are played again where `verify` found nothing, and both findings are one answer."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from fsar_ledger.printable import Shown

from . import output
from .progress import Progress
from .simulated import runs

if TYPE_CHECKING:
    from fsar_ledger.ledger.verify.verify import VerifyReport
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


def verdict_lines(ledger: Path, report: "VerifyReport", again: "ReplayReport | None") -> list[str]:
    """What was found, for people; `again` is None where no replay was asked for."""
    lines = output.verdict_lines(ledger, report)
    if again is None:
        return lines
    if not report.ok:
        return [*lines, f"{ledger}: not replayed, as its rows are in doubt"]
    if again.ok and not report.runs:
        return [*lines, "replayed: nothing; the ledger holds no run", *again.remarks]
    if again.ok:
        return [
            *lines,
            f"replayed: all {again.events:,} events of {runs(again.runs)} are as the world and the handlers make them",
            *again.remarks,
        ]
    count = f"{report.runs - again.runs:,} of {report.runs:,} runs" if report.runs > again.runs else "what was planned"
    return [
        *map(str, again.differences),
        f"{ledger}: consistent, but replay doubts {count}; do not rely on what they say happened and was decided",
    ]


def verdict_json(
    report: "VerifyReport", again: "ReplayReport | None", witnessed: Mapping[str, object] | None = None
) -> Shown:
    """What was found, for programs: `ok` is true when nobody found anything, `replay` holds the differences and `witnessed` what witnesses saw, where asked."""
    more: dict[str, object] = {} if again is None else {"replay": again}
    if witnessed is not None:
        more["witnessed"] = witnessed
    ok = report.ok and (again is None or again.ok) and (witnessed is None or bool(witnessed["ok"]))
    return output.verdict_json(report, ok=ok, **more)
