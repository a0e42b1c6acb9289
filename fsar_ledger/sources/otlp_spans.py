"""OTLP JSON as records: the spans of each line, as they were written (opentelemetry-proto 1.x)."""

from collections.abc import Iterator, Mapping
from typing import Any

import msgspec

from fsar_ledger.base.printable import escaped
from fsar_ledger.events.envelope import Robot, recorded_robot

from .adapter import BROKEN, OBJECT, RAW_LIST, RAW_OBJECT, Input, Record, json_object, json_text, lines, unreadable

MAX_DOCUMENT = 1 << 26
"""Bytes of a document over several lines."""
TRACES = ("resourceSpans", "resource_spans")
OTHERS = ("resourceMetrics", "resource_metrics", "resourceLogs", "resource_logs", "resourceProfiles")
SNAKE = {
    "scopeSpans": "scope_spans",
    "traceId": "trace_id",
    "spanId": "span_id",
    "parentSpanId": "parent_span_id",
    "startTimeUnixNano": "start_time_unix_nano",
    "endTimeUnixNano": "end_time_unix_nano",
}
"""The names of protobuf, which its JSON mapping lets a writer keep."""
KINDS = ("UNSPECIFIED", "INTERNAL", "SERVER", "CLIENT", "PRODUCER", "CONSUMER")
SHOWN = (
    "gen_ai.operation.name",
    "gen_ai.agent.id",
    "gen_ai.agent.name",
    "gen_ai.tool.name",
    "gen_ai.tool.call.id",
    "gen_ai.conversation.id",
    "gen_ai.request.model",
    "error.type",
)
"""The attributes that an observation shows: none that may hold what was said to a model."""
REFUSED = ("RequestDenied", "RequestUnanswered")
"""Types of errors of a span that was requested and never began, as our own export names them."""
MAX_NS = 9_000_000_000_000_000_000

Key = tuple[str, str]


class Span(msgspec.Struct, frozen=True, gc=False):
    """The needed fields of a span: its own agent, if it names one, its operation, and how that ended, if it did.

    `is_executed`: it stands for something that was done, not for a task of our own export, or a request not taken up.
    """

    key: Key
    parent: Key | None
    operation: str
    agent: Robot | None
    is_client: bool
    capability: str
    failure: str | None
    is_open: bool
    is_executed: bool


def texts(one: Input) -> Iterator[bytes]:
    """Yield the lines of an input, or all of it if its lines are those of one document."""
    remaining = lines([one])
    buffered: list[bytes] = []
    size = 0
    for line in remaining:
        buffered.append(line)
        size += len(line)
        if size > MAX_DOCUMENT or _is_whole(line):
            break
    else:
        document = b"".join(buffered)  # JSON has no use for the ends of lines, and one that is too long came in parts
        if len(buffered) > 1 and _is_whole(document):
            buffered = [document]
    yield from buffered
    yield from remaining


def _is_whole(text: bytes) -> bool:
    try:
        document = RAW_OBJECT.decode(text)
    except BROKEN:
        return False
    return any(name in document for name in (*TRACES, *OTHERS))


def records(text: bytes) -> Iterator[Record]:
    """Yield the spans of a line; a part of it that cannot be read is one record, and the others are read."""
    if not text.strip():
        return
    try:
        top = RAW_OBJECT.decode(text)
    except BROKEN as error:
        yield unreadable(text, error)
        return
    resources = next((top[name] for name in TRACES if name in top), None)
    if resources is None:
        kind = next((name for name in OTHERS if name in top), None)
        yield Record(kind, text) if kind is not None else unreadable(text, f"found {sorted(top)}, expected {TRACES[0]}")
        return
    for resource in _parts(resources):
        if isinstance(resource, Record):
            yield resource
            continue
        service = _service(resource.get("resource"))
        for scope in _parts(_raw(resource, "scopeSpans")):
            if isinstance(scope, Record):
                yield scope
                continue
            yield from (_span(raw, service) for raw in _listed(scope.get("spans")))


def _raw(fields: Mapping[str, Any], name: str) -> Any:
    return fields.get(name, fields.get(SNAKE[name]))


def _listed(raw: msgspec.Raw | None) -> list[msgspec.Raw]:
    """Return the elements of a list; anything else is one element, which becomes an unreadable record."""
    if raw is None or bytes(raw) == b"null":
        return []
    try:
        return RAW_LIST.decode(raw)
    except BROKEN:
        return [raw]


def _parts(raw: msgspec.Raw | None) -> Iterator[dict[str, msgspec.Raw] | Record]:
    for element in _listed(raw):
        try:
            yield RAW_OBJECT.decode(element)
        except BROKEN as error:
            yield unreadable(bytes(element), error)


