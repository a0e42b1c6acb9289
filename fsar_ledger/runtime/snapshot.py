"""Files beside the ledger of a live run: a snapshot of the run, and the lock of the process that governs it.

A run continues from its snapshot instead of being rebuilt from its beginning. A snapshot is derived and disposable. It
is valid for one prefix of one ledger and one version of the code; later events of the ledger are rebuilt and compared.
A damaged, old or foreign snapshot is ignored.
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
from fsar_ledger.ledger.store.paths import beside
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
    """What a snapshot is valid for: run, size and root of the ledger, and code; and the SHA-256 of its data."""

    run: str
    size: int
    root: str
    code: str
    sha256: str


def save(ledger: Path, run: str, head: Head, known: object) -> None:
    """Save the state of the run at this head of the ledger. A disk error is ignored."""
    data = pickle.dumps(known, protocol=5)
    line = msgspec.json.encode(Snapshot(run, head.size, head.root, _code(), hashlib.sha256(data).hexdigest()))
    path = snapshot_path(ledger, run)
    temporary = path.with_suffix(f".{os.getpid()}")
    with suppress(OSError):
        path.parent.mkdir(exist_ok=True)
        with temporary.open("wb") as file:
            file.writelines((line, b"\n", data))
        temporary.replace(path)


def drop(ledger: Path, run: str) -> None:
    """Remove the snapshot of a run that continues as another one. A disk error is ignored."""
    with suppress(OSError):
        snapshot_path(ledger, run).unlink()


def snapshot_path(ledger: Path, run: str) -> Path:
    """Return the path of the run's snapshot."""
    return beside(ledger, ".snapshots") / hashlib.sha256(run.encode()).hexdigest()[:16]


def load(view: View, run: str) -> tuple[Any, LedgerRun | None] | None:
    """Return the saved state of the run, and its events since then, if any; None without a valid snapshot."""
    try:
        line, _, data = snapshot_path(view.path, run).read_bytes().partition(b"\n")
        snapshot = msgspec.json.decode(line, type=Snapshot)
    except (OSError, msgspec.DecodeError, UnicodeDecodeError):
        return None
    if (snapshot.run, snapshot.code, snapshot.sha256) != (run, _code(), hashlib.sha256(data).hexdigest()):
        return None
    commit = view.commits.ending_at(snapshot.size)
    if commit is None or commit.tree_root != snapshot.root:
        return None
    pieces: list[LedgerRun] = []
    for table in view.tables_from(snapshot.size, SCHEMA.names):
        rows = table.filter(pc.equal(table.column("run_id"), run))
        pieces += decode(rows, is_whole=False) if rows.num_rows else ()
    return _Known(io.BytesIO(data)).load(), joined(pieces) if pieces else None


class Hold:
    """The lock by which this process governs a run, until released; the system releases it with the process.

    It belongs to the process (`lockf`), so that a federation that was never closed does not block a later one of the
    same process. Without locks on the disk, or room for the file, a second process is detected when it commits.

    Raises: UsageError if another process holds it.
    """

    def __init__(self, ledger: Path, run: str) -> None:
        self._handle: int | None = None
        lock = snapshot_path(ledger, run).with_suffix(".lock")
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
            return  # the file system has no locks

    def release(self) -> None:
        """Let another process govern the run."""
        if self._handle is not None:
            os.close(self._handle)
            self._handle = None


class _Known(pickle.Unpickler):
    """Unpickles plain values only: a file written by somebody else must not run code."""

    def find_class(self, module: str, name: str) -> Any:
        value_type = (
            super().find_class(module, name) if (module, name) in _LIBRARY or f"{module}.".startswith(_KNOWN) else None
        )
        if isinstance(value_type, type) or (module, name) in _LIBRARY:
            return value_type
        raise pickle.UnpicklingError(f"found {module}.{name}, expected a value")


def state_sha256(stands: object) -> str:
    """Return the digest of a run's state (`Kernel.stands`): SHA-256 of its JSON, in hex.

    A structure is written as its name and its fields without defaults, so that a new field with a default changes
    nothing. Members of a set are sorted; everything else keeps its order.

    Raises: TypeError for anything but values.
    """
    return hashlib.sha256(msgspec.json.encode(_plain(stands))).hexdigest()


def _plain(part: Any) -> Any:
    match part:
        case None | bool() | int() | float() | str():
            return part
        case tuple() | list() | deque():
            return [_plain(item) for item in part]
        case frozenset():
            return sorted(map(_plain, part), key=msgspec.json.encode)
        case Mapping():
            return [[_plain(key), _plain(item)] for key, item in part.items()]
        case msgspec.Struct():
            return [type(part).__name__, *_unusual(part)]
        case State():
            return _unusual(part)
        case _:
            raise TypeError(f"found {type(part).__name__}, expected a value")


def _unusual(part: Any) -> list[Any]:
    """Return the fields whose values are not their defaults."""
    kind: Any = type(part)
    pairs = ((name, getattr(part, name), default) for name, _, default in _fields(kind))
    return [[name, _plain(own)] for name, own, default in pairs if type(own) is not type(default) or own != default]


@cache
def _fields(kind: Any) -> tuple[tuple[str, Any, Any], ...]:
    """Return the name, type and default of each field; `msgspec.NODEFAULT` where there is none."""
    if kind is State:
        initial = State()
        return tuple((slot, SLOTS[slot], getattr(initial, slot)) for slot in sorted(SLOTS))
    return tuple(
        (
            field.name,
            field.type,
            field.default if field.default_factory is msgspec.NODEFAULT else field.default_factory(),
        )
        for field in msgspec.structs.fields(kind)
    )


def shape_of(kinds: Iterable[Any]) -> str:
    """Return a digest (16 hex digits) of these types: names, types and defaults of all fields, recursively.

    If it differs, so may `state_sha256` of the same state.
    """
    known: dict[Any, Any] = {}
    for kind in kinds:
        _type_text(kind, known)
    lines = sorted({msgspec.json.encode(text) for text in known.values()})
    return hashlib.sha256(b"\n".join(lines)).hexdigest()[:16]


def _type_text(kind: Any, known: dict[Any, Any]) -> str:
    """Return the type as text, the same in every version of Python, and add its fields to `known`."""
    origin, of = get_origin(kind) or kind, get_args(kind)
    if isinstance(kind, NewType):
        return _type_text(kind.__supertype__, known)
    if origin is Annotated:
        return _type_text(of[0], known)
    if origin is Literal:
        return "|".join(sorted({type(option).__name__ for option in of}))
    texts = [_type_text(argument, known) for argument in of]
    if origin in (Union, UnionType):
        return "|".join(sorted({*texts}))
    name = "..." if origin is Ellipsis else origin.__name__
    if origin not in known and (origin is State or isinstance(origin, type(msgspec.Struct))):
        known[origin] = None  # it may be a field of itself
        fields = [
            [field, _type_text(of, known), None if default is msgspec.NODEFAULT else [_plain(default)]]
            for field, of, default in _fields(origin)
        ]
        known[origin] = [name, *fields]
    return f"{name}[{', '.join(texts)}]" if texts else name


@cache
def _code() -> str:
    """Return a digest of the code that decides a run."""
    package, digest = Path(__file__).parents[1], hashlib.sha256()
    for room in _ROOMS:
        for path in sorted((package / room).rglob("*.py")):
            digest.update(f"{path.relative_to(package)}\n".encode() + path.read_bytes())
    return digest.hexdigest()
