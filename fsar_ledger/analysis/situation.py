"""The situation of a fleet at a moment of a run, derived from its state.

What rests on a concern that the run does not observe is None, for unknown.
"""

from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, TypeVar

import msgspec

from fsar_ledger.events import CONCERN_OF, CONCERNS, Event
from fsar_ledger.events.envelope import Robot
from fsar_ledger.metrics.provenance import IN_PART
from fsar_ledger.projections.execution import HELPING, doing_and_waiting
from fsar_ledger.projections.fleet import Member
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.registry import surface
from fsar_ledger.projections.request import Request
from fsar_ledger.projections.trust import is_within
from fsar_ledger.runtime.handlers.supervision import is_open

if TYPE_CHECKING:
    from .moments import Past

_T = TypeVar("_T")
EVERY_ROBOT = "every robot"


class Coverage:
    """What the source of a run observes.

    `lacking` has the concerns of which it does not record every event type, each with its name for display.
    `is_in_part`: the run names the event types that it records. `tells_ends`: it records how executions end.
    """

    def __init__(self, started: Event) -> None:
        observes, records = getattr(started, "observes", ()), getattr(started, "records", None)
        partly = {CONCERN_OF.get(name) for name in records or ()}
        unnamed = {concern for name, concern in CONCERN_OF.items() if name not in (records or ())} - {*observes}
        self.lacking = {
            concern: f"{concern}{IN_PART}" if concern in partly else concern
            for concern in CONCERNS
            if concern in unnamed
        }
        self.is_in_part, self._records = records is not None, records or ()
        self.tells_ends = "execution" in observes or {"ExecutionFinished", "ExecutionWithdrawn"} <= {*(records or ())}
        self._names_supervisors = "fleet" in observes or "RobotJoined.supervisor" in (records or ())

    def of(self, concern: str, value: _T) -> _T | None:
        """Return the value, which rests on this concern; None where the run does not observe it."""
        return None if concern in self.lacking else value

    def supervises(self, has_joined: bool) -> bool | None:
        """Return False where a robot that has joined without a supervisor of its own has none; None: not observed."""
        return False if has_joined and self._names_supervisors else None

    def all(self, concern: str, values: Iterable[_T], *ends: str) -> tuple[_T, ...] | None:
        """Return the values, as `of`; of a run that records concerns in part, those on record whose ends are, too."""
        items = tuple(values)
        is_told = self.is_in_part and (not ends or not {*ends}.isdisjoint(self._records))
        return items if items and is_told else self.of(concern, items)


class Window(msgspec.Struct, frozen=True):
    """An open policy window, and the event that opened it. Units: seconds of run time."""

    scope: str
    window: str
    outcome: str
    since_s: float
    seq: int


class Work(msgspec.Struct, frozen=True):
    """An action at a robot, or help with one. Units: `ends_s` run time of its planned end; None: none is planned.

    `capability` is None for help, and where no event on record names it.
    """

    action_id: str
    capability: str | None
    stage: str
    on_behalf_of: str | None
    ends_s: float | None


class RobotNow(msgspec.Struct, frozen=True):
    """A robot: whether it is on and linked, what it does and what waits, and what constrains it.

    `work`: what it does, newest first; empty: nothing, or not observed (see `is_idle`). `offers`: its advertised
    capabilities by availability. `departed`: how it left the fleet, None: it has not, or not observed. `grade` of its
    actuator, None: sound, or not observed. `supervisor` None: none, or not observed (see `has_supervisor`). Any other
    None: not observed.
    """

    robot: str
    role: str | None
    team: int | None
    supervisor: str | None
    has_supervisor: bool | None
    departed: str | None
    is_on: bool | None
    is_linked: bool | None
    grade: str | None
    obstructions: tuple[str, ...] | None
    is_idle: bool | None
    work: tuple[Work, ...]
    queue: tuple[str, ...] | None
    windows: tuple[Window, ...] | None
    offers: dict[str, tuple[str, ...]] | None


class RequestNow(msgspec.Struct, frozen=True):
    """An open request, and its phase."""

    action_id: str
    requester: str
    capability: str
    target: str | None
    phase: str


class ClaimNow(msgspec.Struct, frozen=True):
    """An open claim on one dimension of an action."""

    action_id: str
    dimension: str
    claimant: str


class RecoveryNow(msgspec.Struct, frozen=True):
    """A failure that is being recovered. Units: `since_s` run time of its detection.

    `cause` and `since_s` are None where the failure itself is not on record, `level` and `attempts` where nothing of
    its recovery is and the run does not observe it.
    """

    action_id: str
    robot: str
    cause: str | None
    level: str | None
    attempts: int | None
    since_s: float | None


class CallNow(msgspec.Struct, frozen=True):
    """An open call to a supervisor, by its number in the run."""

    number: int
    supervisor: str
    purpose: str
    action_id: str


