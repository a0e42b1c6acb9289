"""The verb `cause`: what an outcome of a run came from, and when it could no longer be avoided."""

from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Annotated

import msgspec

from fsar_ledger.base import printable
from fsar_ledger.base.errors import UsageError, option
from fsar_ledger.base.printable import SafeText
from fsar_ledger.base.progress import Progress

from .answers import Answer, Screen
from .verbs import AnswersOption, OneRunOption, Option, Shows, declare, switch, verb

if TYPE_CHECKING:
    from fsar_ledger.analysis.avoidability import Chance
    from fsar_ledger.analysis.causes import Element
    from fsar_ledger.metrics.provenance import Provenance

    from .ledger import Ledger
    from .table import Table

MOST_FUTURES = 10_000
BAR = 40
"""Characters of the bar of a chance of 1."""


class CauseResult(Answer, msgspec.Struct, frozen=True, kw_only=True):
    """A smallest cause of an outcome of a run, and how its chances went.

    `elements` are facts of the world and answers at ports that suffice for the outcome together, of `candidates`; it
    falls without any one of them. `presupposed`: what else the set needs for the outcome to have a value at all, and
    no cause of it. `also_necessary`: others without any one of which it falls in the whole run.
    `chances`: by moment, in how many futures from then on the outcome is avoided; none if no futures were asked for.
    `last_open_s`: the last moment found from which some future avoids it; `closing_seq`: the event from which on none
    does. `forks`: runs that were played for this.
    """

    run: str
    outcome: str
    elements: tuple["Element", ...]
    presupposed: tuple["Element", ...]
    unknown: tuple["Element", ...]
    also_necessary: tuple["Element", ...]
    candidates: int
    forks: int
    chances: tuple["Chance", ...]
    last_open_s: float | None
    closing_seq: int | None
    closing_s: float | None
    provenance: "Provenance"

    def table(self) -> "Table":
        """Return a row for each element."""
        from fsar_ledger.analysis.causes import Element

        from .table import Table, of_structs

        return Table(of_structs(self.elements, Element), self.provenance)

    def curve(self) -> "Table":
        """Return a row for each moment."""
        from fsar_ledger.analysis.avoidability import Chance

        from .table import Table, of_structs

        return Table(of_structs(self.chances, Chance), self.provenance)

    def text(self, screen: Screen) -> Iterator[SafeText]:
        """Yield the cause, what else is necessary, and the curve."""
        head = [screen.run_text(self.run), f"outcome: {self.outcome}"]
        tail = []
        if self.elements:
            head.append(
                f"{len(self.elements):,} of {self.candidates:,} facts and answers "
                + ("suffices; without it" if len(self.elements) == 1 else "suffice together; without any one of them")
                + " there is no such outcome"
            )
            tail.append(f"{_named(one for one in self.elements if one.is_necessary)} necessary in the whole run, too")
            if self.presupposed:
                without = "it" if len(self.presupposed) == 1 else "any one of them"
                tail.append(f"{_named(self.presupposed)} presupposed: without {without}, there is no value to compare")
        elif self.unknown:
            head.append(
                f"none of {self.candidates:,} facts and answers is known to be a cause: without any one of these, "
                "something is asked that nobody on record answers"
            )
        else:
            head += [_closing(self)] if self.chances else []
            head.append(
                f"none of {self.candidates:,} facts and answers is a cause: the outcome stands with these alone, "
                "without any one of which there is no value to compare"
            )
        if self.unknown:
            if self.elements:
                named = _listed(self.unknown)
                tail.append(f"without any one of {named}, something is asked that nobody on record answers")
            tail.append("`--answers model:7` lets the model answer")
        if self.also_necessary:
            tail.append(f"also necessary there: {_listed(self.also_necessary)}")
        if self.elements:
            call = f"fsar-ledger whatif {printable.word(screen.path)} --run {screen.run_word(self.run)}"
            tail.append(f"`{call} --change {printable.word(self.elements[0].change)}` shows the run without the first")
        rows = [
            {
                "seq": one.seq,
                "begins_s": None if one.begins_s is None else f"{one.begins_s:.3f}",
                "cause" if self.elements else "unknown" if self.unknown else "presupposed": one.name,
                "words": one.words,
            }
            for one in self.elements or self.unknown or self.presupposed
        ]
        yield printable.lines(*head, "")
        yield screen.table(rows)
        if tail:
            yield printable.lines("", *tail)
        if self.chances:
            yield printable.lines("", *_curve(self), *(["", _closing(self)] if self.elements else []))


