"""Help as work: the helper can be obstructed, and its actuator can fail as well. Paper: sec:model:recovery."""

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import FailureCause, Principal, Principals, RecoveryLevel, Robot, Supervisor
from fsar_ledger.events.recovery import (
    AssistanceAdmitted,
    AssistanceDeclined,
    AssistanceEnded,
    AssistanceFailed,
    FailureResolved,
)
from fsar_ledger.events.world import ObstructionAppeared
from fsar_ledger.projections.execution import HELPING, Action
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.recovery import Recovery
from fsar_ledger.projections.world import World
from fsar_ledger.runtime.ports import Ask

from .attribution import is_idle
from .commands import (
    EndAssistance,
    Failure,
    Handlers,
    HelpCommand,
    Scheduled,
    StopAssistance,
    at_once,
    helping,
    holds,
    message,
    open_failure,
)
from .execution import next_turn
from .recovery import actuator_holds

HANDLERS = Handlers()


def end_assistance(state: State, command: EndAssistance, level: RecoveryLevel) -> tuple[Event, ...]:
    """Resolve the failure at this level, or record that the helper could not; free the helper."""
    match helped(state, command.action_id, command.helper):
        case action, recovery if recovery.failure == command.failure:
            cause = _hindrance(state.world, recovery, command)
            if cause is not None:
                return (help_failed(action, recovery, command.helper, cause),)
            return (
                AssistanceEnded(action.subject, action.robot, command.helper, recovery.failure),
                FailureResolved(action.subject, action.robot, recovery.failure, level),
            )
        case _:
            return ()


@HANDLERS.decide(StopAssistance, helping)
def stop_assistance(state: State, command: StopAssistance) -> tuple[Event, ...]:
    """End the help because the helper itself is obstructed."""
    match helped(state, command.action_id, command.helper):
        case action, recovery if state.world.obstructions.get(command.helper):
            return (help_failed(action, recovery, command.helper, "obstruction"),)
        case _:
            return ()


def ordered(
    state: State,
    command: HelpCommand,
    failure: Failure,
    level: RecoveryLevel,
    requested_by: Principal | None = None,
    supervised_by: Supervisor | None = None,
) -> tuple[Event, ...]:
    """Let the requested robot help, or decline under other work; nothing if another was asked meanwhile.

    Nothing is evaluated, so no decision is recorded.
    """
    action, recovery = failure
    if recovery.awaited != command.helper:
        return ()
    if not is_idle(state.execution, command.helper):
        return (AssistanceDeclined(action.subject, action.robot, command.helper, recovery.failure),)
    return (
        AssistanceAdmitted(
            subject=action.subject,
            principals=Principals(
                decided_by=None,
                requested_by=requested_by,
                executed_by=action.executed_by,
                supervised_by=supervised_by,
                path=(),
            ),
            robot=action.robot,
            helper=command.helper,
            failure=recovery.failure,
            level=level,
        ),
    )


def end_of(event: AssistanceAdmitted, after_us: int, waits: tuple[Ask, ...] = ()) -> Scheduled:
    """Schedule the end of the admitted help.

    A helper whose actuator is degraded gets the same answer under every architecture.
    """
    ask = holds(f"assist/{event.subject.action_id}/{event.failure}/{event.helper}")
    return Scheduled(EndAssistance(event.subject.action_id, event.helper, event.failure), after_us, waits, ask)


def end_once_answered(state: State, event: AssistanceAdmitted, _now_us: int) -> tuple[Scheduled, ...]:
    """Schedule the end of the help for when the helper's answer has reached the robot."""
    answer = message(event.helper, f"{event.subject.action_id}/{event.failure}", "answer")
    return (end_of(event, state.fleet.structure.assistance_us, (answer, at_once(event.robot))),)


def helped(state: State, action_id: str, who: Robot) -> Failure | None:
    """Return the action that the robot helps with and its failure, or None when it helps with none."""
    return open_failure(state, action_id) if state.execution.current.get(who) == HELPING + action_id else None


# See docs/decisions/help-can-fail.md.
def _hindrance(world: World, recovery: Recovery, command: EndAssistance) -> FailureCause | None:
    """Return what keeps the helper from helping, or None.

    Clearing a way takes a body that moves; standing in for an actuator also takes one that holds.
    """
    if world.obstructions.get(command.helper):
        return "obstruction"
    if recovery.cause == "degradation" and not actuator_holds(world, command.helper, command.answer):
        return "degradation"
    return None


def help_failed(action: Action, recovery: Recovery, who: Robot, cause: FailureCause) -> AssistanceFailed:
    """Return the event that the helper could not help, for this cause."""
    return AssistanceFailed(
        subject=action.subject,
        robot=action.robot,
        helper=who,
        failure=recovery.failure,
        cause=cause,
    )


@HANDLERS.react(AssistanceAdmitted)
def _on_assistance(state: State, event: AssistanceAdmitted, _now_us: int) -> tuple[Scheduled, ...]:
    if not state.world.obstructions.get(event.helper):
        return ()
    return (Scheduled(StopAssistance(event.subject.action_id, event.helper)),)


@HANDLERS.react(ObstructionAppeared)
def _on_obstruction(state: State, event: ObstructionAppeared, _now_us: int) -> tuple[Scheduled, ...]:
    current = state.execution.current.get(event.robot, "")
    return (
        (Scheduled(StopAssistance(current.removeprefix(HELPING), event.robot)),) if current.startswith(HELPING) else ()
    )


@HANDLERS.react(AssistanceEnded, AssistanceFailed)
def _on_end(state: State, event: AssistanceEnded | AssistanceFailed, _now_us: int) -> tuple[Scheduled, ...]:
    return next_turn(state.execution, event.helper)
