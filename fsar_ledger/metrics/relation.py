"""Make the relation `events` over segments of every release.

It has each event once, in its newest version, with today's columns. Files are read in place; columns newer than a
segment are NULL. Rows of a retired type whose next versions only add to it are read in place, too, with the additions.
Others are upcast one by one in memory, which takes one more pass over the segments that hold some.
"""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pyarrow as pa

from fsar_ledger.base import printable
from fsar_ledger.base.errors import FsarLedgerError, LedgerCorrupted
from fsar_ledger.events.fleet import RunContinued, RunStarted
from fsar_ledger.events.retired import ADDITIONS
from fsar_ledger.ledger.rows.codec import upcast_rows
from fsar_ledger.ledger.rows.runs import unlike_beginning
from fsar_ledger.ledger.rows.schema import (
    COLUMNS,
    ENVELOPE,
    FINGERPRINTS,
    LAYOUTS,
    RELEASE,
    RETIRED,
    SCHEMA,
    SCHEMAS,
    STANDS_ALONE,
)
from fsar_ledger.ledger.rows.segment import read_table
from fsar_ledger.ledger.store.shards import HEAD_TYPE

from .connection import Database
from .library import SQL_TYPES
from .sql_values import listed, literal, parquet, quoted, sql_literal

_DATASET, _UPCAST, _AS_STORED, _BY_RUN = "events_dataset", "events_upcast", "events_as_stored", "events_by_run"
_CARRIED = "events_carried"
_CONTINUED = f"{RunContinued.__struct_config__.tag}"
_NUMBERS = pa.schema([("run_id", pa.string()), ("number", pa.int64())])


class RowFilter(NamedTuple):
    """A condition on the rows to read.

    `run_numbers` is the relation of that name. `condition` is the SQL condition on a row, which may use it; in the
    segments of `whole` it holds for every row.
    """

    condition: str
    run_numbers: pa.Table
    whole: frozenset[Path] = frozenset()


class Parts(NamedTuple):
    """Consecutive parts of a run that was cut, with the number of events of each; the database has no others.

    `run` is the name of the whole, and `types` are its event types; `before` is how many events it has before these
    parts, and `carried` those of them to be judged with these, if any.
    """

    run: str
    types: frozenset[str] | None
    sizes: Mapping[str, int]
    before: int
    carried: pa.Table | None


def of_runs(runs: Sequence[str]) -> str:
    """Return the condition that a row belongs to one of these runs."""
    return f"run_id IN ({listed(runs)})" if len(runs) > 1 else f"run_id = {quoted(runs[0])}"


OF_NUMBERED = "run_id IN (SELECT run_numbers.run_id FROM run_numbers)"
"""The condition that a row belongs to a run that has a number."""


def numbered(runs: Sequence[str], first: int = 1) -> pa.Table:
    """Return the relation `run_numbers` of these runs, numbered from `first`."""
    return pa.table([[*runs], [*range(first, first + len(runs))]], schema=_NUMBERS)


