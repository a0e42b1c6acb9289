"""OpenTelemetry traces as OTLP JSON (opentelemetry-proto 1.x), one `TracesData` a line: a fleet of agents and its work.

As the file exporter of the collector writes it; one document over several lines is read, too. Attributes are those of
the conventions for generative AI 1.41. A span arrives when it has ended, a parent after its children: the run is in
order of arrival, at the ends of the spans, with their starts beside it. The agent of a span is the one that its own
attributes name, else its parent's. Events follow from a span once the agent of its parent is known.

| span | becomes |
|---|---|
| `invoke_agent` under a span of another agent | `RequestIssued`, `RequestClosed` by that agent |
| the same, unless its kind is CLIENT: only the caller saw it | `RequestAccepted`; `ExecutionStarted` for that agent |
| `invoke_agent` of nobody, or under a span of the same agent | `ExecutionStarted` |
| `execute_tool` | `ExecutionStarted` by the agent whose span it is, of the tool |
| each of these executions, as it ended | `ExecutionFinished`; `ExecutionFailed`, `Withdrawn` with the status ERROR |
| one with the status message ExecutionWithdrawn | `ExecutionWithdrawn`: how it would have ended is unknown |
| one with the `error.type` RequestDenied or RequestUnanswered | no execution, and no `RequestAccepted` |
| any other, and one whose parent is not in the recording | an observation |
"""

from collections.abc import Iterable, Iterator
from typing import Literal

from fsar_ledger.base.errors import UsageError
from fsar_ledger.base.printable import value
from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Parties, RequestSubject, Robot, Subject
from fsar_ledger.events.execution import ExecutionFailed, ExecutionFinished, ExecutionStarted, ExecutionWithdrawn
from fsar_ledger.events.request import RequestAccepted, RequestClosed, RequestIssued

from .adapter import UNREADABLE, Derived, Input, Record
from .otlp_spans import MAX_DOCUMENT, Key, Span, records, texts

KEPT_SPANS = 1 << 16
"""Spans whose owner, or parent, is remembered: a child that comes later than that has an unknown parent."""
WAITING_SPANS = 1 << 16
"""The most spans that wait for their parents; beyond it, the oldest are derived without a known requester."""
MAX_HOPS = 256
"""The most spans between a span and the one that names its agent; beyond it, or in a cycle, there is none."""
WITHDRAWN = "ExecutionWithdrawn"
"""The failure of an execution that was withdrawn and had not failed, as our own export names it."""
MAX_STRANGE = 100
"""The most lines of another format at the beginning of an input of this format."""


