"""Answer queries over a slice of a ledger; a long run that was cut is judged some parts at a time.

Verdicts on a run are about single tasks, actions and failures. What ended before the oldest open one began cannot
interact with anything later. So some parts are judged together with the events carried over to them, and verdicts on
what is carried on are left to the next parts: the rest is settled, and adds up.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache, partial
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from fsar_ledger.base.progress import parts_of
from fsar_ledger.ledger.store.derived import Extent
from fsar_ledger.ledger.store.locations import earlier_runs
from fsar_ledger.ledger.store.record import Head
from fsar_ledger.ledger.store.shards import views_of

from . import relation, slices
from .connection import Database
from .library import library
from .slices import Slice, SliceQuery, digest_of, slice_of, slice_query

_CARRIED = "carried_events"
_CARRYING = f"SELECT events.*, carried.has_begun FROM events INNER JOIN {_CARRIED} AS carried USING (run_id, seq)"
_WHETHER = frozenset({"human_intervention"})
"""The metrics that count whether, and not how often."""
_OF_THE_RUN = frozenset({"actions_under_way", "run_started", "runs", "unobservable"})
"""What follows from how a run began; `actions_under_way` and the open part of `unobservable` are of foreign runs."""


def answers(
    one: Slice, head: Head, rows_verified: bool | None, queries: Mapping[str, SliceQuery], threads: int | None = None
) -> dict[str, pa.Table]:
    """Return the answers of a slice of the ledger with this head to these queries, by their texts.

    Raises: As `slices.fill` and `Database.table`.
    """
    connect = partial(slices.connect, one, head, rows_verified, threads)
    tables = _answers_by_cuts(one, connect, {text: query for text, query in queries.items() if _adds_up(query)})
    if rest := queries.keys() - tables.keys():
        with connect() as database:
            slices.fill(database, one)
            tables.update((text, queries[text].of(database)) for text in rest)
    return tables


# See docs/decisions/long-runs-are-judged-by-their-cuts.md.
def _answers_by_cuts(
    slice_: Slice, connect: Callable[[], Database], queries: Mapping[str, SliceQuery]
) -> dict[str, pa.Table]:
    """Return the answers of a slice that has one run that was cut, judged some parts at a time; else nothing.

    Also nothing where an event of a part is about a task that ended in an earlier one. Raises: As `Database.table`.
    """
    if not (queries and (stretches := _stretches(slice_))):
        return {}
    names = sorted(_adding() & frozenset[str]().union(*(query.reads or () for query in queries.values())))
    carrying = slice_query(_CARRYING).text
    texts = {name: digest_of([carrying, slice_query(f"SELECT * FROM {name}").text]) for name in names}
    texts[_CARRIED] = carrying
    of_parts: dict[str, list[pa.Table]] = {name: [] for name in names}
    with connect() as database:  # one for all, since planning the queries takes as long as answering them
        types = relation.types_of(database, slices.segments(slice_))
        parts = relation.Parts(slice_.runs[-1].run, types, {}, 0, None)
        for stretch in stretches:
            last = parts = parts._replace(sizes={extent.run: extent.rows for extent in stretch.slice.runs})
            if (settled_rows := _settled_of(stretch, database, texts, parts)) is None:
                return {}
            for name in names:
                of_parts[name].append(settled_rows[name])
            # Event 0 of each part repeats that of the first.
            events_before = max(parts.before, 1) + sum(parts.sizes.values()) - len(parts.sizes)
            parts = parts._replace(before=events_before, carried=settled_rows[_CARRIED])
    with connect() as database:
        slices.fill(database, stretch.slice, last)
        for name, tables in of_parts.items():
            database.hold(name, summed(name, tables))
        return {text: query.of(database) for text, query in queries.items()}


class _Stretch(NamedTuple):
    """Consecutive parts of a run, and the `digest` of all bytes up to their end; None where these have no hash."""

    slice: Slice
    digest: str | None
    is_last: bool


def _stretches(slice_: Slice) -> list[_Stretch]:
    """Return the parts of a slice's only run, grouped as they are judged; nothing if one group has all.

    Also nothing if it has several runs, or parts in several ledgers.
    """
    earlier = earlier_runs(slice_.view) if len(slice_.runs) > 1 else {}
    follow = all(earlier.get(following.run) == previous.run for previous, following in pairwise(slice_.runs))
    if not follow or len([*views_of(slice_.view)]) > 1:
        return []
    stretches: list[_Stretch] = []
    until: list[Extent] = []
    for runs in parts_of(slice_.runs, lambda extent: extent.rows, slice_.most):
        until += runs
        is_last = len(until) == len(slice_.runs)
        digest = None if is_last else slice_of(slice_.view, until, slice_.beside, slice_.most).digest
        stretches.append(_Stretch(slice_of(slice_.view, runs, slice_.beside, slice_.most), digest, is_last))
    return stretches if len(stretches) > 1 else []


def digests(one: Slice) -> dict[tuple[Extent, ...], str]:
    """Return the cache's digests of a slice and of the groups of parts of its run, by their runs."""
    digests_of = [(one.runs, one.digest), *((stretch.slice.runs, stretch.digest) for stretch in _stretches(one))]
    return {runs: digest for runs, digest in digests_of if digest is not None}


