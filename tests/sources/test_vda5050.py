"""What becomes of VDA 5050 messages, and what can be judged then."""

import json
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fsar_ledger.api.ledger import Ledger
from tests.cli.conftest import Call
from tests.sources import vda
from tests.sources.importing import filed, imported, is_good, kinds, record_numbers, rows
from tests.sources.vda import Line, message, order, stamp, state

FLEET = '[robots]\nKIT.0001 = "agv"\n"KIT.0002" = "agv"\n'


def derived(folder: Path, lines: Sequence[Line]) -> list[str]:
    imported(folder / "ledger", filed(folder, lines))
    return kinds(folder / "ledger")


def audited(call: Call, ledger: Path) -> dict[str, Any]:
    answer = json.loads(call("audit", ledger, "--json").out)
    return {row["invariant"][:2]: row for row in answer["rows"]}


def refusal(name: str, **beside: Any) -> Line:
    reference = {"referenceKey": "orderId", "referenceValue": name}
    return {"errorType": "orderUpdateError", "errorLevel": "WARNING", "errorReferences": [reference], **beside}


@pytest.mark.slow
def test_an_honest_night_has_no_offence_and_its_fleet_is_judged(call: Call, tmp_path: Path) -> None:
    night, fleet = filed(tmp_path, vda.honest_night()), tmp_path / "fleet.toml"
    fleet.write_text(FLEET)
    call("import", tmp_path / "ledger", night, "--as", "vda5050", "--fleet", fleet).good()
    found = audited(call, tmp_path / "ledger")
    assert {name: row["holds"] for name, row in found.items() if row["holds"] is not None} == {"a2": True, "a4": True}
    assert (found["i1"]["not_observed"], found["i1"]["first_found"]) == ("RobotDeparted", None)
    assert all(row["not_observed"] for row in found.values() if row["holds"] is None)


@pytest.mark.slow
def test_a_vehicle_that_is_not_of_the_fleet_breaks_i1(call: Call, tmp_path: Path) -> None:
    night, fleet = filed(tmp_path, vda.honest_night()), tmp_path / "fleet.toml"
    fleet.write_text('[robots]\n"KIT.0001" = "agv"\n')
    call("import", tmp_path / "ledger", night, "--as", "vda5050", "--fleet", fleet).good()
    offence = audited(call, tmp_path / "ledger")["i1"]
    assert (offence["holds"], offence["first_type"]) == (False, "RequestIssued.v1")
    assert offence["first_found"].startswith("robot/KIT.0002 is named")


@pytest.mark.slow
def test_without_a_fleet_nothing_is_said_of_who_belongs_to_it(call: Call, tmp_path: Path) -> None:
    said = call("import", tmp_path / "ledger", filed(tmp_path, vda.honest_night()), "--as", "vda5050").good()
    assert "not observable: I1 (missing: RobotDeparted, RobotJoined)" in said.out
    assert audited(call, tmp_path / "ledger")["i1"]["holds"] is None


def test_a_recording_that_begins_in_the_midst_of_an_order_accuses_nobody(call: Call, tmp_path: Path) -> None:
    night = list(vda.honest_night(["0001"]))[3:]
    assert derived(tmp_path, night)[:2] == ["RequestAccepted", "ExecutionStarted"]
    assert [name for name, row in audited(call, tmp_path / "ledger").items() if row["holds"] is False] == []


def test_each_step_of_an_order_is_told_once_and_an_action_is_executed_by_its_vehicle(tmp_path: Path) -> None:
    assert derived(tmp_path, list(vda.honest_night(["0001"]))) == [
        "TaskArrived",
        "RequestIssued",
        "RequestAccepted",
        "ExecutionStarted",
        "ExecutionPaused",
        "ExecutionResumed",
        "ExecutionFinished",
        "TaskCompleted",
    ]
    done = [row for row in rows(tmp_path / "ledger") if row["type"].startswith(("ExecutionSt", "ExecutionFi"))]
    assert [(row["executed_by"], row.get("requested_by")) for row in done] == [("robot/KIT.0001", None)] * 2


def test_every_derived_event_is_caused_by_its_message(tmp_path: Path) -> None:
    derived(tmp_path, list(vda.honest_night()))
    run = rows(tmp_path / "ledger")
    said = [row for row in run if row["type"].startswith(("Task", "Request", "Execution"))]
    assert said
    assert {run[row["caused_by"]]["type"] for row in said} == {"Observed.v1"}


