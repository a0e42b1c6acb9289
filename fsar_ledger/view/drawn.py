"""A run as lanes, spans, arrows and events: what a page or a trace shows of it."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from fsar_ledger.events import CONCERN_OF, Event
from fsar_ledger.events.envelope import flat
from fsar_ledger.events.fleet import RobotJoined
from fsar_ledger.ledger.rows.codec import LedgerRun

from .spans import Span, lane_of, spans_of

_KINDS = ("robot", "supervisor", "coordinator", "service")
_ORDER = {kind: place for place, kind in enumerate(_KINDS)}
_FIELDS = ("claimant", "supervisor", "holder", "robot", "decided_by", "requested_by", "executed_by")
"""The fields that say whose event it is where its words do not, best first."""

_ARROWS = {
    "request": ("RequestIssued", "RequestRelayed", "CommandIssued", "AwardMade", "BidSubmitted", "OfferAnswered"),
    "call": ("SupervisorCalled", "SupervisorResponded"),
    "help": ("AssistanceRequested", "AssistanceAdmitted", "AssistanceDeclined", "ReassignmentDecided"),
    "refusal": ("RequestDenied", "RequestUnanswered"),
}
ARROW_OF = {name: kind for kind, names in _ARROWS.items() for name in names}
"""By type of an event, the kind of its arrow where that is not `message`."""


class Words(NamedTuple):
    """An event in the words of `log`: who tells whom (the same for a deed), what, what else, about which action."""

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
    """One event: its words, the lane that it lies in, and its task, where the record says so."""

    words: Words
    lane: str | None
    task: str | None


class Drawn(NamedTuple):
    """A run to draw, and the name that people give it: its number, where it has one."""

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


def drawn(run: LedgerRun, name: str, words: Sequence[Words]) -> Drawn:
    """Return the run with everything that is drawn of it. `words` has one element for each event."""
    spans = spans_of(run)
    told = tuple(_told(event, one) for event, one in zip(run.events, words, strict=True))
    lanes = _lanes(run.events, told, spans)
    arrows = tuple(_arrows(run, told, {lane.name for lane in lanes}))
    return Drawn(run, name, lanes, spans, arrows, told)


def _told(event: Event, words: Words) -> EventLabel:
    fields = flat(event)
    mine = words.sender or words.receiver
    lane = next(
        (
            lane_of(name)
            for name in (mine, *(fields.get(field) for field in _FIELDS))
            if isinstance(name, str) and name.partition("/")[0] in (*_KINDS, "agent")
        ),
        None,
    )
    task = fields.get("task_id") or (words.action_id.partition("/")[0] if words.action_id else None)
    return EventLabel(words, lane, task)


def _lanes(events: Sequence[Event], told: Sequence[EventLabel], spans: Sequence[Span]) -> tuple[Lane, ...]:
    """Return a lane for each principal that the record names: robots as they joined, then who they answer to."""
    about: dict[str, str] = {}
    for event in events:
        if isinstance(event, RobotJoined):
            place = f", {event.place}" if event.place else ""
            about[event.robot] = f"role {event.role}, team {event.team}{place}"
            if event.supervisor is not None:
                about.setdefault(event.supervisor, "")
    for one in told:
        for name in (one.lane, one.words.sender, one.words.receiver):
            if name is not None and lane_of(name).partition("/")[0] in _KINDS:
                about.setdefault(lane_of(name), "")
    for span in spans:
        about.setdefault(span.fact.lane, "")
    names = sorted(about, key=lambda name: _ORDER.get(name.partition("/")[0], len(_ORDER)))
    return tuple(Lane(name, about[name]) for name in names)


def _arrows(run: LedgerRun, told: Sequence[EventLabel], lanes: set[str]) -> Iterator[Arrow]:
    caused: Mapping[int, list[int]] = _effects(run)
    for seq, one in enumerate(told):
        sender, receiver = one.words.sender, one.words.receiver
        if sender is None or receiver is None:
            continue
        ends = lane_of(sender), lane_of(receiver)
        if ends[0] == ends[1] or not lanes.issuperset(ends):
            continue
        kind = ARROW_OF.get(type_name(run.events[seq]), "message")
        effects = caused.get(seq, []) if kind == "request" else []
        arrived = next((effect for effect in effects if told[effect].lane == ends[1]), seq)
        yield Arrow(*ends, run.times_us[seq], run.times_us[arrived], seq, kind)


def _effects(run: LedgerRun) -> dict[int, list[int]]:
    """Return, by seq, the events that it caused directly."""
    found: dict[int, list[int]] = {}
    for seq, cause in enumerate(run.caused_by):
        if cause is not None:
            found.setdefault(cause, []).append(seq)
    return found


def words_of(rows: Sequence[Mapping[str, Any]]) -> tuple[Words, ...]:
    """Return the words of a run's events, from the rows of its log in order of seq."""
    return tuple(Words(*(row[name] for name in Words._fields)) for row in rows)
