"""Lines of VDA 5050 as recorders write them, and what vehicles report beside the straight course of an order."""

from pathlib import Path
from typing import Any

import msgspec
import pytest

from tests.sources import vda
from tests.sources.importing import filed, imported, kinds, rows
from tests.sources.vda import Line, order, state


def test_a_message_as_a_text_says_what_the_message_says(tmp_path: Path) -> None:
    night = [*vda.honest_night()]
    texts = [line | {"payload": msgspec.json.encode(line["payload"]).decode()} for line in night]
    for name, lines in (("texts", texts), ("whole", night)):
        imported(tmp_path / name, filed(tmp_path, lines))
    assert kinds(tmp_path / "texts") == kinds(tmp_path / "whole") != []


@pytest.mark.parametrize(
    "line", [{"payload": None}, {"payload": "no"}, {"payload": "[]"}, {"message": {"headerId": 1}}]
)
def test_a_topic_without_a_message_is_not_understood(tmp_path: Path, line: dict[str, Any]) -> None:
    topic = state(2, "0001", "a")["topic"]
    lines = [state(1, "0001", "a"), {"topic": topic, "timestamp": vda.stamp(2), **line}]
    found = imported(tmp_path / "ledger", filed(tmp_path, lines)).not_understood
    assert [(one.kind, one.count, one.first) for one in found] == [("unknown", 1, 2)]


@pytest.mark.parametrize(
    ("kind", "fields"),
    [
        ("order", {"orderId": "a", "nodes": []}),
        ("instantActions", {"instantActions": []}),
        ("instantActions", {"actions": []}),
        ("visualization", {"agvPosition": {}}),
        ("visualization", {"referenceStateHeaderId": 1, "velocity": {}}),
    ],
    ids=["order", "instant actions of 2.0", "instant actions of 2.1", "visualization of 2.1", "visualization of 3.0"],
)
def test_a_message_without_a_topic_is_known_by_its_fields(tmp_path: Path, kind: str, fields: Line) -> None:
    made = imported(tmp_path / "ledger", filed(tmp_path, [vda.message(0, "0001", kind, **fields)["payload"]]))
    (seen,) = (row for row in rows(tmp_path / "ledger") if row["type"] == "Observed.v1")
    assert (seen["kind"], made.not_understood) == (kind, ())


def test_two_errors_of_one_type_are_both_observed(tmp_path: Path) -> None:
    errors = [{"errorType": "sensor", "errorDescription": where} for where in ("left", "right")]
    imported(tmp_path / "ledger", filed(tmp_path, [state(1, "0001", "a", errors=errors)]))
    (seen,) = (row for row in rows(tmp_path / "ledger") if row["type"] == "Observed.v1")
    told = {name: text for name, text in zip(seen["names"], seen["texts"], strict=True) if name.startswith("error/")}
    assert [*told] == ["error/sensor", "error/sensor/2"]
    assert [msgspec.json.decode(text) for text in told.values()] == errors


def test_vehicles_that_nobody_names_are_not_one_robot(tmp_path: Path) -> None:
    line = order(0, "", "a")
    line["payload"] |= {"manufacturer": "", "serialNumber": ""}
    told = imported(tmp_path / "ledger", filed(tmp_path, [line | {"topic": "uagv/v2///order"}]))
    assert (told.robots, [one.count for one in told.not_understood]) == ((), [1])
    named = imported(tmp_path / "named", filed(tmp_path, [line | {"topic": "uagv/v2/KIT/7/order"}]))
    assert named.robots == ("robot/KIT.7",)


def test_a_recording_of_mosquitto_sub_has_the_times_at_which_it_got_each_message(tmp_path: Path) -> None:
    """The clock of a vehicle is five minutes late: nothing is dated by it."""
    lines = [
        {"tst": "2026-03-01T11:05:00.250000+0100", "topic": line["topic"], "qos": 0, "retain": False, "payloadlen": 9}
        | {"payload": line["payload"]}
        for line in (state(0, "0001", "a"), state(1, "0001", "a"))
    ]
    made = imported(tmp_path / "ledger", filed(tmp_path, lines))
    assert (rows(tmp_path / "ledger")[0]["epoch"], made.late) == ("2026-03-01T10:05:00.250000Z", 0)


@pytest.mark.parametrize("digits", [10, 13, 16, 19])
def test_a_recorder_may_count_when_it_got_a_message_in_any_unit_since_1970(tmp_path: Path, digits: int) -> None:
    times = [1_772_359_208 * 10 ** (digits - 10), 1_772_359_209 * 10 ** (digits - 10)]
    lines = [state(at, "0001", "a") | {"received": received} for at, received in enumerate(times)]
    imported(tmp_path / "ledger", filed(tmp_path, lines))
    begun, *_, closed = rows(tmp_path / "ledger")
    assert (begun["epoch"], closed["time_us"]) == ("2026-03-01T10:00:08Z", 1_000_000)


@pytest.mark.parametrize("received", [True, 12.5, -1, 10**400, 1e300])
def test_a_number_that_is_no_time_since_1970_leaves_the_time_of_the_vehicle(tmp_path: Path, received: float) -> None:
    line = msgspec.json.encode(state(1, "0001", "a") | {"received": 0})
    text = line.replace(b'"received":0', b'"received":' + f"{received}".lower().encode())
    imported(tmp_path / "ledger", filed(tmp_path, text))
    assert rows(tmp_path / "ledger")[0]["epoch"] == vda.stamp(1)


