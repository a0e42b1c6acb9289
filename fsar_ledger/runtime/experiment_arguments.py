"""Make an experiment from the arguments of `simulate`."""

from typing import Any

import msgspec

from fsar_ledger.base import printable
from fsar_ledger.base.errors import InvalidExperiment, UsageError, option
from fsar_ledger.designs import registered
from fsar_ledger.designs.constants import Constants, Load
from fsar_ledger.designs.registered import known
from fsar_ledger.events.configuration import (
    ARCHITECTURES,
    EVERY_MECHANISM,
    FULL,
    MECHANISMS_OF,
    PAPER_ARCHITECTURES,
    removed_mechanisms,
)
from fsar_ledger.events.configuration import without as ablation
from fsar_ledger.runtime.experiment import Experiment, workflow_experiment
from fsar_ledger.runtime.own import is_file, with_own
from fsar_ledger.runtime.world.founding import team_size

RUNS = 20  # per scenario and architecture, as in the paper


def experiment_of(
    architectures: list[str] | None,
    scenarios: list[str] | None,
    runs: int | None,
    seed: int,
    fleet_size: int | None,
    without: list[str] | None,
    workflows: list[str] | None = None,
    load: tuple[int | None, int] = (None, 1),
    fleet: str | None = None,
    settings: list[str] | None = None,
) -> Experiment:
    """Return the experiment that the arguments of `simulate` name.

    With `without`, the default architecture is the one that has the mechanisms. `load` is the number of teams that work
    (None: all) and the number of task sets for each. `fleet` and `settings` are as in `with_own`.

    Raises:
        InvalidExperiment: A name is unknown, or a number impossible.
        UsageError: An argument does not go with a workflow, or a file or setting is wrong.
    """
    if workflows:
        others = {
            "scenario": scenarios,
            "without": without,
            "teams_working": load[0],
            "task_sets": load[1] if load[1] != 1 else None,
            "fleet": fleet,
            "settings": settings,
        }
        return _workflows_of(workflows, runs, seed, others, architectures, fleet_size)

    configurations = tuple(
        dict.fromkeys(ablation(known("mechanism", _joined(name), EVERY_MECHANISM)) for name in without or ())
    )
    whose = tuple(
        name
        for name in MECHANISMS_OF
        if any(removed_mechanisms(one) & set(MECHANISMS_OF[name]) for one in configurations)
    )
    known("scenario", [name for name in scenarios or () if not is_file(name)], registered.scenarios())
    constants, chosen = with_own(Constants(), tuple(dict.fromkeys(scenarios or ())), fleet, settings or ())
    size = team_size(constants.fleet) if fleet_size is None else fleet_size
    if load not in ((None, 1), (size // team_size(constants.fleet), 1)):
        if constants.load is not None:
            raise UsageError(
                f"{option('settings', 'load')} and {option('teams_working')} or {option('task_sets')}: expected one "
                "or the other"
            )
        constants = msgspec.structs.replace(constants, load=Load(*load))
    return Experiment(
        architectures=known("architecture", architectures, ARCHITECTURES) or whose or PAPER_ARCHITECTURES,
        scenarios=chosen or registered.PAPER_SCENARIOS,
        configurations=configurations or (FULL,),
        runs=RUNS if runs is None else runs,
        seed=seed,
        fleet_size=size,
        constants=constants,
    )


def _joined(asked: str) -> list[str]:
    """Split names joined by +. Raises: InvalidExperiment if one is empty or repeated, or joined otherwise."""
    names = [name.strip() for name in asked.split("+")]
    if "" in names or len(set(names)) < len(names) or "," in asked:
        raise InvalidExperiment(
            f"{option('without', printable.value(asked))}: expected mechanisms, each once, with + between them, as in "
            "trust-evaluation+shared-registry"
        )
    return names


def _workflows_of(
    asked: list[str],
    runs: int | None,
    seed: int,
    others: dict[str, Any],
    architectures: list[str] | None,
    fleet_size: int | None,
) -> Experiment:
    """Return the experiment of these workflows, under FSAR, with one robot of each role."""
    for name, found in others.items():
        if found is not None and found != []:
            shown = found[0] if isinstance(found, list) else found
            raise UsageError(f"{option('workflow')} and {option(name, shown)}: expected one or the other")
    for name in architectures or ():
        if name != "fsar":
            raise UsageError(
                f"{option('workflow')} and {option('architecture', name)}: expected fsar; the workflows are FSAR's"
            )
    if fleet_size not in (None, 4):
        raise UsageError(
            f"{option('workflow')} and {option('fleet_size', fleet_size)}: expected 4, one robot of each role"
        )
    names = {name.removeprefix("workflow-"): name for name in registered.workflows()}
    chosen = tuple(names[name] for name in known("workflow", asked, tuple(names)))
    return workflow_experiment(seed, 1 if runs is None else runs, chosen)
