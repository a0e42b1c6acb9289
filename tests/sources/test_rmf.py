"""A recording of Open-RMF: what people ask of it is found, and nobody is accused of what it does not say."""

import io
import json
import random
import re
import shlex
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from fsar_ledger.api.ledger import Ledger
from fsar_ledger.base.errors import UsageError
from fsar_ledger.cli.app import run
from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Robot
from fsar_ledger.sources.adapter import UNREADABLE, Input, Record
from fsar_ledger.sources.importing import Imported, import_files
from fsar_ledger.sources.rmf import SEARCHED, Rmf
from tests import past

from .rmf_messages import FLEET, Line, booking, dispatched, fleet, honest_day, log, millis, phases, state
from .vda import written

ROBOTS = {f"{FLEET}.r1": "tiny", f"{FLEET}.r2": "tiny"}
PAGE = Path(__file__).resolve().parents[2] / "docs" / "sources" / "rmf.md"


def given(data: bytes) -> list[Input]:
    return [Input("day", None, io.BytesIO(data))]


def records(data: bytes) -> list[Record]:
    return list(Rmf().read(given(data)))


def derived(lines: Iterable[Line]) -> list[Event]:
    adapter = Rmf()
    return [one.event for record in adapter.read(given(written(lines))) for one in (adapter.derive(record) or ())]


def kinds(lines: Iterable[Line]) -> list[str]:
    return [type(event).__name__ for event in derived(lines)]


def observed(line: Line) -> Record:
    [record] = records(written([line]))
    return record


def imported(folder: Path, data: bytes, robots: dict[str, str] | None = None) -> Imported:
    path = folder / "day.jsonl"
    path.write_bytes(data)
    with path.open("rb") as file:
        return import_files(folder / "out", [Input("day", path, file)], Rmf(), run="day", fleet=robots)


def offences(folder: Path, invariant: str) -> list[str]:
    return [row["found"] for row in Ledger(folder / "out").query(f"invariants/{invariant}").rows()]


def verdicts(folder: Path) -> dict[str, str | None]:
    """Each invariant and metric with what it lacks, None where it is observable."""
    rows = Ledger(folder / "out").query("audit/record_gaps").rows()
    return {row["judge"]: row["missing"] for row in rows}


def test_a_task_goes_from_its_arrival_through_its_robot_to_its_end() -> None:
    assert kinds(
        [
            state(0, "t", "queued", dispatch={"status": "queued"}),
            state(1, "t", "queued", dispatch=dispatched("r1")),
            state(2, "t", "standby", robot="r1", active=None),
            state(3, "t", "underway", robot="r1"),
            state(4, "t", "underway", robot="r1"),
            state(5, "t", "completed", robot="r1"),
        ]
    ) == ["TaskArrived", "RequestIssued", "ExecutionStarted", "ExecutionFinished", "TaskCompleted"]


def test_the_dispatcher_asks_and_the_person_who_booked_is_no_principal() -> None:
    [_, request] = derived([state(1, "t", "queued", dispatch=dispatched("r1"))])
    principals = request.principals  # type: ignore[attr-defined]
    assert (principals.requested_by, principals.decided_by, principals.executed_by) == (
        "coordinator",
        "coordinator",
        f"robot/{FLEET}.r1",
    )


def test_a_fleet_that_names_no_robot_leaves_the_executor_open() -> None:
    [_, request] = derived([state(1, "t", "queued", dispatch=dispatched(None))])
    assert request.principals.executed_by is None  # type: ignore[attr-defined]


def test_a_start_between_two_states_is_told_by_the_end() -> None:
    assert kinds([state(9, "t", "completed", robot="r1")])[1:] == [
        "ExecutionStarted",
        "ExecutionFinished",
        "TaskCompleted",
    ]


def test_the_robot_of_a_task_executes_it_and_nobody_is_said_to_have_asked_or_to_supervise() -> None:
    executed = derived([state(9, "t", "completed", robot="r1")])[1:3]
    assert [event.principals for event in executed] == [past.parties(executed_by=Robot(f"robot/{FLEET}.r1"))] * 2  # type: ignore[attr-defined]


