"""Interventions of supervisors in whole runs: the invariants hold, and a start that ignores a rule is caught."""

from typing import Any

import pytest

from fsar_ledger.events.envelope import Robot
from fsar_ledger.events.policy import PolicyRuleSet
from fsar_ledger.events.supervision import SupervisionDensitySet
from fsar_ledger.events.trust import TrustThresholdsSet
from fsar_ledger.ledger.rows.codec import encode
from fsar_ledger.metrics.invariants import audit_rows, invariants
from fsar_ledger.runtime.architectures import HandlerTable
from fsar_ledger.runtime.architectures.fsar import FSAR
from fsar_ledger.runtime.architectures.fsar.request import EvaluateRequest, evaluate_request
from fsar_ledger.runtime.handlers.commands import StartAction
from tests import past
from tests.queries.histories import S
from tests.queries.test_mutated_handlers import unchecked_start
from tests.queries.test_rules_and_trust import DOOR, H_B
from tests.recycled import from_table
from tests.runtime.governed import H_F, governed, record

B1 = Robot("robot/B1")
GOVERNANCE = (
    (2, TrustThresholdsSet(2, 1, H_F)),
    (3, SupervisionDensitySet(robot=None, review_every=2, decided_by=H_F, reason="start-up")),
    (4, past.ruled_for_all("allow", None, DOOR)),
    (5, PolicyRuleSet(scope="local", robot=B1, capability=DOOR, context=None, outcome="deny", decided_by=H_B)),
    (50 * S, PolicyRuleSet(scope="local", robot=B1, capability=DOOR, context=None, outcome="review", decided_by=H_B)),
    (90 * S, past.ruled_for_all("deny", B1)),
    (110 * S, past.ruled_for_all("allow", B1)),
)


def audited(structure: Any = FSAR) -> dict[str, int]:
    """How often each invariant, and policy, is broken in runs in which supervisors intervene."""
    records = [
        record(governed(scenario, *GOVERNANCE, run=4, structure=structure))
        for scenario in ("door-relay", "mixed-trust-inspection")
    ]
    with from_table(encode(records), threads=1) as database:
        counts = {row.invariant[:2]: row.events for row in audit_rows(database, invariants())}
        (found,) = database.rows("SELECT sum(numerator)::BIGINT AS violations FROM policy_violations")
    return {**counts, "violations": found["violations"]}


def silent_denial(state: Any, command: EvaluateRequest) -> tuple[Any, ...]:
    """FSAR's handler, which tells nobody of a conflict."""
    return tuple(one for one in evaluate_request(state, command) if type(one).__name__ != "PolicyConflictEscalated")


@pytest.mark.slow
def test_in_runs_with_interventions_the_invariants_hold_until_starts_ignore_a_rule_that_denies() -> None:
    counts, mutated = audited(), audited(HandlerTable({**FSAR.decides, StartAction: unchecked_start}, FSAR.reacts))
    assert {name for name, events in counts.items() if events} <= {"i5", "violations"}
    assert mutated["i3"] > 0
    assert mutated["violations"] > counts["violations"]


def test_a_conflict_that_nobody_was_told_of_is_caught_by_a3() -> None:
    assert audited(HandlerTable({**FSAR.decides, EvaluateRequest: silent_denial}, FSAR.reacts))["a3"] > 0
