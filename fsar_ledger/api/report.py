"""The verbs `report` and `reproduce`: typeset the evaluation, of one ledger or from the experiments on."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec

from fsar_ledger.base import printable
from fsar_ledger.base.errors import UsageError, option
from fsar_ledger.base.printable import SafeText, counted
from fsar_ledger.base.progress import Showing, unseen

from .answers import Answer, Lines, Screen
from .names import KindOfReport, Names, Place, names_of
from .simulate import CONTINUES
from .verbs import AdoptOption, Gives, KeyOption, Option, WorkersOption, declare, readers_of, verb, workers_of

if TYPE_CHECKING:
    from fsar_ledger.base.workers import WorkerPool
    from fsar_ledger.ledger.log.note import Signer
    from fsar_ledger.runtime.experiment import SimulationResult
    from fsar_ledger.runtime.paper import Name, PaperLedger

    from .ledger import Ledger
    from .table import Table


SHOWN = ("architecture", "metric", "mean", "sd", "n", "ci_low", "ci_high")


@verb(
    "report out/ledger --out out/report.pdf",
    "report out/ledger --with out/workflows --with out/untrusting --out out/report.pdf",
    "report out/ledger --out out/report.pdf --numbers out/numbers.json",
    "report out/ledger --kind audit --out out/audit.pdf",
    takes=(),
    memory_factor=3,
)
def report(
    ledger: "Ledger",
    out: Annotated[Place, Option("--out", "FILE", "The PDF; replaced if it exists.")],
    *,
    beside: Sequence[Place] = declare(
        "LEDGER",
        "Another ledger to show, of ablations, larger fleets, workflows or the scenario churn; may be repeated.",
        "none; their sections are omitted",
        flag="--with",
        value=(),
    ),
    workflows: Place | None = declare(
        "LEDGER", "A ledger of the paper's three workflows.", "none; the section is omitted"
    ),
    sensitivity: Place | None = declare("FILE", "A file of `study run sensitivity`.", "the one in this package"),
    numbers: Place | None = declare(
        "FILE", "Write all numbers of the report, as JSON; replaced if it exists.", "not written"
    ),
    kind: KindOfReport = declare(
        "KIND",
        "`paper`: the evaluation beside the paper's. `audit`: what this ledger records, and what is broken or open.",
        "paper if all runs are of its experiment, or another option asks for a part of that report; else audit",
    ),
    workers: WorkersOption = None,
    showing: Annotated["Showing | None", Gives("showing")] = None,
) -> Lines:
    """Typeset the evaluation, or an audit of the ledger, as a PDF.

    In the paper's report each number of the paper stands beside the ledger's, with its interval and a verdict; the runs
    of all seeds are taken together. Ablations, larger fleets, workflows and members that come and go have sections of
    their own where this ledger, or one given by --with, holds them. The audit report is about any ledger: who asked
    whom, what was denied under which rule, what supervisors decided, violations, conflicts and invariants with the
    events behind them, and what was not observed. All rows are compared with their root first, as `verify` does.

    Raises:
        UsageError: The kind is unknown, or options of the paper's report are given for an audit report.
        LedgerCorrupted: The comparison found something.
        WriteFailed: The PDF cannot be written.
    """
    from fsar_ledger.report.build import write_report

    def path(place: Place | None) -> Path | None:
        return None if place is None else Path(place)

    options: dict[str, object] = {"with": beside, "workflows": workflows, "sensitivity": sensitivity}
    of_the_paper = [name for name, argument in options.items() if argument]
    if kind not in (None, "paper", "audit"):
        raise UsageError(f"{option('kind', printable.value(kind))}: expected paper or audit")
    if kind == "audit" and of_the_paper:
        raise UsageError(
            f"{option(of_the_paper[0])}: the audit report is of one ledger; leave it out, or {option('kind')}"
        )
    write_report(
        ledger.path,
        Path(out),
        path(workflows),
        readers_of(workers, ledger.path),
        showing or unseen,
        beside=list(map(Path, beside or ())),
        sensitivity=path(sensitivity),
        numbers_out=path(numbers),
        kind="paper" if kind is None and of_the_paper else kind,
    )
    return Lines(*(f"{file}" for file in (out, numbers) if file is not None))


class Reproduced(Answer, msgspec.Struct, frozen=True):
    """The result of `reproduce`: what was added to each ledger, by experiment, and the metrics of the results."""

    folder: Path
    results: "Mapping[Name, SimulationResult]"
    metrics: "Table"

    @property
    def report(self) -> Path:
        """Return the path of the PDF."""
        return self.folder / "report.pdf"

    @property
    def ledgers(self) -> "dict[Name, Ledger]":
        """Return the ledger of each experiment."""
        from .ledger import Ledger

        return {name: Ledger(self.folder / name) for name in self.results}

    def text(self, screen: Screen) -> Iterator[SafeText]:
        """Yield the metrics of the results, and where the report is."""
        results = self.results["results"]
        summary = f"{results.head.events:,} events, root {results.head.root}, {screen.elapsed_s:.0f} s"
        yield screen.table(self.metrics.rows(), SHOWN)
        yield printable.lines(*beyond(results), "", summary, str(self.report))


@verb(
    "reproduce",
    "reproduce --out out/paper --only results --runs 20",
    takes=("wide",),
    after_interruption=CONTINUES,
)
def reproduce(
    out: Place = declare("FOLDER", "Where the ledgers, the tables and the report go.", value="fsar-out"),
    *,
    only: Names = declare(
        "EXPERIMENT", "results (always made), ablation, scaling or workflows; may be repeated.", "all"
    ),
    runs: int | None = declare(
        "N", "Runs of each scenario, spread over the registered seeds.", "results 200, ablation 40, scaling 20"
    ),
    key: KeyOption = None,
    adopt: AdoptOption = False,
    workers: WorkersOption = None,
    showing: Annotated["Showing | None", Gives("showing")] = None,
) -> Reproduced:
    """Run the paper's experiments, judge them and typeset the report.

    FOLDER then holds report.pdf, its numbers as reproduction.json, metrics.csv, statistics.csv and a ledger of each
    experiment: results/, ablation/, scaling/ and workflows/. The key signs results/ under its name NAME, and the others
    under NAME/ablation, NAME/scaling and NAME/workflows, because no two ledgers may have one origin.

    Raises:
        UsageError: The folder is a ledger, or lies inside one.
        InvalidExperiment: An experiment is unknown, or the number of runs impossible.
    """
    from fsar_ledger.base.workers import WorkerPool
    from fsar_ledger.designs.registered import known_names
    from fsar_ledger.ledger.store.paths import require_outside
    from fsar_ledger.metrics.database import connect
    from fsar_ledger.metrics.provenance import of_outcomes
    from fsar_ledger.metrics.results import MetricRow, StatisticRow, metric_rows, statistic_rows
    from fsar_ledger.metrics.verified import ensure_verified
    from fsar_ledger.report.build import write_report
    from fsar_ledger.runtime.paper import NAMES, paper_ledger

    from .files import write_csv
    from .key import signer_of
    from .table import Table, of_structs

    folder, processes, signer, show = Path(out), workers_of(workers), signer_of(key, adopts=adopt), showing or unseen
    require_outside(folder, option("out", folder))
    wanted = known_names("experiment", names_of(only), NAMES)
    experiments = [paper_ledger(name, runs) for name in NAMES if name == "results" or not wanted or name in wanted]
    with WorkerPool(processes) as pool:
        results = {
            experiment.name: _carried_out(
                folder / experiment.name, experiment, pool, experiment.signer(signer), show, adopts=adopt
            )
            for experiment in experiments
        }
    ledger = folder / "results"
    with show("verified", "segments") as progress:
        demanded = ensure_verified(ledger, processes, progress)
    with connect(ledger, demanded=demanded) as database:
        metrics, statistics = metric_rows(database, pools_seeds=True), statistic_rows(database, pools_seeds=True)
        table = Table(of_structs(metrics, MetricRow), of_outcomes(database))
    write_csv(folder / "metrics.csv", table)
    write_csv(folder / "statistics.csv", Table(of_structs(statistics, StatisticRow)))
    write_report(
        ledger,
        folder / "report.pdf",
        workers=processes,
        demanded=demanded,
        beside=[folder / experiment.name for experiment in experiments if experiment.name != "results"],
        numbers_out=folder / "reproduction.json",
        showing=show,
    )
    return Reproduced(folder, results, table)


def _carried_out(
    out: Path,
    experiment: "PaperLedger",
    workers: "WorkerPool",
    signer: "Signer | None",
    showing: Showing,
    *,
    adopts: bool,
) -> "SimulationResult":
    """Append all parts of an experiment to its ledger, one after the other; return its final head and counts.

    A signer signs the ledger of the results under its own name, and the others under names of their own.
    """
    from fsar_ledger.runtime.experiment import run_experiment

    origin = experiment.origin if signer is None else None
    for part in experiment.parts:
        with showing(f"{experiment.name}: simulated", "batches") as progress:
            result = run_experiment(out, part, workers, progress, signer, origin, adopts=adopts)
    return msgspec.structs.replace(result, runs_asked=experiment.size)


def beyond(result: "SimulationResult") -> list[str]:
    """Return a line on runs beyond the requested ones, which are judged too; empty if there are none."""
    if not (more := result.runs_held - result.runs_asked):
        return []
    return [
        f"the ledger holds {counted(more, 'run')} beyond the {result.runs_asked:,} of the paper's experiment, and they "
        "are also judged here"
    ]
