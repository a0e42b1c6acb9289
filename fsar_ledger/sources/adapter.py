"""Readers of formats, the records of a source, the typed events that follow from them, and the inputs.

An adapter is made for one import and keeps what it has seen in it. Others publish their own under the entry point
`fsar_ledger.sources`, as a class without arguments. Most formats are lines of JSON, read one at a time: an unreadable
line is reported, and the lines after it are read all the same.
"""

import io
import json
import os
import sys
import tomllib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from copy import deepcopy
from hashlib import sha256
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, BinaryIO, Literal, NamedTuple, Protocol, TypeVar

import msgspec

from fsar_ledger.base.errors import UsageError, option
from fsar_ledger.base.printable import did_you_mean, value
from fsar_ledger.events import Event

ENTRY_POINTS = "fsar_ledger.sources"
MAX_LINE = 1 << 24
"""The most bytes of a line; no known source has longer records."""

LOOKED_AT = 100
"""The records at the beginning of an input of which at least one must be of the format."""

BOM = b"\xef\xbb\xbf"
COMPRESSED = {b"\x1f\x8b": "zcat", b"\x28\xb5\x2f\xfd": "zstdcat", b"BZh": "bzcat", b"\xfd7zXZ\x00": "xzcat"}
"""The first bytes of a compressed file, and the command that writes it uncompressed."""

One = TypeVar("One")
BROKEN = (msgspec.DecodeError, UnicodeDecodeError, RecursionError, UsageError)
"""What reading JSON raises."""
RAW_OBJECT = msgspec.json.Decoder(dict[str, msgspec.Raw])
RAW_LIST = msgspec.json.Decoder(list[msgspec.Raw])
OBJECT = msgspec.json.Decoder(dict[str, Any])


class Input(NamedTuple):
    """A file of the source, opened, and its name; `path` is None for standard input."""

    name: str
    path: Path | None
    file: BinaryIO


class Record(NamedTuple):
    """One record of the input, as it was read.

    `kind` is what the source calls it, `values` what it says and `objects` what it is about, by name, each with its
    part. `raw` are its bytes, `data` whatever the adapter needs to derive events from it. A record that could not be
    read has no data, and its kind is `unreadable`. `line` are the bytes of the line if this is the first of several
    records in it: while the line was still being written, it was one record.

    Units: `source_us` and `arrival_us` microseconds since 1970 in UTC, by the clocks of the source and of the
    receiver; None: unknown.
    """

    kind: str
    raw: bytes
    data: Any = None
    values: Mapping[str, str] = {}
    objects: Mapping[str, str] = {}
    source_us: int | None = None
    arrival_us: int | None = None
    line: bytes | None = None


class Derived(NamedTuple):
    """An event that follows from a record.

    It is caused by that record, or by the last event that was derived with the key `cause`; `key` is its own.
    """

    event: Event
    key: str | None = None
    cause: str | None = None


class Adapter(Protocol):
    """A reader of one format."""

    name: str
    version: str
    clock: Literal["arrival", "source"]
    is_sampled: bool

    @property
    def format(self) -> str:
        """The format and its version, as in `vda5050/2.1.0`; presumed until a record was read."""
        ...

    def declares(self) -> Iterable[str]:
        """Return what the source records completely: concerns, event types and fields, as `Recorder` takes them."""
        ...

    def read(self, inputs: Iterable[Input]) -> Iterator[Record]:
        """Yield every record of the inputs, in order, including unreadable ones.

        Raises: UsageError for an input that is not of the format at all.
        """
        ...

    def derive(self, record: Record) -> Iterable[Derived] | None:
        """Return the events that follow from the record, if any; None if it is not understood."""
        ...


MEMBERS = (*Adapter.__annotations__, *(name for name in vars(Adapter) if not name.startswith("_")))
UNREADABLE = "unreadable"


def unreadable(raw: bytes, why: object) -> Record:
    """Return a record of bytes that could not be read."""
    return Record(UNREADABLE, raw, values={"why": f"{why!s:.200}"})


OWN = tuple(
    EntryPoint(name, f"fsar_ledger.sources.{name}:{name.capitalize()}", ENTRY_POINTS)
    for name in ("mcap", "ocel", "otlp", "rmf", "vda5050")
)
"""The adapters that come with the package; they need no installed metadata."""


def _installed() -> dict[str, EntryPoint]:
    return {entry_point.name: entry_point for entry_point in (*OWN, *entry_points(group=ENTRY_POINTS))}


