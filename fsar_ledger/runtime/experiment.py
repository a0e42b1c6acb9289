"""An experiment is a row of runs in canonical order, committed in batches: architectures x scenarios x runs."""

import gc
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from itertools import islice
from pathlib import Path
from typing import get_args

import msgspec

from fsar_ledger.constants import Constants
from fsar_ledger.errors import InvalidExperiment
from fsar_ledger.events.envelope import Architecture, Configuration, Scenario, Workflow
from fsar_ledger.ledger.append import Staged, Writer, stage
from fsar_ledger.ledger.note import Signer
from fsar_ledger.ledger.read import Head, LedgerView, open_ledger
from fsar_ledger.runtime.simulation import RunSpec, run_id, run_started, simulate_run
from fsar_ledger.workers import WorkerPool

from .world.workflows import FLEET_SIZE, WORKFLOWS

ORIGIN = "fsar-ledger/simulated"
WORKFLOWS_ORIGIN = "fsar-ledger/workflows"  # of the second ledger of `reproduce`: no key signs two trees under one origin
BATCH_RUNS = 25  # runs in a commit, whatever the number of workers
IN_FLIGHT = 2  # batches per worker that may be under way, so that memory stays flat

Progress = Callable[[int, int], None]


class Experiment(msgspec.Struct, frozen=True):
    """Which runs to make: `runs` per scenario (or workflow), architecture and configuration.

    Raises:
        InvalidExperiment: a name is unknown, a number impossible, or a workflow meant for anything but FSAR and its fleet of four.
    """

    architectures: tuple[Architecture, ...]
    scenarios: tuple[Scenario | Workflow, ...]
    runs: int
    seed: int = 42
    fleet_size: int = 4
    configurations: tuple[Configuration, ...] = ("full",)
    constants: Constants = Constants()

    def __post_init__(self) -> None:
        _require_known("architecture", self.architectures, get_args(Architecture))
        _require_known("scenario", self.scenarios, get_args(Scenario) + get_args(Workflow))
        _require_known("configuration", self.configurations, get_args(Configuration))
        if not 1 <= self.runs <= 9999:
            raise InvalidExperiment(f"runs: found {self.runs}, expected 1 to 9999")
        if not 0 <= self.seed < 2**53:
            raise InvalidExperiment(f"seed: found {self.seed}, expected 0 to {2**53 - 1}")
        if self.fleet_size < 4 or self.fleet_size % 4 or self.fleet_size > 256:
            raise InvalidExperiment(f"fleet size: found {self.fleet_size}, expected a multiple of 4 (teams of four roles) from 4 to 256")
        if self.configurations != ("full",) and self.architectures != ("fsar",):
            asked = ", ".join(self.architectures)
            raise InvalidExperiment(f"mechanisms are taken out of FSAR only: found architectures {asked}, expected fsar; leave out --architecture")
        self._require_workflows_as_written()
        self._require_possible_load()

    def _require_possible_load(self) -> None:
        """Each floor holds a team, and what there is to do falls to teams that exist, while the world still happens."""
        world, load = self.constants.world, self.constants.load
        if world.floor_teams < 1:
            raise InvalidExperiment(f"teams of a floor: found {world.floor_teams}, expected at least 1")
        if load is None:
            return
        teams, working = self.fleet_size // 4, load.teams_working
        if working is not None and not 1 <= working <= teams:
            raise InvalidExperiment(f"teams working: found {working}, expected 1 to {teams}, the teams of a fleet of {self.fleet_size}")
        if load.interval_s <= 0:
            raise InvalidExperiment(f"interval of task sets: found {load.interval_s} s, expected more than 0")
        most = int(world.horizon_s / 2 / load.interval_s) + 1
        if not 1 <= load.task_sets <= most:
            raise InvalidExperiment(
                f"task sets: found {load.task_sets}, expected 1 to {most}: one every {load.interval_s:g} s, the last in the first half of the world's {world.horizon_s:g} s"
            )
        if any(name in WORKFLOWS for name in self.scenarios):
            raise InvalidExperiment(f"workflow {self.scenarios[0]}: found another load, expected the tasks of its script alone")

    def _require_workflows_as_written(self) -> None:
        """The workflows are those of the paper: FSAR's, in full, with one robot of each role."""
        workflows = [name for name in self.scenarios if name in WORKFLOWS]
        if not workflows:
            return
        about = f"workflow {workflows[0]}"
        if len(workflows) < len(self.scenarios):
            raise InvalidExperiment(f"{about}: found beside scenarios, expected workflows alone")
        if self.architectures != ("fsar",) or self.configurations != ("full",):
            raise InvalidExperiment(f"{about}: found {', '.join(self.architectures)} ({', '.join(self.configurations)}), expected fsar (full)")
        if self.fleet_size != FLEET_SIZE:
            raise InvalidExperiment(f"{about}: found fleet size {self.fleet_size}, expected {FLEET_SIZE}")

    def specs(self) -> Iterator[RunSpec]:
        """The runs in canonical order: scenario, run, architecture, configuration."""
        for scenario in self.scenarios:
            for run in range(self.runs):
                for architecture in self.architectures:
                    for configuration in self.configurations:
                        yield RunSpec(self.seed, architecture, configuration, scenario, self.fleet_size, run)

    def batches(self) -> list[tuple[RunSpec, ...]]:
        """The runs of each commit."""
        specs = self.specs()
        return list(iter(lambda: tuple(islice(specs, BATCH_RUNS)), ()))


