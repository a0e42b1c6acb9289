"""What has happened, as tests write it: of each event what a test is about; the rest is the ordinary."""

from typing import Any

from fsar_ledger.events.authority import AuthorityGranted, AuthorityRevoked
from fsar_ledger.events.envelope import (
    FLEET_SUPERVISOR,
    Availability,
    FailureCause,
    OverrideLevel,
    Parties,
    PolicyOutcome,
    Principal,
    Principals,
    RecoveryLevel,
    RequestSubject,
    Robot,
    Subject,
    Supervisor,
    TrustScope,
    local_supervisor,
)
from fsar_ledger.events.execution import ExecutionFailed, ExecutionFinished, ExecutionQueued, ExecutionStarted
from fsar_ledger.events.fleet import RobotJoined
from fsar_ledger.events.policy import PolicyRuleSet
from fsar_ledger.events.recovery import AssistanceAdmitted, RecoveryBudgetSet
from fsar_ledger.events.registry import AvailabilityChanged, CapabilityAdvertised, CapabilityInstalled, RegistryQueried
from fsar_ledger.events.request import RequestClosed, RequestDenied, RequestIssued
from fsar_ledger.events.supervision import SupervisorCalled, SupervisorResponded
from fsar_ledger.events.task import StepBegan
from fsar_ledger.events.trust import TrustSet
from fsar_ledger.events.world import TaskArrived


def parties(
    requested_by: Principal | None = None, executed_by: Robot | None = None, supervised_by: Supervisor | None = None
) -> Parties:
    return Parties(requested_by=requested_by, executed_by=executed_by, supervised_by=supervised_by)


def principals(
    decided_by: Principal | None = None,
    requested_by: Principal | None = None,
    executed_by: Robot | None = None,
    supervised_by: Supervisor | None = None,
) -> Principals:
    """Of what was decided at once, by nobody else."""
    return Principals(
        decided_by=decided_by,
        requested_by=requested_by,
        executed_by=executed_by,
        supervised_by=supervised_by,
        path=(decided_by,) if decided_by else (),
    )


def arrived(task_id: str, robot: Robot, steps: tuple[str, ...], **fields: Any) -> TaskArrived:
    """A task of a team of robot 1, to be done within a minute."""
    return TaskArrived(
        **{"team": 1, "budget_us": 60_000_000, "due_us": 65_000_000, **fields},
        task_id=task_id,
        robot=robot,
        steps=steps,
    )


def began(
    subject: Subject[Any, Any], robot: Robot, step: int, capability: str, target_role: str | None = None
) -> StepBegan:
    return StepBegan(subject=subject, robot=robot, step=step, attempt=1, capability=capability, target_role=target_role)


def queried(
    subject: Subject[Any, Any], named: Parties, capability: str, *candidates: Robot, **fields: Any
) -> RegistryQueried:
    return RegistryQueried(subject=subject, principals=named, capability=capability, candidates=candidates, **fields)


def issued(action_id: str, named: Principals, capability: str, task_id: str = "t1", **fields: Any) -> RequestIssued:
    """A request that carries its requester's word that it may be made."""
    subject = RequestSubject(task_id, action_id, action_id)
    return RequestIssued(subject=subject, principals=named, capability=capability, carried_policy="allow", **fields)


def closed(action_id: str, named: Principals, task_id: str = "t1", result: Any = "success") -> RequestClosed:
    return RequestClosed(RequestSubject(task_id, action_id, action_id), named, result)


def denied(action_id: str, named: Principals, reason: str, task_id: str = "t1") -> RequestDenied:
    return RequestDenied(RequestSubject(task_id, action_id, action_id), named, reason)


def queued(
    subject: Subject[Any, Any],
    robot: Robot,
    on_behalf_of: Robot,
    capability: str,
    *,
    step: int = 1,
    principals: Parties | None = None,
    override: OverrideLevel = "none",
) -> ExecutionQueued:
    """An action that waits for the robot; of another's step, for its way there as well."""
    return ExecutionQueued(
        subject=subject,
        principals=principals or parties(on_behalf_of, robot),
        robot=robot,
        on_behalf_of=on_behalf_of,
        capability=capability,
        step=step,
        attempt=1,
        is_delegated=robot != on_behalf_of,
        has_approach=robot != on_behalf_of,
        is_supervised=True,
        override=override,
    )


def started(
    subject: Subject[Any, Any],
    robot: Robot,
    on_behalf_of: Robot,
    capability: str,
    ends_us: int,
    principals: Parties | None = None,
) -> ExecutionStarted:
    return ExecutionStarted(
        subject=subject,
        principals=principals or parties(on_behalf_of, robot),
        robot=robot,
        on_behalf_of=on_behalf_of,
        capability=capability,
        ends_us=ends_us,
    )


