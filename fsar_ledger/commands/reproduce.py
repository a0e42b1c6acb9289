"""The paper's experiment, all of it: simulated, judged, typeset into one folder. Nothing here prints."""

from pathlib import Path

from fsar_ledger.ledger.note import Signer
from fsar_ledger.ledger.place import require_outside
from fsar_ledger.ledger.read import Head
from fsar_ledger.metrics.database import connect
from fsar_ledger.metrics.results import metric_rows, statistic_rows
from fsar_ledger.printable import Shown, joined, lines
from fsar_ledger.report import write_report
from fsar_ledger.runtime.experiment import WORKFLOWS_ORIGIN, carry_out, simulate, workflow_experiment

from .answering import looked_head
from .files import write_text
from .options import experiment_of
from .output import csv_text, plain, table_text
from .progress import Progress
from .simulated import beyond

SEED = 42
SHOWN = ("architecture", "metric", "mean", "sd", "n", "ci_low", "ci_high")


def reproduce(out: Path, workers: int, signer: Signer | None = None, *, adopts: bool = False) -> tuple[Shown, Head]:
    """The folder holds the ledgers, the tables and the report; returns the table of metrics as text and the ledger's head.

    A signer signs the main ledger; that of the workflows has an origin of its own and is unsigned.

    Raises:
        UsageError: The folder is a ledger, or lies inside one.
        FsarLedgerError: As `simulate`, `required_look` and `write_report`.
    """
    require_outside(out, f"--out {out}")
    ledger = out / "ledger"
    with Progress("simulated", "batches") as progress:
        made = carry_out(ledger, experiment_of(None, None, None, SEED, 4, None), workers, progress, signer, adopts=adopts)
    demanded = looked_head(ledger, workers)
    with connect(ledger, demanded=demanded) as database:
        metrics, statistics = plain(metric_rows(database)), plain(statistic_rows(database))
    write_text(out / "metrics.csv", csv_text(metrics, list(metrics[0])))
    write_text(out / "statistics.csv", csv_text(statistics, list(statistics[0])))
    workflows = out / "workflows"
    simulate(workflows, workflow_experiment(SEED), 1, origin=WORKFLOWS_ORIGIN)
    write_report(ledger, out / "report.pdf", workflows, workers, demanded=demanded)
    return joined(table_text(metrics, SHOWN), lines(*beyond(made))), made.head