def test_an_error_that_names_an_order_which_was_not_accepted_denies_it(tmp_path: Path) -> None:
    lines = [order(0, "0001", "a"), state(1, "0001", "", errors=[refusal("a")]), state(2, "0001", "")]
    assert derived(tmp_path, lines) == ["TaskArrived", "RequestIssued", "RequestDenied"]
    (denied,) = [row for row in rows(tmp_path / "ledger") if row["type"] == "RequestDenied.v1"]
    assert ("orderUpdateError" in denied.values(), denied["decided_by"]) == (True, "robot/KIT.0001")


def test_an_error_of_an_order_on_its_way_denies_nothing(tmp_path: Path) -> None:
    lines = [order(0, "0001", "a"), state(1, "0001", "a"), state(2, "0001", "a", errors=[refusal("a")])]
    assert "RequestDenied" not in derived(tmp_path, lines)


def test_a_retriable_action_has_failed_and_runs_on_when_it_is_tried_again(tmp_path: Path) -> None:
    steps = ("RUNNING", "RETRIABLE", "RUNNING", "RETRIABLE", "FAILED")
    lines = [order(0, "0001", "a", "p"), *(state(at, "0001", "a", p=step) for at, step in enumerate(steps, 1))]
    found = [name for name in derived(tmp_path, lines) if name.startswith("Execution")]
    assert found == [f"Execution{how}" for how in ("Started", "Failed", "Resumed", "Failed", "Withdrawn")]
    assert [row["failure"] for row in rows(tmp_path / "ledger") if "failure" in row] == [1, 2, 2]


def test_a_vehicle_does_nothing_more_about_an_action_that_failed_for_good(tmp_path: Path) -> None:
    tried = [order(0, "0001", "a", "p"), state(1, "0001", "a", p="RUNNING"), state(2, "0001", "a", p="RETRIABLE")]
    derived(tmp_path, tried)
    stands = Ledger(tmp_path / "ledger").state("night").standing
    assert [one.action_id for one in stands.recoveries or ()] == ["p"]
    imported(tmp_path / "ledger", filed(tmp_path, [*tried, state(3, "0001", "a", p="FAILED")]))
    stands = Ledger(tmp_path / "ledger").state("night").standing
    assert (stands.robots, stands.recoveries) == (None, None)


def test_what_a_cancelled_order_still_had_is_called_off_and_has_not_failed(tmp_path: Path) -> None:
    lines = [order(0, "0001", "a", "p", "q"), state(1, "0001", "a", p="RUNNING", q="WAITING")]
    for at, status, cancel in ((2, "RUNNING", "RUNNING"), (3, "FAILED", "FINISHED")):
        lines.append(state(at, "0001", "a", nodes=0, p=status, q=status.replace("RUNNING", "WAITING")))
        asks = {"actionId": "c", "actionType": "cancelOrder", "actionStatus": cancel}
        lines[-1]["payload"]["actionStates"].append(asks)
    found = derived(tmp_path, lines)
    assert ("ExecutionFailed" not in found, found[-1]) == (True, "TaskAbandoned")
    withdrawn = [row for row in rows(tmp_path / "ledger") if row["type"] == "ExecutionWithdrawn.v1"]
    assert [(row["action_id"], row.get("failure")) for row in withdrawn] == [("p", None)]


@pytest.mark.parametrize("field", ["actionStates", "instantActionStates"])
@pytest.mark.parametrize("is_typed", [True, False])
def test_an_order_that_was_cancelled_is_given_up_and_not_completed(tmp_path: Path, field: str, is_typed: bool) -> None:
    asked = message(2, "0001", "instantActions", actions=[{"actionId": "c", "actionType": "cancelOrder"}])
    lines = [order(0, "0001", "a"), state(1, "0001", "a"), asked]
    for at, status in ((3, "RUNNING"), (4, "FINISHED"), (5, "FINISHED")):
        lines.append(state(at, "0001", "a", nodes=0))
        lines[-1]["payload"][field] = [{"actionId": "c", "actionStatus": status}]
        lines[-1]["payload"][field][0] |= {"actionType": "cancelOrder"} if is_typed else {}
    ends = [order(6, "0001", "b"), state(7, "0001", "b", nodes=0)]
    ends[-1]["payload"][field] = lines[-1]["payload"][field]  # of 3.0 it stays
    found = [name for name in derived(tmp_path, [*lines, *ends]) if name.startswith("Task")]
    assert found == ["TaskArrived", "TaskAbandoned", "TaskArrived", "TaskCompleted"]


