"""The statements of a policy's witnesses about a ledger, for its verifier, and as text.

They show two things. The ledger must begin with every checkpoint that its own key signed, whichever witness presents
it: none can forge one. They also give the number of events for which enough witnesses vouch: each vouches for the tree
that it cosigned and for every prefix of that tree.
"""

import os
from collections.abc import Sequence
from datetime import UTC, datetime
from http import HTTPStatus
from pathlib import Path
from typing import NamedTuple

import msgspec

from fsar_ledger.base.errors import LedgerCorrupted, UsageError, option
from fsar_ledger.ledger.log.note import Note, VerifierKey
from fsar_ledger.ledger.store import disk
from fsar_ledger.ledger.store.manifest import parse_manifest, read_manifest
from fsar_ledger.ledger.store.paths import MANIFEST
from fsar_ledger.ledger.verify.report import Anchor

from . import checkpoint_path, parse_cosigned
from .cosign import NoAnswer, ask_all, send_request
from .policy import Policy, Witness, read_policy

_LAST_SECOND = 253_402_300_799  # of the year 9999


MAX_AGE_S = 300
"""Seconds by which the time of a fresh cosignature may differ from ours; beyond that it is old or a clock is wrong."""


class Statement(msgspec.Struct, frozen=True):
    """The statement of one witness: it saw `size` events at `time_s` (seconds since 1970).

    Both are None if the statement does not count; then `reason` is why.
    """

    witness: str
    size: int | None = None
    time_s: int | None = None
    reason: str | None = None


class Evidence(msgspec.Struct, frozen=True):
    """The statements of all witnesses of a policy.

    `size` is the largest number of events that enough of them saw, or 0. `checkpoints` are those that the log's key
    signed: the ledger must begin with each.
    """

    size: int
    statements: tuple[Statement, ...]
    checkpoints: tuple[Anchor, ...]


def ask_witnesses(policy: Policy, logs: Sequence[VerifierKey], origin: str, now_s: int) -> Evidence:
    """Query the witnesses of the policy for their newest checkpoints. Raises: UsageError if none has a URL."""
    statements, checkpoints = [], []
    otherwise = "; or give what they cosigned with --cosigned FILE"
    for witness, answer in ask_all(lambda witness: _newest(witness, origin), policy, otherwise):
        if isinstance(answer, NoAnswer):
            statements.append(Statement(witness.name, reason=str(answer)))
            continue
        where = f"witness {witness.name} ({witness.url})"
        statements.append(_statement(witness, where, answer, logs, origin, now_s, is_asked=True))
        checkpoints += [Anchor(where, answer)] if _is_of(logs, answer, origin) else []
    return _weigh(policy, statements, checkpoints)


def read_cosigned(
    policy: Policy, logs: Sequence[VerifierKey], origin: str, now_s: int, files: Sequence[Path]
) -> Evidence:
    """Read the statements of the policy's witnesses from these notes, which may be cosigned at any time.

    Raises:
        UsageError: A file cannot be read, or is not a note of this log.
    """
    notes = {file: _read(file) for file in files}
    for file, note in notes.items():
        if not _is_of(logs, note, origin):
            raise UsageError(
                f"--cosigned {file}: found no checkpoint of {origin} with a signature of its key, "
                "expected a note of this ledger"
            )
    statements = []
    for witness in policy.witnesses:
        own = [
            _statement(witness, str(file), note, logs, origin, now_s, is_asked=False) for file, note in notes.items()
        ]
        statements.append(max(own, key=lambda each: (each.size is not None, each.size or 0, each.time_s or 0)))
    return _weigh(policy, statements, [Anchor(str(file), note) for file, note in notes.items()])


def _newest(witness: Witness, origin: str) -> Note:
    """Request the newest note that this witness cosigned. Raises: NoAnswer."""
    url = witness.url or ""
    answer = send_request(url, checkpoint_path(origin))
    if answer.status != HTTPStatus.OK:
        reason = (
            "it has no checkpoint of this log"
            if answer.status == HTTPStatus.NOT_FOUND
            else f"an answer with status {answer.status}"
        )
        raise NoAnswer(f"{url}: {reason}")
    try:
        return parse_cosigned(url, answer.text.encode())
    except LedgerCorrupted as error:
        raise NoAnswer(f"{url}: an answer that is no C2SP checkpoint") from error


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
    """Return whether the note is about this log and signed by one of its keys."""
    return note.checkpoint.origin == origin and any(key.has_signed(note) for key in logs)


def _statement(
    witness: Witness, where: str, note: Note, logs: Sequence[VerifierKey], origin: str, now_s: int, *, is_asked: bool
) -> Statement:
    """Return the statement of this witness according to this note."""
    time_s = witness.key.time_of(note)
    reason = None
    if not _is_of(logs, note, origin):
        reason = f"{where}: a checkpoint that no key of the log {origin} signed"
    elif time_s is None:
        named = any(signature.key == witness.key.key for signature in note.signatures)
        reason = f"{where}: {'a cosignature that its key did not make' if named else 'no cosignature of it'}"
    elif time_s > now_s + MAX_AGE_S:
        reason = f"{where}: a cosignature {time_s - now_s:,} s in the future"
    elif is_asked and time_s < now_s - MAX_AGE_S:
        reason = f"{where}: a cosignature {now_s - time_s:,} s old, where it was asked for a new one"
    return (
        Statement(witness.name, note.checkpoint.size, time_s)
        if reason is None
        else Statement(witness.name, reason=reason)
    )


