"""What a shell offers for the word that is being typed: names of designs, queries, runs, parameters and constants.

What is called when the shell asks imports what it needs then, and offers nothing where it cannot tell: a shell has no
place for a message.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import typer

from fsar_ledger.base import printable
from fsar_ledger.base.errors import FsarLedgerError

if TYPE_CHECKING:
    from fsar_ledger.metrics.query_parameters import Parameter

DESIGNS = Path(__file__).parents[1] / "runtime/world"
MOST = 1_000
"""Names offered; a terminal cannot show more."""


class Line(NamedTuple):
    """The line so far: the arguments and options that it gives, by name, and the word that is being typed."""

    given: Mapping[str, Any]
    typed: str


def offered(what: str) -> Callable[[typer.Context, str], list[str]]:
    """Return what typer asks for names of this kind.

    It offers only single words that a terminal shows as they are, and nothing where the line or the ledger is wrong.
    """

    def offer(ctx: typer.Context, incomplete: str) -> list[str]:
        try:
            found = [name for name in OFFERS[what](Line(_given(ctx), incomplete)) if name.startswith(incomplete)]
        except (FsarLedgerError, OSError):
            return []
        return [name for name in found if printable.is_shown(name) and not any(map(str.isspace, name))][:MOST]

    return offer


def _given(ctx: typer.Context) -> dict[str, Any]:
    """Return the arguments and options by name.

    After an option that still lacks its value, which is the one being typed, the arguments are not yet by name.
    """
    lacking = [one.name for one in ctx.command.params if one.param_type_name == "argument"]
    by_place = {name: value for name, value in zip(lacking, ctx.args, strict=False) if name is not None}
    return {**ctx.params, **by_place}


def _designs(folder: str) -> list[str]:
    return sorted(file.stem for file in (DESIGNS / folder).glob("*.toml"))


def _mechanisms(line: Line) -> Iterable[str]:
    """Return the mechanisms of all architectures; after a `+`, further ones."""
    from fsar_ledger.events.configuration import EVERY_MECHANISM

    begun, plus, _ = line.typed.rpartition("+")
    return [f"{begun}{plus}{name}" for name in EVERY_MECHANISM]


def _invariants(_: Line) -> Iterable[str]:
    from fsar_ledger.metrics.invariants import invariants

    return [one.relation.partition("_")[0] for one in invariants()]


def _constants(_: Line) -> Iterable[str]:
    from fsar_ledger.metrics.constant_names import names_of_constants

    return [f"{name}=" for name in names_of_constants()]


def _queries(line: Line) -> Iterable[str]:
    """Return the full names of the queries, or where no `/` is typed, also the last parts."""
    from fsar_ledger.metrics.library import library

    known = library()
    return [*known.queries, *(known.relations if line.typed and "/" not in line.typed else ())]


def _studies(_: Line) -> Iterable[str]:
    from fsar_ledger.studies.verbs import STUDIES

    return STUDIES


def _parameters(line: Line) -> Iterable[str]:
    """Return the parameters of the query that the line names, as `NAME=`, and after the `=` their values."""
    from fsar_ledger.metrics.library import library

    known = library().find(line.given.get("name") or line.given.get("query") or "").parameters
    name, equals, _ = line.typed.partition("=")
    if not equals:
        return [f"{one}=" for one in known]
    return [f"{name}={value}" for value in _values(line, known[name])] if name in known else []


OFFERS: Mapping[str, Callable[[Line], Iterable[str]]] = {
    "scenarios": lambda _: _designs("scenarios"),
    "workflows": lambda _: [name.removeprefix("workflow-") for name in _designs("workflows")],
    "architectures": lambda _: ("fsar", "cfc", "dhma"),
    "mechanisms": _mechanisms,
    "invariants": _invariants,
    "constants": _constants,
    "queries": _queries,
    "studies": _studies,
    "runs": lambda line: _on_record(line, "run", None),
    "actions": lambda line: _on_record(line, "action", line.given.get("run")),
    "parameters": _parameters,
}
"""By what `Option.complete` says, the names that are offered."""


def _values(line: Line, one: "Parameter") -> Sequence[str]:
    """Return the values that a parameter can have: its default, and what the ledger has on record."""
    given = dict(pair.partition("=")[::2] for pair in line.given.get("param") or line.given.get("parameters") or ())
    default = [] if one.default is None else [one.default]
    return default if one.kind in ("time", "seq") else [*default, *_on_record(line, one.kind, given.get("run"))]


def _on_record(line: Line, kind: str, run: str | None) -> list[str]:
    """Return the names of this kind in the ledger that the line names, of one run or of all. Raises: As `connect`."""
    from fsar_ledger.api.lookup import run_of
    from fsar_ledger.metrics.database import connect
    from fsar_ledger.metrics.recorded_names import names_on_record

    with connect(Path(str(line.given.get("ledger") or ""))) as database:
        return names_on_record(database, kind, None if run in (None, "all") else run_of(database, run))