def failed(
    subject: Subject[Any, Any], robot: Robot, cause: FailureCause, remaining_us: int, detected_us: int, failure: int = 1
) -> ExecutionFailed:
    return ExecutionFailed(
        subject=subject, robot=robot, failure=failure, cause=cause, remaining_us=remaining_us, detected_us=detected_us
    )


def finished(subject: Subject[Any, Any], robot: Robot, requested_by: Principal | None) -> ExecutionFinished:
    return ExecutionFinished(subject, parties(requested_by, robot), robot)


def assisted(
    subject: Subject[Any, Any], robot: Robot, helper: Robot, principals: Principals, level: RecoveryLevel = "peer"
) -> AssistanceAdmitted:
    return AssistanceAdmitted(
        subject=subject, principals=principals, robot=robot, helper=helper, failure=1, level=level
    )


def budget(robot: Robot, level: RecoveryLevel, n_max: int, t_max_us: int = 30_000_000) -> RecoveryBudgetSet:
    """By the robot's own supervisor."""
    return RecoveryBudgetSet(
        robot=robot, level=level, t_max_us=t_max_us, n_max=n_max, decided_by=local_supervisor(robot)
    )


def joined(robot: Robot, role: str, team: int = 1, domain: str = "") -> RobotJoined:
    """Without a supervisor of its own."""
    return RobotJoined(robot=robot, role=role, team=team, supervisor=None, domain=domain)


def installed(robot: Robot, capability: str, version: str = "1.0.0", **fields: Any) -> CapabilityInstalled:
    return CapabilityInstalled(robot=robot, capability=capability, version=version, **fields)


def advertised(robot: Robot, capability: str, **fields: Any) -> CapabilityAdvertised:
    return CapabilityAdvertised(robot=robot, capability=capability, **fields)


def available(robot: Robot, capability: str | None, availability: Availability, reason: str) -> AvailabilityChanged:
    return AvailabilityChanged(robot=robot, capability=capability, availability=availability, reason=reason)


def trusted(robot: Robot, peer: Robot, scope: TrustScope, capability: str | None = None, **fields: Any) -> TrustSet:
    return TrustSet(robot=robot, peer=peer, scope=scope, capability=capability, **fields)


def ruled(
    outcome: PolicyOutcome, robot: Robot, capability: str | None = None, context: str | None = None
) -> PolicyRuleSet:
    """A rule of the robot's own, by its own supervisor."""
    return PolicyRuleSet(
        scope="local",
        robot=robot,
        capability=capability,
        context=context,
        outcome=outcome,
        decided_by=local_supervisor(robot),
    )


def ruled_for_all(
    outcome: PolicyOutcome, robot: Robot | None = None, capability: str | None = None, context: str | None = None
) -> PolicyRuleSet:
    """A rule of the fleet's, by the fleet's supervisor."""
    return PolicyRuleSet(
        scope="fleet", robot=robot, capability=capability, context=context, outcome=outcome, decided_by=FLEET_SUPERVISOR
    )


def granted(
    requested_by: Robot,
    executed_by: Robot | None = None,
    override: OverrideLevel = "none",
    capability: str | None = None,
    context: str | None = None,
    decided_by: Principal | None = FLEET_SUPERVISOR,
) -> AuthorityGranted:
    return AuthorityGranted(
        requested_by=requested_by,
        executed_by=executed_by,
        capability=capability,
        context=context,
        override=override,
        decided_by=decided_by,
    )


def revoked(
    requested_by: Robot,
    executed_by: Robot | None = None,
    capability: str | None = None,
    context: str | None = None,
    reason: Any = "human override",
    decided_by: Principal | None = FLEET_SUPERVISOR,
) -> AuthorityRevoked:
    return AuthorityRevoked(
        requested_by=requested_by,
        executed_by=executed_by,
        capability=capability,
        context=context,
        reason=reason,
        decided_by=decided_by,
    )


def called(subject: Subject[Any, Any], supervisor: Supervisor, purpose: Any, **fields: Any) -> SupervisorCalled:
    return SupervisorCalled(subject=subject, supervisor=supervisor, purpose=purpose, **fields)


def approved(subject: Subject[Any, Any], requested_by: Robot, executed_by: Robot | None) -> SupervisorResponded:
    """A review, by the fleet's supervisor."""
    named = principals(FLEET_SUPERVISOR, requested_by, executed_by, FLEET_SUPERVISOR)
    return SupervisorResponded(subject, named, "review")
