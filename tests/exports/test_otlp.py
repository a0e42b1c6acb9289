"""The protocol buffers of OpenTelemetry read the traces, and no event is lost in them."""

import base64
import json
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

import fsar_ledger
from fsar_ledger.api.record import import_records
from fsar_ledger.events.envelope import flat
from fsar_ledger.exports import documents
from fsar_ledger.ledger.rows.codec import LedgerRun
from tests.exports.conftest import Asked
from tests.recycled import asked as asked_of

json_format = pytest.importorskip("google.protobuf.json_format", reason="make test-all installs it")
trace_pb2 = pytest.importorskip("opentelemetry.proto.trace.v1.trace_pb2", reason="make test-all installs it")
IDS = {"traceId", "spanId", "parentSpanId"}


def read(path: Path) -> Any:
    """Read as receivers of OTLP do: ids are hex there, where JSON of protocol buffers has base64."""

    def with_bytes(value: Any) -> Any:
        if isinstance(value, list):
            return [with_bytes(one) for one in value]
        if not isinstance(value, dict):
            return value
        return {
            key: base64.b64encode(bytes.fromhex(one)).decode() if key in IDS else with_bytes(one)
            for key, one in value.items()
        }

    return json_format.ParseDict(with_bytes(json.loads(path.read_text())), trace_pb2.TracesData())


def spans_of(data: Any) -> list[Any]:
    return [span for run in data.resource_spans for scope in run.scope_spans for span in scope.spans]


def values_of(attributes: Any) -> dict[str, Any]:
    return {one.key: getattr(one.value, one.value.WhichOneof("value")) for one in attributes}


@pytest.fixture(scope="module")
def written(ledger: fsar_ledger.Ledger, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Any]:
    out = tmp_path_factory.mktemp("otlp") / "traces.json"
    return out, ledger.export(out, format="otlp")


@pytest.fixture(scope="module")
def data(written: tuple[Path, Any]) -> Any:
    return read(written[0])


def test_every_event_is_one_span_event_with_its_fields(data: Any, asked: Asked) -> None:
    found = Counter(
        (values_of(run.resource.attributes)["service.instance.id"], values_of(event.attributes)["fsar.seq"], event.name)
        for run in data.resource_spans
        for scope in run.scope_spans
        for span in scope.spans
        for event in span.events
    )
    rows = asked("SELECT run_id, seq, split_part(type, '.', 1) AS kind FROM events")
    assert found == Counter((row["run_id"], row["seq"], row["kind"]) for row in rows)


def test_the_fields_of_an_event_are_those_of_its_row(data: Any, asked: Asked) -> None:
    row = asked("SELECT * FROM events WHERE type = 'RequestAdmitted.v1' ORDER BY run_id, seq")[0]
    trace = next(
        run for run in data.resource_spans if values_of(run.resource.attributes)["service.instance.id"] == row["run_id"]
    )
    event = next(
        event
        for span in trace.scope_spans[0].spans
        for event in span.events
        if values_of(event.attributes)["fsar.seq"] == row["seq"]
    )
    found = values_of(event.attributes)
    for name in ("caused_by", "action_id", "requested_by", "executed_by", "outcome", "trust", "may_execute"):
        assert found.get(f"fsar.{name}") == row[name], name
    assert [one.string_value for one in found["fsar.path"].values] == row["path"]
    assert event.time_unix_nano == row["time_us"] * 1_000


def test_there_is_a_span_for_each_run_task_and_action_within_its_parent(data: Any, asked: Asked) -> None:
    (stored,) = asked(
        "SELECT count(DISTINCT run_id) AS invoke_workflow, "
        "count(DISTINCT (run_id, task_id)) FILTER (task_id IS NOT NULL) AS invoke_agent, "
        "count(DISTINCT (run_id, action_id)) FILTER (type = 'ExecutionStarted.v1') AS execute_tool, "
        "count(DISTINCT (run_id, action_id)) FILTER (action_id IS NOT NULL) - execute_tool AS request_tool FROM events"
    )
    assert stored["request_tool"] > 0
    spans = spans_of(data)
    assert Counter(values_of(span.attributes)["gen_ai.operation.name"] for span in spans) == stored
    known = {(span.trace_id, span.span_id): span for span in spans}
    assert len(known) == len(spans)
    assert {(len(trace), len(span)) for trace, span in known} == {(16, 8)}
    for span in spans:
        if span.parent_span_id:
            parent = known[span.trace_id, span.parent_span_id]
            assert parent.start_time_unix_nano <= span.start_time_unix_nano
            assert span.end_time_unix_nano <= parent.end_time_unix_nano
        for event in span.events:
            assert span.start_time_unix_nano <= event.time_unix_nano <= span.end_time_unix_nano


