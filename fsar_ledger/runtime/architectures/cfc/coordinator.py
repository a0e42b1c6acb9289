"""CFC: one coordinator serves all work in order of arrival and reads periodically synced copies.

It calls supervisors, and records their answers without naming the requester. Paper: sec:evaluation:baselines.
"""

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import (
    COORDINATOR,
    FLEET_SUPERVISOR,
    Parties,
    PolicyOutcome,
    Principals,
    RequestSubject,
    Robot,
    Subject,
)
from fsar_ledger.events.knowledge import CopySynced, WorkQueued
from fsar_ledger.events.request import GapDetected, RequestDenied
from fsar_ledger.events.supervision import SupervisorCalled
from fsar_ledger.events.task import StepCompleted, TaskAbandoned
from fsar_ledger.events.world import SyncPhaseSet
from fsar_ledger.projections.fleet import Fleet
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.knowledge import Knowledge
from fsar_ledger.projections.policy import Policy, standing
from fsar_ledger.projections.registry import Registry
from fsar_ledger.projections.request import Request
from fsar_ledger.projections.task import given_up_us
from fsar_ledger.projections.world import in_force, stricter
from fsar_ledger.runtime.handlers import supervision
from fsar_ledger.runtime.handlers.attribution import capable, is_idle
from fsar_ledger.runtime.handlers.commands import (
    ActionCommand,
    Command,
    Decide,
    Handlers,
    React,
    Respond,
    Scheduled,
    nobody,
)
from fsar_ledger.runtime.handlers.supervision import RespondToCall
from fsar_ledger.runtime.handlers.task import TransferSegment, on_completed, transferred
from fsar_ledger.runtime.ports import Ask

NO_TIME = "no time left"  # reason for denying a step whose task would be given up before the coordinator reaches it

HANDLERS = Handlers()


class Sync(Command):
    """Refresh the copies of the robots' states."""


class ReachCoordinator(ActionCommand):
    """Deliver a message about an action to the coordinator."""

    item: str


class ProcessWork(ActionCommand):
    """Process the coordinator's next item of work."""

    item: str


def by_coordinator(executor: Robot | None) -> Principals:
    """Return the principals of a decision before an action is commanded: the coordinator records no requester."""
    return Parties(requested_by=None, executed_by=executor, supervised_by=FLEET_SUPERVISOR).decided(COORDINATOR)


def gap_of(request: Request) -> GapDetected:
    """Return the gap of this request, without naming the robot that has it."""
    parties = Parties(requested_by=None, executed_by=None, supervised_by=FLEET_SUPERVISOR)
    return GapDetected(Subject(request.task_id, None), parties, request.capability)


def to_coordinator(action_id: str, item: str, wait: Ask) -> Scheduled:
    """Send the coordinator a message about the action."""
    return Scheduled(ReachCoordinator(action_id, item), 0, (wait,))


def until_next_sync_us(fleet: Fleet, knowledge: Knowledge, now_us: int) -> int:
    """Return the time until just after the copies are next refreshed. Units: microseconds."""
    period_us = fleet.structure.sync_period_us
    offset_us = knowledge.sync_phase_ppm * period_us // 1_000_000
    return period_us - (now_us - offset_us) % period_us + 1


def copied_policy(copy: CopySynced, robot: Robot) -> PolicyOutcome:
    """Return the robot's own policy as the copy shows it."""
    if robot in copy.local_deny:
        return "deny"
    return "review" if robot in copy.local_review else "allow"


def copied_rule(copy: CopySynced, robot: Robot) -> PolicyOutcome:
    """Return the fleet's rule for the robot's zone as the copy shows it."""
    if robot in copy.fleet_deny:
        return "deny"
    return "review" if robot in copy.fleet_review else "allow"


# See docs/decisions/declared-rules-reach-every-architecture.md.
def declared(policy: Policy, robot: Robot, capability: str | None, context: str | None) -> PolicyOutcome:
    """Return the outcome of the rules on record, the robot's own and the fleet's: no copy of these is out of date.

    Only a founding sets rules under this architecture.
    """
    about = (robot, capability, context)
    return stricter(standing(policy, "local", *about), standing(policy, "fleet", *about))


def candidates_of(fleet: Fleet, registry: Registry, request: Request) -> tuple[Robot, ...]:
    """Return the robots that the coordinator considers for a step: its own robot, or every other capable one."""
    if request.is_delegated:
        return capable(fleet, registry, request.capability, request.requester)
    return (request.requester,)


