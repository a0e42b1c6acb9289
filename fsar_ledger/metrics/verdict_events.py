"""The verdicts of SQL on a run, each with the events that made it."""

import pyarrow as pa

from fsar_ledger.base import printable
from fsar_ledger.base.errors import UsageError, option

from .connection import Database
from .invariants import invariants
from .library import Query

JUDGES = {
    "violation": "policy_violations",
    "conflict": "authority_conflicts",
    "late": "coordination_success",
    "unattributed": "audit_attributability",
}
"""By kind of verdict, the metric that counts such verdicts."""

_OF_METRICS = """
    SELECT seq, time_us / 1e6 AS time_s, action_id, about, found, made_by
    FROM verdict_events
    WHERE run_id = $run AND verdict = $kind
    ORDER BY seq, action_id, about
"""
_OF_INVARIANT = """
    SELECT seq, time_us / 1e6 AS time_s, action_id, type AS about, found, [seq] AS made_by
    FROM {relation}
    WHERE run_id = $run
    ORDER BY seq
"""


def kinds() -> dict[str, str]:
    """Return the kinds of verdicts, each with the metric or invariant that judges."""
    return JUDGES | {query.relation.partition("_")[0]: query.relation for query in invariants()}


def verdict_rows(database: Database, run: str, kind: str) -> tuple[pa.Table, Query]:
    """Return the verdicts of this kind on a run, with the events that made each, and the query that judges.

    Raises:
        UsageError: There is no such kind.
    """
    judges = kinds()
    if kind not in judges:
        hint = printable.did_you_mean(kind, judges) or ";"
        raise UsageError(
            f"{option('verdict', printable.value(kind))}: there is no such kind of verdict{hint} expected one of "
            f"{', '.join(judges)}"
        )
    judge = database.library.find(judges[kind])
    if kind in JUDGES:
        return database.table(_OF_METRICS, {"run": run, "kind": kind}), judge
    return database.table(_OF_INVARIANT.format(relation=judge.relation), {"run": run}), judge
