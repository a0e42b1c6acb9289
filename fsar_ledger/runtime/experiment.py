"""Experiments: runs over architectures, configurations and scenarios, in canonical order, committed in batches."""

from collections.abc import Callable, Iterable, Iterator
from itertools import filterfalse
from pathlib import Path

import msgspec

from fsar_ledger.base import printable
from fsar_ledger.base.errors import InvalidExperiment
from fsar_ledger.base.progress import Progress
from fsar_ledger.base.workers import WorkerPool
from fsar_ledger.designs import Fleet, Scenario, Workflow, registered
from fsar_ledger.designs.constants import Constants, negatives, write_constants
from fsar_ledger.events.configuration import (
    ARCHITECTURES,
    EVERY_MECHANISM,
    FULL,
    MECHANISMS_OF,
    Configuration,
    is_known,
    rank,
    removed_mechanisms,
)
from fsar_ledger.events.fleet import ExperimentPlanned
from fsar_ledger.ledger.log.note import Signer
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.record import Head
from fsar_ledger.ledger.store.staging import stage

from .handlers.public import commands
from .own import problems_of_commands
from .simulation import (
    COMMIT_EVENTS,
    MODEL_VERSION,
    Batch,
    RunSpec,
    Staging,
    handler_table_of,
    plan_record,
    run_id,
    run_started,
)
from .world import team_size
from .world.checks import Problem, problems_of_design, problems_of_fleet
from .world.schedule import happening

ORIGIN = "fsar-ledger/simulated"
WORKFLOWS_ORIGIN = "fsar-ledger/workflows"  # a ledger of its own: no key signs two trees under one origin
# See docs/decisions/batches-follow-from-the-plan.md.
EVENTS_PER_ROBOT, EVENTS_PER_DHMA_ROBOT = 150, 257
"""Expected events of a run for each robot; used only to divide runs into batches."""
MOST_FIRST = 999_999
"""The highest number that the first run of an experiment may have."""
MOST_ROBOTS = 1 << 16
"""The most robots of a run; the largest run tried so far had 4,096."""
MAX_OWN = 60_000
"""The most characters of parameters that contain a fleet or a scenario; readers parse them constant by constant.

Without either, they have about 2,000.
"""


