"""Runs as one document of JSON: OCEL 2.0 (ocel-standard.org), and traces as OTLP (opentelemetry.io/docs/specs/otlp).

In a log of OCEL, for process mining, an event that names an object is an event; what it names are its objects, each
with its role as the qualifier of the relation. All names begin with the number of the run, since robots of two runs are
not the same. The rest of an event's fields are its attributes: lists as JSON text, times in microseconds of run time.

In OTLP, for programs that show spans, a run is one trace, because what its tasks share (windows, outages, the order of
supervisors) would be lost in traces of tasks alone. Its root span has a child for each task, which has one for each
action. An event is a span event of its action, else of its task, else of the run, with all of its fields; a cause in
another span is a link, too. Attributes have the names of OpenTelemetry's conventions for generative AI where these
fit: a robot is an agent, a task its invocation, an action the execution of a tool, which is the capability. An action
without an execution on record, such as one that was denied, is `request_tool`, a name of our own.
"""

import shutil
from collections.abc import Iterable, Iterator, Mapping
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any, NamedTuple

import msgspec

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import flat
from fsar_ledger.events.fleet import RunContinued
from fsar_ledger.events.source import Observed
from fsar_ledger.ledger.rows.codec import LedgerRun

from . import NAMING, TOLD, ExportedFile, elements, epoch_us, named_in, rfc3339

FIRST_DAY = datetime.min.replace(tzinfo=UTC)
"""A log of OCEL has times as texts, of any year."""
RUN = [{"name": "run_id", "type": "string"}]
"""The attributes of every type of object."""
INTERNAL = 1
"""SPAN_KIND_INTERNAL."""
ERROR = 2
"""STATUS_CODE_ERROR."""
FAILURES = frozenset({"RequestDenied", "RequestUnanswered", "ExecutionWithdrawn", "TaskAbandoned"})
"""The types of events that end a task or an action without its result."""
ENDS = FAILURES | {"ExecutionFinished", "RequestClosed", "StepCompleted", "TaskCompleted"}
"""All types of events that end a task or an action."""


EXECUTED = frozenset({"ExecutionStarted", "ExecutionPaused", "ExecutionResumed", "ExecutionFinished"})
"""The types of events that show that an action was executed, also where its beginning is not on record."""


