"""A run as lanes, spans, arrows and events; the self-contained page of HTML that shows one run or two; trace events.

The page is `page.html` with `page.css` and `page.js` (both built from `src/` by `make page`) and the data as JSON. Its
Content-Security-Policy admits exactly these two texts, by their hashes, and no request at all. Every text of the ledger
reaches the page as JSON, with `<` escaped, and the screen as text.

Trace events are for long runs: the Perfetto UI (ui.perfetto.dev) and chrome://tracing open them.
"""

import base64
import hashlib
from collections.abc import Hashable, Iterator, Mapping, Sequence
from importlib.resources import files
from typing import Any, NamedTuple

import msgspec

from fsar_ledger.events import CONCERN_OF, Event
from fsar_ledger.events.envelope import flat
from fsar_ledger.events.fleet import RobotJoined
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.rows.runs import parts_at

from .spans import TRACKS, Span, lane_of, spans_of

_KINDS = ("robot", "supervisor", "coordinator", "service")
_ORDER = {kind: rank for rank, kind in enumerate(_KINDS)}
_FIELDS = ("claimant", "supervisor", "holder", "robot", "decided_by", "requested_by", "executed_by")
"""The fields that name the principal of an event if its words do not, best first."""

_ARROWS = {
    "request": ("RequestIssued", "RequestRelayed", "CommandIssued", "AwardMade", "BidSubmitted", "OfferAnswered"),
    "call": ("SupervisorCalled", "SupervisorResponded"),
    "help": ("AssistanceRequested", "AssistanceAdmitted", "AssistanceDeclined", "ReassignmentDecided"),
    "refusal": ("RequestDenied", "RequestUnanswered"),
}
ARROW_OF = {name: kind for kind, names in _ARROWS.items() for name in names}
"""The kind of arrow by event type, if that is not `message`."""


class Words(NamedTuple):
    """An event in the words of `log`: sender, receiver (the same for an act), message, note, and its action."""

    sender: str | None
    receiver: str | None
    message: str
    note: str | None
    action_id: str | None


class Lane(NamedTuple):
    """One principal. `about` says more: a robot's role and supervisor."""

    name: str
    about: str


class Arrow(NamedTuple):
    """A message from lane to lane. A request arrives with the first event that it caused there, anything else at once.

    Units: microseconds of run time.
    """

    sender: str
    receiver: str
    sent_us: int
    arrived_us: int
    seq: int
    kind: str


class EventLabel(NamedTuple):
    """The label of an event: its words, its lane, and its task, if on record."""

    words: Words
    lane: str | None
    task: str | None


class Drawn(NamedTuple):
    """A run to draw, with a short name: its number, if it has one."""

    run: LedgerRun
    name: str
    lanes: tuple[Lane, ...]
    spans: tuple[Span, ...]
    arrows: tuple[Arrow, ...]
    told: tuple[EventLabel, ...]


def type_name(event: Event) -> str:
    """Return the name of the event's type, without its version."""
    return type(event).__name__


def concern_of(event: Event) -> str | None:
    """Return the concern of the event; None for one that describes the run itself."""
    return CONCERN_OF.get(type_name(event))


def draw_run(run: LedgerRun, name: str, words: Sequence[Words]) -> Drawn:
    """Return the run with everything that is drawn of it. `words` has one element for each event."""
    spans = spans_of(run)
    labels = tuple(_event_label(event, event_words) for event, event_words in zip(run.events, words, strict=True))
    lanes = _lanes(run.events, labels, spans)
    arrows = tuple(_arrows(run, labels, {lane.name for lane in lanes}))
    return Drawn(run, name, lanes, spans, arrows, labels)


def _event_label(event: Event, words: Words) -> EventLabel:
    fields = flat(event)
    principal = words.sender or words.receiver
    lane = next(
        (
            lane_of(name)
            for name in (principal, *(fields.get(field) for field in _FIELDS))
            if isinstance(name, str) and name.partition("/")[0] in (*_KINDS, "agent")
        ),
        None,
    )
    task = fields.get("task_id") or (words.action_id.partition("/")[0] if words.action_id else None)
    return EventLabel(words, lane, task)


