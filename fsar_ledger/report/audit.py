"""The audit report: what one ledger records, whatever system made it, judged by its own rules.

The answers of the packaged queries become relations, from which the sections of `reports/audit/` select. A number for
runs that do not observe what it rests on is missing, never 0.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import pyarrow as pa

from fsar_ledger.designs.registered import PAPER_SCENARIOS, PAPER_WORKFLOWS
from fsar_ledger.events.configuration import PAPER_ARCHITECTURES
from fsar_ledger.ledger.log.note import signers_of
from fsar_ledger.ledger.opening import open_for_answers
from fsar_ledger.ledger.store.read import View
from fsar_ledger.ledger.store.shards import log_of
from fsar_ledger.metrics.database import connect_view
from fsar_ledger.metrics.invariants import AuditRow, audit_rows, invariants
from fsar_ledger.metrics.provenance import Unobserved, never_observed
from fsar_ledger.report import printing, specs
from fsar_ledger.report.findings import Head, Source, arrow, ledger_head, sources_of
from fsar_ledger.report.layout import Layout, for_programs, head_for_programs, versions

MAX_NAME = 60  # characters of the name of a ledger
MAX_OFFENCES = 5
"""Events in the annex for each broken invariant, architecture and configuration."""
MAX_GROUPS = 8
"""Architectures and configurations with events in the annex for an invariant."""

# Grain: one row per run. Units: last_us microseconds of run time. NULL: fleet where nothing on record names it.
RUNS = """
    WITH named AS (
        SELECT parameter_set, any_value(trim(value, '"')) AS fleet
        FROM constants
        WHERE name = 'fleet.name'
        GROUP BY parameter_set
    ), sizes AS (
        SELECT run_id, count(*) AS events, max(time_us) AS last_us FROM events GROUP BY run_id
    )
    SELECT
        runs.number, runs.run_id, runs.kind, runs.source, runs.architecture, runs.configuration, runs.scenario,
        runs.fleet_size, settings.kind AS made_as, sizes.events, sizes.last_us,
        list_contains(coalesce(runs.observes, []), 'request')
        OR list_contains(coalesce(started.records, []), 'RequestIssued') AS observes_requests,
        list_contains(coalesce(runs.observes, []), 'supervision')
        OR list_contains(coalesce(started.records, []), 'SupervisorCalled') AS observes_supervision,
        strftime(begun.epoch, '%Y-%m-%d %H:%M:%S UTC') AS begins,
        if(runs.kind = 'simulated', coalesce(named.fleet, 'paper'), NULL) AS fleet
    FROM runs
    INNER JOIN run_settings AS settings ON runs.run_id = settings.run_id
    INNER JOIN sizes ON runs.run_id = sizes.run_id
    INNER JOIN run_started AS started ON runs.run_id = started.run_id
    LEFT JOIN run_epochs AS begun ON runs.run_id = begun.run_id
    LEFT JOIN named ON settings.parameter_set = named.parameter_set
    ORDER BY runs.number, runs.run_id
"""
ASKED: Mapping[str, str] = {
    "requests": "audit/requests",
    "denials": "audit/denials",
    "grounds": "audit/grounds_of_denials",
    "interventions": "audit/interventions",
    "supervisor_decisions": "audit/supervisor_decisions",
    "recordings": "audit/recordings",
    "by_field": "audit/attributability_by_field",
    "by_day": "audit/events_by_day",
    "departures": "audit/churn",
}
"""The queries whose complete answers the sections select from, by the name of the relation."""
SELECTED: Mapping[str, tuple[str, str]] = {
    "runs": ("staging/runs", RUNS),
    "members": ("facts/fleet_members", "SELECT * FROM fleet_members"),
    "verdicts": (
        "facts/verdict_events",
        "SELECT * FROM verdict_events WHERE list_contains(['violation', 'conflict'], verdict)",
    ),
    "violations": ("metrics/policy_violations", "SELECT run_id, numerator, not_observed FROM policy_violations"),
    "conflicts": ("metrics/authority_conflicts", "SELECT run_id, numerator, not_observed FROM authority_conflicts"),
}
"""The other relations that they select from: the query, and the SELECT that reads it."""
# The first offending events of an invariant, as `audit` counts them. Grain: one row per event.
OFFENCES = """
    WITH found AS (
        SELECT
            offences.run_id, offences.seq, min(offences.type) AS type, min(offences.action_id) AS action_id,
            string_agg(DISTINCT offences.found, '; ' ORDER BY offences.found) AS found
        FROM {relation} AS offences
        LEFT JOIN unobservable AS hidden ON offences.run_id = hidden.run_id AND hidden.judge = '{relation}'
        WHERE NOT coalesce(hidden.hides_offences, FALSE)
        GROUP BY offences.run_id, offences.seq
    )
    SELECT '{relation}' AS invariant, runs.architecture, runs.configuration, runs.number, found.*
    FROM found INNER JOIN runs ON found.run_id = runs.run_id
    QUALIFY
        row_number() OVER (PARTITION BY runs.architecture, runs.configuration ORDER BY runs.number, found.seq) <= {most}
        AND dense_rank() OVER (ORDER BY runs.architecture, runs.configuration) <= {groups}
    ORDER BY runs.number, found.seq
