"""Find the event that a user means, and prove it."""

from pathlib import Path

from fsar_ledger import printable
from fsar_ledger.errors import LedgerCorrupted, UsageError
from fsar_ledger.ledger.store.opening import open_for_answers
from fsar_ledger.ledger.store.proof import Proof, Proven, blocks, check_proof, prove
from fsar_ledger.ledger.store.read import LedgerView
from fsar_ledger.metrics.verified import is_verified


def prove_event(ledger: Path, event: str, demanded: str | None = None) -> Proof:
    """Prove the event of this name: `RUN:SEQ`, or its number in the ledger.

    The beginning of the run's name is enough if no other run's name begins like it.

    Raises:
        UsageError: There is no such event, or more than one such run.
        NotALedger, FormatVersionMismatch, LedgerCorrupted: As `open_for_answers` and `prove`.
    """
    view = open_for_answers(ledger)
    is_verified(view, demanded)
    proof = prove(view, _index_of(view, event))
    _require_asked(view, event, check_proof(str(ledger), proof))
    return proof


def _index_of(view: LedgerView, event: str) -> int:
    """Return the number of this event in the ledger, from 0."""
    size = view.head.size
    if event.isascii() and event.isdecimal():
        if len(event) > 16 or int(event) >= size:
            raise UsageError(
                f"EVENT {event}: found {size:,} events in {view.path}, expected a number below that, or RUN:SEQ"
            )
        return int(event)
    asked, _, seq = event.rpartition(":")
    if not asked or not (seq.isascii() and seq.isdecimal()):
        raise UsageError(
            f"EVENT {event}: found no number, expected RUN:SEQ, as a run and the seq of an event in it, or the "
            "event's number in the ledger"
        )
    found = {block.run: block for block in blocks(view)}
    names = [asked] if asked in found else sorted(name for name in found if name.startswith(asked))
    if len(names) != 1:
        raise UsageError(_no_run(view, asked, names, sorted(found)))
    block = found[names[0]]
    if len(seq) > 16 or int(seq) >= block.events:
        raise UsageError(
            f"EVENT {event}: found {block.events:,} events in run {block.run}, expected a seq from 0 to "
            f"{block.events - 1}"
        )
    return block.first + int(seq)


def _require_asked(view: LedgerView, event: str, proven: Proven) -> None:
    """Check that the proven event has the run and seq asked for: its place came from rows that no proof covers.

    Raises: LedgerCorrupted if it is not.
    """
    run, _, seq = event.rpartition(":")
    found = proven.event
    if run and not (str(found["run_id"]).startswith(run) and found["seq"] == int(seq)):
        raise LedgerCorrupted(
            f"{view.path}: event {proven.index}: found run {found['run_id']} seq {found['seq']}, expected {event} "
            "there; run fsar-ledger verify"
        )


def _no_run(view: LedgerView, asked: str, names: list[str], known: list[str]) -> str:
    if names:
        return (
            f"EVENT {asked}: found {len(names)} runs that begin so, {names[0]} and {names[1]} among them, expected "
            "one; give more of its name"
        )
    hint = printable.did_you_mean(asked, known) or ";"
    way = f"`fsar-ledger query runs {printable.word(view.path)}` lists them"
    return f"EVENT {asked}: there is no such run in {view.path}{hint} {way}"
