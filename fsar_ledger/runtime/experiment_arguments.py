"""Build an experiment from the arguments of `simulate`, and the command that continues a plan of a ledger."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from fsar_ledger.base import printable
from fsar_ledger.base.errors import InvalidExperiment, UsageError, option
from fsar_ledger.base.parameters import BadParameters
from fsar_ledger.designs import registered
from fsar_ledger.designs.constants import Constants, Load, read_constants
from fsar_ledger.designs.registered import PAPER_SCENARIOS, known_names, workflows
from fsar_ledger.events.configuration import (
    ARCHITECTURES,
    EVERY_MECHANISM,
    FULL,
    MECHANISMS_OF,
    PAPER_ARCHITECTURES,
    removed_mechanisms,
)
from fsar_ledger.events.configuration import without as ablation
from fsar_ledger.ledger.store.read import View
from fsar_ledger.ledger.store.shards import log_of, views_of
from fsar_ledger.metrics.database import Database
from fsar_ledger.metrics.provenance import EXPERIMENTS
from fsar_ledger.runtime.experiment import ORIGIN, Experiment, workflow_experiment
from fsar_ledger.runtime.own import is_file, with_exchanges, with_own
from fsar_ledger.runtime.paper import NAMES, paper_ledger, whole_of
from fsar_ledger.runtime.simulation import plan_id
from fsar_ledger.runtime.world import team_size

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
    first_run: int = 0,
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
            "first_run": first_run or None,
        }
        return _workflows_of(workflows, runs, seed, others, architectures, fleet_size)

    configurations = tuple(
        dict.fromkeys(ablation(known_names("mechanism", _joined(name), EVERY_MECHANISM)) for name in without or ())
    )
    affected = tuple(
        name
        for name in MECHANISMS_OF
        if any(removed_mechanisms(configuration) & set(MECHANISMS_OF[name]) for configuration in configurations)
    )
    known_names("scenario", [name for name in scenarios or () if not is_file(name)], registered.scenarios())
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
        architectures=known_names("architecture", architectures, ARCHITECTURES) or affected or PAPER_ARCHITECTURES,
        scenarios=chosen or registered.PAPER_SCENARIOS,
        configurations=configurations or (FULL,),
        runs=RUNS if runs is None else runs,
        seed=seed,
        fleet_size=size,
        constants=with_exchanges(constants, settings or ()),
        first_run=first_run,
    )


def _joined(text: str) -> list[str]:
    """Split names joined by +. Raises: InvalidExperiment if one is empty or repeated, or joined otherwise."""
    names = [name.strip() for name in text.split("+")]
    if "" in names or len(set(names)) < len(names) or "," in text:
        raise InvalidExperiment(
            f"{option('without', printable.value(text))}: expected mechanisms, each once, with + between them, as in "
            "trust-evaluation+shared-registry"
        )
    return names


def _workflows_of(
    requested: list[str],
    runs: int | None,
    seed: int,
    others: dict[str, Any],
    architectures: list[str] | None,
    fleet_size: int | None,
) -> Experiment:
    """Return the experiment of these workflows, under FSAR, with one robot of each role."""
    for name, value in others.items():
        if value is not None and value != []:
            first = value[0] if isinstance(value, list) else value
            raise UsageError(f"{option('workflow')} and {option(name, first)}: expected one or the other")
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
    chosen = tuple(names[name] for name in known_names("workflow", requested, tuple(names)))
    return workflow_experiment(seed, 1 if runs is None else runs, chosen)


MAX_RUNS = 9999  # of an experiment
MAX_COUNTS = 32
"""The number of values of `reproduce --runs` that are tried, the largest ones: each costs some milliseconds.

