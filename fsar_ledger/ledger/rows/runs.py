"""Runs as they are passed to a writer, their limits, and how they are split into pieces and joined again.

msgspec constructors do not check types, so an event may contain anything. The codec detects by column that a batch has
a bad value; the functions here then search for it value by value, to report its run, seq and field.
"""

from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain
from typing import NamedTuple

import msgspec

from fsar_ledger.base import printable
from fsar_ledger.base.errors import InvalidRun, LedgerCorrupted, UsageError
from fsar_ledger.base.parameters import BadParameters, read_parameters
from fsar_ledger.events import Event
from fsar_ledger.events.envelope import flat
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.ledger.rows.bounds import MAX_NAME_BYTES
from fsar_ledger.ledger.rows.schema import LAYOUTS, MAX_INTEGER, Field, Kind


class LedgerRun(msgspec.Struct, frozen=True):
    """One run in memory, or a part of it: its events, and one time and one cause for each.

    The seq of an event is its index, counted from `first`; that is 0 unless the run continues in this commit from an
    earlier one, as runs of a ledger may. `goes_on` is whether later commits may extend it.
    """

    run_id: str
    times_us: Sequence[int]
    caused_by: Sequence[int | None]
    events: Sequence[Event]
    first: int = 0
    goes_on: bool = False


def start_of(record: LedgerRun) -> RunStarted:
    """Return the run's first event. Raises: UsageError if it is the plan of an experiment, in which nothing happens."""
    started = record.events[0]
    if not isinstance(started, RunStarted):
        name = printable.value(record.run_id)
        raise UsageError(f"{name}: found the plan of an experiment, expected a run; `query runs` lists them")
    return started


def until(record: LedgerRun, time_us: int) -> LedgerRun:
    """Return the part of the record up to this time, inclusive."""
    count = bisect_right(record.times_us, time_us)
    parts = record.times_us[:count], record.caused_by[:count], record.events[:count]
    return LedgerRun(record.run_id, *parts)


def parts_at(first: LedgerRun, second: LedgerRun) -> int | None:
    """Return the first seq after 0 at which two records differ in event, time or cause; None if there is none."""
    events: Sequence[Event] = first.events
    length = min(len(events), len(second.events))
    if (
        events[1:length] == second.events[1:length]
        and first.times_us[1:length] == second.times_us[1:length]
        and first.caused_by[1:length] == second.caused_by[1:length]
    ):
        return None if len(events) == len(second.events) else length
    return next(
        seq
        for seq in range(1, length)
        if first.times_us[seq] != second.times_us[seq]
        or first.caused_by[seq] != second.caused_by[seq]
        or events[seq] != second.events[seq]
    )


class Flaw(msgspec.Struct, frozen=True):
    """The first flaw in some rows. `row` counts from 0 within the table; -1 means the table as a whole."""

    row: int
    run: str | None
    seq: int | None
    field: str | None
    found: str
    expected: str

    def __str__(self) -> str:
        where = [f"run {printable.value(self.run)}, seq {self.seq}"] if self.run is not None else []
        where += [f"field {self.field}"] if self.field is not None else []
        return f"{', '.join(where) or 'table'}: found {self.found}, expected {self.expected}"


class Allowed(NamedTuple):
    """The allowed values of a field of an event: exactly of this type, or None if `is_nullable`.

    Elements of a tuple are exactly strings. With a closed list, only its values are allowed.
    """

    type: type
    is_nullable: bool
    values: frozenset[str | None] | None


TIME, CAUSE = Allowed(int, False, None), Allowed(int, True, None)
_ONLY_STRINGS = frozenset({str})
_TYPES: dict[Kind, type] = {"string": str, "integer": int, "boolean": bool, "strings": tuple}


def _allowed(field: Field) -> Allowed:
    return Allowed(
        _TYPES[field.kind], field.is_nullable, None if field.values is None else frozenset({*field.values, None})
    )


ALLOWED: dict[str, tuple[Allowed, ...]] = {
    layout.tag: tuple(map(_allowed, layout.fields)) for layout in LAYOUTS.values()
}
"""The allowed values of the fields of each event type, in the order of its constructor. They are derived from the
structs, as is all that `check` expects of stored rows.
"""


def are_allowed(values: Sequence[object], allowed: Allowed) -> bool:
    """Return whether each of these values is allowed in a field.

    The size of integers and surrogates in strings are checked by column instead.
    """
    kind, is_nullable, closed = allowed
    types = list(map(type, values))  # the fastest way to check each
    if (of_kind := types.count(kind)) != len(types) and not (
        is_nullable and of_kind + types.count(type(None)) == len(types)
    ):
        return False
    if kind is tuple and not _are_strings(chain.from_iterable(filter(None, values))):  # type: ignore[arg-type]
        return False
    return closed is None or closed.issuperset(values)


