"""Lines of VDA 5050 as recorders write them: with a topic, a text in place of the message, or no message at all."""

from pathlib import Path
from typing import Any

import msgspec
import pytest

from tests.sources import vda
from tests.sources.importing import filed, imported, kinds, rows
from tests.sources.vda import order, state


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
