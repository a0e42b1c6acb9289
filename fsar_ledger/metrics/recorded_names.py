"""The names that a ledger has on record, by kind: what a parameter of a query can be."""

from fsar_ledger.events.configuration import ARCHITECTURES

from .connection import Database

RUNS = "SELECT run_id FROM run_numbers ORDER BY number"
PRINCIPALS = ("robot", "supervisor")
_ON_RECORD = {
    "robot": """
        SELECT robot AS name FROM robot_joined WHERE $run IS NULL OR run_id = $run
        UNION ALL
        SELECT unnest([decided_by, requested_by, executed_by]) AS name FROM events WHERE $run IS NULL OR run_id = $run
    """,
    "supervisor": """
        SELECT supervisor AS name FROM robot_joined WHERE $run IS NULL OR run_id = $run
        UNION ALL
        SELECT unnest([decided_by, supervised_by, supervisor]) AS name
        FROM events
        WHERE $run IS NULL OR run_id = $run
    """,
    "action": "SELECT action_id AS name FROM keyed_events WHERE $run IS NULL OR run_id = $run",
    "capability": "SELECT capability AS name FROM events",
    "context": "SELECT unnest([task_id, context]) AS name FROM events WHERE $run IS NULL OR run_id = $run",
    "reason": "SELECT reason AS name FROM refusal_reasons UNION ALL SELECT reason AS name FROM events",
    "record": "SELECT record_kind AS name FROM event_classes",
    "architecture": f"SELECT architecture AS name FROM runs UNION ALL SELECT unnest({list(ARCHITECTURES)}) AS name",
    "claim": "SELECT claim AS name FROM case_definitions",
    "case": "SELECT case_number::VARCHAR AS name FROM case_definitions",
}
"""By kind, the names that have a meaning: in this run, or wherever the kind is the same for every run.

A name that is one of them may well have no row in an answer; any other is a typing error.
"""


def names_on_record(database: Database, kind: str, run: str | None) -> list[str]:
    """Return the names that a parameter of this kind can have in this run, or in any, in order."""
    if kind == "run":
        return [str(row["run_id"]) for row in database.rows(RUNS)]
    sql = f"SELECT DISTINCT name FROM ({_ON_RECORD[kind]}) WHERE name IS NOT NULL ORDER BY name"
    names = [str(row["name"]) for row in database.rows(sql, {"run": run} if "$run" in sql else None)]
    return [name for name in names if name.startswith(f"{kind}/")] if kind in PRINCIPALS else names
