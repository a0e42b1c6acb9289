"""Where a foreign run comes from, and each record of its source as it was read.

Typed events are derived from these records and caused by them. A record without a typed event is kept all the same, so
nothing of an input is lost silently. None of these types is evidence that something did not happen.
"""

from typing import Literal

from .envelope import Event


class SourceOpened(Event, frozen=True, kw_only=True):
    """A source of records was opened.

    `format` is the format and its version (`vda5050/3.0.0`), `adapter` the reader and its version; the hashes (SHA-256,
    hex) are of the input and of the mapping that was used, if there is one. With the `clock` `source`, events have the
    time that the source gives; with `arrival`, the time at which the record arrived, and the source's own time is kept
    beside it. A source that `is_sampled` reports states from time to time; what happens in between is unknown.
    """

    source: str
    format: str
    adapter: str
    clock: Literal["arrival", "source"]
    is_sampled: bool = False
    input_sha256: str | None = None
    mapping_sha256: str | None = None


class Observed(Event, frozen=True, kw_only=True):
    """One record of a source, as it was read.

    `kind` is what the source calls it (`actionStatus/RUNNING`). `names` and `texts`, which are aligned, are its
    content; `objects` and `qualifiers`, also aligned, are what it is about, as in OCEL 2.0. `record_sha256` is the hash
    of the raw record, `record_number` its position in the input from 1; `body` is the raw record, kept only on request.

    Units: `source_time_us` microseconds of run time on the source's clock, which may be wrong; None if it gives none.
    """

    source: str
    kind: str
    names: tuple[str, ...] = ()
    texts: tuple[str, ...] = ()
    objects: tuple[str, ...] = ()
    qualifiers: tuple[str, ...] = ()
    source_time_us: int | None = None
    record_number: int | None = None
    record_sha256: str | None = None
    body: str | None = None


class SourceClosed(Event, frozen=True, kw_only=True):
    """The source has no more records: what is open now has no known end, which is not a failure.

    `record_count` is the number of its records, `gaps` are spans in which it may have missed some (`START..END`).

    Units: `until_us` and the ends of gaps microseconds of run time; `until_us` is how far it was observed.
    """

    source: str
    until_us: int
    record_count: int
    gaps: tuple[str, ...] = ()
