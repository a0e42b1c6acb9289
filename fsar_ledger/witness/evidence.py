"""What witnesses saw of a ledger, for an auditor: each one's newest checkpoint, and whether enough of them saw what is in hand.

Two things are judged. Whatever the log's own key signed, and anybody shows, the ledger must begin with: no witness can make that up. And how many
events enough honest witnesses vouch for: each vouches for the tree that it cosigned and for what that tree began with.
"""

import os
from collections.abc import Sequence
from http import HTTPStatus
from pathlib import Path

import msgspec

from fsar_ledger.errors import LedgerCorrupted, UsageError
from fsar_ledger.ledger.log.note import Note, VerifierKey
from fsar_ledger.ledger.store import disk
from fsar_ledger.ledger.verify.notes import Anchor
from fsar_ledger.witness.client import Silent, ask, ask_all
from fsar_ledger.witness.cosignature import parse_cosigned
from fsar_ledger.witness.policy import Policy, Witness
from fsar_ledger.witness.protocol import path_of

MAX_AGE_S = 300
"""A witness that is asked cosigns anew; its time may differ from ours by so much, else it is an old answer, or a clock is wrong."""


class Word(msgspec.Struct, frozen=True):
    """What one witness says: it saw so many events at this time (seconds since 1970); or None, and why its word does not count."""

    witness: str
    size: int | None = None
    time_s: int | None = None
    reason: str | None = None


class Evidence(msgspec.Struct, frozen=True):
    """What all witnesses of a policy say.

    `size` is the number of events that enough of them saw, 0 if there is none. `checkpoints` are all that the log's key signed,
    which the ledger must begin with.
    """

    size: int
    words: tuple[Word, ...]
    checkpoints: tuple[Anchor, ...]


def ask_witnesses(policy: Policy, logs: Sequence[VerifierKey], origin: str, now_s: int) -> Evidence:
    """What the witnesses of the policy say now. Raises: UsageError if none of them has a URL."""
    asked = [witness for witness in policy.witnesses if witness.url is not None]
    if not asked:
        raise UsageError(
            f"{policy.file}: found no witness with a URL, expected one that can be asked; or give what they cosigned with --cosigned FILE"
        )
    answers = dict(
        zip((witness.name for witness in asked), ask_all(lambda witness: _newest(witness, origin), asked), strict=True)
    )
    words, checkpoints = [], []
    for witness in policy.witnesses:
        answer = answers.get(witness.name, Silent("the policy has no URL for it"))
        if isinstance(answer, Silent):
            words.append(Word(witness.name, reason=str(answer)))
            continue
        where = f"witness {witness.name} ({witness.url})"
        words.append(_word(witness, where, answer, logs, origin, now_s, is_asked=True))
        checkpoints += [Anchor(where, answer)] if _is_of(logs, answer, origin) else []
    return _weighed(policy, words, checkpoints)


def read_cosigned(
    policy: Policy, logs: Sequence[VerifierKey], origin: str, now_s: int, files: Sequence[Path]
) -> Evidence:
    """What these files show of what the witnesses of the policy said, whenever that was. Raises: UsageError if one cannot be read or is no note of the log."""
    notes = {file: _read(file) for file in files}
    for file, note in notes.items():
        if not _is_of(logs, note, origin):
            raise UsageError(
                f"--cosigned {file}: found no checkpoint of {origin} with a signature of its key, expected a note of this ledger"
            )
    words = []
    for witness in policy.witnesses:
        said = [_word(witness, str(file), note, logs, origin, now_s, is_asked=False) for file, note in notes.items()]
        words.append(max(said, key=lambda word: (word.size is not None, word.size or 0, word.time_s or 0)))
    return _weighed(policy, words, [Anchor(str(file), note) for file, note in notes.items()])


def _newest(witness: Witness, origin: str) -> Note:
    """The newest note that this witness cosigned. Raises: Silent."""
    url = witness.url or ""
    answer = ask(url, path_of(origin))
    if answer.status != HTTPStatus.OK:
        said = (
            "it has no checkpoint of this log"
            if answer.status == HTTPStatus.NOT_FOUND
            else f"an answer with status {answer.status}"
        )
        raise Silent(f"{url}: {said}")
    try:
        return parse_cosigned(url, answer.text.encode())
    except LedgerCorrupted as error:
        raise Silent(f"{url}: an answer that is no C2SP checkpoint") from error


def _read(file: Path) -> Note:
    try:
        return parse_cosigned(f"--cosigned {file}", disk.read_document(Path(os.path.realpath(file))))
    except OSError as error:
        raise UsageError(
            f"--cosigned {file}: it cannot be read ({error.strerror}), expected what `fsar-ledger witness ask` wrote"
        ) from error
    except LedgerCorrupted as error:
        raise UsageError(str(error)) from error


def _is_of(logs: Sequence[VerifierKey], note: Note, origin: str) -> bool:
    """Whether a key of the log signed this note of it."""
    return note.checkpoint.origin == origin and any(key.has_signed(note) for key in logs)


def _word(
    witness: Witness, where: str, note: Note, logs: Sequence[VerifierKey], origin: str, now_s: int, *, is_asked: bool
) -> Word:
    """What this note is worth as the word of this witness."""
    time_s = witness.key.time_of(note)
    reason = None
    if not _is_of(logs, note, origin):
        reason = f"{where}: a checkpoint that no key of the log {origin} signed"
    elif time_s is None:
        named = any(one.key == witness.key.key for one in note.signatures)
        reason = f"{where}: {'a cosignature that its key did not make' if named else 'no cosignature of it'}"
    elif time_s > now_s + MAX_AGE_S:
        reason = f"{where}: a cosignature {time_s - now_s:,} s in the future"
    elif is_asked and time_s < now_s - MAX_AGE_S:
        reason = f"{where}: a cosignature {now_s - time_s:,} s old, where it was asked for a new one"
    return Word(witness.name, note.checkpoint.size, time_s) if reason is None else Word(witness.name, reason=reason)


def _weighed(policy: Policy, words: Sequence[Word], checkpoints: Sequence[Anchor]) -> Evidence:
    """The words, and the largest size that enough of them cover: who saw a larger tree saw the smaller one in it."""
    sizes = sorted({word.size for word in words if word.size}, reverse=True)
    enough = (
        size
        for size in sizes
        if policy.is_met({word.witness for word in words if word.size is not None and word.size >= size})
    )
    return Evidence(next(enough, 0), tuple(words), tuple(checkpoints))
