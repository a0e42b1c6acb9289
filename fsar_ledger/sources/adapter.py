"""What reads a format: the records of a source, and the typed events that follow from them.

An adapter is made for one import and keeps what it has seen in it. Others publish their own under the entry point
`fsar_ledger.sources`, as a class without arguments.
"""

from collections.abc import Iterable, Iterator, Mapping
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, BinaryIO, Literal, NamedTuple, Protocol

from fsar_ledger.base.errors import UsageError
from fsar_ledger.base.printable import did_you_mean, value
from fsar_ledger.events import Event

ENTRY_POINTS = "fsar_ledger.sources"


class Input(NamedTuple):
    """A file of the source, opened, and its name; `path` is None for standard input."""

    name: str
    path: Path | None
    file: BinaryIO


class Record(NamedTuple):
    """One record of the input, as it was read.

    `kind` is what the source calls it, `values` what it says and `objects` what it is about, by name, each with its
    part. `raw` are its bytes, `data` whatever the adapter needs to derive events from it. A record that could not be
    read has no data, and its kind is `unreadable`.

    Units: `source_us` and `arrival_us` microseconds since 1970 in UTC, by the clock of the source and of whoever
    received it; None: not told.
    """

    kind: str
    raw: bytes
    data: Any = None
    values: Mapping[str, str] = {}
    objects: Mapping[str, str] = {}
    source_us: int | None = None
    arrival_us: int | None = None


class Derived(NamedTuple):
    """An event that follows from a record.

    It is caused by that record, or by the last event that was derived with the key `cause`; `key` is its own.
    """

    event: Event
    key: str | None = None
    cause: str | None = None


class Adapter(Protocol):
    """Reads one format."""

    name: str
    version: str
    clock: Literal["arrival", "source"]
    is_sampled: bool

    @property
    def format(self) -> str:
        """The format and its version, as in `vda5050/2.1.0`; what it is taken to be before any record was read."""
        ...

    def declares(self) -> Iterable[str]:
        """Return what the source records completely: concerns, event types and fields, as `Recorder` takes them."""
        ...

    def read(self, inputs: Iterable[Input]) -> Iterator[Record]:
        """Yield every record of the inputs, in order: also those that cannot be read.

        Raises: UsageError for an input that is not of the format at all.
        """
        ...

    def derive(self, record: Record) -> Iterable[Derived] | None:
        """Return what follows from the record; nothing, if it is understood and says nothing; None if it is not."""
        ...


UNREADABLE = "unreadable"


def unreadable(raw: bytes, why: object) -> Record:
    """Return a record of what could not be read."""
    return Record(UNREADABLE, raw, values={"why": f"{why!s:.200}"})


OWN = tuple(
    EntryPoint(name, f"fsar_ledger.sources.{name}:{name.capitalize()}", ENTRY_POINTS)
    for name in ("mcap", "ocel", "otlp", "rmf", "vda5050")
)
"""The adapters that come with the package; they need no installed metadata."""


def adapter_named(name: str) -> Adapter:
    """Return a new adapter of this name.

    Raises: UsageError if there is none, or if what it needs is not installed.
    """
    found = {one.name: one for one in (*OWN, *entry_points(group=ENTRY_POINTS))}
    if name not in found:
        raise UsageError(
            f"--as {value(name)}: found no adapter of that name, expected one of {', '.join(sorted(found))}"
            f"{did_you_mean(name, found)}; or describe the format in a mapping (--with)"
        )
    try:
        made: Adapter = found[name].load()()
    except ModuleNotFoundError as error:
        raise UsageError(
            f"--as {name}: found no module {error.name}, which it needs; install it with `pip install "
            f"'fsar-ledger[{name}]'`"
        ) from error
    return made
