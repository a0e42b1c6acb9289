"""Events as lines: each that is right is on record at once, each that is wrong is refused by number and field."""

import io
import json
import sys
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec
import pytest

from fsar_ledger import exports
from fsar_ledger.api.ledger import Ledger
from fsar_ledger.base.errors import UsageError, WriteFailed
from fsar_ledger.cli.app import run
from fsar_ledger.events.source import Observed
from fsar_ledger.sources import columns
from fsar_ledger.sources.columns import event_of, parse_line, tell
from fsar_ledger.sources.recorder import Recorder

STARTED = {"type": "ExecutionStarted", "task_id": "t", "action_id": "t/1", "robot": "robot/A1", "capability": "pick"}
ACCEPTED = {"type": "RequestAccepted", "task_id": "t", "action_id": "t/1", "decided_by": "robot/A1"}
OBSERVED = {"type": "Observed", "source": "plc", "kind": "door/open"}
TYPES = ("ExecutionStarted", "RequestAccepted")


def line(told: dict[str, Any], **more: Any) -> bytes:
    return json.dumps(told | more).encode() + b"\n"


def without(told: dict[str, Any], name: str) -> dict[str, Any]:
    return {key: one for key, one in told.items() if key != name}


@pytest.fixture
def recorder(tmp_path: Path) -> Iterator[Recorder]:
    with Recorder(tmp_path / "out", run="n", observes=TYPES) as one:
        yield one


def refused(recorder: Recorder, data: bytes) -> str:
    """What is said of this line, between two that are right and are recorded."""
    events, found = tell(recorder, io.BytesIO(line(STARTED) + data.rstrip(b"\n") + b"\n" + line(STARTED)))
    assert (events, list(found)) == (2, [2])
    return found[2]


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"not json", "JSON is malformed"),
        (b"\xff\xfe", "expected a JSON object"),
        (b"[" * 100_000, "expected a JSON object"),
        (b"[1]", "expected a JSON object"),
        (b'{"a": 1', "expected a JSON object"),
        (b"{}", "field type: found null, expected an event type"),
        (line({"type": ["x"]}), 'field type: found ["x"]'),
        (line({"type": "ExecutionStartet"}), "did you mean ExecutionStarted?"),
        (line(STARTED, type="ExecutionStarted.v9"), "expected an event type, ExecutionStarted or ExecutionStarted.v1"),
        (line({"type": "RunStarted"}), "field type: found RunStarted"),
        (
            line({"type": "RunStarted"}),
            "found RunStarted, expected an event type that a recorder does not add by itself",
        ),
        (line({"type": "SourceClosed"}), "expected an event type that a recorder does not add by itself"),
        (line({"type": "TaskArrived", "task_id": "t", "budget_us": -5}), "field budget_us: found -5 in TaskArrived"),
        (
            line(
                {"type": "PolicyWindowOpened", "robot": "robot/a", "scope": "local", "window": "w", "outcome": "allow"}
            ),
            "field outcome: found allow in PolicyWindowOpened, expected review or deny",
        ),
        (
            line({**without(ACCEPTED, "type"), "type": "RequestAdmitted", "outcome": "deny"}),
            "field outcome: found deny in RequestAdmitted, expected allow or review: a request that is not allowed is "
            "recorded as RequestDenied",
        ),
        (line({"type": "RunContinued"}), "expected an event type that a recorder does not add by itself"),
        (
            line({"type": "TaskCompleted", "task_id": "t"}),
            "field type: found TaskCompleted, expected an",
        ),
        (
            line(STARTED, robt="x"),
            "field robt: found it in ExecutionStarted, which has no such field; did you",
        ),
        (line(without(STARTED, "robot")), "field robot: found none, expected one in ExecutionStarted"),
        (line(without(STARTED, "task_id")), "field task_id: found none, expected one in ExecutionStarted"),
        (line(STARTED, capability=5), "field capability: Expected `str`, got `int`"),
        (line(STARTED, action_id=None), "field action_id: "),
        (line(STARTED, ends_us=10**18), "field ends_us: found 1000000000000000000, expected at most 2^53 - 1"),
        (line(STARTED, ends_us=1.5), "field ends_us: Expected `int"),
        (
            line(STARTED, capability="a\x07"),
            "field capability: found 'a\\x07', expected characters that can",
        ),
        (line(ACCEPTED, path="robot/A1"), "field path: Expected `array`, got `str`"),
        (line(ACCEPTED, path=[1]), "field path: Expected `str`, got `int`"),
        (line(OBSERVED, names=["a"], texts=[]), "field texts: found [], expected one for each of `names`"),
        (line(OBSERVED, objects=["a"]), "field qualifiers: found null, expected one for each of `objects`"),
        (line(OBSERVED, names=5), "field names: Expected `array`, got `int`"),
        (line(STARTED, time=20260301), "field time: found 20260301, expected a time such as 2026-03-01T10:00:00Z"),
        (line(STARTED, time="noon"), "field time: found noon"),
        (line(STARTED, time="1710010112345"), "field time: found 1710010112345, expected a time such as"),
        (line(STARTED, time="0001-01-01T00:00:00+14:00"), "field time: found 0001-01-01T00:00:00+14:00"),
        (line(STARTED, time="2001-01-01T00:00:00Z"), "field time: found 2001-01-01T00:00:00+00:00"),
        (
            line(STARTED, time="2001-01-01T00:00:00Z"),
            "keep the time of the source in an observation (`source_time_us`)",
        ),
        (line(STARTED, caused_by=True), "field caused_by: found true, expected the number of an earlier event"),
        (line(STARTED, caused_by="1"), "field caused_by: found 1, expected the number"),
        (line(STARTED, caused_by=99), "field caused_by: found 99, expected the number"),
        (line(STARTED, caused_by=-1), "field caused_by: found -1, expected the number"),
        (
            line(STARTED).replace(b"{", b'{"action_id": "t/2", '),
            "field action_id: found it more than once, expected it once",
        ),
        (line(STARTED).replace(b"{", b'{"type": "Observed", '), "field type: found it more than once"),
        *(
            (line(STARTED, **{name: ""}), f"field {name}: found an empty text in ExecutionStarted, expected a name")
            for name in ("robot", "task_id", "action_id", "requested_by")
        ),
    ],
)
def test_a_wrong_line_is_refused_by_number_and_field_and_the_record_goes_on(
    recorder: Recorder, data: bytes, said: str
) -> None:
    assert said in refused(recorder, data)


