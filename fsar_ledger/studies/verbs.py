"""The verbs `study run NAME` and `study show`. `study run multiverse` is a verb of a ledger (`api/multiverse.py`)."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from fsar_ledger.api.answers import Answer, Lines, Row, Screen
from fsar_ledger.api.names import Place
from fsar_ledger.api.verbs import Option, Shows, WorkersOption, argument, declare, verb
from fsar_ledger.base import printable
from fsar_ledger.base.errors import UsageError
from fsar_ledger.base.printable import SafeText
from fsar_ledger.base.progress import Progress

if TYPE_CHECKING:
    from fsar_ledger.metrics.effects import About, Sensitivity
    from fsar_ledger.metrics.study_results import Calibration, Comparison, Predictions

STUDIES = ("calibration", "predictions", "comparison", "sensitivity")
"""Those whose results are files."""

OutOption = Annotated[Place, Option("--out", "FILE", "The result, as JSON; replaced if it exists.")]


@verb(
    "study show comparison",
    "study show calibration out/calibration.json",
    name="study show",
    takes=("wide",),
)
def study_show(
    name: Annotated[str, argument("NAME", "calibration, predictions, comparison or sensitivity.", complete="studies")],
    file: Place | None = argument("FILE", "What `study run NAME` wrote.", "the result in this package"),
) -> Answer:
    """Show the result of a study as tables, and whether what it rests on has changed since.

    It rests on the version of the model, the constants and the queries that judged its runs. The package has results of
    the calibration, the predictions and the comparison; that of `study run multiverse` is in no file.

    Raises:
        InvalidExperiment: There is no such study.
        UsageError: The file cannot be read, or none is given and the package has none.
        FsarLedgerError: It holds something else.
    """
    from fsar_ledger.designs.names import known
    from fsar_ledger.metrics.effects import MADE_BY, open_effects
    from fsar_ledger.metrics.study_results import Calibration, Comparison, Predictions, packaged, read

    known("study", [name], STUDIES)
    if name == "sensitivity":
        if file is None:
            raise UsageError(f"study show sensitivity: expected a file of `{MADE_BY}`; the package has none")
        effects = open_effects(Path(file))
        return Effects(effects, _standing(effects.about))
    kinds: dict[str, type[Calibration | Predictions | Comparison]] = {
        "calibration": Calibration,
        "predictions": Predictions,
        "comparison": Comparison,
    }
    found = packaged(kinds[name]) if file is None else read(Path(file), kinds[name])
    if found is None:
        raise UsageError(f"study show {name}: expected a file of `{kinds[name].MADE_BY}`; the package has none")
    return Result(found, _standing(found))


@verb("study run calibration --out out/calibration.json", name="study run calibration", takes=(), old="calibrate")
def calibration(
    out: OutOption,
    workers: WorkersOption = None,
    progress: Annotated[Progress | None, Shows("tried", "parameter sets")] = None,
) -> Lines:
    """Fit the constants again as registered; takes the better part of an hour.

    The fit is to the paper's results table alone. `reports/registration.toml` names the constants and their ranges. The
    result says where the fit began, what the data identify and what was accepted.
    """
    from .calibration import calibrate

    calibrate(out, workers=workers, progress=progress)
    return Lines(f"{out}")


@verb("study run predictions --out out/predictions.json", name="study run predictions", takes=(), old="predict")
def predictions(
    out: OutOption,
    workers: WorkersOption = None,
    progress: Annotated[Progress | None, Shows("played", "experiments")] = None,
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
    old="judge",
)
def comparison(
    predictions: Annotated[Place, argument("PREDICTIONS", "What `study run predictions` wrote.")], out: OutOption
) -> Lines:
    """Compare predicted numbers with the paper's, and with what its claims were registered to imply.

    Nothing is simulated. In the source of this package, `reports/predictions.json` holds the predictions made right
    after the fit, and `reports/comparison.json` their comparison.
    """
    from .comparison import judge

    judge(predictions, out)
    return Lines(f"{out}")


class Effects(Answer):
    """The effects of a sensitivity study, and lines below them."""

    def __init__(self, found: "Sensitivity", *below: str) -> None:
        self._found, self._below = found, below

    def text(self, screen: Screen) -> Iterator[SafeText]:
        """Yield how much was varied, and the table of the factors that matter most."""
        from fsar_ledger.metrics.effects import dozen, reach

        about, rows = self._found.about, dozen(self._found)
        still = sum(furthest == 0 for furthest in reach(self._found).values())
        yield printable.line(
            f"{len(about.factors)} factors, {about.evaluations:,} evaluations; {still} factors move nothing; in "
            "margins of the cell moved furthest:"
        )
        yield screen.table(rows) if rows else printable.line("none moves anything")
        yield printable.lines(*self._below)


@verb(
    "study run sensitivity --out out/sensitivity.parquet --svg out/sensitivity.svg",
    "study run sensitivity --out out/short.parquet --trajectories 2 --runs 1 --points 0",
    name="study run sensitivity",
    takes=("wide",),
    after_interruption="finished evaluations are kept beside --out, and the same command continues there",
    old="sensitivity",
)
def sensitivity(
    out: Annotated[Place, Option("--out", "FILE", "The effects, as Parquet; replaced if it exists.")],
    trajectories: int = declare("N", "How often each factor is moved.", value=20),
    runs: int = declare("N", "Runs per scenario and architecture of each evaluation.", value=10),
    points: int = declare("N", "Evaluations for the Sobol indices; 0: none, only the screening.", value=512),
    svg: Place | None = declare("FILE", "Also draw them, as SVG; replaced if it exists."),
    workers: WorkersOption = None,
    progress: Annotated[Progress | None, Shows("evaluated", "points")] = None,
) -> Effects:
    """Measure how much each number depends on each constant; takes most of an hour on two cores.

    Morris screening varies every constant of the world and of the structure, the load and the fleet size. Sobol indices
    then give the part of each number's variance that is due to each of the dozen constants that move a number furthest.
    An interrupted study continues where it stopped.
    """
    from fsar_ledger.base.publishing import publish
    from fsar_ledger.ledger.store.paths import require_outside
    from fsar_ledger.report.sensitivity import heat_map

    from .sensitivity import sensitivity as study

    if svg is not None:
        require_outside(Path(svg), f"--svg {svg}")
    found = study(out, trajectories=trajectories, runs=runs, points=points, workers=workers, progress=progress)
    if svg is not None:
        publish(Path(svg), heat_map(found))
    return Effects(found, *(f"{file}" for file in (out, svg) if file is not None))


class Result(Answer):
    """The stored result of a study, and whether it is stale."""

    def __init__(self, found: "Calibration | Predictions | Comparison", standing: str) -> None:
        self._found, self._standing = found, standing

    def text(self, screen: Screen) -> Iterator[SafeText]:
        """Yield the tables that have rows, and whether the result is stale."""
        for rows in filter(None, _tables(self._found)):
            yield screen.table(rows)
            yield printable.line("")
        yield printable.line(self._standing)


def _standing(result: "Calibration | Predictions | Comparison | About") -> str:
    from .result import stale

    differs = stale(result)
    return f"stale: found results {differs}" if differs else "nothing that it rests on has changed since"


def _tables(result: "Calibration | Predictions | Comparison") -> "Iterator[Sequence[Row]]":
    """Yield the tables of a result: the numbers of all scenarios together, and no single checks."""
    from fsar_ledger.api.table import plain
    from fsar_ledger.metrics.study_results import Calibration, Predictions

    if isinstance(result, Calibration):
        yield plain(result.parameters)
        yield plain(result.residuals)
    elif isinstance(result, Predictions):
        yield plain([one for one in result.numbers if one.scenario is None])
        yield plain(result.cases)
    else:
        yield plain(result.cells)
        names = ("name", "implies", "held", "of", "holds")
        yield [{name: getattr(one, name) for name in names} for one in result.predictions]