def adapter_named(name: str) -> Adapter:
    """Return a new adapter of this name. Raises: UsageError if there is none, or it or what it needs is not there."""
    adapters = _installed()
    if name not in adapters:
        raise UsageError(
            f"{option('format', value(name))}: found no adapter of that name, expected one of "
            f"{', '.join(sorted(adapters))}{did_you_mean(name, adapters)}; or describe it by {option('mapping')}"
        )
    point = adapters[name]
    try:
        kind = point.load()
    except (ModuleNotFoundError, AttributeError) as error:
        what = f"it with `pip install 'fsar-ledger[{name}]'`" if point in OWN else f"the package that has {point.value}"
        raise UsageError(f"{option('format', name)}: {error}, which it needs; install {what}") from error
    adapter: Adapter = kind()
    if missing := [one for one in MEMBERS if not hasattr(adapter, one)]:
        raise UsageError(f"{option('format', name)}: {point.value} lacks {', '.join(missing)}; correct the adapter")
    return adapter


STDIN = "-"


@contextmanager
def opened(logs: Sequence[str | os.PathLike[str]]) -> Iterator[list[Input]]:
    """Open these files; `-` is standard input.

    Raises: UsageError if there are none, or one cannot be read or comes twice.
    """
    if not logs:
        raise UsageError("import: found no file, expected at least one, or - for standard input")
    with ExitStack() as stack:
        inputs: list[Input] = []
        known: dict[tuple[int, ...], str] = {}
        for log in map(str, logs):
            path = Path(log)
            try:
                file = sys.stdin.buffer if log == STDIN else stack.enter_context(path.open("rb"))
            except OSError as error:
                raise UsageError(
                    f"{value(log)}: cannot be read ({error.strerror}); name a file, or - for standard input"
                ) from error
            is_file = log != STDIN and file.seekable()  # a pipe cannot be read twice
            if is_file and (file_id := os.fstat(file.fileno())[1:3]) in known:
                raise UsageError(f"{value(log)}: found the file {value(known[file_id])} again, expected each file once")
            known |= {file_id: log} if is_file else {}
            name = "pipe" if path.parent.name == "fd" else path.stem  # a shell numbers its pipes: /dev/fd/63
            inputs.append(Input("stdin" if log == STDIN else name, path if is_file else None, file))
        yield inputs


def adapter_of(name: str | None, mapping: Path | None) -> tuple[Adapter, str | None]:
    """Return the adapter of this name, or that of a mapping, and the SHA-256 of the mapping.

    Raises: UsageError unless exactly one of both is given; or as `adapter_named`.
    """
    if (name is None) == (mapping is None):
        found = "neither" if name is None else "both"
        names = ", ".join(sorted(_installed()))
        raise UsageError(
            f"import: found {found} of {option('format')} and {option('mapping')}, expected {names}, or a mapping"
        )
    if name is not None:
        return adapter_named(name), None
    assert mapping is not None
    from .mapping import mapped

    data = read(mapping)
    return mapped(mapping, data), sha256(data).hexdigest()


def looked(adapter: Adapter, inputs: Sequence[Input]) -> Adapter:
    """Let the adapter look at its inputs before there is a ledger, and before it declares anything.

    An adapter whose declarations depend on its inputs has a method `look`; for any other, files are read up to the
    first record. Each file is at its beginning afterwards.

    Raises: UsageError for files without a record, for a compressed one that it cannot read, or as `Adapter.read`.
    """
    for log in inputs:
        if (error := _compressed(log)) is not None and not _can_read(adapter, log):
            raise error
    if (look := getattr(adapter, "look", None)) is not None:
        look(inputs)
    elif all(log.path is not None for log in inputs):
        if next(iter(deepcopy(adapter).read(inputs)), None) is None:
            raise no_record(inputs)
        for log in inputs:
            log.file.seek(0)
    return adapter


def _compressed(log: Input) -> UsageError | None:
    """Return the error for a compressed file, None for any other input."""
    if log.path is None:
        return None
    head = log.file.read(max(map(len, COMPRESSED)))
    log.file.seek(0)
    for mark, writer in COMPRESSED.items():
        if head.startswith(mark):
            name = value(str(log.path))
            return UsageError(
                f"{name}: found a compressed file, expected one that is not; uncompress it, or give {STDIN} as "
                f"the file and pipe the output of `{writer} {name}`"
            )
    return None


def _can_read(adapter: Adapter, log: Input) -> bool:
    first = None
    with suppress(UsageError):
        first = next(iter(deepcopy(adapter).read([log])), None)
    log.file.seek(0)
    return first is not None and first.kind != UNREADABLE


class _Stream(io.RawIOBase):
    """A stream that calls `before_wait` before each read, which may block."""

    def __init__(self, file: BinaryIO, before_wait: Callable[[], None]) -> None:
        self._file, self._before_wait = file, before_wait

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        self._before_wait()
        read = getattr(self._file, "read1", self._file.read)
        data: bytes = read(len(buffer))
        buffer[: len(data)] = data
        return len(data)


def awaited(log: Input, before_wait: Callable[[], None]) -> Input:
    """Return the input; a stream calls `before_wait` before it waits for more."""
    return log if log.path is not None else log._replace(file=io.BufferedReader(_Stream(log.file, before_wait)))