def test_a_line_that_is_too_long_is_one_line(recorder: Recorder, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(columns, "MAX_LINE", 200)
    for size in (201, 202, 401, 402, 1_000):
        assert refused(recorder, b"x" * size) == "found more than 200 bytes, expected one event per line"
    why = "found more than 200 bytes, expected one event per line"
    assert tell(recorder, io.BytesIO(b"x" * 1_000)) == (0, {1: why})


def test_blank_lines_are_counted_and_nothing_else(recorder: Recorder) -> None:
    assert tell(recorder, io.BytesIO(b"\n  \r\n" + line(STARTED) + b"\nno\n")) == (1, {5: refused(recorder, b"no")})


def test_a_line_without_a_time_or_a_cause_says_neither() -> None:
    assert parse_line(line(STARTED))[1:] == (None, None)


@pytest.fixture
def far_from_utc(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    with monkeypatch.context() as patch:
        patch.setenv("TZ", "Asia/Tokyo")
        time.tzset()
        yield
    time.tzset()


@pytest.mark.usefixtures("far_from_utc")
def test_a_time_without_a_zone_is_utc() -> None:
    when = datetime(2026, 3, 1, 10, tzinfo=UTC)
    for text in ("2026-03-01T10:00:00", "2026-03-01T10:00:00Z", "2026-03-01T12:00:00+02:00"):
        assert parse_line(line(STARTED, time=text))[1] == when


def test_a_type_may_have_its_version() -> None:
    assert parse_line(line(STARTED, type="ExecutionStarted.v1")) == parse_line(line(STARTED))


def test_what_may_be_unknown_is_and_a_decision_has_the_path_of_its_decider() -> None:
    event: Any = parse_line(line(ACCEPTED))[0]
    assert (event.principals.requested_by, event.principals.path) == (None, ("robot/A1",))
    event = parse_line(line(without(ACCEPTED, "decided_by")))[0]
    assert (event.principals.decided_by, event.principals.path) == (None, ())


def test_a_path_that_is_no_list_is_named() -> None:
    with pytest.raises(UsageError, match="field path: "):
        parse_line(line(ACCEPTED, path={}))


def test_the_command_names_what_it_refused_and_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Stdin:
        buffer = io.BytesIO(line(STARTED) + line(STARTED, capability=5) + line(OBSERVED))

    monkeypatch.setattr(sys, "stdin", Stdin())
    out = tmp_path / "out"
    assert run(["record", str(out), "--run", "n", "--observes", "ExecutionStarted"]) == 1
    assert capsys.readouterr().out.splitlines() == [
        f"{out}: run n, 2 events recorded, 1 refused",
        "line 2: field capability: Expected `str`, got `int` in ExecutionStarted",
    ]
    kept = Ledger(out).record("n").events
    assert [one.source for one in kept if isinstance(one, Observed)] == ["plc"]
    assert run(["verify", str(out)]) == 0


def test_where_the_disk_is_full_it_is_said_with_which_line_to_go_on(
    recorder: Recorder, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = b"".join(b'{"type": "Observed", "source": "s", "kind": "k%d"}\n' % number for number in range(5))
    recorder.observed("before")
    put = Recorder.event

    def until_full(self: Recorder, event: Any, **told: Any) -> int:
        if event.kind == "k3":
            raise WriteFailed("disk: no space")
        return put(self, event, **told)

    monkeypatch.setattr(Recorder, "event", until_full)
    with pytest.raises(WriteFailed, match="no space; 3 events of the lines before line 4 are on disk"):
        tell(recorder, io.BytesIO(lines))


def test_an_event_from_python_is_no_admission_that_denies_either(tmp_path: Path) -> None:
    columns = {name: one for name, one in ACCEPTED.items() if name != "type"}
    with Recorder(tmp_path / "out", observes=["RequestAdmitted"]) as one:
        denied = msgspec.structs.replace(event_of("RequestAdmitted", {**columns, "outcome": "allow"}), outcome="deny")
        with pytest.raises(UsageError, match="found deny in RequestAdmitted"):
            one.event(denied)


@pytest.mark.parametrize(
    ("kind", "column", "outcome"),
    [
        ("ExecutionFinished", "result", "partial"),
        ("RequestClosed", "result", "failure"),
        ("SupervisorResponded", "approves", False),
    ],
)
def test_how_something_ended_is_told_or_the_event_is_refused(kind: str, column: str, outcome: object) -> None:
    """Left out, it would have ended well, and a human would have approved."""
    named = {"task_id": "t", "action_id": "t/1"} | ({"robot": "robot/A1"} if kind == "ExecutionFinished" else {})
    named |= {"purpose": "review"} if kind == "SupervisorResponded" else {}
    for tag in (kind, f"{kind}.v1"):
        assert getattr(event_of(tag, {**named, column: outcome}), column) == outcome
        with pytest.raises(UsageError, match=f"field {column}: found none, expected one in {kind}"):
            event_of(tag, named)


@pytest.mark.parametrize(
    ("kind", "column", "meant"),
    [
        ("TaskArrived", "robot", "robot/A1"),
        ("ExecutionStarted", "executed_by", "robot/A1"),
        ("ExecutionStarted", "supervised_by", "supervisor/A1"),
        ("RobotJoined", "supervisor", "supervisor/A1"),
        ("RequestAccepted", "decided_by", "robot/A1"),
    ],
)
def test_who_is_named_without_a_kind_is_nobody_of_the_fleet_and_is_refused(kind: str, column: str, meant: str) -> None:
    """It would be a stranger to every judge, and a person's name would stand on record as it is."""
    named = {"task_id": "t", "action_id": "t/1", "robot": "robot/A1", "capability": "pick", "role": "a"}
    known = {field.name for field in columns.LAYOUT_OF[kind].fields}
    named = {name: one for name, one in named.items() if name in known}
    with pytest.raises(UsageError, match=f"field {column}: found A1 in {kind}, expected a kind .* such as {meant}$"):
        event_of(kind, {**named, column: "A1"})
    for principal in (meant, *([None, "coordinator"] if column.endswith("_by") else [])):
        event_of(kind, {**named, column: principal})


def test_every_column_that_names_a_principal_asks_for_a_kind_but_that_of_who_may_be_anybody() -> None:
    assert exports.NAMING.keys() - exports._COLUMNS.keys() - {"issued_by"} == columns.PRINCIPALS


@pytest.mark.parametrize(
    ("kind", "column", "named"),
    [
        ("InternalHandoff", "receiver", {"sender": "agent/A1/planning", "receiver": "A1"}),
        ("TaskPlanned", "robots", {"task_id": "t", "robots": ["robot/A1", "A1"], "ready_us": 1}),
        ("OwnStepDecided", "path", {"task_id": "t", "capability": "c", "path": ["A1", "robot/A1"]}),
    ],
)
def test_one_of_two_and_one_of_several_are_named_by_a_kind_too(kind: str, column: str, named: dict[str, Any]) -> None:
    known = {"robot": "robot/A1", "executed_by": "robot/A1", **named}
    fields = {field.name for field in columns.LAYOUT_OF[kind].fields}
    with pytest.raises(UsageError, match=f"field {column}: found A1 in {kind}, expected a kind and a name"):
        event_of(kind, {name: one for name, one in known.items() if name in fields})
