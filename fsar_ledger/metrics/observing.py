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


class Unobserved(msgspec.Struct, frozen=True):
    """A concern that some runs do not observe, and how many of how many."""

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
    """Return the concerns that the query rests on and that not all runs observe (or this one does not), by name.

    A judge rests on what `judged_concerns` says, any other query on the concerns of the events that it reads. Raises:
    as `Database.rows`.
    """
    types = types_read(database.library, query)
    named = "" if types is None else f"WHERE type IN ({listed(sorted(types)) or 'NULL'})"
    needed = f"""
        SELECT concern FROM judged_concerns WHERE judge = '{query.relation}'
        UNION
        SELECT concern FROM event_concerns {named}
        {"WHERE" if types is None else "AND"} NOT EXISTS (FROM judged_concerns WHERE judge = '{query.relation}')
    """
    return _lacking(database, needed, run)


def never_observed(database: Database) -> list[Unobserved]:
    """Return the concerns that not all runs observe, by name. Raises: as `Database.rows`."""
    return _lacking(database, "SELECT DISTINCT concern FROM event_concerns")


def _lacking(database: Database, needed: str, run: str | None = None) -> list[Unobserved]:
    """Return those of the needed concerns that not all runs (or not this one) observe."""
    rows = database.rows(
        f"""
        SELECT
            needed.concern,
            count(*) FILTER (NOT list_contains(coalesce(runs.observes, []), needed.concern)) AS runs,
            count(*) AS of_runs
        FROM ({needed}) AS needed
        CROSS JOIN runs
        WHERE $run IS NULL OR runs.run_id = $run
        GROUP BY needed.concern
        ORDER BY needed.concern
        """,
        {"run": run},
    )
    return [Unobserved(**row) for row in rows if row["runs"]]


def told(found: Iterable[Unobserved]) -> str | None:
    """Return one line for people; None if every run observes everything."""
    parts = shown(found)
    return f"not observed, so that the answer says nothing about it: {parts}" if parts else None


def shown(found: Iterable[Unobserved]) -> str:
    """Return the concerns, and how many runs do not observe each."""
    return ", ".join(f"{one.concern} ({one.runs:,} of {one.of_runs:,} runs)" for one in found)
