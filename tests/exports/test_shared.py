"""What an event names, and the time of day of run time."""

import pytest

from fsar_ledger.base.errors import UsageError
from fsar_ledger.exports import NAMING, Named, epoch_us, named_in, rfc3339

NAMES = {
    *(
        "busy",
        "candidates",
        "claimant",
        "decided_by",
        "degraded",
        "executed_by",
        "fleet_deny",
        "fleet_review",
        "helper",
    ),
    *("holder", "issued_by", "local_deny", "local_review", "on_behalf_of", "path", "peer", "receiver", "rejected"),
    *("relay", "requested_by", "robot", "robots", "sender", "supervised_by", "supervisor", "written_by"),
    *("action_id", "failed_action", "parent", "preempted_by", "request_id", "task_id"),
}
"""The columns that name something, as a reader of docs/event-types.json finds them."""


def test_every_column_that_names_something_is_known() -> None:
    assert NAMING.keys() == NAMES


def test_one_that_has_several_roles_has_them_joined() -> None:
    found = named_in(
        {"requested_by": "robot/A1", "executed_by": "robot/A1", "action_id": "A1-1/2.1", "reason": "trust"}
    )
    assert found == {Named("robot", "robot/A1"): "requester, executor", Named("action", "action/A1-1/2.1"): "action"}


def test_each_of_a_list_is_named_once_in_a_role() -> None:
    path = ("robot/A1", "service/registry", "robot/A1")
    assert named_in({"path": path, "relay": None}) == {
        Named("robot", "robot/A1"): "path",
        Named("service", "service/registry"): "path",
    }


def test_a_name_of_another_system_is_taken_for_no_task() -> None:
    assert list(named_in({"robot": "task/A1-1", "task_id": "A1-1"})) == [
        Named("principal", "principal/task/A1-1"),
        Named("task", "task/A1-1"),
    ]


def test_an_epoch_is_a_time_of_day() -> None:
    assert epoch_us("r", None) == 0
    assert rfc3339(epoch_us("r", "2026-03-01T12:00:00Z") + 1_500_000) == "2026-03-01T12:00:01.500000Z"
    assert epoch_us("r", "2026-03-01T12:00:00") == epoch_us("r", "2026-03-01T13:00:00+01:00")


@pytest.mark.parametrize("epoch", ["noon", "", "1969-12-31T23:59:59Z", "9500-01-01T00:00:00Z"])
def test_an_epoch_that_is_none_is_refused(epoch: str) -> None:
    with pytest.raises(UsageError, match="expected a time in ISO 8601"):
        epoch_us("r", epoch)