def test_a_cancellation_that_comes_with_the_next_order_ends_the_one_before_it(tmp_path: Path) -> None:
    lines = [order(0, "0001", "a"), state(1, "0001", "a"), order(2, "0001", "b"), state(3, "0001", "b")]
    lines[-1]["payload"]["actionStates"] = [{"actionId": "c", "actionType": "cancelOrder", "actionStatus": "FINISHED"}]
    imported(tmp_path / "ledger", filed(tmp_path, lines))
    ended = [row["task_id"] for row in rows(tmp_path / "ledger") if row["type"] == "TaskAbandoned.v1"]
    assert ended == ["a"]


def test_a_cancellation_that_failed_ends_nothing(tmp_path: Path) -> None:
    cancel = {"actionId": "c", "actionType": "cancelOrder", "actionStatus": "FAILED"}
    lines = [order(0, "0001", "a", "p"), state(1, "0001", "a", p="RUNNING"), state(2, "0001", "a", nodes=0, p="FAILED")]
    lines[1]["payload"]["actionStates"].append(cancel)
    lines[2]["payload"]["instantActionStates"] = [cancel]
    assert [name for name in derived(tmp_path, lines[:2]) if name.startswith("Task")] == ["TaskArrived"]


def test_an_order_that_is_over_with_an_action_that_failed_is_given_up(tmp_path: Path) -> None:
    lines = [order(0, "0001", "a", "p"), state(1, "0001", "a", p="RUNNING"), state(2, "0001", "a", nodes=0, p="FAILED")]
    assert derived(tmp_path, lines)[-3:] == ["ExecutionFailed", "ExecutionWithdrawn", "TaskAbandoned"]
    unknown = [order(0, "0001", "a"), state(1, "0001", "a", nodes=0, p="FAILED")]
    (tmp_path / "unknown").mkdir()
    assert derived(tmp_path / "unknown", unknown)[-1] == "ExecutionWithdrawn"


def test_an_order_that_was_refused_and_then_taken_is_completed(tmp_path: Path) -> None:
    lines = [order(0, "0001", "a"), state(1, "0001", "", errors=[refusal("a")]), order(2, "0001", "a")]
    assert derived(tmp_path, [*lines, state(3, "0001", "a"), state(4, "0001", "a", nodes=0)])[2:] == [
        "RequestDenied",
        "RequestAccepted",
        "TaskCompleted",
    ]


def test_an_action_whose_name_is_used_again_under_another_order_runs_again(tmp_path: Path) -> None:
    lines = [
        order(0, "0001", "a", "p"),
        state(1, "0001", "a", p="RUNNING"),
        state(2, "0001", "a", nodes=0, p="FINISHED"),
        order(3, "0001", "b", "p"),
        state(4, "0001", "b", p="RUNNING"),
        state(5, "0001", "b", nodes=0, p="FINISHED"),
        order(6, "0001", "c", "p"),
        state(7, "0001", "c", nodes=0, p="FINISHED"),  # it began and ended between two states
    ]
    found = [name for name in derived(tmp_path, lines) if name.startswith("Execution")]
    assert found == [*["ExecutionStarted", "ExecutionFinished"] * 2, "ExecutionFinished"]


def ended(folder: Path, *lines: Line) -> list[tuple[str, str | None]]:
    imported(folder / "ledger", filed(folder, lines))
    found = [row for row in rows(folder / "ledger") if row["type"].startswith(("Execution", "TaskC", "TaskAb"))]
    return [(row["type"].partition(".v")[0], row.get("action_id")) for row in found]


BEGUN = (order(0, "0001", "a", "p", "q", "r"), state(1, "0001", "a", p="RUNNING", q="PAUSED", r="WAITING"))


@pytest.mark.parametrize("after", ["", "a", "b"])
def test_how_an_action_ended_that_a_state_has_no_more_is_not_told(tmp_path: Path, after: str) -> None:
    gone = ended(tmp_path, *BEGUN, state(2, "0001", after, nodes=0), state(3, "0001", after, nodes=0))
    assert gone == [
        ("ExecutionStarted", "p"),
        ("ExecutionPaused", "q"),
        ("ExecutionWithdrawn", "p"),
        ("ExecutionWithdrawn", "q"),
    ]
    assert Ledger(tmp_path / "ledger").state("night").standing.robots is None


def test_an_action_that_a_state_has_again_begins_again_and_its_order_can_be_completed(tmp_path: Path) -> None:
    lines = [order(0, "0001", "a", "p"), state(1, "0001", "a", p="RUNNING"), state(2, "0001", "a")]
    lines += [state(3, "0001", "a", p="RUNNING"), state(4, "0001", "a", nodes=0, p="FINISHED")]
    assert ended(tmp_path, *lines)[1:] == [
        ("ExecutionWithdrawn", "p"),
        ("ExecutionStarted", "p"),
        ("ExecutionFinished", "p"),
        ("TaskCompleted", None),
    ]