def _lanes(events: Sequence[Event], labels: Sequence[EventLabel], spans: Sequence[Span]) -> tuple[Lane, ...]:
    """Return a lane for each principal that the record names: robots as they joined, then their supervisors."""
    about: dict[str, str] = {}
    for event in events:
        if isinstance(event, RobotJoined):
            role = f"role {event.role}" if event.role else None
            team = None if event.team is None else f"team {event.team}"
            about[event.robot] = ", ".join(part for part in (role, team, event.place) if part)
            if event.supervisor is not None:
                about.setdefault(event.supervisor, "")
    for label in labels:
        for name in (label.lane, label.words.sender, label.words.receiver):
            if name is not None and lane_of(name).partition("/")[0] in _KINDS:
                about.setdefault(lane_of(name), "")
    for span in spans:
        about.setdefault(span.fact.lane, "")
    names = sorted(about, key=lambda name: _ORDER.get(name.partition("/")[0], len(_ORDER)))
    return tuple(Lane(name, about[name]) for name in names)


def _arrows(run: LedgerRun, labels: Sequence[EventLabel], lanes: set[str]) -> Iterator[Arrow]:
    effects_of: Mapping[int, list[int]] = _effects(run)
    for seq, label in enumerate(labels):
        sender, receiver = label.words.sender, label.words.receiver
        if sender is None or receiver is None:
            continue
        ends = lane_of(sender), lane_of(receiver)
        if ends[0] == ends[1] or not lanes.issuperset(ends):
            continue
        kind = ARROW_OF.get(type_name(run.events[seq]), "message")
        effects = effects_of.get(seq, []) if kind == "request" else []
        arrived = next((effect for effect in effects if labels[effect].lane == ends[1]), seq)
        yield Arrow(*ends, run.times_us[seq], run.times_us[arrived], seq, kind)


def _effects(run: LedgerRun) -> dict[int, list[int]]:
    """Return, by seq, the events that it caused directly."""
    effects: dict[int, list[int]] = {}
    for seq, cause in enumerate(run.caused_by):
        if cause is not None:
            effects.setdefault(cause, []).append(seq)
    return effects


def words_of(rows: Sequence[Mapping[str, Any]]) -> tuple[Words, ...]:
    """Return the words of a run's events, from the rows of its log in order of seq."""
    return tuple(Words(*(row[name] for name in Words._fields)) for row in rows)


_ABOUT = ("architecture", "configuration", "scenario", "seed", "fleet_size", "kind", "source", "model_version")
"""The fields of event 0 that identify the run."""


class PageOptions(msgspec.Struct, frozen=True):
    """A run to show, and its origin: the word that names its ledger in a command, and the head.

    `not_observed` names the concerns that its source does not record, or only in part.
    """

    drawn: Drawn
    ledger: str
    size: int
    root: str
    is_verified: bool
    not_observed: tuple[str, ...]


def page(one: PageOptions, other: PageOptions | None = None) -> bytes:
    """Return the page for a run, or for two one above the other with their first difference marked."""
    options = [one] if other is None else [one, other]
    first = None if other is None else parts_at(one.drawn.run, other.drawn.run)
    document = {
        "is_same": other is not None and first is None,
        "first_difference": first,
        "runs": [_document(run) for run in options],
    }
    data = msgspec.json.encode(document).decode().replace("<", "\\u003c").replace(">", "\\u003e")
    parts = {name: files(__package__).joinpath(f"page.{name}").read_text("utf-8") for name in ("html", "css", "js")}
    text = parts["html"]
    for name, value in (
        ("SCRIPT_HASH", _hash(parts["js"])),
        ("STYLE_HASH", _hash(parts["css"])),
        ("STYLE", parts["css"]),
        ("SCRIPT", parts["js"]),
        ("DATA", data),
    ):
        text = text.replace(f"%{name}%", value, 1)
    return text.encode()


