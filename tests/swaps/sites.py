"""Where an event, or a part of one, is made, and which two arguments could have been written in each other's place.

A function that makes such a part from principals by name (`HELPERS`) counts as the part does.
"""

import ast
import copy
from collections.abc import Iterator
from functools import cache
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple, get_args, get_type_hints

import msgspec

from fsar_ledger.events import EVENT_TYPES
from fsar_ledger.events.envelope import (
    Agent,
    Coordinator,
    Part,
    Parties,
    Principals,
    RequestSubject,
    Robot,
    Service,
    Subject,
    Supervisor,
)
from fsar_ledger.runtime.handlers.attribution import recorded_by

PACKAGE = Path(__file__).resolve().parents[2] / "fsar_ledger"
PARTS: tuple[type[Part], ...] = (Subject, RequestSubject, Parties, Principals)
MADE: dict[str, type[msgspec.Struct]] = {cls.__name__: cls for cls in (*EVENT_TYPES, *PARTS)}
HELPERS: dict[str, dict[str, Any]] = {helper.__name__: get_type_hints(helper) for helper in (recorded_by,)}
PRINCIPALS = frozenset({Robot, Supervisor, Service, Agent, Coordinator})


class Swap(NamedTuple):
    """Two arguments of one call that change places: the call is the so-manieth of its file, the arguments count
    positional ones first."""

    file: Path
    call: int
    one: int
    other: int
    line: int
    name: str

    def __str__(self) -> str:
        return f"{self.file.relative_to(PACKAGE)}:{self.line} {self.name}"


@cache
def swaps() -> list[Swap]:
    """Return every swap of two arguments of the same declared type, or of two principals of any kind; not of equal
    ones."""
    return [swap for file in sorted(PACKAGE.rglob("*.py")) for swap in _swaps_in(file)]


def swapped(tree: ast.Module, swap: Swap) -> ast.Module:
    """Return a copy of the module in which the two arguments have changed places."""
    tree = copy.deepcopy(tree)
    call = calls(tree)[swap.call]
    one, other = _slots(call)[swap.one], _slots(call)[swap.other]
    first, second = one.get(), other.get()
    one.put(second)
    other.put(first)
    return tree


def calls(tree: ast.AST) -> list[ast.Call]:
    """Return every call of the module, or of a part, in an order that unparsing does not change."""
    return [node for node in ast.walk(tree) if isinstance(node, ast.Call)]


class _Slot(NamedTuple):
    """One argument of a call."""

    call: ast.Call
    number: int

    def get(self) -> ast.expr:
        positional = len(self.call.args)
        if self.number < positional:
            return self.call.args[self.number]
        return self.call.keywords[self.number - positional].value

    def put(self, value: ast.expr) -> None:
        positional = len(self.call.args)
        if self.number < positional:
            self.call.args[self.number] = value
        else:
            self.call.keywords[self.number - positional].value = value


def _slots(call: ast.Call) -> list[_Slot]:
    return [_Slot(call, number) for number in range(len(call.args) + len(call.keywords))]


def _swaps_in(file: Path) -> Iterator[Swap]:
    tree = ast.parse(file.read_text())
    within = {call: node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef) for call in calls(node)}
    for number, call in enumerate(calls(tree)):
        name = call.func.id if isinstance(call.func, ast.Name) else ""
        if isinstance(call.func, ast.Attribute) and call.func.attr == "decided":
            fields = [(f"path {place}", frozenset[Any](PRINCIPALS)) for place in range(len(call.args))]
        elif name in MADE or name in HELPERS:
            types = HELPERS.get(name) or {field.name: field.type for field in msgspec.structs.fields(MADE[name])}
            declared = {field: _kinds(kind) for field, kind in types.items()}
            names = [*list(declared)[: len(call.args)], *(str(keyword.arg) for keyword in call.keywords)]
            fields = [(one, declared[one]) for one in names]
        else:
            continue
        slots = _slots(call)
        for one, other in combinations(range(len(slots)), 2):
            kinds, others = fields[one][1], fields[other][1]
            alike = kinds == others or (kinds & PRINCIPALS and others & PRINCIPALS)
            if alike and ast.dump(slots[one].get()) != ast.dump(slots[other].get()):
                pair = f"{name or 'decided'}: {fields[one][0]}, {fields[other][0]}"
                yield Swap(file, number, one, other, call.lineno, f"{within.get(call, 'module')} {pair}")


def _kinds(kind: Any) -> frozenset[Any]:
    """The types of a field, None aside: `Robot | None` is declared as `Robot` is.

    Lists of principals are no principals.
    """
    return frozenset(get_args(kind) or (kind,)) - {type(None)}