class Experiment(msgspec.Struct, frozen=True):
    """The runs to simulate: `runs` of each scenario (or workflow), architecture and configuration, from `first_run` on.

    Names are sorted into canonical order. Each must be registered, or be the scenario in the constants.

    Raises:
        InvalidExperiment: a name is unknown, a number impossible, a scenario impossible for the fleet, or a workflow
            asked for with anything but FSAR and its fleet of four.
    """

    architectures: tuple[str, ...]
    scenarios: tuple[str, ...]
    runs: int
    seed: int = 42
    fleet_size: int = 4
    configurations: tuple[Configuration, ...] = (FULL,)
    constants: Constants = Constants()
    first_run: int = 0

    def __post_init__(self) -> None:
        _require_known("architecture", self.architectures, ARCHITECTURES)
        _require_known("scenario", self.scenarios, self._known_scenarios())
        _require_configurations(self.configurations)
        self._require_designs()
        if not 1 <= self.runs <= 9999:
            raise InvalidExperiment(f"runs: found {self.runs}, expected 1 to 9999")
        if not 0 <= self.first_run <= MOST_FIRST:
            raise InvalidExperiment(f"first run: found {self.first_run}, expected 0 to {MOST_FIRST}")
        if not 0 <= self.seed < 2**53:
            raise InvalidExperiment(f"seed: found {self.seed}, expected 0 to {2**53 - 1}")
        of_team = team_size(self.constants.fleet)
        if self.fleet_size < of_team or self.fleet_size % of_team:
            team = "teams of four roles" if self.constants.fleet is None else f"teams of {self.constants.fleet.name}"
            raise InvalidExperiment(
                f"fleet size: found {self.fleet_size}, expected {of_team} or a multiple of it ({team})"
            )
        self._require_mechanisms()
        if wrong := negatives(self.constants):
            raise InvalidExperiment(f"constants: found {printable.list_few(wrong)}, expected 0 or more")
        self._require_workflows_as_written()
        self._require_possible_load()
        self._require_possible_membership()
        self._put_in_order()

    def _known_scenarios(self) -> tuple[str, ...]:
        """Return the user's own scenario alone if there is one, else all registered ones."""
        own = self.constants.scenario
        return (*registered.scenarios(), *registered.workflows()) if own is None else (own.name,)

    def _require_designs(self) -> None:
        """Check that the designer's own designs are well formed and that every scenario suits the fleet."""
        own, fleet = self.constants.scenario, self.constants.fleet
        require_designs(own, fleet)
        for name in self.scenarios:
            scenario = happening(self.constants, name)
            if isinstance(scenario, Workflow) and fleet is not None:
                raise InvalidExperiment(f"workflow {name}: found a fleet of your own, expected the paper's")
            if fleet is not None and name in registered.PAPER_SCENARIOS:
                raise InvalidExperiment(
                    f"scenario {name}: found fleet {printable.value(fleet.name)}, expected the paper's, for which the "
                    "scenario is written; use your own --scenario with your own --fleet"
                )
            problems = [*problems_of_design(scenario, fleet or registered.fleet())]
            if isinstance(scenario, Scenario):
                problems += problems_of_commands(scenario, fleet or registered.fleet())
                problems += self._undecided(scenario)
            for problem in problems:
                if own is not None:
                    raise InvalidExperiment(f"scenario {printable.value(own.name)}: {problem}")
                where = registered.design_location(scenario, problem.field)
                raise InvalidExperiment(f"{where}: found {problem.found}, expected {problem.expected}")
        if (own or fleet) and (found := len(write_constants(self.constants))) > MAX_OWN:
            raise InvalidExperiment(f"fleet and scenario: found {found:,} characters, expected at most {MAX_OWN:,}")

    def _undecided(self, scenario: Scenario) -> Iterator[Problem]:
        """Yield the commands of the scenario that an architecture does not decide."""
        for number, given in enumerate(scenario.commands):
            for architecture in self.architectures:
                kind, decides = commands().get(given.command), handler_table_of(architecture).decides
                if kind is not None and kind not in decides:
                    able = [name for name, known in commands().items() if known in decides]
                    yield Problem(
                        ("commands", number, "command"),
                        f"{given.command}, which architecture {architecture} does not decide",
                        f"one of {', '.join(sorted(able))}, or --architecture fsar, which decides every command",
                    )

    def _require_mechanisms(self) -> None:
        """Check that every architecture has the mechanisms that are taken out of it."""
        for architecture in self.architectures:
            for name in sorted(
                frozenset().union(*map(removed_mechanisms, self.configurations))
                - set(MECHANISMS_OF.get(architecture, ()))
            ):
                [whose] = [other for other, names in MECHANISMS_OF.items() if name in names]
                raise InvalidExperiment(
                    f"without {name}: found architecture {architecture}, "
                    f"expected {whose} alone, whose mechanism it is; run one experiment for each architecture"
                )

    def _require_possible_load(self) -> None:
        """Check that each floor holds a team, and that tasks go to teams that exist, within the horizon."""
        world, load = self.constants.world, self.constants.load
        if world.floor_teams < 1:
            raise InvalidExperiment(f"teams of a floor: found {world.floor_teams}, expected at least 1")
        if load is None:
            return
        teams, working = self.fleet_size // team_size(self.constants.fleet), load.teams_working
        if working is not None and not 1 <= working <= teams:
            raise InvalidExperiment(
                f"teams working: found {working}, expected 1 to {teams}, the teams of a fleet of {self.fleet_size}"
            )
        if load.interval_s <= 0:
            raise InvalidExperiment(f"interval of task sets: found {load.interval_s} s, expected more than 0")
        most = int(world.horizon_s / 2 / load.interval_s) + 1
        if not 1 <= load.task_sets <= most:
            raise InvalidExperiment(
                f"task sets: found {load.task_sets}, "
                f"expected 1 to {most}, one each {printable.number(load.interval_s)} s in half the world's "
                f"{printable.number(world.horizon_s)} s"
            )
        if any(name in registered.workflows() for name in self.scenarios):
            raise InvalidExperiment(
                f"workflow {self.scenarios[0]}: found another load, expected the tasks of its script alone"
            )

    def _require_possible_membership(self) -> None:
        """Check that heartbeats come in time, and that a robot is off for one reason."""
        membership, outages = self.constants.membership, self.constants.outages
        if membership is None:
            return
        period_us, least_us = membership.heartbeat_us, 1_000_000
        if period_us and not least_us <= period_us < membership.suspect_us:
            raise InvalidExperiment(
                f"heartbeats: found one each {period_us} microseconds and a suspicion after {membership.suspect_us}, "
                f"expected none (0) or one each {least_us} or more, before a suspicion"
            )
        if membership.away_rate_per_s and outages is not None and outages.off_rate_per_s:
            raise InvalidExperiment(
                "found robots that go off by outages.off_rate_per_s and by membership.away_rate_per_s, expected one"
            )

    def _require_workflows_as_written(self) -> None:
        """Check that the workflows are those of the paper: FSAR's, in full, with one robot of each role."""
        workflows = [name for name in self.scenarios if name in registered.workflows()]
        if not workflows:
            return
        about = f"workflow {workflows[0]}"
        if len(workflows) < len(self.scenarios):
            raise InvalidExperiment(f"{about}: found beside scenarios, expected workflows alone")
        if self.architectures != ("fsar",) or self.configurations != (FULL,):
            raise InvalidExperiment(
                f"{about}: found {', '.join(self.architectures)} ({', '.join(self.configurations)}), "
                "expected fsar (full)"
            )
        if self.fleet_size != team_size(None):
            raise InvalidExperiment(f"{about}: found fleet size {self.fleet_size}, expected {team_size(None)}")
        if self.constants.outages is not None:
            raise InvalidExperiment(f"{about}: found outages, expected none: the world of a workflow is its script")
        if self.constants.membership is not None:
            raise InvalidExperiment(f"{about}: found membership, expected none: the world of a workflow is its script")

    def _put_in_order(self) -> None:
        """Sort the names, so that the order of the arguments does not matter."""
        in_order = msgspec.structs.force_setattr
        in_order(self, "architectures", tuple(sorted(self.architectures, key=ARCHITECTURES.index)))
        in_order(self, "scenarios", tuple(sorted(self.scenarios, key=self._known_scenarios().index)))
        in_order(self, "configurations", tuple(sorted(self.configurations, key=rank)))

    def specs(self) -> Iterator[RunSpec]:
        """Yield the runs in canonical order: scenario, run, architecture, configuration."""
        for scenario in self.scenarios:
            for run in range(self.first_run, self.first_run + self.runs):
                for architecture in self.architectures:
                    for configuration in self.configurations:
                        yield RunSpec(self.seed, architecture, configuration, scenario, self.fleet_size, run)

    @property
    def size(self) -> int:
        """Return the number of runs."""
        return len(self.scenarios) * self.runs * len(self.architectures) * len(self.configurations)

    def batches(self) -> list[Batch]:
        """Return all runs in batches of consecutive runs, each expected to fit into a commit, or of a single run."""
        batches: list[list[RunSpec]] = []
        room = 0
        for spec in self.specs():
            events = self.fleet_size * (EVENTS_PER_DHMA_ROBOT if spec.architecture == "dhma" else EVENTS_PER_ROBOT)
            if events > room:
                batches.append([])
                room = COMMIT_EVENTS
            room -= events
            batches[-1].append(spec)
        return [tuple(batch) for batch in batches]

    # See docs/decisions/experiment-plans-are-events.md.
    def plan(self) -> ExperimentPlanned:
        """Return the plan, which is committed before the first run."""
        return ExperimentPlanned(
            architectures=self.architectures,
            configurations=self.configurations,
            scenarios=self.scenarios,
            run_count=self.runs,
            first_run=self.first_run or None,
            seed=self.seed,
            fleet_size=self.fleet_size,
            model_version=MODEL_VERSION,
            parameters=write_constants(self.constants),
        )