def test_what_vehicles_do_without_an_order_is_no_task_that_they_share(tmp_path: Path) -> None:
    """One is still charging when its next order comes, and the other is switched off meanwhile."""
    charging = {"actionType": "startCharging", "actionStatus": "RUNNING"}
    lines = [state(at, serial, "", nodes=0) for at, serial in enumerate(("0001", "0002"))]
    lines += [state(2, "0001", "o"), state(3, "0002", "", nodes=0)]
    for line, name, status in zip(lines[:3], ("i", "j", "i"), ("RUNNING", "RUNNING", "FINISHED"), strict=True):
        line["payload"]["actionStates"] = [charging | {"actionId": name, "actionStatus": status}]
    imported(tmp_path / "ledger", filed(tmp_path, lines))
    told = [row for row in rows(tmp_path / "ledger") if row["type"].startswith("Execution")]
    assert [(row["type"], row["task_id"], row["action_id"]) for row in told] == [
        ("ExecutionStarted.v1", "i", "i"),
        ("ExecutionStarted.v1", "j", "j"),
        ("ExecutionFinished.v1", "i", "i"),
        ("ExecutionWithdrawn.v1", "j", "j"),
    ]


def told(folder: Path, *lines: Line) -> list[tuple[str, str | None]]:
    imported(folder / "ledger", filed(folder, lines))
    events = [row for row in rows(folder / "ledger") if row["type"].startswith(("Execution", "TaskC", "TaskAb"))]
    return [(row["type"].partition(".v")[0], row.get("action_id")) for row in events]


@pytest.mark.parametrize("mode", ["MANUAL", "SERVICE", "STARTUP", "TEACHIN", "TEACH_IN"])
@pytest.mark.parametrize("name", ["a", ""])
def test_an_order_that_a_vehicle_clears_is_not_done_and_nothing_of_it_has_failed(
    tmp_path: Path, mode: str, name: str
) -> None:
    """Somebody takes over by hand: the nodes that are left, and what was to be done there, are gone."""
    asked, runs = order(0, "0001", "a", "p", "q"), state(1, "0001", "a", p="RUNNING", q="WAITING")
    cleared = state(2, "0001", name, nodes=0, mode=mode, p="FAILED", q="FAILED")
    if not name:
        cleared["payload"]["actionStates"] = []
    assert told(tmp_path, asked, runs, cleared, state(3, "0001", name, nodes=0)) == [
        ("ExecutionStarted", "p"),
        ("ExecutionWithdrawn", "p"),
        ("TaskAbandoned", None),
    ]


@pytest.mark.parametrize("mode", [None, [], {}, 1])
def test_a_mode_of_another_kind_clears_nothing(tmp_path: Path, mode: Any) -> None:
    lines = [order(0, "0001", "a"), state(1, "0001", "a", nodes=2), state(2, "0001", "a", nodes=0, mode=mode)]
    assert told(tmp_path, *lines) == [("TaskCompleted", None)]


def test_an_order_without_actions_that_is_cleared_is_not_said_to_be_completed(tmp_path: Path) -> None:
    lines = [order(0, "0001", "a"), state(1, "0001", "a", nodes=2), state(2, "0001", "a", nodes=0, mode="MANUAL")]
    assert told(tmp_path, *lines, state(3, "0001", "a", nodes=0)) == [("TaskAbandoned", None)]


def test_an_order_of_which_only_actions_were_left_is_completed_by_hand(tmp_path: Path) -> None:
    lines = [order(0, "0001", "a", "p"), state(1, "0001", "a", nodes=0, p="RUNNING")]
    lines += [state(2, "0001", "a", nodes=0, mode="MANUAL", p="RUNNING")]
    assert told(tmp_path, *lines, state(3, "0001", "a", nodes=0, mode="MANUAL", p="FINISHED")) == [
        ("ExecutionStarted", "p"),
        ("ExecutionFinished", "p"),
        ("TaskCompleted", None),
    ]


def test_a_vehicle_that_is_sent_to_sleep_has_given_up_its_order(tmp_path: Path) -> None:
    asleep = state(2, "0001", "a", nodes=0)
    asleep["payload"]["instantActionStates"] = [
        {"actionId": "i", "actionType": "startHibernation", "actionStatus": "FINISHED"}
    ]
    lines = [order(0, "0001", "a"), state(1, "0001", "a", nodes=2), asleep]
    assert told(tmp_path, *lines) == [("ExecutionFinished", "i"), ("TaskAbandoned", None)]


@pytest.mark.parametrize("is_late", [False, True])
def test_an_order_is_completed_without_the_horizon_that_an_update_took_from_it(tmp_path: Path, is_late: bool) -> None:
    asked, update = order(0, "0001", "a", "p"), order(2, "0001", "a", "p", "q")
    ahead = [{"actionId": "h", "actionType": "drop"}]
    asked["payload"]["nodes"].append({"nodeId": "n2", "sequenceId": 2, "released": False, "actions": ahead})
    update["payload"]["orderUpdateId"] = 1
    changes = [update, state(3, "0001", "a", p="RUNNING", q="WAITING")]
    lines = [asked, state(1, "0001", "a", p="RUNNING", h="WAITING"), *(changes[::-1] if is_late else changes)]
    lines += [asked, state(4, "0001", "a", nodes=0, p="FINISHED", q="FINISHED")]  # the first order comes once more
    assert told(tmp_path, *lines)[-1] == ("TaskCompleted", None)
