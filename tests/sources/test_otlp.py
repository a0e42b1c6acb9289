"""A recording of spans becomes observations, and requests and executions of agents; nobody is accused by mistake."""

from collections.abc import Callable, Iterable
from io import BytesIO
from pathlib import Path
from typing import Any

import msgspec
import pytest

from fsar_ledger.api.ledger import Ledger
from fsar_ledger.api.record import ImportResult, import_records
from fsar_ledger.base.errors import UsageError
from fsar_ledger.sources import otlp
from fsar_ledger.sources.adapter import MAX_LINE, Input, Record
from tests.quick import few
from tests.recycled import asked
from tests.sources.importing import is_good
from tests.sources.otel import Line, attributes, batch, honest_day, snake, span
from tests.sources.pages import printed_otherwise
from tests.sources.vda import written

FLEET = '[robots]\nplanner = "planner"\npicker = "picker"\n'
Import = Callable[..., ImportResult]


@pytest.fixture
def imported(tmp_path: Path) -> Import:
    """Import these lines, or bytes, with the fleet of planner and picker."""

    def made(lines: Iterable[Line] | bytes, name: str = "ledger") -> ImportResult:
        log, fleet = tmp_path / "day.jsonl", tmp_path / "fleet.toml"
        log.write_bytes(lines if isinstance(lines, bytes) else written(lines))
        fleet.write_text(FLEET)
        return import_records(str(tmp_path / name), [str(log)], format="otlp", fleet=str(fleet))

    return made


def typed(result: ImportResult) -> list[dict[str, Any]]:
    """The events of the run that are no records, without the beginning."""
    rows = asked(result.ledger.path, "SELECT * FROM events ORDER BY seq")
    return [row for row in rows if row["action_id"] is not None]


def said(result: ImportResult) -> list[tuple[str, ...]]:
    """Each typed event: type, span, requester, executor or robot."""
    return [
        (
            row["type"].removesuffix(".v1"),
            row["action_id"][-1],
            *(str(row[name]).removeprefix("robot/") for name in ("requested_by", "executed_by")),
        )
        for row in typed(result)
    ]


def verdicts(ledger: Ledger) -> tuple[set[str], set[str], dict[str, str]]:
    """The invariants that hold, that are broken, and what the others lack."""
    rows = {row.invariant[:2]: row for row in ledger.audit().rows}
    return (
        {name for name, row in rows.items() if row.holds},
        {name for name, row in rows.items() if row.holds is False},
        {name: row.not_observed or "" for name, row in rows.items() if row.holds is None},
    )


def test_an_agent_that_invokes_another_asks_it_and_closes_when_it_ended(imported: Import) -> None:
    assert said(imported(honest_day(["1"]))) == [
        ("ExecutionStarted", "3", "picker", "picker"),
        ("ExecutionFinished", "3", "picker", "picker"),
        ("ExecutionStarted", "5", "picker", "picker"),
        ("ExecutionFailed", "5", "None", "None"),
        ("ExecutionWithdrawn", "5", "None", "None"),
        ("RequestIssued", "2", "planner", "picker"),
        ("RequestAccepted", "2", "planner", "picker"),
        ("ExecutionStarted", "2", "planner", "picker"),
        ("ExecutionFinished", "2", "planner", "picker"),
        ("RequestClosed", "2", "planner", "picker"),
        ("ExecutionStarted", "1", "None", "planner"),
        ("ExecutionFinished", "1", "None", "planner"),
    ]


def test_the_message_of_a_status_is_the_cause_of_a_failure(imported: Import) -> None:
    (failed,) = (row for row in typed(imported(honest_day(["1"]))) if row["type"] == "ExecutionFailed.v1")
    assert (failed["cause"], failed["robot"]) == ("too heavy", "robot/picker")


def test_what_follows_does_not_depend_on_the_order_of_arrival(imported: Import) -> None:
    lines = list(honest_day(["1"]))
    assert sorted(said(imported(lines))) == sorted(said(imported(lines[::-1], "other")))


@pytest.mark.slow
def test_names_of_protobuf_and_one_document_of_many_lines_say_the_same(imported: Import, tmp_path: Path) -> None:
    import json

    expected = said(imported(honest_day(["1"])))
    assert said(imported(snake(list(honest_day(["1"]))), "snake")) == expected
    whole = {"resourceSpans": [one for line in honest_day(["1"]) for one in line["resourceSpans"]]}
    assert said(imported(json.dumps(whole, indent=2).encode(), "whole")) == expected


def test_a_document_of_which_a_line_is_longer_than_lines_may_be_is_read_whole() -> None:
    """As an export of a run with many events is."""
    first, *others = [one for line in honest_day(["1"]) for one in line["resourceSpans"]]
    first["scopeSpans"][0]["spans"][0]["attributes"] += attributes({"said": "x" * (MAX_LINE + 1)})
    document = b'{"resourceSpans":[\n' + b",\n".join(map(msgspec.json.encode, [first, *others])) + b"]}\n"
    found = list(otlp.Otlp().read([Input("day", None, BytesIO(document))]))
    assert [record.kind for record in found] == ["execute_tool", "chat", "execute_tool", "invoke_agent", "invoke_agent"]


