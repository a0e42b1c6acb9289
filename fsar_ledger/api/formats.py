"""Write a ledger in the format of another system, whole or not at all: `export --as`."""

from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import pyarrow as pa
import pyarrow.compute as pc

from fsar_ledger.analysis.records import record_of
from fsar_ledger.base.errors import UsageError, option
from fsar_ledger.base.progress import Progress, each
from fsar_ledger.exports import delta, mcap, ocel, otlp
from fsar_ledger.exports.shared import Written

from .files import whole_file
from .lookup import present, run_in
from .names import Run
from .verbs import either
from .view import require_picture, trace

if TYPE_CHECKING:
    from fsar_ledger.ledger.rows.codec import LedgerRun
    from fsar_ledger.ledger.store.read import View

    from .ledger import Ledger
    from .provenance import Provenance

SUFFIXES: Mapping[str, str] = {"ocel": ".json", "otlp": ".json", "mcap": ".mcap", "perfetto": ".json", "delta": ""}
"""By format, how the name of its file ends; the last is a folder."""
EXTRAS = {"mcap": "mcap", "deltalake": "lake"}
"""By library that only one format needs, the extra of the package that has it."""


def write_as(
    ledger: "Ledger", file: Path, format: str, run: Run | None, progress: Progress | None
) -> "tuple[Written, Provenance]":
    """Write a run, or without one all of them, in a format of `SUFFIXES`; return what was written, and its provenance.

    Raises:
        UsageError: There is no such format or run; the file has another suffix or lies inside a ledger; the format
            needs a library that is not installed, one run and no other, or all of them.
        LedgerCorrupted: A segment is not as committed.
        WriteFailed: The file cannot be written.
    """
    if format not in SUFFIXES:
        raise UsageError(f"{option('format', format)}: found no such format, expected {either(SUFFIXES)}; choose one")
    if format != "delta":
        require_picture(file, SUFFIXES[format], "out")
    elif file.suffix:
        raise UsageError(
            f"{option('out', file)}: found a name that ends in {file.suffix!r}, expected that of a new folder, without "
            "a suffix; choose another name"
        )
    if format == "delta" and run is not None:
        raise UsageError(
            f"{option('run', run)} and {option('format', format)}: a Delta table has whole segments, which hold other "
            "runs, too; expected one of them: leave the run out, and select it in the table"
        )
    view, provenance = present(ledger)
    name = None if run is None else run_in(view, run, ledger.demanded)
    if format == "perfetto":
        name = name or _only_run(view)
        trace(ledger, file, name)
        return Written(sum(one.rows for one in view.extents() if one.run == name), ()), provenance
    try:
        return _written(view, file, format, name, progress), provenance
    except ImportError as error:
        library = (error.name or "").partition(".")[0]
        if library not in EXTRAS:
            raise
        raise UsageError(
            f"{option('format', format)}: found no library {library}, expected it; install it with "
            f'`pip install "fsar-ledger[{EXTRAS[library]}]"`'
        ) from error


def _written(view: "View", file: Path, format: str, run: str | None, progress: Progress | None) -> Written:
    if format == "delta":
        return delta.write(file, view)
    with whole_file(file) as temporary:
        if format == "mcap":
            return mcap.write(temporary, view, _tables(view, run, progress))
        runs = _runs(view, progress) if run is None else [record_of(view, run)]
        if format == "otlp":
            return otlp.write(temporary, runs)
        return ocel.write(temporary, runs, {name: at for at, name in enumerate(view.run_names.runs, start=1)})


def _runs(view: "View", progress: Progress | None) -> "Iterator[LedgerRun]":
    """Yield every run, and report progress in commits."""
    ends, done = [commit.tree_size for commit in view.commits], 0
    for run in view.runs():
        yield run
        done += len(run.events)
        if progress is not None:
            progress(bisect_right(ends, done), len(ends))


def _tables(view: "View", run: str | None, progress: Progress | None) -> Iterable[pa.Table]:
    """Yield the stored rows, or those of one run, a table for each segment that has any."""
    numbers = range(len(view.releases)) if run is None else view.segments_of(view.parts(run))
    for number in each(numbers, progress):
        table = view.table(number)
        yield table if run is None else table.filter(pc.equal(table.column("run_id"), run))


def _only_run(view: "View") -> str | None:
    """Return the only run; None if there is none at all. Raises: UsageError if there are several."""
    names = view.run_names.runs
    if len(names) > 1:
        raise UsageError(
            f"{option('format', 'perfetto')}: found {len(names):,} runs and none that is asked for, expected one, as a "
            f"trace shows one; name it with {option('run')}"
        )
    return names[0] if names else None