def test_a_cause_in_another_span_is_a_link_to_that_span(data: Any) -> None:
    count = 0
    for run in data.resource_spans:
        spans = run.scope_spans[0].spans
        lies_in = {values_of(event.attributes)["fsar.seq"]: span.span_id for span in spans for event in span.events}
        causes = {
            (values_of(event.attributes)["fsar.seq"], cause)
            for span in spans
            for event in span.events
            if (cause := values_of(event.attributes).get("fsar.caused_by")) is not None
        }
        found = [(values_of(link.attributes), link, span) for span in spans for link in span.links]
        for about, link, span in found:
            assert (about["fsar.seq"], about["fsar.caused_by"]) in causes
            assert (link.trace_id, link.span_id) == (span.trace_id, lies_in[about["fsar.caused_by"]])
        assert len(found) == sum(lies_in[seq] != lies_in[cause] for seq, cause in causes)
        count += len(found)
    assert count > 0


def test_an_action_is_the_execution_of_a_tool_by_an_agent(data: Any, asked: Asked) -> None:
    started = {
        (row["run_id"], row["action_id"]): (row["capability"], row["robot"])
        for row in asked("SELECT * FROM events WHERE type = 'ExecutionStarted.v1' ORDER BY run_id, seq DESC")
    }
    found = {}
    for span in spans_of(data):
        about = values_of(span.attributes)
        if (key := (about["gen_ai.conversation.id"], about.get("gen_ai.tool.call.id"))) in started:
            found[key] = (about["gen_ai.tool.name"], about["gen_ai.agent.name"])
            assert span.name == f"execute_tool {about['gen_ai.tool.name']}"
    capabilities = {key: capability for key, (capability, _) in found.items()}
    assert capabilities == {key: capability for key, (capability, _) in started.items()}
    assert found == started


def test_what_is_imported_again_was_executed_by_whom_the_ledger_says(
    written: tuple[Path, Any], asked: Asked, tmp_path: Path
) -> None:
    made = import_records(str(tmp_path / "again"), [str(written[0])], format="otlp")
    sql = (
        "SELECT robot, capability, count(DISTINCT (run_id, action_id)) AS n FROM events WHERE type = '{}' GROUP BY ALL"
    )
    again = asked_of(made.ledger.path, sql.format("ExecutionStarted.v1"))
    stored = asked(
        "SELECT arg_max(robot, seq) AS robot, any_value(capability) AS capability FROM events "
        "WHERE type = 'ExecutionStarted.v1' GROUP BY run_id, action_id"
    )
    assert Counter({(row["robot"], row["capability"]): row["n"] for row in again}) == Counter(
        (row["robot"], row["capability"]) for row in stored
    )


def test_what_was_refused_has_the_status_of_an_error(data: Any, asked: Asked) -> None:
    (stored,) = asked("SELECT count(*) AS n FROM events WHERE type = 'RequestDenied.v1'")
    assert stored["n"] > 0
    refused = [span for span in spans_of(data) if values_of(span.attributes).get("error.type") == "RequestDenied"]
    assert 0 < len(refused) <= stored["n"]
    assert {span.status.code for span in refused} == {trace_pb2.Status.STATUS_CODE_ERROR}


@pytest.mark.parametrize(
    ("finished", "closed", "is_error"),
    [(None, "failure", True), ("success", "failure", False), ("failure", None, True)],
)
def test_what_ended_as_a_failure_has_the_status_of_an_error(
    tmp_path: Path, finished: str | None, closed: str | None, is_error: bool
) -> None:
    about: dict[str, Any] = {"task_id": "t", "action_id": "t/1"}
    with fsar_ledger.record(tmp_path / "ledger", run="r", observes=["request", "execution"]) as recorder:
        recorder.event("ExecutionStarted", **about, robot="robot/a", capability="c")
        if finished is not None:
            recorder.event("ExecutionFinished", **about, robot="robot/a", result=finished)
        if closed is not None:
            recorder.event("RequestClosed", **about, result=closed)
    fsar_ledger.open_ledger(tmp_path / "ledger").export(tmp_path / "out.json", format="otlp")
    (span,) = [one for one in spans_of(read(tmp_path / "out.json")) if "fsar.action_id" in values_of(one.attributes)]
    assert (span.status.code == trace_pb2.Status.STATUS_CODE_ERROR) is is_error