`info` also reads ledgers that others wrote.
"""
PARAMETERS = "SELECT run_id, parameters FROM experiment_planned"


class PlanRow(NamedTuple):
    """A ledger: the path that the user gave, and its content."""

    path: Path
    view: View


def plans(database: Database, ledger: PlanRow) -> list[dict[str, Any]]:
    """Return every plan, the largest first, with the command that continues it.

    The command is None if no run is missing, or if this version cannot make the missing runs.
    """
    rows, view = database.rows(EXPERIMENTS), ledger.view
    shards = [] if log_of(view) is view else views_of(view)
    constants = (
        {row["run_id"]: row["parameters"] for row in database.rows(PARAMETERS)}
        if any(row["missing_count"] for row in rows)
        else {}
    )
    reproduced = reproducing({row["plan"]: row["run_count"] for row in rows}, ledger) if constants else {}

    def call(row: Mapping[str, Any]) -> str | None:
        home = next((PlanRow(shard.path, shard) for shard in shards if shard.has_run(row["plan"])), ledger)
        return reproduced.get(row["plan"]) or continues_with(row, constants[row["plan"]], home)

    return [{**row, "continues_with": call(row) if row["missing_count"] else None} for row in rows]


def reproducing(planned: Mapping[str, int], ledger: PlanRow) -> dict[str, str]:
    """Return, by plan, the call of `reproduce` that continues a ledger that it made besides the results.

    `simulate` cannot continue such a ledger, because no key signs under its name. `planned` are the ledger's plans and
    their numbers of runs. Several values of `reproduce --runs` can give a seed this many runs; the one that covers the
    most plans of the ledger is chosen, the smallest of these if there are several.
    """
    path = ledger.path if ledger.path.name else ledger.path.resolve()
    name = next((suffix for suffix in NAMES if suffix == path.name), NAMES[0])
    if name == NAMES[0] or not ledger.view.manifest.origin.endswith(f"/{name}"):
        return {}
    calls: dict[str, tuple[int, str]] = {}
    possible = sorted({number for count in planned.values() for number in whole_of(count) if 1 <= number <= MAX_RUNS})
    for runs in (None, *possible[-MAX_COUNTS:]):
        arguments = [
            "--out",
            printable.word(path.parent),
            "--only",
            name,
            *([] if runs is None else ["--runs", str(runs)]),
        ]
        call = " ".join(("fsar-ledger reproduce", *arguments, *(["--key KEY"] if _is_signed(ledger.view) else [])))
        shared = planned.keys() & {plan_id(part.plan()) for part in paper_ledger(name, runs).parts}
        calls |= {plan: (len(shared), call) for plan in shared if len(shared) > calls.get(plan, (0, ""))[0]}
    return {plan: call for plan, (_, call) in calls.items()}


def _is_signed(view: View) -> bool:
    note = view.note()
    return note is not None and bool(note.signatures)


def shape(plan: Mapping[str, Any]) -> str:
    """Describe a plan: `door-relay x 20 runs x fsar, cfc (full), seed 42, 4 robots`."""
    parts = (
        _names_or_count(plan["scenarios"], "scenarios"),
        printable.counted(plan["run_count"], "run") + (f" from {plan['first_run']:,}" if plan["first_run"] else ""),
        _names_or_count(plan["architectures"], "architectures"),
    )
    configurations = (
        "" if plan["configurations"] == ["full"] else f" ({_names_or_count(plan['configurations'], 'configurations')})"
    )
    return f"{' x '.join(parts)}{configurations}, seed {plan['seed']}, {plan['fleet_size']} robots"


def _names_or_count(names: list[str], what: str) -> str:
    return ", ".join(map(printable.value, names)) if len(names) < printable.NAMED else f"{len(names):,} {what}"


def continues_with(plan: Mapping[str, Any], parameters: str, ledger: PlanRow) -> str | None:
    """Return the call of `simulate` that makes the missing runs; None if no call of this version has this plan.

    No call has it if the model, the constants or the names differ.
    """
    arguments = _arguments_of_plan(plan, parameters)
    try:
        if arguments is None or plan_id(experiment_of(**arguments).plan()) != plan["plan"]:
            return None
    except (InvalidExperiment, UsageError):
        return None
    return " ".join(("fsar-ledger simulate", printable.word(ledger.path), *_options(arguments), *_name(ledger.view)))


def _arguments_of_plan(plan: Mapping[str, Any], parameters: str) -> dict[str, Any] | None:
    """Return the arguments of `experiment_of` for such a plan; None if its constants cannot be read.

    An argument is None if it has its default.
    """
    try:
        load = read_constants(parameters).load or Load()
    except BadParameters:
        return None
    scenarios, architectures, configurations = (
        set(plan[name]) for name in ("scenarios", "architectures", "configurations")
    )
    is_workflow, is_ablated = scenarios <= set(workflows()), configurations != {"full"}
    default = {"fsar"} if is_workflow or is_ablated else set(PAPER_ARCHITECTURES)
    return {
        "architectures": None if architectures == default else sorted(architectures),
        "scenarios": None if is_workflow or scenarios == set(PAPER_SCENARIOS) else sorted(scenarios),
        "workflows": sorted(name.removeprefix("workflow-") for name in scenarios) if is_workflow else None,
        "without": sorted(name.removeprefix("without-") for name in configurations) if is_ablated else None,
        "runs": None if plan["run_count"] == (1 if is_workflow else RUNS) else plan["run_count"],
        "first_run": plan["first_run"],
        "seed": plan["seed"],
        "fleet_size": plan["fleet_size"],
        "load": (load.teams_working, load.task_sets),
    }


def _options(arguments: Mapping[str, Any]) -> Iterator[str]:
    """Yield the options of `simulate` for these arguments, without those at their defaults."""
    for flag, name in (
        ("--architecture", "architectures"),
        ("--scenario", "scenarios"),
        ("--workflow", "workflows"),
        ("--without", "without"),
    ):
        yield from (f"{flag} {printable.word(value)}" for value in arguments[name] or ())
    working, sets = arguments["load"]
    numbers = (
        ("--first-run", arguments["first_run"], 0),
        ("--runs", arguments["runs"], None),
        ("--seed", arguments["seed"], 42),
        ("--fleet-size", arguments["fleet_size"], 4),
    )
    for flag, value, default in (*numbers, ("--teams-working", working, None), ("--task-sets", sets, 1)):
        if value != default:
            yield f"{flag} {value}"


def _name(view: View) -> Iterator[str]:
    """Yield the option that this ledger must be written with: its key if it is signed, else an unusual origin."""
    if _is_signed(view):
        yield "--key KEY"
    elif view.manifest.origin != ORIGIN:
        yield f"--origin {printable.word(view.manifest.origin)}"
