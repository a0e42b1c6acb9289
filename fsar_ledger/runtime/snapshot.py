"""What lies beside the ledger of a live run: where the run stood, and the lock of the process that governs it.

A run goes on from a snapshot of it, without being made again from its beginning. A snapshot is derived and disposable.
It counts for one prefix of one ledger and one version of the code, and what the ledger has after it is made again and
compared. One that is damaged, old or another's is passed over.
"""

import fcntl
import hashlib
import io
import os
import pickle
from collections import deque
from collections.abc import Iterable, Mapping
from contextlib import suppress
from functools import cache
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, NewType, Union, get_args, get_origin

import msgspec
import pyarrow.compute as pc

from fsar_ledger.base.errors import UsageError
from fsar_ledger.base.printable import value
from fsar_ledger.ledger.rows.codec import decode
from fsar_ledger.ledger.rows.runs import LedgerRun, joined
from fsar_ledger.ledger.rows.schema import SCHEMA
from fsar_ledger.ledger.store.read import View
from fsar_ledger.ledger.store.record import Head
from fsar_ledger.projections.fold import SLOTS, State

_ROOMS = ("runtime", "projections", "events", "designs")
_KNOWN = (
    *(f"fsar_ledger.{room}." for room in ("projections", "events", "designs", "runtime.handlers")),
    *(
        "fsar_ledger.runtime.architectures.",
        "fsar_ledger.runtime.agenda.",
        "fsar_ledger.runtime.live.",
        "fsar_ledger.runtime.ports.",
    ),
)
_LIBRARY = {
    ("array", "array"),
    ("array", "_array_reconstructor"),
    ("collections", "OrderedDict"),
    ("collections", "deque"),
    ("msgspec._utils", "rebuild"),
}


class Snapshot(msgspec.Struct, frozen=True):
    """What a snapshot counts for: the run, the ledger's size and root there, the code; and the SHA-256 of the rest."""

    run: str
    size: int
    root: str
    code: str
    sha256: str


def save(ledger: Path, run: str, head: Head, known: object) -> None:
    """Keep what is known of the run when the ledger is so long. A disk that refuses is no error."""
    data = pickle.dumps(known, protocol=5)
    line = msgspec.json.encode(Snapshot(run, head.size, head.root, _code(), hashlib.sha256(data).hexdigest()))
    path = place(ledger, run)
    temporary = path.with_suffix(f".{os.getpid()}")
    with suppress(OSError):
        path.parent.mkdir(exist_ok=True)
        with temporary.open("wb") as file:
            file.writelines((line, b"\n", data))
        temporary.replace(path)


def drop(ledger: Path, run: str) -> None:
    """Remove the snapshot of a run that goes on in another one. A disk that refuses is no error."""
    with suppress(OSError):
        place(ledger, run).unlink()


def place(ledger: Path, run: str) -> Path:
    """Return where the snapshot of the run is."""
    return ledger.with_name(f"{ledger.name}.snapshots") / hashlib.sha256(run.encode()).hexdigest()[:16]


def load(view: View, run: str) -> tuple[Any, LedgerRun | None] | None:
    """Return what was known of the run, and its events after that, if any; None if no snapshot counts."""
    try:
        line, _, data = place(view.path, run).read_bytes().partition(b"\n")
        found = msgspec.json.decode(line, type=Snapshot)
    except (OSError, msgspec.DecodeError, UnicodeDecodeError):
        return None
    if (found.run, found.code, found.sha256) != (run, _code(), hashlib.sha256(data).hexdigest()):
        return None
    commit = view.commits.ending_at(found.size)
    if commit is None or commit.tree_root != found.root:
        return None
    pieces: list[LedgerRun] = []
    for table in view.tables_from(found.size, SCHEMA.names):
        mine = table.filter(pc.equal(table.column("run_id"), run))
        pieces += decode(mine, is_whole=False) if mine.num_rows else ()
    return _Known(io.BytesIO(data)).load(), joined(pieces) if pieces else None


