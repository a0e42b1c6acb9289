"""The time spans in which facts of a run's state held, such as an execution or an open window.

The facts are read from the projections, so a span means what the handlers themselves mean by that name.
"""

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Any, NamedTuple

from fsar_ledger.analysis.situation import Coverage
from fsar_ledger.events import Event
from fsar_ledger.events.envelope import COORDINATOR, Principal, Robot, flat
from fsar_ledger.events.knowledge import WorkQueued
from fsar_ledger.events.registry import AvailabilityChanged
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.projections.authority import Authority
from fsar_ledger.projections.execution import HELPING, Execution, doing_and_waiting
from fsar_ledger.projections.fold import ROUTES, State
from fsar_ledger.projections.knowledge import Knowledge
from fsar_ledger.projections.policy import Policy, rules_in_force
from fsar_ledger.projections.recovery import Recoveries
from fsar_ledger.projections.request import Request
from fsar_ledger.projections.task import RequestEnds, Tasks
from fsar_ledger.projections.world import World
from fsar_ledger.runtime.handlers.supervision import is_open

TRACKS = ("task", "work", "queue", "recovery", "request", "call", "claim", "policy", "told", "world")
"""The rows of a lane, from top to bottom."""

_WORK = {
    "polling": "held",
    "withdrawn": "queued",
    "preempted": "paused",
    "halted": "paused",
}
"""The kind of a span by the stage of the action that occupies the robot, if that is not the stage itself."""


class Fact(NamedTuple):
    """A fact that holds for a while. `about` is an action, task or window; `text` describes it.

    `lane` is the principal it holds for, `track` one of `TRACKS`.
    """

    lane: str
    track: str
    kind: str
    about: str
    text: str


class Span(NamedTuple):
    """The time in which a fact held. Units: microseconds of run time; `end_us` None: until the end of the record.

    `seq` is the event from which it held, `until` the one from which it no longer did, if an event ended it.
    """

    fact: Fact
    start_us: int
    end_us: int | None
    seq: int
    until: int | None


def lane_of(principal: Principal | str) -> str:
    """Return the lane of a principal: its own, or for an agent that of its robot."""
    kind, _, rest = principal.partition("/")
    return f"robot/{rest.split('/')[0]}" if kind == "agent" else principal


def spans_of(run: LedgerRun) -> tuple[Span, ...]:
    """Return the spans of a run, in order of their beginning."""
    state, facts, ends = State(), _Facts(), RequestEnds()
    # As in `state`: not how long a robot acts, or what waits, if the source does not record it.
    coverage = Coverage(run.events[0])
    execution_facts = partial(
        _execution, is_work_told=coverage.tells_ends, is_queue_told="execution" not in coverage.lacking
    )
    reads: dict[str, Callable[[Any], Iterator[Fact]]] = {**FACTS, "execution": execution_facts}
    for seq, (time_us, event) in enumerate(zip(run.times_us, run.events, strict=True)):
        requests, actions, ended, calls = state.request, state.execution.actions, ends, state.supervision.calls
        ends = ends.after(event)
        for slot, evolve in ROUTES.get(type(event), ()):
            old = getattr(state, slot)
            new = evolve(old, event)
            setattr(state, slot, new)
            if new is not old and slot in reads:
                facts.now(slot, frozenset(reads[slot](new)), time_us, seq)
        is_freed = ends.is_foreign and state.execution.actions is not actions
        if state.request is not requests or ends is not ended or is_freed:
            facts.requests(state, ends, event, time_us, seq)
        is_moved = state.request is not requests or state.execution.actions is not actions
        if state.supervision.calls is not calls or (calls and is_moved):
            facts.now("call", frozenset(call_facts(state)), time_us, seq)
        facts.beside(event, time_us, seq)
    facts.end()
    return tuple(sorted(facts.spans, key=lambda span: (span.start_us, span.seq, span.fact)))


