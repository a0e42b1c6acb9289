"""The verb `step`: a walk through a run, by keys or by a script."""

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Annotated

from fsar_ledger.base import printable
from fsar_ledger.base.errors import UsageError
from fsar_ledger.base.printable import SafeText

from .answers import Answer, Screen
from .names import Time, microseconds
from .verbs import Gives, OneRunOption, declare, verb

if TYPE_CHECKING:
    from fsar_ledger.analysis.situation import Situation
    from fsar_ledger.ledger.rows.codec import LedgerRun
    from fsar_ledger.metrics.provenance import Provenance

    from .ledger import Ledger


class Steps:
    """A walk through a run of a ledger: where it is, what happened there, and how things stand."""

    def __init__(self, record: "LedgerRun", provenance: "Provenance", at_us: int | None) -> None:
        """Begin after the last event of that time; None: at event 0. Raises: as `Database.rows`."""
        from fsar_ledger.analysis.moments import Timeline, Walk
        from fsar_ledger.analysis.records import lines_of
        from fsar_ledger.analysis.situation import Coverage
        from fsar_ledger.metrics.provenance import of_run

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
        from fsar_ledger.events.envelope import flat

        event = self._record.events[self.seq]
        yield "type", event.__struct_config__.tag
        yield "time_s", self.time_s(self.seq)
        yield "caused_by", self._record.caused_by[self.seq]
        yield from flat(event).items()

    def standing(self, robot: str | None = None) -> "Situation":
        """Return how things stand after the event at which the walk is."""
        from fsar_ledger.analysis.situation import situation

        return situation(self._record, self.seq, self._timeline.after(self.seq), robot)

    def _seq_at(self, text: str) -> int:
        time_us = microseconds("go", text)
        if time_us is None:
            raise UsageError("go: found no time, expected one, as 46.6s")
        return self._timeline.seq_at(time_us)


class Played(Answer):
    """A walk, and the script that is played on it; without one the user walks by keys."""

    def __init__(self, steps: Steps, script: str | None, walk: "Callable[[Steps, str], None] | None") -> None:
        self._steps, self._script, self._walk = steps, script, walk
        self.provenance = steps.provenance

    def text(self, screen: Screen) -> Iterator[SafeText]:
        """Yield where each move of the script lands."""
        from .state import standing_lines

        steps = self._steps
        if self._script is None:
            assert self._walk is not None  # `_asked` requires one
            self._walk(steps, screen.run_text(steps.run))
            return
        for move in filter(None, (part.strip() for part in self._script.split(";"))):
            name, _, about = move.partition(" ")
            if name == "state":
                yield printable.lines(*standing_lines(steps.standing()), "")
            elif name == "record":
                fields = ((field, value) for field, value in steps.fields() if value is not None)
                yield printable.lines(*(f"    {field} = {printable.value(str(value))}" for field, value in fields))
            elif reason := steps.move(name, about.strip()):
                yield printable.line(f"{move}: {reason}")
            else:
                words = printable.value(steps.words[steps.seq], 1_000)
                yield printable.lines(f"{steps.seq:>6} {steps.time_s(steps.seq):>10.3f} s  {words}")


def _asked(
    ledger: "Ledger",
    run: str,
    at: Time = None,
    script: str | None = declare("MOVES", "Moves with ; between them, instead of keys."),
    walk: Annotated["Callable[[Steps, str], None] | None", Gives("walk")] = None,
) -> Played:
    if script is None and walk is None:
        raise UsageError('step: found no terminal to walk on, expected one, or --script "next-decision; state"')
    return Played(step(ledger, run, at), script, walk)


@verb(
    'step out/ledger --run 1 --script "go 40s; next-decision; cause; state"',
    'step out/ledger --run 2 --script "next-of B1; next-refusal; record"',
    takes=("verified",),
    call=_asked,
)
def step(
    ledger: "Ledger",
    run: OneRunOption,
    at: Time = declare("TIME", "Begin there: 46.6, 46.6s or 46600ms.", "event 0"),
) -> Steps:
    """Walk through a run event by event, with the record and the state of the fleet at each.

    Keys: right and left for the next event and the one before, d for the next decision (D: before), r refusal, c back
    to the cause, b the next event of a robot, g a time or event, / a text, home, end, q.

    Moves of a script: next, previous, next-decision, previous-decision, next-refusal, cause, next-of ROBOT, go TIME or
    SEQ, find TEXT, first, last; state and record show how things stand and what the event holds.

    Raises:
        UsageError: There is no such run, or `at` is no time of it.
    """
    from .lookup import about_run, present, recorded, time_of

    view, provenance = present(ledger)
    with about_run(view, run, ledger.demanded) as (database, name, _):
        at_us = time_of(database, "at", at, name)
    return Steps(recorded(ledger, view, name), provenance, at_us)
