"""Outcomes: conditions over a run, judged by SQL for many runs at once.

`policy_violations > 0` compares a metric of the run, `i3 > 0` how many events violate an invariant; a SELECT gives the
`run_id` of each run that has the outcome. A run in which a metric has no value neither has the outcome nor lacks it:
without a task, nothing succeeded and nothing failed.
"""

import re
from collections.abc import Sequence
from typing import NamedTuple

from fsar_ledger import printable
from fsar_ledger.errors import QueryFailed, UsageError
from fsar_ledger.ledger.rows.codec import LedgerRun, encode_coded
from fsar_ledger.metrics.database import from_table
from fsar_ledger.metrics.definitions import metrics
from fsar_ledger.metrics.invariants import invariants

_COMPARISON = re.compile(r"\s*([A-Za-z_0-9/]+)\s*(>=|<=|!=|<>|=|==|>|<)\s*(-?[0-9]+(?:\.[0-9]+)?)\s*")
_SELECT = re.compile(r"\s*(SELECT|WITH|FROM)\b", re.IGNORECASE)
_OPERATORS = {"==": "=", "!=": "<>"}
SECONDS, MEMORY_BYTES = 60, 1 << 32
"""The limits of a SELECT of one's own."""


class Outcome(NamedTuple):
    """A condition as it was given, and the SELECT of the runs that meet it; `is_own` if people wrote that SELECT.

    `defined` is the SELECT of the runs in which there is a value to compare; empty: in all of them.
    """

    text: str
    sql: str
    is_own: bool = False
    defined: str = ""

    def of(self, runs: Sequence[Sequence[object]]) -> list[bool | None]:
        """Return for each run, as (times, causes, events), whether it has the outcome; None where that is undefined.

        Raises:
            QueryFailed: The SELECT fails, or has no column `run_id`.
        """
        records = [
            LedgerRun(f"{number}", run[0], run[1], run[2])  # type: ignore[arg-type]
            for number, run in enumerate(runs)
        ]
        with from_table(encode_coded(records)) as database:
            if self.is_own:
                database.check_one_select(self.sql)
                database.prepare(self.sql)
                database.lock(SECONDS, MEMORY_BYTES)
            found = database.table(self.sql)
            valued = {row["run_id"] for row in database.rows(self.defined)} if self.defined else None
        if "run_id" not in found.column_names:
            named = printable.some(map(printable.value, found.column_names))
            raise QueryFailed(f"outcome: found the columns {named}, expected run_id of each run with the outcome")
        held = set(found.column("run_id").to_pylist())
        names = [one.run_id for one in records]
        return [None if valued is not None and name not in valued else name in held for name in names]


def outcome_of(text: str) -> Outcome:
    """Return the outcome that a text gives. Raises: UsageError for an unknown name or form."""
    if _SELECT.match(text):
        return Outcome(text, text, is_own=True)
    match = _COMPARISON.fullmatch(text)
    if match is None:
        raise UsageError(
            f"outcome {printable.value(text)}: expected a metric or an invariant and a number, as `policy_violations > "
            "0` or `i3 > 0`, or a SELECT of run_id"
        )
    name, operator, number = match[1], _OPERATORS.get(match[2], match[2]), match[3]
    if name in (one.name for one in metrics()):
        defined = f"SELECT run_id FROM {name} WHERE value IS NOT NULL"
        return Outcome(text, f"SELECT run_id FROM {name} WHERE value {operator} {number}", defined=defined)
    aliases = {alias: query.relation for query in invariants() for alias in (query.relation, query.relation[:2])}
    relation = aliases.get(name.lower())
    if relation is None:
        names = [one.name for one in metrics()] + sorted(aliases)
        hint = printable.did_you_mean(name, names) or ";"
        raise UsageError(
            f"outcome {printable.value(text)}: there is no metric or invariant {printable.value(name)}{hint} expected "
            f"one of {', '.join(one.name for one in metrics())}, or an invariant, i1 to i5 and a1 to a5"
        )
    counted = f"SELECT run_id, count(DISTINCT seq) AS events FROM {relation} GROUP BY run_id"
    return Outcome(
        text,
        f"SELECT runs.run_id FROM runs LEFT JOIN ({counted}) AS found ON runs.run_id = found.run_id "
        f"WHERE coalesce(found.events, 0) {operator} {number}",
    )