def test_an_action_that_the_next_order_names_again_is_not_that_of_the_last_order(tmp_path: Path) -> None:
    lines = [order(0, "0001", "a", "p"), state(1, "0001", "a", p="RUNNING")]
    lines += [order(2, "0001", "b", "p"), state(3, "0001", "b", p="RUNNING")]
    assert ended(tmp_path, *lines) == [
        ("ExecutionStarted", "p"),
        ("ExecutionWithdrawn", "p"),
        ("ExecutionStarted", "p"),
    ]


def test_a_state_without_a_list_says_nothing_of_its_actions(tmp_path: Path) -> None:
    lines = [*BEGUN, state(2, "0001", "a")]
    del lines[-1]["payload"]["actionStates"]
    assert ended(tmp_path, *lines)[2:] == []


def test_an_action_that_was_over_is_not_missed_and_is_not_over_twice(tmp_path: Path) -> None:
    lines = [order(0, "0001", "a", "p"), state(1, "0001", "a", p="FINISHED"), state(2, "0001", "a", p="WAITING")]
    lines += [state(3, "0001", "a"), state(4, "0001", "a", nodes=0, p="FINISHED")]
    assert ended(tmp_path, *lines) == [("ExecutionFinished", "p"), ("TaskCompleted", None)]


def test_a_connection_that_breaks_and_comes_back_is_told_once(tmp_path: Path) -> None:
    states = ("ONLINE", "CONNECTIONBROKEN", "CONNECTIONBROKEN", "ONLINE", "OFFLINE", "ONLINE")
    lines = [message(at, "0001", "connection", connectionState=one) for at, one in enumerate(states)]
    assert derived(tmp_path, lines) == ["LinkWentDown", "LinkCameUp"]


@pytest.mark.parametrize("broken", ["CONNECTIONBROKEN", "CONNECTION_BROKEN"])
def test_a_broken_connection_is_told_in_what_the_vehicle_left_before_it_came_online(
    tmp_path: Path, broken: str
) -> None:
    states = ("ONLINE", broken, "OFFLINE", "ONLINE", broken)
    lines = [message(at, "0001", "connection", connectionState=one) for at, one in enumerate(states)]
    for number, line in enumerate(lines):
        line["payload"] |= {"headerId": number, "timestamp": stamp(number)}
        if line["payload"]["connectionState"] == broken:
            line["payload"] |= {"headerId": 0, "timestamp": stamp(-1)}
    assert derived(tmp_path, lines) == ["LinkWentDown", "LinkCameUp", "LinkWentDown"]


@pytest.mark.parametrize("name", ["instantActionStates", "zoneActionStates"])
def test_what_becomes_of_other_actions_than_an_orders_is_told_and_no_order_waits_for_them(
    tmp_path: Path, name: str
) -> None:
    charging = {"actionId": "i1", "actionType": "startCharging", "actionStatus": "RUNNING"}
    line = state(1, "0001", "a", nodes=0)
    line["payload"][name] = [charging]
    assert derived(tmp_path, [order(0, "0001", "a"), line])[2:] == [
        "RequestAccepted",
        "ExecutionStarted",
        "TaskCompleted",
    ]
    del line["payload"][name][0]["actionStatus"]
    (tmp_path / "unnamed").mkdir()
    assert "ExecutionStarted" not in derived(tmp_path / "unnamed", [order(0, "0001", "a"), line])


def test_a_state_without_its_nodes_does_not_complete_an_order(tmp_path: Path) -> None:
    short = state(1, "0001", "a", nodes=0)
    del short["payload"]["nodeStates"]
    assert "TaskCompleted" not in derived(tmp_path, [order(0, "0001", "a"), short])


def test_a_state_that_was_sent_before_the_last_one_says_nothing_new(tmp_path: Path) -> None:
    before, after = state(1, "0001", "a", p="RUNNING"), state(2, "0001", "a", p="PAUSED")
    assert derived(tmp_path, [order(0, "0001", "a", "p"), before, after, before, after])[3:] == [
        "ExecutionStarted",
        "ExecutionPaused",
    ]


def test_a_clock_that_was_set_back_hides_nothing(tmp_path: Path) -> None:
    later = state(-500, "0001", "a", p="FINISHED")
    later["payload"]["headerId"] = 2
    found = derived(tmp_path, [order(0, "0001", "a", "p"), state(1, "0001", "a", p="RUNNING"), later])
    assert found[-1] == "ExecutionFinished"
    times = [row["time_us"] for row in rows(tmp_path / "ledger")]
    assert times == sorted(times)