class Hold:
    """Holds a run for this process, until it is released: a lock, which the system releases with the process.

    It is one of a process (`lockf`), so that a federation that was dropped without being closed holds up no later one
    of the same process. Where a disk has no locks, or no place for the file, a second process is found when it commits.

    Raises: UsageError if another process holds it.
    """

    def __init__(self, ledger: Path, run: str) -> None:
        self._handle: int | None = None
        lock = place(ledger, run).with_suffix(".lock")
        with suppress(OSError):
            lock.parent.mkdir(exist_ok=True)
            self._handle = os.open(lock, os.O_RDWR | os.O_CREAT, 0o666)
        if self._handle is None:
            return
        try:
            fcntl.lockf(self._handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except (BlockingIOError, PermissionError) as error:
            self.release()
            raise UsageError(
                f"{ledger}: run {value(run)}: found that another process governs it, expected none; stop that one "
                "first, or give this run another name"
            ) from error
        except OSError:
            return  # no locks here

    def release(self) -> None:
        """Let another process govern the run."""
        if self._handle is not None:
            os.close(self._handle)
            self._handle = None


class _Known(pickle.Unpickler):
    """Reads values alone: a file that somebody else wrote must not run anything."""

    def find_class(self, module: str, name: str) -> Any:
        found = (
            super().find_class(module, name) if (module, name) in _LIBRARY or f"{module}.".startswith(_KNOWN) else None
        )
        if isinstance(found, type) or (module, name) in _LIBRARY:
            return found
        raise pickle.UnpicklingError(f"found {module}.{name}, expected a value")


def state_sha256(stands: object) -> str:
    """Return the digest, in hex, of where a run stands (`Kernel.stands`): SHA-256 of it as JSON.

    A structure is its name and the fields that are not as by default, so that one more field with a default changes
    nothing. Members of a set are sorted; all else has an order of its own.

    Raises: TypeError for what is no value.
    """
    return hashlib.sha256(msgspec.json.encode(_plain(stands))).hexdigest()


def _plain(found: Any) -> Any:
    match found:
        case None | bool() | int() | float() | str():
            return found
        case tuple() | list() | deque():
            return [_plain(one) for one in found]
        case frozenset():
            return sorted(map(_plain, found), key=msgspec.json.encode)
        case Mapping():
            return [[_plain(key), _plain(one)] for key, one in found.items()]
        case msgspec.Struct():
            return [type(found).__name__, *_unusual(found)]
        case State():
            return _unusual(found)
        case _:
            raise TypeError(f"found {type(found).__name__}, expected a value")


def _unusual(found: Any) -> list[Any]:
    """Return the fields that have other values than by default."""
    kind: Any = type(found)
    pairs = ((name, getattr(found, name), usual) for name, _, usual in _fields(kind))
    return [[name, _plain(own)] for name, own, usual in pairs if type(own) is not type(usual) or own != usual]


@cache
def _fields(kind: Any) -> tuple[tuple[str, Any, Any], ...]:
    """Return the name, type and default of each field; `msgspec.NODEFAULT` where there is none."""
    if kind is State:
        initial = State()
        return tuple((slot, SLOTS[slot], getattr(initial, slot)) for slot in sorted(SLOTS))
    return tuple(
        (one.name, one.type, one.default if one.default_factory is msgspec.NODEFAULT else one.default_factory())
        for one in msgspec.structs.fields(kind)
    )


def shape_of(kinds: Iterable[Any]) -> str:
    """Return the shape of these types and of those of their fields: 16 hex digits, of all names, types and defaults.

    Where it is another one, `state_sha256` of the same state may be, too.
    """
    known: dict[Any, Any] = {}
    for kind in kinds:
        _type_text(kind, known)
    lines = sorted({msgspec.json.encode(one) for one in known.values()})
    return hashlib.sha256(b"\n".join(lines)).hexdigest()[:16]


def _type_text(kind: Any, known: dict[Any, Any]) -> str:
    """Return the type as text, the same in every version of Python, and add its fields to what is known of types."""
    origin, of = get_origin(kind) or kind, get_args(kind)
    if isinstance(kind, NewType):
        return _type_text(kind.__supertype__, known)
    if origin is Annotated:
        return _type_text(of[0], known)
    if origin is Literal:
        return "|".join(sorted({type(one).__name__ for one in of}))
    texts = [_type_text(one, known) for one in of]
    if origin in (Union, UnionType):
        return "|".join(sorted({*texts}))
    name = "..." if origin is Ellipsis else origin.__name__
    if origin not in known and (origin is State or isinstance(origin, type(msgspec.Struct))):
        known[origin] = None  # it may be a field of itself
        fields = [
            [field, _type_text(of, known), None if usual is msgspec.NODEFAULT else [_plain(usual)]]
            for field, of, usual in _fields(origin)
        ]
        known[origin] = [name, *fields]
    return f"{name}[{', '.join(texts)}]" if texts else name


@cache
def _code() -> str:
    """Return the digest of the code that makes a run."""
    package, digest = Path(__file__).parents[1], hashlib.sha256()
    for room in _ROOMS:
        for path in sorted((package / room).rglob("*.py")):
            digest.update(f"{path.relative_to(package)}\n".encode() + path.read_bytes())
    return digest.hexdigest()