"""
OFFENCES_SCHEMA = pa.schema(
    [
        *((name, pa.string()) for name in ("invariant", "architecture", "configuration")),
        ("number", pa.int64()),
        ("run_id", pa.string()),
        ("seq", pa.int64()),
        *((name, pa.string()) for name in ("type", "action_id", "found")),
    ]
)
PAPER_SQL = """
    SELECT
        count(*) FILTER (list_contains($scenarios, runs.scenario)) > 0
        AND bool_and(
            runs.kind = 'simulated' AND coalesce(list_contains($names, runs.scenario), FALSE)
            AND coalesce(list_contains($architectures, runs.architecture), FALSE)
            AND settings.parameter_set IS DISTINCT FROM own.parameter_set
        ) AS is_paper
    FROM runs
    INNER JOIN run_settings AS settings ON runs.run_id = settings.run_id
    LEFT JOIN (
        SELECT DISTINCT parameter_set FROM constants WHERE list_contains(['fleet.name', 'scenario.name'], name)
    ) AS own ON settings.parameter_set = own.parameter_set
"""


class AuditFindings(msgspec.Struct, frozen=True):
    """The content of the audit report: name and head of the ledger, the answers by name, and their queries."""

    name: str
    head: Head
    relations: Mapping[str, pa.Table]
    sources: tuple[Source, ...]


def kind_of(ledger: Path, demanded: str | None = None) -> specs.Kind:
    """Return the report that suits the ledger: the paper's if it has only runs of the paper's experiment, at least one.

    Runs of the paper's workflows may be among them. Raises: as `connect_view`.
    """
    with connect_view(open_for_answers(ledger), demanded=demanded) as database:
        scenarios = list(PAPER_SCENARIOS)
        [row] = database.rows(
            PAPER_SQL,
            {
                "scenarios": scenarios,
                "names": [*scenarios, *PAPER_WORKFLOWS],
                "architectures": list(PAPER_ARCHITECTURES),
            },
        )
    return "paper" if row["is_paper"] else "audit"


def gather_audit(ledger: Path, demanded: str | None = None) -> AuditFindings:
    """Return the answers of the queries about all runs of the ledger's current head. Raises: as `connect_view`."""
    view = open_for_answers(ledger)
    with connect_view(view, demanded=demanded) as database:
        relations = {name: database.table(sql) for name, (_, sql) in SELECTED.items()}
        relations |= {name: database.query(query) for name, query in ASKED.items()}
        queries = invariants()
        judged = audit_rows(database.slices or database, queries) if relations["runs"].num_rows else []
        broken = [
            query for query in queries if any(row.invariant == query.relation and row.holds is False for row in judged)
        ]
        offences = [
            database.table(OFFENCES.format(relation=query.relation, most=MAX_OFFENCES, groups=MAX_GROUPS))
            for query in broken
        ]
        relations |= {
            "invariants": arrow(judged, AuditRow),
            "not_observed": arrow(never_observed(database), Unobserved),
            "offences": pa.concat_tables([OFFENCES_SCHEMA.empty_table(), *offences]),
            "whole": _ledger_head(view),
            "versions": pa.Table.from_pylist(
                [{"name": name, "version": number} for name, number in versions().items()]
            ),
        }
        used = [*ASKED.values(), *(query for query, _ in SELECTED.values()), *(query.name for query in queries)]
        name, head = printing.words(ledger.absolute().name, MAX_NAME), ledger_head(database, None)
        return AuditFindings(name, head, relations, sources_of(database, used))


def _ledger_head(view: View) -> pa.Table:
    """Return the head in one row: origin, size, root, the signers named in the newest note, and the signed commits.

    No key is given, so no signature is checked. NULL: signers of an unsigned ledger.
    """
    origin = view.manifest.origin
    notes = [commit.note(origin) for commit in log_of(view).commits]
    row: dict[str, Any] = {
        "origin": origin,
        "commits": len(notes),
        "events": view.head.events,
        "root": view.head.root,
        "signers": signers_of(notes[-1]) if notes else None,
        "signed": sum(bool(note.signatures) for note in notes),
    }
    schema = pa.schema([(name, pa.int64() if isinstance(value, int) else pa.string()) for name, value in row.items()])
    return pa.Table.from_pylist([row], schema)


class AuditDocument(Layout):
    """The audit report, laid out for the template."""

    def __init__(self, findings: AuditFindings) -> None:
        self.findings = findings
        super().__init__(findings.relations, specs.relations("audit_relations.toml"), specs.sections("audit"), {})

    def encoded(self) -> bytes:
        """Return the template's input, as JSON with sorted names."""
        titles = specs.titles()["audit"]
        filled = {name: getattr(titles, name).format(ledger=self.findings.name) for name in ("title", "heading")}
        return self.template_data(msgspec.structs.replace(titles, **filled), self.findings.head)

    def reproduction(self) -> bytes:
        """Return the same as JSON for programs: the head, every table with its values, and the digests of the queries.

        Values are in the units of the queries; null: not on record, or not observed.
        """
        tables = {
            part["name"]: [dict(zip(part["keys"], (cell.value for cell in row), strict=True)) for row in part["rows"]]
            for section in self.sections
            for part in section["parts"]
            if part["shape"] == "table"
        }
        content = {
            "ledger": head_for_programs(self.findings.head),
            "invariants": self.findings.relations["invariants"].to_pylist(),
            "tables": tables,
        }
        return for_programs(content, self.findings.sources)
