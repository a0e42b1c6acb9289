"""The experiments of the paper by name, as `reproduce` makes them, one ledger each. Paper: sec:evaluation.

`results` is the results table. `ablation` is FSAR in full and without one mechanism each, and without the registry at
several encounter rates; then every architecture without each of its further mechanisms, to show which numbers depend
on it. `scaling` is the table of fleet sizes at both ends of the load that the text leaves open, with loads in
between and larger fleets. `workflows` are the three workflows. The runs of each are spread over the registered seeds,
since one seed can be lucky. Each ledger has an origin of its own, so a key signs each under a different name.
"""

from collections.abc import Iterator
from typing import Literal, get_args

import msgspec

from fsar_ledger.designs.constants import Constants, Load
from fsar_ledger.events.configuration import (
    CONFIGURATIONS,
    FULL,
    MECHANISMS,
    MECHANISMS_OF,
    PAPER_ARCHITECTURES,
    Configuration,
    without,
)
from fsar_ledger.ledger.log.note import Signer
from fsar_ledger.metrics.registration import registration
from fsar_ledger.runtime.experiment import ORIGIN, WORKFLOWS_ORIGIN, Experiment, workflow_experiment
from fsar_ledger.runtime.simulation import SCENARIOS

Name = Literal["results", "ablation", "scaling", "workflows"]
NAMES: tuple[Name, ...] = get_args(Name)

SEED = 42
"""The seed of the workflows, which are scripts."""

RUNS: dict[Name, int] = {"results": 200, "ablation": 40, "scaling": 20, "workflows": 1}
"""Runs of each scenario, architecture and configuration: the registered number, twice the paper's, and the paper's."""

ENCOUNTERS_S = (30.0, 60.0, 180.0, 300.0)
"""Mean times between encounters of two robots, in addition to the model's."""

TABLED_SIZES, LOADED_SIZE = (4, 8, 16), 16
"""Fleet sizes of the paper's table, and the one that is simulated at every load."""

FURTHER = 2
"""The factor by which the number of runs is reduced for ablations that are not the paper's."""

BEYOND: dict[int, int] = {32: 5, 64: 10}
"""Larger fleets, and the factor by which their runs are reduced: a run of 64 robots costs as much as 20 of four."""

_ORIGINS: dict[Name, str] = {
    "results": ORIGIN,
    "ablation": "fsar-ledger/ablation",
    "scaling": "fsar-ledger/scaling",
    "workflows": WORKFLOWS_ORIGIN,
}


class PaperLedger(msgspec.Struct, frozen=True):
    """A ledger to make: its name, its origin, and its experiments in order."""

    name: Name
    origin: str
    parts: tuple[Experiment, ...]

    @property
    def size(self) -> int:
        """Return the number of runs."""
        return sum(part.size for part in self.parts)

    def signer(self, signer: Signer | None) -> Signer | None:
        """Return a signer with the same secret under this ledger's name; None: unsigned.

        The name is the key's own for `results`, else the key's and the experiment's.
        """
        return (
            signer if signer is None or self.name == "results" else signer.under(f"{signer.verifier.name}/{self.name}")
        )


def paper_ledger(name: Name, runs: int | None = None) -> PaperLedger:
    """Return the experiment of this name with this many runs of each scenario, by default as in `RUNS`.

    The workflows are scripts and always have one run.
    """
    count = RUNS[name] if runs is None else runs
    if name == "workflows":
        return PaperLedger(name, _ORIGINS[name], (workflow_experiment(SEED, 1),))
    parts = {"results": _results, "ablation": _ablation, "scaling": _scaling}[name]
    return PaperLedger(name, _ORIGINS[name], tuple(seeded for part in parts(count) for seeded in over_seeds(part)))


# See docs/decisions/verdicts-pool-registered-seeds.md.
def over_seeds(experiment: Experiment) -> Iterator[Experiment]:
    """Spread the runs of an experiment over the registered seeds, as evenly as possible, the first seeds first."""
    seeds = registration().verdicts.seeds
    for index, seed in enumerate(seeds):
        if (runs := (experiment.runs + len(seeds) - 1 - index) // len(seeds)) > 0:
            yield msgspec.structs.replace(experiment, seed=seed, runs=runs)


def whole_of(runs: int) -> range:
    """Return the total numbers of runs for which `over_seeds` can give one seed this many."""
    seeds = len(registration().verdicts.seeds)
    return range(seeds * (runs - 1) + 1, seeds * (runs + 1))


def _results(runs: int) -> Iterator[Experiment]:
    yield Experiment(PAPER_ARCHITECTURES, SCENARIOS, runs)


def _ablation(runs: int) -> Iterator[Experiment]:
    yield Experiment(("fsar",), SCENARIOS, runs, configurations=CONFIGURATIONS)
    alone: tuple[Configuration, ...] = (without(["shared-registry"]),)
    for mean in ENCOUNTERS_S:
        world = msgspec.structs.replace(Constants().world, encounter_mean_s=mean)
        yield Experiment(("fsar",), SCENARIOS, runs, configurations=alone, constants=Constants(world))
    for architecture, names in MECHANISMS_OF.items():
        further = tuple(without([name]) for name in names if name not in MECHANISMS)
        yield Experiment((architecture,), SCENARIOS, -(-runs // FURTHER), configurations=(FULL, *further))


def _scaling(runs: int) -> Iterator[Experiment]:
    """Yield the experiments over fleet sizes, at full load (all teams work) and with fewer teams working."""
    for size in TABLED_SIZES:
        yield Experiment(PAPER_ARCHITECTURES, SCENARIOS, runs, fleet_size=size)
    for size in (*TABLED_SIZES[1:], *BEYOND):
        fewer = -(-runs // BEYOND.get(size, 1))
        if size in BEYOND:
            yield Experiment(PAPER_ARCHITECTURES, SCENARIOS, fewer, fleet_size=size)
        for teams in range(1, size // 4) if size == LOADED_SIZE else (1,):
            yield Experiment(
                PAPER_ARCHITECTURES,
                SCENARIOS,
                fewer,
                fleet_size=size,
                constants=Constants(load=Load(teams_working=teams)),
            )