def _hash(text: str) -> str:
    """Return the source expression that admits this text in a Content-Security-Policy."""
    return "'sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() + "'"


def _index(value: Hashable, indexes: dict[Any, int]) -> int:
    """Return the index of a value that is written once and then named by its index."""
    return indexes.setdefault(value, len(indexes))


def _document(options: PageOptions) -> dict[str, Any]:
    """Return the run as the page reads it (see `src/data.ts`): lists instead of objects, repeated values by index."""
    drawn = options.drawn
    run = drawn.run
    words: dict[Any, int] = {}
    payloads: dict[Any, int] = {}
    types: dict[Any, int] = {}
    lanes = {lane.name: index for index, lane in enumerate(drawn.lanes)}
    events: list[list[Any]] = []
    previous_us = 0
    for seq, event in enumerate(run.events):
        label = drawn.told[seq]
        fields = flat(event)
        kind = _index((type_name(event), concern_of(event), tuple(fields)), types)
        lane = -1 if label.lane is None else lanes[label.lane]
        payload = _index((kind, *fields.values()), payloads)
        events.append(
            [run.times_us[seq] - previous_us, run.caused_by[seq], payload, _index(label.words, words), lane, label.task]
        )
        previous_us = run.times_us[seq]
    about = flat(run.events[0])
    return {
        "run": run.run_id,
        "name": drawn.name,
        "ledger": options.ledger,
        "size": options.size,
        "root": options.root,
        "is_verified": options.is_verified,
        "epoch": about.get("epoch"),
        "not_observed": options.not_observed,
        "about": [[name.replace("_", " "), f"{about[name]}"] for name in _ABOUT if about.get(name) is not None],
        "lanes": drawn.lanes,
        "types": list(types),
        "words": list(words),
        "payloads": list(payloads),
        "events": events,
        "spans": [_span(span, lanes) for span in drawn.spans],
        "arrows": [
            [lanes[arrow.sender], lanes[arrow.receiver], arrow.sent_us, arrow.arrived_us, arrow.seq, arrow.kind]
            for arrow in drawn.arrows
        ],
    }


def _span(span: Span, lanes: dict[str, int]) -> list[Any]:
    lane, *fact = span.fact
    return [lanes[lane], *fact, span.start_us, span.end_us, span.seq, span.until]


MESSAGES = "messages"
"""The track of what a principal sends and receives."""

_OTHER = "run"
"""The process of events that name no principal."""


# The format is the JSON of the "Trace Event Format": a process for each kind of principal, a thread for each principal
# and track, a slice (`X`) for each span, a flow (`s`, `f`) for each message between lanes, an instant (`i`) for each
# event. A flow binds to slices, so a message has one of a microsecond at both ends. Units: microseconds, as in the
# format.


def trace(drawn: Drawn) -> bytes:
    """Return the run as JSON that Perfetto opens."""
    numbers = _Numbers(drawn)
    events = [*_metadata_events(numbers), *_slices(drawn, numbers), *_instants(drawn, numbers), *_flows(drawn, numbers)]
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
        ordered = sorted(self.rows, key=lambda key: (key[0], (*TRACKS, MESSAGES).index(key[1]), key[2]))
        self.rows = {key: number for number, key in enumerate(ordered, start=len(self.processes) + 1)}

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


def _metadata_events(numbers: _Numbers) -> Iterator[dict[str, Any]]:
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
    for seq, (event, label) in enumerate(zip(drawn.run.events, drawn.told, strict=True)):
        recorded = {"seq": seq, "caused_by": drawn.run.caused_by[seq], "words": label.words.message, **flat(event)}
        where = {"ts": drawn.run.times_us[seq], **numbers.events_of(label.lane)}
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
