"""Witnesses of a ledger: the service that cosigns, the client, and the auditor's policy.

This module has a witness's messages, without network: C2SP tlog-witness (`add-checkpoint`) and tlog-cosignature.

```
old 20852014                                       the size that the witness is assumed to have
PlRNCrwHpqhGrupue0L7gxbjbMiKA9temvuZZDDpkaw=       the consistency proof from that size, one hash per line
...

fsar-ledger/simulated                              the checkpoint, signed by the log
20852163
CsUYapGGPo4dkMgIAUqom/Xajj7h2fB2MPA3j2jxq2I=

— fsar-ledger/simulated Az3grlgtzPICa5OS8npVmf1...
```

The answer is an Ed25519 cosignature:

```
— example.org/w1 jWbPPwAAAABkGFDLEZMHwS...     the witness; its key id, a time (8 bytes, seconds since 1970)
                                               and 64 bytes of Ed25519 over

cosignature/v1                                 this text
time 1679315147
fsar-ledger/simulated                          and the checkpoint's
167003
GOniXQYJeSjvAPLjEaJ...UJtQ=
```
"""

import base64
import binascii
import hashlib
import os
import re
from collections.abc import Sequence
from http import HTTPStatus
from pathlib import Path
from typing import ClassVar

import msgspec

from fsar_ledger.base.errors import LedgerCorrupted, UsageError
from fsar_ledger.ledger.log.hashing import HASH_BYTES
from fsar_ledger.ledger.log.merkle import EMPTY_ROOT, is_consistent
from fsar_ledger.ledger.log.note import (
    ED25519,
    SIGNATURE_BYTES,
    Checkpoint,
    Note,
    PublicKey,
    Signature,
    Signer,
    VerifierKey,
    is_name,
    parse_note,
)
from fsar_ledger.ledger.store import disk

_COSIGNATURE = b"\x04"
_TIME_BYTES = 8
_SECRET = "PRIVATE+KEY+"
MAX_TIME_S = 2**63 - 1


class WitnessKey(PublicKey, frozen=True):
    """The public key of a witness, which checks its cosignatures. Raises: As `PublicKey`."""

    KIND: ClassVar[bytes] = _COSIGNATURE

    def time_of(self, note: Note) -> int | None:
        """Return the newest time (seconds since 1970) at which this witness cosigned the note, or None."""
        times = [self._time(signature, note.checkpoint) for signature in note.signatures if signature.key == self.key]
        return max((time for time in times if time is not None), default=None)

    def _time(self, signature: Signature, checkpoint: Checkpoint) -> int | None:
        time = int.from_bytes(signature.data[:_TIME_BYTES], "big")
        if len(signature.data) != _TIME_BYTES + SIGNATURE_BYTES or not 0 < time <= MAX_TIME_S:
            return None
        return time if self.verifies(signature.data[_TIME_BYTES:], cosigned_text(checkpoint, time)) else None


class Cosigner:
    """The secret key of a witness."""

    def __init__(self, name: str, secret: bytes):
        self._signer = Signer(name, secret)
        self.key = WitnessKey(name, self._signer.verifier.public)

    def cosign(self, checkpoint: Checkpoint, time_s: int) -> Signature:
        """Cosign the checkpoint: the witness had seen no larger tree of this log at `time_s` (seconds since 1970).

        Raises:
            ValueError: The time is not valid.
        """
        if not 0 < time_s <= MAX_TIME_S:
            raise ValueError(f"found time {time_s}, expected seconds since 1970")
        signed = self._signer.signature_of(cosigned_text(checkpoint, time_s))
        return Signature(self.key.name, self.key.key_id, time_s.to_bytes(_TIME_BYTES, "big") + signed)


def cosigned_text(checkpoint: Checkpoint, time_s: int) -> bytes:
    """Return the bytes that a cosignature made at this time signs."""
    return f"cosignature/v1\ntime {time_s}\n{checkpoint.text()}".encode()


