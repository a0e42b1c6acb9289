"""What a slice of a ledger answers; a run of years that was cut is judged some parts at a time.

What a judge says of a run is said of tasks, actions and failures, one by one. What was over before the oldest that is
still open began can meet nothing that comes later. So some parts are judged together with what was carried to them, and
what is said of what is carried on is left to the next ones: the rest is settled, and adds up.
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
"""The metrics that say whether, and not how often."""
_OF_THE_RUN = frozenset({"actions_under_way", "run_started", "runs", "unobservable"})
"""What follows from how a run began; `actions_under_way` and what is open of `unobservable` are of foreign runs."""


def answers(
    one: Slice, head: Head, rows_verified: bool | None, queries: Mapping[str, SliceQuery], threads: int | None = None
) -> dict[str, pa.Table]:
    """Return what a slice of the ledger with this head answers to these, by their texts.

    Raises: As `slices.fill` and `Database.table`.
    """
    connect = partial(slices.connect, one, head, rows_verified, threads)
    found = _answers_by_cuts(one, connect, {text: each for text, each in queries.items() if _adds_up(each)})
    if rest := queries.keys() - found.keys():
        with connect() as database:
            slices.fill(database, one)
            found.update((text, queries[text].of(database)) for text in rest)
    return found


# See docs/decisions/long-runs-are-judged-by-their-cuts.md.
def _answers_by_cuts(
    one: Slice, connect: Callable[[], Database], queries: Mapping[str, SliceQuery]
) -> dict[str, pa.Table]:
    """Return what a slice answers to these if it has one run that was cut, judged some parts at a time; else nothing.

    Nothing, too, where an event of a part is about a task of an earlier one that was over. Raises: As `Database.table`.
    """
    if not (queries and (stretches := _stretches(one))):
        return {}
    names = sorted(_adding() & frozenset[str]().union(*(each.reads or () for each in queries.values())))
    carrying = slice_query(_CARRYING).text
    texts = {name: digest_of([carrying, slice_query(f"SELECT * FROM {name}").text]) for name in names}
    texts[_CARRIED] = carrying
    of_parts: dict[str, list[pa.Table]] = {name: [] for name in names}
    with connect() as database:  # one for all of them, since to plan the queries takes as long as to answer them
        types = relation.types_of(database, slices.segments(one))
        parts = relation.Parts(one.runs[-1].run, types, {}, 0, None)
        for stretch in stretches:
            last = parts = parts._replace(sizes={each.run: each.rows for each in stretch.slice.runs})
            if (made := _settled_of(stretch, database, texts, parts)) is None:
                return {}
            for name in names:
                of_parts[name].append(made[name])
            # Event 0 of each part repeats that of the first.
            after = max(parts.before, 1) + sum(parts.sizes.values()) - len(parts.sizes)
            parts = parts._replace(before=after, carried=made[_CARRIED])
    with connect() as database:
        slices.fill(database, stretch.slice, last)
        for name, tables in of_parts.items():
            database.hold(name, summed(name, tables))
        return {text: each.of(database) for text, each in queries.items()}


class _Stretch(NamedTuple):
    """Some parts of a run in a row, and by `digest` the bytes of all up to their end; None where these have no hash."""

    slice: Slice
    digest: str | None
    is_last: bool


def _stretches(one: Slice) -> list[_Stretch]:
    """Return the parts of the run that a slice has alone, those together that are judged at once; nothing if all are.

    Nothing, too, if it has several runs, or parts in several ledgers.
    """
    earlier = earlier_runs(one.view) if len(one.runs) > 1 else {}
    follow = all(earlier.get(after.run) == before.run for before, after in pairwise(one.runs))
    if not follow or len([*views_of(one.view)]) > 1:
        return []
    found: list[_Stretch] = []
    until: list[Extent] = []
    for runs in parts_of(one.runs, lambda each: each.rows, one.most):
        until += runs
        is_last = len(until) == len(one.runs)
        digest = None if is_last else slice_of(one.view, until, one.beside, one.most).digest
        found.append(_Stretch(slice_of(one.view, runs, one.beside, one.most), digest, is_last))
    return found if len(found) > 1 else []


def digests(one: Slice) -> dict[tuple[Extent, ...], str]:
    """Return by which digest the cache knows a slice, and the parts of its run that are judged at once, by the runs."""
    known = [(one.runs, one.digest), *((each.slice.runs, each.digest) for each in _stretches(one))]
    return {runs: digest for runs, digest in known if digest is not None}


@cache
def _adding() -> frozenset[str]:
    """Return the relations whose rows or numbers about a run are those of its parts, added up."""
    every = library().relations.values()
    metrics = {one.relation for one in every if one.name.startswith("metrics/") and "Partial" in one.header}
    offences = {one.relation for one in every if one.name.startswith("invariants/")}
    return frozenset(metrics | offences | {"invariant_cases", "open_work"})


def _adds_up(query: SliceQuery) -> bool:
    """Return whether an answer follows from what adds up over the parts of a run, and else from how it began."""
    reads = query.reads or frozenset()
    return not reads.isdisjoint(_adding()) and not library().needs(reads, _adding() | _OF_THE_RUN)


def _settled_of(
    stretch: _Stretch, database: Database, texts: Mapping[str, str], parts: relation.Parts
) -> dict[str, pa.Table] | None:
    """As `settled`, from the cache where it is known by these texts; the run may have had another name then."""
    known = slices.remembered(stretch.digest, texts.values())
    made = {name: slices.joined([known[text]]) for name, text in texts.items() if text in known}
    if lacking := texts.keys() - made.keys():
        database.empty()
        slices.fill(database, stretch.slice, parts)
        found = settled(database, sorted(lacking - {_CARRIED}), made.get(_CARRIED), is_last=stretch.is_last)
        if found is None:
            return None
        made |= found
        slices.remember(stretch.digest, {texts[name]: slices.written(made[name]) for name in lacking})
    return {name: _of_run(slices.coded(table), parts.run) for name, table in made.items()}


def carried_on(database: Database) -> pa.Table | None:
    """Return the events that later parts may need; None if one is about a task whose beginning is not there.

    Raises: As `Database.table`.
    """
    carrying = database.table(_CARRYING)
    return None if False in carrying["has_begun"].to_pylist() else carrying.drop_columns(["has_begun"])


def settled(
    database: Database, names: Sequence[str], carried: pa.Table | None, *, is_last: bool
) -> dict[str, pa.Table] | None:
    """Return of each of these relations what no later part changes, and what is carried on to the next, if not known.

    The database has the events of some parts and what was carried to them; what is said of what is carried on is left
    to the next part, if there is one. None if an event is about a task whose beginning was not carried, or if the rest
    does not add up.

    Raises: As `Database.table`.
    """
    if carried is None and (carried := carried_on(database)) is None:
        return None
    here = {name: database.table(f"SELECT * FROM {name}") for name in names}
    made = {_CARRIED: carried}
    if is_last:
        return made | here
    numbers = database.table("SELECT * FROM run_numbers")
    database.refill(carried)
    database.hold("run_numbers", numbers)
    for name, table in here.items():
        again = database.table(f"SELECT * FROM {name}").cast(table.schema)
        if "seq" in table.column_names:  # an offence
            made[name] = table.filter(pc.invert(pc.is_in(table["seq"], again["seq"])))
            adds_up = pc.all(pc.is_in(again["seq"], table["seq"]), min_count=0).as_py()
        else:
            made[name] = _added(name, [(1, table), (-1, again)])
            adds_up = all(
                not pc.any(pc.less(column, 0)).as_py() for column in made[name].columns if column.type == pa.int64()
            )
        if not adds_up:
            return None
    return made


def _of_run(table: pa.Table, run: str) -> pa.Table:
    names = pa.DictionaryArray.from_arrays(pa.array(np.zeros(len(table), np.int32)), pa.array([run]))
    return table.set_column(table.schema.get_field_index("run_id"), "run_id", names)


def summed(name: str, tables: Sequence[pa.Table]) -> pa.Table:
    """Return the rows of a relation over a whole run, given what is settled of each part."""
    return pa.concat_tables(tables) if "seq" in tables[0].column_names else _added(name, [(1, one) for one in tables])


def _added(name: str, signed: Iterable[tuple[int, pa.Table]]) -> pa.Table:
    """Return the numbers of a relation, added and subtracted; what says whether is not."""
    key, sums = tuple(library().relations[name].key or ()), dict[tuple[Any, ...], dict[str, Any]]()
    for sign, table in signed:
        for row in table.to_pylist():
            whole = sums.setdefault(tuple(row[one] for one in key), dict.fromkeys(row))
            for column, value in row.items():
                if not isinstance(value, int):
                    whole[column] = value if sign > 0 else whole[column]
                elif name not in _WHETHER or column != "numerator":
                    whole[column] = (whole[column] or 0) + sign * value
                elif sign > 0:
                    whole[column] = max(whole[column] or 0, value)
    for row in sums.values():
        for rest in ("", "_without_routine"):
            if f"value{rest}" in row:
                of = row[f"denominator{rest}"]
                share = row[f"numerator{rest}"] / of if of else None
                row[f"value{rest}"] = share / 1_000_000 if share is not None and name.endswith("_s") else share
    rows = [row for row in sums.values() if "value" in row or any(isinstance(one, int) and one for one in row.values())]
    return pa.Table.from_pylist(rows, slices.decoded(table.slice(0, 0)).schema)
