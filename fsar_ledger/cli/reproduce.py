"""The paper's experiments, all of them: simulated, judged, typeset into one folder. Nothing here prints."""

from collections.abc import Sequence
from pathlib import Path

from fsar_ledger.ledger.log.note import Signer
from fsar_ledger.ledger.store.paths import require_outside
from fsar_ledger.ledger.store.read import Head
from fsar_ledger.metrics.database import connect
from fsar_ledger.metrics.results import metric_rows, statistic_rows
from fsar_ledger.printable import Shown, joined, lines
from fsar_ledger.report import write_report
from fsar_ledger.runtime.experiment import Made, carry_out
from fsar_ledger.runtime.experiments import NAMES, SEED, Named, named

from .answering import looked_head
from .files import write_text
from .options import known
from .output import csv_text, plain, table_text
from .progress import Progress
from .simulated import beyond

SHOWN = ("architecture", "metric", "mean", "sd", "n", "ci_low", "ci_high")


def reproduce(
    out: Path,
    workers: int,
    signer: Signer | None = None,
    *,
    adopts: bool = False,
    only: Sequence[str] | None = None,
    runs: int | None = None,
) -> tuple[Shown, Head]:
    """The folder holds a ledger of each experiment, the tables and the report; returns the table of metrics as text and the head of the results.

    A signer signs the ledger of the results under its own name, and each other one under that name and the experiment's. The results are always made:
    the tables and the report begin with them.

    Raises:
        UsageError: The folder is a ledger, or lies inside one.
        InvalidExperiment: An experiment of `only` is unknown, or the count of runs impossible.
        FsarLedgerError: As `simulate`, `required_look` and `write_report`.
    """
    require_outside(out, f"--out {out}")
    chosen = [name for name in NAMES if name == "results" or not only or name in known("experiment", only, NAMES)]
    experiments = [named(name, SEED, runs) for name in chosen]
    made = {
        one.name: _carried_out(out / one.name, one, workers, one.signer(signer), adopts=adopts) for one in experiments
    }
    ledger = out / "results"
    demanded = looked_head(ledger, workers)
    with connect(ledger, demanded=demanded) as database:
        metrics, statistics = plain(metric_rows(database)), plain(statistic_rows(database))
    write_text(out / "metrics.csv", csv_text(metrics, list(metrics[0])))
    write_text(out / "statistics.csv", csv_text(statistics, list(statistics[0])))
    beside = [out / one.name for one in experiments if one.name != "results"]
    write_report(
        ledger,
        out / "report.pdf",
        workers=workers,
        demanded=demanded,
        beside=beside,
        numbers_out=out / "reproduction.json",
    )
    return joined(table_text(metrics, SHOWN), lines(*beyond(made["results"]))), made["results"].head


def _carried_out(out: Path, experiment: Named, workers: int, signer: Signer | None, *, adopts: bool) -> Made:
    """All parts of an experiment are in its ledger, one after the other; says of the last what `carry_out` does."""
    origin = experiment.origin if signer is None else None
    for part in experiment.parts:
        with Progress(f"{experiment.name}: simulated", "batches") as progress:
            made = carry_out(out, part, workers, progress, signer, origin, adopts=adopts)
    return made
