"""The moments of a run: its state at any time, a walk through its events, and what a decider had been told."""

import re
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import takewhile

import msgspec

from fsar_ledger.base import printable
from fsar_ledger.base.errors import UsageError
from fsar_ledger.events import Event
from fsar_ledger.events.command import CommandRejected
from fsar_ledger.events.envelope import COORDINATOR, FLEET_SUPERVISOR, REGISTRY, Robot, flat
from fsar_ledger.events.knowledge import CopySynced, SnapshotTaken
from fsar_ledger.events.recovery import AssistanceDeclined
from fsar_ledger.events.registry import AvailabilityChanged
from fsar_ledger.events.request import RequestCountered, RequestDenied, RequestIssued, RequestUnanswered
from fsar_ledger.events.world import PolicyWindowOpened
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.projections import put
from fsar_ledger.projections.fold import State, apply
from fsar_ledger.projections.registry import surface
from fsar_ledger.projections.task import RequestEnds
from fsar_ledger.projections.world import in_force

from .situation import Coverage

EVERY = 256
"""Events between two kept states, which share everything that did not change."""


class Past(msgspec.Struct):
    """A run up to one of its events: the state after it, and what is queried but not kept in the state.

    `opened` is the seq and the time of the last event that opened a policy window, by window; `told_us` is when a
    principal was last told something, by event type and the robot concerned. `asked` is the robot to which a request
    has gone, by action; `ends` are the requests that no event closes.
    """

    started: Event
    state: State
    seq: int = -1
    time_us: int = 0
    opened: Mapping[tuple[str, str, str], tuple[int, int]] = {}
    told_us: Mapping[tuple[type[Event], str | None], int] = {}
    asked: Mapping[str | None, str | None] = {}
    ends: RequestEnds = RequestEnds()

    def add(self, event: Event, time_us: int) -> None:
        """Add the next event of the run."""
        self.seq, self.time_us = self.seq + 1, time_us
        apply(self.state, event)
        self.ends = self.ends.after(event)
        if isinstance(event, PolicyWindowOpened):
            self.opened = put(self.opened, (event.robot, event.scope, event.window), (self.seq, time_us))
        elif isinstance(event, CopySynced | SnapshotTaken | AvailabilityChanged):
            self.told_us = put(self.told_us, (type(event), getattr(event, "robot", None)), time_us)
        elif isinstance(event, RequestIssued):
            self.asked = put(self.asked, event.subject.action_id, event.principals.executed_by)

    def copy(self) -> "Past":
        """Return a copy; both share what does not change."""
        return msgspec.structs.replace(self, state=self.state.copy())


