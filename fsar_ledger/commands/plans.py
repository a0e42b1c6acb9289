"""The plans of a ledger for people: what each names, in a few words, and the call that goes on with it."""

from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, get_args

from fsar_ledger import printable
from fsar_ledger.events.envelope import Architecture, Configuration, Scenario, Workflow
from fsar_ledger.ledger.read import LedgerView
from fsar_ledger.metrics.plans import EXPERIMENTS

from .options import RUNS

if TYPE_CHECKING:
    from fsar_ledger.metrics.database import Database

NAMED = 5
"""So many names of a list are told."""


class Shown(NamedTuple):
    """The ledger as the user named it, and what is in it."""

    path: Path
    view: LedgerView


def plans(database: "Database", ledger: Shown) -> list[dict[str, Any]]:
    """Every plan, the largest first, with the call that goes on with it where runs are missing and this version can make them, else None."""
    rows = database.rows(EXPERIMENTS)
    return [{**row, "continues_with": continues_with(row, ledger) if row["missing_count"] else None} for row in rows]


def shape(plan: Mapping[str, Any]) -> str:
    """What a plan names: `door-relay x 20 runs x fsar, cfc (full), seed 42, 4 robots`."""
    parts = (_some(plan["scenarios"], "scenarios"), f"{plan['run_count']:,} runs", _some(plan["architectures"], "architectures"))
    configurations = "" if plan["configurations"] == ["full"] else f" ({_some(plan['configurations'], 'configurations')})"
    return f"{' x '.join(parts)}{configurations}, seed {plan['seed']}, {plan['fleet_size']} robots"


def _some(names: list[str], what: str) -> str:
    return ", ".join(map(printable.value, names)) if len(names) < NAMED else f"{len(names):,} {what}"


def continues_with(plan: Mapping[str, Any], ledger: Shown) -> str | None:
    """The call that makes what is missing; None where this version cannot be told so: another model, other constants, other names."""
    options = _options(plan)
    if options is None or (plan["model_version"], plan["parameters_sha256"]) != _own():
        return None
    return " ".join(("fsar-ledger simulate", printable.word(ledger.path), *options, *_name(ledger.view)))


@cache
def _own() -> tuple[str, str]:
    """The model version and the digest of the constants that `simulate` has."""
    from fsar_ledger.constants import Constants, write_constants
    from fsar_ledger.runtime.simulation import MODEL_VERSION

    return MODEL_VERSION, sha256(write_constants(Constants()).encode()).hexdigest()


def _options(plan: Mapping[str, Any]) -> list[str] | None:
    """The options of `simulate` that name this plan, those with their default left out; None if there are none."""
    scenarios, architectures, configurations = (set(plan[name]) for name in ("scenarios", "architectures", "configurations"))
    is_workflow, is_ablated = scenarios <= set(get_args(Workflow)), configurations != {"full"}
    every_architecture, every_scenario = set(get_args(Architecture)), set(get_args(Scenario))
    if not scenarios or not architectures or not configurations or not architectures <= every_architecture:
        return None
    if not configurations <= set(get_args(Configuration)) or (is_ablated and "full" in configurations):
        return None
    if not is_workflow and not scenarios <= every_scenario:
        return None
    default = {"fsar"} if is_workflow or is_ablated else every_architecture
    found = [] if architectures == default else _each("--architecture", architectures)
    if is_workflow:
        found += _each("--workflow", (name.removeprefix("workflow-") for name in scenarios))
    else:
        found += [] if scenarios == every_scenario else _each("--scenario", scenarios)
    found += _each("--without", (name.removeprefix("without-") for name in configurations)) if is_ablated else []
    numbers = (("--runs", plan["run_count"], 1 if is_workflow else RUNS), ("--seed", plan["seed"], 42), ("--fleet-size", plan["fleet_size"], 4))
    return [*found, *(f"{option} {value}" for option, value, usual in numbers if value != usual)]


def _each(option: str, names: Iterable[str]) -> list[str]:
    return [f"{option} {name}" for name in sorted(names)]


def _name(view: LedgerView) -> Iterator[str]:
    """The options that let this ledger be written to: a key where the newest commit is signed, else the origin where it is not the usual one."""
    from fsar_ledger.runtime.experiment import ORIGIN

    if view.records and view.records[-1].signed_note().signatures:
        yield "--key KEY"
    elif view.manifest.origin != ORIGIN:
        yield f"--origin {printable.word(view.manifest.origin)}"
