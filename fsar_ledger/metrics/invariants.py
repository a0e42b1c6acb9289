"""Check the invariants: what each query of `queries/invariants/` finds, by architecture and configuration.

Also the single verdicts on a run, of invariants and of metrics, each with the events behind it.
"""

from collections.abc import Sequence

import msgspec
import pyarrow as pa

from fsar_ledger.base import printable
from fsar_ledger.base.errors import UnknownQuery, UsageError, option
from fsar_ledger.base.progress import Progress

from .database import Database, Slices, Value, from_rows
from .library import Query, library
from .results import typed
from .slices import slice_query


class AuditRow(msgspec.Struct, frozen=True):
    """One invariant over the runs of one architecture and configuration.

    It holds if no event violates it, every run observes what it rests on, and there was a case; `not_observed` names
    what `runs_not_observed` of the runs do not observe. A violation counts despite gaps if what is observed proves it.
    `holds` is None without a violation if something is not observed or there was no case. `cases` counts the cases
    checked. `events` counts distinct events; `first_*` is the first of them by run and seq, None if there is none or
    nothing could be judged.
    """

    invariant: str
    architecture: str | None
    configuration: str | None
    runs: int
    holds: bool | None
    cases: int | None
    runs_not_observed: int
    not_observed: str | None
    events: int | None
    first_run: str | None
    first_seq: int | None
    first_type: str | None
    first_found: str | None

    @property
    def is_empty(self) -> bool:
        """Return whether everything was observed, but no case of the invariant occurred."""
        return self.holds is None and not self.runs_not_observed


def all_shown(rows: Sequence[AuditRow]) -> bool:
    """Return whether some architecture shows each invariant to hold, and none is broken or not observable."""
    upheld = {row.invariant for row in rows if row.holds}
    return all(row.holds or (row.is_empty and row.invariant in upheld) for row in rows)


def invariants() -> list[Query]:
    """Return the queries of the invariants, I1 to I5 before A1 to A5."""
    queries = [query for query in library().queries.values() if query.name.startswith("invariants/")]
    return sorted(queries, key=lambda query: (query.relation[0] != "i", query.relation))


def chosen(names: Sequence[str]) -> list[Query]:
    """Return the invariants of these names (`i4` or the whole name), each once and in order; all for no names.

    Raises:
        UnknownQuery: There is no such invariant; the message suggests the nearest.
    """
    queries = invariants()
    named = {
        alias: query for query in queries for alias in (query.relation, query.relation.partition("_")[0], query.name)
    }
    for name in names:
        if name.lower() not in named:
            hint = (
                printable.did_you_mean(name.lower(), named)
                or f"; expected one of {', '.join(query.relation for query in queries)}"
            )
            raise UnknownQuery(f"invariant {name}: there is no invariant of that name{hint}")
    chosen_names = {named[name.lower()].relation for name in names}
    return [query for query in queries if not chosen_names or query.relation in chosen_names]


def audit_rows(
    judged: Database | Slices,
    queries: Sequence[Query],
    architectures: Sequence[str] = (),
    progress: Progress | None = None,
) -> list[AuditRow]:
    """Return what these invariants find: a row for each, per architecture (default: all) and configuration with runs.

    `progress` is called with the number of judgements done, and the total.

    Raises:
        UsageError: There is no run to check.
        QueryFailed, LedgerCorrupted: As `Database.table`.
    """
    selects = {query.relation: _counted(query) for query in queries}
    if isinstance(judged, Slices):
        counted = list(judged.tables({name: slice_query(sql) for name, sql in selects.items()}, progress))
    else:
        counted = []
        for sql in selects.values():
            counted.append(judged.table(sql))
            if progress is not None:
                progress(len(counted), len(queries))
    with from_rows([]) as database:
        database.hold("counted", pa.concat_tables(counted))
        rows = database.rows(_JUDGED, {"invariants": list(selects), "architectures": list(architectures)})
    if not rows:
        raise UsageError(
            f"audit: found no runs of {' or '.join(architectures) or 'any architecture'}; `fsar-ledger info` shows "
            "what a ledger holds"
        )
    return typed(rows, AuditRow)


