"""The verb `simulate`."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from fsar_ledger.base import printable
from fsar_ledger.base.printable import SafeText, counted
from fsar_ledger.base.progress import Progress

from .answers import Answer, Screen, head_json
from .names import Names, Place, names_of, require_whole
from .verbs import (
    ONE_ARCHITECTURE,
    RUNTIME,
    WORTH_ROBOTS,
    AdoptOption,
    KeyOption,
    Shows,
    WorkersOption,
    argument,
    declare,
    either,
    verb,
    workers_of,
)

if TYPE_CHECKING:
    from fsar_ledger.runtime.experiment import SimulationResult

    from .ledger import Ledger

CONTINUES = "what is committed is kept, and the same command continues from there"
"""The effect of an interrupted simulation."""


ONE_SCENARIO = either(file.stem for file in RUNTIME.glob("world/scenarios/*.toml"))


@dataclass(frozen=True)
class Simulated(Answer):
    """The result of `simulate`; the ledger may also hold earlier runs. `key` is the one to sign with."""

    ledger: "Ledger"
    result: "SimulationResult"
    key: Place | None = None

    def document(self, _: Screen) -> Mapping[str, object]:
        """Return the head, and how many runs were requested, made and held."""
        head, counts = (
            self.result.head,
            {name: getattr(self.result, name) for name in ("runs_asked", "runs_made", "runs_held")},
        )
        return {"head": head_json(head), "ledger": str(self.ledger.path), "commits": head.commits, **counts}

    def text(self, _: Screen) -> Iterator[SafeText]:
        """Yield the head of the ledger, the counts of new and existing runs, and its signature."""
        head, path = self.result.head, self.ledger.path
        yield printable.lines(
            f"{path}: {counted(head.size, 'event')} in {counted(head.commits, 'commit')}",
            f"root {head.root}",
            *before(self.result),
            *([] if self.key is None else [_signed(path, Path(self.key))]),
        )


@verb(
    "simulate out/ledger",
    "simulate out/doors --architecture fsar --scenario door-relay --runs 3 --seed 7",
    "simulate out/doors --architecture fsar --scenario door-relay --runs 5 --seed 7    # enlarges it",
    "simulate out/untrusting --without trust-evaluation --runs 2",
    "simulate out/later --scenario door-relay --first-run 20 --runs 2",
    "simulate out/workflows --workflow door-relay --workflow layered-recovery --workflow human-supervision",
    "simulate out/signed --scenario door-relay --runs 1 --key out/fleet.key",
    "simulate out/named --scenario door-relay --runs 1 --origin example.org/fleet",
    "simulate out/large --architecture cfc --scenario fleet-contention --fleet-size 16 --teams-working 2 --runs 2",
    "simulate out/reviewed --scenario door-relay --set world.review_share=0.5 --runs 2",
    takes=("cluster", "json"),
    after_interruption=CONTINUES,
)
def simulate(
    out: Annotated[Place, argument("OUT", "A new folder, or that of a ledger to continue or enlarge.")],
    *,
    architecture: Names = declare(
        "NAME",
        f"{ONE_ARCHITECTURE}; may be repeated.",
        "the three of the paper; with --without, the one that has the mechanism",
        complete="architectures",
    ),
    scenario: Names = declare(
        "NAME",
        f"{ONE_SCENARIO}; may be repeated. Or one of your own: a .toml file (docs/own-fleet.md).",
        "the paper's five",
        complete="scenarios",
    ),
    workflow: Names = declare(
        "NAME",
        "Run one of the paper's workflows under FSAR instead: door-relay, layered-recovery or human-supervision; "
        "may be repeated.",
        complete="workflows",
    ),
    runs: int | None = declare("N", "Runs per scenario (or workflow) and architecture.", "20; with --workflow, 1"),
    first_run: int = declare(
        "N", "The number of the first run; another ledger has the runs before it (docs/scale.md).", value=0
    ),
    seed: int = declare("N", "The seed of every random draw of the world.", value=42),
    fleet: Place | None = declare("FILE", "A .toml file with a fleet of your own.", "the paper's"),
    settings: Names = declare(
        "NAME=VALUE",
        "A new value of a constant, such as world.review_share=0.5; may be repeated.",
        complete="constants",
        flag="--set",
    ),
    fleet_size: int | None = declare(
        "N", "Robots: a multiple of 4, since a team has four roles, or of the size of your --fleet.", "one team"
    ),
    teams_working: int | None = declare("N", "Teams that have tasks; the others stand by and can be asked.", "all"),
    task_sets: int = declare(
        "N", "How often each team that works gets the tasks of its scenario, 30 s apart.", value=1
    ),
    without: Names = declare(
        "MECHANISM",
        "Remove a mechanism of FSAR: trust-evaluation, policy-composition, layered-recovery or shared-registry "
        "(docs/model.md lists more, also of CFC and DHMA), or several of one architecture, joined by +. May be "
        "repeated, for one configuration each.",
        complete="mechanisms",
    ),
    origin: str | None = declare(
        "NAME", "Publish the ledger under this name, such as host/path.", "the key's name, else fsar-ledger/simulated"
    ),
    key: KeyOption = None,
    adopt: AdoptOption = False,
    workers: WorkersOption = None,
    progress: Annotated[Progress | None, Shows("simulated", "batches")] = None,
) -> Simulated:
    """Simulate fleets, and append every event to the ledger OUT.

    Called again, an interrupted simulation continues where it stopped. With more --runs, or other scenarios, it adds
    what is missing.

    Raises:
        InvalidExperiment: A name is unknown, or a number impossible.
        UsageError: The arguments contradict each other.
        WriteFailed: A write failed; what is committed stays.
    """
    from fsar_ledger.runtime.experiment import run_experiment
    from fsar_ledger.runtime.experiment_arguments import experiment_of

    from .key import origin_of, signer_of
    from .ledger import Ledger

    require_whole(runs=runs, first_run=first_run, seed=seed, fleet_size=fleet_size)
    require_whole(teams_working=teams_working, task_sets=task_sets)
    experiment = experiment_of(
        names_of(architecture),
        names_of(scenario),
        runs,
        seed,
        fleet_size,
        names_of(without),
        names_of(workflow),
        (teams_working, task_sets),
        None if fleet is None else str(fleet),
        names_of(settings),
        first_run,
    )
    signer = signer_of(key, adopts=adopt)
    processes = workers_of(workers, experiment.size * experiment.fleet_size // WORTH_ROBOTS)
    result = run_experiment(Path(out), experiment, processes, progress, signer, origin_of(origin), adopts=adopt)
    return Simulated(Ledger(out), result, key)


def before(result: "SimulationResult") -> list[str]:
    """Return a line on the runs that already existed, if any."""
    more = result.runs_held - result.runs_asked
    others = f", and {more:,} more" if more else ""
    if not result.runs_made:
        are = "is" if result.runs_asked == 1 else "are"
        return [f"nothing to do: the {counted(result.runs_asked, 'requested run')} {are} already there{others}"]
    if result.runs_made < result.runs_asked:
        earlier = result.runs_asked - result.runs_made
        return [
            f"made {counted(result.runs_made, 'run')}; {earlier:,} of the {result.runs_asked:,} requested were already "
            f"there{others}"
        ]
    return [f"made {counted(result.runs_made, 'run')}, beside {more:,} of other experiments"] if more else []


def _signed(ledger: Path, key: Path) -> str:
    """Return whether this key signed the newest commit, in words."""
    from fsar_ledger.ledger.log.note import signers_of
    from fsar_ledger.ledger.opening import open_ledger
    from fsar_ledger.ledger.store.keys import read_signer

    note = open_ledger(ledger).note()
    signers = None if note is None else signers_of(note)
    if signers == read_signer(key).verifier.key:
        return f"signed by {printable.value(signers)}"
    signed = f"signed by {printable.value(signers)}" if signers else "unsigned"
    return f"nothing was appended, so nothing was signed; the newest commit is {signed}"