class _Ocel:
    """The contents of the runs so far: counts, types of events with those of their attributes, types of objects."""

    def __init__(self, numbers: Mapping[str, int]) -> None:
        self.events = self.left_out = self.observations = self.objects = 0
        self.event_types: dict[str, dict[str, str]] = {}
        self.object_types: set[str] = set()
        self._numbers = numbers

    def events_of(self, run: LedgerRun, objects: dict[str, str]) -> Iterator[dict[str, Any]]:
        """Yield the events of a run that name objects, and put these into `objects`, by label with their kinds."""
        number = self._numbers.get(run.run_id, 0)
        start_us = epoch_us(run.run_id, getattr(run.events[0], "epoch", None), FIRST_DAY)
        for seq, (event, time_us) in enumerate(zip(run.events, run.times_us, strict=True)):
            columns = flat(event)
            named = named_in(columns)
            if not named:
                self.left_out += 1
                self.observations += isinstance(event, Observed)
                continue
            self.events += 1
            objects.update({item.label: item.kind for item in named})
            kind = type(event).__name__
            envelope = {"run_id": run.run_id, "seq": seq, "caused_by": run.caused_by[seq]}
            yield {
                "id": f"{number}:{seq}",
                "type": kind,
                "time": rfc3339(start_us + time_us),
                "attributes": list(self._attributes(kind, envelope | columns)),
                "relationships": [
                    {"objectId": f"{number}:{item.label}", "qualifier": role} for item, role in named.items()
                ],
            }

    def objects_of(self, run: LedgerRun, objects: Mapping[str, str]) -> Iterator[dict[str, Any]]:
        """Yield the objects of a run, from their labels and kinds."""
        number = self._numbers.get(run.run_id, 0)
        self.objects += len(objects)
        self.object_types.update(objects.values())
        for label, kind in objects.items():
            about = {"name": "run_id", "time": rfc3339(0), "value": run.run_id}
            yield {"id": f"{number}:{label}", "type": kind, "attributes": [about], "relationships": []}

    def _attributes(self, kind: str, columns: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
        types = self.event_types.setdefault(kind, {})
        for name, value in columns.items():
            if value is None or (name in NAMING and not isinstance(value, tuple)):
                continue  # the relations have the names, but not the order of a list, nor that it is empty
            if isinstance(value, tuple):
                value = msgspec.json.encode(value).decode()
            types[name] = "boolean" if isinstance(value, bool) else "integer" if isinstance(value, int) else "string"
            yield {"name": name, "value": value}

    def types(self) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
        """Return the types of the events and of the objects, in the format's form."""
        return (
            [
                {"name": kind, "attributes": [{"name": name, "type": one} for name, one in sorted(types.items())]}
                for kind, types in sorted(self.event_types.items())
            ],
            [{"name": kind, "attributes": RUN} for kind in sorted(self.object_types)],
        )


def write_ocel(out: Path, runs: Iterable[LedgerRun], numbers: Mapping[str, int]) -> ExportedFile:
    """Write the runs to this path; memory holds one of them. `numbers` has the number of each run.

    Raises: OSError, or UsageError as `epoch_us`.
    """
    log = _Ocel(numbers)
    with out.open("wb") as file, TemporaryFile() as buffer:  # the objects, which come after all events

        def events() -> Iterator[dict[str, Any]]:
            for run in runs:
                objects: dict[str, str] = {}
                yield from log.events_of(run, objects)
                separator = b",\n" if buffer.tell() else b""
                buffer.write(separator + b"".join(elements(log.objects_of(run, objects))) if objects else b"")

        file.write(b'{"events":[')
        file.writelines(elements(events()))
        file.write(b'],\n"objects":[')
        buffer.seek(0)
        shutil.copyfileobj(buffer, file)
        event_types, object_types = map(msgspec.json.encode, log.types())
        file.write(b'],\n"eventTypes":' + event_types + b',\n"objectTypes":' + object_types + b"}\n")
    left_out = f"{log.left_out:,} events name no object and are not in the file"
    if log.observations:
        left_out += f"; {log.observations:,} of them are observations, which name their objects in open text"
    return ExportedFile(log.events, (f"{log.objects:,} objects", left_out, TOLD))


class _Key(NamedTuple):
    """The subject of a span: a run (whose `name` is empty), a task or an action."""

    kind: str
    name: str


_RUN = _Key("run", "")


class _Span(msgspec.Struct):
    """A span so far: the seqs of its first and last event, what ended it, and its own events.

    `about` has the first value on record of each field, but the last execution's robot and capability.
    """

    parent: _Key | None
    first: int
    last: int = 0
    ended_by: str | None = None
    failure: str | None = None
    is_executed: bool = False
    own: list[int] = []
    about: dict[str, str] = {}


class _Traces(msgspec.Struct):
    """Counts of what was written: spans, those that nothing ended, span events, links."""

    spans: int = 0
    open: int = 0
    events: int = 0
    links: int = 0


def write_otlp(out: Path, runs: Iterable[LedgerRun]) -> ExportedFile:
    """Write a trace for each run to this path; memory holds one of them. Raises: OSError, UsageError as `epoch_us`."""
    counts = _Traces()
    with out.open("wb") as file:
        file.write(b'{"resourceSpans":[')
        file.writelines(elements(_resource(run, counts) for run in runs))
        file.write(b"]}\n")
    return ExportedFile(
        counts.events,
        (
            f"{counts.spans:,} spans of runs, tasks and actions, each from the first to the last of its events",
            f"{counts.events:,} span events, one for each event; 0 events are in no span",
            f"{counts.open:,} spans had not ended and are marked fsar.open",
            f"{counts.links:,} links, one for each cause in another span",
            TOLD,
        ),
    )


def _resource(run: LedgerRun, counts: _Traces) -> dict[str, Any]:
    """Return the spans of a run, under a resource that identifies the run."""
    name = next((event.continues for event in run.events if isinstance(event, RunContinued)), run.run_id)
    trace = sha256(name.encode() + b"\0" + msgspec.json.encode(run.events[0])).hexdigest()[:32]
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
        if (ending := type(event).__name__) in ENDS:
            # The end of an execution is not undone by a request that is closed otherwise, as of a robot that left.
            if (spans[key].ended_by, ending) != ("ExecutionFinished", "RequestClosed"):
                result = columns.get("result")
                # One that was withdrawn because of a failure has failed; how others would have ended is unknown.
                is_failed = ending == "ExecutionWithdrawn" and columns["failure"] is not None
                failure_type = "ExecutionFailed" if is_failed else ending
                spans[key].failure = failure_type if ending in FAILURES else result if result == "failure" else None
            spans[key].ended_by = ending
        keys.append(key)
    return spans, keys


def _follow(span: _Span, event: Event, columns: dict[str, Any], seq: int) -> None:
    span.last = seq
    span.is_executed |= type(event).__name__ in EXECUTED
    if type(event).__name__ == "ExecutionStarted":
        span.about |= {"executor": columns["robot"], "capability": columns["capability"]}
    for name in ("capability", "robot", "requested_by", "executed_by"):
        if columns.get(name) is not None:
            span.about.setdefault(name, columns[name])


def _spans(run: LedgerRun, trace: str, counts: _Traces) -> Iterator[dict[str, Any]]:
    spans, keys = _grouped(run)
    start_us = epoch_us(run.run_id, getattr(run.events[0], "epoch", None))
    times = [f"{(start_us + time_us) * 1_000}" for time_us in run.times_us]
    ids = {key: sha256(f"{trace} {key.kind} {key.name}".encode()).hexdigest()[:16] for key in spans}
    for key, span in spans.items():
        is_open = span.ended_by is None and key != _RUN
        causes = [(seq, cause) for seq in span.own if (cause := run.caused_by[seq]) is not None and keys[cause] != key]
        name, about = _name_and_attributes(run, key, span)
        document = {
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
            document["parentSpanId"] = ids[span.parent]
        if span.failure is not None:
            document["status"] = {"code": ERROR, "message": span.failure}
        counts.spans += 1
        counts.open += is_open
        counts.events += len(span.own)
        counts.links += len(causes)
        yield document


def _name_and_attributes(run: LedgerRun, key: _Key, span: _Span) -> tuple[str, dict[str, Any]]:
    """Return the name of a span, and its attributes by the conventions and from the events."""
    about: dict[str, Any] = {"gen_ai.conversation.id": run.run_id}
    if key.kind == "run":
        workflow = getattr(run.events[0], "scenario", None)
        name, operation = workflow, "invoke_workflow"
        about["gen_ai.workflow.name"] = workflow
    elif key.kind == "task":
        name, operation = span.about.get("robot"), "invoke_agent"
        about |= {"gen_ai.agent.name": name, "fsar.task_id": key.name}
    else:
        name, operation = span.about.get("capability"), "execute_tool" if span.is_executed else "request_tool"
        agent = next((span.about[field] for field in ("executor", "executed_by", "robot") if field in span.about), None)
        about |= {"gen_ai.tool.name": name, "gen_ai.tool.call.id": key.name, "gen_ai.agent.name": agent}
        about |= {"fsar.action_id": key.name, "fsar.requested_by": span.about.get("requested_by")}
    about = {"gen_ai.operation.name": operation, **about, "error.type": span.failure}
    return f"{operation} {name or key.name}".strip(), about


def _event(run: LedgerRun, seq: int, time: str) -> dict[str, Any]:
    fields = {f"fsar.{name}": value for name, value in flat(run.events[seq]).items()}
    attributes = _attributes({"fsar.seq": seq, "fsar.caused_by": run.caused_by[seq], **fields})
    return {"timeUnixNano": time, "name": type(run.events[seq]).__name__, "attributes": attributes}


def _attributes(values: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the values that are not None in OTLP's form: integers as text, since JSON readers may round them."""
    return [{"key": key, "value": _value(value)} for key, value in values.items() if value is not None]


def _value(value: Any) -> dict[str, Any]:
    if isinstance(value, bool):
        return {"boolValue": value}
    if isinstance(value, int):
        return {"intValue": f"{value}"}
    if isinstance(value, tuple):
        return {"arrayValue": {"values": [_value(item) for item in value]}}
    return {"stringValue": value}