class TaskNow(msgspec.Struct, frozen=True):
    """An open task: steps done of all, and the attempt at the present one. Units: `due_s` run time.

    `steps` and `due_s` are None where its arrival is not on record, or does not say them; so is `robot`.
    """

    task_id: str
    robot: str | None
    steps_done: int
    steps: int | None
    step: str | None
    attempt: int
    due_s: float | None


class TrustNow(msgspec.Struct, frozen=True):
    """An entry of trust: of a robot in a peer, or of every robot of a role in those of another; None: all of them.

    An entry between a robot and every robot applies where no other entry does.
    """

    robot: str
    peer: str
    scope: str
    capability: str | None
    task: str | None


class RuleNow(msgspec.Struct, frozen=True):
    """A rule of policy, of a robot or a role; None: every robot, all capabilities, all tasks."""

    scope: str
    robot: str | None
    capability: str | None
    task: str | None
    outcome: str


class Situation(msgspec.Struct, frozen=True, kw_only=True):
    """The situation after an event of a run. None: not observed; `not_observed` names the concerns."""

    robots: tuple[RobotNow, ...] | None
    requests: tuple[RequestNow, ...] | None
    claims: tuple[ClaimNow, ...] | None
    recoveries: tuple[RecoveryNow, ...] | None
    calls: tuple[CallNow, ...] | None
    tasks: tuple[TaskNow, ...] | None
    trust: tuple[TrustNow, ...] | None
    rules: tuple[RuleNow, ...] | None
    off_shift: tuple[str, ...] | None
    not_observed: tuple[str, ...]


def situation(past: "Past", busy_us: Mapping[str, int], robot: str | None) -> Situation:
    """Return the situation then; with `robot`, only what involves it. `busy_us` is facts/busy_before."""
    state = past.state
    members = dict.fromkeys((*state.fleet.robots, *state.execution.current))  # an acting robot need not have joined
    robots = [name for name in members if robot in (None, name)]
    requests = [
        RequestNow(request.action_id, request.requester, request.capability, request.target, _phase(request))
        for request in _open_requests(past)
        if robot in (None, request.requester, request.target)
    ]
    names = {request.action_id for request in requests}
    names |= {action for action in state.execution.actions if robot in (None, state.execution.actions[action].robot)}

    seen = Coverage(past.started)
    return Situation(
        robots=seen.all("fleet", (_robot(past, name, seen, busy_us.get(name, 0)) for name in robots)),
        requests=seen.all("request", requests),
        claims=seen.all(
            "authority",
            (
                ClaimNow(action, claim.dimension, claim.claimant)
                for action, claims in state.authority.claims.items()
                for claim in claims
                if robot is None or action in names
            ),
            "AuthorityReleased",
        ),
        recoveries=seen.all("recovery", _recoveries(state, robot, seen), "FailureResolved", "ExecutionWithdrawn"),
        calls=seen.all(
            "supervision",
            (
                CallNow(number, call.supervisor, call.purpose, call.subject.action_id)
                for number, call in state.supervision.calls.items()
                if is_open(state, call) and (robot is None or call.subject.action_id in names)
            ),
            "SupervisorResponded",
        ),
        tasks=seen.all("task", _tasks(state, robot), "TaskCompleted"),
        trust=seen.all("trust", _trust(state, robot)),
        rules=seen.all("policy", _rules(state, robot)),
        off_shift=seen.all("supervision", sorted(state.world.off_shift), "SupervisorReturned"),
        not_observed=tuple(seen.lacking.values()),
    )


def _open_requests(past: "Past") -> Iterator[Request]:
    """Yield the open requests, each with the robot that has it, or to which it has gone, as its target.

    A request that no event closes, as of an abandoned task in another system's run, is open only while executed.
    """
    actions = past.state.execution.actions
    for open_request in past.state.request.open.values():
        if past.ends.is_over(open_request, actions):
            continue
        action = actions.get(open_request.action_id)
        sent_to = next(
            (name for name in open_request.candidates[:1] if name == past.asked.get(open_request.action_id)), None
        )
        yield msgspec.structs.replace(
            open_request, target=open_request.target or (sent_to if action is None else action.robot)
        )


def _recoveries(state: State, robot: str | None, seen: Coverage) -> Iterator[RecoveryNow]:
    for action, recovery in state.recovery.items():
        if robot in (None, recovery.robot):
            is_seen = recovery.number > 0 or recovery.level != "local" or "recovery" not in seen.lacking
            level, attempts = (recovery.level, recovery.number) if is_seen else (None, None)
            since_s = recovery.detected_us / 1e6 or None
            yield RecoveryNow(action, recovery.robot, recovery.cause, level, attempts, since_s)


def _tasks(state: State, robot: str | None) -> Iterator[TaskNow]:
    for task in state.task.values():
        if robot in (None, task.robot):
            yield TaskNow(
                task.task_id,
                task.robot or None,
                task.step,
                len(task.steps) if task.has_arrived and task.steps else None,
                task.steps[task.step] if 0 <= task.step < len(task.steps) else None,
                task.attempt,
                task.due_us / 1e6 or None,
            )