@settings(max_examples=15, deadline=None)
@given(st.data())
def test_messages_that_come_twice_or_late_double_no_event(data: st.DataObject) -> None:
    night = list(vda.honest_night())
    again = data.draw(st.lists(st.sampled_from(night), max_size=20))
    shuffled = data.draw(st.permutations([*night, *again]))
    with tempfile.TemporaryDirectory() as folder:
        imported(Path(folder) / "ledger", filed(Path(folder), shuffled))
        once = [
            (row["type"], row.get("task_id"), row.get("action_id"))
            for row in rows(Path(folder) / "ledger")
            if row["type"].startswith(("TaskA", "TaskC", "Request", "ExecutionFin"))
        ]
    assert len(once) == len(set(once))


FIELDS = [*vda.state(0, "1", "a")["payload"], "connectionState", "topic", "payload", "received", "actions", "nodes"]
VALUES: st.SearchStrategy[Any] = st.recursive(
    st.none() | st.booleans() | st.integers() | st.text(max_size=9) | st.sampled_from(["a", "RUNNING", vda.stamp(1)]),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(FIELDS) | st.text(), inner, max_size=4),
    max_leaves=12,
)
LINES = (
    st.dictionaries(st.sampled_from(FIELDS), VALUES).map(msgspec.json.encode)
    | st.binary(max_size=60)
    | st.sampled_from([msgspec.json.encode(line) for line in vda.honest_night()])
    | st.dictionaries(st.sampled_from(FIELDS), VALUES, min_size=1, max_size=1).map(
        lambda changed: msgspec.json.encode(
            state(1, "0001", "a", p="RUNNING") | {"payload": {**state(1, "0001", "a")["payload"], **changed}}
        )
    )
)


@pytest.mark.slow
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(LINES, max_size=12))
def test_any_lines_leave_a_ledger_that_verifies_and_has_each_of_them_once(lines: list[bytes]) -> None:
    first = msgspec.json.encode(message(0, "0001", "connection", connectionState="ONLINE"))
    whole = b"\n".join([first, *lines])
    count = sum(1 for line in whole.split(b"\n") if line.strip())
    with tempfile.TemporaryDirectory() as folder:
        ledger = Path(folder) / "ledger"
        assert imported(ledger, filed(Path(folder), whole)).records == count
        assert record_numbers(ledger) == list(range(1, count + 1))
        assert is_good(ledger)


@pytest.mark.parametrize("topic", [None, 7, "", "a", "a/b/c/d/state"])
def test_a_topic_of_any_form_is_no_failure(tmp_path: Path, topic: Any) -> None:
    line = state(1, "0001", "a") | {"topic": topic}
    assert "RequestAccepted" in derived(tmp_path, [order(0, "0001", "a"), line])


def test_a_file_of_another_format_is_refused_and_nothing_is_recorded(call: Call, tmp_path: Path) -> None:
    other = filed(tmp_path, [{"resourceSpans": []}] * 3, "other.jsonl")
    said = call("import", tmp_path / "ledger", other, "--as", "vda5050")
    assert (said.code, "expected VDA 5050 messages" in said.err) == (2, True), said.err
    assert not (tmp_path / "ledger").exists()


def test_the_command_of_the_page_does_what_it_says(call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = (Path(__file__).parents[2] / "docs" / "sources" / "vda5050.md").read_text("utf-8")
    command = next(line for line in page.splitlines() if line.startswith("fsar-ledger import"))
    monkeypatch.chdir(tmp_path)
    filed(tmp_path, vda.honest_night())
    (tmp_path / "fleet.toml").write_text(page.split("```toml\n")[1].split("```")[0])
    said = call(*command.split()[1:]).good()
    assert "can be judged: A2, A4\n" in said.out


@pytest.mark.parametrize(
    "states",
    [
        {"actionStates": [{"actionId": None, "actionType": "pick", "actionStatus": "RUNNING"}]},
        {"actionStates": [{"actionType": "drop", "actionStatus": "RUNNING"}]},
        {"actionStates": [{"actionId": ["x"], "actionType": "drop", "actionStatus": "RUNNING"}]},
        {"errors": [{"errorReferences": [{"referenceKey": "orderId", "referenceValue": "o2"}]}]},
    ],
)
def test_a_state_that_names_no_action_or_error_is_not_understood(tmp_path: Path, states: dict[str, Any]) -> None:
    said = state(2, "0001", "o1")
    lines = [order(1, "0001", "o1"), order(1, "0001", "o2"), {**said, "payload": said["payload"] | states}]
    assert derived(tmp_path, lines).count("TaskArrived") == 2
    assert not {"ExecutionStarted", "RequestDenied"} & set(kinds(tmp_path / "ledger"))