def _are_strings(values: Iterable[object]) -> bool:
    return set(map(type, values)) <= _ONLY_STRINGS


def require_runs(runs: Sequence[LedgerRun]) -> None:
    """Check that each run has events, as many times and causes, and a unique name.

    Raises: InvalidRun if not.
    """
    seen: set[str] = set()
    for run in runs:
        if type(run.run_id) is not str:
            raise InvalidRun(f"field run_id: found {run.run_id!r:.80}, expected a string; give each run a name")
        if not _is_unicode(run.run_id):
            raise InvalidRun(
                f"field run_id: found {run.run_id!r:.80}, expected text without surrogates; give each run a name that "
                "can be stored"
            )
        sizes = len(run.events), len(run.times_us), len(run.caused_by)
        if not sizes[0] == sizes[1] == sizes[2] or not sizes[0]:
            lengths = "{} events, {} times and {} causes".format(*sizes)
            raise InvalidRun(
                f"run {printable.value(run.run_id)}: found {lengths}, expected as many of each, at least 1; append "
                "finished runs only"
            )
        if run.run_id in seen:
            raise refusal(Flaw(-1, run.run_id, 0, "run_id", "the run twice in one batch", "each run once"))
        seen.add(run.run_id)


def refusal(flaw: Flaw) -> InvalidRun:
    """Return the error for this flaw."""
    return InvalidRun(f"{flaw}; nothing was written: correct the run")


def first_unfit(runs: Sequence[LedgerRun]) -> Flaw | None:
    """Return the flaw of the first value that no row can hold, run by run and event by event; None if there is none."""
    return next(
        (
            Flaw(-1, run.run_id, run.first + index, *unfit)
            for run in runs
            for index in range(len(run.events))
            for unfit in _unfit(run, index)
        ),
        None,
    )


def unreadable(runs: Sequence[LedgerRun]) -> Flaw | None:
    """Return the flaw of the first run whose parameters cannot be read as constants; None if there is none.

    Readers accept it, because 0.1.0 and 0.2.0 stored any text.
    """
    for run in runs:
        text = getattr(run.events[0], "parameters", None)
        try:
            if text is not None:
                read_parameters(text)
        except BadParameters:
            return Flaw(-1, run.run_id, 0, "parameters", f"{text!r:.80}", "constants as a JSON object, or None")
    return None


def overlong(runs: Sequence[LedgerRun]) -> Flaw | None:
    """Return the flaw of the first run whose name is longer than readers accept; None if there is none."""
    for run in runs:
        if (size := len(run.run_id.encode())) > MAX_NAME_BYTES:
            return Flaw(-1, run.run_id, 0, "run_id", f"a name of {size} bytes", f"at most {MAX_NAME_BYTES}")
    return None


def _unfit(run: LedgerRun, index: int) -> Iterator[tuple[str, str, str]]:
    """Yield each fault of the event at this index: field, found, expected."""
    for name, value, allowed in (("time_us", run.times_us[index], TIME), ("caused_by", run.caused_by[index], CAUSE)):
        yield from _unfit_value(name, value, allowed)
    cause, event, seq = run.caused_by[index], run.events[index], run.first + index
    if cause is not None and seq == 0:
        yield "caused_by", f"{cause!r:.80}", "None, as nothing came before"
    if cause is not None and seq > 0 and not 0 <= cause < seq:
        yield "caused_by", f"{cause!r:.80}", "the seq of an earlier event, or None if that is not known"
    tag = str(event.__struct_config__.tag) if isinstance(event, Event) else ""
    if tag not in LAYOUTS or type(event) is not LAYOUTS[tag].cls:
        yield "type", f"{type(event).__name__} {tag}".strip(), "an event of a type that is written today"
        return
    for member in LAYOUTS[tag].members:
        part = getattr(event, member.name)
        if member.part is not None and type(part) is not member.part:
            yield member.name, f"{part!r:.80}", f"a value: {member.part.__name__}, and no other class"
            return
    values = flat(event)
    for field, allowed in zip(LAYOUTS[tag].fields, ALLOWED[tag], strict=True):
        yield from _unfit_value(field.name, values[field.name], allowed)


