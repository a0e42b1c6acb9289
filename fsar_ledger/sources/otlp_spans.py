"""OTLP JSON as records: the spans of each line, as they were written (opentelemetry-proto 1.x)."""

from collections.abc import Iterator, Mapping
from typing import Any

import msgspec

from fsar_ledger.base.printable import escaped
from fsar_ledger.events.envelope import Robot, recorded_robot

from .adapter import BROKEN, OBJECT, RAW_LIST, RAW_OBJECT, Input, Record, lines, shown, unreadable

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
"""Types of errors of a span that was asked for and never began, as our own export names them."""
MAX_NS = 9_000_000_000_000_000_000

Key = tuple[str, str]


class Span(msgspec.Struct, frozen=True, gc=False):
    """What is needed of a span: its own agent, if it names one, what it does, and how that ended, if it did.

    `is_executed`: it stands for something that was done, not for a task of our own export, or what nobody took up.
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
    found = lines([one])
    held: list[bytes] = []
    size = 0
    for line in found:
        held.append(line)
        size += len(line)
        if size > MAX_DOCUMENT or _is_whole(line):
            break
    else:
        document = b"\n".join(held)
        if len(held) > 1 and _is_whole(document):
            held = [document]
    yield from held
    yield from found


def _is_whole(text: bytes) -> bool:
    try:
        found = RAW_OBJECT.decode(text)
    except BROKEN:
        return False
    return any(name in found for name in (*TRACES, *OTHERS))


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


def _raw(found: Mapping[str, Any], name: str) -> Any:
    return found.get(name, found.get(SNAKE[name]))


def _listed(raw: msgspec.Raw | None) -> list[msgspec.Raw]:
    """Return the elements of a list; what is none is one element, which is told as one that cannot be read."""
    if raw is None or bytes(raw) == b"null":
        return []
    try:
        return RAW_LIST.decode(raw)
    except BROKEN:
        return [raw]


def _parts(raw: msgspec.Raw | None) -> Iterator[dict[str, msgspec.Raw] | Record]:
    for one in _listed(raw):
        try:
            yield RAW_OBJECT.decode(one)
        except BROKEN as error:
            yield unreadable(bytes(one), error)


def _service(raw: msgspec.Raw | None) -> str | None:
    try:
        found = {} if raw is None else OBJECT.decode(raw)
    except BROKEN:
        return None
    name = _attributes(found.get("attributes")).get("service.name")
    return name if isinstance(name, str) else None


def _attributes(found: object) -> dict[str, Any]:
    """Return the attributes by name: texts, numbers as they are written, and whatever else there is."""
    values: dict[str, Any] = {}
    for one in found if isinstance(found, list) else ():
        if isinstance(one, dict) and isinstance(name := one.get("key"), str):
            given = one.get("value")
            values[name] = next(iter(given.values()), None) if isinstance(given, dict) else given
    return values


def _text(found: object) -> str | None:
    """Return a text as an event can hold it, None for none."""
    return escaped(found) if isinstance(found, str) and found else None


def _id(found: object) -> str | None:
    """Return an id: hexadecimal in any case, or base64 as the JSON mapping of protobuf has it; None for zeros."""
    if not isinstance(found, str) or not found.strip("0"):
        return None
    return escaped(found.lower() if len(found) in (16, 32) else found)


def _span(raw: msgspec.Raw, service: str | None) -> Record:
    try:
        span = OBJECT.decode(raw)
    except BROKEN as error:
        return unreadable(bytes(raw), error)
    trace, own, parent = (_id(_raw(span, name)) for name in ("traceId", "spanId", "parentSpanId"))
    about = _attributes(span.get("attributes"))
    operation = about.get("gen_ai.operation.name")
    agent = _robot(about)
    status, kind = span.get("status"), _kind(span.get("kind"))
    failure = _failure(status, about)
    tool = about.get("gen_ai.tool.name")
    values = {"name": shown(span.get("name"))}
    values |= {name: shown(about[name]) for name in SHOWN if name in about}
    values |= {name: one for name, one in (("service.name", service), ("failure", failure)) if one is not None}
    names = ((trace, "trace"), (own, "span"), (parent, "parent"))
    objects = {f"span/{one}" if part != "trace" else f"trace/{one}": part for one, part in names if one is not None}
    if agent is not None:
        objects[agent] = "agent"
    for link in span.get("links") or () if isinstance(span.get("links"), list) else ():
        if isinstance(link, dict) and (linked := _id(_raw(link, "spanId"))) is not None:
            objects.setdefault(f"span/{linked}", "link")
    is_action = operation in ("invoke_agent", "execute_tool")
    ended_us = _us(_raw(span, "endTimeUnixNano"))
    data = None
    if trace is not None and own is not None:
        data = Span(
            (trace, own),
            None if parent is None else (trace, parent),
            operation if isinstance(operation, str) else "",
            agent,
            kind == "CLIENT",
            (_text(tool) if operation == "execute_tool" else None) or (shown(operation) if is_action else ""),
            failure,
            failure is None and (ended_us is None or about.get("fsar.open") is True),
            about.get("error.type") not in REFUSED and not (operation == "invoke_agent" and "fsar.task_id" in about),
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


def _robot(about: Mapping[str, Any]) -> Robot | None:
    """Return the agent that a span names; one whose name says that it is a robot or a service is that."""
    name = _text(about.get("gen_ai.agent.name")) or _text(about.get("gen_ai.agent.id"))
    if name is None:
        return None
    return recorded_robot(name if name.startswith(("robot/", "service/")) else f"robot/{name}")


def _kind(found: object) -> str:
    """Return the kind of a span without its prefix, from its number or its name."""
    if isinstance(found, int) and 0 <= found < len(KINDS):
        return KINDS[found]
    return found.removeprefix("SPAN_KIND_") if isinstance(found, str) else KINDS[0]


def _failure(status: object, about: Mapping[str, Any]) -> str | None:
    """Return what went wrong: what the status says, else the type of the error; None without the status ERROR."""
    if not isinstance(status, dict) or status.get("code") not in (2, "STATUS_CODE_ERROR"):
        return None
    return _text(status.get("message")) or _text(about.get("error.type")) or "error"


def _us(found: object) -> int | None:
    """Return microseconds since 1970 from nanoseconds, a number or its digits; None for anything else, and for 0."""
    if isinstance(found, str) and found.isascii() and found.isdecimal() and len(found) < 20:
        found = int(found)
    if not isinstance(found, int) or not 0 < found < MAX_NS:
        return None
    return found // 1_000
