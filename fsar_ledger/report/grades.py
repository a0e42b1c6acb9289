"""Lay the paper's two tables of grades beside ours: features of architectures and mechanisms of workflows.

Grades and cells come from `queries/tables/`.
"""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

from fsar_ledger.base.errors import UsageError
from fsar_ledger.metrics.database import Database, connect, plain_rows
from fsar_ledger.report import specs
from fsar_ledger.report.findings import ARCHITECTURES, MAIN_CONFIGURATION, Row, Workflows

QUERIES = (
    "tables/mechanism_coverage",
    "audit/requests",
    "audit/request_timeline",
    "audit/failure_timeline",
)  # what is read from a ledger of workflows
NOT_RUN = ("RoboOS", "JADE", "ALLIANCE")  # systems of the paper's table that no ledger holds
WORKFLOWS = {
    "workflow-door-relay": "workflow_1_door_relay",
    "workflow-layered-recovery": "workflow_2_layered_recovery",
    "workflow-human-supervision": "workflow_3_human_supervision",
}
GROUPS = """
    SELECT made_alike, count(*) AS runs
    FROM run_groups
    INNER JOIN runs USING (run_id)
    WHERE list_contains($names, runs.scenario)
    GROUP BY made_alike
    ORDER BY count(*) DESC, min(run_id)
"""
FIRST = """
    SELECT scenario, min(run_id) AS run_id
    FROM runs
    INNER JOIN run_groups USING (run_id)
    WHERE made_alike = $made_alike
    GROUP BY scenario
"""
AGREES, DIFFERS = "agrees", "differs"
NOT_OBSERVABLE = "not observable"  # the cell of a mechanism that the runs do not record


# See docs/decisions/grades-go-by-conduct.md.
def graded(database: Database) -> list[Row]:
    """Return feature, architecture, grade and evidence in the order of the paper's table.

    The grade is None where the ledger shows too little.
    """
    rows = plain_rows(database.query("tables/architecture_features"))
    found = {(row["feature"], row["architecture"]): row for row in rows if row["configuration"] == MAIN_CONFIGURATION}
    return [
        {
            "feature": printed["feature"],
            "architecture": architecture,
            "grade": row["grade"],
            "evidence": row["evidence"],
        }
        for printed in specs.paper_table("architecture_features")
        for architecture in ARCHITECTURES
        if (row := found.get((printed["feature"], architecture))) is not None
    ]


def features(grades: Sequence[Row], unjudged: Collection[str] = ()) -> tuple[Row, ...]:
    """Return the table "Architectural comparison" with our grades beside the paper's. Paper: tab:baseline_context.

    Architectures in `unjudged` have no part in the verdicts.
    """
    ours = {(row["feature"], row["architecture"]): row["grade"] for row in grades}
    rows = []
    for printed in specs.paper_table("architecture_features"):
        pairs = {name: (printed[name.upper()], ours.get((printed["feature"], name))) for name in ARCHITECTURES}
        row: Row = {
            "feature": printed["feature"],
            "verdict": verdict({name.upper(): pair for name, pair in pairs.items() if name not in unjudged}),
        }
        for name, (paper, grade) in pairs.items():
            row |= {f"{name}_paper": paper, f"{name}_ours": grade}
        rows.append(row | {name.lower(): printed[name] for name in NOT_RUN})
    return tuple(rows)


def verdict(pairs: Mapping[str, tuple[str | None, str | None]]) -> str | None:
    """Say whether ours agrees with the paper, or where it differs; None if we have nothing to compare."""
    compared = {name: pair for name, pair in pairs.items() if pair[1] is not None}
    if not compared:
        return None
    differing = [name for name, (paper, ours) in compared.items() if paper != ours]
    return f"{DIFFERS}: {', '.join(differing)}" if differing else AGREES


def workflows(ledger: Path, demanded: str | None = None) -> Workflows:
    """Return what a ledger of workflows shows: mechanisms, the door relay's timeline, the recovery's timeline.

    Raises:
        UsageError: The ledger holds no run of a workflow.
        NotALedger, FormatVersionMismatch, LedgerCorrupted, SequenceConflict: As `connect`.
    """
    with connect(ledger, demanded=demanded) as database:
        groups = database.rows(GROUPS, {"names": list(WORKFLOWS)})
        if not groups:
            raise UsageError(
                f"--workflows {ledger}: found no run of {', '.join(WORKFLOWS)}; make one with `fsar-ledger simulate`"
            )
        head, main = database.head, groups[0]["made_alike"]
        runs = {row["scenario"]: row["run_id"] for row in database.rows(FIRST, {"made_alike": main})}
        return Workflows(
            commits=head.commits if head else 0,
            size=head.size if head else 0,
            root=head.root if head else "",
            run_count=sum(row["runs"] for row in database.rows("SELECT count(*) AS runs FROM runs")),
            coverage=_coverage(database, main),
            others=sum(row["runs"] for row in groups[1:]),
            timeline=_first(database, "request_timeline", runs.get("workflow-door-relay"), "RequestIssued.v1"),
            recovery=_first(database, "failure_timeline", runs.get("workflow-layered-recovery"), "ExecutionFailed.v1"),
        )


def _coverage(database: Database, main: str) -> tuple[Row, ...]:
    """Return the table "FSAR mechanisms exercised by each workflow", ours beside the paper's. Paper: tab:coverage.

    Only runs of the setting `main` count.
    """
    found = plain_rows(database.query("tables/mechanism_coverage"))
    ours = {(row["mechanism"], row["workflow"]): row["cell"] for row in found if row["made_alike"] == main}
    rows = []
    for printed in specs.paper_table("mechanism_coverage"):
        name = printed["mechanism"]
        pairs = {
            workflow: (printed[column] or None, ours.get((name, workflow))) for workflow, column in WORKFLOWS.items()
        }
        held = {workflow for _, workflow in ours}
        differing = [
            workflow
            for workflow, (paper, cell) in pairs.items()
            if workflow in held and paper != cell != NOT_OBSERVABLE
        ]
        titles = [specs.labels("workflow")[workflow] for workflow in differing]
        is_seen = any(cell != NOT_OBSERVABLE for workflow, (_, cell) in pairs.items() if workflow in held)
        row: Row = {
            "mechanism": name,
            "verdict": f"{DIFFERS}: {', '.join(titles)}" if differing else AGREES if is_seen or not held else None,
        }
        row["reasons"] = [
            reason
            for workflow in differing
            if (reason := specs.labels("difference").get(f"{workflow}/{name}/{pairs[workflow][1]}"))
        ]
        for workflow, (paper, cell) in pairs.items():
            row |= {f"{workflow}_paper": paper, f"{workflow}_ours": cell}
        rows.append(row)
    return tuple(rows)


def _first(database: Database, query: str, run: str | None, kind: str) -> tuple[Row, ...]:
    """Return the timeline of the first action of the run with an event of this type; empty if there is none."""
    if run is None:
        return ()
    found = database.rows(
        "SELECT arg_min(action_id, seq) AS action_id FROM events WHERE run_id = $run AND type = $kind",
        {"run": run, "kind": kind},
    )
    action = found[0]["action_id"]
    return () if action is None else tuple(plain_rows(database.query(f"audit/{query}", {"run": run, "action": action})))