def _unfit_value(name: str, value: object, allowed: Allowed) -> Iterator[tuple[str, str, str]]:
    kind, is_nullable, closed = allowed
    quoted = f"{value!r:.80}"
    if type(value) is not kind and not (value is None and is_nullable):
        yield name, quoted, f"a value: {kind.__name__}{' or None' * is_nullable}, and no other class"
    elif closed is not None and value not in closed:
        yield name, quoted, f"one of {sorted(filter(None, closed))}"
    elif isinstance(value, int) and abs(value) > MAX_INTEGER:
        yield name, quoted, "at most 2^53 - 1 in size"
    else:
        texts = value if isinstance(value, tuple) else (value,) if isinstance(value, str) else ()
        for text in texts:
            if type(text) is not str:
                yield name, quoted, "strings in the tuple, and no other class"
            elif not _is_unicode(text):
                yield name, quoted, "text without surrogates"


def _is_unicode(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def joined(pieces: Sequence[LedgerRun]) -> LedgerRun:
    """Join these pieces of one run, each of which continues the one before."""
    if len(pieces) == 1:
        return pieces[0]
    return LedgerRun(
        pieces[0].run_id,
        list(chain.from_iterable(part.times_us for part in pieces)),
        list(chain.from_iterable(part.caused_by for part in pieces)),
        list(chain.from_iterable(part.events for part in pieces)),
        pieces[0].first,
        pieces[-1].goes_on,
    )


def continuing(parts: Sequence[LedgerRun]) -> LedgerRun:
    """Join runs, each of which continues the one before, into one run with the name of the last.

    Its seqs are consecutive: event 0 of each run but the first, which equals that of the first, is omitted.

    Raises: LedgerCorrupted if one has another event 0.
    """
    pieces, size = [parts[0]], len(parts[0].events)
    for part in parts[1:]:
        require_alike(part, parts[0].events[0], parts[0].run_id)
        pieces.append(counted_on(part, size - 1))
        size += len(pieces[-1].events)
    return msgspec.structs.replace(joined(pieces), run_id=parts[-1].run_id)


def require_alike(part: LedgerRun, started: Event, before: str) -> None:
    """Require that a run begins with the same event as the one that it continues. Raises: LedgerCorrupted if not."""
    if part.events[0] != started:
        raise LedgerCorrupted(unlike_beginning(part.run_id, before))


def unlike_beginning(run: str, before: str) -> str:
    """Return the message that a run begins differently from the one that it continues."""
    return (
        f"run {printable.value(run)}, seq 0: found another event than event 0 of run {printable.value(before)}, which "
        "it continues, expected the same; run fsar-ledger verify --replay"
    )


def counted_on(part: LedgerRun, by: int) -> LedgerRun:
    """Return a part of a run that continues another, with its seqs shifted by `by` and without its event 0."""
    skipped = 0 if part.first else 1
    causes = [cause + by if cause else cause for cause in part.caused_by[skipped:]]
    return LedgerRun(
        part.run_id, part.times_us[skipped:], causes, part.events[skipped:], part.first + skipped + by, part.goes_on
    )


def whole_run(pieces: Sequence[LedgerRun]) -> LedgerRun:
    """Join all pieces of a run in a ledger. Raises: LedgerCorrupted if one of them is missing."""
    next_seq = 0
    for part in pieces:
        require_next(part, next_seq)
        next_seq += len(part.events)
    return joined(pieces)


def require_next(part: LedgerRun, seq: int) -> None:
    """Require that a part of a run begins with this seq. Raises: LedgerCorrupted if not."""
    if part.first != seq:
        raise LedgerCorrupted(
            f"run {printable.value(part.run_id)}: found event {part.first} where event {seq} is expected; run "
            "fsar-ledger verify"
        )


def gathered(parts: Iterable[tuple[int, Sequence[LedgerRun]]], last: Mapping[str, int]) -> Iterator[LedgerRun]:
    """Yield each run that is in these parts of a ledger, once all its pieces are read.

    Args:
        parts: The end index in the ledger of each part, and its pieces of runs.
        last: The start index of the last piece of each run that may be in several parts.

    Raises: As `whole_run`.
    """
    pending: dict[str, list[LedgerRun]] = {}
    for end, pieces in parts:
        for part in pieces:
            pending.setdefault(part.run_id, []).append(part)
        for run in [run for run in pending if last.get(run, 0) < end]:
            yield whole_run(pending.pop(run))


def piece(run: LedgerRun, at: int, end: int) -> LedgerRun:
    """Return the part of a run between these indexes of its events; it `goes_on` unless they are its last."""
    if (at, end) == (0, len(run.events)):
        return run
    return LedgerRun(
        run.run_id,
        run.times_us[at:end],
        run.caused_by[at:end],
        run.events[at:end],
        run.first + at,
        end < len(run.events) or run.goes_on,
    )


def is_same_batch(times_us: Sequence[int], caused_by: Sequence[int | None], seq: int) -> bool:
    """Return whether the event belongs to the batch of the event before it."""
    cause = caused_by[seq]
    return cause is not None and times_us[cause] == times_us[seq]