@pytest.mark.parametrize("failure", [None, 1])
def test_what_was_withdrawn_without_a_failure_has_not_failed_when_it_is_read_again(
    tmp_path: Path, failure: int | None
) -> None:
    about: dict[str, Any] = {"task_id": "t", "action_id": "t/1", "robot": "robot/a"}
    with fsar_ledger.record(tmp_path / "ledger", run="r", observes=["execution", "recovery"]) as recorder:
        recorder.event("ExecutionStarted", **about, capability="c")
        if failure is not None:
            recorder.event("ExecutionFailed", **about, failure=failure, cause="jammed")
        recorder.event("ExecutionWithdrawn", **about, failure=failure)
    fsar_ledger.open_ledger(tmp_path / "ledger").export(tmp_path / "out.json", format="otlp")
    made = import_records(str(tmp_path / "again"), [str(tmp_path / "out.json")], format="otlp").made.events
    failed = {} if failure is None else {"ExecutionFailed": 1}
    assert made == {"ExecutionStarted": 1, "ExecutionWithdrawn": 1, **failed}


def test_a_tool_is_what_was_executed_and_not_what_was_asked_for(tmp_path: Path) -> None:
    about: dict[str, Any] = {"task_id": "t", "action_id": "t/1"}
    with fsar_ledger.record(tmp_path / "ledger", run="r", observes=["execution", "request"]) as recorder:
        recorder.event("RequestIssued", **about, decided_by="robot/b", executed_by="robot/a", capability="carry.linen")
        recorder.event("ExecutionStarted", **about, robot="robot/a", capability="carry.medicine")
    fsar_ledger.open_ledger(tmp_path / "ledger").export(tmp_path / "out.json", format="otlp")
    again = import_records(str(tmp_path / "again"), [str(tmp_path / "out.json")], format="otlp").ledger
    assert asked_of(again.path, "SELECT robot, capability FROM execution_started") == [
        {"robot": "robot/a", "capability": "carry.medicine"}
    ]


def test_what_an_event_ended_is_not_open(runs: list[LedgerRun], tmp_path: Path) -> None:
    """A run up to the end of its first execution, whose step is not yet complete."""
    run = runs[0]
    kinds = [type(event).__name__ for event in run.events]
    end = kinds.index("ExecutionFinished") + 1
    assert "StepCompleted" not in kinds[:end]
    cut = LedgerRun(run.run_id, run.times_us[:end], run.caused_by[:end], run.events[:end])
    documents.write_otlp(tmp_path / "ended.json", [cut])
    spans = [values_of(span.attributes) for span in spans_of(read(tmp_path / "ended.json"))]
    finished = flat(run.events[end - 1])["action_id"]
    assert [span["fsar.open"] for span in spans if span.get("fsar.action_id") == finished] == [False]
    assert [span["fsar.open"] for span in spans if span["gen_ai.operation.name"] == "invoke_agent"] == [True]


def test_an_execution_that_has_not_ended_is_open_until_the_last_event(at_noon: LedgerRun, tmp_path: Path) -> None:
    """And its times are those of the day."""
    told = documents.write_otlp(tmp_path / "open.json", [at_noon])
    root, *spans = spans_of(read(tmp_path / "open.json"))
    noon_ns = 1_772_366_400 * 10**9
    assert {values_of(span.attributes)["fsar.open"] for span in spans} == {True}
    assert not values_of(root.attributes)["fsar.open"]
    assert {span.end_time_unix_nano for span in spans} == {noon_ns + at_noon.times_us[-1] * 1_000}
    assert root.start_time_unix_nano == noon_ns
    assert any(f"{len(spans)} spans had not ended" in note for note in told.notes)


def test_what_the_answer_says_is_what_the_file_has(written: tuple[Path, Any], data: Any) -> None:
    spans = spans_of(data)
    events, links = (sum(len(getattr(span, name)) for span in spans) for name in ("events", "links"))
    said = "\n".join(written[1].notes)
    assert written[1].row_count == events
    for told in (f"{len(spans):,} spans of", f"{events:,} span events", "0 events are in no span", f"{links:,} links"):
        assert told in said


def test_a_run_is_the_same_trace_alone_and_among_all(ledger: fsar_ledger.Ledger, data: Any, tmp_path: Path) -> None:
    ledger.export(tmp_path / "run.json", format="otlp", run=3)
    ledger.export(tmp_path / "again.json", format="otlp", run=3)
    assert (tmp_path / "run.json").read_bytes() == (tmp_path / "again.json").read_bytes()
    (alone,) = read(tmp_path / "run.json").resource_spans
    assert [run for run in data.resource_spans if run == alone] == [alone]