def _service(raw: msgspec.Raw | None) -> str | None:
    try:
        resource = {} if raw is None else OBJECT.decode(raw)
    except BROKEN:
        return None
    name = _attributes(resource.get("attributes")).get("service.name")
    return name if isinstance(name, str) else None


def _attributes(listed: object) -> dict[str, Any]:
    """Return the attributes by name: texts, numbers as they are written, and any other values."""
    values: dict[str, Any] = {}
    for entry in listed if isinstance(listed, list) else ():
        if isinstance(entry, dict) and isinstance(name := entry.get("key"), str):
            content = entry.get("value")
            values[name] = next(iter(content.values()), None) if isinstance(content, dict) else content
    return values


def _text(content: object) -> str | None:
    """Return a text as an event can hold it; None if it is empty or not a text."""
    return escaped(content) if isinstance(content, str) and content else None


def _id(text: object) -> str | None:
    """Return an id: hexadecimal in any case, or base64 as the JSON mapping of protobuf has it; None for zeros."""
    if not isinstance(text, str) or not text.strip("0"):
        return None
    return escaped(text.lower() if len(text) in (16, 32) else text)


def _span(raw: msgspec.Raw, service: str | None) -> Record:
    try:
        span = json_object(raw)
    except BROKEN as error:
        return unreadable(bytes(raw), error)
    trace, span_id, parent = (_id(_raw(span, name)) for name in ("traceId", "spanId", "parentSpanId"))
    attributes = _attributes(span.get("attributes"))
    operation = attributes.get("gen_ai.operation.name")
    agent = _robot(attributes)
    status, kind = span.get("status"), _kind(span.get("kind"))
    failure = _failure(status, attributes)
    tool = attributes.get("gen_ai.tool.name")
    values = {"name": json_text(span.get("name"))}
    values |= {name: json_text(attributes[name]) for name in SHOWN if name in attributes}
    values |= {name: text for name, text in (("service.name", service), ("failure", failure)) if text is not None}
    names = ((trace, "trace"), (span_id, "span"), (parent, "parent"))
    objects = {f"span/{text}" if part != "trace" else f"trace/{text}": part for text, part in names if text is not None}
    if agent is not None:
        objects[agent] = "agent"
    for link in span.get("links") or () if isinstance(span.get("links"), list) else ():
        if isinstance(link, dict) and (linked := _id(_raw(link, "spanId"))) is not None:
            objects.setdefault(f"span/{linked}", "link")
    is_action = operation in ("invoke_agent", "execute_tool")
    ended_us = _us(_raw(span, "endTimeUnixNano"))
    data = None
    if trace is not None and span_id is not None:
        data = Span(
            (trace, span_id),
            None if parent is None else (trace, parent),
            operation if isinstance(operation, str) else "",
            agent,
            kind == "CLIENT",
            (_text(tool) if operation == "execute_tool" else None) or (json_text(operation) if is_action else ""),
            failure,
            failure is None and (ended_us is None or attributes.get("fsar.open") is True),
            attributes.get("error.type") not in REFUSED
            and not (operation == "invoke_agent" and "fsar.task_id" in attributes),
        )
    return Record(
        operation if isinstance(operation, str) and operation else f"span/{kind}",
        bytes(raw),
        data,
        values,
        objects,
        _us(_raw(span, "startTimeUnixNano")),
        ended_us,
    )


def _robot(attributes: Mapping[str, Any]) -> Robot | None:
    """Return the agent that a span names, as a robot unless its name is that of a robot or a service already."""
    name = _text(attributes.get("gen_ai.agent.name")) or _text(attributes.get("gen_ai.agent.id"))
    if name is None:
        return None
    return recorded_robot(name if name.startswith(("robot/", "service/")) else f"robot/{name}")


def _kind(kind: object) -> str:
    """Return the kind of a span without its prefix, from its number or its name."""
    if isinstance(kind, int) and 0 <= kind < len(KINDS):
        return KINDS[kind]
    return kind.removeprefix("SPAN_KIND_") if isinstance(kind, str) else KINDS[0]


def _failure(status: object, attributes: Mapping[str, Any]) -> str | None:
    """Return the failure: the status message, else the type of the error; None without the status ERROR."""
    if not isinstance(status, dict) or status.get("code") not in (2, "STATUS_CODE_ERROR"):
        return None
    return _text(status.get("message")) or _text(attributes.get("error.type")) or "error"


def _us(nanoseconds: object) -> int | None:
    """Return microseconds since 1970 from nanoseconds, a number or its digits; None for anything else, and for 0."""
    if isinstance(nanoseconds, str) and nanoseconds.isascii() and nanoseconds.isdecimal() and len(nanoseconds) < 20:
        nanoseconds = int(nanoseconds)
    if not isinstance(nanoseconds, int) or not 0 < nanoseconds < MAX_NS:
        return None
    return nanoseconds // 1_000
