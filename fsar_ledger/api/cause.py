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
    """A smallest cause of an outcome of a run, and the chances to avoid it.

    `elements` are the facts of the world and answers at ports, of `candidates`, that suffice together for the outcome;
    without any one of them it does not occur. `presupposed`: what else the set needs for the outcome to have a value,
    but not a cause of it. `also_necessary`: others without any one of which it does not occur in the whole run.
    `chances`: by moment, in how many futures from then on the outcome is avoided; empty if no futures were requested.
    `last_open_s`: the last moment found from which some future avoids it; `closing_seq`: the event from which on none
    does. `forks`: the number of runs simulated for this.
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
                + " the outcome does not occur"
            )
            tail.append(
                f"{_names_are(item for item in self.elements if item.is_necessary)} necessary in the whole run, too"
            )
            if self.presupposed:
                without = "it" if len(self.presupposed) == 1 else "any one of them"
                tail.append(
                    f"{_names_are(self.presupposed)} presupposed: without {without}, there is no value to compare"
                )
        elif self.unknown:
            head.append(
                f"none of {self.candidates:,} facts and answers is known to be a cause: without any one of these, "
                "the run asks something that the record does not answer"
            )
        else:
            head += [_closing(self)] if self.chances else []
            head.append(
                f"none of {self.candidates:,} facts and answers is a cause: the outcome occurs with only these, and "
                "without any one of them there is no value to compare"
            )
        if self.unknown:
            if self.elements:
                named = _listed(self.unknown)
                tail.append(f"without any one of {named}, the run asks something that the record does not answer")
            tail.append("`--answers model:7` lets the model answer")
        if self.also_necessary:
            tail.append(f"also necessary there: {_listed(self.also_necessary)}")
        if self.elements:
            call = f"fsar-ledger whatif {printable.word(screen.path)} --run {screen.run_word(self.run)}"
            tail.append(f"`{call} --change {printable.word(self.elements[0].change)}` shows the run without the first")
        rows = [
            {
                "seq": element.seq,
                "begins_s": None if element.begins_s is None else f"{element.begins_s:.3f}",
                "cause" if self.elements else "unknown" if self.unknown else "presupposed": element.name,
                "words": element.words,
            }
            for element in self.elements or self.unknown or self.presupposed
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
    futures: int | None = declare("N", "Futures to draw from each moment; 0: no curve.", "50; for a live run none"),
    answers: AnswersOption = None,
    progress: Annotated[Progress | None, Shows("simulated", "runs")] = None,
) -> CauseResult:
    """Find the smallest cause of an outcome of a run, and when it could no longer be avoided.

    A cause is a set of facts of the world, and of answers to the run's questions, that suffices for the outcome;
    without any one of them the outcome does not occur. It is found by forking the run, so it is a cause and not only a
    correlation; other sets may also suffice. A fact without which the outcome has no value is not a cause: without a
    task nothing fails. The curve then shows, from moments of the run on, the share of newly drawn futures that avoid
    the outcome, up to the event after which none does.

    For a live run, commands are removed. If the run then asks something that the record does not answer, the outcome
    is unknown, unless --answers lets the model answer. There is no curve.

    Raises:
        UsageError: The run does not have the outcome, or it cannot be made again.
        QueryFailed: The SELECT fails.
    """
    from fsar_ledger.analysis import causes
    from fsar_ledger.analysis.avoidability import FUTURES, MOMENTS, Curve, curve
    from fsar_ledger.analysis.causes import outcome_of
    from fsar_ledger.analysis.fork_base import base_of_record, rerun
    from fsar_ledger.analysis.whatif import answers_of, changes_of

    from .lookup import present, recorded

    view, provenance = present(ledger)
    record = recorded(ledger, view, run)
    if futures is not None and not 0 <= futures <= MOST_FUTURES:
        raise UsageError(f"{option('futures', futures)}: expected 0 (no curve) to {MOST_FUTURES:,}")
    condition = outcome_of(outcome)
    base = rerun(base_of_record(record, view.head.root))
    is_live = base.base.recipe.live is not None
    if is_live and futures:
        raise UsageError(
            f"{option('futures', futures)}: found a live run, expected 0: the futures of real robots cannot be drawn"
        )
    if answers is not None:
        if not is_live:
            raise UsageError(f"{option('answers', answers)}: found a simulated run, whose world answers everything")
        base = base.with_answers(changes_of(answers_of(answers)))
    report = None if progress is None else lambda done: progress(done, done)
    found = causes.cause(base, condition, lengths=lengths, progress=report)
    futures_drawn = (0 if is_live else FUTURES) if futures is None else futures
    drawn = curve(base, condition, futures_drawn, MOMENTS, progress) if futures_drawn else Curve((), None, None)
    forks = found.forks + sum(chance.futures + chance.undefined for chance in drawn.chances)
    return CauseResult(
        run=record.run_id,
        **msgspec.structs.asdict(msgspec.structs.replace(found, forks=forks)),
        **msgspec.structs.asdict(drawn),
        closing_s=None if drawn.closing_seq is None else record.times_us[drawn.closing_seq] / 1_000_000,
        provenance=provenance,
    )


def _names_are(elements: "Iterable[Element]") -> str:
    names = [printable.value(element.name) for element in elements]
    return f"{printable.list_few(names)} {'is' if len(names) == 1 else 'are'}" if names else "none of them is"


def _listed(elements: "Sequence[Element]") -> str:
    return printable.list_few([printable.value(element.name) for element in elements])


def _curve(result: CauseResult) -> Iterator[str]:
    drawn = max(chance.futures + chance.undefined for chance in result.chances)
    left_out = any(chance.undefined for chance in result.chances)
    without = "; those in which it has no value are left out" if left_out else ""
    yield f"futures that avoid the outcome, of {drawn:,} drawn from each moment{without}"
    closed = [chance for chance in result.chances if result.last_open_s is None or chance.at_s > result.last_open_s]
    for chance in result.chances:
        if chance not in closed[1:-1]:
            yield _bar(chance)
        elif chance is closed[1]:
            yield f"{'...':>10}"


def _closing(result: CauseResult) -> str:
    if result.closing_seq is None:
        return "some futures avoid it to the end"
    if result.last_open_s is None:
        return "no future avoids it, even from the beginning"
    return (
        f"point of no return: event {result.closing_seq}, at {result.closing_s:.3f} s; before it, at "
        f"{result.last_open_s:.3f} s, some futures still avoid it"
    )


def _bar(chance: "Chance") -> str:
    if chance.share is None:
        return f"{chance.at_s:>10.3f} s     -"
    return f"{chance.at_s:>10.3f} s  {chance.share:>4.0%}  {'#' * round(chance.share * BAR)}".rstrip()