def hold_segments(
    database: Database,
    segments: Sequence[Path],
    releases: Sequence[str],
    chosen: RowFilter | None = None,
    passing: Collection[Path] = (),
    parts: Parts | None = None,
) -> None:
    """Make the rows of these segments, given the release of each, the database's `events`.

    With `chosen`, only some rows; otherwise runs are numbered in the order of the segments. With `parts`, only their
    rows and those carried to them. The database copies the rows of `passing` segments, whose files will not stay.

    Raises: as `_upcast`, and LedgerCorrupted if there are heads of shards among them.
    """
    if not segments:
        database.hold("events", SCHEMA.empty_table())
        return
    types = types_of(database, segments) if parts is None else parts.types
    if types is not None and HEAD_TYPE in types:  # only the index says whether a ledger is the log of a federation
        raise LedgerCorrupted(
            f"{segments[0]}: found heads of shards, expected events of runs alone; the index of a log says that it is "
            "none, or a ledger of runs holds heads: run fsar-ledger verify"
        )
    database.absent = frozenset(
        tag for tag in LAYOUTS if types is not None and _name(tag) not in set(map(_name, types))
    )
    holding = _holding(database, segments, types)
    groups: dict[tuple[str, bool, bool], list[Path]] = {}
    for path, release in zip(segments, releases, strict=True):
        is_cut = chosen is not None and path not in chosen.whole
        groups.setdefault((FINGERPRINTS[release], is_cut, path in passing), []).append(path)
    present = {FINGERPRINTS[release]: frozenset(SCHEMAS[release].names) for release in releases}
    where = "" if chosen is None else f" WHERE {chosen.condition}"
    stored = [
        (f"(SELECT * FROM {source}{where})" if is_cut else source, present[fingerprint])
        for (fingerprint, is_cut, is_passing), paths in groups.items()
        if (source := (_store_segments if is_passing else _read)(database, paths))
    ]
    if chosen is not None:
        database.hold("run_numbers", chosen.run_numbers)
    name = _BY_RUN if parts is not None or (types is not None and _CONTINUED in types) else "events"
    if holding:
        _hold_newest(database, stored, holding, name, where)
    else:
        database.define(name, "\nUNION ALL\n".join(_select(*part) for part in stored))
        if groups.keys() == {(FINGERPRINTS[RELEASE], False, False)}:
            database.source = _read(database, segments)
    if parts is not None:
        _join(database, _places(parts.sizes, parts.run, parts.before), parts.carried)
        return
    continued = _join_continued(database) if name == _BY_RUN else ()
    if chosen is None and types:
        _number_runs(database, segments, continued, is_stored=database.is_for_others)


# See docs/decisions/cut-runs-are-judged-whole.md.
def _join_continued(database: Database) -> list[str]:
    """Make `events` of the rows by run: runs that continue each other become one, with the name of the last.

    Seqs run on, as in `ledger.rows.runs.continuing`. Returns the names of the others.
    """
    continues = dict(
        database.direct(f"SELECT run_id, continues FROM {_BY_RUN} WHERE type = {quoted(_CONTINUED)} AND seq = 1")
    )
    names = listed(sorted({*continues, *continues.values()})) or "NULL"
    _require_alike(database, continues, names)
    sizes = dict(
        database.direct(f"SELECT run_id, max(seq) + 1 FROM {_BY_RUN} WHERE run_id IN ({names}) GROUP BY run_id")
    )
    places = [place for chain in _chains(continues, sizes) for place in _places(chain, [*chain][-1])]
    _join(database, places)
    return [f"{place['run_id']}" for place in places if place["run_id"] != place["whole"]]


def _chains(continues: Mapping[str, str], sizes: Mapping[str, int]) -> list[dict[str, int]]:
    """Return the chains of runs that continue each other, in order, with the number of events of each."""
    chains = []
    for last in sorted(sizes.keys() - set(continues.values())):
        chain = [last]
        while (earlier := continues.get(chain[0])) in sizes and earlier not in chain:
            chain.insert(0, f"{earlier}")
        chains.append({run: sizes[run] for run in chain})
    return chains


_PLACES = pa.schema([("run_id", pa.string()), ("whole", pa.string()), ("shift", pa.int64()), ("is_first", pa.bool_())])


def _places(sizes: Mapping[str, int], whole: str, before: int = 0) -> list[dict[str, object]]:
    """Return the place of each of these parts of a run, given the number of events of each and of all before them."""
    places: list[dict[str, object]] = []
    for run, size in sizes.items():
        shift = before - 1 if before else 0
        places.append({"run_id": run, "whole": whole, "shift": shift, "is_first": not before})
        before = shift + size
    return places