def _trust(state: State, robot: str | None) -> Iterator[TrustNow]:
    for (truster, peer), entries in state.trust.entries.items():
        if robot in (None, truster, peer):
            for (capability, task), scope in entries.items():
                yield TrustNow(truster, peer, scope, capability, task)
    for (role, peer_role, domain), entries in state.trust.of_roles.items():
        if _has_role(state, robot, (role, peer_role), domain):
            for (capability, task), scope in entries.items():
                yield TrustNow(_role(role, domain), f"role {peer_role}", scope, capability, task)
    for (name, is_trusting), scope in state.trust.initial.items():
        if robot in (None, name):
            trusting, trusted = (name, EVERY_ROBOT) if is_trusting else (EVERY_ROBOT, name)
            yield TrustNow(trusting, trusted, scope, None, None)


def _rules(state: State, robot: str | None) -> Iterator[RuleNow]:
    for (scope, owner, capability, task), outcome in state.policy.rules.items():
        if robot is None or owner in (None, robot):
            yield RuleNow(scope, owner, capability, task, outcome)
    for (scope, role, domain, capability, task), outcome in state.policy.of_roles.items():
        if _has_role(state, robot, (role,), domain):
            yield RuleNow(scope, _role(role, domain), capability, task, outcome)


def _role(role: str, domain: str) -> str:
    return f"role {role} in {domain}" if domain else f"role {role}"


def _has_role(state: State, robot: str | None, roles: tuple[str, ...], domain: str) -> bool:
    """Return whether the robot has one of these roles in the domain; True if `robot` is None."""
    return robot is None or any(
        member.role in roles and is_within(member.domain, domain)
        for member in state.fleet.robots.values()
        if member.name == robot
    )


def _robot(past: "Past", name: Robot, seen: Coverage, busy_us: int) -> RobotNow:
    state = past.state
    is_known = past.time_us >= busy_us and name not in (*state.fleet.departed, *state.knowledge.suspected)
    world, member = state.world, state.fleet.robots.get(name, Member(name, "", 0, None))
    offers: dict[str, tuple[str, ...]] = {}
    for offer in surface(state.registry, name):
        offers[offer.availability] = (*offers.get(offer.availability, ()), offer.capability)
    doing, waiting = doing_and_waiting(state.execution, name)
    work = tuple(current for action in doing if (current := _work(state, action, seen)) is not None)
    return RobotNow(
        name,
        member.role or None,
        member.team or None,
        member.supervisor,
        True if member.supervisor else seen.supervises(name in state.fleet.robots),
        (seen.all("fleet", (state.fleet.departed.get(name),), "RobotReturned") or (None,))[0],
        seen.of("world", name not in world.off),
        seen.of("world", name not in world.unlinked),
        seen.of("world", world.degraded.get(name)),
        seen.of("world", world.obstructions.get(name, ())),
        False if work else seen.of("execution", seen.of("recovery", True if is_known else None)),
        work,
        seen.of("execution", tuple(action.removeprefix(HELPING) for action in waiting)),
        seen.all("policy", _windows(past, name), "PolicyWindowClosed"),
        seen.of("registry", offers),
    )


def _work(state: State, name: str, seen: Coverage) -> Work | None:
    """Return an action of a robot as its work; None where its source does not record how executions end."""
    action = state.execution.actions.get(name)
    if action is None:
        return Work(name.removeprefix(HELPING), None, "helping", None, None)
    if not seen.tells_ends:
        return None
    principal = action.on_behalf_of if action.on_behalf_of != action.robot else None
    ends_s = action.ends_us / 1e6 if action.ends_us else None
    return Work(action.action_id, action.capability or None, action.stage, principal, ends_s)


def _windows(past: "Past", name: Robot) -> Iterator[Window]:
    """Yield the robot's open windows, each with the last event that opened it."""
    for scope, windows in (("local", past.state.world.local), ("fleet", past.state.world.fleet)):
        for window, outcome in windows.get(name, ()):
            seq, time_us = past.opened[name, scope, window]
            yield Window(scope, window, outcome, time_us / 1e6, seq)


def _phase(request: Request) -> str:
    """Return the phase of a request, in words. Paper: eq:request."""
    if request.result is not None:
        return f"done, {request.result}; to be closed"
    if request.is_unanswered:
        return "unanswered"
    if request.is_questioned:
        return "its contract is in question"
    if request.is_accepted:
        return "accepted"
    if request.offered is not None:
        return f"countered: {request.offered}"
    if request.is_heard:
        return "deferred, or before a supervisor"
    if request.is_received:
        return "received"
    if request.target is not None:
        return "asked"
    if request.bids or request.underway:
        return "bids come in"
    return "candidates are known" if request.candidates else "looking for somebody"
