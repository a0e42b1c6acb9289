"""The command `diff`: in what two runs differ, and why."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fsar_ledger import printable
from fsar_ledger.cli import completing
from fsar_ledger.cli.options import JsonOption, LedgerArgument, VerifiedOption, WideOption, examples
from fsar_ledger.cli.terminal import show
from fsar_ledger.printable import Shown, counted

if TYPE_CHECKING:
    from fsar_ledger.api.difference import Diff

EXAMPLES = examples(
    "fsar-ledger diff out/ledger 1 2",
    "fsar-ledger diff out/ledger 1 4 --all",
    "fsar-ledger diff out/ledger 1 1 --other out/large --verified --json",
)
MAX_PARAMETER = 60
"""Characters of a field of event 0; constants are long."""


def diff(
    ledger: LedgerArgument,
    first: Annotated[
        str, typer.Argument(metavar="RUN", help="The first run.", show_default=False, autocompletion=completing.runs)
    ],
    second: Annotated[
        str, typer.Argument(metavar="RUN2", help="The second run.", show_default=False, autocompletion=completing.runs)
    ],
    other: Annotated[
        Path | None, typer.Option("--other", metavar="LEDGER", help="Another ledger, which holds the second run.")
    ] = None,
    lists: Annotated[bool, typer.Option("--all", help="Also list every difference, one a line.")] = False,
    verified: VerifiedOption = False,
    as_json: JsonOption = False,
    wide: WideOption = False,
) -> None:
    """Say in what two runs differ: where they part and why, and what they came to.

    Events are aligned by cause and content, so that one more event does not make all that follow differ. A run is the
    same, or an event happens in one only, or changed, or has another cause, or moved in time. Where they part, both
    events are shown with what caused them, back to a fact of the world.
    """
    from fsar_ledger.cli.answering import opened, warn

    asked = opened(ledger, verified=verified)
    theirs = None if other is None else opened(other, verified=verified)
    found = asked.diff(first, second, theirs)
    for place, provenance in zip((ledger, other), found.provenances, strict=False):
        if place is not None:
            warn(place, provenance)
    show(_json(found) if as_json else _text(found, lists=lists, wide=wide))


def _json(found: "Diff") -> Shown:
    from msgspec import structs

    from fsar_ledger.cli.output import answer_json

    answer = {name: value for name, value in structs.asdict(found).items() if name != "provenances"}
    return answer_json(found.provenances[0], answer)


def _text(found: "Diff", *, lists: bool, wide: bool) -> Shown:
    from fsar_ledger.cli.stories import story
    from fsar_ledger.cli.tables import table

    head = [f"first: {printable.value(found.first)}", f"second: {printable.value(found.second)}"]
    head += [
        f"{one.field}: {_short(one.first)} and {_short(one.second)}"
        for one in found.parameters
        if not one.field.startswith("forked_from")
    ]
    if found.is_same:
        return printable.lines(*head, f"the same {counted(found.same, 'event')} at the same times")
    parts = [printable.lines(*head), story(found, ("first", "second"), wide=wide)]
    if lists:
        rows = found.table().rows()
        columns = [name for name in rows[0] if name != "is_consequence"]
        parts += [printable.lines(""), table(rows, columns, wide=wide)]
    return printable.joined(*parts)


def _short(text: str | None) -> str:
    return "-" if text is None else printable.value(text, MAX_PARAMETER)
