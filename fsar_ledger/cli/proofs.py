"""Which event a user means, and what a proof shows, as text and JSON. Nothing here prints."""

import os
from pathlib import Path

from fsar_ledger import printable
from fsar_ledger.errors import LedgerCorrupted, UsageError
from fsar_ledger.ledger.rows.canonical import document
from fsar_ledger.ledger.store.opening import open_for_answers
from fsar_ledger.ledger.store.paths import require_outside
from fsar_ledger.ledger.store.proof import Proof, Proven, blocks, check_proof, prove
from fsar_ledger.ledger.store.read import LedgerView
from fsar_ledger.metrics.verified import is_verified
from fsar_ledger.printable import Shown

from .answering import demanded_head
from .options import did_you_mean
from .output import json_text, signature_text

PRINCIPALS = ("decided_by", "requested_by", "executed_by", "supervised_by")
UNKNOWN = "not on record"


def proof_of(ledger: Path, event: str, *, verified: bool = False) -> Proof:
    """The proof of the event of this name: `RUN:SEQ`, where the beginning of the run's name is enough if no other begins so, or its number.

    Raises:
        UsageError: There is no such event, or more than one such run.
        NotALedger, FormatVersionMismatch, LedgerCorrupted: As `open_for_answers` and `prove`.
    """
    demanded = demanded_head(ledger, verified=verified)
    view = open_for_answers(ledger)
    is_verified(view, demanded)
    proof = prove(view, _index_of(view, event))
    _require_asked(view, event, check_proof(str(ledger), proof))
    return proof


def write_proof(ledger: Path, event: str, out: Path, *, verified: bool = False) -> Shown:
    """The new file holds the proof of this event; two lines that say so.

    Raises:
        UsageError: As `proof_of`; or the file exists, which is left as it is, or would lie inside a ledger.
        WriteFailed: The file cannot be written.
    """
    from .files import write_text

    if os.path.lexists(out):
        raise UsageError(f"--out {out}: found a file, expected a free name; a proof is never overwritten")
    require_outside(out, f"--out {out}")
    proof = proof_of(ledger, event, verified=verified)
    write_text(out, str(proof))
    tree = proof.note.checkpoint
    return printable.lines(f"{out}: event {proof.index:,} of {tree.size:,}", f"root {tree.root.hex()}")


def _index_of(view: LedgerView, event: str) -> int:
    """The number of this event in the ledger, from 0."""
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
            f"EVENT {event}: found no number, expected RUN:SEQ, as a run and the seq of an event in it, or the event's number in the ledger"
        )
    found = {block.run: block for block in blocks(view)}
    names = [asked] if asked in found else sorted(name for name in found if name.startswith(asked))
    if len(names) != 1:
        raise UsageError(_no_run(view, asked, names, sorted(found)))
    block = found[names[0]]
    if len(seq) > 16 or int(seq) >= block.events:
        raise UsageError(
            f"EVENT {event}: found {block.events:,} events in run {block.run}, expected a seq from 0 to {block.events - 1}"
        )
    return block.first + int(seq)


def _require_asked(view: LedgerView, event: str, proven: Proven) -> None:
    """The proven event is itself of the run and seq that were asked for; where it is came from rows that no proof covers. Raises: LedgerCorrupted."""
    run, _, seq = event.rpartition(":")
    found = proven.event
    if run and not (str(found["run_id"]).startswith(run) and found["seq"] == int(seq)):
        raise LedgerCorrupted(
            f"{view.path}: event {proven.index}: found run {found['run_id']} seq {found['seq']}, expected {event} there; run fsar-ledger verify"
        )


def _no_run(view: LedgerView, asked: str, names: list[str], known: list[str]) -> str:
    if names:
        return f"EVENT {asked}: found {len(names)} runs that begin so, {names[0]} and {names[1]} among them, expected one; give more of its name"
    return f"EVENT {asked}: there is no such run in {view.path}; {did_you_mean(asked, known)}`fsar-ledger query runs {printable.word(view.path)}` lists them"


def proven_text(file: Path, proven: Proven) -> Shown:
    """What the proof shows, for people: the event and its principals, its place, and what the signature is worth."""
    event = {name: printable.value(found) if isinstance(found, str) else found for name, found in proven.event.items()}
    width = max(map(len, PRINCIPALS))
    signature = signature_text(proven.signature, proven.signer)
    place = f"event {proven.index:,} of {proven.size:,} in the ledger of {printable.value(proven.origin)}"
    hint = (
        [] if proven.signature == "signed" else ["no signature was checked: compare the root with one that you trust"]
    )
    return printable.lines(
        f"{file}: proven: {place}, {signature}",
        f"root {proven.root}",
        *hint,
        "",
        f"run {event['run_id']}, seq {event['seq']}: {event['type']}",
        *(f"{name.replace('_', ' '):<{width}}  {event.get(name, UNKNOWN)}" for name in PRINCIPALS),
        printable.ascii_json(document(proven.event).decode()),
    )


def proven_json(file: Path, proven: Proven) -> Shown:
    """What the proof shows, for programs; `head` is that of the proof's checkpoint."""
    event = proven.event
    about = {name: event[name] for name in ("run_id", "seq", "type")} | {name: event.get(name) for name in PRINCIPALS}
    place = {"index": proven.index, "origin": proven.origin, "signature": proven.signature, "signer": proven.signer}
    return json_text(proven, {"ok": True, "file": str(file), **place, **about, "event": event})
