"""The ten invariants, checked: what each of `queries/invariants/` finds, by architecture and configuration."""

from collections.abc import Sequence
from difflib import get_close_matches

import msgspec

from fsar_ledger.errors import UnknownQuery, UsageError

from .database import Database
from .library import Query, library
from .results import typed


class AuditRow(msgspec.Struct, frozen=True):
    """One invariant over the runs of one architecture and configuration; it holds if no event offends.

    `events` are distinct events, `first_*` the first of them by run and seq. None: there is none.
    """

    invariant: str
    architecture: str
    configuration: str
    runs: int
    events: int
    first_run: str | None
    first_seq: int | None
    first_type: str | None
    first_found: str | None


def invariants() -> list[Query]:
    """The queries of the invariants, I1 to I5 before A1 to A5."""
    found = [query for query in library().queries.values() if query.name.startswith("invariants/")]
    return sorted(found, key=lambda query: (query.relation[0] != "i", query.relation))


def chosen(names: Sequence[str]) -> list[Query]:
    """The invariants of these names, each once and in order: `i4` or its whole name; all for no names.

    Raises:
        UnknownQuery: there is no such invariant; the message suggests the nearest.
    """
    every = invariants()
    known = {alias: query for query in every for alias in (query.relation, query.relation.partition("_")[0], query.name)}
    for name in names:
        if name.lower() not in known:
            near = get_close_matches(name.lower(), known, 1, 0.5)
            hint = f"did you mean {near[0]}?" if near else f"expected one of {', '.join(query.relation for query in every)}"
            raise UnknownQuery(f"invariant {name}: there is no invariant of that name; {hint}")
    asked = {known[name.lower()].relation for name in names}
    return [query for query in every if not asked or query.relation in asked]


def audit_rows(database: Database, queries: Sequence[Query], architectures: Sequence[str] = ()) -> list[AuditRow]:
    """What these invariants find, one row for each and each architecture (all: none named) and configuration with runs.

    Raises:
        UsageError: there is no run to check, so that nothing could be said to hold.
        QueryFailed, LedgerCorrupted: as `Database.table`.
    """
    wanted = list(architectures) or [row["architecture"] for row in database.rows("SELECT DISTINCT architecture FROM runs")]
    rows = [row for query in queries for row in database.rows(_counts(query), {"architectures": wanted})]
    if not rows:
        raise UsageError(f"audit: found no runs of {' or '.join(architectures) or 'any architecture'}; `fsar-ledger info` shows what a ledger holds")
    return typed(rows, AuditRow)


def _counts(query: Query) -> str:
    """The SQL that counts and samples the rows of one invariant."""
    return f"""
        WITH found AS (
            SELECT run_id, seq, min(type) AS type, string_agg(found, '; ' ORDER BY found) AS found
            FROM {query.relation}
            GROUP BY run_id, seq
        )

        SELECT
            '{query.relation}' AS invariant,
            architecture,
            configuration,
            count(DISTINCT runs.run_id) AS runs,
            count(seq) AS events,
            arg_min(found.run_id, (found.run_id, seq)) FILTER (seq IS NOT NULL) AS first_run,
            arg_min(seq, (found.run_id, seq)) FILTER (seq IS NOT NULL) AS first_seq,
            arg_min(type, (found.run_id, seq)) FILTER (seq IS NOT NULL) AS first_type,
            arg_min(found, (found.run_id, seq)) FILTER (seq IS NOT NULL) AS first_found
        FROM runs
        LEFT JOIN found ON runs.run_id = found.run_id
        WHERE list_contains($architectures, architecture)
        GROUP BY architecture, configuration
        ORDER BY list_position(['fsar', 'cfc', 'dhma'], architecture), configuration <> 'full', configuration
    """