class _Facts:
    """The facts that hold at present, by their source, and the spans that have ended."""

    def __init__(self) -> None:
        self.spans: list[Span] = []
        self._open: dict[str, dict[Fact, tuple[int, int]]] = {}
        self._availability: dict[tuple[Robot, str | None], Fact] = {}
        self._coordinator_us = 0
        self._requests: set[str] = set()

    def now(self, source: str, facts: frozenset[Fact], time_us: int, seq: int) -> None:
        """Replace the facts from this source by these, which hold from this event on."""
        open_facts = self._open.setdefault(source, {})
        for fact in [fact for fact in open_facts if fact not in facts]:
            start_us, since = open_facts.pop(fact)
            self.spans.append(Span(fact, start_us, time_us, since, seq))
        for fact in facts - open_facts.keys():
            open_facts[fact] = (time_us, seq)

    def requests(self, state: State, ends: RequestEnds, event: Event, time_us: int, seq: int) -> None:
        """Update the open requests. A closed one may stay in the state forever; it reopens only if it is named."""
        fields = flat(event)
        named: set[str] = {fields.get("action_id") or "", fields.get("task_id") or ""}
        open_requests, actions = state.request.open, state.execution.actions
        self._requests = {
            name
            for name in self._requests | named
            if (request := open_requests.get(name)) is not None and not ends.is_over(request, actions)
        }
        self.now("request", frozenset(request_facts(open_requests[name] for name in self._requests)), time_us, seq)

    def beside(self, event: Event, time_us: int, seq: int) -> None:
        """Update what the state holds only in part: the availability on record, and the work of the coordinator."""
        match event:
            case AvailabilityChanged(robot=robot, capability=capability, availability=availability):
                text = f"{availability}: {capability or 'every capability'} ({event.reason})"
                self._availability.pop((robot, capability), None)
                if availability != "ready":
                    self._availability[robot, capability] = Fact(robot, "world", availability, capability or "", text)
                self.now("availability", frozenset(self._availability.values()), time_us, seq)
            case WorkQueued():
                begin_us = max(time_us, self._coordinator_us)
                fact = Fact(COORDINATOR, "work", "running", event.subject.action_id, event.item)
                self.spans.append(Span(fact, begin_us, event.ready_us, seq, None))
                self._coordinator_us = event.ready_us
            case _:
                pass

    def end(self) -> None:
        """Add a span for each fact that still holds at the end of the record."""
        for open_facts in self._open.values():
            self.spans += [Span(fact, start_us, None, seq, None) for fact, (start_us, seq) in open_facts.items()]


def _tasks(state: Tasks) -> Iterator[Fact]:
    for task in state.values():
        yield Fact(task.robot, "task", "task", task.task_id, task.task_id)


def _execution(state: Execution, *, is_work_told: bool = True, is_queue_told: bool = True) -> Iterator[Fact]:
    for robot in {**state.current, **state.queues}:
        doing, waiting = doing_and_waiting(state, robot)
        for name in doing:
            if name.startswith(HELPING):
                about = name.removeprefix(HELPING)
                yield Fact(robot, "work", "helping", about, f"helps with {about}")
            elif is_work_told and name in state.actions:
                action = state.actions[name]
                yield Fact(robot, "work", _WORK.get(action.stage, action.stage), name, action.capability)
        for name in waiting if is_queue_told else ():
            yield Fact(robot, "queue", "waiting", name, state.actions[name].capability)


def _recoveries(state: Recoveries) -> Iterator[Fact]:
    for name, failure in state.items():
        cause = failure.cause or "cause not on record"
        yield Fact(failure.robot, "recovery", failure.level, name, f"{cause}, failure {failure.failure}")


def request_facts(requests: Iterable[Request]) -> Iterator[Fact]:
    """Yield a fact for each delegated request."""
    for request in requests:
        if request.is_delegated:
            kind = "accepted" if request.is_accepted else "open"
            yield Fact(request.requester, "request", kind, request.action_id, request.capability)


def call_facts(state: State) -> Iterator[Fact]:
    """Yield a fact for each call that can still be answered."""
    for call in filter(partial(is_open, state), state.supervision.calls.values()):
        yield Fact(call.supervisor, "call", call.purpose, call.subject.action_id, f"call: {call.purpose}")


def _claims(state: Authority) -> Iterator[Fact]:
    for name, claims in state.claims.items():
        for claim in claims:
            yield Fact(lane_of(claim.claimant), "claim", claim.dimension, name, f"{claim.dimension}, {claim.reason}")


def _rules(state: Policy) -> Iterator[Fact]:
    for rule in rules_in_force(state):
        if rule.outcome != "allow":
            about = " in ".join(part for part in (rule.capability or "every capability", rule.context) if part)
            yield Fact(rule.robot, "policy", rule.outcome, about, f"{rule.scope} rule: {rule.outcome}")


def _world(state: World) -> Iterator[Fact]:
    for scope, windows in (("local", state.local), ("fleet", state.fleet)):
        for robot, opened in windows.items():
            for window, outcome in opened:
                yield Fact(robot, "policy", outcome, window, f"{scope} policy: {outcome}")
    for robot, names in state.obstructions.items():
        for name in names:
            yield Fact(robot, "world", "obstructed", name, "obstructed")
    for robot, grade in state.degraded.items():
        yield Fact(robot, "world", "degraded", "", f"actuator {grade}")
    for supervisor in state.off_shift:
        yield Fact(supervisor, "world", "off", "", "off shift")
    for robot in state.off:
        yield Fact(robot, "world", "off", "", "off")
    for robot in state.unlinked:
        yield Fact(robot, "world", "unlinked", "", "link down")


def _fleet_rule_facts(state: Knowledge) -> Iterator[Fact]:
    for robot, outcome in state.fleet_rule.items():
        if outcome != "allow":
            yield Fact(robot, "told", outcome, "", f"told the fleet's rule: {outcome}")


FACTS: dict[str, Callable[[Any], Iterator[Fact]]] = {
    "task": _tasks,
    "execution": _execution,
    "recovery": _recoveries,
    "authority": _claims,
    "policy": _rules,
    "world": _world,
    "knowledge": _fleet_rule_facts,
}
"""The facts of each slot of the state; requests (`_Facts.requests`) and calls rest on more than one."""