def test_a_task_that_was_cancelled_before_it_began_was_never_executed() -> None:
    waits = state(0, "t", "queued", robot="r1")
    del waits["data"]["active"]
    cancelled = state(1, "t", "canceled", robot="r1")
    del cancelled["data"]["active"]
    assert kinds([waits, cancelled]) == ["TaskArrived", "TaskAbandoned"]


def test_a_robot_that_loses_its_task_to_another_is_released() -> None:
    events = derived([state(1, "t", "underway", robot="r1"), state(2, "t", "underway", robot="r2")])
    assert [(type(one).__name__, getattr(one, "robot", None)) for one in events[1:]] == [
        ("ExecutionStarted", f"robot/{FLEET}.r1"),
        ("ExecutionWithdrawn", f"robot/{FLEET}.r1"),
        ("ExecutionStarted", f"robot/{FLEET}.r2"),
    ]


def test_an_interruption_between_two_states_is_told_by_the_next_one() -> None:
    over = {"unix_millis_request_time": millis(2), "labels": ["bob"], "resumed_by": {"labels": ["bob"]}}
    assert kinds(
        [state(1, "t", "underway", robot="r1"), state(3, "t", "underway", robot="r1", interruptions={"a": over})]
    )[2:] == ["ExecutionPaused", "ExecutionResumed"]


@pytest.mark.parametrize(
    ("lines", "cause"),
    [
        ([log(2, "t", "no path to pantry", "error"), state(3, "t", "failed", robot="r1")], "no path to pantry"),
        ([state(3, "t", "failed", robot="r1", phases=phases("failed", "Go to pantry"))], "Go to pantry"),
        ([log(2, "t", "door is slow", "warning"), state(3, "t", "failed", robot="r1")], "failed"),
    ],
)
def test_a_failure_has_the_cause_that_the_recording_gives(lines: list[Line], cause: str) -> None:
    events = derived([state(1, "t", "underway", robot="r1"), *lines])
    assert [event.cause for event in events if hasattr(event, "cause")] == [cause]
    assert [type(event).__name__ for event in events][-2:] == ["ExecutionWithdrawn", "TaskAbandoned"]


def test_a_task_that_no_fleet_takes_is_given_up() -> None:
    nobody = {
        "type": "task_state_update",
        "data": {"booking": booking("t"), "dispatch": {"status": "failed_to_assign"}},
    }
    assert kinds([nobody]) == ["TaskArrived", "TaskAbandoned"]


def test_what_comes_late_or_twice_changes_nothing() -> None:
    lines = list(honest_day())
    assert kinds([*lines, *lines]) == kinds(lines)


def test_a_second_task_of_the_same_name_is_not_understood() -> None:
    again = state(9, "t", "queued")
    again["data"]["booking"]["unix_millis_request_time"] = millis(8)
    adapter = Rmf()
    made = [adapter.derive(one) for one in adapter.read(given(written([state(5, "t", "completed"), again])))]
    assert (len(list(made[0] or ())), made[1]) == (2, None)


def test_who_asked_who_cancelled_and_which_robot_are_in_the_observation() -> None:
    cancelled = {"unix_millis_request_time": millis(5), "labels": ["carol", "reason=spill"]}
    record = observed(state(5, "t", "canceled", robot="r1", cancellation=cancelled))
    assert record.kind == "task_state/canceled"
    assert record.objects == {
        "task/t": "task",
        f"robot/{FLEET}.r1": "assigned robot",
        "alice": "requester",
        "app=dashboard": "booking label",
        "carol": "cancellation label",
        "reason=spill": "cancellation label",
    }
    assert record.values["booking/requester"] == "alice"
    assert record.values["booking/priority"] == '{"type":"binary","value":1}'
    assert msgspec.json.decode(record.values["cancellation"]) == cancelled