def parse_cosigned(where: str, data: bytes) -> Note:
    """Parse the bytes of a note. Raises: LedgerCorrupted, as `parse_note`."""
    try:
        text = data.decode()
    except UnicodeDecodeError as error:
        raise LedgerCorrupted(f"{where}: found bytes that are not UTF-8, expected a C2SP checkpoint") from error
    return parse_note(where, text)


def parse_vkey(text: str) -> VerifierKey | WitnessKey:
    """Parse the public key of a log (0x01) or of a witness (0x04).

    Raises:
        ValueError: The text is not such a key, or is a key for which anyone could sign. The message does not repeat the
            text, which may be a secret.
    """
    name, _, rest = text.partition("+")
    key_id, _, data = rest.partition("+")
    try:
        material = base64.b64decode(data, validate=True)
    except (binascii.Error, ValueError):
        material = b""
    if (
        name == "PRIVATE"
        or not is_name(name)
        or name.encode("utf-8", "replace").decode() != name
        or base64.b64encode(material).decode() != data
        or material[:1] not in (ED25519, _COSIGNATURE)
    ):
        raise ValueError(
            "found no public key of a log or a witness, expected name+id+key as `fsar-ledger key new` and "
            "`fsar-ledger witness new` print it"
        )
    kind = WitnessKey if material[:1] == _COSIGNATURE else VerifierKey
    try:
        key = kind(name, material[1:])
    except ValueError as error:
        raise ValueError(
            f"found {error}, expected an Ed25519 public key of prime order; "
            "a signature by this key would prove nothing; get another key"
        ) from error
    if key.key_id.hex() != key_id:
        raise ValueError(f"found another key id than this key's, {key.key_id.hex()}; it was altered, get it again")
    return key


def read_log_key(key: str) -> VerifierKey:
    """Return the log's public key, given as text or as the name of a file. Raises: UsageError."""
    is_text = key.count("+") >= 2 and not os.path.lexists(key)
    where = "--log" if is_text else f"--log {key}"
    try:
        log_key = parse_vkey(key if is_text else _read(Path(key)))
    except ValueError as error:
        raise UsageError(f"{where}: {error}") from error
    if not isinstance(log_key, VerifierKey):
        raise UsageError(
            f"{where}: found the key of a witness, expected that of a log, as `fsar-ledger key new` prints it"
        )
    return log_key


def _read(path: Path) -> str:
    """Return the text of this file without its last line feed. Raises: ValueError if it cannot be read."""
    try:
        return disk.read_document(Path(os.path.realpath(path))).decode().removesuffix("\n")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not text"
        raise ValueError(f"the key cannot be read ({reason}), expected a .pub file") from error


def secret_text(key: WitnessKey, secret: bytes) -> str:
    """Return the content of this key's secret file, one line."""
    return f"{_SECRET}{key.key}+{base64.b64encode(_COSIGNATURE + secret).decode()}\n"


def parse_secret(text: str) -> Cosigner | None:
    """Parse the text of a secret file; return None if it is not one."""
    name, _, rest = text.removesuffix("\n").removeprefix(_SECRET).partition("+")
    try:
        material = base64.b64decode(rest.partition("+")[2], validate=True)
        cosigner = Cosigner(name, material[1:])
    except (binascii.Error, ValueError):
        return None
    return cosigner if text == secret_text(cosigner.key, material[1:]) else None


ADD_CHECKPOINT = "/add-checkpoint"
MAX_PROOF_LINES = 63
MAX_BODY_BYTES = 1 << 17
"""Enough for 63 hashes and 64 Ed25519 signatures, or 20 of the largest kind (ML-DSA-44, 3.3 kB each)."""

PLAIN = "text/plain; charset=utf-8"
SIZE = "text/x.tlog.size"
_OLD = re.compile(r"old (0|[1-9][0-9]{0,18})")


class Answer(msgspec.Struct, frozen=True):
    """An HTTP response: its status, its text and the media type."""

    status: int
    text: str
    media: str = PLAIN