class Otlp:
    """A reader of OTLP JSON."""

    name = "otlp"
    version = "1"
    format = "otlp-json/1"
    clock: Literal["arrival", "source"] = "arrival"
    is_sampled = False

    def __init__(self) -> None:
        self._owners: dict[Key, Robot | Key | None] = {}
        self._calls: dict[Key, Robot | None] = {}
        self._waiting: dict[Key, list[Span]] = {}
        self._waiting_spans = 0

    def declares(self) -> Iterable[str]:
        """Name what a complete recording of instrumented agents has.

        That a span began shows that its agent took the request up, not who decided that: `RequestAccepted.decided_by`
        is not among them.
        """
        parties = ("requested_by", "executed_by")
        return (
            *(f"RequestIssued.{name}" for name in ("task_id", "action_id", "decided_by", *parties)),
            *(f"RequestAccepted.{name}" for name in parties),
            *(f"RequestClosed.{name}" for name in ("decided_by", *parties)),
            *(f"ExecutionStarted.{name}" for name in ("on_behalf_of", *parties)),
            *(f"ExecutionFinished.{name}" for name in parties),
            *("ExecutionFailed", "ExecutionWithdrawn"),
        )

    def look(self, inputs: Iterable[Input]) -> None:
        """Raise what `read` would for files that are not of the format, before there is a run."""
        for log in inputs:
            if log.path is not None:
                next(_read(log), None)
                log.file.seek(0)

    def read(self, inputs: Iterable[Input]) -> Iterator[Record]:
        """Yield every span, and a record for each line of metrics or logs.

        Raises: UsageError for an input that begins with something else.
        """
        for log in inputs:
            yield from _read(log)

    def derive(self, record: Record) -> Iterable[Derived] | None:
        """Return the events of this span, and of those that waited for it."""
        span = record.data
        if span is None:
            return None
        if span.key in self._owners:  # sent again
            return ()
        self._remember(span)
        children = self._waiting.pop(span.key, [])
        self._waiting_spans -= len(children)
        events: list[Event] = []
        # A child ended before its parent did, but what is called acts after the call.
        for group in ([span, *children],) if span.key in self._calls else (children, [span]):
            closings: list[Event] = []
            for member in group:
                if member.operation in ("invoke_agent", "execute_tool"):
                    self._tell(member, events, closings)
            events += closings
        while self._waiting_spans > WAITING_SPANS:
            late = self._waiting.pop(next(iter(self._waiting)))
            self._waiting_spans -= len(late)
            for member in late:
                events += _executed(member, member.agent, None, member.key)
        return [Derived(event) for event in events]

    def _remember(self, span: Span) -> None:
        """Keep the agent of the span, or its parent; a call or a creation is not of the agent that it names."""
        is_call = span.is_client and span.operation == "invoke_agent"
        names_another = is_call or span.operation == "create_agent"
        self._owners[span.key] = span.parent if span.agent is None or names_another else span.agent
        if is_call:
            self._calls[span.key] = span.agent
        if len(self._owners) > KEPT_SPANS:
            oldest = next(iter(self._owners))
            del self._owners[oldest]
            self._calls.pop(oldest, None)

    def _tell(self, span: Span, events: list[Event], closings: list[Event]) -> None:
        """Add the events of the span, or let it wait for the span that they depend on."""
        caller: Robot | Key | None = span.parent
        call: Key | None = None
        for _ in range(MAX_HOPS):
            if not isinstance(caller, tuple):
                break
            if caller not in self._owners:
                self._waiting.setdefault(caller, []).append(span)
                self._waiting_spans += 1
                return
            called = self._calls.get(caller)
            if called is not None and called == span.agent and span.operation == "invoke_agent":
                call, caller = caller, self._owners[caller]
            else:
                caller = called or self._owners[caller]
        requester = None if isinstance(caller, tuple) else caller
        is_tool = span.operation == "execute_tool"
        agent = span.agent or (requester if is_tool else None)
        if not is_tool and agent is not None and requester is not None and agent != requester:
            self._request(span, agent, requester, call, events, closings)
        elif is_tool or not span.is_client:
            events += _executed(span, agent, requester, span.key)

    def _request(
        self, span: Span, agent: Robot, requester: Robot, call: Key | None, events: list[Event], closings: list[Event]
    ) -> None:
        """Add the requester's request to the agent, and what the agent did; a `call` was recorded by the caller."""
        action = call or span.key
        subject = RequestSubject(span.key[0], "/".join(action), None)
        parties = Parties(requested_by=requester, executed_by=agent, supervised_by=None)
        if call is None:
            events.append(
                RequestIssued(subject=subject, principals=parties.decided(requester), capability=span.capability)
            )
        if not span.is_client and span.is_executed:
            events.append(RequestAccepted(subject, parties.decided(agent)))
            events += _executed(span, agent, requester, action)
        if call is None and not span.is_open:
            result: Literal["success", "failure"] = "success" if span.failure is None else "failure"
            closings.append(RequestClosed(subject, parties.decided(requester), result))


def _executed(span: Span, agent: Robot | None, requester: Robot | None, action: Key) -> Iterator[Event]:
    """Yield the execution of the span by the agent; nothing if the agent is unknown, or it was not executed."""
    if agent is None or not span.is_executed:
        return
    subject, parties = (
        Subject(span.key[0], "/".join(action)),
        Parties(requested_by=requester, executed_by=agent, supervised_by=None),
    )
    yield ExecutionStarted(
        subject=subject, principals=parties, robot=agent, on_behalf_of=requester, capability=span.capability
    )
    if span.is_open:
        return
    if span.failure is None:
        yield ExecutionFinished(subject, parties, agent)
    elif span.failure == WITHDRAWN:
        yield ExecutionWithdrawn(subject, agent)
    else:
        yield ExecutionFailed(subject=subject, robot=agent, failure=1, cause=span.failure)
        yield ExecutionWithdrawn(subject, agent, 1)


def _read(log: Input) -> Iterator[Record]:
    strange: list[Record] = []
    is_known = False
    for text in texts(log):
        spans = list(records(text))
        spans[:1] = [first._replace(line=text) for first in spans[:1]]
        if not is_known and all(record.kind == UNREADABLE for record in spans):
            strange += spans
            if len(strange) > MAX_STRANGE:
                raise _not_otlp(log, strange[0])
            continue
        yield from strange
        strange, is_known = [], True
        yield from spans
    if strange:
        raise _not_otlp(log, strange[0])


def _not_otlp(log: Input, first: Record) -> UsageError:
    return UsageError(
        f"{value(str(log.path or log.name))}: found {value(first.raw[:60].decode(errors='backslashreplace'))}, "
        f"expected lines of OTLP JSON with resourceSpans, or one document of at most {MAX_DOCUMENT >> 20} MiB; write "
        "them with the collector's file exporter (format: json)"
    )