class Timeline:
    """A run with its states. Building it folds all events once; each lookup then folds at most `EVERY` events."""

    def __init__(self, record: LedgerRun) -> None:
        self.record = record
        past = Past(record.events[0], State())
        self._kept = [past.copy()]
        for time_us, event in zip(record.times_us, record.events, strict=True):
            past.add(event, time_us)
            if (past.seq + 1) % EVERY == 0:
                self._kept.append(past.copy())

    def seq_at(self, time_us: int) -> int:
        """Return the seq of the last event that has happened by then, at least 0."""
        return max(0, bisect_right(self.record.times_us, time_us) - 1)

    def past(self, seq: int) -> Past:
        """Return the run up to this event."""
        past = self._kept[(seq + 1) // EVERY].copy()
        for number in range(past.seq + 1, seq + 1):
            past.add(self.record.events[number], self.record.times_us[number])
        return past


def past_at(pieces: Iterable[LedgerRun], time_us: int) -> Past:
    """Return a run up to this time, at least up to event 0, with memory nearly independent of its length."""
    events = ((us, event) for piece in pieces for us, event in zip(piece.times_us, piece.events, strict=True))
    begun_us, started = next(events)
    past = Past(started, State())
    past.add(started, begun_us)
    for us, event in takewhile(lambda timed: timed[0] <= time_us, events):
        past.add(event, us)
    return past


REFUSALS = (RequestDenied, RequestCountered, RequestUnanswered, AssistanceDeclined, CommandRejected)
MOVES = {
    "next": "the next event",
    "previous": "the previous event",
    "next-decision": "the next event that names who decided it",
    "previous-decision": "the previous decision",
    "next-of": "the next event that names the robot: `next-of B1`",
    "next-refusal": "the next refusal",
    "cause": "the event that caused this one",
    "go": "a time or an event: `go 46.6s`, `go 289`",
    "find": "the next event whose words hold the text: `find door`",
    "first": "event 0",
    "last": "the last event",
}
"""The target of each move of a walk, by name."""
_SEQ = re.compile(r"[0-9]{1,16}")


class Walk:
    """A cursor on the events of a run. A move that leads nowhere does not change it, and returns why."""

    def __init__(self, record: LedgerRun, words: list[str], seq: int = 0) -> None:
        """Begin at the event `seq`; `words` are the texts of all events."""
        self.record = record
        self.words = words
        self.seq = seq

    def move(self, name: str, about: str = "", seq_at: Callable[[str], int] | None = None) -> str | None:
        """Make a move; return why it leads nowhere, or None.

        Args:
            name: One of `MOVES`.
            about: The robot, text, time or seq that it needs.
            seq_at: Parses a time and returns the last event that has happened by then.

        Raises:
            UsageError: There is no such move, or it lacks what it needs.
        """
        if name not in MOVES:
            hint = printable.did_you_mean(name, MOVES) or ";"
            raise UsageError(
                f"move {printable.value(name)}: there is no such move{hint} expected one of "
                f"{', '.join(MOVES)}, or state or record in a script"
            )
        if name in ("next-of", "go", "find") and not about:
            raise UsageError(f"move {name}: expected what to look for, {MOVES[name]}")
        seq = self._target_seq(name, about, seq_at)
        if seq is None:
            return f"found none: {MOVES[name].partition(':')[0]}"
        self.seq = seq
        return None

    def _target_seq(self, name: str, about: str, seq_at: Callable[[str], int] | None) -> int | None:
        last = len(self.record.events) - 1
        match name:
            case "next" | "previous":
                seq = self.seq + (1 if name == "next" else -1)
                return seq if 0 <= seq <= last else None
            case "first" | "last":
                return 0 if name == "first" else last
            case "cause":
                return self.record.caused_by[self.seq]
            case "previous-decision":
                return self._first(_is_decision, range(self.seq - 1, -1, -1))
            case "go" if _SEQ.fullmatch(about):
                return int(about) if int(about) <= last else None
            case "go":
                return None if seq_at is None else seq_at(about)
            case "find":
                return next((seq for seq in self._later() if about.casefold() in self.words[seq].casefold()), None)
        kinds: dict[str, Callable[[Event], bool]] = {
            "next-decision": _is_decision,
            "next-refusal": lambda event: isinstance(event, REFUSALS),
            "next-of": lambda event: _names(event, about if "/" in about else f"robot/{about}"),
        }
        return self._first(kinds[name], self._later())

    def _later(self) -> range:
        return range(self.seq + 1, len(self.record.events))

    def _first(self, is_it: Callable[[Event], bool], seqs: range) -> int | None:
        return next((seq for seq in seqs if is_it(self.record.events[seq])), None)


def _is_decision(event: Event) -> bool:
    """Return whether the record names who decided it."""
    return flat(event).get("decided_by") is not None


def _names(event: Event, robot: str) -> bool:
    """Return whether a field of the event, or an item of one, is this robot."""
    return any(robot == value or (isinstance(value, tuple) and robot in value) for value in flat(event).values())


class Belief(msgspec.Struct, frozen=True):
    """What a decider believes about a robot, when that was so, how old it is, and what holds now.

    Units: `as_of_s` run time, `age_s` seconds. `believed` is None where it was never told, or where that is not
    observed, and then `was_told` is None, too. `holds` is None where that is not observed.
    """

    about: str
    what: str
    believed: str | None
    as_of_s: float | None
    age_s: float | None
    holds: str | None
    was_told: bool | None

    @property
    def is_stale(self) -> bool | None:
        """Return whether something else holds; None where that is not observed."""
        return None if self.holds is None else self.believed != self.holds


def deciders(state: State) -> list[str]:
    """Return the principals that can be told something in this run, in order."""
    robots = list(state.fleet.robots)
    agents = [
        f"agent/{robot[6:]}/{kind}"
        for robot in robots
        for kind in ("planning", "execution", "communication", "recovery")
    ]
    supervisors = dict.fromkeys(
        member.supervisor for member in state.fleet.robots.values() if member.supervisor is not None
    )
    return [*dict.fromkeys([COORDINATOR, REGISTRY, *robots, *supervisors, FLEET_SUPERVISOR, *agents])]


def beliefs(past: Past, decider: str, now_us: int) -> list[Belief]:
    """Return what a decider had been told by then, about each robot in order.

    `now_us` may be later than the last event of the past: beliefs age without events.

    Raises:
        UsageError: There is no such principal, or it decides on the current state and keeps no copies.
    """
    state, names = past.state, deciders(past.state)
    if decider not in names:
        hint = printable.did_you_mean(decider, names) or ";"
        raise UsageError(
            f"{printable.value(decider)}: there is no such principal{hint} expected one of {printable.list_few(names)}"
        )
    last = _Last(past, now_us)
    robots = {str(robot): robot for robot in state.fleet.robots}
    planned = {f"agent/{robot[6:]}/planning": robot for robot in robots.values()}
    if decider == COORDINATOR:
        return list(_of_coordinator(state, last))
    if decider == REGISTRY:
        return list(_of_registry(state, last))
    if decider in robots:
        return list(_of_robot(state, robots[decider], last))
    if decider in planned:
        return list(_of_planner(state, planned[decider], last))
    raise UsageError(
        f"{decider}: it keeps no copies and decides on what it is asked; expected the coordinator, a robot, "
        f"{REGISTRY}, or the planning agent of a robot"
    )


class _Last:
    """When principals were last told something, and what the run observes."""

    def __init__(self, past: Past, now_us: int) -> None:
        self._told_us, self.now_us = past.told_us, now_us
        self._seen = Coverage(past.started)

    def time_us(self, kind: type[Event], robot: str | None = None) -> int | None:
        """Return when the last event of this type (about this robot) happened; None: there is none."""
        return self._told_us.get((kind, robot))

    def belief(
        self, about: str, what: str, told: tuple[str, str | None], as_of_us: int | None, *holds: tuple[str, str]
    ) -> Belief:
        """Return a belief of that age.

        `told` and `holds` are pairs of a concern and the value that rests on it; what holds may rest on several.
        """
        believed, holding = self._seen.of(*told), holds[0][1]
        was_told = self._seen.of(told[0], told[1] is not None)
        true_now = None if any(self._seen.of(*entry) is None for entry in holds) else holding
        if as_of_us is None or believed is None:
            return Belief(about, what, believed, None, None, true_now, was_told)
        return Belief(about, what, believed, as_of_us / 1e6, (self.now_us - as_of_us) / 1e6, true_now, was_told)


def _of_coordinator(state: State, last: _Last) -> Iterator[Belief]:
    """Yield what the coordinator's last copy says. A robot not listed there allows, is idle and not degraded."""
    copy, as_of_us, world = state.knowledge.copy, last.time_us(CopySynced), state.world
    for robot in state.fleet.robots:
        local, fleet = in_force(world.local, robot), in_force(world.fleet, robot)
        busy = _yes(robot in state.execution.current)
        rows: tuple[tuple[str, str, tuple[tuple[str, str], ...]], ...] = (
            ("own policy", _outcome(robot, copy.local_deny, copy.local_review), (("policy", local),)),
            ("fleet's rule", _outcome(robot, copy.fleet_deny, copy.fleet_review), (("policy", fleet),)),
            ("busy", _yes(robot in copy.busy), (("execution", busy), ("recovery", busy))),
            ("degraded", _yes(robot in copy.degraded), (("world", _yes(robot in world.degraded)),)),
        )
        for what, believed, holds in rows:
            told = None if as_of_us is None else believed
            yield last.belief(robot, what, ("knowledge", told), as_of_us, *holds)


def _of_robot(state: State, robot: Robot, last: _Last) -> Iterator[Belief]:
    """Yield what a robot knows of itself, and what it was told about the fleet's rule, its peers and the registry."""
    holds = ("policy", in_force(state.world.local, robot))
    yield last.belief(robot, "own policy", holds, last.now_us, holds)
    as_of_us = state.knowledge.fleet_rule_as_of_us.get(robot)
    believed = state.knowledge.fleet_rule.get(robot)
    rule = ("policy", in_force(state.world.fleet, robot))
    yield last.belief(robot, "fleet's rule", ("knowledge", believed), as_of_us, rule)
    for (knower, peer), until_us in state.knowledge.met.items():
        if knower == robot:
            is_known = _yes(until_us > last.now_us)
            yield last.belief(peer, "a peer it met", ("knowledge", is_known), None, ("knowledge", "yes"))
    cache = state.registry.caches.get(robot)
    if cache is not None:
        yield last.belief("registry", "its copy", ("registry", "kept"), cache.as_of_us, ("registry", "kept"))


def _of_planner(state: State, robot: Robot, last: _Last) -> Iterator[Belief]:
    """Yield what the snapshot of a robot's planning agent says."""
    believed = state.knowledge.snapshot.get(robot)
    as_of_us = last.time_us(SnapshotTaken, robot)
    holds = ("policy", in_force(state.world.local, robot))
    yield last.belief(robot, "own policy", ("knowledge", believed), as_of_us, holds)


def _of_registry(state: State, last: _Last) -> Iterator[Belief]:
    """Yield each robot's availability according to the registry, and its actual state."""
    for robot in state.fleet.robots:
        states = sorted({offer.availability for offer in surface(state.registry, robot)})
        is_busy = "busy" in states and robot in state.execution.current  # most architectures do not advertise that
        holds = "degraded" if robot in state.world.degraded else "busy" if is_busy else "ready"
        holds = "offline" if robot in state.world.off else holds
        yield last.belief(
            robot,
            "availability",
            ("registry", ", ".join(states) or "nothing"),
            last.time_us(AvailabilityChanged, robot),
            *((concern, holds) for concern in ("world", "execution", "recovery", "registry")),
        )


def _outcome(robot: Robot, deny: tuple[Robot, ...], review: tuple[Robot, ...]) -> str:
    return "deny" if robot in deny else "review" if robot in review else "allow"


def _yes(value: bool) -> str:
    return "yes" if value else "no"
