"""The differences of two runs, in words."""

from collections import Counter

import msgspec

from fsar_ledger.analysis.consequences import FIRST, SECOND, Consequences, consequences
from fsar_ledger.analysis.difference import KINDS, Difference, align, chain
from fsar_ledger.analysis.words import Line, lines_from
from fsar_ledger.events import Event
from fsar_ledger.events.envelope import flat
from fsar_ledger.ledger.rows.codec import LedgerRun, encode_coded
from fsar_ledger.metrics.database import from_table

from .provenance import Provenance
from .table import Table, of_structs


class Parameter(msgspec.Struct, frozen=True):
    """A field of an event in which two runs differ, as text."""

    field: str
    first: str | None
    second: str | None


class Told(msgspec.Struct, frozen=True):
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


class Parting(msgspec.Struct, frozen=True):
    """Where two runs part: the first event of each that is not the same in the other, with its chain of causes.

    Each chain begins with the event and goes back to a fact of the world; empty where all events of the run are the
    same in the other. `fields` are those that differ where both are the same event. Units: `at_s` seconds of run time;
    what a field named `_us` holds, microseconds.
    """

    at_s: float
    first: tuple[Line, ...]
    second: tuple[Line, ...]
    fields: tuple[Parameter, ...] = ()


class Diff(msgspec.Struct, frozen=True, kw_only=True):
    """The differences of two runs.

    `same` events are the same at the same time; `counts` has the others by kind; `parameters` the fields of event 0
    that differ. `parting`, `consequences`: None where nothing but event 0 differs.
    """

    first: str
    second: str
    parameters: tuple[Parameter, ...]
    same: int
    counts: dict[str, int]
    differences: tuple[Told, ...]
    parting: Parting | None
    consequences: Consequences | None
    provenances: tuple[Provenance, ...]

    @property
    def is_same(self) -> bool:
        """Return whether the two do the same; event 0 may say otherwise of what they were made from."""
        return not self.differences

    def table(self) -> Table:
        """Return a row for each difference, in order of time."""
        return Table(of_structs(self.differences, Told), self.provenances[0])


def difference_of(first: LedgerRun, second: LedgerRun, provenances: tuple[Provenance, ...]) -> Diff:
    """Return the differences of two records. Raises: as `Database.rows`."""
    found = align(first, second)
    differing = [one for one in found.differences if (one.first_seq, one.second_seq) != (0, 0)]
    counted = Counter(one.kind for one in differing)
    named = [msgspec.structs.replace(run, run_id=name) for name, run in ((FIRST, first), (SECOND, second))]
    told: tuple[Told, ...] = ()
    parting = after = None
    if differing:
        starts = _starts(differing)
        chains = [chain(run, seq) if seq is not None else [] for run, seq in zip((first, second), starts, strict=True)]
        with from_table(encode_coded(named)) as database:
            places = [(FIRST, one.first_seq) for one in differing if one.first_seq is not None]
            places += [(SECOND, one.second_seq) for one in differing if one.second_seq is not None]
            places += [(name, seq) for name, seqs in zip((FIRST, SECOND), chains, strict=True) for seq in seqs]
            lines = lines_from(database, places)
            after = consequences(database, first, second, found.pairs)
        told = tuple(_told(one, first, second, lines) for one in differing)
        both = [tuple(lines[(name, seq)] for seq in seqs) for name, seqs in zip((FIRST, SECOND), chains, strict=True)]
        at_s = min(one.time_s for side in both for one in side[:1])
        parting = Parting(at_s, both[0], both[1], _changed(first, second, starts, found.pairs))
    return Diff(
        first=first.run_id,
        second=second.run_id,
        parameters=_parameters(first.events[0], second.events[0]),
        same=found.same + (len(found.differences) > len(differing)),
        counts={kind: counted[kind] for kind in KINDS if counted[kind]},
        differences=told,
        parting=parting,
        consequences=after,
        provenances=provenances,
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


def _told(one: Difference, first: LedgerRun, second: LedgerRun, lines: dict[tuple[str, int], Line]) -> Told:
    words = [
        lines[place].text
        for place in ((FIRST, one.first_seq), (SECOND, one.second_seq))
        if place[1] is not None and place in lines
    ]
    return Told(
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
    """Return the fields in which two events differ."""
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
