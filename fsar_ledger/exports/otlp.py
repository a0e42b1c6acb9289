"""Runs as traces: OTLP in JSON (opentelemetry.io/docs/specs/otlp), for whatever shows spans.

A run is one trace, because what its tasks share (windows, outages, the order of supervisors) would be lost in traces of
tasks alone. Its root span has a child for each task, which has one for each action. An event is a span event of its
action, else of its task, else of the run, with all of its fields; a cause that lies in another span is a link, too.
Attributes have the names of OpenTelemetry's conventions for generative AI where these fit: a robot is an agent, a task
its invocation, an action the execution of a tool, which is the capability.
"""

from collections.abc import Iterable, Iterator
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import flat
from fsar_ledger.ledger.rows.codec import LedgerRun

from . import TOLD, Written, elements, epoch_us

INTERNAL = 1
"""SPAN_KIND_INTERNAL."""
ERROR = 2
"""STATUS_CODE_ERROR."""
FAILURES = frozenset({"RequestDenied", "RequestUnanswered", "ExecutionWithdrawn", "TaskAbandoned"})
"""The types of events that end a task or an action without its result."""
ENDS = FAILURES | {"ExecutionFinished", "RequestClosed", "StepCompleted", "TaskCompleted"}
"""All types of events that end a task or an action."""


class _Key(NamedTuple):
    """What a span is about: a run (whose `name` is empty), a task or an action."""

    kind: str
    name: str


_RUN = _Key("run", "")


class _Span(msgspec.Struct):
    """What is known of a span so far: places of its first and last event, what ended it, and its own events.

    `about` has what the first event says that says it at all.
    """

    parent: _Key | None
    first: int
    last: int = 0
    ended_by: str | None = None
    own: list[int] = []
    about: dict[str, str] = {}


class _Counts(msgspec.Struct):
    """What was written: spans, those that nothing ended, span events, links."""

    spans: int = 0
    open: int = 0
    events: int = 0
    links: int = 0


def write(out: Path, runs: Iterable[LedgerRun]) -> Written:
    """Write a trace for each run to this path; memory holds one of them. Raises: OSError, UsageError as `epoch_us`."""
    counts = _Counts()
    with out.open("wb") as file:
        file.write(b'{"resourceSpans":[')
        file.writelines(elements(_resource(run, counts) for run in runs))
        file.write(b"]}\n")
    return Written(
        counts.events,
        (
            f"{counts.spans:,} spans of runs, tasks and actions, each from the first to the last of its events",
            f"{counts.events:,} span events, one for each event; 0 events are in no span",
            f"{counts.open:,} spans had not ended and are marked fsar.open",
            f"{counts.links:,} links, one for each cause in another span",
            TOLD,
        ),
    )


def _resource(run: LedgerRun, counts: _Counts) -> dict[str, Any]:
    """Return the spans of a run, under a resource that says which run it is."""
    trace = sha256(run.run_id.encode() + b"\0" + msgspec.json.encode(run.events[0])).hexdigest()[:32]
    about = {f"fsar.{name}": value for name, value in flat(run.events[0]).items() if name != "observes"}
    resource = {"service.name": "fsar-ledger", "service.instance.id": run.run_id, **about}
    return {
        "resource": {"attributes": _attributes(resource)},
        "scopeSpans": [{"scope": {"name": "fsar_ledger"}, "spans": list(_spans(run, trace, counts))}],
    }


def _grouped(run: LedgerRun) -> tuple[dict[_Key, _Span], list[_Key]]:
    """Return the spans of a run, parents first, and for each event the one that it is an event of."""
    spans = {_RUN: _Span(None, 0)}
    keys = []
    for seq, event in enumerate(run.events):
        columns = flat(event)
        task, action = (columns.get(name) for name in ("task_id", "action_id"))
        key = _RUN
        for kind, name in (("task", task), ("action", action)):
            if name is not None:
                key, parent = _Key(kind, name), key
                spans.setdefault(key, _Span(parent, seq))
                _follow(spans[key], event, columns, seq)
        spans[_RUN].last = seq
        spans[key].own.append(seq)
        if type(event).__name__ in ENDS:
            spans[key].ended_by = type(event).__name__
        keys.append(key)
    return spans, keys


