"""What a shell offers for the word that is being typed: names of designs, queries, runs, parameters and constants.

Each function is called by typer when the shell asks. It imports what it needs then, and offers nothing where it cannot
tell: a shell has no place for a message.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import typer

from fsar_ledger import printable
from fsar_ledger.errors import FsarLedgerError

if TYPE_CHECKING:
    from fsar_ledger.metrics.database import Database
    from fsar_ledger.metrics.query_parameters import Parameter

DESIGNS = Path(__file__).parents[1] / "runtime/world"
MOST = 1_000
"""Names offered; a terminal cannot show more."""


class Line(NamedTuple):
    """The line so far: the arguments and options that it gives, by name, and the word that is being typed."""

    given: Mapping[str, Any]
    typed: str


def offering(offer: Callable[[Line], Iterable[str]]) -> Callable[[typer.Context, str], list[str]]:
    """Offer only single words that a terminal shows as they are, and nothing where the line or the ledger is wrong."""

    def offered(ctx: typer.Context, incomplete: str) -> list[str]:
        try:
            found = [name for name in offer(Line(_given(ctx), incomplete)) if name.startswith(incomplete)]
        except (FsarLedgerError, OSError):
            return []
        return [name for name in found if printable.is_shown(name) and not any(map(str.isspace, name))][:MOST]

    return offered


def _given(ctx: typer.Context) -> dict[str, Any]:
    """Return the arguments and options by name.

    After an option that still lacks its value, which is the one being typed, the arguments are not yet by name.
    """
    lacking = [one.name for one in ctx.command.params if one.param_type_name == "argument"]
    by_place = {name: value for name, value in zip(lacking, ctx.args, strict=False) if name is not None}
    return {**ctx.params, **by_place}


@offering
def scenarios(_: Line) -> Iterable[str]:
    """Return the packaged scenarios."""
    return sorted(file.stem for file in (DESIGNS / "scenarios").glob("*.toml"))


@offering
def workflows(_: Line) -> Iterable[str]:
    """Return the workflows of the paper."""
    return sorted(file.stem.removeprefix("workflow-") for file in (DESIGNS / "workflows").glob("*.toml"))


@offering
def architectures(_: Line) -> Iterable[str]:
    """Return the architectures."""
    return ("fsar", "cfc", "dhma")


@offering
def mechanisms(line: Line) -> Iterable[str]:
    """Return the mechanisms of all architectures; after a `+`, further ones."""
    from fsar_ledger.events.configuration import EVERY_MECHANISM

    begun, plus, _ = line.typed.rpartition("+")
    return [f"{begun}{plus}{name}" for name in EVERY_MECHANISM]


@offering
def invariants(_: Line) -> Iterable[str]:
    """Return the short names of the invariants."""
    from fsar_ledger.metrics.invariants import invariants as known

    return [one.relation.partition("_")[0] for one in known()]


@offering
def constants(_: Line) -> Iterable[str]:
    """Return the constants that `--set` takes, each with its `=`."""
    from fsar_ledger.metrics.constant_names import names_of_constants

    return [f"{name}=" for name in names_of_constants()]


@offering
def queries(line: Line) -> Iterable[str]:
    """Return the queries: their full names, or where no `/` is typed, also the last parts."""
    from fsar_ledger.metrics.library import library

    known = library()
    return [*known.queries, *(known.relations if line.typed and "/" not in line.typed else ())]


@offering
def studies(_: Line) -> Iterable[str]:
    """Return the studies that `study show` shows."""
    from fsar_ledger.cli.studies import STUDIES

    return STUDIES


@offering
def runs(line: Line) -> Iterable[str]:
    """Return the runs of the ledger that the line names."""
    with _ledger(line) as database:
        return _on_record(database, "run", None)


@offering
def actions(line: Line) -> Iterable[str]:
    """Return the actions of the run that the line names, or of all runs."""
    with _ledger(line) as database:
        return _on_record(database, "action", line.given.get("run"))


@offering
def parameters(line: Line) -> Iterable[str]:
    """Return the parameters of the query that the line names, as `NAME=`, and after the `=` their values."""
    from fsar_ledger.metrics.library import library

    known = library().find(line.given.get("name") or line.given.get("query") or "").parameters
    name, equals, _ = line.typed.partition("=")
    if not equals:
        return [f"{one}=" for one in known]
    if name not in known:
        return []
    return [f"{name}={value}" for value in _values(line, known[name])]


def _values(line: Line, one: "Parameter") -> Sequence[str]:
    """Return the values that a parameter can have: its default, and what the ledger has on record."""
    given = dict(pair.partition("=")[::2] for pair in line.given.get("param") or line.given.get("parameters") or ())
    default = [] if one.default is None else [one.default]
    if one.kind in ("time", "seq"):
        return default
    with _ledger(line) as database:
        return [*default, *_on_record(database, one.kind, given.get("run"))]


def _on_record(database: "Database", kind: str, run: str | None) -> list[str]:
    from fsar_ledger.api.lookup import names_on_record, run_of

    return names_on_record(database, kind, None if run in (None, "all") else run_of(database, run))


@contextmanager
def _ledger(line: Line) -> "Iterator[Database]":
    """Open the ledger that the line names. Raises: As `connect`."""
    from fsar_ledger.metrics.database import connect

    with connect(Path(str(line.given.get("ledger") or ""))) as database:
        yield database
