"""The state folder of a witness: its key, and for each log the newest checkpoint that it cosigned.

```
STATE/
  witness.key                   the secret key; anyone who has it can cosign anything
  witness.key.pub
  logs/9f86d081884c7d65...      the note, with the log's signature and the witness's own; named after the SHA-256
                                of the origin
```

A witness that lost its checkpoints would cosign a rewritten log as if it were new. So the key and the checkpoints are
in one folder and are lost together, a checkpoint is on disk before its cosignature is sent, and only one process at a
time has the folder open.
"""

import errno
import fcntl
import os
import stat
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from fsar_ledger.base.errors import LedgerCorrupted, UsageError, WriteFailed
from fsar_ledger.ledger.log.note import KEY_BYTES, Checkpoint, Note, Signature, VerifierKey, is_name
from fsar_ledger.ledger.store import disk

from . import Cosigner, WitnessKey, origin_hash, parse_cosigned, parse_secret, secret_text

SECRET = "witness.key"
PUBLIC = SECRET + ".pub"
LOGS = "logs"


class State:
    """The folder of a witness, open only in this process."""

    def __init__(self, folder: Path, cosigner: Cosigner, newest: dict[str, Note]) -> None:
        self.folder, self.cosigner, self._newest = folder, cosigner, newest

    def newest(self, origin: str) -> Note | None:
        """Return the newest cosigned note of this log, with the cosignature that was stored with it, or None."""
        return self._newest.get(origin)

    def require_signed(self, logs: Sequence[VerifierKey]) -> None:
        """Require that the stored note of each log still has the log's signature, undamaged.

        A log may have changed its key since, so a signature by a key that is not given is not checked.

        Raises: LedgerCorrupted if a signature is damaged or missing.
        """
        for origin, note in self._newest.items():
            signed = [signature for signature in note.signatures if signature.name == origin]
            keys = [key for key in logs if key.name == origin]
            if not all(_is_right(signature, note.checkpoint, keys) for signature in signed) or not signed:
                raise LedgerCorrupted(
                    f"{self.folder / LOGS / origin_hash(origin)}: found a note without the signature of the log of "
                    f"{origin}, or with a damaged one, {_GONE}"
                )

    def remember(self, note: Note) -> None:
        """Store the note durably as the newest of its log.

        Raises:
            WriteFailed: The disk refused; the cosignature must not be sent.
        """
        path = self.folder / LOGS / origin_hash(note.checkpoint.origin)
        with disk.refusals(path, "remembering a checkpoint", "nothing was cosigned"):
            disk.write_durably(path, str(note).encode())
        self._newest[note.checkpoint.origin] = note


def new_state(folder: Path, name: str) -> WitnessKey:
    """Create the folder of a new witness, with a new key and no checkpoints, or finish what was interrupted.

    Raises:
        UsageError: The name is not valid for a key, or the folder is not empty; it is left unchanged.
        WriteFailed: The disk refused; no key was made.
    """
    if not is_name(name):
        raise UsageError(
            f"--name {name!r}: expected a printable name without spaces and plus signs, "
            "by convention host/path, such as example.org/w1"
        )
    secret = os.urandom(KEY_BYTES)
    key = Cosigner(name, secret).key
    with disk.refusals(folder, "making a witness", "no witness was made"):
        disk.make_folder(folder)
        if not _is_unfinished(folder):
            raise UsageError(
                f"{folder}: found files in it, expected a new or empty folder; a witness is never overwritten"
            )
        disk.make_folder(folder / LOGS)
        disk.write_durably(folder / PUBLIC, f"{key}\n".encode())
        disk.write_secret(folder / SECRET, secret_text(key, secret).encode())  # last: without it there is no witness
    return key


def _is_unfinished(folder: Path) -> bool:
    """Return whether nothing is in this folder but what an interrupted `new_state` leaves, before the secret key."""
    names = {name for name in os.listdir(folder) if not name.endswith(disk.TEMPORARY)}
    return names <= {PUBLIC, LOGS} and (LOGS not in names or not os.listdir(folder / LOGS))


@contextmanager
def open_state(folder: Path) -> Iterator[State]:
    """Open the witness in this folder, for this process only.

    Raises:
        UsageError: The folder is not that of a witness, other users can read its key, or another process has it open.
        LedgerCorrupted: A stored checkpoint cannot be read, or was not written by this witness.
        WriteFailed: The folder cannot be locked.
    """
    if not (folder / SECRET).is_file():
        raise UsageError(
            f"{folder}: found no witness there, expected the folder that `fsar-ledger witness new` made; "
            "a lost one cannot be recreated"
        )
    handle = _locked(folder)
    try:
        cosigner = _read_key(folder / SECRET)
        yield State(folder, cosigner, _read_logs(folder, cosigner.key))
    finally:
        disk.close(handle)


def _locked(folder: Path) -> int:
    with disk.refusals(folder, "locking", "nothing was cosigned"):
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        disk.close(handle)
        if error.errno in (errno.EWOULDBLOCK, errno.EACCES):
            raise UsageError(
                f"{folder}: found another process that serves this witness, expected one at most; "
                "two would cosign two histories"
            ) from error
        raise WriteFailed(
            f"{folder}: found a file system without locks ({error.strerror}), expected one with them; "
            "keep the witness elsewhere"
        ) from error
    return handle


def _read_key(path: Path) -> Cosigner:
    try:
        text, mode = disk.read_document(path).decode(), stat.S_IMODE(path.lstat().st_mode)
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not text"
        raise UsageError(
            f"{path}: the key cannot be read ({reason}), expected the file that `fsar-ledger witness new` wrote"
        ) from error
    if mode & 0o077:
        raise UsageError(
            f"{path}: found a secret key with mode {mode:o}, which others may read, expected 600; "
            "run chmod 600 on it, or make a new witness"
        )
    cosigner = parse_secret(text)
    if cosigner is None:
        raise UsageError(
            f"{path}: found no secret key of a witness, expected the file that `fsar-ledger witness new` wrote"
        )
    return cosigner


def _is_right(signature: Signature, checkpoint: Checkpoint, keys: Sequence[VerifierKey]) -> bool:
    """Return whether these keys show no damage in this signature of a log, in its key id or its data."""
    makers = [key for key in keys if key.verifies(signature.data, checkpoint.text().encode())]
    named = [key for key in keys if key.key_id == signature.key_id]
    return makers == named


def _read_logs(folder: Path, key: WitnessKey) -> dict[str, Note]:
    """Return the newest note of each log, by origin."""
    notes: dict[str, Note] = {}
    try:
        names = [entry.name for entry in disk.entries(folder / LOGS)]
    except OSError as error:
        raise LedgerCorrupted(f"{folder / LOGS}: it cannot be read ({error.strerror}), {_GONE}") from error
    for name in names:
        path = folder / LOGS / name
        if name.endswith(disk.TEMPORARY):  # left by a process that was killed before it answered
            disk.remove(path)
            continue
        try:
            note = parse_cosigned(str(path), disk.read_document(path))
        except OSError as error:
            raise LedgerCorrupted(f"{path}: it cannot be read ({error.strerror}), {_GONE}") from error
        if name != origin_hash(note.checkpoint.origin) or key.time_of(note) is None:
            raise LedgerCorrupted(
                f"{path}: found a note that this witness did not cosign, or under another name, {_GONE}"
            )
        notes[note.checkpoint.origin] = note
    return notes


_GONE = (
    "expected the newest checkpoint of a log; do not remove the file, or the witness would cosign a rewritten "
    "log as a new one: retire this witness and make another"
)