class Request(msgspec.Struct, frozen=True):
    """A request to `add-checkpoint`."""

    old: int
    proof: tuple[bytes, ...]
    note: Note

    def __str__(self) -> str:
        return "\n".join(
            [f"old {self.old}", *(base64.b64encode(entry).decode() for entry in self.proof), "", str(self.note)]
        )


def checkpoint_path(origin: str) -> str:
    """Return the path of a log's newest checkpoint: by the SHA-256 of its origin in hex, as in C2SP tlog-mirror."""
    return f"/{origin_hash(origin)}/checkpoint"


def origin_hash(origin: str) -> str:
    """Return the SHA-256 of the origin in hex, which names a log in paths."""
    return hashlib.sha256(origin.encode()).hexdigest()


def parse_request(body: bytes) -> Request:
    """Parse a request to `add-checkpoint`.

    Raises:
        ValueError: The bytes are not a request; the message repeats none of them.
    """
    head, blank, note = body.partition(b"\n\n")
    try:
        first, *lines = head.decode("ascii").split("\n")
    except UnicodeDecodeError as error:
        raise ValueError("the old size or the proof is not ASCII") from error
    old = _OLD.fullmatch(first)
    if old is None:
        raise ValueError("the first line is not `old` and a size")
    if len(lines) > MAX_PROOF_LINES:
        raise ValueError(f"the proof has more than {MAX_PROOF_LINES} lines")
    if not blank:
        raise ValueError("there is no empty line after the proof")
    proof = tuple(map(_parse_hash, lines))
    try:
        return Request(int(old[1]), proof, parse_cosigned("note", note))
    except LedgerCorrupted as error:
        raise ValueError("the note is not a C2SP checkpoint of three lines with its signatures") from error


def _parse_hash(line: str) -> bytes:
    try:
        digest = base64.b64decode(line, validate=True)
    except (binascii.Error, ValueError):
        digest = b""
    if len(digest) != HASH_BYTES or base64.b64encode(digest).decode() != line:
        raise ValueError("a line of the proof is not the base64 of a hash")
    return digest


def judge(request: Request, logs: Sequence[VerifierKey], known: Checkpoint | None) -> Note | Answer:
    """Decide on a request: return the note to cosign, with only the signatures of the log, or the refusal.

    Args:
        request: The parsed request.
        logs: The keys of all logs that this witness trusts.
        known: The newest checkpoint of this log that the witness cosigned, if any.
    """
    new = request.note.checkpoint
    trusted = [key for key in logs if key.name == new.origin]
    if not trusted:
        return Answer(HTTPStatus.NOT_FOUND, "unknown log\n")
    signatures = signatures_of(request.note, trusted)
    if not signatures:
        return Answer(HTTPStatus.FORBIDDEN, "no signature of a trusted key of this log, or a wrong one\n")
    if request.old > new.size:
        return Answer(HTTPStatus.BAD_REQUEST, "the old size is larger than the checkpoint's\n")
    size, root = (known.size, known.root) if known is not None else (0, EMPTY_ROOT)
    if request.old != size:
        return Answer(HTTPStatus.CONFLICT, f"{size}\n", SIZE)
    if new.size == size and new.root != root:
        return Answer(HTTPStatus.CONFLICT, "another root of the same size was cosigned before\n")
    if not is_consistent(size, root, new.size, new.root, request.proof):
        return Answer(
            HTTPStatus.UNPROCESSABLE_ENTITY,
            "the consistency proof does not lead from the checkpoint that was cosigned before to this one\n",
        )
    return Note(new, signatures)


def signatures_of(note: Note, trusted: Sequence[VerifierKey]) -> tuple[Signature, ...]:
    """Return the signatures by these keys of the log, or none at all if one of them is forged."""
    signatures: list[Signature] = []
    for key in trusted:
        by_key = [signature for signature in note.signatures if signature.key == key.key]
        if by_key and not key.has_signed(note):
            return ()
        signatures += by_key[:1]
    return tuple(signatures)
