"""Describe the plans of a ledger: what each names, and the command that continues it."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from fsar_ledger.base import printable
from fsar_ledger.base.errors import InvalidExperiment, UsageError
from fsar_ledger.base.parameters import BadParameters
from fsar_ledger.designs.constants import Load, read_constants
from fsar_ledger.designs.registered import PAPER_SCENARIOS, workflows
from fsar_ledger.events.configuration import PAPER_ARCHITECTURES
from fsar_ledger.ledger.store.read import View
from fsar_ledger.metrics.database import Database
from fsar_ledger.metrics.provenance import EXPERIMENTS
from fsar_ledger.runtime.experiment import ORIGIN
from fsar_ledger.runtime.experiment_arguments import RUNS, experiment_of
from fsar_ledger.runtime.paper import NAMES, paper_ledger, whole_of
from fsar_ledger.runtime.simulation import plan_id

MAX_RUNS = 9999  # of an experiment
MAX_COUNTS = 32
"""How many values of `reproduce --runs` are tried, the largest ones: each costs some milliseconds.

`info` also reads ledgers that others wrote.
"""
PARAMETERS = "SELECT run_id, parameters FROM experiment_planned"


class PlanRow(NamedTuple):
    """A ledger, by the path that the user gave, and its content."""

    path: Path
    view: View


def plans(database: Database, ledger: PlanRow) -> list[dict[str, Any]]:
    """Return every plan, the largest first, with the command that continues it.

    The command is None where no run is missing, or where this version cannot make the missing runs.
    """
    rows = database.rows(EXPERIMENTS)
    constants = (
        {row["run_id"]: row["parameters"] for row in database.rows(PARAMETERS)}
        if any(row["missing_count"] for row in rows)
        else {}
    )
    reproduced = reproducing({row["plan"]: row["run_count"] for row in rows}, ledger) if constants else {}

    def call(row: Mapping[str, Any]) -> str | None:
        return reproduced.get(row["plan"]) or continues_with(row, constants[row["plan"]], ledger)

    return [{**row, "continues_with": call(row) if row["missing_count"] else None} for row in rows]


def reproducing(planned: Mapping[str, int], ledger: PlanRow) -> dict[str, str]:
    """Return, by plan, the call of `reproduce` that continues a ledger that it made besides the results.

    `simulate` cannot continue such a ledger, because no key signs under its name. `planned` are the ledger's plans and
    their numbers of runs. Several values of `reproduce --runs` can give this many to a seed; that with most of the
    ledger's plans is meant, and the smallest of these.
    """
    path = ledger.path if ledger.path.name else ledger.path.resolve()
    name = next((one for one in NAMES if one == path.name), NAMES[0])
    if name == NAMES[0] or not ledger.view.manifest.origin.endswith(f"/{name}"):
        return {}
    found: dict[str, tuple[int, str]] = {}
    possible = sorted({one for count in planned.values() for one in whole_of(count) if 1 <= one <= MAX_RUNS})
    for many in (None, *possible[-MAX_COUNTS:]):
        asked = ["--out", printable.word(path.parent), "--only", name, *([] if many is None else ["--runs", str(many)])]
        call = " ".join(("fsar-ledger reproduce", *asked, *(["--key KEY"] if _is_signed(ledger.view) else [])))
        theirs = planned.keys() & {plan_id(part.plan()) for part in paper_ledger(name, many).parts}
        found |= {plan: (len(theirs), call) for plan in theirs if len(theirs) > found.get(plan, (0, ""))[0]}
    return {plan: call for plan, (_, call) in found.items()}


def _is_signed(view: View) -> bool:
    note = view.note()
    return note is not None and bool(note.signatures)


def shape(plan: Mapping[str, Any]) -> str:
    """Describe what a plan names: `door-relay x 20 runs x fsar, cfc (full), seed 42, 4 robots`."""
    parts = (
        _some(plan["scenarios"], "scenarios"),
        printable.counted(plan["run_count"], "run"),
        _some(plan["architectures"], "architectures"),
    )
    configurations = (
        "" if plan["configurations"] == ["full"] else f" ({_some(plan['configurations'], 'configurations')})"
    )
    return f"{' x '.join(parts)}{configurations}, seed {plan['seed']}, {plan['fleet_size']} robots"


def _some(names: list[str], what: str) -> str:
    return ", ".join(map(printable.value, names)) if len(names) < printable.NAMED else f"{len(names):,} {what}"


def continues_with(plan: Mapping[str, Any], parameters: str, ledger: PlanRow) -> str | None:
    """Return the call of `simulate` that makes the missing runs; None if no call of this version has this plan.

    None has it where the model, the constants or the names differ.
    """
    asked = _asked(plan, parameters)
    try:
        if asked is None or plan_id(experiment_of(**asked).plan()) != plan["plan"]:
            return None
    except (InvalidExperiment, UsageError):
        return None
    return " ".join(("fsar-ledger simulate", printable.word(ledger.path), *_options(asked), *_name(ledger.view)))


def _asked(plan: Mapping[str, Any], parameters: str) -> dict[str, Any] | None:
    """Return the arguments of `experiment_of` for such a plan; None where its constants cannot be read.

    An argument is None where the default will do.
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
        "seed": plan["seed"],
        "fleet_size": plan["fleet_size"],
        "load": (load.teams_working, load.task_sets),
    }


def _options(asked: Mapping[str, Any]) -> Iterator[str]:
    """Yield the options of `simulate` for these arguments, without those at their defaults."""
    for option, name in (
        ("--architecture", "architectures"),
        ("--scenario", "scenarios"),
        ("--workflow", "workflows"),
        ("--without", "without"),
    ):
        yield from (f"{option} {printable.word(one)}" for one in asked[name] or ())
    working, sets = asked["load"]
    numbers = (("--runs", asked["runs"], None), ("--seed", asked["seed"], 42), ("--fleet-size", asked["fleet_size"], 4))
    for option, value, usual in (*numbers, ("--teams-working", working, None), ("--task-sets", sets, 1)):
        if value != usual:
            yield f"{option} {value}"


def _name(view: View) -> Iterator[str]:
    """Yield the option that this ledger must be written with: its key if it is signed, else an unusual origin."""
    if _is_signed(view):
        yield "--key KEY"
    elif view.manifest.origin != ORIGIN:
        yield f"--origin {printable.word(view.manifest.origin)}"
