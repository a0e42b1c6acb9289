"""Commands about recovery from outside: budgets that supervisors set, failures that robots report.

Paper: app:foundations.
"""

import pytest

from fsar_ledger.events.command import CommandRejected
from fsar_ledger.events.envelope import Robot, Subject, Supervisor
from fsar_ledger.events.execution import ExecutionFailed
from fsar_ledger.events.recovery import RecoveryBudgetSet
from fsar_ledger.runtime.architectures.fsar.recovery import StartRecovery
from fsar_ledger.runtime.handlers.recovery import ReportFailure, SetRecoveryBudget, report_failure, set_recovery_budget
from fsar_ledger.runtime.simulation import handler_table_of
from tests import past
from tests.runtime.failures import ACTION, A, B, executing, failed, taken
from tests.runtime.histories import given
from tests.runtime.live import decided
from tests.sure import only


@pytest.mark.parametrize("issued_by", ["supervisor/A1", "supervisor/fleet"])
def test_a_supervisor_in_charge_sets_a_recovery_budget(issued_by: Supervisor) -> None:
    assert decided(given("fsar"), SetRecoveryBudget(issued_by, A, "peer", 5_000_000, 0)) == (
        RecoveryBudgetSet(robot=A, level="peer", t_max_us=5_000_000, n_max=0, decided_by=issued_by),
    )


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        (SetRecoveryBudget(Supervisor("supervisor/fleet"), Robot("robot/Z9"), "peer", 1, 1), "unknown robot robot/Z9"),
        (SetRecoveryBudget(Supervisor("supervisor/Z9"), A, "peer", 1, 1), "unknown supervisor supervisor/Z9"),
        (SetRecoveryBudget(Supervisor("supervisor/B1"), A, "peer", 1, 1), "supervisor/B1 does not supervise robot/A1"),
        (SetRecoveryBudget(Supervisor(A), A, "peer", 1, 1), "unknown supervisor robot/A1"),
        (SetRecoveryBudget(Supervisor("supervisor/A1"), A, "cosmic", 1, 1), "level cosmic"),
        (SetRecoveryBudget(Supervisor("supervisor/A1"), A, "local", -1, 1), "at least 0"),
        (SetRecoveryBudget(Supervisor("supervisor/A1"), A, "local", 1, -1), "at least 0"),
        (SetRecoveryBudget(Supervisor("supervisor/A1"), A, "human", 0, 1), "at least 1"),
        (SetRecoveryBudget(Supervisor("supervisor/A1"), A, "human", 1, 0), "at least 1"),
    ],
)
def test_an_impossible_budget_is_rejected(command: SetRecoveryBudget, reason: str) -> None:
    found = only(CommandRejected, set_recovery_budget(given("fsar"), command))
    assert (found.command, found.subject, found.issued_by) == ("SetRecoveryBudget", command.robot, command.issued_by)
    assert reason in found.reason


def test_a_reported_failure_is_recovered_like_any_other() -> None:
    state = executing(B, "door.open.basic")
    [event] = taken(state, decided(state, ReportFailure(B, ACTION, "obstruction", now_us=2_000_000)))
    assert event == past.failed(Subject("A1-1", ACTION), B, "obstruction", 1_000_000, 2_000_000)
    [scheduled] = [
        one.command
        for react in handler_table_of("fsar").reacts[ExecutionFailed]
        for one in react(state, event, 2_000_000)
    ]
    assert scheduled == StartRecovery(ACTION)


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        (ReportFailure(Robot("robot/Z9"), ACTION, "obstruction"), "unknown robot robot/Z9"),
        (ReportFailure(A, "A1-9/1.1", "obstruction"), "unknown or finished action A1-9/1.1"),
        (ReportFailure(B, ACTION, "obstruction"), "executed by robot/A1"),
        (ReportFailure(A, ACTION, ""), "cause '', expected what failed"),
        (ReportFailure(A, ACTION, "a\x1b"), "expected what failed"),
    ],
)
def test_a_report_about_what_the_robot_does_not_execute_is_rejected(command: ReportFailure, reason: str) -> None:
    found = only(CommandRejected, report_failure(executing(), command))
    assert (found.command, found.subject, found.issued_by) == ("ReportFailure", command.action_id, command.robot)
    assert reason in found.reason


def test_a_second_report_of_the_same_failure_is_rejected() -> None:
    found = only(CommandRejected, decided(failed(executing()), ReportFailure(A, ACTION, "obstruction")))
    assert "is failed, expected running" in found.reason
