"""The verbs `maintain recover`, `maintain upgrade` and `maintain compact`."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec

from fsar_ledger.base import printable
from fsar_ledger.base.printable import SafeText, counted
from fsar_ledger.base.progress import Progress

from .answers import Answer, Lines, Screen, head_json
from .key import OWN_CHECKPOINT, anchor_of, is_own_checkpoint, signature_text, trusted_of
from .names import Place
from .verbs import Option, Shows, TrustedKeyOption, WorkersOption, declare, readers_of, verb

if TYPE_CHECKING:
    from fsar_ledger.ledger.store.record import Head
    from fsar_ledger.ledger.verify import Recovery, Step
    from fsar_ledger.ledger.verify.report import VerifyOptions
    from fsar_ledger.ledger.verify.trusted import Later

    from .ledger import Ledger

DAMAGED = 3
SHOWN = 10
"""Lines of each kind that are shown as text."""


class RecoverResult(Answer, msgspec.Struct, frozen=True):
    """The findings and repairs of `recover` in a ledger, its options, and the new folder."""

    ledger: Path
    found: "Recovery"
    asked: "VerifyOptions"
    into: Path | None

    @property
    def exit_code(self) -> int:
        """3 if the ledger is damaged and nothing was copied, or a shard is not whole."""
        return DAMAGED if self.found.outcome == "damaged" or self.found.shards else 0

    def document(self, _: Screen) -> Mapping[str, object]:
        """Return what was found and done; the head is that of the part that can be trusted."""
        into = None if self.into is None else str(self.into)
        answer = msgspec.to_builtins(self.found)
        return {"head": answer["head"], **answer, "ledger": str(self.ledger), "into": into}

    def text(self, _: Screen) -> Iterator[SafeText]:
        """Yield what was found, what was done, what can be trusted and what to do next."""
        ledger, result, into = self.ledger, self.found, self.into
        if result.report is not None and not result.problems:
            done = "repaired; nothing was deleted" if result.steps else "intact, nothing to repair"
            lines = [
                f"{ledger}: {done}{'; not all of its shards are intact' if result.shards else ''}",
                *_done(result.steps),
            ]
            lines += ["trusted", *self._trusted()]
            lines += ["next"] if result.steps or into is not None else []
            lines += ["  run the interrupted command again: it continues where it stopped"] if result.steps else []
            lines += [f"  nothing was copied to {into}: {ledger} itself can be trusted"] if into is not None else []
            lines += ["shards", *_first_lines([f"  {problem}" for problem in result.shards])] if result.shards else []
            lines += ["  fsar-ledger maintain recover SHARD repairs one of them"] if result.shards else []
        else:
            where = result.problems[0].commit
            location = f"commit {where:,}" if where is not None else result.problems[0].where
            changed = "it was repaired as far as possible" if result.steps else "it was not changed"
            lines = [f"{ledger}: damaged at {location}; {changed}"]
            lines += ["found", *_first_lines([f"  {problem}" for problem in result.problems]), *_done(result.steps)]
            lines += ["trusted", *self._trusted()]
            lines += (
                ["later commits, each on its own", *_first_lines(list(_later(result.later)))] if result.later else []
            )
            lines += ["next", *self._next()]
        yield printable.lines(*lines)

    def _trusted(self) -> Iterator[str]:
        """Yield what can be trusted, and on whose authority."""
        result, head = self.found, self.found.head
        if head.commits:
            last = f"commit{'s 0 to' if head.commits > 1 else ''} {head.commits - 1:,}"
            yield f"  {last}: {head.size:,} events, up to run {printable.value(head.last_run or '')}"
            yield f"  root {head.root}"
            yield "  all their rows, hashes and records were derived again and agree"
        else:
            yield "  no commit" if result.problems else "  it is empty"
        if self.asked.trusted is not None and head.commits:
            yield f"  {signature_text('signed', self.asked.trusted.key)}"
        elif result.report is not None:
            yield f"  {signature_text(result.report.signature, result.report.signer)}"
        note = self.asked.anchor.note if self.asked.anchor is not None else None
        if note is None:
            yield (
                "  no ledger shows whether newer commits were removed; --anchor FILE, a checkpoint kept elsewhere, does"
            )
        elif is_own_checkpoint(self.asked.anchor, self.ledger):
            yield f"  {OWN_CHECKPOINT}"
        elif result.anchored is not None:
            yield f"  the anchor vouches for the first {result.anchored:,} events"
        elif head.commits and note.checkpoint.size > head.size:
            yield (
                f"  the anchor knows of {note.checkpoint.size:,} events, and the stored hashes do not prove that it "
                f"begins with these {head.size:,}"
            )
        else:
            yield "  the anchor vouches for none of them"

    def _next(self) -> Iterator[str]:
        ledger, result, into = self.ledger, self.found, self.into
        if into is not None:
            yield (
                f"  {into} holds what can be trusted, byte for byte, and verifies; {ledger} remains damaged, keep it "
                "as evidence"
            )
            yield f"  fsar-ledger simulate {printable.word(into)} with the options of {ledger} continues it"
            return
        yield f"  keep {ledger} as it is: it is the evidence"
        lost = dict.fromkeys((commit.file, commit.restore) for commit in result.later if commit.file is not None)
        yield from _first_lines(
            [f"  {ledger / file} can be restored from a copy with SHA-256 {sha256}" for file, sha256 in lost]
        )
        if result.head.commits:
            yield (
                f"  fsar-ledger maintain recover {printable.word(ledger)} --into NEW copies what can be trusted to a "
                "new ledger; simulate NEW continues it"
            )
        else:
            yield "  restore it from a copy that verifies, or begin a new ledger"


def _recovered(
    ledger: "Ledger",
    into: Place | None,
    *,
    anchor: Place | None,
    trusted_key: str | None,
    workers: int | None,
    progress: Progress | None,
) -> RecoverResult:
    from fsar_ledger.ledger.opening import open_checked
    from fsar_ledger.ledger.store.shards import is_log
    from fsar_ledger.ledger.verify import recover, shards_to_recover
    from fsar_ledger.ledger.verify.report import VerifyOptions

    trusted = trusted_of(trusted_key)
    options = VerifyOptions(trusted=trusted, anchor=anchor_of(anchor, trusted))
    new = None if into is None else Path(into)
    readers = readers_of(workers, ledger.path)
    recovery = recover(ledger.path, readers, progress, options, new)
    if recovery.outcome in ("whole", "mended") and is_log(view := open_checked(ledger.path)):
        recovery = msgspec.structs.replace(recovery, shards=tuple(shards_to_recover(view, readers, progress)))
    return RecoverResult(ledger.path, recovery, options, new)


@verb(
    "maintain recover out/ledger",
    "maintain recover out/ledger --json",
    "maintain recover out/ledger --into out/continued",
    name="maintain recover",
    takes=("json",),
    call=_recovered,
    after_interruption="finished repairs are kept; run it again",
)
def recover(
    ledger: "Ledger",
    into: Place | None = declare("NEW", "Copy what can be trusted of a damaged ledger to this new folder."),
    *,
    anchor: Place | None = declare("FILE", "A copy of LEDGER/checkpoint that was kept elsewhere."),
    trusted_key: TrustedKeyOption = None,
    workers: WorkersOption = None,
    progress: Annotated[Progress | None, Shows("examined", "segments")] = None,
) -> "Recovery":
    """Repair what a crash left; after tampering, say what can be trusted.

    Nothing is deleted: what does not belong to the ledger moves to LEDGER.set-aside. A ledger whose rows or records
    were altered or lost is left as it is; the answer says up to which commit it can be trusted, and --into copies that
    much. The shards of a federation's log are left as they are; those that are not intact are named. Exit code 3 if
    LEDGER is damaged and nothing was copied, or a shard is not intact.

    Raises:
        UsageError: `into` exists.
        LedgerCorrupted: No commit can be trusted.
        WriteFailed: Another writer is at work, or a write failed.
    """
    return _recovered(ledger, into, anchor=anchor, trusted_key=trusted_key, workers=workers, progress=progress).found


def _upgraded(ledger: "Ledger", into: Path, *, progress: Progress | None) -> Lines:
    head = upgrade(ledger, into, progress=progress)
    return Lines(
        f"{into}: {counted(head.size, 'event')} in {counted(head.commits, 'commit')}",
        f"root {head.root}",
        **{"head": head_json(head), "ledger": str(into), "from": str(ledger.path), "commits": head.commits},
    )


@verb(
    "maintain upgrade out/old --into out/upgraded",
    "maintain upgrade out/old --into out/upgraded --json",
    name="maintain upgrade",
    takes=("json",),
    call=_upgraded,
    after_interruption="the commits written so far are kept; run it again to continue",
)
def upgrade(
    ledger: "Ledger",
    into: Annotated[Place, Option("--into", "NEW", "A new folder for the ledger.")],
    *,
    progress: Annotated[Progress | None, Shows("written", "commits")] = None,
) -> "Head":
    """Convert a ledger of format 1, of fsar-ledger up to 0.8, to the present format: the same events, commits and root.

    LEDGER is verified first and is not changed. Signatures are kept.

    Raises:
        UsageError: The ledger is not of format 1, its writer was interrupted, or something else is at `into`.
        LedgerCorrupted: It does not verify; nothing was written.
        WriteFailed: A write failed.
    """
    from fsar_ledger.ledger.v1 import upgrade

    return upgrade(ledger.path, Path(into), progress)


class CompactResult(msgspec.Struct, frozen=True):
    """The result of `compact`: the head, and the number of segments before (a journal counts as one) and after."""

    head: "Head"
    before: int
    after: int


def _compacted(ledger: "Ledger") -> Lines:
    result = compact(ledger)
    done = (
        f"{counted(result.before, 'segment')} merged into {result.after:,}"
        if result.after < result.before
        else f"nothing to do: {counted(result.after, 'segment')}"
    )
    return Lines(
        f"{ledger.path}: {done}",
        f"root {result.head.root}",
        head=head_json(result.head),
        ledger=str(ledger.path),
        before=result.before,
        after=result.after,
    )


@verb(
    "maintain compact out/reviewed",
    "maintain compact out/reviewed --json",
    name="maintain compact",
    takes=("json",),
    call=_compacted,
    after_interruption="nothing is lost; run it again to continue",
)
def compact(ledger: "Ledger") -> CompactResult:
    """Merge small segments, and write what the journal holds as a segment.

    Answers from few large segments are quicker than from many small ones. No event, root, commit or proof changes.

    Raises:
        LedgerCorrupted: A segment is not as placed.
        WriteFailed: A write failed.
    """
    from fsar_ledger.ledger.opening import open_ledger
    from fsar_ledger.ledger.store.append import Writer
    from fsar_ledger.metrics.database import keep_known

    view = open_ledger(ledger.path)
    with Writer(ledger.path, view.manifest.origin, adopts=True) as writer:  # appends nothing
        segments_before = len(view.releases)
        writer.compact()
        compacted = open_ledger(ledger.path)
        keep_known(view, compacted)
        return CompactResult(writer.head, segments_before, len(compacted.releases))


def _done(steps: "Sequence[Step]") -> Iterator[str]:
    for action in dict.fromkeys(step.did for step in steps):
        chosen = [step for step in steps if step.did == action]
        yield action
        yield from _first_lines([f"  {step.file}{'' if step.to == step.file else f' -> {step.to}'}" for step in chosen])


def _first_lines(lines: list[str]) -> list[str]:
    more = len(lines) - SHOWN
    return lines if more <= 0 else [*lines[:SHOWN], f"  ... and {more:,} more; --json names all"]


def _later(later: "Sequence[Later]") -> Iterator[str]:
    """Yield a line for each sequence of like commits after the trusted ones."""
    for (what, _), group in groupby(later, lambda commit: (commit.found, commit.restore)):
        numbers = [f"{commit.number:,}" for commit in group]
        yield f"  commit{f's {numbers[0]} to' if len(numbers) > 1 else ''} {numbers[-1]}: {what}"