def digest_of(inputs: Sequence[Input]) -> str | None:
    """Return the SHA-256 of the files' concatenated bytes; None if one is a stream."""
    if any(log.path is None for log in inputs):
        return None
    digest = sha256()
    for log in inputs:
        while block := log.file.read(1 << 20):
            digest.update(block)
        log.file.seek(0)
    return digest.hexdigest()


def no_record(inputs: Sequence[Input]) -> UsageError:
    """Return the error for empty inputs."""
    return UsageError(f"{value(inputs[0].name)}: found no record, expected at least one; import it when it has")


def read(path: Path) -> bytes:
    """Return the bytes of a file that a user named. Raises: UsageError if it cannot be read."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise UsageError(f"{value(str(path))}: cannot be read ({error.strerror})") from error


def named_robots(path: Path) -> dict[str, str]:
    """Return the role of each robot that a TOML file names under [robots].

    Raises: UsageError for a file without such a table of texts, with another table, or with a robot twice.
    """
    try:
        data = tomllib.loads(read(path).decode())
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UsageError(f"{value(str(path))}: {error}; expected TOML with a table [robots]") from error
    entries = list(_flat(data["robots"])) if isinstance(data.get("robots"), dict) else None
    if entries is None or data.keys() != {"robots"} or not all(isinstance(role, str) for _, role in entries):
        raise UsageError(
            f"{value(str(path))}: found {value(', '.join(data))}, expected only a table [robots] with a role for each "
            'name, as in `KIT.0001 = "agv"`'
        )
    names = Counter(name.removeprefix("robot/") for name, _ in entries)
    if twice := [name for name, count in names.items() if count > 1]:
        raise UsageError(f"{value(str(path))}: found robot {value(twice[0])} twice, expected each once")
    return dict(entries)


def _flat(table: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield the values by dotted name: TOML reads `KIT.0001 = "agv"` as a table KIT with a key 0001."""
    for name, entry in table.items():
        if isinstance(entry, dict):
            yield from ((f"{name}.{rest}", leaf) for rest, leaf in _flat(entry))
        else:
            yield name, entry


def lines(inputs: Iterable[Input]) -> Iterator[bytes]:
    """Yield the nonempty lines of the inputs without their ends; a line that is too long comes in parts."""
    for log in inputs:
        mark = BOM
        while line := log.file.readline(MAX_LINE):
            if line := line.removeprefix(mark).strip(b"\r\n"):
                yield line
            mark = b""


def objects(inputs: Iterable[Input]) -> Iterator[tuple[bytes, dict[str, Any]] | Record]:
    """Yield each line with its JSON object, or an unreadable record for a line without one."""
    for line in lines(inputs):
        if not line.strip():
            continue
        try:
            yield line, json_object(line)
        except BROKEN as error:
            yield unreadable(line, error)


def json_object(data: bytes | msgspec.Raw) -> dict[str, Any]:
    """Return the JSON object in these bytes.

    Raises: As `BROKEN`; UsageError if a key occurs twice, of which readers of JSON silently drop one.
    """
    document = OBJECT.decode(data)
    json.loads(bytes(data), object_pairs_hook=_require_once, parse_int=len, parse_float=len)
    return document


def _require_once(pairs: list[tuple[str, object]]) -> None:
    if len(keys := [key for key, _ in pairs]) > len(set(keys)):
        twice = next(key for index, key in enumerate(keys) if key in keys[:index])
        raise UsageError(f"field {value(twice)}: found it more than once, expected it once")


def require_format(
    found: Iterable[One], inputs: Sequence[Input], is_known: Callable[[One], bool], expected: str
) -> Iterator[One]:
    """Yield everything found, but nothing before one item is known to be of the format.

    Raises: UsageError if none of the first `LOOKED_AT` is, or none at all.
    """
    waiting, size = list[One](), 0
    items = iter(found)
    for item in items:
        waiting.append(item)
        size += len(item.raw) if isinstance(item, Record) else 0
        if is_known(item):
            yield from waiting
            yield from items
            return
        if len(waiting) >= LOOKED_AT or size >= MAX_LINE:
            break
    if waiting:
        first = waiting[0] if isinstance(waiting[0], Record) else Record("", b"")
        why = f" ({first.values['why']})" if first.kind == UNREADABLE else ""
        packed = [f"pipe it through `{writer}`" for mark, writer in COMPRESSED.items() if first.raw.startswith(mark)]
        advice = packed[0] if packed else "give the format that it has (--as, --with)"
        raise UsageError(
            f"{value(inputs[0].name)}: found {first.raw[:40]!r}{why} and no such record in the first "
            f"{len(waiting):,}, expected {expected}; nothing was recorded: {advice}"
        )


def json_text(found: object) -> str:
    """Return a value of JSON as text: a string as it is."""
    if isinstance(found, str):
        return found
    return f"{found}" if type(found) is int else msgspec.json.encode(found).decode()
