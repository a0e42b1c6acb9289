"""A run to walk through, with the words of each event and the state after it."""

from collections.abc import Iterator

from fsar_ledger.analysis.moments import Timeline, Walk
from fsar_ledger.analysis.records import lines_of
from fsar_ledger.analysis.situation import Coverage, Situation, situation
from fsar_ledger.base.errors import UsageError
from fsar_ledger.events.envelope import flat
from fsar_ledger.ledger.rows.codec import LedgerRun

from .names import microseconds
from .provenance import Provenance, of_run


class Steps:
    """A walk through a run of a ledger: where it is, what happened there, and how things stand."""

    def __init__(self, record: LedgerRun, provenance: Provenance, at_us: int | None) -> None:
        """Begin after the last event of that time; None: at event 0. Raises: as `Database.rows`."""
        self.run = record.run_id
        self.provenance = of_run(provenance, Coverage(record).lacking)
        self._record = record
        self._timeline = Timeline(record)
        found = lines_of([record], [(record.run_id, seq) for seq in range(len(record.events))])
        self.words = [found[(record.run_id, seq)].text for seq in range(len(record.events))]
        self._walk = Walk(record, self.words, 0 if at_us is None else self._timeline.seq_at(at_us))

    @property
    def seq(self) -> int:
        """Return the event at which the walk is."""
        return self._walk.seq

    @property
    def size(self) -> int:
        """Return the number of events."""
        return len(self._record.events)

    def time_s(self, seq: int) -> float:
        """Return when an event happened, in seconds of run time."""
        return self._record.times_us[seq] / 1e6

    def move(self, name: str, about: str = "") -> str | None:
        """Make a move (`analysis/moments.py: MOVES`); return why it leads nowhere, or None.

        Raises:
            UsageError: There is no such move, it lacks what it needs, or a time is none.
        """
        return self._walk.move(name, about, self._seq_at)

    def fields(self) -> Iterator[tuple[str, object]]:
        """Yield the fields of the event at which the walk is, its type, time and cause first."""
        event = self._record.events[self.seq]
        yield "type", event.__struct_config__.tag
        yield "time_s", self.time_s(self.seq)
        yield "caused_by", self._record.caused_by[self.seq]
        yield from flat(event).items()

    def standing(self, robot: str | None = None) -> Situation:
        """Return how things stand after the event at which the walk is."""
        return situation(self._record, self.seq, self._timeline.after(self.seq), robot)

    def _seq_at(self, text: str) -> int:
        time_us = microseconds("go", text)
        if time_us is None:
            raise UsageError("go: found no time, expected one, as 46.6s")
        return self._timeline.seq_at(time_us)
