"""Keys that sign ledgers, and the names that they sign under."""

from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from fsar_ledger import printable
from fsar_ledger.errors import UsageError, option

if TYPE_CHECKING:
    from fsar_ledger.ledger.log.note import Signer, VerifierKey
    from fsar_ledger.ledger.verify.notes import Anchor


def key_new(file: str | PathLike[str], name: str | None = None) -> "VerifierKey":
    """Make a key that signs ledgers, secret in `file`, public in `file` + `.pub`; return the public half.

    Args:
        file: Where it goes; never overwritten. Who has this file can rewrite every ledger that the key signed.
        name: The origin of the ledgers that it signs; None: `fsar-ledger/simulated`.

    Raises:
        UsageError: The name cannot be an origin, or the file would lie inside a ledger, or exists.
        WriteFailed: The file cannot be written.
    """
    from fsar_ledger.ledger.store.keys import new_key
    from fsar_ledger.ledger.store.paths import require_outside
    from fsar_ledger.runtime.experiment import ORIGIN

    require_outside(Path(file), f"FILE {file}")
    return new_key(Path(file), ORIGIN if name is None else short("name", name))


def key_public(key: str, name: str) -> "VerifierKey":
    """Return a public key, of a .pub file or given as text, under another name, to verify a ledger of that origin.

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
        UsageError: There is none in it, or what others wrote shall be adopted without one.
    """
    if key is None:
        if adopts:
            raise UsageError(f"{option('adopt')}: found no {option('key')}, expected the key that signs on from here")
        return None
    from fsar_ledger.ledger.store.keys import read_signer

    return read_signer(Path(key))


def origin_of(name: str | None, parameter: str = "origin") -> str | None:
    """Check the origin that was asked for, if any. Raises: UsageError if no ledger can have it."""
    from fsar_ledger.ledger.log.note import is_name

    if name is not None and not is_name(name):
        raise UsageError(f"{option(parameter, repr(name))}: expected a printable name without spaces and plus signs")
    return None if name is None else short(parameter, name)


def short(parameter: str, name: str) -> str:
    """Return the name if it is short enough to be shown whole. Raises: UsageError if not."""
    if len(name) > printable.MAX_VALUE:
        raise UsageError(
            f"{option(parameter, name[:40])}...: found {len(name):,} characters, expected at most {printable.MAX_VALUE}"
        )
    return name


def trusted_of(key: str | None) -> "VerifierKey | None":
    """Read the public key that must have signed, if one was given. Raises: UsageError if it is none."""
    from fsar_ledger.ledger.store.keys import read_verifier

    return None if key is None else read_verifier(key)


def anchor_of(file: str | PathLike[str] | None) -> "Anchor | None":
    """Read the kept checkpoint in this file, if one was given. Raises: UsageError if it is none."""
    from fsar_ledger.ledger.verify.notes import read_anchor

    return None if file is None else read_anchor(Path(file))
