"""Report which of the events that a query reads are not observed by the runs of a ledger.

An empty answer about such events says nothing.
"""

import re
from collections.abc import Iterable

import msgspec

from .database import Database
from .library import Library, Query
from .paths import listed

_TYPE = re.compile(r"'([A-Z][A-Za-z]+\.v\d+)'")
_NOT_READ = re.compile(r"--[^\n]*|\btype NOT IN \([^)]*\)")
_WIDE = frozenset({"events", "event_principals"})
"""Relations that hold every event, whatever its type."""
_TIES = frozenset({"event_principals", "keyed_events", "naming_events"})
"""Relations that read all events only to tell which belong together; the query names what it is about beside them."""


_OF_ANY_TYPE = frozenset({"evidence_of_principals", "keyed_events", "revocations"})
"""Queries that read events of every type, although they also name some."""


IN_PART = " in part"
"""Behind the name of a concern of which a run records some types and not others."""


class Unobserved(msgspec.Struct, frozen=True):
    """A concern, or a part of it, that some runs do not observe, and how many of how many."""

    concern: str
    runs: int
    of_runs: int


def types_read(library: Library, query: Query) -> frozenset[str] | None:
    """Return the event types that the query reads; None if it reads events of every type."""
    found: set[str] = set()
    for one in (*library.needs(query.sources() - {query.relation}, held={"unobservable"}), query):
        named = _TYPE.findall(_NOT_READ.sub("", one.sql))
        reads_all = not named and _WIDE >= one.sources() & {"events", *library.relations} > set()
        if (reads_all or one.relation in _OF_ANY_TYPE) and (one is query or one.relation not in _TIES):
            return None
        found.update(named)
    return frozenset(found)


# See docs/decisions/unobserved-is-null.md.
def unobserved(database: Database, query: Query, run: str | None = None) -> list[Unobserved]:
    """Return what the query rests on and not all runs observe (or this one does not), by name.

    A judge rests on what `unobservable` says, any other query on the concerns of the events that it reads; of a run
    that records some types of a concern, the rest of it. Raises: as `Database.rows`.
    """
    types = types_read(database.library, query)
    named = "" if types is None else f"WHERE type IN ({listed(sorted(types)) or 'NULL'})"
    return _lacking(database, named, run, query.relation)


def never_observed(database: Database) -> list[Unobserved]:
    """Return the concerns of which not all runs observe anything, by name. Raises: as `Database.rows`."""
    return [one for one in _lacking(database) if not one.concern.endswith(IN_PART)]


def _lacking(database: Database, named: str = "", run: str | None = None, judge: str | None = None) -> list[Unobserved]:
    """Return what not all runs (or not this one) observe, of the types that this condition takes."""
    rows = database.rows(
        f"""
        WITH needed AS (
            SELECT concern, split_part(type, '.', 1) AS kind, count(*) OVER (PARTITION BY concern) AS kinds
            FROM event_concerns {named}
        ),

        lacking AS (
            SELECT
                started.run_id, needed.concern,
                started.records IS NULL
                OR count(*) OVER (PARTITION BY started.run_id, needed.concern) = needed.kinds AS is_whole
            FROM run_started AS started
            INNER JOIN needed
                ON
                    NOT list_contains(coalesce(started.observes, []), needed.concern)
                    AND NOT list_contains(coalesce(started.records, []), needed.kind)
        ),

        judged AS (
            SELECT run_id, unnest(string_split(not_observed, ', ')) AS name
            FROM unobservable
            WHERE judge = $judge
        ),

        named AS (
            SELECT run_id, if(is_whole, concern, concern || '{IN_PART}') AS name
            FROM lacking
            WHERE NOT EXISTS (FROM judged_concerns WHERE judge = $judge)
            UNION
            SELECT run_id, name
            FROM judged
        )

        SELECT
            name AS concern, count(*) AS runs,
            (SELECT count(*) FROM runs WHERE $run IS NULL OR run_id = $run) AS of_runs
        FROM named
        WHERE $run IS NULL OR run_id = $run
        GROUP BY name
        ORDER BY name
        """,
        {"run": run, "judge": judge},
    )
    return [Unobserved(**row) for row in rows]


def told(found: Iterable[Unobserved]) -> str | None:
    """Return one line for people; None if every run observes everything."""
    parts = shown(found)
    return f"not observed, so that the answer says nothing about it: {parts}" if parts else None


def shown(found: Iterable[Unobserved]) -> str:
    """Return the concerns, and how many runs do not observe each."""
    return ", ".join(f"{one.concern} ({one.runs:,} of {one.of_runs:,} runs)" for one in found)
