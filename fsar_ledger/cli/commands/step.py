"""The command `step`: a walk through a run, by keys or by a script."""

from typing import TYPE_CHECKING, Annotated

import typer

from fsar_ledger import printable
from fsar_ledger.cli.options import LedgerArgument, OneRunOption, VerifiedOption, examples
from fsar_ledger.cli.terminal import has_keys, show
from fsar_ledger.errors import UsageError

if TYPE_CHECKING:
    from fsar_ledger.api.walks import Steps

EXAMPLES = examples(
    'fsar-ledger step out/ledger --run 1 --script "go 40s; next-decision; cause; state"',
    'fsar-ledger step out/ledger --run 2 --script "next-of B1; next-refusal; record"',
)


def step(
    ledger: LedgerArgument,
    run: OneRunOption,
    at: Annotated[
        str | None,
        typer.Option("--at", metavar="TIME", help="Begin there: 46.6, 46.6s or 46600ms.", show_default="event 0"),
    ] = None,
    script: Annotated[
        str | None,
        typer.Option(
            "--script", metavar="MOVES", help="Moves with ; between them, instead of keys.", show_default=False
        ),
    ] = None,
    verified: VerifiedOption = False,
) -> None:
    """Walk through a run event by event, with the record and the state of the fleet at each.

    Keys: right and left for the next event and the one before, d for the next decision (D: before), r refusal, c back
    to the cause, b the next event of a robot, g a time or event, / a text, home, end, q.

    Moves of a script: next, previous, next-decision, previous-decision, next-refusal, cause, next-of ROBOT, go TIME or
    SEQ, find TEXT, first, last; state and record show how things stand and what the event holds.
    """
    from fsar_ledger.cli.answering import opened, warn

    if script is None and not has_keys():
        raise UsageError('step: found no terminal to walk on, expected one, or --script "next-decision; state"')
    asked = opened(ledger, verified=verified)
    steps = asked.step(run, at)
    warn(ledger, steps.provenance)
    if script is not None:
        _play(steps, script)
        return
    from fsar_ledger.cli.output import run_text
    from fsar_ledger.cli.stepper import Stepper

    Stepper(steps, run_text(steps.run, asked.numbers().get(steps.run))).run()


def _play(steps: "Steps", script: str) -> None:
    """Show where each move of the script lands."""
    from fsar_ledger.api.state import standing_lines

    for one in filter(None, (part.strip() for part in script.split(";"))):
        name, _, about = one.partition(" ")
        if name == "state":
            show(printable.lines(*standing_lines(steps.standing()), ""))
        elif name == "record":
            shown = [
                f"    {field} = {printable.value(str(value))}" for field, value in steps.fields() if value is not None
            ]
            show(printable.lines(*shown))
        else:
            said = steps.move(name, about.strip())
            place = (
                f"{steps.seq:>6} {steps.time_s(steps.seq):>10.3f} s  {printable.value(steps.words[steps.seq], 1_000)}"
            )
            show(printable.lines(f"{one}: {said}" if said else place))