def test_a_call_of_a_remote_agent_and_what_that_agent_tells_are_one_request(imported: Import) -> None:
    server = span("4", "3", "invoke_agent", agent="picker", kind=2)
    between = span("3", "2", "http", kind=3)
    call = span("2", "1", "invoke_agent", agent="picker", kind=3)
    planner = span("1", None, "invoke_agent", agent="planner")
    told = said(imported([batch(server), batch(between), batch(call), batch(planner)]))
    assert [kind for kind, action, *_ in told if action == "2"] == [
        "RequestIssued",
        "RequestAccepted",
        "ExecutionStarted",
        "ExecutionFinished",
        "RequestClosed",
    ]


def test_a_tool_below_a_call_is_executed_by_the_agent_that_was_called(imported: Import) -> None:
    tool = span("3", "2", "execute_tool", tool="grasp")
    call = span("2", "1", "invoke_agent", agent="picker", kind=3)
    told = said(imported([batch(tool, call, span("1", None, "invoke_agent", agent="planner"))]))
    assert told[:2] == [("ExecutionStarted", "3", "picker", "picker"), ("ExecutionFinished", "3", "picker", "picker")]


def test_nobody_knows_whether_an_agent_took_up_a_call_that_only_the_caller_saw(imported: Import) -> None:
    lines = [
        batch(span("2", "1", "invoke_agent", agent="picker", kind=3), span("1", None, "invoke_agent", agent="planner"))
    ]
    assert [kind for kind, action, *_ in said(imported(lines)) if action == "2"] == ["RequestIssued", "RequestClosed"]


def test_spans_without_agents_are_observed_and_nothing_follows(imported: Import) -> None:
    made = imported([batch(span("1", None, "execute_tool", tool="grep"), span("2", "9", "invoke_agent", agent="lost"))])
    assert (made.made.records, made.made.events, made.made.not_understood) == (2, {}, ())


@pytest.mark.parametrize("error", ["RequestDenied", "RequestUnanswered"])
def test_what_nobody_took_up_is_no_execution(imported: Import, error: str) -> None:
    why: dict[str, Any] = {"failure": error, "error.type": error}
    found = imported(
        [
            batch(
                span("3", "1", "execute_tool", tool="lift", **why),
                span("2", "1", "invoke_agent", agent="picker", **why),
                span("1", None, "invoke_agent", agent="planner"),
            )
        ]
    )
    assert sorted(said(found)) == [
        ("ExecutionFinished", "1", "None", "planner"),
        ("ExecutionStarted", "1", "None", "planner"),
        ("RequestClosed", "2", "planner", "picker"),
        ("RequestIssued", "2", "planner", "picker"),
    ]


def test_a_task_of_our_own_export_is_no_execution(imported: Import) -> None:
    task: dict[str, Any] = {"fsar.task_id": "t"}
    found = imported(
        [batch(span("1", None, "invoke_agent", agent="picker", **task), span("2", "1", "execute_tool", tool="lift"))]
    )
    assert [one[:2] for one in said(found)] == [("ExecutionStarted", "2"), ("ExecutionFinished", "2")]


def test_a_span_that_is_sent_again_is_told_once(imported: Import) -> None:
    lines = list(honest_day(["1"]))
    again = imported([*lines, *lines], "twice")
    assert said(again) == said(imported(lines))
    assert again.made.records == 10


def test_a_recording_that_has_grown_says_what_it_says_at_once(imported: Import) -> None:
    lines = list(honest_day())
    imported(lines[:3])
    grown = imported(lines)
    assert (grown.made.before, grown.made.records) == (5, 10)
    assert said(grown) == said(imported(lines, "other"))


@pytest.mark.slow
def test_an_honest_fleet_offends_nothing_and_what_is_not_recorded_is_named(imported: Import) -> None:
    holding, broken, lacking = verdicts(imported(honest_day()).ledger)
    assert (holding, broken) == ({"a2"}, set())
    assert lacking["a4"] == "RequestAccepted.decided_by"
    assert (lacking["i1"], lacking["i2"]) == ("RobotDeparted", "AuthorityRevoked, RequestAccepted.decided_by")
    assert all(lacking.values())


@pytest.mark.parametrize(("agent", "broken"), [("stranger", {"i1"}), ("service/registry", {"a2"})])
def test_an_offence_is_found(imported: Import, agent: str, broken: set[str]) -> None:
    lines = [*honest_day(), batch(span("1", None, "invoke_agent", trace="9", agent=agent))]
    assert verdicts(imported(lines).ledger)[1] == broken