def _weigh(policy: Policy, statements: Sequence[Statement], checkpoints: Sequence[Anchor]) -> Evidence:
    """Find the largest size that enough witnesses saw; one that saw a larger tree also saw the smaller one in it."""
    sizes = sorted({statement.size for statement in statements if statement.size}, reverse=True)
    enough = (
        size
        for size in sizes
        if policy.is_met(
            {statement.witness for statement in statements if statement.size is not None and statement.size >= size}
        )
    )
    return Evidence(next(enough, 0), tuple(statements), tuple(checkpoints))


class WitnessAnswer(NamedTuple):
    """The evidence of a policy's witnesses about a ledger; a key of `logs` must have signed what they cosigned."""

    policy: Policy
    logs: tuple[VerifierKey, ...]
    evidence: Evidence

    @property
    def log(self) -> VerifierKey | None:
        """Return the key that must have signed the ledger; None if there are several."""
        return self.logs[0] if len(self.logs) == 1 else None

    @property
    def is_enough(self) -> bool:
        """Return whether enough witnesses saw any events."""
        return self.evidence.size > 0

    def lines(self, events: int) -> list[str]:
        """Return lines of text about what they saw; `events` is the number of the ledger's events."""
        size, statements = self.evidence.size, self.evidence.statements
        rest = "" if size >= events else f"; fewer saw the newest {events - size:,}"
        return [
            (
                f"witnessed: {min(size, events):,} of {events:,} events, by {self._heard()} (enough: "
                f"{self.policy.rule()}){rest}"
            ),
            *(
                f"witness {statement.witness}: its answer does not count: {statement.reason}"
                for statement in statements
                if statement.reason is not None
            ),
        ]

    def doubt(self, ledger: Path) -> str:
        """Return the message about why too few of them saw any events."""
        reasons = "; ".join(
            f"{statement.witness}: {statement.reason}"
            for statement in self.evidence.statements
            if statement.reason is not None
        )
        return (
            f"{self.policy.file}: found {self._heard() or 'no cosignature that counts'} ({reasons}), expected "
            f"{self.policy.rule()}; {ledger} may be "
            "consistent, but nothing shows that it is what they saw: ask again, or find out why they do not answer"
        )

    def _heard(self) -> str:
        return listed(
            {
                statement.witness: statement.time_s
                for statement in self.evidence.statements
                if statement.time_s is not None
            }
        )

    def json(self) -> dict[str, object]:
        """Return the evidence, for JSON."""
        return {
            "policy": self.policy.file,
            "ok": self.is_enough,
            "size": self.evidence.size,
            "witnesses": self.evidence.statements,
        }


def answers_of(
    ledger: Path,
    policy: Path | None,
    cosigned: Sequence[Path] | None,
    trusted: VerifierKey | None,
    now_s: int | None,
) -> WitnessAnswer | None:
    """Return the evidence of the policy's witnesses about the ledger; None without a policy.

    They are queried now, or their notes are read from the files `cosigned`.

    Raises:
        UsageError: The policy is invalid, or does not fit the other arguments.
        NotALedger, FormatVersionMismatch: There is no ledger.
        LedgerCorrupted: The ledger is of a log that the policy does not name.
    """
    if policy is None:
        if cosigned:
            raise UsageError(
                f"{option('cosigned')}: found no {option('witness_policy')}, expected the policy that names the "
                "witnesses"
            )
        return None

    parsed = read_policy(policy)
    logs = _logs_of(parsed, trusted)
    try:
        origin = parse_manifest(ledger / MANIFEST, read_manifest(ledger)).origin
    except LedgerCorrupted:
        return None  # `verify` reports it, with whatever else is wrong
    logs = tuple(key for key in logs if key.name == origin)
    if not logs:
        raise LedgerCorrupted(
            f"{ledger}: found a ledger of {origin}, expected one of a log that {policy} or {option('trusted_key')} "
            "names"
        )
    if now_s is None:
        raise UsageError("witness policy: found no time, expected now_s, seconds since 1970; cosignatures have dates")
    if cosigned:
        return WitnessAnswer(parsed, logs, read_cosigned(parsed, logs, origin, now_s, cosigned))
    return WitnessAnswer(parsed, logs, ask_witnesses(parsed, logs, origin, now_s))


def _logs_of(policy: Policy, trusted: VerifierKey | None) -> tuple[VerifierKey, ...]:
    """Return the keys of which one must have signed what the witnesses cosigned."""
    if policy.quorum is None:
        raise UsageError(
            f"{policy.file}: found `quorum none`, expected a witness or a group; without one nothing is proven"
        )
    if trusted is None and not policy.logs:
        raise UsageError(f"{policy.file}: found no log, expected a line `log KEY`, or {option('trusted_key', 'KEY')}")
    if trusted is not None and policy.logs and trusted not in policy.logs:
        raise UsageError(f"{option('trusted_key')}: found {trusted.key}, expected a log of {policy.file}")
    return policy.logs if trusted is None else (trusted,)


def listed(times: dict[str, int]) -> str:
    """Return the names of witnesses with the times at which they cosigned, as text."""
    return ", ".join(f"{name} ({_time(time_s)})" for name, time_s in times.items())


def _time(time_s: int) -> str:
    return (
        datetime.fromtimestamp(time_s, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
        if time_s <= _LAST_SECOND
        else f"second {time_s:,}"
    )