def _join(database: Database, places: Sequence[Mapping[str, object]], carried: pa.Table | None = None) -> None:
    """Make `events` of the rows by run, moved to the places of their parts, and of the carried rows, unchanged."""
    database.source = None
    database.hold("run_places", pa.Table.from_pylist([*places], _PLACES))
    values = {
        "run_id": "coalesce(place.whole, one.run_id)",
        "seq": "one.seq + coalesce(place.shift, 0)",
        "caused_by": "CASE WHEN one.caused_by > 0 THEN one.caused_by + coalesce(place.shift, 0) ELSE one.caused_by END",
    }
    columns = ", ".join(values.get(name, f'one."{name}"') + f' AS "{name}"' for name in COLUMNS)
    joined = (
        f"SELECT {columns} FROM {_BY_RUN} AS one LEFT JOIN run_places AS place ON one.run_id = place.run_id "
        "WHERE one.seq > 0 OR place.is_first IS DISTINCT FROM FALSE"
    )
    if carried is not None:
        database.hold(_CARRIED, carried)
        names = ", ".join(f'"{name}"' for name in COLUMNS)
        joined += f"\nUNION ALL\nSELECT {names} FROM {_CARRIED}"
    database.define("events", joined)


def _require_alike(database: Database, continues: Mapping[str, str], names: str) -> None:
    """Require that runs continue different runs with an event 0 like their own. Raises: LedgerCorrupted."""
    excluded = ("run_id", "time_us")
    fields = (*ENVELOPE, *LAYOUTS[f"{RunStarted.__struct_config__.tag}"].fields)
    columns = ", ".join(f'"{field.name}"' for field in fields if field.name not in excluded)
    rows = database.direct(
        f"SELECT run_id, CAST(({columns}) AS VARCHAR) FROM {_BY_RUN} WHERE seq = 0 AND run_id IN ({names})"
    )
    begins: dict[str, str] = dict(rows)
    for run, continued in continues.items():
        if continued not in begins:
            continue
        if begins[run] != begins[continued]:
            raise LedgerCorrupted(unlike_beginning(run, continued))
        if others := [name for name in continues if name != run and continues[name] == continued]:
            raise LedgerCorrupted(
                f"run {printable.value(run)}: found that it continues run {printable.value(continued)}, as run "
                f"{printable.value(others[0])} does, expected one that does; run fsar-ledger verify"
            )


def _read(database: Database, paths: Sequence[Path], *options: str) -> str:
    """Return the relation that reads these segments."""
    return parquet(paths, *options, is_for_others=database.is_for_others)


def _store_segments(database: Database, paths: Sequence[Path]) -> str:
    """Return a new table with the rows of these segments."""
    name = f"events_kept_{paths[0].stem[:8]}"
    database.define(name, f"SELECT * FROM {parquet(paths)}", is_stored=True)
    return name


def hold_dataset(database: Database, stored: Any, segments: Sequence[Path]) -> None:
    """Make the rows of this Arrow dataset or table over these segments the database's `events`.

    Raises: as `_upcast`.
    """
    types = types_of(database, segments)
    holding = _holding(database, segments, types)
    name = _BY_RUN if types is not None and _CONTINUED in types else "events"
    if not holding:
        database.hold(name, stored)
    else:
        database.hold(_DATASET, stored)
        _hold_newest(database, [(_DATASET, frozenset(COLUMNS))], holding, name)
    continued = _join_continued(database) if name == _BY_RUN else ()
    if types:
        _number_runs(database, segments, continued, is_stored=True)


def _number_runs(database: Database, segments: Sequence[Path], continued: Sequence[str], *, is_stored: bool) -> None:
    """Define `run_numbers`: the runs in the order in which these segments hold their first events.

    Runs that others continue are counted, but left out.

    The relation `events` has no order: it reads rows of different releases one after the other. With `is_stored` the
    segments are read now, and never again.
    """
    source = _read(database, segments, "filename = true", "file_row_number = true")
    order = f"list_position([{listed(map(literal, segments))}], filename), file_row_number"
    database.define(
        "run_numbers",
        f"SELECT run_id, row_number() OVER (ORDER BY {order}) AS number FROM {source} WHERE seq = 0 AND type NOT IN "
        f"({listed(sorted(STANDS_ALONE))})" + (f" QUALIFY run_id NOT IN ({listed(continued)})" if continued else ""),
        is_stored=is_stored,
    )


