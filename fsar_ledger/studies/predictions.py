"""Simulates the registered predictions, and writes the numbers before they are compared.

They are registered in `reports/registration.toml`: the tables of the paper that the fit does not aim at (ablation,
scaling), and numbers that the paper does not print: other seeds, fleet sizes between and beyond its own, loads,
encounter rates, triples of ablations. Nothing here reads a number of the paper.
"""

from collections.abc import Iterator
from itertools import combinations
from pathlib import Path
from typing import Any

import msgspec

from fsar_ledger.api.names import Place
from fsar_ledger.api.verbs import workers_of
from fsar_ledger.base.progress import Progress, each
from fsar_ledger.designs.constants import Constants, Load
from fsar_ledger.events.configuration import CONFIGURATIONS, MECHANISMS, PAPER_ARCHITECTURES, Configuration, without
from fsar_ledger.events.envelope import Architecture
from fsar_ledger.metrics.results import MetricRow, measure_the_printed, metric_rows, typed
from fsar_ledger.metrics.study_results import Claim, Predicted, Predictions
from fsar_ledger.runtime.experiment import Experiment
from fsar_ledger.runtime.paper import over_seeds
from fsar_ledger.runtime.simulation import SCENARIOS

from .evaluations import simulated
from .result import grounds, require_out, write

SEEDS = (31622776, 36055512)  # registered, and never used before
SEED_RUNS = 200  # runs a scenario for the results table
ABLATION_RUNS = 40
SCALING_RUNS = 20  # the paper's
ENCOUNTERS_S = (30.0, 50.0, 90.0, 200.0, 300.0)

CASES = "cases"
CLAIMS_SQL = """
    SELECT
        case_number, claim, is_taken, architecture, sum(runs)::BIGINT AS runs, sum(numerator)::BIGINT AS numerator,
        sum(denominator)::BIGINT AS denominator, sum(numerator) / sum(denominator) AS value
    FROM case_claims
    GROUP BY case_number, position, claim, is_taken, architecture
    ORDER BY case_number, position, claim, is_taken DESC, architecture
"""


class PlannedExperiment(msgspec.Struct, frozen=True):
    """One experiment whose numbers are predicted, and its purpose; seed None: spread over those of the verdicts."""

    of: str
    experiment: Experiment
    seed: int | None = None

    def parts(self) -> Iterator[Experiment]:
        """Yield the experiments of its seeds."""
        if self.seed is None:
            yield from over_seeds(self.experiment)
        else:
            yield msgspec.structs.replace(self.experiment, seed=self.seed)


def planned_experiments() -> Iterator[PlannedExperiment]:
    """Yield the experiments, in the order of the registration."""

    def one(
        of: str,
        runs: int,
        *,
        seed: int | None = None,
        size: int = 4,
        teams: int | None = None,
        architectures: tuple[Architecture, ...] = PAPER_ARCHITECTURES,
        configurations: tuple[Configuration, ...] = ("full",),
        constants: Constants | None = None,
    ) -> PlannedExperiment:
        base = constants or Constants()
        loaded = base if teams is None else msgspec.structs.replace(base, load=Load(teams_working=teams))
        experiment = Experiment(
            architectures, SCENARIOS, runs, fleet_size=size, configurations=configurations, constants=loaded
        )
        return PlannedExperiment(of, experiment, seed)

    yield one(CASES, SEED_RUNS)
    yield one("ablation", ABLATION_RUNS, architectures=("fsar",), configurations=CONFIGURATIONS)
    yield one(
        "triples",
        ABLATION_RUNS,
        architectures=("fsar",),
        configurations=tuple(without(triple) for triple in combinations(MECHANISMS, 3)),
    )
    for mean in ENCOUNTERS_S:
        world = msgspec.structs.replace(Constants().world, encounter_mean_s=mean)
        alone: tuple[Configuration, ...] = (without(["shared-registry"]),)
        yield one(
            "encounters", ABLATION_RUNS, architectures=("fsar",), configurations=alone, constants=Constants(world)
        )
    for size in (4, 8, 12, 16, 28):
        yield one("scaling", SCALING_RUNS, size=size)
        if size > 4:
            yield one("scaling", SCALING_RUNS, size=size, teams=1)
    for teams in (2, 3):
        yield one("loads", SCALING_RUNS, size=16, teams=teams)
    for seed in SEEDS:
        yield one("seeds", SEED_RUNS, seed=seed)


def predict(out: Place, *, workers: int | None = None, progress: Progress | None = None) -> None:
    """Simulate the experiments registered for prediction, and write their numbers; takes minutes.

    Raises:
        UsageError: The file lies inside a ledger.
        WriteFailed: The file cannot be written.
    """
    out, workers = Path(out), workers_of(workers)
    require_out(out)
    numbers: list[Predicted] = []
    claims: list[Claim] = []
    for planned in each(list(planned_experiments()), progress):
        with simulated(planned.parts(), workers) as database:
            measure_the_printed(database)
            for by_scenario in (False, True):
                rows = metric_rows(database, by_scenario, pools_seeds=True)
                numbers += [_predicted(planned, row) for row in rows]
            if planned.of == CASES:
                claims += typed(database.rows(CLAIMS_SQL), Claim)
    write(
        out,
        Predictions(
            **grounds(Predictions),
            numbers=numbers,
            cases=claims,
        ),
    )


def _predicted(planned: PlannedExperiment, row: MetricRow) -> Predicted:
    experiment = planned.experiment
    load = experiment.constants.load
    fields: dict[str, Any] = {
        name: getattr(row, name)
        for name in ("architecture", "configuration", "scenario", "metric", "mean", "sd", "n", "ci_low", "ci_high")
    }
    return Predicted(
        of=planned.of,
        seed=planned.seed,
        fleet_size=experiment.fleet_size,
        teams_working=None if load is None else load.teams_working,
        encounter_mean_s=experiment.constants.world.encounter_mean_s,
        **fields,
    )
