"""The differences of two runs in words: each of them, where the runs part with what led there, what they came to."""

from collections import Counter

import msgspec

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import flat
from fsar_ledger.ledger.rows.codec import LedgerRun, encode_coded
from fsar_ledger.metrics.database import from_table
from fsar_ledger.runtime.forks import until

from .difference import FIRST, KINDS, SECOND, Difference, OutcomesDiff, align, chain, outcomes_diff, until_the_end
from .records import Line, lines_from


class Parameter(msgspec.Struct, frozen=True):
    """A field of an event in which two runs differ, as text."""

    field: str
    first: str | None
    second: str | None


class DifferenceLine(msgspec.Struct, frozen=True):
    """A difference in words. `shift_s`: how much later the event is in the second run. Units: seconds of run time.

    None: the event is not in that run, or has no words there.
    """

    kind: str
    first_seq: int | None
    second_seq: int | None
    first_s: float | None
    second_s: float | None
    shift_s: float | None
    fields: str
    is_consequence: bool
    words: str


class FirstDifference(msgspec.Struct, frozen=True):
    """Where two runs part: the first event of each that is not the same in the other, with its chain of causes.

    Each chain begins with the event and goes back to a fact of the world; empty where all events of the run are the
    same in the other. `fields` are those that differ where both are the same event. Units: `at_s` seconds of run time;
    what a field named `_us` holds, microseconds.
    """

    at_s: float
    first: tuple[Line, ...]
    second: tuple[Line, ...]
    fields: tuple[Parameter, ...] = ()


class DifferenceText(msgspec.Struct, frozen=True, kw_only=True):
    """The differences of two runs; the fields are those of the answer of `diff`."""

    first: str
    second: str
    parameters: tuple[Parameter, ...]
    same: int
    counts: dict[str, int]
    differences: tuple[DifferenceLine, ...]
    parting: FirstDifference | None
    consequences: OutcomesDiff | None


def difference_text(first: LedgerRun, second: LedgerRun, ends_us: int | None = None) -> DifferenceText:
    """Return the differences of two records.

    With `ends_us` the second ends then, before all has happened: nothing later of the first is compared, and of what
    the second came to no more is told than had come about.

    Raises: as `Database.rows`.
    """
    whole, first = first, first if ends_us is None else until(first, ends_us)
    found = align(first, second)
    differing = [one for one in found.differences if (one.first_seq, one.second_seq) != (0, 0)]
    kinds = Counter(one.kind for one in differing)
    named = [msgspec.structs.replace(run, run_id=name) for name, run in ((FIRST, whole), (SECOND, second))]
    told: tuple[DifferenceLine, ...] = ()
    parting = after = None
    if differing:
        starts = _starts(differing)
        chains = [chain(run, seq) if seq is not None else [] for run, seq in zip((first, second), starts, strict=True)]
        with from_table(encode_coded(named)) as database:
            places = [(FIRST, one.first_seq) for one in differing if one.first_seq is not None]
            places += [(SECOND, one.second_seq) for one in differing if one.second_seq is not None]
            places += [(name, seq) for name, seqs in zip((FIRST, SECOND), chains, strict=True) for seq in seqs]
            lines = lines_from(database, places)
            after = outcomes_diff(database, whole, second, found.pairs)
        if ends_us is not None:
            after = until_the_end(after, ends_us)
        told = tuple(_told(one, first, second, lines) for one in differing)
        both = [tuple(lines[(name, seq)] for seq in seqs) for name, seqs in zip((FIRST, SECOND), chains, strict=True)]
        at_s = min(one.time_s for side in both for one in side[:1])
        parting = FirstDifference(at_s, both[0], both[1], _changed(first, second, starts, found.pairs))
    return DifferenceText(
        first=first.run_id,
        second=second.run_id,
        parameters=_parameters(first.events[0], second.events[0]),
        same=found.same + (len(found.differences) > len(differing)),
        counts={kind: kinds[kind] for kind in KINDS if kinds[kind]},
        differences=told,
        parting=parting,
        consequences=after,
    )


def _starts(differing: list[Difference]) -> tuple[int | None, int | None]:
    """Return the first event of each run that is not the same in the other."""
    firsts = [one.first_seq for one in differing if one.first_seq is not None]
    seconds = [one.second_seq for one in differing if one.second_seq is not None]
    return min(firsts, default=None), min(seconds, default=None)


def _changed(
    first: LedgerRun, second: LedgerRun, starts: tuple[int | None, int | None], pairs: dict[int, int]
) -> tuple[Parameter, ...]:
    """Return the fields in which the first differing events differ, if they are the same event."""
    one, other = starts
    if one is None or other is None or pairs.get(one) != other:
        return ()
    return _parameters(first.events[one], second.events[other])


def _told(one: Difference, first: LedgerRun, second: LedgerRun, lines: dict[tuple[str, int], Line]) -> DifferenceLine:
    words = [
        lines[place].text
        for place in ((FIRST, one.first_seq), (SECOND, one.second_seq))
        if place[1] is not None and place in lines
    ]
    return DifferenceLine(
        one.kind,
        one.first_seq,
        one.second_seq,
        None if one.first_seq is None else first.times_us[one.first_seq] / 1e6,
        None if one.second_seq is None else second.times_us[one.second_seq] / 1e6,
        None if one.shift_us is None else one.shift_us / 1e6,
        ", ".join(one.fields),
        one.is_consequence,
        " / ".join(dict.fromkeys(words)),
    )


def _parameters(first: Event, second: Event) -> tuple[Parameter, ...]:
    firsts, seconds = flat(first), flat(second)
    return tuple(
        Parameter(name, _text(firsts.get(name)), _text(seconds.get(name)))
        for name in dict.fromkeys((*firsts, *seconds))
        if firsts.get(name) != seconds.get(name)
    )


def _text(value: object) -> str | None:
    if isinstance(value, tuple):
        return "; ".join(map(str, value)) or "nothing"
    return None if value is None else str(value)