def _require_known(what: str, found: tuple[str, ...], expected: tuple[str, ...]) -> None:
    unknown = [name for name in found if name not in expected]
    if unknown or not found or len(set(found)) != len(found):
        raise InvalidExperiment(f"{what}: found {', '.join(found) or 'none'}, expected some of {', '.join(expected)}, each once")


def workflow_experiment(seed: int = 42, runs: int = 1, workflows: tuple[Workflow, ...] = WORKFLOWS) -> Experiment:
    """The runs of the paper's workflows, all three unless some are named. Paper: sec:prototype:workflows."""
    return Experiment(("fsar",), workflows, runs, seed, FLEET_SIZE)


def simulate(
    out: Path,
    experiment: Experiment,
    workers: int,
    progress: Progress | None = None,
    signer: Signer | None = None,
    origin: str | None = None,
    *,
    adopts: bool = False,
) -> Head:
    """Every run of the experiment is in the ledger; batches that were there already are not made again.

    The bytes of the ledger do not depend on `workers`. `progress` is told batches done and batches in all. What is committed now carries a signature
    of `signer`, whose key stays in this process; with `adopts` also where another or none signed what is there.
    A new ledger has this origin, else the name of the signer, else `ORIGIN`.

    Raises:
        InvalidExperiment: the ledger holds some of these runs in batches of another experiment.
        SequenceConflict: another process commits to the ledger meanwhile; the same call again makes what is missing then.
        NotALedger, FormatVersionMismatch, LedgerCorrupted, UsageError, WriteFailed: see `Writer`.
    """
    batches = experiment.batches()
    name = origin or (signer.verifier.name if signer is not None else ORIGIN)
    with Writer(out, name, signer, adopts=adopts) as writer:
        missing = _missing(open_ledger(out), batches, experiment.constants)
        done = len(batches) - len(missing)
        if progress is not None:
            progress(done, len(batches))
        for staged in _staged(out, missing, experiment.constants, min(workers, len(missing))):
            writer.append(staged)
            done += 1
            if progress is not None:
                progress(done, len(batches))
        return writer.head


def _id(spec: RunSpec, constants: Constants) -> str:
    return run_id(run_started(spec, constants))


def _missing(ledger: LedgerView, batches: list[tuple[RunSpec, ...]], constants: Constants) -> list[tuple[RunSpec, ...]]:
    """The batches that the ledger lacks, after a check that it holds none of their runs otherwise."""
    held = {(record.first_run, record.last_run) for record in ledger.records}
    missing = [batch for batch in batches if (_id(batch[0], constants), _id(batch[-1], constants)) not in held]
    if missing and held:
        wanted = {_id(spec, constants) for batch in missing for spec in batch}
        for table in ledger.tables(["run_id"]):
            found = wanted.intersection(table.column("run_id").unique().to_pylist())
            if found:
                raise InvalidExperiment(
                    f"run {min(found)} is in the ledger already, in a batch of an experiment of another shape; give a new folder for this one"
                )
    return missing


def _stage(out: Path, batch: tuple[RunSpec, ...], constants: Constants) -> Staged:
    """The batch is simulated and staged; meanwhile nothing looks for cyclic garbage, for a run makes none."""
    gc.disable()
    try:
        return stage(out, [simulate_run(spec, constants) for spec in batch])
    finally:
        gc.enable()


def _staged(out: Path, batches: list[tuple[RunSpec, ...]], constants: Constants, workers: int) -> Iterator[Staged]:
    """The staged batches in order, made by this process or by `workers` others."""
    if workers <= 1:
        for batch in batches:
            yield _stage(out, batch, constants)
        return
    with WorkerPool(workers) as pool:
        queue: deque[Future[Staged]] = deque()
        for batch in batches:
            queue.append(pool.submit(_stage, out, batch, constants))
            if len(queue) >= IN_FLIGHT * workers:
                yield queue.popleft().result()
        while queue:
            yield queue.popleft().result()
