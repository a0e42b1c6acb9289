"""CFC: robots are thin endpoints that execute what they are told, without a local check.

Paper: sec:evaluation:baselines.
"""

from fsar_ledger.events import Event
from fsar_ledger.events.authority import AuthorityClaimed
from fsar_ledger.events.envelope import (
    COORDINATOR,
    FLEET_SUPERVISOR,
    Dimension,
    Parties,
    Principal,
    Robot,
    Subject,
    local_supervisor,
)
from fsar_ledger.events.execution import ExecutionPaused, ReplanOrdered, RoutinePerformed, RoutineWithheld
from fsar_ledger.events.world import ContextChanged, PolicyWindowClosed
from fsar_ledger.projections.authority import Authority
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.request import Requests
from fsar_ledger.runtime.handlers.attribution import on_shift
from fsar_ledger.runtime.handlers.authority import made_for, released
from fsar_ledger.runtime.handlers.commands import (
    Command,
    DecideRoutine,
    Handlers,
    ResumeAction,
    RobotCommand,
    Scheduled,
    StartAction,
    TakeTurn,
    at_once,
    body,
    message,
    named,
    nobody,
)
from fsar_ledger.runtime.handlers.execution import approach, pause_running, started, waiting

from .coordinator import ReachCoordinator, copied_policy, copied_rule, declared, until_next_sync_us

HANDLERS = Handlers()


class SafeStop(RobotCommand):
    """Make a robot whose context has changed safe, while the coordinator holds actions of it or for it."""

    window: str | None


class EndWatch(Command):
    """End a local supervisor's watch over a policy window that has closed."""

    window: str


@HANDLERS.decide(StartAction, body)
def start(state: State, command: StartAction) -> tuple[Event, ...]:
    """Start the execution."""
    action = waiting(state.execution, command.action_id)
    return () if action is None else (started(state, action, command),)


@HANDLERS.decide(SafeStop, named)
def safe_stop(state: State, command: SafeStop) -> tuple[Event, ...]:
    """Let the robot claim override over its actions, and both supervisors claim supervision where a window opened."""
    claimed: list[Event] = []
    for action_id in _held(state.authority, state.request, command.robot):
        task_id = state.request.open[action_id].task_id
        wanted: list[tuple[Dimension, Principal, str]] = [("override", command.robot, "safe stop")]
        if command.window is not None:
            wanted.append(("audit", FLEET_SUPERVISOR, "policy window"))
            if on_shift(state, command.robot) is not None:
                wanted.append(("audit", local_supervisor(command.robot), command.window))
        known = {(claim.dimension, claim.claimant, claim.reason) for claim in state.authority.claims[action_id]}
        claimed += [
            AuthorityClaimed(Subject(task_id, action_id), dimension, claimant, reason)
            for dimension, claimant, reason in wanted
            if (dimension, claimant, reason) not in known
        ]
    return tuple(claimed)


def _held(authority: Authority, requests: Requests, robot: Robot) -> list[str]:
    """Return the robot's actions whose execution the coordinator claims."""
    held = []
    for action_id, claims in authority.claims.items():
        request = requests.open.get(action_id)
        if request is None or robot not in (request.requester, request.target or request.requester):
            continue
        if any(claim.dimension == "execution" and claim.claimant == COORDINATOR for claim in claims):
            held.append(action_id)
    return held


@HANDLERS.decide(EndWatch, nobody)
def end_watch(state: State, command: EndWatch) -> tuple[Event, ...]:
    """Release what the local supervisor watched over in this window."""
    return released(made_for(state.authority, command.window))


@HANDLERS.decide(DecideRoutine, named)
def decide_routine(state: State, command: DecideRoutine) -> tuple[Event, ...]:
    """Perform the routine operation; withhold a motion that the last copy of policy or rule forbids."""
    robot = command.robot
    principals = Parties(requested_by=robot, executed_by=robot, supervised_by=FLEET_SUPERVISOR).decided(robot)
    copy = state.knowledge.copy
    known = (copied_policy(copy, robot), copied_rule(copy, robot), declared(state.policy, robot, None, None))
    if command.operation == "motion" and "deny" in known:
        return (RoutineWithheld(principals, robot, command.operation),)
    return (RoutinePerformed(principals, robot, command.operation),)


@HANDLERS.react(ContextChanged)
def _on_context(state: State, event: ContextChanged, now_us: int) -> tuple[Scheduled, ...]:
    paused = pause_running(state, event, now_us)
    if not _held(state.authority, state.request, event.robot):
        return paused
    return (*paused, Scheduled(SafeStop(event.robot, event.window)))


@HANDLERS.react(PolicyWindowClosed)
def _on_window_closed(state: State, event: PolicyWindowClosed, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(EndWatch(event.window)),) if made_for(state.authority, event.window) else ()


@HANDLERS.react(ExecutionPaused)
def _on_pause(state: State, event: ExecutionPaused, now_us: int) -> tuple[Scheduled, ...]:
    """Tell the coordinator about the pause at the next sync."""
    return (
        Scheduled(
            ReachCoordinator(event.subject.action_id, "replan"),
            until_next_sync_us(state.fleet, state.knowledge, now_us),
            (at_once(event.robot),),
        ),
    )


@HANDLERS.react(ReplanOrdered)
def _on_replan(state: State, event: ReplanOrdered, _now_us: int) -> tuple[Scheduled, ...]:
    task = state.task.get(event.task_id)
    if task is None:  # given up meanwhile
        return ()
    segment = state.execution.actions[task.action_id].segments
    plan = message(COORDINATOR, task.action_id, f"replan{segment}")
    return (Scheduled(ResumeAction(task.action_id), state.fleet.structure.replan_us, (plan,)),)


HANDLERS.decide(TakeTurn, body)(approach)
