"""Define what is read from the ledgers: the printed numbers beside ours, and what sections select from."""

import types
import typing
from collections.abc import Collection, Iterable, Mapping
from typing import Any

import msgspec
import pyarrow as pa

from fsar_ledger.metrics.database import Database
from fsar_ledger.metrics.library import generated
from fsar_ledger.metrics.multiverse import Multiverse
from fsar_ledger.report.judge import Number


class Source(msgspec.Struct, frozen=True):
    """One packaged query: its name, and the SHA-256 of its text in hex."""

    name: str
    sha256: str


class Head(msgspec.Struct, frozen=True):
    """The head of a ledger (commits, events, root), its number of runs, whether it is complete, and its model."""

    commits: int
    events: int
    root: str
    runs: int
    completeness: str
    model_version: str | None


class Findings(msgspec.Struct, frozen=True, kw_only=True):
    """Everything that the report shows of one head of a ledger, and of the ledgers beside it.

    heads: by part (results, ablation, scaling, mechanisms, workflows), of the ledger that gives it.
    numbers: every printed number of the tables that there are runs for, with ours.
    relations: what the packaged queries answered about these runs, by name.
    sources: these queries, with all that they read.
    parameters: the constants of the main runs by dotted name; parameters_sha256: their SHA-256 as recorded;
        model_version: that of these runs; model_versions: of all runs of the ledger.
    table_share: the share of experiments drawn from the main runs that print a results table as far out as the paper's;
        None if none are drawn.
    unjudged: which numbers are not judged, and why, in words; shown: which runs the tables are of, if the ledger holds
        others; differing: the pairs of runs that are left out because they met different worlds.
    multiverse: the cells under every reading of the text; None if not asked for, or if the runs are not judged.
    """

    heads: dict[str, Head]
    numbers: tuple[Number, ...] = ()
    relations: Mapping[str, Any] = {}
    sources: tuple[Source, ...] = ()
    parameters: dict[str, str] = {}
    parameters_sha256: str | None = None
    model_version: str | None = None
    model_versions: tuple[str, ...] = ()
    table_share: float | None = None
    unjudged: str | None = None
    shown: str | None = None
    differing: tuple[str, ...] = ()
    multiverse: Multiverse | None = None


def sources_of(database: Database, names: Collection[str]) -> tuple[Source, ...]:
    """Return the packaged queries of these names with everything that they read; views of event types are left out."""
    made = {one.name for one in generated()}
    needed = database.library.needs(database.library.find(name).relation for name in names)
    return tuple(
        Source(one.name, one.sha256) for one in sorted(needed, key=lambda one: one.name) if one.name not in made
    )


_TYPES: Mapping[Any, pa.DataType] = {
    str: pa.string(),
    int: pa.int64(),
    float: pa.float64(),
    bool: pa.bool_(),
}


def arrow(rows: Iterable[msgspec.Struct], kind: type[msgspec.Struct]) -> pa.Table:
    """Return the rows as an Arrow table with a column for each field, typed also where no row has a value."""
    fields = msgspec.structs.fields(kind)
    schema = pa.schema([(field.encode_name, _arrow_type(field.type)) for field in fields])
    return pa.Table.from_pylist([{one.encode_name: getattr(row, one.name) for one in fields} for row in rows], schema)


def _arrow_type(of: Any) -> pa.DataType:
    """Return the Arrow type of a field; tuples of one type are lists, and anything else is text."""
    parts = [one for one in typing.get_args(of) if one not in (type(None), Ellipsis)]
    if typing.get_origin(of) in (typing.Union, types.UnionType):
        return _arrow_type(parts[0])
    return pa.list_(_arrow_type(parts[0])) if typing.get_origin(of) is tuple else _TYPES.get(of, pa.string())
