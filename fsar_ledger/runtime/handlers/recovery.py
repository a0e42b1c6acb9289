"""What a recovery attempt meets in the world, what each level may spend, and failures reported from outside.

Paper: sec:model:recovery.
"""

from typing import get_args

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import (
    FAILURE_CAUSES,
    FailureCause,
    Principals,
    RecoveryLevel,
    Result,
    Robot,
    Supervisor,
)
from fsar_ledger.events.execution import ExecutionFailed
from fsar_ledger.events.recovery import RecoveryAttempted, RecoveryAttemptFailed, RecoveryBudgetSet, RecoveryEscalated
from fsar_ledger.projections.budget import Budget, Budgets
from fsar_ledger.projections.execution import Action, left_us
from fsar_ledger.projections.fleet import Fleet
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.recovery import Recovery
from fsar_ledger.projections.registry import Registry
from fsar_ledger.projections.world import World

from .commands import EndAttempt, Handlers, Scheduled, holds, lasts
from .public import PublicCommand, RobotReport, made_from, not_in_charge, outdated, rejected, unknown_robot

LEVELS: tuple[RecoveryLevel, ...] = get_args(RecoveryLevel)

HANDLERS = Handlers()


class SetRecoveryBudget(PublicCommand):
    """Set the budget of one level of the robot's recovery. Units: `t_max_us` microseconds."""

    issued_by: Supervisor
    robot: Robot
    level: str
    t_max_us: int
    n_max: int


class ReportFailure(RobotReport):
    """Report that the action which the executor executes has failed."""

    robot: Robot
    action_id: str
    cause: str


def budget(budgets: Budgets, fleet: Fleet, robot: Robot, level: RecoveryLevel) -> Budget:
    """Return (t_max, n_max) of the level: the robot's own Q_i where it was set, else the fleet's structure.

    Paper: eq:recovery, app:foundations.
    """
    robot_budget = budgets.get((robot, level))
    if robot_budget is not None:
        return robot_budget
    structure = fleet.structure
    match level:
        case "local":
            return Budget(structure.local_budget_us, structure.local_attempts)
        case "peer":
            return Budget(structure.peer_budget_us, structure.peer_helpers)
        case "fleet":
            return Budget(structure.fleet_budget_us, structure.fleet_reassignments)
        case "human":
            return Budget(structure.human_budget_us, structure.human_calls)


@HANDLERS.decide(SetRecoveryBudget)
def set_recovery_budget(state: State, command: SetRecoveryBudget) -> tuple[Event, ...]:
    """Set the level's budget, on the authority of the robot's own supervisor or of H_F. Paper: app:foundations."""
    refused = (
        unknown_robot(state.fleet, command.robot)
        or not_in_charge(state.fleet, command.issued_by, command.robot)
        or _impossible(command)
    )
    if refused is not None:
        return rejected(command, command.robot, refused, command.issued_by)
    level = next(level for level in LEVELS if level == command.level)
    return (made_from(RecoveryBudgetSet, command, level=level, decided_by=command.issued_by),)


def _impossible(command: SetRecoveryBudget) -> str | None:
    if command.level not in LEVELS:
        return f"level {command.level}, expected one of {', '.join(LEVELS)}"
    least = 1 if command.level == "human" else 0  # a failure that nothing else resolved must reach a human
    if command.t_max_us < least or command.n_max < least:
        return (
            f"budget ({command.t_max_us} microseconds, {command.n_max}), "
            f"expected at least {least} of both at level {command.level}"
        )
    return None


def failed(action: Action, cause: FailureCause, now_us: int) -> ExecutionFailed:
    """Return the event that the running action fails now, with how much of its execution was left."""
    return ExecutionFailed(
        subject=action.subject,
        robot=action.robot,
        failure=action.failures + 1,
        cause=cause,
        remaining_us=left_us(action, now_us),
        detected_us=now_us,
    )


