"""The command `cause`: what an outcome of a run came from, and when it could no longer be avoided."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fsar_ledger import printable
from fsar_ledger.cli.options import JsonOption, LedgerArgument, OneRunOption, VerifiedOption, WideOption, examples
from fsar_ledger.cli.progress import Progress
from fsar_ledger.cli.terminal import show
from fsar_ledger.printable import Shown, counted

if TYPE_CHECKING:
    from fsar_ledger.analysis.causes import Element
    from fsar_ledger.analysis.futures import Chance
    from fsar_ledger.api.causes import Caused
    from fsar_ledger.api.ledger import Ledger

EXAMPLES = examples(
    'fsar-ledger cause out/ledger --run 1 --outcome "policy_violations > 0"',
    'fsar-ledger cause out/ledger --run 2 --outcome "authority_conflicts > 3" --futures 0',
    'fsar-ledger cause out/ledger --run 2 --outcome "SELECT run_id FROM conflicts" --futures 0 --json',
)
BAR = 40
"""Characters of the bar of a chance of 1."""


def cause(
    ledger: LedgerArgument,
    run: OneRunOption,
    outcome: Annotated[
        str,
        typer.Option(
            "--outcome",
            metavar="CONDITION",
            help="What to explain: METRIC > NUMBER, INVARIANT > NUMBER, or a SELECT of run_id.",
        ),
    ],
    lengths: Annotated[
        bool, typer.Option("--lengths", help="Also ask whether the lengths of messages, ways and work mattered.")
    ] = False,
    futures: Annotated[
        int, typer.Option("--futures", metavar="N", help="Futures to draw from each moment; 0: no curve.")
    ] = 50,
    verified: VerifiedOption = False,
    as_json: JsonOption = False,
    wide: WideOption = False,
) -> None:
    """Find the smallest cause of an outcome of a run, and when it could no longer be avoided.

    A cause is a set of facts of the world and answers at ports with which alone the outcome stands, and without any one
    of which it falls. It is found over forks of the run, so it is a cause and no mere correlation; others may suffice,
    too. A fact without which the outcome has no value is no cause of it: without a task nothing fails. Then the curve:
    from moments of the run on, the share of futures, drawn anew, that avoid the outcome, up to the event after which
    none does.
    """
    from fsar_ledger.cli.answering import opened, warn

    asked = opened(ledger, verified=verified)
    with Progress("played", "runs") as progress:
        found = asked.cause(run, outcome, lengths=lengths, futures=futures, progress=progress)
    warn(ledger, found.provenance)
    show(_json(found) if as_json else _text(ledger, asked, found, wide=wide))


def _json(found: "Caused") -> Shown:
    from msgspec import structs

    from fsar_ledger.cli.output import answer_json

    answer = {name: value for name, value in structs.asdict(found).items() if name != "provenance"}
    return answer_json(found.provenance, answer)


def _text(ledger: Path, asked: "Ledger", found: "Caused", *, wide: bool) -> Shown:
    from fsar_ledger.cli.output import run_text, run_word
    from fsar_ledger.cli.tables import table

    number = asked.numbers().get(found.run)
    head = [run_text(found.run, number), f"outcome: {found.outcome}"]
    tail = []
    if found.elements:
        head.append(
            f"{counted(len(found.elements), 'cause')} of {found.candidates:,} facts and answers suffice together; "
            "without any one of them the outcome falls"
        )
        tail.append(f"{_named(one for one in found.elements if one.is_necessary)} necessary in the whole run, too")
        if found.presupposed:
            tail.append(f"{_named(found.presupposed)} presupposed: without it, there is no value to compare")
    else:
        head += [_closing(found)] if found.chances else []
        head.append(
            f"none of {found.candidates:,} facts and answers is a cause: the outcome stands with these alone, without "
            "any one of which there is no value to compare"
        )
    if found.also_necessary:
        tail.append(f"also necessary there: {_listed(found.also_necessary)}")
    if found.elements:
        call = f"fsar-ledger whatif {printable.word(ledger)} --run {run_word(found.run, number)}"
        tail.append(f"`{call} --change {printable.word(found.elements[0].change)}` shows the run without the first")
    rows = [
        {
            "seq": one.seq,
            "begins_s": None if one.begins_s is None else f"{one.begins_s:.3f}",
            "cause" if found.elements else "presupposed": one.name,
            "words": one.words,
        }
        for one in found.elements or found.presupposed
    ]
    parts = [printable.lines(*head, ""), table(rows, list(rows[0]), wide=wide)]
    if tail:
        parts.append(printable.lines("", *tail))
    if found.chances:
        parts.append(printable.lines("", *_curve(found), *(["", _closing(found)] if found.elements else [])))
    return printable.joined(*parts)


def _named(elements: "Iterable[Element]") -> str:
    names = [printable.value(one.name) for one in elements]
    return f"{printable.some(names)} {'is' if len(names) == 1 else 'are'}" if names else "none of them is"


def _listed(elements: "Sequence[Element]") -> str:
    return printable.some([printable.value(one.name) for one in elements])


def _curve(found: "Caused") -> Iterator[str]:
    """Yield the curve: a line for each moment."""
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


def _closing(found: "Caused") -> str:
    """Return the line about the point of no return."""
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
