"""The provenance of an answer: the head that it is about, and what it leaves open.

Numbers rest on runs that were planned and may be missing; an empty answer about events that runs do not observe means
nothing. Every answer reports both.
"""

import re
from collections.abc import Iterable
from typing import Any

import msgspec

from fsar_ledger.base.printable import counted
from fsar_ledger.ledger.store.record import Head

from .database import Database
from .library import Library, Query
from .sql_values import listed

EXPERIMENTS = "SELECT * FROM experiments ORDER BY planned_count DESC, plan"
MISSING = "SELECT missing_count FROM missing_runs"
MAX_COMBINATIONS = 10_000
"""Maximum combinations of architecture, configuration and scenario in a plan that `missing_runs` reads."""

UNPLANNED = "SELECT count(*) AS runs FROM unplanned_runs"


class Completeness(msgspec.Struct, frozen=True):
    """The runs of a ledger compared with its plans: `unfinished` plans lack some, and no larger plan covers them.

    `unplanned` counts runs that no plan names.
    """

    plans: int
    unfinished: tuple[dict[str, Any], ...]
    unplanned: int
    missing: int | None
    """The number of missing runs of these plans, each counted once, however many plans name it.

    None if plans name too many to count.
    """

    def warning(self) -> str | None:
        """Return what is missing according to the plans; None if nothing is."""
        if not self.unfinished:
            return None
        first, *others = self.unfinished
        more = f"; {len(others):,} more plans lack runs" if others else ""
        return (
            f"not complete: {first['missing_count']:,} of the {first['planned_count']:,} runs of a plan are "
            f"missing{more}"
        )

    def answer(self) -> dict[str, object]:
        """Return the same for JSON answers: `complete` is None without a plan, or if some runs are in none.

        `missing_count` counts each run once.
        """
        complete = None if not self.plans or self.unplanned else True
        return {"complete": False if self.unfinished else complete, "missing_count": self.missing}

    def sentence(self) -> str:
        """Return the result in one sentence, also if nothing is missing."""
        if not self.plans:
            return "no plan is on record, so nothing shows whether any runs are missing"
        text = self.warning() or "all planned runs are there"
        return f"{text}; {self.unplanned:,} runs are in no plan" if self.unplanned else text


def completeness(database: Database) -> Completeness:
    """Compare the runs of this ledger with its plans. Raises: as `Database.rows`."""
    rows = database.rows(EXPERIMENTS)
    [counted] = database.rows(UNPLANNED)
    unfinished = tuple(row for row in rows if row["missing_count"] and not row["larger_plans"])
    return Completeness(len(rows), unfinished, counted["runs"], _missing(database, unfinished))


def _missing(database: Database, unfinished: tuple[dict[str, Any], ...]) -> int | None:
    lacking: list[int] = [plan["missing_count"] for plan in unfinished]
    if len(unfinished) < 2:
        return sum(lacking)
    if any(
        len(plan["architectures"]) * len(plan["configurations"]) * len(plan["scenarios"]) > MAX_COMBINATIONS
        for plan in unfinished
    ):
        return None
    lacking = [row["missing_count"] for row in database.rows(MISSING)]
    return sum(lacking)


_TYPE = re.compile(r"'([A-Z][A-Za-z]+\.v\d+)'")
_NOT_READ = re.compile(r"--[^\n]*|\btype NOT IN \([^)]*\)")
_WIDE = frozenset({"events", "event_principals"})
"""Relations that hold events of every type."""
_TIES = frozenset({"action_events", "event_principals", "keyed_events", "naming_events"})
"""Relations that read all events only to group them; a query that uses them also names the types it is about."""
_OF_ANY_TYPE = _TIES | {"evidence_of_principals", "revocations"}
"""Queries that read events of every type, although they also name some."""
_EXCUSES = frozenset({"unobservable", "actions_under_way"})
"""Relations of what is not judged: without the events that they read, nothing more is reported as wrong."""


IN_PART = " in part"
"""Suffix of the name of a concern of which a run records some types and not others."""


class Unobserved(msgspec.Struct, frozen=True):
    """A concern, or a part of it, that `runs` of `of_runs` runs do not observe."""

    concern: str
    runs: int
    of_runs: int


def types_read(library: Library, query: Query) -> frozenset[str] | None:
    """Return the event types that the query reads; None if it reads events of every type."""
    types: set[str] = set()
    for needed in (*library.needs(query.sources() - {query.relation}, held=_EXCUSES), query):
        tags = _TYPE.findall(_NOT_READ.sub("", needed.sql))
        reads_all = not tags and _WIDE >= needed.sources() & {"events", *library.relations} > set()
        if (reads_all or needed.relation in _OF_ANY_TYPE) and (needed is query or needed.relation not in _TIES):
            return None
        types.update(tags)
    return frozenset(types)


# See docs/decisions/unobserved-is-null.md.
def unobserved(database: Database, query: Query, run: str | None = None) -> list[Unobserved]:
    """Return what the query rests on that not all runs observe (or this one does not), by name.

    A judge rests on what `unobservable` lists, any other query on the concerns of the events that it reads; for a run
    that records some types of a concern, on the others. Raises: as `Database.rows`.
    """
    types = types_read(database.library, query)
    condition = "" if types is None else f"WHERE type IN ({listed(sorted(types)) or 'NULL'})"
    return _lacking(database, condition, run, query.relation if is_judge(database.library, query.relation) else None)


def is_judge(library: Library, relation: str) -> bool:
    """Return whether the relation may be a judge: whether the lists of judges name it.

    For others there is no need to make `unobservable`, which takes as long as a small answer.
    """
    listed_in = (library.relations.get(name) for name in ("judged_concerns", "metric_concerns"))
    return any(f"'{relation}'" in query.sql for query in listed_in if query is not None)


