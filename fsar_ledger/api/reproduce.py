"""Simulate all the paper's experiments, judge them and typeset the report, in one folder."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import msgspec

from fsar_ledger.errors import option
from fsar_ledger.ledger.log.note import Signer
from fsar_ledger.ledger.store.paths import require_outside
from fsar_ledger.metrics.database import connect
from fsar_ledger.metrics.progress import Showing
from fsar_ledger.metrics.results import MetricRow, StatisticRow, metric_rows, statistic_rows
from fsar_ledger.metrics.verified import ensure_verified
from fsar_ledger.report.build import write_report
from fsar_ledger.runtime.experiment import SimulationResult, run_experiment
from fsar_ledger.runtime.paper import NAMES, SEED, Name, PaperLedger, paper_ledger

from .fields import csv_text, plain
from .files import write_text
from .ledger import Ledger
from .names import known
from .provenance import of_judgement
from .table import Table, of_structs


class Reproduced(msgspec.Struct, frozen=True):
    """The result of `reproduce`: what was added to each ledger, by experiment, and the metrics of the results."""

    folder: Path
    made: Mapping[Name, SimulationResult]
    metrics: Table

    @property
    def report(self) -> Path:
        """Return the path of the PDF."""
        return self.folder / "report.pdf"

    @property
    def ledgers(self) -> dict[Name, Ledger]:
        """Return the ledger of each experiment."""
        return {name: Ledger(self.folder / name) for name in self.made}


def reproduce_experiments(
    out: Path,
    workers: int,
    signer: Signer | None,
    showing: Showing,
    *,
    adopts: bool = False,
    only: Sequence[str] | None = None,
    runs: int | None = None,
) -> Reproduced:
    """Write a ledger of each experiment, the tables and the report to the folder.

    A signer signs the ledger of the results under its own name NAME, and the others under NAME/EXPERIMENT. The results
    are always made, because the tables and the report begin with them.

    Raises:
        UsageError: The folder is a ledger, or lies inside one.
        InvalidExperiment: An experiment of `only` is unknown, or the count of runs impossible.
        FsarLedgerError: As `simulate`, `ensure_verified` and `write_report`.
    """
    require_outside(out, option("out", out))
    chosen = [name for name in NAMES if name == "results" or not only or name in known("experiment", only, NAMES)]
    experiments = [paper_ledger(name, SEED, runs) for name in chosen]
    made = {
        one.name: _carried_out(out / one.name, one, workers, one.signer(signer), showing, adopts=adopts)
        for one in experiments
    }
    ledger = out / "results"
    with showing("verified", "segments") as progress:
        demanded = ensure_verified(ledger, workers, progress)
    with connect(ledger, demanded=demanded) as database:
        metrics, statistics = metric_rows(database), statistic_rows(database)
        table = Table(of_structs(metrics, MetricRow), of_judgement(database))
    write_text(out / "metrics.csv", csv_text(plain(metrics), MetricRow.__struct_fields__))
    write_text(out / "statistics.csv", csv_text(plain(statistics), StatisticRow.__struct_fields__))
    beside = [out / one.name for one in experiments if one.name != "results"]
    write_report(
        ledger,
        out / "report.pdf",
        workers=workers,
        demanded=demanded,
        beside=beside,
        numbers_out=out / "reproduction.json",
        showing=showing,
    )
    return Reproduced(out, made, table)


def _carried_out(
    out: Path, experiment: PaperLedger, workers: int, signer: Signer | None, showing: Showing, *, adopts: bool
) -> SimulationResult:
    """Append all parts of an experiment to its ledger, one after the other; return what the last added."""
    origin = experiment.origin if signer is None else None
    for part in experiment.parts:
        with showing(f"{experiment.name}: simulated", "batches") as progress:
            made = run_experiment(out, part, workers, progress, signer, origin, adopts=adopts)
    return made