def _hold_newest(
    database: Database,
    parts: Sequence[tuple[str, frozenset[str]]],
    holding: Mapping[str, Sequence[Path]],
    name: str,
    where: str = "",
) -> None:
    """Make the rows of these relations, given with their columns, the database's relation of this name.

    Rows of retired types that meet the condition are brought up to date.
    """
    # See docs/decisions/evidence-is-never-rewritten.md.
    others = {tag: paths for tag, paths in holding.items() if RETIRED[tag].cls not in ADDITIONS}
    added = [tag for tag in holding if tag not in others]
    kept = f" WHERE type NOT IN ({listed(others)})" if others else ""
    selects = [f"{_select(*part, added)}{kept}" for part in parts]
    if (newest := _upcast(others)) is not None:
        database.hold(_UPCAST, newest)
        selects.append(f"SELECT * FROM {_UPCAST}{where}")
    database.define(name, "\nUNION ALL\n".join(selects))
    # Most types have no retired rows. Their views need not read the types that are made row by row, which DuckDB cannot
    # skip before it has read the rest.
    database.define(_AS_STORED, "\nUNION ALL\n".join(_select(*part) for part in parts))
    database.source, database.changed = _AS_STORED, frozenset(map(_name, holding))


def _select(source: str, present: frozenset[str], added: Sequence[str] = ()) -> str:
    """Return the SELECT of all of today's columns from a relation that has those in `present`; others are NULL.

    Rows of the retired types in `added` get the additions of their later versions.
    """
    values = {
        name: f'"{name}"' if name in present else f"CAST(NULL AS {SQL_TYPES[kind]})" for name, kind in COLUMNS.items()
    }
    for tag in added:
        upgrade = ADDITIONS[RETIRED[tag].cls]
        for name, value in {**upgrade.added, "type": upgrade.after.__struct_config__.tag}.items():
            # One pass over all rows: a second, for these rows alone, would decode the types of all of them once more.
            values[name] = (
                f"CASE WHEN type = {quoted(tag)} THEN CAST({sql_literal(value)} AS {SQL_TYPES[COLUMNS[name]]}) ELSE "
                f"{values[name]} END"
            )
    columns = ", ".join(f'{value} AS "{name}"' for name, value in values.items())
    return f"SELECT {columns} FROM {source}"


def types_of(database: Database, segments: Sequence[Path]) -> frozenset[str] | None:
    """Return the event types of the rows of these segments; None if a segment cannot be read."""
    try:
        return frozenset(
            str(tag)
            for (tag,) in (database.direct(f"SELECT DISTINCT type FROM {parquet(segments)}") if segments else ())
        )
    except FsarLedgerError:
        return None


def _holding(
    database: Database, segments: Sequence[Path], types: frozenset[str] | None
) -> Mapping[str, Sequence[Path]]:
    """Return the retired types among these types of the segments, each with the segments that hold it.

    All of both if `types` is None because a segment cannot be read, so that reading it reports what is wrong.
    """
    if types is None:
        return dict.fromkeys(RETIRED, segments)
    if types.isdisjoint(RETIRED):
        return {}
    pairs = database.direct(
        f"SELECT DISTINCT type, filename FROM {parquet(segments, 'filename = true')} WHERE type IN ({listed(RETIRED)})"
    )
    paths_of = {tag: [path for path in segments if (tag, literal(path)) in pairs] for tag in RETIRED}
    return {tag: paths for tag, paths in paths_of.items() if paths}


def _name(tag: str) -> str:
    """Return the name that all versions of an event type share."""
    return tag.partition(".")[0]


def _upcast(holding: Mapping[str, Sequence[Path]]) -> pa.Table | None:
    """Return the rows of these retired types as their newest versions; None if there are none.

    Raises:
        LedgerCorrupted: A segment that holds some cannot be read, or does not hold valid events.
    """
    tags = list(holding)
    paths = dict.fromkeys(path for holders in holding.values() for path in holders)
    tables = [rows for path in paths if (rows := _upcast_segment(path, tags)) is not None]
    return pa.concat_tables(tables) if tables else None


def _upcast_segment(path: Path, tags: Sequence[str]) -> pa.Table | None:
    try:
        return upcast_rows(read_table(path), tags)
    except LedgerCorrupted as error:
        raise type(error)(f"{path}: {error}") from error
