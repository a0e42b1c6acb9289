"""Write a run, or two beside each other, to a page of HTML; or a run to a trace that Perfetto opens."""

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import msgspec

from fsar_ledger import printable
from fsar_ledger.analysis.records import record_of
from fsar_ledger.errors import UsageError, option
from fsar_ledger.events import ALONE
from fsar_ledger.events.concerns import CONCERNS
from fsar_ledger.ledger.opening import open_for_answers
from fsar_ledger.ledger.store.paths import require_outside
from fsar_ledger.metrics.observing import Unobserved

from .files import whole_file
from .log_rows import asked_of, timeline
from .lookup import about_run
from .names import Run
from .provenance import Provenance

if TYPE_CHECKING:
    from fsar_ledger.view.page import Shown

PAGE, TRACE = ".html", ".json"


class Source(NamedTuple):
    """A ledger, and the SHA-256 of the newest record if its rows were just compared with its root."""

    path: Path
    demanded: str | None


class Picture(msgspec.Struct, frozen=True):
    """The file, its bytes, the runs that it shows, and the provenance.

    `first_difference` is the first seq at which two runs differ: None where they do not, or where there is only one.
    `other` is the provenance of a run from another ledger.
    """

    file: Path
    size: int
    runs: tuple[str, ...]
    first_difference: int | None
    provenance: Provenance
    other: Provenance | None = None


def require_picture(out: Path, suffix: str, name: str) -> None:
    """Check the name of a file before anything is read. `name` is the parameter that gives it.

    Raises: UsageError if it has another suffix, is a folder, or lies inside a ledger.
    """
    if out.suffix != suffix:
        raise UsageError(
            f"{option(name, out)}: found a file name that ends in {out.suffix or 'nothing'!r}, expected {suffix}; "
            "choose another name"
        )
    if out.is_dir():
        raise UsageError(f"{option(name, out)}: found a folder, expected the name of a file; choose another name")
    require_outside(out, option(name, out))


def write_page(source: Source, out: Path, run: Run | None, second: Run | None, other: Source | None) -> Picture:
    """Write the page. Raises: As `Ledger.view`."""
    from fsar_ledger.runtime.forks import parts_at
    from fsar_ledger.view.page import page

    require_picture(out, PAGE, "out")
    shown = [_shown(source, run)]
    first = None
    if second is not None or other is not None:
        one = shown[0][0].drawn.run
        shown.append(_shown(other or source, one.run_id if second is None else second))
        two = shown[1][0].drawn.run
        if two.run_id == one.run_id and (other is None or other.path.resolve() == source.path.resolve()):
            raise UsageError(
                f"{option('second', second)}: found run {printable.value(one.run_id)} twice, expected two runs; name "
                "another one"
            )
        first = parts_at(one, two)
    content = page(*(picture for picture, _ in shown))
    _write(out, content)
    runs = tuple(picture.drawn.run.run_id for picture, _ in shown)
    provenances = [provenance for _, provenance in shown]
    if other is None:
        return Picture(out, len(content), runs, first, _together(provenances))
    return Picture(out, len(content), runs, first, *provenances)


def write_trace(source: Source, out: Path, run: Run | None) -> Picture:
    """Write the trace. Raises: As `Ledger.trace`."""
    from fsar_ledger.view.perfetto import trace

    require_picture(out, TRACE, "out")
    shown, provenance = _shown(source, run)
    content = trace(shown.drawn)
    _write(out, content)
    return Picture(out, len(content), (shown.drawn.run.run_id,), None, provenance)


def _write(out: Path, content: bytes) -> None:
    with whole_file(out) as temporary:
        temporary.write_bytes(content)


def _shown(source: Source, asked: Run | None) -> tuple["Shown", Provenance]:
    """Return a run with all that is drawn of it, and the provenance of that."""
    from fsar_ledger.view.drawn import drawn, words_of
    from fsar_ledger.view.page import Shown

    view = open_for_answers(source.path)
    with about_run(view, asked, source.demanded) as (database, name, number):
        told = timeline(database, asked_of(database, source.path, name, None, None, None, None))
    run = record_of(view, name)
    if type(run.events[0]) in ALONE:
        raise UsageError(
            f"run {printable.value(name)}: found the plan of an experiment, expected a run; "
            f"`fsar-ledger query runs {printable.word(source.path)}` lists them"
        )
    provenance = told.provenance
    missing = tuple(concern for concern in CONCERNS if concern not in getattr(run.events[0], "observes", ()))
    head = provenance.head
    picture = Shown(
        drawn(run, name if number is None else f"{number}", words_of(told.rows())),
        printable.word(source.path),
        head.size if head else 0,
        head.root if head else "",
        bool(provenance.rows_verified),
        missing,
    )
    return picture, provenance


def _together(found: list[Provenance]) -> Provenance:
    """Return what holds for runs of one ledger: its head, and each gap once."""
    gaps: dict[str, Unobserved] = {one.concern: one for each in found for one in each.not_observed}
    verified = all(each.rows_verified for each in found)
    return Provenance(found[0].head, verified, None, tuple(gaps.values()))
