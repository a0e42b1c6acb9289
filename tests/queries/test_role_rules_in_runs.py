"""Rules by role in whole runs: they are heeded, exceptions stand, and the queries agree at every moment."""

from collections import Counter
from itertools import product

import pytest

from fsar_ledger.events.envelope import Robot, Supervisor
from fsar_ledger.events.execution import ExecutionStarted
from fsar_ledger.events.policy import RolePolicyRuleSet
from fsar_ledger.events.request import RequestDenied
from fsar_ledger.ledger.rows.codec import LedgerRun, encode
from fsar_ledger.metrics.database import Database, from_table
from fsar_ledger.metrics.invariants import chosen
from fsar_ledger.projections import policy
from fsar_ledger.runtime.architectures import HandlerTable
from fsar_ledger.runtime.architectures.fsar import FSAR
from fsar_ledger.runtime.handlers.commands import StartAction
from fsar_ledger.runtime.handlers.fleet import InstallCapability, JoinFleet
from fsar_ledger.runtime.handlers.policy import SetPolicyRule, SetRolePolicyRule
from fsar_ledger.runtime.handlers.registry import AdvertiseCapability
from fsar_ledger.runtime.handlers.request import RequestCapability
from tests import past
from tests.queries.histories import S
from tests.queries.test_mutated_handlers import unchecked_start
from tests.queries.test_role_rules import SCOPES, A, B, folded, in_force
from tests.queries.test_role_trust import DOOR
from tests.runtime.governed import H_F, governed
from tests.runtime.live import of, played

A1, B1, B2 = A, B, Robot("robot/B2")
COMMANDS = (
    (1 * S, SetRolePolicyRule(H_F, "B", "deny", capability=DOOR)),
    (2 * S, SetPolicyRule(H_F, "fleet", B1, DOOR, None, "allow")),
    (3 * S, JoinFleet(B2, "B", 2, Supervisor("supervisor/B2"), "yard")),
    (3 * S, InstallCapability(B2, DOOR, "1.0.0")),
    (4 * S, AdvertiseCapability(B2, DOOR, "1.0.0")),
    (5 * S, RequestCapability(A1, B1, DOOR, "visit", "excepted")),
    (20 * S, RequestCapability(A1, B2, DOOR, "visit", "of the role")),
    (40 * S, SetRolePolicyRule(H_F, "B", "allow", "yard", DOOR)),
    (41 * S, RequestCapability(A1, B2, DOOR, "visit", "of the yard")),
    (60 * S, SetRolePolicyRule(H_F, "B", "deny", "yard", DOOR, "visit")),
    (61 * S, RequestCapability(A1, B2, DOOR, "visit", "of the visit")),
    (80 * S, SetPolicyRule(H_F, "fleet", B1, DOOR, None, "deny")),
    (81 * S, SetRolePolicyRule(H_F, "B", "allow", capability=DOOR)),
    (82 * S, RequestCapability(A1, B1, DOOR, "visit", "no longer excepted")),
)


def offences(database: Database) -> dict[tuple[str, str], int]:
    """How often I3 and A3 are broken in each run, where they are."""
    found = [
        (query.relation[:2], one["run_id"])
        for query in chosen(["i3", "a3"])
        for one in database.rows(f"SELECT run_id FROM {query.relation}")
    ]
    return dict(Counter(found))


@pytest.mark.slow
def test_in_a_commanded_run_the_role_is_ruled_the_exception_is_not_and_the_queries_agree_at_every_moment() -> None:
    one = played(COMMANDS)
    began = {event.subject.action_id for _, event in of(one, ExecutionStarted)}
    denied = {(event.subject.action_id, event.reason) for _, event in of(one, RequestDenied)}
    assert began == {"excepted", "of the yard"}
    assert denied == {("of the role", "policy"), ("of the visit", "policy"), ("no longer excepted", "policy")}
    with from_table(encode([LedgerRun("r1", one.times_us, one.caused_by, one.events)]), threads=1) as database:
        for at_us in sorted({time_us + S // 2 for time_us, _ in COMMANDS}):
            state = folded(event for time_us, event in zip(one.times_us, one.events, strict=True) if time_us <= at_us)
            found = in_force(database, at_us, DOOR, "visit")
            for robot, scope in product(state.members, SCOPES):
                assert found["r1", robot, scope] == (policy.ruled(state, scope, robot, DOOR, "visit") or "allow"), (
                    at_us,
                    robot,
                    scope,
                )
        assert offences(database) == {}


INTERVENTIONS = (
    (2, RolePolicyRuleSet(scope="fleet", role="B", outcome="deny", domain="", capability=DOOR, decided_by=H_F)),
    (3, RolePolicyRuleSet(scope="local", role="A", outcome="deny", domain="", capability="carry.package")),
    (60 * S, past.ruled_for_all("allow", B1, DOOR)),
    (70 * S, RolePolicyRuleSet(scope="fleet", role="B", outcome="deny", domain="", capability=DOOR, decided_by=H_F)),
    (80 * S, RolePolicyRuleSet(scope="local", role="A", outcome="allow", domain="", capability="carry.package")),
)


def test_in_simulated_runs_rules_of_roles_are_heeded_and_a_start_that_does_not_look_is_caught() -> None:
    one = governed("door-relay", *INTERVENTIONS, run=4)
    starts = of(one, ExecutionStarted)
    for capability, from_us in ((DOOR, 60 * S), ("carry.package", 80 * S)):
        times = [time_us for time_us, event in starts if event.capability == capability]
        assert times
        assert min(times) > from_us
    blind = HandlerTable({**FSAR.decides, StartAction: unchecked_start}, FSAR.reacts)
    other = governed("door-relay", *INTERVENTIONS, run=4, structure=blind)
    runs = [
        LedgerRun(name, made.times_us, made.caused_by, made.events) for name, made in (("blind", other), ("fsar", one))
    ]
    with from_table(encode(runs), threads=1) as database:
        broken = offences(database)
    assert broken["i3", "blind"] > 0
    assert {name for _, name in broken} == {"blind"}
