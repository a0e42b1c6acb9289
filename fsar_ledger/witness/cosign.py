"""Sends a ledger's newest checkpoint to witnesses, each with a proof that the log only grew since the one it has."""

from http import HTTPStatus
from pathlib import Path

import msgspec

from fsar_ledger.errors import LedgerCorrupted, UsageError
from fsar_ledger.ledger.chain.read import View
from fsar_ledger.ledger.log.merkle import consistency_proof
from fsar_ledger.ledger.log.note import Note, Signature
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.witness.client import NoAnswer, ask, ask_all
from fsar_ledger.witness.cosignature import parse_cosigned
from fsar_ledger.witness.policy import Policy, Witness
from fsar_ledger.witness.protocol import ADD_CHECKPOINT, SIZE, Answer, Request

_TRIES = 3  # the first gets the size that the witness knows; another client may advance it before the second


class Cosigned(msgspec.Struct, frozen=True):
    """The outcome of asking the witnesses of a policy to cosign.

    `note` carries their cosignatures. By witness name, `times` holds when each one cosigned (seconds since 1970) and
    `silent` why the others did not.
    """

    note: Note
    times: dict[str, int]
    silent: dict[str, str]


def published_note(view: View) -> Note:
    """Return the note of the newest commit, or of the one before it if the newest one's tiles are not yet written.

    Raises:
        UsageError: There is no commit, or its checkpoint is unsigned.
    """
    note = view.note()
    if note is None:
        raise UsageError(f"{view.path}: found no commit, expected one whose checkpoint can be cosigned")
    if not note.signatures:
        raise UsageError(
            f"{view.path}: found an unsigned checkpoint, expected one signed by the ledger's key: "
            "witnesses cosign only signed ones; see simulate --key"
        )
    return note


def cosign(ledger: Path, policy: Policy) -> Cosigned:
    """Send the ledger's newest checkpoint to every witness of the policy that has a URL.

    Raises:
        UsageError: The policy has no URL, or the ledger has no signed checkpoint.
        NotALedger, FormatVersionMismatch, LedgerCorrupted: As `open_ledger`.
    """
    asked = [witness for witness in policy.witnesses if witness.url is not None]
    if not asked:
        raise UsageError(f"{policy.file}: found no witness with a URL, expected at least one")
    view = open_ledger(ledger)
    note = published_note(view)
    answers = ask_all(lambda witness: _obtain(view, note, witness), asked)
    silent = {
        witness.name: f"the policy has no URL for {witness.name}" for witness in policy.witnesses if witness.url is None
    }
    cosignatures: list[Signature] = []
    times: dict[str, int] = {}
    for witness, answer in zip(asked, answers, strict=True):
        if isinstance(answer, NoAnswer):
            silent[witness.name] = str(answer)
        else:
            times[witness.name], signature = answer
            cosignatures.append(signature)
    return Cosigned(Note(note.checkpoint, (*note.signatures, *cosignatures)), times, silent)


def _obtain(view: View, note: Note, witness: Witness) -> tuple[int, Signature]:
    """Return the time at which this witness cosigned the note, and its cosignature. Raises: NoAnswer."""
    url, size = witness.url or "", note.checkpoint.size
    old = 0
    for _ in range(_TRIES):
        answer = ask(url, ADD_CHECKPOINT, str(Request(old, _proof(view, old, size), note)).encode())
        if answer.status == HTTPStatus.OK:
            return _cosignature(answer, note, witness)
        known = answer.text.removesuffix("\n")
        is_size = answer.media == SIZE and known.isascii() and known.isdecimal() and len(known) <= len(str(1 << 63))
        if answer.status != HTTPStatus.CONFLICT or not is_size:
            break
        old = int(known)
        if old > size:
            raise NoAnswer(
                f"{url}: refused: it knows {old:,} events of this log, the ledger has {size:,}: "
                "this is an older copy, or the newest were removed"
            )
    else:
        raise NoAnswer(f"{url}: refused {_TRIES} times: each time it said that it knows a different size")
    meaning = _MEANINGS.get(answer.status, "")
    raise NoAnswer(f"{url}: refused with {answer.status}{meaning}")


_MEANINGS: dict[int, str] = {
    HTTPStatus.NOT_FOUND: ": it does not watch this log",
    HTTPStatus.FORBIDDEN: ": it does not trust the key that signed the checkpoint",
    HTTPStatus.CONFLICT: ": it knows another root of the same size: history was rewritten, or the witness lies",
    HTTPStatus.UNPROCESSABLE_ENTITY: (
        ": the ledger did not only grow since what it knows: history was rewritten, or the witness lies"
    ),
}


def _proof(view: View, old: int, new: int) -> tuple[bytes, ...]:
    """Compute the consistency proof from the ledger's stored hashes. Raises: NoAnswer if one is missing."""
    try:
        return consistency_proof(view.node(new), old, new)
    except LedgerCorrupted as error:
        raise NoAnswer(str(error)) from error


def _cosignature(answer: Answer, note: Note, witness: Witness) -> tuple[int, Signature]:
    """Return the time and the newest cosignature of this witness in the answer. Raises: NoAnswer if it has none."""
    try:
        found = parse_cosigned("answer", f"{note.checkpoint.text()}\n{answer.text}".encode())
    except LedgerCorrupted as error:
        raise NoAnswer(f"{witness.url}: an answer without cosignatures") from error
    for signature in found.signatures:
        time = witness.key.time_of(Note(note.checkpoint, (signature,)))
        if time is not None and time == witness.key.time_of(found):
            return time, signature
    raise NoAnswer(f"{witness.url}: a cosignature that the key of {witness.name} did not make")
