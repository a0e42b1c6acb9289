"""The command `view`: a run, or two beside each other, as a page to explore, or a run as a trace."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fsar_ledger import printable
from fsar_ledger.cli import completing
from fsar_ledger.cli.options import LedgerArgument, VerifiedOption, examples
from fsar_ledger.cli.terminal import show
from fsar_ledger.errors import UsageError

if TYPE_CHECKING:
    from fsar_ledger.api.pictures import Picture

EXAMPLES = examples(
    "fsar-ledger view out/ledger --out out/run.html",
    "fsar-ledger view out/ledger --run 1 --with 2 --out out/two.html",
    "fsar-ledger view out/ledger --run 1 --perfetto out/run.json",
)


def view(
    ledger: LedgerArgument,
    run: Annotated[
        str | None,
        typer.Option(
            "--run",
            metavar="RUN",
            help="A run: its number, its name, or a part of it that no other run has.",
            show_default="the first run",
            autocompletion=completing.runs,
        ),
    ] = None,
    second: Annotated[
        str | None,
        typer.Option(
            "--with",
            metavar="RUN",
            help="Show this run, too, below the other; their first difference is marked.",
            show_default=False,
            autocompletion=completing.runs,
        ),
    ] = None,
    other: Annotated[
        Path | None,
        typer.Option(
            "--other", metavar="LEDGER", help="The ledger that holds the run of --with.", show_default="LEDGER"
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="FILE", help="A .html file; replaced if it exists.", show_default=False),
    ] = None,
    perfetto: Annotated[
        Path | None,
        typer.Option(
            "--perfetto",
            metavar="FILE",
            help="A .json file of trace events for ui.perfetto.dev; replaced if it exists.",
            show_default=False,
        ),
    ] = None,
    verified: VerifiedOption = False,
) -> None:
    """Write a page that shows a run: who did what when, what held at any moment, and every event.

    The page is one file and needs no network: open it in a browser. It has a lane for each robot, supervisor and
    service; a time cursor shows the state, a click on an event its record, its causes and the command that proves it.
    Press ? in it for the keys. With --perfetto, write the run as a trace that ui.perfetto.dev opens, for long runs.
    """
    from fsar_ledger.api.pictures import PAGE, TRACE, require_picture
    from fsar_ledger.cli.answering import opened, warn

    if out is None and perfetto is None:
        raise UsageError("found neither --out nor --perfetto, expected a file to write; give --out FILE.html")
    if perfetto is not None and (second is not None or other is not None):
        found = f"--with {second}" if second is not None else f"--other {other}"
        raise UsageError(
            f"--perfetto {perfetto} and {found}: a trace shows one run, expected one of them; --out FILE.html shows two"
        )
    for place, suffix, name in ((out, PAGE, "out"), (perfetto, TRACE, "perfetto")):
        if place is not None:
            require_picture(place, suffix, name)
    asked = opened(ledger, verified=verified)
    holder = None if other is None else opened(other, verified=verified)
    written = []
    if out is not None:
        written.append(asked.view(out, run, second, holder))
    if perfetto is not None:
        written.append(asked.trace(perfetto, run))
    warn(ledger, written[0].provenance)
    if other is not None and written[0].other is not None:
        warn(other, written[0].other)
    for picture in written:
        show(printable.line(f"{picture.file}: {picture.size:,} bytes, {_what(picture)}"))


def _what(picture: "Picture") -> str:
    """Return which runs the picture shows, and where they part."""
    if len(picture.runs) == 1:
        return f"run {printable.value(picture.runs[0])}"
    names = " and ".join(printable.value(run) for run in picture.runs)
    first = picture.first_difference
    return f"runs {names}: " + ("no difference" if first is None else f"the first difference is event {first}")
