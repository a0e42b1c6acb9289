"""The service of a live federation: robots, people and programs give it commands over HTTP, and follow its events.

This module authenticates them by a file of principals, each with the hash of a token that it alone has. A token is 256
random bits, so its SHA-256 reveals nothing, and no slower hash is needed. Its public part finds its line, and its
secret part is compared in constant time.
"""

import hashlib
import hmac
import os
import secrets
from pathlib import Path

import msgspec

from fsar_ledger.base.errors import UsageError, WriteFailed
from fsar_ledger.base.printable import value
from fsar_ledger.events.envelope import COORDINATION, POLICY, RECOVERY, REGISTRY, TRUST
from fsar_ledger.ledger.store.disk import append_whole

KINDS = {
    "robot": "a robot speaks for itself, and sees the events that name it",
    "supervisor": "a person answers calls and governs the robots that they supervise",
    "service": "a program brings work to robots",
    "auditor": "reads and gives no commands",
}
MAX_NAME = 200
_OWN = (REGISTRY, COORDINATION, RECOVERY, POLICY, TRUST)
_DUMMY = hashlib.sha256(b"").hexdigest()


class Principal(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A line of the file: the name, the public part of its token, and the SHA-256 of the secret part (hex)."""

    principal: str
    token_id: str
    sha256: str

    @property
    def kind(self) -> str:
        """Return its kind: robot, supervisor, service or auditor."""
        return self.principal.partition("/")[0]


def add_principal(path: Path, name: str) -> str:
    """Add the principal to the file, a new one if need be, and return its token, of which only the hash is stored.

    A principal can have several tokens, so that one can be replaced: remove its line and it is void at once.

    Raises:
        UsageError: No principal can have this name, or the file holds something else.
        WriteFailed: The file cannot be written.
    """
    if not _is_name(name):
        raise UsageError(f"NAME {value(name)}: {_EXPECTED}")
    if name in _OWN:
        raise UsageError(
            f"NAME {name}: found a part of the federation itself, expected the name of a program beside it"
        )
    if path.exists():
        _read(path)
    token_id, secret = secrets.token_hex(8), secrets.token_urlsafe(32)
    line = msgspec.json.encode(Principal(name, token_id, hashlib.sha256(secret.encode()).hexdigest())) + b"\n"
    try:
        file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o600)
        try:
            size = os.fstat(file).st_size
            is_ended = size == 0 or os.pread(file, 1, size - 1) == b"\n"  # an editor may have left the last line open
            append_whole(file, line if is_ended else b"\n" + line)
        finally:
            os.close(file)
    except OSError as error:
        raise WriteFailed(f"{value(str(path))}: the principal was not added ({error.strerror})") from error
    return f"fsar.{token_id}.{secret}"


class Principals:
    """The principals in a file, which is read again when it changes. Raises: UsageError if it holds something else."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._seen = self._state()
        self._by_id = _read(path)

    def __len__(self) -> int:
        return len(self._by_id)

    def authenticate(self, authorization: str) -> Principal | None:
        """Return the principal whose token this header has (`Bearer fsar.ID.SECRET`), or None.

        Raises: UsageError: The file has changed, and cannot be read.
        """
        self._read_again()
        scheme, _, token = authorization.partition(" ")
        parts = token.strip().split(".")
        is_formed = scheme.lower() == "bearer" and len(parts) == 3 and parts[0] == "fsar"
        principal = self._by_id.get(parts[1]) if is_formed else None
        digest = hashlib.sha256(parts[-1].encode(errors="surrogateescape")).hexdigest()
        is_valid = hmac.compare_digest(digest, principal.sha256 if principal is not None else _DUMMY)
        return principal if is_valid else None

    def failure(self) -> UsageError | None:
        """Return why nobody can be authenticated now, or None."""
        try:
            self._read_again()
        except UsageError as error:
            return error
        return None

    def _read_again(self) -> None:
        """Read the file if it has changed. Raises: UsageError: It cannot be read."""
        if (now := self._state()) != self._seen:
            self._by_id, self._seen = _read(self._path), now

    def _state(self) -> tuple[int, ...]:
        """Return a value that differs after any change: a copy may keep the time of the last write."""
        try:
            status = self._path.stat()
        except OSError:
            return ()
        return status.st_mtime_ns, status.st_ctime_ns, status.st_ino, status.st_size


_EXPECTED = (
    f"expected a kind and a name without spaces, such as robot/A1, of at most {MAX_NAME} characters; the kinds are "
    f"{', '.join(KINDS)}"
)


def _is_name(name: str) -> bool:
    kind, _, rest = name.partition("/")
    return kind in KINDS and rest != "" and rest.isprintable() and " " not in rest and len(name) <= MAX_NAME


def _read(path: Path) -> dict[str, Principal]:
    """Return the principals by the public parts of their tokens; empty lines say nothing."""
    try:
        lines = path.read_bytes().splitlines()
    except OSError as error:
        raise UsageError(
            f"{value(str(path))}: {error.strerror}, expected a file that `fsar-ledger principal new` made"
        ) from error
    principals: dict[str, Principal] = {}
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        try:
            principal = msgspec.json.decode(line, type=Principal)
        except (msgspec.DecodeError, UnicodeDecodeError) as error:
            raise UsageError(f"{value(str(path))}:{number}: {error}; expected a principal in a line of JSON") from error
        if not _is_name(principal.principal):
            raise UsageError(f"{value(str(path))}:{number}: found {value(principal.principal)}, {_EXPECTED}")
        if principal.token_id in principals:
            raise UsageError(
                f"{value(str(path))}:{number}: found a token_id that an earlier line has, expected one of its own; "
                "`fsar-ledger principal new` makes a line"
            )
        principals[principal.token_id] = principal
    return principals