@cache
def _adding() -> frozenset[str]:
    """Return the relations whose rows or numbers about a run are the sums of those of its parts."""
    queries = library().relations.values()
    metrics = {query.relation for query in queries if query.name.startswith("metrics/") and "Partial" in query.header}
    offences = {query.relation for query in queries if query.name.startswith("invariants/")}
    return frozenset(metrics | offences | {"invariant_cases", "open_work"})


def _adds_up(query: SliceQuery) -> bool:
    """Return whether an answer depends only on relations that add up over a run's parts, and on how it began."""
    reads = query.reads or frozenset()
    return not reads.isdisjoint(_adding()) and not library().needs(reads, _adding() | _OF_THE_RUN)


def _settled_of(
    stretch: _Stretch, database: Database, texts: Mapping[str, str], parts: relation.Parts
) -> dict[str, pa.Table] | None:
    """Return `settled`, from the cache where it has these texts; the run may have had another name then."""
    cached = slices.remembered(stretch.digest, texts.values())
    rows = {name: slices.joined([cached[text]]) for name, text in texts.items() if text in cached}
    if lacking := texts.keys() - rows.keys():
        database.empty()
        slices.fill(database, stretch.slice, parts)
        computed = settled(database, sorted(lacking - {_CARRIED}), rows.get(_CARRIED), is_last=stretch.is_last)
        if computed is None:
            return None
        rows |= computed
        slices.remember(stretch.digest, {texts[name]: slices.table_bytes(rows[name]) for name in lacking})
    return {name: _of_run(slices.coded(table), parts.run) for name, table in rows.items()}


def carried_on(database: Database) -> pa.Table | None:
    """Return the events that later parts may need; None if one is about a task whose beginning is missing.

    Raises: As `Database.table`.
    """
    carrying = database.table(_CARRYING)
    return None if False in carrying["has_begun"].to_pylist() else carrying.drop_columns(["has_begun"])


def settled(
    database: Database, names: Sequence[str], carried: pa.Table | None, *, is_last: bool
) -> dict[str, pa.Table] | None:
    """Return the rows of each relation that no later part changes, and the events carried on to the next part.

    The database has the events of some parts and those carried to them; verdicts on what is carried on are left to the
    next part, if there is one. `carried` is computed if None. None if an event is about a task whose beginning was not
    carried, or if the rest does not add up.

    Raises: As `Database.table`.
    """
    if carried is None and (carried := carried_on(database)) is None:
        return None
    rows = {name: database.table(f"SELECT * FROM {name}") for name in names}
    settled_rows = {_CARRIED: carried}
    if is_last:
        return settled_rows | rows
    numbers = database.table("SELECT * FROM run_numbers")
    database.refill(carried)
    database.hold("run_numbers", numbers)
    for name, table in rows.items():
        open_rows = database.table(f"SELECT * FROM {name}").cast(table.schema)
        if "seq" in table.column_names:  # an offence
            settled_rows[name] = table.filter(pc.invert(pc.is_in(table["seq"], open_rows["seq"])))
            adds_up = pc.all(pc.is_in(open_rows["seq"], table["seq"]), min_count=0).as_py()
        else:
            settled_rows[name] = _added(name, [(1, table), (-1, open_rows)])
            adds_up = all(
                not pc.any(pc.less(column, 0)).as_py()
                for column in settled_rows[name].columns
                if column.type == pa.int64()
            )
        if not adds_up:
            return None
    return settled_rows


def _of_run(table: pa.Table, run: str) -> pa.Table:
    names = pa.DictionaryArray.from_arrays(pa.array(np.zeros(len(table), np.int32)), pa.array([run]))
    return table.set_column(table.schema.get_field_index("run_id"), "run_id", names)


def summed(name: str, tables: Sequence[pa.Table]) -> pa.Table:
    """Return the rows of a relation over a whole run, given the settled rows of each part."""
    return (
        pa.concat_tables(tables) if "seq" in tables[0].column_names else _added(name, [(1, table) for table in tables])
    )


def _added(name: str, signed: Iterable[tuple[int, pa.Table]]) -> pa.Table:
    """Return the numbers of a relation, added and subtracted, except numerators of `_WHETHER`."""
    key, sums = tuple(library().relations[name].key or ()), dict[tuple[Any, ...], dict[str, Any]]()
    for sign, table in signed:
        for row in table.to_pylist():
            total = sums.setdefault(tuple(row[column] for column in key), dict.fromkeys(row))
            for column, value in row.items():
                if not isinstance(value, int):
                    total[column] = value if sign > 0 else total[column]
                elif name not in _WHETHER or column != "numerator":
                    total[column] = (total[column] or 0) + sign * value
                elif sign > 0:
                    total[column] = max(total[column] or 0, value)
    for row in sums.values():
        for rest in ("", "_without_routine"):
            if f"value{rest}" in row:
                denominator = row[f"denominator{rest}"]
                share = row[f"numerator{rest}"] / denominator if denominator else None
                row[f"value{rest}"] = share / 1_000_000 if share is not None and name.endswith("_s") else share
    rows = [
        row
        for row in sums.values()
        if "value" in row or any(isinstance(value, int) and value for value in row.values())
    ]
    return pa.Table.from_pylist(rows, slices.decoded(table.slice(0, 0)).schema)
