"""A run as trace events, which the Perfetto UI (ui.perfetto.dev) and chrome://tracing open: for long runs.

The format is the JSON of the "Trace Event Format": a process for each kind of principal, a thread for each principal
and track, a slice (`X`) for each span, a flow (`s`, `f`) for each message between lanes, an instant (`i`) for each
event. A flow binds to slices, so a message has one of a microsecond at both ends. Units: microseconds, in which the
format counts, too.
"""

from collections.abc import Iterator
from typing import Any

import msgspec

from fsar_ledger.events.envelope import flat

from .drawn import Drawn, concern_of, type_name
from .spans import TRACKS, Span

MESSAGES = "messages"
"""The track of what a principal sends and receives."""

_OTHER = "run"
"""The process of events that name no principal."""


def trace(drawn: Drawn) -> bytes:
    """Return the run as JSON that Perfetto opens."""
    numbers = _Numbers(drawn)
    events = [*_named(numbers), *_slices(drawn, numbers), *_instants(drawn, numbers), *_flows(drawn, numbers)]
    about = {"run": drawn.run.run_id}
    return msgspec.json.encode({"traceEvents": events, "displayTimeUnit": "ms", "otherData": about})


class _Numbers:
    """The numbers of processes and threads, from 1, in the order of the lanes."""

    def __init__(self, drawn: Drawn) -> None:
        self.processes = {lane.name: number for number, lane in enumerate(drawn.lanes, start=1)}
        self.processes[_OTHER] = len(self.processes) + 1
        self.abouts = {lane.name: lane.about for lane in drawn.lanes}
        self.rows: dict[tuple[str, str, int], int] = {}
        self.row_of: dict[Span, int] = {}
        free_us: dict[tuple[str, str], list[int]] = {}
        end_us = drawn.run.times_us[-1]
        for span in drawn.spans:  # slices of one thread must nest, so spans that overlap get a thread each
            ends = free_us.setdefault((span.fact.lane, span.fact.track), [])
            row = next((row for row, until_us in enumerate(ends) if until_us <= span.start_us), len(ends))
            ends[row : row + 1] = [end_us if span.end_us is None else span.end_us]
            self.row_of[span] = row
            self.rows.setdefault((span.fact.lane, span.fact.track, row), 0)
        for arrow in drawn.arrows:
            for lane in (arrow.sender, arrow.receiver):
                self.rows.setdefault((lane, MESSAGES, 0), 0)
        ordered = sorted(self.rows, key=lambda one: (one[0], (*TRACKS, MESSAGES).index(one[1]), one[2]))
        self.rows = {one: number for number, one in enumerate(ordered, start=len(self.processes) + 1)}

    def events_of(self, lane: str | None) -> dict[str, int]:
        """Return process and thread of the events of a lane. The main thread of a process has its number."""
        number = self.processes[lane or _OTHER]
        return {"pid": number, "tid": number}

    def of(self, span: Span) -> dict[str, int]:
        """Return process and thread of a span."""
        fact = span.fact
        return {"pid": self.processes[fact.lane], "tid": self.rows[fact.lane, fact.track, self.row_of[span]]}

    def messages_of(self, lane: str) -> dict[str, int]:
        """Return process and thread of the messages of a lane."""
        return {"pid": self.processes[lane], "tid": self.rows[lane, MESSAGES, 0]}


def _named(numbers: _Numbers) -> Iterator[dict[str, Any]]:
    for lane, number in numbers.processes.items():
        about = numbers.abouts.get(lane)
        yield _metadata("process_name", number, number, name=f"{lane} ({about})" if about else lane)
        yield _metadata("process_sort_index", number, number, sort_index=number)
        yield _metadata("thread_name", number, number, name="events")
    for (lane, track, row), number in numbers.rows.items():
        yield _metadata("thread_name", numbers.processes[lane], number, name=f"{track} {row + 1}" if row else track)
        yield _metadata("thread_sort_index", numbers.processes[lane], number, sort_index=number)


def _metadata(what: str, process: int, thread: int, **values: object) -> dict[str, Any]:
    return {"ph": "M", "name": what, "pid": process, "tid": thread, "args": values}


def _slices(drawn: Drawn, numbers: _Numbers) -> Iterator[dict[str, Any]]:
    end_us = drawn.run.times_us[-1]
    for span in drawn.spans:
        fact = span.fact
        until_us = end_us if span.end_us is None else span.end_us
        where = {"ts": span.start_us, "dur": max(until_us - span.start_us, 0), **numbers.of(span)}
        details = {"about": fact.about, "from_seq": span.seq, "until_seq": span.until}
        yield {"ph": "X", "name": f"{fact.kind} {fact.text}".strip(), "cat": fact.track, **where, "args": details}


def _instants(drawn: Drawn, numbers: _Numbers) -> Iterator[dict[str, Any]]:
    for seq, (event, told) in enumerate(zip(drawn.run.events, drawn.told, strict=True)):
        recorded = {"seq": seq, "caused_by": drawn.run.caused_by[seq], "words": told.words.message, **flat(event)}
        where = {"ts": drawn.run.times_us[seq], **numbers.events_of(told.lane)}
        yield {
            "ph": "i", "s": "t", "name": type_name(event), "cat": concern_of(event) or "run", **where, "args": recorded
        }  # fmt: skip


def _flows(drawn: Drawn, numbers: _Numbers) -> Iterator[dict[str, Any]]:
    for arrow in drawn.arrows:
        flow = {"name": type_name(drawn.run.events[arrow.seq]), "cat": arrow.kind}
        details = {"from": arrow.sender, "to": arrow.receiver, "seq": arrow.seq}
        for phase, lane, time_us in (("s", arrow.sender, arrow.sent_us), ("f", arrow.receiver, arrow.arrived_us)):
            where = {"ts": time_us, **numbers.messages_of(lane)}
            yield {"ph": "X", **flow, **where, "dur": 1, "args": details}
            yield {"ph": phase, **({"bp": "e"} if phase == "f" else {}), **flow, "id": arrow.seq, **where}
