"""Look up the runs and robots that a question names, as the ledger names them."""

from typing import TYPE_CHECKING, Any

from .names import microseconds, robot_named, run_named

if TYPE_CHECKING:
    from fsar_ledger.metrics.database import Database

ROBOTS = """
    SELECT DISTINCT name
    FROM (
        SELECT robot AS name FROM robot_joined WHERE $run IS NULL OR run_id = $run
        UNION ALL
        SELECT unnest([decided_by, requested_by, executed_by]) AS name FROM events WHERE $run IS NULL OR run_id = $run
    )
    WHERE starts_with(name, 'robot/')
    ORDER BY name
"""
_RUNS = "SELECT DISTINCT run_id FROM events ORDER BY run_id"
_ALL = ("all", "any")
_ROBOT_PARAMETERS = ("robot", "peer")


def run_of(database: "Database", asked: str) -> str:
    """Return the full name of a run. Raises: UsageError if no run, or several, match."""
    return run_named(asked, [row["run_id"] for row in database.rows(_RUNS)])


def robot_of(database: "Database", asked: str, run: str | None) -> str:
    """Return the full name of a robot of this run, or of any. Raises: UsageError if none matches."""
    return robot_named(asked, [row["name"] for row in database.rows(ROBOTS, {"run": run})])


def parameters_of(database: "Database", known: Any, given: dict[str, object]) -> dict[str, str]:
    """Return the parameters of a query as text, with full names of runs and robots, and times in microseconds.

    Raises: UsageError for an unknown name.
    """
    found = {name: str(value) for name, value in given.items()}
    if "at" in given and "at_us" in known and "at_us" not in given:
        at = given["at"]
        found["at_us"] = str(microseconds("at", at if isinstance(at, int | float) else -1))
        del found["at"]
    if found.get("run", "all") not in _ALL and "run" in known:
        found["run"] = run_of(database, found["run"])
    run = found.get("run")
    for name in _ROBOT_PARAMETERS:
        if name in known and found.get(name, "all") not in _ALL:
            found[name] = robot_of(database, found[name], None if run in _ALL else run)
    return found
