"""What a witness must never forget: its key, and for each log the newest checkpoint that it cosigned.

```
STATE/
  witness.key                                    the secret half; whoever has it can cosign anything
  witness.key.pub
  logs/9f86d081884c7d65...                       named after the SHA-256 of the origin: the note, with the log's signature and the witness's own
```

A witness that forgot would cosign a rewritten log as if it were new. So key and memory lie in one folder and are lost together, a checkpoint is on
the disk before its cosignature leaves, and one process at a time has the folder.
"""

import errno
import fcntl
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fsar_ledger.errors import LedgerCorrupted, UsageError, WriteFailed
from fsar_ledger.ledger.log.ed25519 import KEY_BYTES
from fsar_ledger.ledger.log.note import Note, is_name
from fsar_ledger.ledger.store import disk
from fsar_ledger.witness.cosignature import Cosigner, WitnessKey, parse_cosigned, parse_secret, secret_text
from fsar_ledger.witness.protocol import name_of

SECRET = "witness.key"
PUBLIC = SECRET + ".pub"
LOGS = "logs"


class State:
    """The folder of a witness that this process alone has open: its key and its memory."""

    def __init__(self, folder: Path, cosigner: Cosigner, newest: dict[str, Note]) -> None:
        self.folder, self.cosigner, self._newest = folder, cosigner, newest

    def newest(self, origin: str) -> Note | None:
        """The newest note of this log that was cosigned, with the cosignature of then; None if none was."""
        return self._newest.get(origin)

    def remember(self, note: Note) -> None:
        """The note is the newest of its log, on the disk. Raises: WriteFailed if the disk refused: then it is not, and its cosignature must not leave."""
        path = self.folder / LOGS / name_of(note.checkpoint.origin)
        with disk.refusals(path, "remembering a checkpoint"):
            disk.write_durably(path, str(note).encode())
        self._newest[note.checkpoint.origin] = note


def new_state(folder: Path, name: str) -> WitnessKey:
    """There is a folder with a new key and no memory.

    Raises:
        UsageError: The name cannot be that of a key, or something is in the folder; it is left as it is.
        WriteFailed: The disk refused; there is no key.
    """
    if not is_name(name):
        raise UsageError(
            f"--name {name!r}: expected a printable name without spaces and plus signs, by custom host/path, as example.org/w1"
        )
    secret = os.urandom(KEY_BYTES)
    key = Cosigner(name, secret).key
    with disk.refusals(folder, "making a witness"):
        disk.make_folder(folder)
        if os.listdir(folder):
            raise UsageError(
                f"{folder}: found files in it, expected a new or empty folder; a witness is never overwritten"
            )
        disk.make_folder(folder / LOGS)
        disk.write_durably(folder / PUBLIC, f"{key}\n".encode())
        disk.write_secret(folder / SECRET, secret_text(key, secret).encode())  # last: without it there is no witness
    return key


@contextmanager
def opened(folder: Path) -> Iterator[State]:
    """The witness in this folder, which no other process has open meanwhile.

    Raises:
        UsageError: There is none, its key is open to others, or another process has it open.
        LedgerCorrupted: What it must remember cannot be read, or is not what it wrote.
        WriteFailed: The folder cannot be locked.
    """
    if not (folder / SECRET).is_file():
        raise UsageError(
            f"{folder}: found no witness there, expected the folder that `fsar-ledger witness new` made; a lost one cannot be made again"
        )
    handle = _locked(folder)
    try:
        cosigner = _read_key(folder / SECRET)
        yield State(folder, cosigner, _read_logs(folder, cosigner.key))
    finally:
        disk.close(handle)


def _locked(folder: Path) -> int:
    with disk.refusals(folder, "locking"):
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        disk.close(handle)
        if error.errno in (errno.EWOULDBLOCK, errno.EACCES):
            raise UsageError(
                f"{folder}: found another process that serves this witness, expected one at most; two would cosign two histories"
            ) from error
        raise WriteFailed(
            f"{folder}: found a file system without locks ({error.strerror}), expected one with them; keep the witness elsewhere"
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
            f"{path}: found a secret key with mode {mode:o}, which others may read, expected 600; run chmod 600 on it, or make a new witness"
        )
    cosigner = parse_secret(text)
    if cosigner is None:
        raise UsageError(
            f"{path}: found no secret key of a witness, expected the file that `fsar-ledger witness new` wrote"
        )
    return cosigner


def _read_logs(folder: Path, key: WitnessKey) -> dict[str, Note]:
    """The newest note of each log, by origin."""
    found: dict[str, Note] = {}
    try:
        names = [entry.name for entry in disk.entries(folder / LOGS)]
    except OSError as error:
        raise LedgerCorrupted(f"{folder / LOGS}: it cannot be read ({error.strerror}), {_GONE}") from error
    for name in names:
        path = folder / LOGS / name
        if name.endswith(disk.TEMPORARY):  # of a process that was killed before it had answered
            disk.remove(path)
            continue
        try:
            note = parse_cosigned(str(path), disk.read_document(path))
        except OSError as error:
            raise LedgerCorrupted(f"{path}: it cannot be read ({error.strerror}), {_GONE}") from error
        if name != name_of(note.checkpoint.origin) or key.time_of(note) is None:
            raise LedgerCorrupted(
                f"{path}: found a note that this witness did not cosign, or under another name, {_GONE}"
            )
        found[note.checkpoint.origin] = note
    return found


_GONE = (
    "expected the newest checkpoint of a log; do not take the file away, for then the witness would cosign a rewritten log as a new one: "
    "retire this witness and make another"
)
