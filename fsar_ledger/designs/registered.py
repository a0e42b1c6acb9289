"""The fleets, scenarios and workflows that come with the package, one file each.

Adding a file, named after what is in it, registers another one; nothing else changes. Each is read once, when first
used. An error about a name that is unknown suggests the nearest.
"""

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import TypeVar

from fsar_ledger.base import printable
from fsar_ledger.base.errors import InvalidExperiment, UsageError

from . import Fleet, Scenario, Workflow
from .files import Field, at_line, decoded

_T = TypeVar("_T", Fleet, Scenario, Workflow)
_Name = TypeVar("_Name", bound=str)

PAPER_FLEET = "paper"
PAPER_SCENARIOS = (
    "door-relay",
    "collaborative-delivery",
    "failure-recovery-chain",
    "mixed-trust-inspection",
    "fleet-contention",
)
"""The paper's five, in its order; other registered ones come after them. Paper: sec:evaluation:scenarios."""
PAPER_WORKFLOWS = ("workflow-door-relay", "workflow-layered-recovery", "workflow-human-supervision")


@cache
def fleets() -> tuple[str, ...]:
    """Return the names of the registered fleets, the paper's first."""
    return _names("fleets", (PAPER_FLEET,))


@cache
def scenarios() -> tuple[str, ...]:
    """Return the names of the registered scenarios, the paper's first."""
    return _names("scenarios", PAPER_SCENARIOS)


@cache
def workflows() -> tuple[str, ...]:
    """Return the names of the registered workflows, the paper's first."""
    return _names("workflows", PAPER_WORKFLOWS)


@cache
def fleet(name: str = PAPER_FLEET) -> Fleet:
    """Return the registered fleet of this name."""
    return _read("fleets", name, Fleet)


@cache
def scenario(name: str) -> Scenario:
    """Return the registered scenario of this name."""
    return _read("scenarios", name, Scenario)


@cache
def workflow(name: str) -> Workflow:
    """Return the registered workflow of this name."""
    return _read("workflows", name, Workflow)


def at(design: Fleet | Scenario | Workflow, field: Field) -> str:
    """Return the file, the line and the field of a registered design, for the beginning of a message."""
    file = _folder(f"{type(design).__name__.lower()}s") / f"{design.name}.toml"
    return at_line(str(file), file.read_text("utf-8"), field)


def _names(folder: str, first: tuple[str, ...]) -> tuple[str, ...]:
    there = {file.stem for file in _folder(folder).glob("*.toml")}
    return (*first, *sorted(there.difference(first)))


def _read(folder: str, name: str, kind: type[_T]) -> _T:
    file = _folder(folder) / f"{name}.toml"
    text = file.read_text("utf-8")
    found = decoded(text, kind, str(file))
    if found.name != name:
        where = at_line(str(file), text, ("name",))
        raise UsageError(f"{where}: found {printable.value(found.name)}, expected the name of the file, {name}")
    return found


def _folder(name: str) -> Path:
    return Path(__file__).parents[1] / "runtime" / "world" / name


def known(what: str, asked: Sequence[str] | None, names: tuple[_Name, ...]) -> tuple[_Name, ...]:
    """Return the names asked for, each once, in the order of `names`.

    Raises:
        InvalidExperiment: A name is unknown; the message suggests the nearest.
    """
    for name in asked or ():
        if name not in names:
            hint = printable.did_you_mean(name.lower(), names)
            raise InvalidExperiment(f"unknown {what} {name!r}{hint or ';'} expected one of {', '.join(names)}")
    return tuple(name for name in names if name in (asked or ()))
