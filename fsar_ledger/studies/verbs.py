"""The verbs `study run NAME` and `study show`. `study run multiverse` is a verb of a ledger (`api/metrics.py`)."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from fsar_ledger.api.answers import Answer, Lines, Screen
from fsar_ledger.api.names import Place
from fsar_ledger.api.verbs import Option, Shows, WorkersOption, argument, declare, verb
from fsar_ledger.base import printable
from fsar_ledger.base.errors import UsageError
from fsar_ledger.base.printable import SafeText
from fsar_ledger.base.progress import Progress

if TYPE_CHECKING:
    from fsar_ledger.metrics.study_results import Result

STUDIES = ("ranking", "calibration", "ensemble", "predictions", "comparison", "sensitivity", "placebo", "systems")
"""The studies whose results are files."""

OutOption = Annotated[Place, Option("--out", "FILE", "The result, as JSON; replaced if it exists.")]
GOES_ON = "finished evaluations are kept beside --out, and the same command continues from there"
Points = Annotated[Progress | None, Shows("evaluated", "points")]


class ResultTables(Answer):
    """The result of a study as tables, with a sentence above them and lines below."""

    def __init__(self, found: "Result", *below: str) -> None:
        self._found, self._below = found, below

    def text(self, screen: Screen) -> Iterator[SafeText]:
        """Yield the sentence, if there is one, and the tables that have rows."""
        if summary := self._found.summary():
            yield printable.line(summary)
        for rows in filter(None, self._found.tables()):
            yield screen.table(rows)
            yield printable.line("")
        yield printable.lines(*self._below)


@verb(
    "study show comparison",
    "study show calibration out/calibration.json",
    name="study show",
    takes=("wide",),
)
def study_show(
    name: Annotated[str, argument("NAME", f"{', '.join(STUDIES[:-1])} or {STUDIES[-1]}.", complete="studies")],
    file: Place | None = argument("FILE", "The file that `study run NAME` wrote.", "the result in this package"),
) -> Answer:
    """Show the result of a study as tables, and whether what it rests on has changed since.

    It rests on the version of the model, the constants, the registration and the queries that judged its runs. The
    package has a result of each study for this version, except of `study run multiverse`, whose result is in no file.

    Raises:
        InvalidExperiment: There is no such study.
        UsageError: The file cannot be read, or none is given and the package has none.
        FsarLedgerError: It holds something else.
    """
    from fsar_ledger.designs.registered import known_names
    from fsar_ledger.metrics.study_results import packaged, read

    from .result import KINDS, stale

    known_names("study", [name], STUDIES)
    kind = KINDS[name]
    found = packaged(kind) if file is None else read(Path(file), kind)
    if found is None:
        raise UsageError(f"study show {name}: expected a file of `{kind.MADE_BY}`; the package has none")
    differs = stale(found)
    return ResultTables(
        found, f"stale: found results {differs}" if differs else "nothing that it rests on has changed since"
    )


@verb("study run ranking --out out/ranking.json", name="study run ranking", takes=("wide",), after_interruption=GOES_ON)
def ranking(out: OutOption, workers: WorkersOption = None, progress: Points = None) -> ResultTables:
    """Rank the architectures across the registered ranges, without a fit; takes about 15 minutes on two cores.

    At each registered point, every free constant lies anywhere in its range. The result says in what share of the
    points FSAR is the best of the three in each metric, in what share the paper's order is right, and how often each
    cannot be decided. An interrupted study continues where it stopped.
    """
    from .robustness import ranking as study

    return ResultTables(study(out, workers=workers, progress=progress), f"{out}")


@verb(
    "study run calibration --out out/calibration.json",
    name="study run calibration",
    takes=(),
    after_interruption=GOES_ON,
)
def calibration(
    out: OutOption,
    workers: WorkersOption = None,
    progress: Annotated[Progress | None, Shows("tried", "parameter sets")] = None,
) -> Lines:
    """Fit the constants again as registered; takes most of an hour.

    The fit is to the paper's results table alone. `reports/registration.toml` names the constants and their ranges. The
    result says where the fit began, what the data identify and what was accepted. An interrupted fit continues where it
    stopped.
    """
    from .calibration import calibrate

    calibrate(out, workers=workers, progress=progress)
    return Lines(f"{out}")


@verb(
    "study run ensemble --out out/ensemble.json",
    "study run ensemble out/calibration.json --out out/ensemble.json",
    name="study run ensemble",
    takes=("wide",),
    after_interruption=GOES_ON,
)
def ensemble(
    calibration: Place | None = argument(
        "CALIBRATION", "The file that `study run calibration` wrote.", "the fit in this package"
    ),
    *,
    out: OutOption,
    workers: WorkersOption = None,
    progress: Points = None,
) -> ResultTables:
    """Evaluate points around the fit that explain the paper's results about as well; takes an hour on two cores.

    They are drawn where the slopes of the fit leave them open. A point is plausible if each of the 24 cells lies within
    its margin, and the registered discrepancy, of the printed number. The result says how many points are plausible,
    and with how many of them each verdict on a cell, each sign of a comparison and each rank agrees. An interrupted
    study continues where it stopped.
    """
    from .robustness import ensemble as study

    return ResultTables(study(out, calibration, workers=workers, progress=progress), f"{out}")


@verb("study run predictions --out out/predictions.json", name="study run predictions", takes=())
def predictions(
    out: OutOption,
    workers: WorkersOption = None,
    progress: Annotated[Progress | None, Shows("simulated", "experiments")] = None,
) -> Lines:
    """Simulate the experiments registered for prediction, and write their numbers; takes minutes.

    These are ablations, larger fleets, loads, encounter rates, other seeds and pairs of ablations, with the constants
    as they are. No number of the paper is read. `reports/registration.toml` says what is predicted, and what the
    paper's claims imply for it.
    """
    from .predictions import predict

    predict(out, workers=workers, progress=progress)
    return Lines(f"{out}")


@verb(
    "study run comparison out/predictions.json --out out/comparison.json",
    name="study run comparison",
    takes=(),
)
def comparison(
    predictions: Annotated[Place, argument("PREDICTIONS", "The file that `study run predictions` wrote.")],
    out: OutOption,
) -> Lines:
    """Compare predicted numbers with the paper's, and with what its claims were registered to imply.

    Nothing is simulated. In the source of this package, `reports/predictions.json` holds the predictions made right
    after the fit, and `reports/comparison.json` their comparison.
    """
    from .comparison import judge

    judge(predictions, out)
    return Lines(f"{out}")


@verb(
    "study run sensitivity --out out/sensitivity.json --svg out/sensitivity.svg",
    "study run sensitivity --out out/short.json --trajectories 2 --runs 1 --points 0",
    name="study run sensitivity",
    takes=("cluster", "wide"),
    after_interruption=GOES_ON,
)
def sensitivity(
    out: OutOption,
    trajectories: int = declare("N", "How often each factor is moved.", value=20),
    runs: int = declare("N", "Runs per scenario and architecture of each evaluation.", value=10),
    points: int = declare("N", "Evaluations for the Sobol indices; 0: none, only the screening.", value=512),
    svg: Place | None = declare("FILE", "Also draw them, as SVG; replaced if it exists."),
    workers: WorkersOption = None,
    progress: Points = None,
) -> ResultTables:
    """Measure how much each number depends on each constant; takes most of an hour on two cores.

    Morris screening varies every constant of the world and of the structure, the load and the fleet size. Sobol indices
    then give the part of each number's variance that is due to each of the dozen constants that move a number furthest.
    An interrupted study continues where it stopped.
    """
    from fsar_ledger.base.publishing import publish
    from fsar_ledger.ledger.store.paths import require_outside
    from fsar_ledger.report.study_charts import heat_map

    from .sensitivity import sensitivity as study

    if svg is not None:
        require_outside(Path(svg), f"--svg {svg}")
    result = study(out, trajectories=trajectories, runs=runs, points=points, workers=workers, progress=progress)
    if svg is not None:
        publish(Path(svg), heat_map(result))
    return ResultTables(result, *(f"{file}" for file in (out, svg) if file is not None))


@verb("study run placebo --out out/placebo.json", name="study run placebo", takes=("wide",), after_interruption=GOES_ON)
def placebo(
    out: OutOption,
    workers: WorkersOption = None,
    progress: Annotated[Progress | None, Shows("compared", "repetitions")] = None,
) -> ResultTables:
    """Compare FSAR with itself under the name of another architecture; takes about 10 minutes on two cores.

    It is the negative control of the whole chain from simulation to test. On the same seeds nothing may differ; on
    other seeds each test may reject only as often as its level says. An interrupted study continues where it stopped.
    """
    from .placebo import placebo as study

    return ResultTables(study(out, workers=workers, progress=progress), f"{out}")


@verb("study run systems --out out/systems.json", name="study run systems", takes=("wide",), after_interruption=GOES_ON)
def systems(out: OutOption, workers: WorkersOption = None, progress: Points = None) -> ResultTables:
    """Run every architecture in the same worlds, at 4, 8 and 16 robots and over each dial; takes about 15 minutes.

    These are the paper's three and three published systems, RoboOS, JADE's contract net and ALLIANCE, judged by the
    paper's metrics and by metrics that silence cannot win. Nothing is fitted. An interrupted study continues where it
    stopped.
    """
    from .systems import systems as study

    return ResultTables(study(out, workers=workers, progress=progress), f"{out}")