def _counted(query: Query) -> str:
    """Return the SQL that counts and samples the rows of one invariant; runs that cannot be judged have none."""
    return f"""
        WITH found AS MATERIALIZED (
            SELECT run_id, seq, type, found
            FROM {query.relation}
        ),

        numbered AS (
            SELECT run_id, count(DISTINCT seq) AS events, min(seq) AS first_seq
            FROM found
            GROUP BY run_id
        ),

        offences AS (
            SELECT
                numbered.run_id, numbered.events,
                {{
                    'seq': numbered.first_seq, 'type': min(found.type),
                    'found': string_agg(found.found, '; ' ORDER BY found.found)
                }} AS first
            FROM numbered
            INNER JOIN found ON numbered.run_id = found.run_id AND numbered.first_seq = found.seq
            GROUP BY numbered.run_id, numbered.events, numbered.first_seq
        ),

        judged AS (
            SELECT
                runs.run_id, runs.architecture, runs.configuration, hidden.not_observed,
                CASE WHEN NOT coalesce(hidden.hides_offences, FALSE) THEN offences.events END AS events,
                offences.first,
                CASE WHEN NOT coalesce(hidden.hides_offences, FALSE) THEN coalesce(looked.cases, 0) END AS cases
            FROM runs
            LEFT JOIN offences ON runs.run_id = offences.run_id
            LEFT JOIN invariant_cases AS looked ON runs.run_id = looked.run_id AND looked.invariant = '{query.relation}'
            LEFT JOIN unobservable AS hidden ON runs.run_id = hidden.run_id AND hidden.judge = '{query.relation}'
        )

        SELECT
            '{query.relation}' AS invariant,
            architecture,
            configuration,
            count(*) AS runs,
            sum(cases)::BIGINT AS cases,
            count(not_observed) AS runs_not_observed,
            list(DISTINCT not_observed) FILTER (not_observed IS NOT NULL) AS not_observed,
            sum(events)::BIGINT AS events,
            min(run_id) FILTER (events > 0) AS first_run,
            arg_min(first, run_id) FILTER (events > 0) AS first
        FROM judged
        GROUP BY architecture, configuration
    """


# See docs/decisions/audit-fails-without-a-verdict.md.
# See docs/decisions/breaches-count-despite-gaps.md.
_JUDGED = """
    WITH summed AS (
        SELECT
            invariant,
            architecture,
            configuration,
            sum(runs)::BIGINT AS runs,
            sum(cases)::BIGINT AS cases,
            sum(runs_not_observed)::BIGINT AS runs_not_observed,
            array_to_string(list_sort(list_distinct(flatten(list(not_observed)))), '; ') AS not_observed,
            sum(events)::BIGINT AS events,
            min(first_run) AS first_run,
            arg_min(first, first_run) AS first
        FROM counted
        WHERE len($architectures) = 0 OR list_contains($architectures, architecture)
        GROUP BY invariant, architecture, configuration
    )

    SELECT
        invariant, architecture, configuration, runs,
        CASE WHEN events > 0 THEN FALSE WHEN runs_not_observed = 0 AND cases > 0 THEN TRUE END AS holds,
        CASE WHEN events > 0 OR runs_not_observed < runs THEN cases END AS cases,
        runs_not_observed,
        nullif(not_observed, '') AS not_observed,
        CASE WHEN events > 0 OR runs_not_observed < runs THEN coalesce(events, 0) END AS events,
        first_run, first.seq AS first_seq, first.type AS first_type, first.found AS first_found
    FROM summed
    ORDER BY
        list_position($invariants, invariant), list_position(['fsar', 'cfc', 'dhma'], architecture), architecture,
        configuration <> 'full', configuration
"""


JUDGES = {
    "violation": "policy_violations",
    "conflict": "authority_conflicts",
    "late": "coordination_success",
    "unattributed": "audit_attributability",
}
"""The metric that counts each kind of verdict."""

_OF_METRICS = """
    SELECT seq, time_us / 1e6 AS time_s, action_id, about, found, made_by
    FROM verdict_events
    WHERE
        run_id = $run AND verdict = $kind
        AND NOT EXISTS (FROM unobservable AS hidden WHERE hidden.run_id = $run AND hidden.judge = $judge)
    ORDER BY seq, action_id, about
"""
_OF_INVARIANT = """
    SELECT seq, time_us / 1e6 AS time_s, action_id, type AS about, found, [seq] AS made_by
    FROM {relation}
    WHERE
        run_id = $run
        AND NOT EXISTS (
            FROM unobservable AS hidden WHERE hidden.run_id = $run AND hidden.judge = $judge AND hidden.hides_offences
        )
    ORDER BY seq
"""


def verdict_kinds() -> dict[str, str]:
    """Return the kinds of verdicts, each with the metric or invariant that gives it."""
    return JUDGES | {query.relation.partition("_")[0]: query.relation for query in invariants()}


def verdict_rows(database: Database, run: str, kind: str) -> tuple[pa.Table, Query]:
    """Return the verdicts of this kind on a run, with the events behind each, and the query that gives them.

    There are none where the run does not observe what they rest on, like those of the metric or invariant.

    Raises:
        UsageError: There is no such kind.
    """
    judges = verdict_kinds()
    if kind not in judges:
        hint = printable.did_you_mean(kind, judges) or ";"
        raise UsageError(
            f"{option('verdict', printable.value(kind))}: there is no such kind of verdict{hint} expected one of "
            f"{', '.join(judges)}"
        )
    judge = database.library.find(judges[kind])
    named: dict[str, Value] = {"run": run, "judge": judge.relation}
    if kind in JUDGES:
        return database.table(_OF_METRICS, {**named, "kind": kind}), judge
    return database.table(_OF_INVARIANT.format(relation=judge.relation), named), judge
