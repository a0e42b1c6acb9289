"""The verbs `key new` and `key public`: keys that sign ledgers, and the names under which they sign."""

import re
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from fsar_ledger.base import printable
from fsar_ledger.base.errors import UsageError, option

from .names import Place
from .verbs import Option, argument, declare, verb

if TYPE_CHECKING:
    from fsar_ledger.ledger.log.note import Checkpoint, Signer, VerifierKey
    from fsar_ledger.ledger.verify.report import Anchor


@verb(
    "key new fleet.key",
    "key new arm.key --name example.org/arm",
    name="key new",
    takes=(),
)
def key_new(
    file: Annotated[Place, argument("FILE", "Where the secret key goes; the public one goes to FILE.pub.")],
    name: str | None = declare("NAME", "The origin of the ledgers it signs.", "fsar-ledger/simulated"),
) -> "VerifierKey":
    """Make a key that signs ledgers, and print its public half.

    Keep FILE secret: whoever has it can rewrite every ledger that it signed. The public half is for everyone who
    verifies.

    Raises:
        UsageError: The name cannot be an origin, or the file exists or would lie inside a ledger.
        WriteFailed: The file cannot be written.
    """
    from fsar_ledger.ledger.store.keys import new_key
    from fsar_ledger.ledger.store.paths import require_outside
    from fsar_ledger.runtime.experiment import ORIGIN

    require_outside(Path(file), f"FILE {file}")
    return new_key(Path(file), ORIGIN if name is None else short("name", name))


@verb(
    'key public out/fleet.key.pub --name "example.org/fleet/ablation"',
    name="key public",
    takes=(),
)
def key_public(
    key: Annotated[str, argument("KEY", "A public key: a .pub file, or the key itself.")],
    name: Annotated[str, Option("--name", "NAME", "The origin of the ledger to verify.")],
) -> "VerifierKey":
    """Print a public key under another name, for `verify --trusted-key`.

    `reproduce` signs each ledger with one secret under a name of its own.

    Raises:
        UsageError: There is no such key, or no ledger can have this origin.
    """
    from fsar_ledger.ledger.log.note import VerifierKey
    from fsar_ledger.ledger.store.keys import read_verifier

    if (origin := origin_of(name, "name")) is None:
        raise UsageError(f"{option('name')}: expected the origin of a ledger")
    return VerifierKey(origin, read_verifier(key).public)


def signer_of(key: str | PathLike[str] | None, *, adopts: bool = False) -> "Signer | None":
    """Read the key in this file, if one was given.

    Raises:
        UsageError: The file holds no key, or a ledger is to be adopted without one.
    """
    if key is None:
        if adopts:
            raise UsageError(f"{option('adopt')}: found no {option('key')}, expected the key that signs on from here")
        return None
    from fsar_ledger.ledger.store.keys import read_signer

    return read_signer(Path(key))


def origin_of(name: str | None, parameter: str = "origin") -> str | None:
    """Check and return the origin, if one was given. Raises: UsageError if no ledger can have it."""
    from fsar_ledger.ledger.log.note import is_name

    if name is not None and not is_name(name):
        raise UsageError(f"{option(parameter, repr(name))}: expected a printable name without spaces and plus signs")
    return None if name is None else short(parameter, name)


def short(parameter: str, name: str) -> str:
    """Return the name. Raises: UsageError if it is too long to be shown whole."""
    if len(name) > printable.MAX_VALUE:
        raise UsageError(
            f"{option(parameter, name[:40])}...: found {len(name):,} characters, expected at most {printable.MAX_VALUE}"
        )
    return name


def trusted_of(key: str | None) -> "VerifierKey | None":
    """Read the public key that must have signed, if one was given. Raises: UsageError if it is not a key."""
    from fsar_ledger.ledger.store.keys import read_verifier

    return None if key is None else read_verifier(key)


def anchor_of(file: str | PathLike[str] | None) -> "Anchor | None":
    """Read the kept checkpoint in this file, if one was given. Raises: UsageError if it is not a checkpoint."""
    from fsar_ledger.ledger.verify.report import read_anchor

    return None if file is None else read_anchor(Path(file))


def checkpoint_of(file: str | PathLike[str] | None) -> "Checkpoint | None":
    """Read the kept checkpoint in this file, if one was given. Raises: UsageError if it holds none."""
    if (anchor := anchor_of(file)) is None:
        return None
    if anchor.note is None:
        raise UsageError(
            f"{option('anchor', anchor.file)}: found no checkpoint ({anchor.reason}), expected one that was kept "
            "elsewhere"
        )
    return anchor.note.checkpoint


def root_of(text: str | None) -> str | None:
    """Return the root in hex, if one was given. Raises: UsageError if it is no hash."""
    if text is not None and not re.fullmatch("[0-9a-fA-F]{64}", text):
        raise UsageError(f"{option('root', f'{text:.80}')}: found no hash, expected 64 hexadecimal digits")
    return None if text is None else text.lower()


def signature_text(state: str, signer: str | None) -> str:
    """Return what the signature of a note is worth, in words.

    `signer` is the trusted key that made it, or the one that the note names.
    """
    if signer is None:
        return "unsigned"
    return (
        f"signed by {printable.value(signer)}"
        if state == "signed"
        else f"signed, signer not checked (it names {printable.value(signer)})"
    )
