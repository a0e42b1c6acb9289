"""The command `verify`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fsar_ledger import printable
from fsar_ledger.cli.options import (
    JsonOption,
    LedgerArgument,
    ReplayOption,
    TrustedKeyOption,
    WitnessPolicyOption,
    WorkersOption,
    examples,
)
from fsar_ledger.cli.progress import Progress
from fsar_ledger.cli.terminal import show
from fsar_ledger.errors import LedgerCorrupted, ReplayMismatch
from fsar_ledger.printable import counted

if TYPE_CHECKING:
    from fsar_ledger.api.verify import Verification
    from fsar_ledger.ledger.verify.report import VerifyReport
    from fsar_ledger.runtime.replay import ReplayReport

EXAMPLES = examples(
    "fsar-ledger verify out/ledger",
    "fsar-ledger verify out/ledger --quick --json",
    "fsar-ledger verify out/ledger --replay",
    "cp out/ledger/checkpoint monday    # keep it elsewhere; later:",
    "fsar-ledger verify out/ledger --anchor monday --trusted-key out/fleet.key.pub",
    "fsar-ledger verify out/ledger --witness-policy witnesses.policy --cosigned out/cosigned",
)


def verify(
    context: typer.Context,
    ledger: LedgerArgument,
    quick: Annotated[
        bool, typer.Option("--quick", help="Read no rows: only the chain of records, the files' hashes and the notes.")
    ] = False,
    anchor: Annotated[
        Path | None,
        typer.Option(
            "--anchor",
            metavar="FILE",
            help="Prove that the ledger only grew since this copy of LEDGER/checkpoint.",
            show_default=False,
        ),
    ] = None,
    trusted_key: TrustedKeyOption = None,
    witness_policy: WitnessPolicyOption = None,
    cosigned: Annotated[
        list[Path] | None,
        typer.Option(
            "--cosigned",
            metavar="FILE",
            help="With --witness-policy: ask nobody, and take what this note shows; may be repeated.",
            show_default=False,
        ),
    ] = None,
    replay: ReplayOption = False,
    recorded: Annotated[
        bool,
        typer.Option(
            "--recorded",
            help="With --replay: take what the world did and answered from the ledger, not from the seed.",
        ),
    ] = False,
    workers: WorkersOption = None,
    as_json: JsonOption = False,
) -> None:
    """Derive every hash, count and record of a ledger again.

    Where something does not hold, each place is named and the exit code is 3. No ledger can show by itself that all of
    it was rewritten, or that its newest commits were removed. For that, give a trusted key and an anchor (a copy of
    LEDGER/checkpoint that was kept elsewhere), or ask witnesses, who keep one. A check of all rows that finds nothing
    is remembered in the user's cache, never in the ledger; answers from this head are then `rows_verified`.
    """
    from fsar_ledger.api.ledger import Ledger

    with Progress("verified and replayed" if replay else "verified", "segments") as progress:
        found = Ledger(ledger).verify(
            quick=quick,
            anchor=anchor,
            trusted_key=trusted_key,
            witness_policy=witness_policy,
            cosigned=cosigned or (),
            replay=replay,
            recorded=recorded,
            workers=workers,
            progress=progress,
            now_s=context.obj(),
        )
    report, again, seen = found.report, found.replay, found.witnessed
    if as_json:
        _show_json(found)
    if not report.ok:
        raise LedgerCorrupted(*_lines(ledger, report, again, is_recorded=recorded))
    if again is not None and not again.ok:
        raise ReplayMismatch(*_lines(ledger, report, again, is_recorded=recorded))
    if seen is not None and not seen.is_enough:
        raise LedgerCorrupted(seen.doubt(ledger))
    if not as_json:
        witnessed = seen.lines(report.events) if seen is not None else ()
        show(printable.lines(*_lines(ledger, report, again, is_recorded=recorded), *witnessed))


def _show_json(found: "Verification") -> None:
    """Show the findings as JSON; the root in the head is null where some rows cannot be read."""
    from msgspec import to_builtins

    from fsar_ledger.cli.output import pretty

    report = found.report
    more: dict[str, object] = {} if found.replay is None else {"replay": found.replay}
    if found.witnessed is not None:
        more["witnessed"] = found.witnessed.json()
    head = {"size": report.events, "root": report.root}
    show(pretty({"head": head, **to_builtins(report), "ok": found.ok, **more}))


def _lines(ledger: Path, report: "VerifyReport", again: "ReplayReport | None", *, is_recorded: bool) -> list[str]:
    """Return the findings as lines; `again` is None where no replay was asked for."""
    lines = _of_report(ledger, report)
    if again is None:
        return lines
    if not report.ok:
        return [*lines, f"{ledger}: not replayed, as its rows are in doubt"]
    if again.ok and not report.runs:
        return [*lines, "replayed: nothing; the ledger holds no run", *again.remarks]
    if again.ok:
        makers = (
            "the handlers make them in the world on record; whether it was the world of the seed, this does not tell"
            if is_recorded
            else "the world and the handlers make them"
        )
        return [
            *lines,
            f"replayed: all {again.events:,} events of {counted(again.runs, 'run')} are as {makers}",
            *again.remarks,
        ]
    count = f"{report.runs - again.runs:,} of {report.runs:,} runs" if report.runs > again.runs else "what was planned"
    return [
        *map(str, again.differences),
        f"{ledger}: consistent, but replay doubts {count}; do not rely on what they say happened and was decided",
    ]


def _of_report(ledger: Path, report: "VerifyReport") -> list[str]:
    """Return a line for each problem, or lines on what was found consistent."""
    from fsar_ledger.api.key import signature_text

    if not report.ok:
        count = f"{counted(len(report.problems), 'problem')}{' at a quick look' if report.is_quick else ''}"
        return [
            *map(str, report.problems),
            f"{ledger}: {count}; do not rely on this ledger, restore it from a copy that verifies",
        ]
    of_runs = "" if report.is_quick else f" of {counted(report.runs, 'run')}"
    counts = f"{counted(report.events, 'event')}{of_runs} in {counted(report.commits, 'commit')}"
    looked = "consistent at a quick look, which reads no rows" if report.is_quick else "consistent"
    lines = [f"{ledger}: {looked}, {signature_text(report.signature, report.signer)}: {counts}", f"root {report.root}"]
    lines += [f"signed commits: {report.signed:,} of {report.commits:,}"] if report.signed else []
    lines += (
        [f"only grew since the anchor's {report.anchored:,} events"]
        if report.anchored is not None and not report.is_quick
        else []
    )  # there a remark says it
    lines += [f"not looked at: {', '.join(report.not_looked_at)}"] if report.not_looked_at else []
    return [*lines, *report.remarks]
