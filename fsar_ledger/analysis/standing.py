"""How things stand at a moment of a run: what a person asks of a fleet, from its state."""

from collections.abc import Iterator

import msgspec

from fsar_ledger.events.envelope import Robot
from fsar_ledger.events.world import PolicyWindowOpened
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.projections.execution import Action
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.registry import surface
from fsar_ledger.projections.request import Request


class Window(msgspec.Struct, frozen=True):
    """An open policy window, and the event that opened it. Units: seconds of run time."""

    scope: str
    window: str
    outcome: str
    since_s: float
    seq: int


class Work(msgspec.Struct, frozen=True):
    """An action at a robot, or help with one. Units: `ends_s` run time of its planned end; None: none is planned."""

    action_id: str
    capability: str | None
    stage: str
    on_behalf_of: str | None
    ends_s: float | None


class RobotNow(msgspec.Struct, frozen=True):
    """A robot: whether it is on and linked, what it does and what waits, and what constrains it.

    `offers`: its advertised capabilities by availability. `grade` of its actuator, None: sound.
    """

    robot: str
    role: str
    team: int
    supervisor: str | None
    is_on: bool
    is_linked: bool
    grade: str | None
    obstructions: tuple[str, ...]
    work: Work | None
    queue: tuple[str, ...]
    windows: tuple[Window, ...]
    offers: dict[str, tuple[str, ...]]


class RequestNow(msgspec.Struct, frozen=True):
    """An open request, and how far it is."""

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
    """A failure that is being recovered. Units: `since_s` run time of its detection."""

    action_id: str
    robot: str
    cause: str
    level: str
    attempts: int
    since_s: float


class CallNow(msgspec.Struct, frozen=True):
    """An open call to a supervisor, by its number in the run."""

    number: int
    supervisor: str
    purpose: str
    action_id: str


class TaskNow(msgspec.Struct, frozen=True):
    """An open task: steps done of all, and the attempt at the present one. Units: `due_s` run time."""

    task_id: str
    robot: str
    steps_done: int
    steps: int
    step: str | None
    attempt: int
    due_s: float


class TrustNow(msgspec.Struct, frozen=True):
    """An entry of trust: of a robot in a peer, or of every robot of a role in those of another; None: all of them."""

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


class Standing(msgspec.Struct, frozen=True, kw_only=True):
    """How things stand after an event of a run."""

    robots: tuple[RobotNow, ...]
    requests: tuple[RequestNow, ...]
    claims: tuple[ClaimNow, ...]
    recoveries: tuple[RecoveryNow, ...]
    calls: tuple[CallNow, ...]
    tasks: tuple[TaskNow, ...]
    trust: tuple[TrustNow, ...]
    rules: tuple[RuleNow, ...]
    off_shift: tuple[str, ...]


def standing(record: LedgerRun, seq: int, state: State, robot: str | None = None) -> Standing:
    """Return how things stand after this event; with `robot`, only what that robot has a part in."""
    robots = [name for name in state.fleet.robots if robot in (None, name)]
    requests = [
        RequestNow(one.action_id, one.requester, one.capability, one.target, _phase(one))
        for one in state.request.open.values()
        if not one.is_over and robot in (None, one.requester, one.target)
    ]
    names = {one.action_id for one in requests}
    names |= {one for one in state.execution.actions if robot in (None, state.execution.actions[one].robot)}

    def is_about(action_id: str) -> bool:
        return robot is None or action_id in names

    return Standing(
        robots=tuple(_robot(record, seq, state, name) for name in robots),
        requests=tuple(requests),
        claims=tuple(
            ClaimNow(action, claim.dimension, claim.claimant)
            for action, claims in state.authority.claims.items()
            for claim in claims
            if is_about(action)
        ),
        recoveries=tuple(
            RecoveryNow(action, one.robot, one.cause, one.level, one.number, one.detected_us / 1e6)
            for action, one in state.recovery.items()
            if robot in (None, one.robot)
        ),
        calls=tuple(
            CallNow(number, one.supervisor, one.purpose, one.subject.action_id)
            for number, one in state.supervision.calls.items()
            if is_about(one.subject.action_id)
        ),
        tasks=tuple(
            TaskNow(
                one.task_id,
                one.robot,
                one.step,
                len(one.steps),
                one.steps[one.step] if one.step < len(one.steps) else None,
                one.attempt,
                one.due_us / 1e6,
            )
            for one in state.task.values()
            if robot in (None, one.robot)
        ),
        trust=tuple(one for one in _trust(state) if robot in (None, one.robot, one.peer)),
        rules=tuple(_rules(state, robot)),
        off_shift=tuple(sorted(state.world.off_shift)),
    )


def _trust(state: State) -> Iterator[TrustNow]:
    for (robot, peer), entries in state.trust.entries.items():
        for (capability, task), scope in entries.items():
            yield TrustNow(robot, peer, scope, capability, task)
    for (role, peer_role, domain), entries in state.trust.of_roles.items():
        where = f" in {domain}" if domain else ""
        for (capability, task), scope in entries.items():
            yield TrustNow(f"role {role}{where}", f"role {peer_role}", scope, capability, task)


def _rules(state: State, robot: str | None) -> Iterator[RuleNow]:
    for (scope, whose, capability, task), outcome in state.policy.rules.items():
        if robot is None or whose in (None, robot):
            yield RuleNow(scope, whose, capability, task, outcome)
    for (scope, role, domain, capability, task), outcome in state.policy.of_roles.items():
        where = f" in {domain}" if domain else ""
        yield RuleNow(scope, f"role {role}{where}", capability, task, outcome)


def _robot(record: LedgerRun, seq: int, state: State, name: Robot) -> RobotNow:
    world, member = state.world, state.fleet.robots[name]
    offers: dict[str, tuple[str, ...]] = {}
    for one in surface(state.registry, name):
        offers[one.availability] = (*offers.get(one.availability, ()), one.capability)
    return RobotNow(
        name,
        member.role,
        member.team,
        member.supervisor,
        name not in world.off,
        name not in world.unlinked,
        world.degraded.get(name),
        world.obstructions.get(name, ()),
        _work(state, name),
        state.execution.queues.get(name, ()),
        tuple(_windows(record, seq, state, name)),
        offers,
    )


def _work(state: State, name: Robot) -> Work | None:
    current = state.execution.current.get(name)
    if current is None:
        return None
    action = state.execution.actions.get(current)
    if action is None:
        return Work(current.partition(":")[2], None, "helping", None, None)
    return Work(action.action_id, action.capability, action.stage, _other(action), action.ends_us / 1e6 or None)


def _other(action: Action) -> str | None:
    return action.on_behalf_of if action.on_behalf_of != action.robot else None


def _windows(record: LedgerRun, seq: int, state: State, name: Robot) -> Iterator[Window]:
    """Yield the robot's open windows, each with the last event before this one that opened it."""
    for scope, windows in (("local", state.world.local), ("fleet", state.world.fleet)):
        for window, outcome in windows.get(name, ()):
            opened = next(
                at
                for at in range(seq, -1, -1)
                if isinstance(event := record.events[at], PolicyWindowOpened) and event.window == window
            )
            yield Window(scope, window, outcome, record.times_us[opened] / 1e6, opened)


def _phase(request: Request) -> str:
    """Say how far a request is. Paper: eq:request."""
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
