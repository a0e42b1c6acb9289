"""The command `recover`."""

from collections.abc import Iterator, Sequence
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fsar_ledger import printable
from fsar_ledger.cli.options import JsonOption, LedgerArgument, TrustedKeyOption, WorkersOption, examples
from fsar_ledger.cli.progress import Progress
from fsar_ledger.cli.terminal import show
from fsar_ledger.printable import Shown

if TYPE_CHECKING:
    from fsar_ledger.ledger.verify.recover import Recovery, Step
    from fsar_ledger.ledger.verify.report import Asked
    from fsar_ledger.ledger.verify.trusted import Later

DAMAGED = 3
SHOWN = 10

EXAMPLES = examples(
    "fsar-ledger maintain recover out/ledger",
    "fsar-ledger maintain recover out/ledger --json",
    "fsar-ledger maintain recover out/ledger --into out/continued",
)
AFTER_INTERRUPTION = "what was mended stays; run it again"


def recover(
    ledger: LedgerArgument,
    into: Annotated[
        Path | None,
        typer.Option(
            "--into",
            metavar="NEW",
            help="Copy what can be trusted of a damaged ledger to this new folder.",
            show_default=False,
        ),
    ] = None,
    anchor: Annotated[
        Path | None,
        typer.Option(
            "--anchor", metavar="FILE", help="A copy of LEDGER/checkpoint that was kept elsewhere.", show_default=False
        ),
    ] = None,
    trusted_key: TrustedKeyOption = None,
    workers: WorkersOption = None,
    as_json: JsonOption = False,
) -> None:
    """Repair what a crash left; after tampering, say what can be trusted.

    Nothing is deleted: what does not belong to the ledger moves to LEDGER.set-aside. A ledger whose rows or records
    were altered or lost is left as it is; the answer says up to which commit it can be trusted, and --into copies that
    much. Exit code 3 if LEDGER is damaged and nothing was copied.
    """
    from fsar_ledger.api.key import anchor_of, trusted_of
    from fsar_ledger.api.ledger import Ledger
    from fsar_ledger.ledger.verify.report import Asked

    asked = Asked(trusted=trusted_of(trusted_key), anchor=anchor_of(anchor))
    with Progress("examined", "segments") as progress:
        found = Ledger(ledger).recover(into, anchor=anchor, trusted_key=trusted_key, workers=workers, progress=progress)
    show(recovery_json(ledger, found, into) if as_json else recovery_text(ledger, found, asked, into))
    if found.outcome == "damaged":
        raise typer.Exit(DAMAGED)


def recovery_json(ledger: Path, found: "Recovery", into: Path | None) -> Shown:
    """Return what was found and done as JSON; the head is that of the part that can be trusted."""
    from msgspec import to_builtins

    from fsar_ledger.cli.output import json_text

    answer = to_builtins(found)
    return json_text(
        found.head,
        {**answer, "ledger": str(ledger), "into": None if into is None else str(into), "head": answer["head"]},
    )


def recovery_text(ledger: Path, found: "Recovery", asked: "Asked", into: Path | None) -> Shown:
    """Return what was found, what was done, what can be trusted and what to do next, for people."""
    if found.report is not None and not found.problems:
        lines = [
            f"{ledger}: {'mended; nothing was deleted' if found.steps else 'whole, there is nothing to mend'}",
            *_done(found.steps),
        ]
        lines += ["trusted", *_trusted(found, asked)]
        lines += ["next"] if found.steps or into is not None else []
        lines += ["  the command that was interrupted continues when it is called again"] if found.steps else []
        lines += [f"  nothing was copied to {into}: {ledger} itself can be trusted"] if into is not None else []
    else:
        where = found.problems[0].commit
        place = f"commit {where:,}" if where is not None else found.problems[0].where
        changed = "it was mended as far as possible" if found.steps else "nothing of it was changed"
        lines = [f"{ledger}: damaged at {place}; {changed}"]
        lines += ["found", *_some([f"  {problem}" for problem in found.problems]), *_done(found.steps)]
        lines += ["trusted", *_trusted(found, asked)]
        lines += ["after that, on its own", *_some(list(_later(found.later)))] if found.later else []
        lines += ["next", *_next(ledger, found, into)]
    return printable.lines(*lines)


def _done(steps: "Sequence[Step]") -> Iterator[str]:
    """Yield the steps, by kind."""
    for did in dict.fromkeys(step.did for step in steps):
        chosen = [step for step in steps if step.did == did]
        yield did
        yield from _some([f"  {step.file}{'' if step.to == step.file else f' -> {step.to}'}" for step in chosen])


def _some(lines: list[str]) -> list[str]:
    """Return the first lines, and how many more there are."""
    return (
        lines if len(lines) <= SHOWN else [*lines[:SHOWN], f"  ... and {len(lines) - SHOWN:,} more; --json names all"]
    )


def _trusted(found: "Recovery", asked: "Asked") -> Iterator[str]:
    """Yield what can be trusted, and who vouches for it."""
    from fsar_ledger.api.key import signature_text

    head = found.head
    if head.commits:
        last = f"commit{'s 0 to' if head.commits > 1 else ''} {head.commits - 1:,}"
        yield f"  {last}: {head.size:,} events, up to run {printable.value(head.last_run or '')}"
        yield f"  root {head.root}"
        yield "  every row, hash and record of them was derived again and agrees"
    else:
        yield "  no commit" if found.problems else "  it is empty"
    if asked.trusted is not None and head.commits:
        yield f"  {signature_text('signed', asked.trusted.key)}"
    elif found.report is not None:
        yield f"  {signature_text(found.report.signature, found.report.signer)}"
    note = asked.anchor.note if asked.anchor is not None else None
    if note is None:
        yield (
            "  whether newer commits were removed, nothing in a ledger shows; --anchor FILE does, a checkpoint kept "
            "elsewhere"
        )
    elif found.anchored is not None:
        yield f"  the anchor vouches for the first {found.anchored:,} events"
    elif note.checkpoint.size > head.size:
        yield (
            f"  the anchor knows of {note.checkpoint.size:,} events, and the stored hashes do not prove that it begins "
            f"with these {head.size:,}"
        )
    else:
        yield "  the anchor contradicts it"


def _later(later: "Sequence[Later]") -> Iterator[str]:
    """Yield a line for each row of like commits after the trusted ones."""
    for (what, _), group in groupby(later, lambda commit: (commit.found, commit.restore)):
        numbers = [commit.number for commit in group]
        yield (
            f"  commit{'' if len(numbers) == 1 else 's'} "
            f"{numbers[0]:,}{'' if len(numbers) == 1 else f' to {numbers[-1]:,}'}: {what}"
        )


def _next(ledger: Path, found: "Recovery", into: Path | None) -> Iterator[str]:
    """Yield how to go on."""
    if into is not None:
        yield (
            f"  {into} holds what can be trusted, byte for byte, and verifies; {ledger} remains damaged, keep it as "
            "evidence"
        )
        yield f"  fsar-ledger simulate {printable.word(into)} with the options of {ledger} continues there"
        return
    yield f"  keep {ledger} as it is: it is the evidence"
    lost = dict.fromkeys((commit.file, commit.restore) for commit in found.later if commit.file is not None)
    yield from _some([f"  {ledger / file} can be restored from a copy with SHA-256 {sha256}" for file, sha256 in lost])
    if found.head.commits:
        yield (
            f"  fsar-ledger maintain recover {printable.word(ledger)} --into NEW copies what can be trusted to a new "
            "ledger; simulate NEW continues there"
        )
    else:
        yield "  restore it from a copy that verifies, or begin a new ledger"
