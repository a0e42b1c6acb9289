"""Which experiment the names and numbers that `simulate` is given stand for."""

from typing import TYPE_CHECKING, Any

from fsar_ledger import printable
from fsar_ledger.errors import InvalidExperiment, UsageError

from .names import known

if TYPE_CHECKING:
    from fsar_ledger.runtime.experiment import Experiment

RUNS = 20  # per scenario and architecture, as in the paper


def experiment_of(
    architectures: list[str] | None,
    scenarios: list[str] | None,
    runs: int | None,
    seed: int,
    fleet_size: int,
    without: list[str] | None,
    workflows: list[str] | None = None,
    load: tuple[int | None, int] = (None, 1),
) -> "Experiment":
    """The experiment that the options of `simulate` name; a mechanism is of one architecture, so with one the default is that architecture alone.

    `load` is how many teams work (None: all), and how many sets of tasks each of them gets.

    Raises:
        InvalidExperiment: a name is unknown, or a number impossible.
        UsageError: a workflow was asked for together with what it does not have.
    """
    if workflows:
        others = {
            "--scenario": scenarios,
            "--without": without,
            "--teams-working": load[0],
            "--task-sets": load[1] if load[1] != 1 else None,
        }
        return _workflows_of(workflows, runs, seed, others, architectures, fleet_size)
    from typing import get_args

    from fsar_ledger.constants import Constants, Load
    from fsar_ledger.events.configuration import EVERY_MECHANISM, FULL, MECHANISMS_OF, lacks
    from fsar_ledger.events.configuration import without as ablation
    from fsar_ledger.events.envelope import Architecture, Scenario
    from fsar_ledger.runtime.experiment import Experiment

    every_architecture, every_scenario = get_args(Architecture), get_args(Scenario)
    configurations = tuple(
        dict.fromkeys(ablation(known("mechanism", _joined(name), EVERY_MECHANISM)) for name in without or ())
    )
    whose = tuple(
        name for name in every_architecture if any(lacks(one) & set(MECHANISMS_OF[name]) for one in configurations)
    )
    return Experiment(
        architectures=known("architecture", architectures, every_architecture) or whose or every_architecture,
        scenarios=known("scenario", scenarios, every_scenario) or every_scenario,
        configurations=configurations or (FULL,),
        runs=RUNS if runs is None else runs,
        seed=seed,
        fleet_size=fleet_size,
        constants=Constants() if load in ((None, 1), (fleet_size // 4, 1)) else Constants(load=Load(*load)),
    )


def _joined(asked: str) -> list[str]:
    """The names that a + joins. Raises: InvalidExperiment, where one is missing, stands twice, or is joined otherwise."""
    names = [name.strip() for name in asked.split("+")]
    if "" in names or len(set(names)) < len(names) or "," in asked:
        raise InvalidExperiment(
            f"--without {printable.value(asked)}: expected mechanisms, each once, with + between them, as in trust-evaluation+shared-registry"
        )
    return names


def _workflows_of(
    asked: list[str],
    runs: int | None,
    seed: int,
    others: dict[str, Any],
    architectures: list[str] | None,
    fleet_size: int,
) -> "Experiment":
    """The workflows that were asked for: FSAR's, with one robot of each role, and nothing beside them."""
    from typing import get_args

    from fsar_ledger.events.envelope import Workflow
    from fsar_ledger.runtime.experiment import workflow_experiment

    for option, found in others.items():
        if found is not None and found != []:
            shown = found[0] if isinstance(found, list) else found
            raise UsageError(f"--workflow and {option} {shown}: expected one or the other")
    for name in architectures or ():
        if name != "fsar":
            raise UsageError(f"--workflow and --architecture {name}: expected fsar; the workflows are FSAR's")
    if fleet_size != 4:
        raise UsageError(f"--workflow and --fleet-size {fleet_size}: expected 4, one robot of each role")
    names = {name.removeprefix("workflow-"): name for name in get_args(Workflow)}
    chosen = tuple(names[name] for name in known("workflow", asked, tuple(names)))
    return workflow_experiment(seed, 1 if runs is None else runs, chosen)