def test_somebody_who_asks_and_cancels_has_both_parts() -> None:
    record = observed(state(5, "t", "canceled", cancellation={"unix_millis_request_time": 1, "labels": ["alice"]}))
    assert record.objects["alice"] == "requester, cancellation label"


def test_why_it_failed_is_in_the_observations() -> None:
    dispatch = {"status": "failed_to_assign", "errors": [{"code": 10, "category": "Not Feasible", "detail": "no bid"}]}
    assert "no bid" in observed(state(1, "t", "failed", dispatch=dispatch)).values["dispatch"]
    assert (
        "stuck"
        in observed(state(1, "t", "error", robot="r1", phases=phases("error", "stuck"))).values["phase/1/event/1"]
    )
    record = observed(log(1, "t", "no path", "error"))
    assert (record.kind, record.values) == ("task_log/error", {"phase/1/event/1/0": "error: no path"})


def test_a_fleet_state_tells_of_each_robot() -> None:
    record = observed(fleet(1, r1="t", r2=""))
    assert record.objects == {
        f"fleet/{FLEET}": "fleet",
        f"robot/{FLEET}.r1": "robot",
        "task/t": "task",
        f"robot/{FLEET}.r2": "robot",
    }
    assert '"battery":0.8' in record.values[f"robot/{FLEET}.r1"]


@pytest.mark.parametrize(
    ("line", "kind"),
    [
        ({"type": "cancel_task_request", "task_id": "t", "labels": ["carol"]}, "cancel_task_request"),
        ({"type": "robot_task_request", "robot": "r1", "fleet": FLEET, "request": {}}, "robot_task_request"),
        ({"success": False, "errors": [{"detail": "no such task"}]}, "response/refused"),
        ({"success": True, "state": {"booking": {"id": "t"}}}, "response/accepted"),
        ({"booking": {"id": "t"}, "status": "queued"}, "task_state/queued"),
        ({"task_id": "t", "log": []}, "task_log/uninitialized"),
        ({"name": FLEET, "robots": {}}, "fleet_state"),
        ({"name": FLEET, "log": [], "robots": {}}, "fleet_log"),
    ],
)
def test_a_bare_message_is_known_by_its_fields(line: Line, kind: str) -> None:
    assert observed(line).kind == kind


def test_the_time_of_a_plan_is_not_the_time_of_a_record() -> None:
    waits = state(9, "t", "queued", robot="r1")
    runs = state(9, "t", "underway", robot="r1")
    ends = state(9, "t", "completed", robot="r1")
    assert [observed(one).source_us for one in (waits, runs, ends)] == [millis(at) * 1000 for at in (0, 2, 9)]


def test_an_honest_day_offends_nobody_and_names_what_it_cannot_show(tmp_path: Path) -> None:
    made = imported(tmp_path, written(honest_day()), ROBOTS)
    assert made.not_understood == ()
    found = verdicts(tmp_path)
    assert {judge[:2] for judge, missing in found.items() if missing is None} == {"a2"}
    assert found["i1_local_agent_coherence"] == "RobotDeparted"
    assert found["a4_thin_federation_interface"] == "RequestAccepted"
    assert found["coordination_success"] == "TaskArrived.budget_us"
    assert found["human_intervention"] == "SupervisorCalled"
    assert [offences(tmp_path, judge) for judge in found if judge[:2] in ("i1", "a2")] == [[], []]


def test_a_robot_outside_of_the_fleet_offends_i1(tmp_path: Path) -> None:
    imported(tmp_path, written([*honest_day(), state(200, "t", "underway", robot="r9")]), ROBOTS)
    [found] = offences(tmp_path, "i1_local_agent_coherence")
    assert found.startswith(f"robot/{FLEET}.r9 is named")


def test_a_name_of_a_service_is_still_that_of_a_robot(tmp_path: Path) -> None:
    line = state(1, "t", "underway")
    line["data"]["assigned_to"] = {"group": "", "name": "service/coordination"}
    imported(tmp_path, written([line]))
    assert offences(tmp_path, "a2_coordination_only_federation") == []


