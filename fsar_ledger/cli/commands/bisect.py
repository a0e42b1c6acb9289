"""The command `bisect`: the first run, and in it the first event, at which two sides disagree on an outcome."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fsar_ledger import printable
from fsar_ledger.cli.options import AuditedOption, JsonOption, LedgerArgument, VerifiedOption, WideOption, examples
from fsar_ledger.cli.terminal import show
from fsar_ledger.errors import UsageError
from fsar_ledger.printable import Shown, counted

from .compare import FirstOption, SecondOption

if TYPE_CHECKING:
    from fsar_ledger.api.bisect import Bisected
    from fsar_ledger.api.ledger import Ledger

EXAMPLES = examples(
    'fsar-ledger bisect out/ledger --first fsar --second cfc --outcome "policy_violations > 0"',
    'fsar-ledger bisect out/ledger --change "without shared-registry" --architecture fsar --outcome '
    '"coordination_success < 1"',
    'fsar-ledger bisect out/ledger --first fsar --second dhma --outcome "authority_conflicts > 3" --json',
)


def bisect(
    ledger: LedgerArgument,
    other: Annotated[
        Path | None, typer.Argument(metavar="OTHER", help="The ledger of the second side.", show_default="the same")
    ] = None,
    outcome: Annotated[
        str,
        typer.Option(
            "--outcome",
            metavar="CONDITION",
            help="On what they disagree: METRIC > NUMBER, INVARIANT > NUMBER, or a SELECT of run_id.",
            show_default=False,
        ),
    ] = "",
    first: FirstOption = None,
    second: SecondOption = None,
    change: Annotated[
        list[str] | None,
        typer.Option(
            "--change", metavar="TEXT", help="Instead of two sides: the runs, and forks with this.", show_default=False
        ),
    ] = None,
    architecture: AuditedOption = None,
    verified: VerifiedOption = False,
    as_json: JsonOption = False,
    wide: WideOption = False,
) -> None:
    """Find the first run in which two sides disagree on an outcome, and the event at which they part there.

    The sides are architectures, configurations, constants or models, as in `compare`, from one ledger or two: two
    releases that made the same experiment, too. Or they are the runs as recorded and their forks with --change. Runs
    are paired by seed, scenario and number, in the order of the ledger.
    """
    from fsar_ledger.cli.answering import opened, warn

    if not outcome:
        raise UsageError('--outcome: found none, expected one, as in --outcome "policy_violations > 0"')
    asked = opened(ledger, verified=verified)
    theirs = None if other is None else opened(other, verified=verified)
    found = asked.bisect(outcome, first, second, theirs, changes=change, architecture=architecture)
    for place, provenance in zip((ledger, other), found.provenances, strict=False):
        if place is not None:
            warn(place, provenance)
    show(_json(found) if as_json else _text(asked, found, wide=wide))


def _json(found: "Bisected") -> Shown:
    from msgspec import structs

    from fsar_ledger.cli.output import answer_json

    answer = {name: value for name, value in structs.asdict(found).items() if name != "provenances"}
    if found.diff is not None:
        told = structs.asdict(found.diff)
        answer["diff"] = {name: value for name, value in told.items() if name != "provenances"}
    return answer_json(found.provenances[0], answer)


def _text(asked: "Ledger", found: "Bisected", *, wide: bool) -> Shown:
    from fsar_ledger.cli.output import run_text
    from fsar_ledger.cli.stories import story

    head = [
        f"outcome: {found.outcome}",
        f"first: {found.first}",
        f"second: {found.second}",
        f"{counted(found.pairs, 'pair')}: {found.both:,} have it on both sides, {found.neither:,} on neither, "
        f"{found.first_only:,} on the first alone, {found.second_only:,} on the second alone",
    ]
    if found.undefined:
        head.append(f"in {counted(found.undefined, 'pair')} more, a run has no value to compare")
    if found.diff is None:
        return printable.lines(*head, "no pair disagrees")
    name = found.diff.first
    head += [
        "",
        f"the first pair that disagrees: {run_text(name, asked.numbers().get(name))}",
        f"and {printable.value(found.diff.second)}",
        "",
    ]
    return printable.joined(printable.lines(*head), story(found.diff, ("first", "second"), wide=wide))
