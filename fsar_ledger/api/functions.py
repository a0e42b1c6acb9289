"""Functions that make ledgers and the records beside them, and `verify_proof`."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from .experiments import experiment_of
from .keys import origin_of, signer_of, trusted_of
from .ledger import Ledger
from .names import Place, names_of
from .workload import WORTH_ROBOTS, Progress, workers_of

if TYPE_CHECKING:
    from fsar_ledger.ledger.store.proof import Proven
    from fsar_ledger.report.sensitivity import Sensitivity
    from fsar_ledger.runtime.experiment import Made

    from .reproduce import Reproduced

Names = str | Sequence[str] | None


class Simulated(msgspec.Struct, frozen=True):
    """The result of `simulate`. Some runs may have been there before, and the ledger may hold others."""

    ledger: Ledger
    made: "Made"


def simulate(
    out: Place,
    *,
    architecture: Names = None,
    scenario: Names = None,
    workflow: Names = None,
    runs: int | None = None,
    seed: int = 42,
    fleet: Place | None = None,
    settings: Names = None,
    fleet_size: int | None = None,
    teams_working: int | None = None,
    task_sets: int = 1,
    without: Names = None,
    origin: str | None = None,
    key: Place | None = None,
    adopt: bool = False,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Simulated:
    """Simulate fleets, and append every event to the ledger in the folder `out`.

    The same call continues an interrupted simulation; one with more runs, or other scenarios, enlarges the ledger.

    Args:
        out: The folder: new, or of a ledger to continue.
        architecture: `fsar`, `cfc` or `dhma`, one or several; None: all, with `without` whose that is.
        scenario: One or several registered ones, or one `.toml` file of your own; None: the paper's five.
        workflow: Instead, one or several of the paper's workflows, under FSAR.
        runs: Runs of each scenario and architecture; None: 20, of a workflow 1.
        seed: Decides every draw of the world.
        fleet: A `.toml` file with a fleet of your own; None: the paper's.
        settings: Other values of constants, as `world.review_share=0.5`.
        fleet_size: Robots, a multiple of the fleet's team; None: one team.
        teams_working: Teams that have tasks; None: all.
        task_sets: How often each team gets the tasks of its scenario, 30 s apart.
        without: Mechanisms to take out, one configuration for each; several at once with + between them.
        origin: The name that the ledger is published under.
        key: A file of `key_new`, to sign with.
        adopt: Sign on where another key or none signed what is there.
        workers: Processes at once; None: one per core, if there is enough to do. The ledger is the same for any number.
        progress: Called with batches done and in all.

    Raises:
        InvalidExperiment: A name is unknown, or a number impossible.
        UsageError: What was asked for does not fit together.
        WriteFailed: The disk refused; what is committed stays.
    """
    from fsar_ledger.runtime.experiment import carry_out

    scenarios, load = names_of(scenario), (teams_working, task_sets)
    experiment = experiment_of(
        names_of(architecture),
        scenarios,
        runs,
        seed,
        fleet_size,
        names_of(without),
        names_of(workflow),
        load,
        None if fleet is None else str(fleet),
        names_of(settings),
    )
    signer = signer_of(key, adopts=adopt)
    processes = workers_of(workers, experiment.size * experiment.fleet_size // WORTH_ROBOTS)
    made = carry_out(Path(out), experiment, processes, progress, signer, origin_of(origin), adopts=adopt)
    return Simulated(Ledger(out), made)


def reproduce(
    out: Place = "fsar-out",
    *,
    only: Names = None,
    runs: int | None = None,
    key: Place | None = None,
    adopt: bool = False,
    workers: int | None = None,
    showing: Callable[[str, str], AbstractContextManager[Progress | None]] = lambda *_: nullcontext(),
) -> "Reproduced":
    """Make the paper's experiments, judge them, typeset the report, all in the folder `out`.

    Args:
        out: The folder.
        only: Of results (always made), ablation, scaling and workflows; None: all.
        runs: Runs of each scenario; None: results 200, ablation 40, scaling 20.
        key: As in `simulate`.
        adopt: As in `simulate`.
        workers: As in `simulate`.
        showing: Makes, for each step (what is done, of what unit), a context that yields what to call with the
            progress.

    Raises:
        UsageError: The folder is a ledger, or lies inside one.
        InvalidExperiment: An experiment is unknown, or the number of runs impossible.
    """
    from .reproduce import reproduce_experiments

    return reproduce_experiments(
        Path(out),
        workers_of(workers),
        signer_of(key, adopts=adopt),
        showing,
        adopts=adopt,
        only=names_of(only),
        runs=runs,
    )


def verify_proof(file: Place, trusted_key: str | None = None) -> "Proven":
    """Check a proof, the text of `Ledger.prove` in a file, without the ledger; return what it shows.

    Raises:
        LedgerCorrupted: It proves nothing, or the trusted key did not sign it.
    """
    from fsar_ledger.ledger.store.proof import check_proof, read_proof

    return check_proof(str(file), read_proof(Path(file)), trusted_of(trusted_key))


def calibrate(out: Place, *, workers: int | None = None, progress: Progress | None = None) -> None:
    """Make the registered fit again, and write its record; takes the better part of an hour."""
    from fsar_ledger.calibration import calibrate

    calibrate(Path(out), progress, workers_of(workers))


def predict(out: Place, *, workers: int | None = None, progress: Progress | None = None) -> None:
    """Play what is registered to be predicted, and write down the numbers; takes minutes."""
    from fsar_ledger.prediction import predict

    predict(Path(out), progress, workers_of(workers))


def judge(predictions: Place, out: Place) -> None:
    """Lay predicted numbers beside the paper's, and write the comparison. Plays nothing."""
    from fsar_ledger.comparison import compare_predictions

    compare_predictions(Path(predictions), Path(out))


def sensitivity(
    out: Place,
    *,
    trajectories: int = 20,
    runs: int = 10,
    points: int = 512,
    workers: int | None = None,
    progress: Progress | None = None,
) -> "Sensitivity":
    """Find out how much of each number depends on each constant, and write the effects as Parquet.

    Takes most of an hour.

    Args:
        out: The file. An interrupted study goes on from what is kept beside it.
        trajectories: Times that each factor is moved.
        runs: Runs of each scenario and architecture in an evaluation.
        points: Evaluations for the Sobol indices; 0: only the screening.
        workers: Processes at once.
        progress: Called with evaluations done and in all.
    """
    from fsar_ledger.screening.study import Size, sensitivity

    return sensitivity(Path(out), Size(trajectories, runs, points), workers_of(workers), progress)