def _follow(span: _Span, event: Event, columns: dict[str, Any], seq: int) -> None:
    span.last = seq
    if type(event).__name__ == "ExecutionStarted":
        span.about["executor"] = columns["robot"]
    for name in ("capability", "robot", "requested_by", "executed_by"):
        if columns.get(name) is not None:
            span.about.setdefault(name, columns[name])


def _spans(run: LedgerRun, trace: str, counts: _Counts) -> Iterator[dict[str, Any]]:
    spans, keys = _grouped(run)
    start_us = epoch_us(run.run_id, getattr(run.events[0], "epoch", None))
    times = [f"{(start_us + time_us) * 1_000}" for time_us in run.times_us]
    ids = {key: sha256(f"{trace} {key.kind} {key.name}".encode()).hexdigest()[:16] for key in spans}
    for key, span in spans.items():
        is_open = span.ended_by is None and key != _RUN
        causes = [(seq, cause) for seq in span.own if (cause := run.caused_by[seq]) is not None and keys[cause] != key]
        name, about = _named(run, key, span)
        found = {
            "traceId": trace,
            "spanId": ids[key],
            "name": name,
            "kind": INTERNAL,
            "startTimeUnixNano": times[span.first],
            "endTimeUnixNano": times[-1 if is_open else span.last],
            "attributes": _attributes({**about, "fsar.open": is_open}),
            "events": [_event(run, seq, times[seq]) for seq in span.own],
            "links": [
                {
                    "traceId": trace,
                    "spanId": ids[keys[cause]],
                    "attributes": _attributes({"fsar.seq": seq, "fsar.caused_by": cause}),
                }
                for seq, cause in causes
            ],
        }
        if span.parent is not None:
            found["parentSpanId"] = ids[span.parent]
        if span.ended_by in FAILURES:
            found["status"] = {"code": ERROR, "message": span.ended_by}
        counts.spans += 1
        counts.open += is_open
        counts.events += len(span.own)
        counts.links += len(causes)
        yield found


def _named(run: LedgerRun, key: _Key, span: _Span) -> tuple[str, dict[str, Any]]:
    """Return the name of a span, and its attributes by the conventions and by what the events say."""
    about: dict[str, Any] = {"gen_ai.conversation.id": run.run_id}
    if key.kind == "run":
        workflow = getattr(run.events[0], "scenario", None)
        name, operation = workflow, "invoke_workflow"
        about["gen_ai.workflow.name"] = workflow
    elif key.kind == "task":
        name, operation = span.about.get("robot"), "invoke_agent"
        about |= {"gen_ai.agent.name": name, "fsar.task_id": key.name}
    else:
        name, operation = span.about.get("capability"), "execute_tool"
        agent = next((span.about[one] for one in ("executor", "executed_by", "robot") if one in span.about), None)
        about |= {"gen_ai.tool.name": name, "gen_ai.tool.call.id": key.name, "gen_ai.agent.name": agent}
        about |= {"fsar.action_id": key.name, "fsar.requested_by": span.about.get("requested_by")}
    failed = {"error.type": span.ended_by} if span.ended_by in FAILURES else {}
    return f"{operation} {name or key.name}".strip(), {"gen_ai.operation.name": operation, **about, **failed}


def _event(run: LedgerRun, seq: int, time: str) -> dict[str, Any]:
    fields = {f"fsar.{name}": value for name, value in flat(run.events[seq]).items()}
    attributes = _attributes({"fsar.seq": seq, "fsar.caused_by": run.caused_by[seq], **fields})
    return {"timeUnixNano": time, "name": type(run.events[seq]).__name__, "attributes": attributes}


def _attributes(values: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the values that there are as OTLP has them: integers as text, since JSON readers may round them."""
    return [{"key": key, "value": _value(value)} for key, value in values.items() if value is not None]


def _value(value: Any) -> dict[str, Any]:
    if isinstance(value, bool):
        return {"boolValue": value}
    if isinstance(value, int):
        return {"intValue": f"{value}"}
    if isinstance(value, tuple):
        return {"arrayValue": {"values": [_value(one) for one in value]}}
    return {"stringValue": value}