def _require_known(what: str, names: tuple[str, ...], expected: tuple[str, ...]) -> None:
    unknown = [name for name in names if name not in expected]
    if unknown or not names or len(set(names)) != len(names):
        hint = printable.did_you_mean(unknown[0], expected) if unknown else ""
        raise InvalidExperiment(
            f"{what}: found {', '.join(names) or 'none'}, expected some of {', '.join(expected)}, each once{hint}"
        )


def _require_configurations(names: tuple[Configuration, ...]) -> None:
    if not names or len(set(names)) != len(names) or not all(map(is_known, names)):
        expected = (
            f"{FULL}, or without- and some of {', '.join(EVERY_MECHANISM)}, of one architecture, in this order, "
            "with + between; each once"
        )
        raise InvalidExperiment(f"configuration: found {', '.join(names) or 'none'}, expected {expected}")


def require_designs(own: Scenario | None, fleet: Fleet | None) -> None:
    """Check a user's own fleet and scenario, and that their names are free. Raises: InvalidExperiment."""
    if fleet is not None:
        for problem in problems_of_fleet(fleet):
            raise InvalidExperiment(f"fleet {printable.value(fleet.name)}: {problem}")
        if fleet.name == registered.PAPER_FLEET or (
            fleet.name in registered.fleets() and fleet != registered.fleet(fleet.name)
        ):
            raise InvalidExperiment(
                f"fleet: found one of your own named {fleet.name}, expected a name that is not registered"
            )
    if own is not None and own.name in registered.scenarios():
        raise InvalidExperiment(
            f"scenario: found one of your own named {own.name}, expected a name that is not registered"
        )