def test_a_recording_that_has_grown_gives_the_events_of_the_whole(tmp_path: Path) -> None:
    lines = written(honest_day()).splitlines(keepends=True)
    (tmp_path / "whole").mkdir()
    whole = imported(tmp_path / "whole", b"".join(lines), ROBOTS)
    made = Counter[str]()
    for end in range(1, len(lines) + 1, 4):
        imported(tmp_path, b"".join(lines[:end]), ROBOTS)
    imported(tmp_path, b"".join(lines) + b"\n", ROBOTS)
    made.update(type(one).__name__ for one in Ledger(tmp_path / "out").record("day").events)
    assert {kind: made[kind] for kind in whole.events} == whole.events
    assert made["Observed"] == len(lines)


def test_a_broken_recording_loses_no_record(tmp_path: Path) -> None:
    lines = written(honest_day()).splitlines(keepends=True)
    broken = [lines[0], lines[1][:40] + b"\n", b"\xff\xfe{}\n", b"[1]\n", b'{"type": "alert_update"}\n', *lines[2:]]
    made = imported(tmp_path, b"".join([*broken, lines[3][:-20]]))
    assert made.records == len(lines) + 4
    assert [(one.kind, one.count) for one in made.not_understood] == [(UNREADABLE, 4), ("alert_update", 1)]


def odd_lines() -> Iterator[Line]:
    """Each value of each message of an honest day, replaced by values of every kind."""
    odd: list[Any] = [None, True, -1, 10**30, 1e300, "", "x\x00\u202e", [], [[]], {}, {"a": {}}]

    def places(data: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
        inside = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
        for name, one in inside:
            yield (*path, name)
            yield from places(one, (*path, name))

    for line in [*honest_day(["r1"]), log(1, "t", "no", "error"), fleet(1, r1="t")]:
        for path in places(line):
            for one in odd:
                changed = json.loads(json.dumps(line))
                at = changed
                for name in path[:-1]:
                    at = at[name]
                at[path[-1]] = one
                yield changed


def test_no_value_of_another_kind_than_the_schema_has_stops_an_import(tmp_path: Path) -> None:
    lines = [json.dumps(line).encode() for line in [state(0, "first", "queued"), *odd_lines()]]
    made = imported(tmp_path, b"\n".join(lines), ROBOTS)
    assert made.records == len(lines) > 1_000


def test_no_order_and_no_damage_of_the_lines_stops_an_import() -> None:
    random.seed(7)
    lines = written(honest_day()).splitlines(keepends=True)
    for _ in range(200):
        mixed = random.choices(lines, k=20)
        data = bytearray(b"".join([lines[1], *mixed]))
        for _ in range(5):
            data[random.randrange(len(lines[1]), len(data))] = random.randrange(256)
        adapter = Rmf()
        for record in adapter.read(given(bytes(data))):
            list(adapter.derive(record) or ())


@pytest.mark.parametrize("data", [b"\x89PNG\r\n\x1a\n", b'{"topic": "a"}\n' * (SEARCHED + 5), b"a,b\n1,2\n"])
def test_what_is_no_recording_of_rmf_is_refused_with_what_was_expected(data: bytes) -> None:
    with pytest.raises(
        UsageError, match=r"day: found [\d,]+ records?, the first of them .*expected one message per line, such as"
    ):
        records(data)


def test_an_empty_recording_has_no_records() -> None:
    assert records(b"") == []


@pytest.mark.slow
def test_the_example_of_the_page_tells_who_asked_and_who_cancelled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    blocks = dict(re.findall(r"```(\w+)\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL))
    (tmp_path / "day.jsonl").write_text(blocks["json"])
    (tmp_path / "fleet.toml").write_text(blocks["toml"])
    (tmp_path / "tasks.sql").write_text(blocks["sql"])
    for line in blocks["sh"].splitlines():
        assert run(shlex.split(line)[1:]) == 0
    assert capsys.readouterr().out.splitlines()[-1].split() == [
        *("task/delivery-1", "task_state/canceled", "alice", f"robot/{FLEET}.r1", "carol")
    ]