def never_observed(database: Database) -> list[Unobserved]:
    """Return the concerns of which some runs observe nothing, by name. Raises: as `Database.rows`."""
    return [concern for concern in _lacking(database) if not concern.concern.endswith(IN_PART)]


def _lacking(database: Database, named: str = "", run: str | None = None, judge: str | None = None) -> list[Unobserved]:
    """Return what not all runs (or not this one) observe, of the types that the condition takes or the judge needs."""
    lacking = f"SELECT DISTINCT run_id, if(is_whole, concern, concern || '{IN_PART}') AS name FROM lacking"
    judged = """
        SELECT run_id, unnest(string_split(not_observed, ', ')) AS name FROM unobservable WHERE judge = $judge
        """
    no_judge = "WHERE NOT EXISTS (FROM judged_concerns WHERE judge = $judge)"
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

        named AS (
            {lacking if judge is None else f"{lacking} {no_judge} UNION {judged}"}
        )

        SELECT
            name AS concern, count(*) AS runs,
            (SELECT count(*) FROM runs WHERE $run IS NULL OR run_id = $run) AS of_runs
        FROM named
        WHERE $run IS NULL OR run_id = $run
        GROUP BY name
        ORDER BY name
        """,
        {"run": run} if judge is None else {"run": run, "judge": judge},
    )
    return [Unobserved(**row) for row in rows]


def unobserved_line(found: Iterable[Unobserved]) -> str | None:
    """Return one line for display; None if every run observes everything."""
    parts = unobserved_text(found)
    return f"not observed, so the answer says nothing about it: {parts}" if parts else None


def unobserved_text(found: Iterable[Unobserved]) -> str:
    """Return the concerns, with how many runs do not observe each, as text."""
    return ", ".join(f"{concern.concern} ({concern.runs:,} of {concern.of_runs:,} runs)" for concern in found)


class OpenWork(msgspec.Struct, frozen=True):
    """The open work of live runs where their record ends, which metrics count as not done."""

    tasks: int
    failures: int

    def warning(self) -> str:
        """Return it in one line."""
        parts = [counted(self.tasks, "task"), counted(self.failures, "failure")]
        return f"still open where the record ends, and counted as not done: {' and '.join(parts)}"


class Provenance(msgspec.Struct, frozen=True):
    """The head that an answer is about, and whether the rows that it was read from were compared with its root.

    `plans` compares runs with plans; None where the answer does not depend on that. `not_observed` names the concerns
    that runs do not observe, and about which the answer means nothing there; `open_work` is what a judgement of
    outcomes counts as not done, or None if nothing is open; `actions_under_way` is the number of actions whose requests
    an audit does not judge, since their record began later.
    """

    head: Head | None = None
    rows_verified: bool | None = None
    plans: Completeness | None = None
    not_observed: tuple[Unobserved, ...] = ()
    open_work: OpenWork | None = None
    actions_under_way: int = 0

    def answer(self) -> dict[str, object]:
        """Return the fields of JSON answers besides the head."""
        missing: dict[str, object] = {"not_observed": self.not_observed} if self.not_observed else {}
        missing |= {"open_work": self.open_work} if self.open_work else {}
        missing |= {"actions_under_way": self.actions_under_way} if self.actions_under_way else {}
        return missing if self.plans is None else {**self.plans.answer(), **missing}


def of_run(provenance: Provenance, lacking: Iterable[str]) -> Provenance:
    """Return the provenance of an answer about all of one run, which does not observe these concerns."""
    return msgspec.structs.replace(provenance, not_observed=tuple(Unobserved(concern, 1, 1) for concern in lacking))


def of_rows(database: Database, query: Query | str | None = None, run: str | None = None) -> Provenance:
    """Return the provenance of the rows of a query, for one run or for all."""
    found_query = database.library.find(query) if isinstance(query, str) else query
    missing = () if found_query is None else tuple(unobserved(database, found_query, run))
    return Provenance(database.head, database.rows_verified, None, missing)


def of_judgement(database: Database) -> Provenance:
    """Return the provenance of an answer that judges all planned runs."""
    return Provenance(database.head, database.rows_verified, completeness(database))


def _has_runs(database: Database, kind: str) -> bool:
    """Return whether there are runs of this kind; without any, nothing about them has to be computed."""
    return bool(database.rows("SELECT 1 AS found FROM runs WHERE kind = $kind LIMIT 1", {"kind": kind}))


def of_audit(database: Database) -> Provenance:
    """Return the provenance of an answer that judges who requested, allowed and did what in all planned runs."""
    judgement = of_judgement(database)
    if not _has_runs(database, "foreign"):
        return judgement
    [row] = database.rows("SELECT count(*) AS actions FROM actions_under_way")
    return msgspec.structs.replace(judgement, actions_under_way=row["actions"])


def of_outcomes(database: Database) -> Provenance:
    """Return the provenance of an answer that judges how tasks and failures ended in all planned runs."""
    judgement = of_judgement(database)
    if not _has_runs(database, "live"):
        return judgement
    [row] = database.rows(
        "SELECT coalesce(sum(open_tasks), 0)::BIGINT AS tasks, coalesce(sum(open_failures), 0)::BIGINT AS failures "
        "FROM open_work AS work INNER JOIN runs ON work.run_id = runs.run_id WHERE runs.kind = 'live'"
    )
    return msgspec.structs.replace(judgement, open_work=OpenWork(**row)) if any(row.values()) else judgement