def workflow_experiment(
    seed: int = 42, runs: int = 1, workflows: tuple[str, ...] = registered.PAPER_WORKFLOWS
) -> Experiment:
    """Return the experiment of the paper's workflows, all three unless named. Paper: sec:prototype:workflows."""
    return Experiment(("fsar",), workflows, runs, seed)


class SimulationResult(msgspec.Struct, frozen=True):
    """The head of the ledger after `run_experiment`, and counts of runs.

    `runs_asked` were asked for, of which `runs_made` were missing and were made now; `runs_held` are in the ledger now,
    including those of other experiments.
    """

    head: Head
    runs_asked: int
    runs_made: int
    runs_held: int


def run_experiment(
    out: Path,
    experiment: Experiment,
    workers: int | WorkerPool,
    progress: Progress | None = None,
    signer: Signer | None = None,
    origin: str | None = None,
    *,
    adopts: bool = False,
) -> SimulationResult:
    """Commit the experiment's plan and the runs that the ledger lacks.

    If the ledger has all runs, nothing is done. Otherwise the plan is committed first, unless it is on record; a larger
    plan adds runs as if all had been simulated at once. The missing runs follow in canonical order, in `batches`. Each
    commit is determined by those before it, so neither `workers` (a number of processes, or a pool) nor an interruption
    changes a byte. `progress` is called with (batches done, batches in all). New commits are signed by `signer`, whose
    key stays in this process; with `adopts` even on top of commits of another key or unsigned ones. A new ledger gets
    `origin`, else the name of the signer, else `ORIGIN`.

    Raises:
        InvalidExperiment: the fleet is too large to be held in memory.
        InvalidRun: another process added some of these runs meanwhile, in other batches; the same call again adds the
            missing ones.
        NotALedger, FormatVersionMismatch, LedgerCorrupted, UsageError, WriteFailed: see `Writer`.
    """
    constants, plan = experiment.constants, plan_record(experiment.plan())
    name = origin or (signer.verifier.name if signer is not None else ORIGIN)
    if experiment.fleet_size > MOST_ROBOTS:
        raise InvalidExperiment(
            f"fleet size: found {experiment.fleet_size}, expected at most {MOST_ROBOTS}: a fleet is held in memory"
        )
    with Writer(out, name, signer, adopts=adopts) as writer:
        existing = writer.existing_runs()
        unfinished = writer.unfinished_runs()
        whole = existing.runs - unfinished.keys()
        batches = experiment.batches()
        missing = (
            missing_runs(batches, lambda spec: run_id(run_started(spec, constants)) in whole) if whole else batches
        )
        if missing and plan.run_id not in existing.plans:
            writer.append(stage(out, [plan]))
        made = sum(map(len, missing))
        done = len(batches) - len(missing)
        if progress is not None:
            progress(done, len(batches))
        staging = Staging(out.absolute(), constants, unfinished)
        for batch in staging.of_all(missing, workers):
            for staged in batch:
                writer.append(staged)
            done += 1
            if progress is not None:
                progress(done, len(batches))
        return SimulationResult(writer.head, experiment.size, made, len(whole) + made)


def missing_runs(batches: Iterable[Batch], is_there: Callable[[RunSpec], bool]) -> list[Batch]:
    """Return the missing runs of each batch, so that an interruption does not move the boundaries."""
    return [missing for batch in batches if (missing := tuple(filterfalse(is_there, batch)))]