def test_what_cannot_be_read_is_on_record_and_the_rest_is_read(imported: Import) -> None:
    lines = written(honest_day(["1"])).splitlines(keepends=True)
    broken = [lines[0][:80] + b"\n", b"\xff\xfe{}\n", b"[1]\n", b'{"resourceSpans":[{"scopeSpans":[7]}]}\n', b"\n"]
    made = imported(b"".join([*broken, *lines]))
    assert [(one.kind, one.count, one.first) for one in made.made.not_understood] == [("unreadable", 4, 1)]
    assert made.made.records == 9


ODD: list[Line] = [
    {"spanId": None},
    {"traceId": 7},
    {"attributes": {"a": 1}},
    {"attributes": [None, {"key": 1}, {"key": "gen_ai.agent.name", "value": {"arrayValue": {}}}]},
    {"links": 7},
    {"links": [7, {"spanId": []}]},
    {"status": []},
    {"status": {"code": "STATUS_CODE_ERROR"}},
    {"kind": "SPAN_KIND_CLIENT"},
    {"kind": []},
    {"name": {}},
    {"startTimeUnixNano": "9" * 30, "endTimeUnixNano": -1},
    {"endTimeUnixNano": 1.5},
    {"parentSpanId": "b" * 15 + "1"},
    {"name": "\x00\n\x1b[31m"},
    {"attributes": attributes({"gen_ai.operation.name": "invoke_agent", "gen_ai.agent.name": "\x00\n\u202e"})},
]


@pytest.mark.parametrize("odd", few(ODD, ODD[::5]))
def test_a_span_with_odd_fields_is_a_record(imported: Import, odd: Line) -> None:
    made = imported([batch(span("1", None, "invoke_agent", agent="planner") | odd), *honest_day(["2"])])
    assert made.made.records == 6


@pytest.mark.parametrize(
    "never",
    [
        {"endTimeUnixNano": "0"},
        {"endTimeUnixNano": None},
        {"attributes": [{"key": "fsar.open", "value": {"boolValue": True}}]},
    ],
)
def test_a_span_that_has_not_ended_has_no_success(imported: Import, never: Line) -> None:
    asked, begun = span("1", None, "invoke_agent", agent="planner"), span("2", "1", "invoke_agent", agent="picker")
    begun |= {**never, "attributes": begun["attributes"] + never.get("attributes", [])}
    found = said(imported([batch(begun, asked)]))
    assert sorted((kind, action) for kind, action, *_ in found) == [
        ("ExecutionFinished", "1"),
        ("ExecutionStarted", "1"),
        ("ExecutionStarted", "2"),
        ("RequestAccepted", "2"),
        ("RequestIssued", "2"),
    ]


def test_metrics_and_logs_are_on_record_as_not_understood(imported: Import) -> None:
    made = imported([{"resourceMetrics": []}, {"resourceLogs": []}, *honest_day(["1"])])
    assert [one.kind for one in made.made.not_understood] == ["resourceLogs", "resourceMetrics"]


@pytest.mark.parametrize("text", [b"hello\n", b'{"a": 1}\n', b"\x89PNG\r\n", b"[]\n" * 200])
def test_another_format_is_refused_with_what_was_found_and_no_run_is_begun(
    imported: Import, tmp_path: Path, text: bytes
) -> None:
    with pytest.raises(UsageError, match=r"day\.jsonl.*: found .*, expected lines of OTLP JSON"):
        imported(text)
    assert not (tmp_path / "ledger").exists()


def test_memory_of_spans_is_bounded_and_who_waits_too_long_was_asked_by_nobody_known(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(otlp, "WAITING_SPANS", 2)
    monkeypatch.setattr(otlp, "KEPT_SPANS", 3)
    adapter = otlp.Otlp()
    spans = [span(f"{at}", f"9{at}", "invoke_agent", agent=f"a{at}") for at in range(6)]
    told = [list(adapter.derive(one) or ()) for one in read(adapter, [batch(*spans)])]
    assert [len(one) for one in told] == [0, 0, 2, 2, 2, 2]
    assert {getattr(one.event, "on_behalf_of", None) for each in told for one in each} == {None}
    assert len(adapter._owners) <= 3


def read(adapter: otlp.Otlp, lines: Iterable[Line]) -> list[Record]:
    return list(adapter.read([Input("day", None, BytesIO(written(lines)))]))


def test_the_command_of_the_page_prints_what_the_page_shows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "day.jsonl").write_bytes(written(honest_day()))
    (tmp_path / "fleet.toml").write_text(FLEET)
    assert printed_otherwise("otlp.md", capsys) == []


@pytest.mark.slow
def test_a_trace_file_that_was_read_while_a_line_was_written_is_taken_further(imported: Import) -> None:
    whole = written(honest_day())
    for end in (len(whole) // 3, len(whole) // 2, len(whole)):
        grown = imported(whole[:end], "grown")
    once = imported(whole, "once")
    assert (grown.made.records, grown.made.events) == (once.made.records, once.made.events)
    assert said(grown) == said(once)
    assert is_good(grown.ledger.path)
