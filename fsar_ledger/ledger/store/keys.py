"""Key files: the secret half, readable only by its owner, and beside it the public half in `.pub`."""

import base64
import binascii
import os
import stat
from pathlib import Path

from fsar_ledger.base.errors import UsageError, option
from fsar_ledger.ledger.log.note import ED25519, KEY_BYTES, Signer, VerifierKey, flaw_of, is_name
from fsar_ledger.ledger.store import disk

_SECRET = "PRIVATE+KEY"


def new_key(path: Path, name: str) -> VerifierKey:
    """Create a key: the secret half in this file, the public half beside it with `.pub`. Return the public half.

    Raises:
        UsageError: The name is not valid for a key, or one of the files exists; it is left unchanged.
        WriteFailed: The disk refused; no key was made.
    """
    if not is_name(name):
        raise UsageError(f"{option('name', repr(name))}: expected a printable name without spaces and plus signs")
    public = path.parent / (path.name + ".pub")
    for file in (path, public):
        if os.path.lexists(file):
            raise UsageError(f"{file}: found a file, expected a free name; a key is never overwritten")
    secret = os.urandom(KEY_BYTES)
    verifier = Signer(name, secret).verifier
    text = f"{_SECRET}+{verifier.key}+{base64.b64encode(ED25519 + secret).decode()}\n"
    with disk.refusals(path, "writing a key", "no key was made"):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            disk.write_secret(path, text.encode())
            disk.write_durably(public, f"{verifier}\n".encode())
        except FileExistsError:  # another process created the file first, and owns it
            raise
        except BaseException:
            disk.remove(path)
            raise
    return verifier


def read_signer(path: Path) -> Signer:
    """Read the secret key in this file. Raises: UsageError if it cannot be read, is not one, or is open to others."""
    text = _read_key(path)
    parts = text.removeprefix(_SECRET + "+").split("+", 2)
    expected = f"{path}: found no secret key, expected the file that `fsar-ledger key new` wrote"
    if not text.startswith(_SECRET + "+") or len(parts) != 3:
        raise UsageError(expected)
    name, key_id, data = parts
    secret = _key_bytes(data)
    if secret is None or not is_name(name):
        raise UsageError(expected)
    mode = stat.S_IMODE(path.stat().st_mode)
    if mode & 0o077:
        raise UsageError(
            f"{path}: found a secret key with mode {mode:o}, which others may read, expected 600; run chmod 600 on "
            "it, or make a new key"
        )
    signer = Signer(name, secret)
    if signer.verifier.key_id.hex() != key_id:
        raise UsageError(
            f"{path}: found key id {key_id}, expected {signer.verifier.key_id.hex()} for this key; it was altered, "
            "restore it"
        )
    return signer


def read_verifier(key: str) -> VerifierKey:
    """Read a public key, given as text or as the name of its file. Raises: UsageError if it is not one."""
    is_text = key.count("+") >= 2 and not os.path.lexists(key)
    text = key if is_text else _read_key(Path(key))
    name, _, rest = text.partition("+")
    key_id, _, data = rest.partition("+")
    public = _key_bytes(data)
    where = option("trusted_key", None if is_text else key)
    if name == "PRIVATE" or public is None or not is_name(name):  # the text is not shown: it may be the secret half
        raise UsageError(
            f"{where}: found no public key, expected one as `fsar-ledger key new` prints, or its .pub file"
        )
    if (flaw := flaw_of(public)) is not None:
        raise UsageError(
            f"{where}: found {flaw}, expected an Ed25519 public key of prime order; a signature by it would prove "
            "nothing, get another key"
        )
    verifier = VerifierKey(name, public)
    if verifier.key_id.hex() != key_id:
        raise UsageError(
            f"{where}: found key id {key_id:.40}, expected {verifier.key_id.hex()} for this key; it was "
            "altered, get it again"
        )
    return verifier


def _read_key(path: Path) -> str:
    try:
        return disk.read_document(Path(os.path.realpath(path))).decode().removesuffix("\n")
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not text"
        raise UsageError(
            f"{path}: the key cannot be read ({reason}); give the file that `fsar-ledger key new` wrote"
        ) from error


def _key_bytes(data: str) -> bytes | None:
    """Decode the 32 bytes of an Ed25519 key; return None if `data` is not one."""
    try:
        key = base64.b64decode(data, validate=True)
    except (binascii.Error, ValueError):
        return None
    is_right = key[:1] == ED25519 and len(key) == 1 + KEY_BYTES and base64.b64encode(key).decode() == data
    return key[1:] if is_right else None
