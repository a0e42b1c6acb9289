"""The functions of the API that make ledgers."""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from .experiments import experiment_of
from .key import origin_of, signer_of
from .ledger import Ledger
from .names import Names, Place, names_of
from .workload import WORTH_ROBOTS, Progress, workers_of

if TYPE_CHECKING:
    from fsar_ledger.runtime.experiment import Made

    from .reproduce import Reproduced


class Simulated(msgspec.Struct, frozen=True):
    """The result of `simulate`; the ledger may also hold runs from before."""

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

    The same call continues an interrupted simulation. A call with more runs, or other scenarios, adds what is missing.

    Args:
        out: A new folder, or that of a ledger to continue.
        architecture: One or several of `fsar`, `cfc` and `dhma`; None: all, or with `without` the one that has them.
        scenario: One or several registered ones, or a `.toml` file of your own; None: the paper's five.
        workflow: One or several of the paper's workflows, under FSAR, instead of scenarios.
        runs: Runs of each scenario and architecture; None: 20, or 1 of a workflow.
        seed: Decides every draw of the world.
        fleet: A fleet of your own, a `.toml` file; None: the paper's.
        settings: New values of constants, such as `world.review_share=0.5`.
        fleet_size: Robots, a multiple of the fleet's team; None: one team.
        teams_working: Teams that have tasks; None: all.
        task_sets: How often each team gets the tasks of its scenario, 30 s apart.
        without: Mechanisms to remove, a configuration for each; names joined by + are removed together.
        origin: The name under which the ledger is published.
        key: A file of `key_new`, to sign with.
        adopt: Continue a ledger that another key signed, or none.
        workers: Processes at once; None: one per core, if there is enough to do. The ledger does not depend on it.
        progress: Called with the batches done and their total.

    Raises:
        InvalidExperiment: A name is unknown, or a number impossible.
        UsageError: The arguments contradict each other.
        WriteFailed: A write failed; what is committed stays.
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
    """Run the paper's experiments, judge them and typeset the report, all in the folder `out`.

    Args:
        out: The folder.
        only: Some of results (always made), ablation, scaling and workflows; None: all.
        runs: Runs of each scenario; None: results 200, ablation 40, scaling 20.
        key: As in `simulate`.
        adopt: As in `simulate`.
        workers: As in `simulate`.
        showing: Called with a verb and a unit for each step; returns a context that yields a progress function.

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
