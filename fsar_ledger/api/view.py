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
    """The file, its bytes, the runs that it shows, and the provenance.

    `first_difference` is the first seq at which two runs differ: None where they do not, or where there is only one.
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
        shown = f"{self.file}: {self.size:,} bytes, run"
        if len(self.runs) == 1:
            return f"{shown} {printable.value(self.runs[0])}"
        names, first = " and ".join(map(printable.value, self.runs)), self.first_difference
        return f"{shown}s {names}: " + ("no difference" if first is None else f"the first difference is event {first}")


def _asked(
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
        found = f"--with {second}" if second is not None else f"--other {other and other.path}"
        raise UsageError(
            f"--perfetto {perfetto} and {found}: a trace shows one run, expected one of them; --out FILE.html shows two"
        )
    for place, suffix, name in ((out, PAGE, "out"), (perfetto, TRACE, "perfetto")):
        if place is not None:
            require_picture(Path(place), suffix, name)
    written = [] if out is None else [view(ledger, out, run, second, other)]
    written += [] if perfetto is None else [trace(ledger, perfetto, run)]
    first, other_one = written[0].provenance, written[0].other
    answer = Lines(*map(str, written))
    answer.provenances = (first,) if other_one is None else (first, other_one)
    return answer


@verb(
    "view out/ledger --out out/run.html",
    "view out/ledger --run 1 --with 2 --out out/two.html",
    "view out/ledger --run 1 --perfetto out/run.json",
    takes=("verified",),
    call=_asked,
)
def view(
    ledger: "Ledger",
    out: Annotated[Place, Option("--out", "FILE", "A .html file; replaced if it exists.")],
    run: Run | None = declare(
        "RUN", "A run: its number, its name, or a part of it that no other run has.", "the first run", complete="runs"
    ),
    second: Run | None = declare(
        "RUN", "Show this run, too, below the other; their first difference is marked.", complete="runs", flag="--with"
    ),
    other: "Ledger | None" = declare("LEDGER", "The ledger that holds the run of --with.", "LEDGER"),
) -> Picture:
    """Write a page that shows a run: who did what when, what held at any moment, and every event.

    The page is one file and needs no network: open it in a browser. It has a lane for each robot, supervisor and
    service; a time cursor shows the state, a click on an event its record, its causes and the command that proves it.
    Press ? in it for the keys. With --perfetto, write the run as a trace that ui.perfetto.dev opens, for long runs.

    Raises:
        UsageError: There is no such run, both are the same, `out` has another suffix or lies inside a ledger.
        WriteFailed: The file cannot be written.
    """
    from fsar_ledger.runtime.forks import parts_at
    from fsar_ledger.view import page

    file = Path(out)
    require_picture(file, PAGE, "out")
    shown = [_shown(ledger, run)]
    first = None
    if second is not None or other is not None:
        one = shown[0][0].drawn.run
        shown.append(_shown(other or ledger, one.run_id if second is None else second))
        two = shown[1][0].drawn.run
        if two.run_id == one.run_id and (other is None or other.path.resolve() == ledger.path.resolve()):
            raise UsageError(
                f"{option('second', second)}: found run {printable.value(one.run_id)} twice, expected two runs; name "
                "another one"
            )
        first = parts_at(one, two)
    content = page(*(picture for picture, _ in shown))
    _write(file, content)
    runs = tuple(picture.drawn.run.run_id for picture, _ in shown)
    provenances = [provenance for _, provenance in shown]
    if other is None:
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

    file = Path(out)
    require_picture(file, TRACE, "out")
    shown, provenance = _shown(ledger, run)
    content = trace_of(shown.drawn)
    _write(file, content)
    return Picture(file, len(content), (shown.drawn.run.run_id,), None, provenance)


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


def _write(out: Path, content: bytes) -> None:
    from .files import whole_file

    with whole_file(out) as temporary:
        temporary.write_bytes(content)


def _shown(ledger: "Ledger", asked: Run | None) -> "tuple[PageOptions, Provenance]":
    """Return a run with all that is drawn of it, and the provenance of that."""
    from fsar_ledger.analysis.situation import Coverage
    from fsar_ledger.ledger.rows.runs import start_of
    from fsar_ledger.ledger.store.locations import record_of
    from fsar_ledger.view import PageOptions, drawn, words_of

    from .events import asked_of, timeline
    from .lookup import about_run, present

    held, _ = present(ledger)
    with about_run(held, asked, ledger.demanded, is_whole=True) as (database, name, number):
        told = timeline(database, asked_of(database, ledger.path, name, None, None, None, None))
    run = record_of(held, name)
    started = start_of(run)
    provenance = told.provenance
    head = provenance.head
    picture = PageOptions(
        drawn(run, name if number is None else f"{number}", words_of(told.rows())),
        printable.word(ledger.path),
        head.events if head else 0,
        head.root if head else "",
        bool(provenance.rows_verified),
        tuple(Coverage(started).lacking.values()),
    )
    return picture, provenance


def _together(found: "list[Provenance]") -> "Provenance":
    """Return what holds for runs of one ledger: its head, and each gap once."""
    from fsar_ledger.metrics.provenance import Provenance

    gaps = {one.concern: one for each in found for one in each.not_observed}
    verified = all(each.rows_verified for each in found)
    return Provenance(found[0].head, verified, None, tuple(gaps.values()))
