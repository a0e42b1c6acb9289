"""The messages of C2SP tlog-witness (`add-checkpoint`) and the decision on them, without network or disk.

```
old 20852014                                       the size that the witness is thought to know
PlRNCrwHpqhGrupue0L7gxbjbMiKA9temvuZZDDpkaw=       the consistency proof from there, a hash a line
...

fsar-ledger/simulated                              the checkpoint, signed by the log
20852163
CsUYapGGPo4dkMgIAUqom/Xajj7h2fB2MPA3j2jxq2I=

— fsar-ledger/simulated Az3grlgtzPICa5OS8npVmf1...
```
"""

import base64
import binascii
import hashlib
import re
from collections.abc import Sequence
from http import HTTPStatus

import msgspec

from fsar_ledger.base.errors import LedgerCorrupted
from fsar_ledger.ledger.log.hashing import HASH_BYTES
from fsar_ledger.ledger.log.merkle import EMPTY_ROOT, is_consistent
from fsar_ledger.ledger.log.note import Checkpoint, Note, Signature, VerifierKey
from fsar_ledger.witness.cosignature import parse_cosigned

ADD_CHECKPOINT = "/add-checkpoint"
MAX_PROOF_LINES = 63
MAX_BODY_BYTES = 1 << 17
"""Enough for 63 hashes and 64 Ed25519 signatures, or 20 of the largest kind (ML-DSA-44, 3.3 kB each)."""

PLAIN = "text/plain; charset=utf-8"
SIZE = "text/x.tlog.size"
_OLD = re.compile(r"old (0|[1-9][0-9]{0,18})")


class Answer(msgspec.Struct, frozen=True):
    """An HTTP answer: its status, its text and the media type."""

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
            [f"old {self.old}", *(base64.b64encode(one).decode() for one in self.proof), "", str(self.note)]
        )


def checkpoint_path(origin: str) -> str:
    """Return the path of a log's newest checkpoint: by the SHA-256 of its origin in hex, as C2SP tlog-mirror does."""
    return f"/{origin_hash(origin)}/checkpoint"


def origin_hash(origin: str) -> str:
    """Return the SHA-256 of the origin in hex, which names a log in paths."""
    return hashlib.sha256(origin.encode()).hexdigest()


def parse_request(body: bytes) -> Request:
    """Parse a request to `add-checkpoint`.

    Raises:
        ValueError: The bytes are not a request; the message repeats nothing of them.
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
        found = base64.b64decode(line, validate=True)
    except (binascii.Error, ValueError):
        found = b""
    if len(found) != HASH_BYTES or base64.b64encode(found).decode() != line:
        raise ValueError("a line of the proof is not the base64 of a hash")
    return found


def judge(request: Request, logs: Sequence[VerifierKey], known: Checkpoint | None) -> Note | Answer:
    """Decide on a request: return the note to cosign, with the signatures of the log alone, or the refusal.

    Args:
        request: The parsed request.
        logs: The keys of all logs that this witness trusts.
        known: The newest checkpoint of this log that it cosigned, if any.
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
    found: list[Signature] = []
    for key in trusted:
        of_key = [one for one in note.signatures if one.key == key.key]
        if of_key and not key.has_signed(note):
            return ()
        found += of_key[:1]
    return tuple(found)
