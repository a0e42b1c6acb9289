"""The verb `export`: events, or the answer of a query, as a file; or a ledger in the format of another system."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec

from fsar_ledger.base import printable
from fsar_ledger.base.errors import UsageError, option
from fsar_ledger.base.progress import Progress

from .answers import Answer, Screen
from .names import Place, Run
from .verbs import Option, ParameterOption, RawOption, Shows, declare, switch, verb

if TYPE_CHECKING:
    from fsar_ledger.metrics.provenance import Provenance

    from .ledger import Ledger


class ExportResult(Answer, msgspec.Struct, frozen=True):
    """The number of rows (or tiles, or events) that were written to a file, and their provenance.

    `notes` tell what else is in it and what is not.
    """

    row_count: int
    provenance: "Provenance"
    file: Path
    what: str = "rows"
    notes: tuple[str, ...] = ()

    def text(self, _: Screen) -> Iterator[printable.SafeText]:
        """Yield what was written."""
        yield printable.lines(f"{self.file}: {self.row_count:,} {self.what}", *self.notes)


@verb(
    "export out/ledger --out out/events.parquet",
    "export out/ledger --query metrics/run_metrics --out out/run_metrics.csv",
    "export out/ledger --tiles --out out/tiles",
    "export out/ledger --as ocel --run 1 --out out/run_1.json",
    takes=("verified",),
)
def export(
    ledger: "Ledger",
    out: Annotated[
        Place,
        Option(
            "--out",
            "FILE",
            "A .csv, .parquet, .ndjson or .jsonl file; with --as .json or .mcap. Replaced if it exists. With --tiles "
            "or --as delta a new folder.",
        ),
    ],
    query: str | None = declare("NAME", "Export the answer of this query.", "every event", complete="queries"),
    parameters: ParameterOption = None,
    *,
    raw: RawOption = False,
    tiles: bool = switch("Write the hashes of the tree and the checkpoint instead, as C2SP tlog-tiles."),
    format: str | None = declare(
        "FORMAT",
        "Write the format of another system: ocel (process mining), otlp (OpenTelemetry), mcap (Foxglove), perfetto "
        "or delta (Delta Lake).",
        flag="--as",
    ),
    run: Run | None = declare(
        "RUN", "With --as, only this run: its number, its name, or a unique part of it.", "all", complete="runs"
    ),
    progress: Annotated[Progress | None, Shows("exported", "commits")] = None,
) -> ExportResult:
    """Write events, or the answer of a query, to a file.

    The name of the file decides the format: CSV, Parquet, or JSON with one row a line. In CSV, lists are JSON text, and
    text is made harmless for spreadsheets and terminals unless --raw is given. The others hold the values themselves.
    With --as, write events as another system has them (docs/exports.md says what becomes what); the answer says what
    the file lacks.

    Raises:
        UsageError: The file has another suffix, or lies inside a ledger; there is no such run or format, or the library
            of the format is not installed; parameters do not fit each other.
        WriteFailed: The file cannot be written.
    """
    from .files import require_place, write_events, write_table

    file = Path(out)
    if format is not None:
        if query is not None or parameters or raw or tiles:
            raise UsageError(
                f"{option('format', format)}: found a query, parameters, raw text or tiles beside it, expected none of "
                "them; leave one out"
            )
        from .files import write_as

        written, provenance = write_as(ledger, file, format, run, progress)
        return ExportResult(written.events, provenance, file, "events", written.notes)
    if run is not None:
        raise UsageError(
            f"{option('run', run)}: found no format beside it, expected one; give {option('format', 'FORMAT')}, or "
            "select the run in a query"
        )
    if tiles:
        if query is not None or parameters or raw:
            raise UsageError("export: found tiles and a query, parameters or raw text, expected tiles alone")
        from fsar_ledger.exports.folders import write_tiles

        from .lookup import present

        view, provenance = present(ledger)
        return ExportResult(write_tiles(view, file, progress), provenance, file, "tiles")
    require_place(file)
    if query is not None:
        found = ledger.query(query, **(parameters or {}))
        return ExportResult(write_table(file, found.stored, raw=raw), found.provenance, file)
    if parameters:
        raise UsageError(f"export: found parameter {next(iter(parameters))} and no query, expected both or neither")
    return ExportResult(*write_events(ledger.path, file, raw=raw, demanded=ledger.demanded, progress=progress), file)