@HANDLERS.decide(ReportFailure)
def report_failure(state: State, command: ReportFailure) -> tuple[Event, ...]:
    """Fail the running execution as its own robot reports; recovery begins from there. Paper: sec:model:recovery."""
    refused = outdated(state.fleet, command.robot, command.fence)
    action = state.execution.actions.get(command.action_id)
    if refused is None and action is None:
        refused = f"unknown or finished action {command.action_id}, expected one that is executing"
    if refused is None and action is not None and action.robot != command.robot:
        refused = f"{command.action_id} is executed by {action.robot}, expected its report"
    if refused is None and action is not None and action.stage != "running":
        refused = f"{command.action_id} is {action.stage}, expected running"
    if refused is None and not (command.cause and command.cause.isprintable()):
        refused = f"cause {command.cause!r}, expected what failed, as {FAILURE_CAUSES[0]}"
    if refused is not None or action is None:
        return rejected(command, command.action_id, refused or "", command.robot)
    return (failed(action, command.cause, command.now_us),)


def actuator_holds(world: World, robot: Robot, answer: int) -> bool:
    """Return whether the robot's actuator holds this time.

    A sound one always holds, an unreliable one as its body answers, a slipping or lost one never.
    """
    grade = world.degraded.get(robot)
    return grade is None or (grade == "unreliable" and bool(answer))


def attempt_succeeds(world: World, recovery: Recovery, command: EndAttempt) -> bool:
    """Return whether the way is clear, or the degraded actuator held this time."""
    if command.succeeded is not None:
        return command.succeeded
    if recovery.cause == "obstruction":
        return not world.obstructions.get(recovery.robot)
    return actuator_holds(world, recovery.robot, command.answer)


def attempted(action: Action, recovery: Recovery, principals: Principals, deadline_us: int) -> RecoveryAttempted:
    """Return the event that the robot's next own attempt begins. Units: `deadline_us` run time."""
    return RecoveryAttempted(
        subject=action.subject,
        principals=principals,
        robot=action.robot,
        failure=recovery.failure,
        number=recovery.number + 1,
        level="local",
        deadline_us=deadline_us,
        failed_action=action.action_id,
    )


def escalated(
    action: Action, recovery: Recovery, principals: Principals, to_level: RecoveryLevel, reason: str | None = None
) -> RecoveryEscalated:
    """Return the event that recovery has moved on from its current level."""
    return RecoveryEscalated(
        subject=action.subject,
        principals=principals,
        robot=action.robot,
        failure=recovery.failure,
        level=recovery.level,
        to_level=to_level,
        failed_action=action.action_id,
        reason=reason,
    )


def attempt_failed(registry: Registry, world: World, action: Action, recovery: Recovery) -> RecoveryAttemptFailed:
    """Return the event that the attempt has failed, with its result and the postconditions that hold after it."""
    result, achieved = _attempt_result(registry, world, action, recovery)
    return RecoveryAttemptFailed(
        subject=action.subject,
        robot=action.robot,
        failure=recovery.failure,
        number=recovery.number,
        result=result,
        achieved=achieved,
    )


def end_of_attempt(fleet: Fleet, event: RecoveryAttempted) -> Scheduled:
    """Schedule the end of an attempt that the robot makes by itself, once it has prepared."""
    key = f"{event.failed_action}/{event.failure}/{event.number}"
    end, preparation_us = EndAttempt(event.failed_action, event.number), fleet.structure.retry_preparation_us
    return Scheduled(end, preparation_us, (lasts("retry", key),), holds("retry/" + key))


def _attempt_result(
    registry: Registry, world: World, action: Action, recovery: Recovery
) -> tuple[Result, tuple[str, ...]]:
    """Return the result of an attempt that did not succeed, and the postconditions that hold after it.

    A slipping actuator grips and does not hold: all of the contract is achieved but its last postcondition.
    """
    if recovery.cause == "degradation" and world.degraded.get(action.robot) == "slipping":
        module = registry.modules.get(action.robot, {}).get(action.capability)
        achieved = () if module is None else module.contract.postconditions[:-1]
        if achieved:
            return "partial", achieved
    return "failure", ()