@verb(
    'cause out/ledger --run 2 --outcome "policy_violations > 0"',
    'cause out/ledger --run 2 --outcome "authority_conflicts > 3" --futures 0',
    'cause out/ledger --run 2 --outcome "SELECT run_id FROM conflicts" --futures 0 --json',
)
def cause(
    ledger: "Ledger",
    run: OneRunOption,
    outcome: Annotated[
        str,
        Option(
            "--outcome", "CONDITION", "What to explain: METRIC > NUMBER, INVARIANT > NUMBER, or a SELECT of run_id."
        ),
    ],
    *,
    lengths: bool = switch("Also test whether the durations of messages, approaches and work mattered."),
    futures: int | None = declare("N", "Futures to draw from each moment; 0: no curve.", "50, of a live run none"),
    answers: AnswersOption = None,
    progress: Annotated[Progress | None, Shows("played", "runs")] = None,
) -> CauseResult:
    """Find the smallest cause of an outcome of a run, and when it could no longer be avoided.

    A cause is a set of facts of the world, and of answers to what the run asked of it, that suffices for the outcome;
    without any one of them the outcome does not occur. It is found by forking the run, so it is a cause and not only a
    correlation; other sets may suffice, too. A fact without which the outcome has no value is no cause of it: without a
    task nothing fails. Then the curve: from moments of the run on, the share of futures, drawn anew, that avoid the
    outcome, up to the event after which none does.

    Of a live run, commands are removed. Where it then asks what nobody on record answers, the outcome is unknown,
    unless the model of --answers answers. There is no curve.

    Raises:
        UsageError: The run does not have the outcome, or it cannot be made again.
        QueryFailed: The SELECT fails.
    """
    from fsar_ledger.analysis import causes
    from fsar_ledger.analysis.avoidability import FUTURES, MOMENTS, curve
    from fsar_ledger.analysis.causes import outcome_of
    from fsar_ledger.analysis.fork_base import base_of_record, rerun
    from fsar_ledger.analysis.whatif import answers_of, changes_of

    from .lookup import present, recorded

    view, provenance = present(ledger)
    record = recorded(ledger, view, run)
    if futures is not None and not 0 <= futures <= MOST_FUTURES:
        raise UsageError(f"{option('futures', futures)}: expected 0 (no curve) to {MOST_FUTURES:,}")
    asked = outcome_of(outcome)
    base = rerun(base_of_record(record, view.head.root))
    is_live = base.base.recipe.live is not None
    if is_live and futures:
        raise UsageError(
            f"{option('futures', futures)}: found a live run, expected 0: nobody draws the futures of robots that are "
            "really there"
        )
    if answers is not None:
        if not is_live:
            raise UsageError(f"{option('answers', answers)}: found a simulated run, whose world answers everything")
        base = base.with_answers(changes_of(answers_of(answers)))
    played = None if progress is None else lambda done: progress(done, done)
    found = causes.cause(base, asked, lengths=lengths, progress=played)
    drawn = (0 if is_live else FUTURES) if futures is None else futures
    chances = None if not drawn else curve(base, asked, drawn, MOMENTS, progress)
    closing = None if chances is None else chances.closing_seq
    return CauseResult(
        run=record.run_id,
        outcome=found.outcome,
        elements=found.elements,
        presupposed=found.presupposed,
        unknown=found.unknown,
        also_necessary=found.also_necessary,
        candidates=found.candidates,
        forks=found.forks + (0 if chances is None else sum(one.futures + one.undefined for one in chances.chances)),
        chances=() if chances is None else chances.chances,
        last_open_s=None if chances is None else chances.last_open_s,
        closing_seq=closing,
        closing_s=None if closing is None else record.times_us[closing] / 1_000_000,
        provenance=provenance,
    )


def _named(elements: "Iterable[Element]") -> str:
    names = [printable.value(one.name) for one in elements]
    return f"{printable.some(names)} {'is' if len(names) == 1 else 'are'}" if names else "none of them is"


def _listed(elements: "Sequence[Element]") -> str:
    return printable.some([printable.value(one.name) for one in elements])


def _curve(found: CauseResult) -> Iterator[str]:
    drawn = max(one.futures + one.undefined for one in found.chances)
    left_out = any(one.undefined for one in found.chances)
    without = "; those in which it has no value are left out" if left_out else ""
    yield f"futures that avoid it, of {drawn:,} drawn from each moment on{without}"
    closed = [one for one in found.chances if found.last_open_s is None or one.at_s > found.last_open_s]
    for one in found.chances:
        if one not in closed[1:-1]:
            yield _bar(one)
        elif one is closed[1]:
            yield f"{'...':>10}"


def _closing(found: CauseResult) -> str:
    if found.closing_seq is None:
        return "some futures avoid it to the end"
    if found.last_open_s is None:
        return "no future avoids it, from the beginning on"
    return (
        f"point of no return: event {found.closing_seq}, at {found.closing_s:.3f} s; before it, at "
        f"{found.last_open_s:.3f} s, some futures still avoid it"
    )


def _bar(one: "Chance") -> str:
    if one.share is None:
        return f"{one.at_s:>10.3f} s     -"
    return f"{one.at_s:>10.3f} s  {one.share:>4.0%}  {'#' * round(one.share * BAR)}".rstrip()
