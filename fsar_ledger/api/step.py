"""The verb `step`: a walk through a run, by keys or by a script."""

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Annotated

from fsar_ledger.base import printable
from fsar_ledger.base.errors import UsageError
from fsar_ledger.base.printable import SafeText

from .answers import Answer, Screen
from .names import Time
from .verbs import Gives, OneRunOption, declare, verb

if TYPE_CHECKING:
    from .ledger import Ledger
    from .walks import Steps


class Walk(Answer):
    """A walk, and the script that is played on it; without one the user walks by keys."""

    def __init__(self, steps: "Steps", script: str | None, walk: "Callable[[Steps, str], None] | None") -> None:
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
) -> Walk:
    if script is None and walk is None:
        raise UsageError('step: found no terminal to walk on, expected one, or --script "next-decision; state"')
    return Walk(step(ledger, run, at), script, walk)


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
) -> "Steps":
    """Walk through a run event by event, with the record and the state of the fleet at each.

    Keys: right and left for the next event and the one before, d for the next decision (D: before), r refusal, c back
    to the cause, b the next event of a robot, g a time or event, / a text, home, end, q.

    Moves of a script: next, previous, next-decision, previous-decision, next-refusal, cause, next-of ROBOT, go TIME or
    SEQ, find TEXT, first, last; state and record show how things stand and what the event holds.

    Raises:
        UsageError: There is no such run, or `at` is no time of it.
    """
    from .lookup import about_run, present, recorded, time_of
    from .walks import Steps

    view, provenance = present(ledger)
    with about_run(view, run, ledger.demanded) as (database, name, _):
        at_us = time_of(database, "at", at, name)
    return Steps(recorded(ledger, view, name), provenance, at_us)
