"""The verb `view`: a run, or two beside each other, as a page of HTML; or a run as a trace that Perfetto opens."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec

from fsar_ledger.base import printable
from fsar_ledger.base.errors import UsageError, option

from .answers import Lines
from .names import Place, Run
from .verbs import Option, declare, verb

if TYPE_CHECKING:
    from fsar_ledger.metrics.provenance import Provenance
    from fsar_ledger.view import PageOptions

    from .ledger import Ledger

PAGE, TRACE = ".html", ".json"


class Picture(msgspec.Struct, frozen=True):
    """A written page or trace: the file, its bytes, the runs that it shows, and the provenance.

    `first_difference` is the first seq at which two runs differ: None if they do not, or if there is only one.
    `other` is the provenance of a run from another ledger.
    """

    file: Path
    size: int
    runs: tuple[str, ...]
    first_difference: int | None
    provenance: "Provenance"
    other: "Provenance | None" = None

    def __str__(self) -> str:
        """Return which runs the file shows, and where they diverge."""
        text = f"{self.file}: {self.size:,} bytes, run"
        if len(self.runs) == 1:
            return f"{text} {printable.value(self.runs[0])}"
        names, first = " and ".join(map(printable.value, self.runs)), self.first_difference
        return f"{text}s {names}: " + ("no difference" if first is None else f"the first difference is event {first}")


def _write_pictures(
    ledger: "Ledger",
    out: Place | None = None,
    run: Run | None = None,
    second: Run | None = None,
    other: "Ledger | None" = None,
    perfetto: Place | None = declare(
        "FILE", "A .json file of trace events for ui.perfetto.dev; replaced if it exists."
    ),
) -> Lines:
    if out is None and perfetto is None:
        raise UsageError("found neither --out nor --perfetto, expected a file to write; give --out FILE.html")
    if perfetto is not None and (second is not None or other is not None):
        extra = f"--with {second}" if second is not None else f"--other {other and other.path}"
        raise UsageError(
            f"--perfetto {perfetto} and {extra}: a trace shows one run, expected one of them; --out FILE.html shows two"
        )
    for file, suffix, name in ((out, PAGE, "out"), (perfetto, TRACE, "perfetto")):
        if file is not None:
            require_picture(Path(file), suffix, name)
    written = [] if out is None else [view(ledger, out, run, second, other)]
    written += [] if perfetto is None else [trace(ledger, perfetto, run)]
    first, other_provenance = written[0].provenance, written[0].other
    answer = Lines(*map(str, written))
    answer.provenances = (first,) if other_provenance is None else (first, other_provenance)
    return answer


@verb(
    "view out/ledger --out out/run.html",
    "view out/ledger --run 1 --with 2 --out out/two.html",
    "view out/ledger --run 1 --perfetto out/run.json",
    takes=("verified",),
    call=_write_pictures,
)
def view(
    ledger: "Ledger",
    out: Annotated[Place, Option("--out", "FILE", "A .html file; replaced if it exists.")],
    run: Run | None = declare(
        "RUN", "A run: its number, its name, or a part of it that no other run has.", "the first run", complete="runs"
    ),
    second: Run | None = declare(
        "RUN", "Also show this run, below the other; their first difference is marked.", complete="runs", flag="--with"
    ),
    other: "Ledger | Place | None" = declare("LEDGER", "The ledger that holds the run of --with.", "LEDGER"),
) -> Picture:
    """Write a page that shows a run: who did what when, what held at any moment, and every event.

    The page is one file and needs no network: open it in a browser. It has a lane for each robot, supervisor and
    service; a time cursor shows the state, a click on an event its record, its causes and the command that proves it.
    Press ? in it for the keys. With --perfetto, write the run as a trace that ui.perfetto.dev opens, for long runs.

    Raises:
        UsageError: There is no such run, both are the same, `out` has another suffix or lies inside a ledger.
        WriteFailed: The file cannot be written.
    """
    from fsar_ledger.ledger.rows.runs import parts_at
    from fsar_ledger.view import page

    from .files import write_bytes
    from .lookup import ledgers_of

    file = Path(out)
    require_picture(file, PAGE, "out")
    beside = None if other is None else ledgers_of(ledger, other)[1]
    pages = [_page_options(ledger, run)]
    first = None
    if second is not None or beside is not None:
        upper = pages[0][0].drawn.run
        pages.append(_page_options(beside or ledger, upper.run_id if second is None else second))
        lower = pages[1][0].drawn.run
        if lower.run_id == upper.run_id and (beside is None or beside.path.resolve() == ledger.path.resolve()):
            raise UsageError(
                f"{option('second', second)}: found run {printable.value(upper.run_id)} twice, expected two runs; name "
                "another one"
            )
        first = parts_at(upper, lower)
    content = page(*(picture for picture, _ in pages))
    write_bytes(file, content)
    runs = tuple(picture.drawn.run.run_id for picture, _ in pages)
    provenances = [provenance for _, provenance in pages]
    if beside is None:
        return Picture(file, len(content), runs, first, _together(provenances))
    return Picture(file, len(content), runs, first, *provenances)


def trace(ledger: "Ledger", out: Place, run: Run | None = None) -> Picture:
    """Write a run as trace events, which ui.perfetto.dev opens: for runs too long for a page.

    The name of the file ends in .json; it is replaced if it exists. Without `run` it is the first.

    Raises:
        UsageError: There is no such run, or `out` has another suffix or lies inside a ledger.
        WriteFailed: The file cannot be written.
    """
    from fsar_ledger.view import trace as trace_of

    from .files import write_bytes

    file = Path(out)
    require_picture(file, TRACE, "out")
    options, provenance = _page_options(ledger, run)
    content = trace_of(options.drawn)
    write_bytes(file, content)
    return Picture(file, len(content), (options.drawn.run.run_id,), None, provenance)


def require_picture(out: Path, suffix: str, name: str) -> None:
    """Check the name of a file before anything is read. `name` is the parameter that gives it.

    Raises: UsageError if it has another suffix, is a folder, or lies inside a ledger.
    """
    from fsar_ledger.ledger.store.paths import require_outside

    if out.suffix != suffix:
        raise UsageError(
            f"{option(name, out)}: found a file name that ends in {out.suffix or 'nothing'!r}, expected {suffix}; "
            "choose another name"
        )
    if out.is_dir():
        raise UsageError(f"{option(name, out)}: found a folder, expected the name of a file; choose another name")
    require_outside(out, option(name, out))


def _page_options(ledger: "Ledger", requested: Run | None) -> "tuple[PageOptions, Provenance]":
    """Return what a page draws of a run, and its provenance."""
    from fsar_ledger.analysis.situation import Coverage
    from fsar_ledger.ledger.rows.runs import start_of
    from fsar_ledger.ledger.store.locations import record_of
    from fsar_ledger.view import PageOptions, draw_run, words_of

    from .events import asked_of, timeline
    from .lookup import about_run, present

    ledger_view, _ = present(ledger)
    with about_run(ledger_view, requested, ledger.demanded, is_whole=True) as (database, name, number):
        lines = timeline(database, asked_of(database, name, None, None, None, None))
    run = record_of(ledger_view, name)
    started = start_of(run)
    provenance = lines.provenance
    head = provenance.head
    picture = PageOptions(
        draw_run(run, name if number is None else f"{number}", words_of(lines.rows())),
        printable.word(ledger.path),
        head.events if head else 0,
        head.root if head else "",
        bool(provenance.rows_verified),
        tuple(Coverage(started).lacking.values()),
    )
    return picture, provenance


def _together(provenances: "list[Provenance]") -> "Provenance":
    """Return the joint provenance of runs of one ledger: its head, and each gap once."""
    from fsar_ledger.metrics.provenance import Provenance

    gaps = {gap.concern: gap for provenance in provenances for gap in provenance.not_observed}
    verified = all(provenance.rows_verified for provenance in provenances)
    return Provenance(provenances[0].head, verified, None, tuple(gaps.values()))