@HANDLERS.decide(Sync, nobody)
def sync(state: State, _command: Sync) -> tuple[CopySynced, ...]:
    """Copy the robots as they are now; keep the last copy of those that do not answer."""
    robots, copy = state.fleet.robots, state.knowledge.copy
    silent = state.world.off | state.world.unlinked
    local = {robot: in_force(state.world.local, robot) for robot in state.world.local}
    fleet = {robot: in_force(state.world.fleet, robot) for robot in state.world.fleet}

    def merge_silent(before: tuple[Robot, ...], now: list[Robot]) -> tuple[Robot, ...]:
        return (
            tuple(robot for robot in robots if robot in (before if robot in silent else now)) if silent else tuple(now)
        )

    return (
        CopySynced(
            local_deny=merge_silent(copy.local_deny, [robot for robot in robots if local.get(robot) == "deny"]),
            local_review=merge_silent(copy.local_review, [robot for robot in robots if local.get(robot) == "review"]),
            fleet_deny=merge_silent(copy.fleet_deny, [robot for robot in robots if fleet.get(robot) == "deny"]),
            fleet_review=merge_silent(copy.fleet_review, [robot for robot in robots if fleet.get(robot) == "review"]),
            busy=merge_silent(copy.busy, [robot for robot in robots if not is_idle(state.execution, robot)]),
            degraded=merge_silent(copy.degraded, [robot for robot in robots if robot in state.world.degraded]),
        ),
    )


@HANDLERS.decide(ReachCoordinator, nobody)
def reach_coordinator(
    state: State, command: ReachCoordinator
) -> tuple[GapDetected | WorkQueued | RequestDenied | TaskAbandoned, ...]:
    """Queue the item for the coordinator; record a gap without naming the robot that has it.

    The coordinator knows its own queue, so it gives up a step immediately if it would reach it only after the task is
    given up. A queue that grows faster than it is served is therefore bounded by how long tasks last. The denial of
    such a step names the coordinator as decider.
    """
    action = state.execution.actions.get(command.action_id)
    request = state.request.open.get(command.action_id)
    if request is None and action is None:
        return ()
    task_id = request.task_id if request is not None else action.task_id  # type: ignore[union-attr]
    structure = state.fleet.structure
    is_matching = command.item in ("step", "again")
    considered = () if request is None else candidates_of(state.fleet, state.registry, request)
    candidates = len(considered) if is_matching else 0
    service_us = structure.service_us * state.fleet.size // 4
    service_us += service_us * candidates * structure.candidate_cost_ppm // 1_000_000
    ready_us = max(state.knowledge.ready_us, command.now_us) + service_us
    task = state.task.get(task_id)
    # See docs/decisions/late-tasks-are-given-up.md.
    is_hopeless = is_matching and task is not None and ready_us > given_up_us(task, state.fleet)
    queued: tuple[WorkQueued | RequestDenied | TaskAbandoned, ...] = (
        WorkQueued(Subject(task_id, command.action_id), command.item, ready_us),
    )
    if is_hopeless:
        denied = RequestDenied(RequestSubject(task_id, None, None), by_coordinator(None), NO_TIME)
        queued = (denied, TaskAbandoned(task_id))
    if command.item == "step" and request is not None and request.is_delegated:
        return (gap_of(request), *queued)
    return queued


@HANDLERS.react(SyncPhaseSet)
def _first_sync(state: State, event: SyncPhaseSet, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(Sync(), max(1, event.phase_ppm * state.fleet.structure.sync_period_us // 1_000_000)),)


@HANDLERS.react(CopySynced)
def _next_sync(state: State, _event: CopySynced, now_us: int) -> tuple[Scheduled, ...]:
    structure = state.fleet.structure
    if now_us > structure.watch_us and not state.task:
        return ()
    return (Scheduled(Sync(), structure.sync_period_us),)


@HANDLERS.react(WorkQueued)
def _on_work(_state: State, event: WorkQueued, now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(ProcessWork(event.subject.action_id, event.item), max(1, event.ready_us - now_us)),)


def _nobody(_request: Request) -> None:
    return None


def respond(state: State, command: Respond) -> tuple[Event, ...]:
    """Record the supervisor's answer to the coordinator, which does not know the requester."""
    return supervision.respond(state, command, _nobody)


def respond_to_call(state: State, command: RespondToCall) -> tuple[Event, ...]:
    """Let the supervisor who was called answer the open call."""
    return supervision.respond_to_call(state, command, _nobody)


def _on_call(state: State, event: SupervisorCalled, _now_us: int) -> tuple[Scheduled, ...]:
    return supervision.awaiting(state, event, COORDINATOR)


class AssignSegment(TransferSegment):
    """Assign the next segment to its robot."""


@HANDLERS.decide(AssignSegment, nobody)
def assign_segment(state: State, command: AssignSegment) -> tuple[Event, ...]:
    """Assign the next segment to its robot, without recording the previous one."""
    return transferred(state, command, lambda _previous, executor: by_coordinator(executor))


def _on_completed(state: State, event: StepCompleted, now_us: int) -> tuple[Scheduled, ...]:
    """Let the coordinator assign the segment, where another robot acts in the next step."""
    scheduled = on_completed(state, event, now_us)
    if isinstance(scheduled[0].command, TransferSegment):
        return (Scheduled(AssignSegment(event.subject.task_id), 1),)
    return scheduled


INSTEAD: dict[React, React] = {supervision.on_call: _on_call, on_completed: _on_completed}
OWN: dict[type[Command], Decide] = {Respond: respond, RespondToCall: respond_to_call}
