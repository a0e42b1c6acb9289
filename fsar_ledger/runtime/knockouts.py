"""Removal of mechanisms, to measure the effect of each.

A knockout changes decisions of one architecture and leaves the world as it is. The handlers themselves check the four
mechanisms of the paper's ablation; the replacements of all others are here. A configuration loses only the mechanisms
that it names.
"""

from collections.abc import Callable, Mapping
from functools import lru_cache, partial, wraps
from types import MappingProxyType
from typing import Any, NamedTuple

import msgspec

from fsar_ledger.designs.constants import Structure
from fsar_ledger.events import Event
from fsar_ledger.events.authority import AuthorityClaimed
from fsar_ledger.events.configuration import MECHANISMS_OF, Configuration, removed_mechanisms, without
from fsar_ledger.events.envelope import COORDINATOR, Agent, Architecture, Robot, as_robot, flat, robot_of, with_columns
from fsar_ledger.events.execution import ExecutionFailed, RoutinePerformed
from fsar_ledger.events.recovery import FailureResolved, RecoveryAttempted, RecoveryAttemptFailed
from fsar_ledger.events.request import ContractQuestioned, RequestClosed
from fsar_ledger.projections.budget import Budgets
from fsar_ledger.projections.execution import Action
from fsar_ledger.projections.fleet import Fleet
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.recovery import Recovery
from fsar_ledger.projections.world import in_force
from fsar_ledger.runtime.architectures import HandlerTable, cfc
from fsar_ledger.runtime.architectures.cfc import coordinator
from fsar_ledger.runtime.architectures.cfc import execution as cfc_execution
from fsar_ledger.runtime.architectures.cfc.execution import HANDLERS, GoOnWithoutHelp, go_on_without_help
from fsar_ledger.runtime.architectures.dhma import Dispute, agents
from fsar_ledger.runtime.architectures.dhma import execution as dhma_execution
from fsar_ledger.runtime.architectures.dhma import request as dhma_request
from fsar_ledger.runtime.architectures.fsar import authority as fsar_authority
from fsar_ledger.runtime.architectures.fsar import request as fsar_request
from fsar_ledger.runtime.architectures.fsar.execution import ready, start_under
from fsar_ledger.runtime.handlers.admissibility import holding
from fsar_ledger.runtime.handlers.attribution import parties, recorded_by
from fsar_ledger.runtime.handlers.commands import (
    ActionCommand,
    CloseRequest,
    Command,
    Decide,
    DecideRoutine,
    EndAttempt,
    React,
    Scheduled,
    StartAction,
    body,
    open_failure,
)
from fsar_ledger.runtime.handlers.execution import started
from fsar_ledger.runtime.handlers.recovery import attempt_failed, attempt_succeeds, attempted, budget, end_of_attempt
from fsar_ledger.runtime.handlers.trust import AssessTrust

ChangeTable = Callable[[HandlerTable], HandlerTable]


class Knockout(NamedTuple):
    """One mechanism: its name, its architecture, and the decisions without it.

    `decides` replaces whole decisions; `change` alters the handler table in another way. A mechanism that the handlers
    check themselves has neither.
    """

    name: str
    architecture: Architecture
    decides: Mapping[type[Command], Decide] = MappingProxyType({})
    change: ChangeTable | None = None

    @property
    def configuration(self) -> Configuration:
        """Return the configuration that lacks this mechanism alone."""
        return without([self.name])

    def taken_out_of(self, table: HandlerTable) -> HandlerTable:
        """Return the table without the mechanism."""
        changed = table if self.change is None else self.change(table)
        return HandlerTable({**changed.decides, **self.decides}, changed.reacts, changed.actors)


def decide_nothing(_state: State, _command: Command) -> tuple[Event, ...]:
    """Decide nothing."""
    return ()


def on_view(slot: str, seen: Callable[[State], Any], decide: Callable[..., Any]) -> Callable[..., Any]:
    """Return the same decision or reaction, made on a copy of the state with `seen` in this slot."""

    @wraps(decide)
    def decide_on_it(state: State, *arguments: Any) -> Any:
        copy = state.copy()
        setattr(copy, slot, seen(state))
        return decide(copy, *arguments)

    return decide_on_it


def edit_events(change: Callable[[State, Event], Event | None], decide: Decide) -> Decide:
    """Return the same decision with each event changed, or left out where `change` returns None."""

    @wraps(decide)
    def edited(state: State, command: Command) -> tuple[Event, ...]:
        return tuple(changed for event in decide(state, command) if (changed := change(state, event)) is not None)

    return edited


def in_every_decision(change: Callable[[State, Event], Event | None]) -> ChangeTable:
    """Return a table change that edits the events of every decision."""

    def changed(table: HandlerTable) -> HandlerTable:
        decides = {command: edit_events(change, decide) for command, decide in table.decides.items()}
        return HandlerTable(decides, table.reacts, table.actors)

    return changed


def leaving_out(kind: type[Event], command: type[Command]) -> ChangeTable:
    """Return a table change that drops events of this type from the decision on this command."""

    def changed(table: HandlerTable) -> HandlerTable:
        edited = edit_events(lambda _state, event: None if isinstance(event, kind) else event, table.decides[command])
        return HandlerTable({**table.decides, command: edited}, table.reacts, table.actors)

    return changed


def decided_by(event: Event, robot: Robot | None) -> Event:
    """Return the event with this robot, or none, recorded as the decider."""
    return with_columns(event, decided_by=robot, path=() if robot is None else (robot,))


def zeroed(name: str) -> Callable[[State], Any]:
    """Return a view of the fleet in which this duration of its structure is 0."""
    return lambda state: state.fleet.__replace__(structure=_zeroed(state.fleet.structure, name))


@lru_cache(maxsize=4)
def _zeroed(structure: Structure, name: str) -> Structure:
    return msgspec.structs.replace(structure, **{name: 0})


def _closed_by_requester(state: State, command: CloseRequest) -> tuple[Event, ...]:
    events = fsar_request.close_request(state, command)
    return tuple(
        decided_by(event, as_robot(event.principals.requested_by))
        if isinstance(event, RequestClosed) and event.principals.requested_by is not None
        else event
        for event in events
    )


Start = Callable[[State, Action, StartAction], tuple[Event, ...]]


def _unchecked(state: State, action: Action, command: StartAction) -> tuple[Event, ...]:
    return (started(state, action, command),)


def _checked_by_own_policy(state: State, action: Action, command: StartAction) -> tuple[Event, ...]:
    return start_under(state, action, command, holding(state, action)[0], "allow")


def _with_start(replacement: Start, *, is_delegated: bool) -> ChangeTable:
    """Return a table change that replaces how delegated work (or the robot's own) is started."""

    def changed(table: HandlerTable) -> HandlerTable:
        checked = table.decides[StartAction]

        @wraps(checked)
        def start(state: State, command: Any) -> tuple[Event, ...]:
            action = ready(state.execution, command)
            if action is None or action.is_delegated != is_delegated:
                return checked(state, command)
            return replacement(state, action, command)

        return HandlerTable({**table.decides, StartAction: start}, table.reacts, table.actors)

    return changed


def _moved_unchecked(state: State, command: DecideRoutine) -> tuple[Event, ...]:
    robot = command.robot
    parties = recorded_by(state, robot, requested_by=robot, executed_by=robot)
    return (RoutinePerformed(parties.decided(robot), robot, command.operation),)


_OF_FSAR = (
    Knockout("trust-evaluation", "fsar"),
    Knockout("policy-composition", "fsar"),
    Knockout("layered-recovery", "fsar"),
    Knockout("shared-registry", "fsar"),
    Knockout("trust-by-record", "fsar", {AssessTrust: decide_nothing}),
    Knockout("engine-closing", "fsar", {CloseRequest: _closed_by_requester}),
    Knockout("boundary-revocation", "fsar", {fsar_authority.Revoke: decide_nothing}),
    Knockout("start-recheck", "fsar", change=_with_start(_unchecked, is_delegated=True)),
    Knockout("fleet-recheck", "fsar", change=_with_start(_checked_by_own_policy, is_delegated=True)),
    Knockout("own-work-check", "fsar", {DecideRoutine: _moved_unchecked}, _with_start(_unchecked, is_delegated=False)),
)


def _copy_of_now(state: State) -> Any:
    """Return the knowledge with a copy of the robots' current state."""
    (copy,) = coordinator.sync(state, coordinator.Sync())
    return state.knowledge.__replace__(copy=copy)


class RetryAlone(ActionCommand):
    """Start the robot's own attempt after a failure that it has seen."""


def _may_try(budgets: Budgets, fleet: Fleet, recovery: Recovery, attempts: int, now_us: int) -> bool:
    """Return whether the robot may try again after this many attempts, by the number and the time of its budget."""
    allowed = budget(budgets, fleet, recovery.robot, "local")
    return attempts < allowed.n_max and now_us < recovery.detected_us + allowed.t_max_us


def _retried(state: State, action: Action, recovery: Recovery) -> RecoveryAttempted:
    by_robot = parties(state, action).decided(action.robot)
    allowed = budget(state.budget, state.fleet, action.robot, "local")
    return attempted(action, recovery, by_robot, recovery.detected_us + allowed.t_max_us)


def _retry_alone(state: State, command: RetryAlone) -> tuple[Event, ...]:
    failure = open_failure(state, command.action_id)
    return () if failure is None else (_retried(state, *failure),)


def _end_own_attempt(state: State, command: EndAttempt) -> tuple[Event, ...]:
    """End the robot's attempt; once its budget is spent, the coordinator takes over."""
    failure = open_failure(state, command.action_id)
    if failure is None or failure[1].number != command.number:
        return ()
    action, recovery = failure
    if attempt_succeeds(state.world, recovery, command):
        return (FailureResolved(action.subject, action.robot, recovery.failure, "local"),)
    failed = attempt_failed(state.registry, state.world, action, recovery)
    if _may_try(state.budget, state.fleet, recovery, command.number, command.now_us):
        return (failed, _retried(state, action, recovery))
    return (failed,)


def _on_own_failure(state: State, event: ExecutionFailed, now_us: int) -> tuple[Scheduled, ...]:
    if _may_try(state.budget, state.fleet, state.recovery[event.subject.action_id], 0, now_us):
        return (Scheduled(RetryAlone(event.subject.action_id)),)
    return HANDLERS.reacts[ExecutionFailed](state, event, now_us)


def _on_own_attempt(state: State, event: RecoveryAttempted, now_us: int) -> tuple[Scheduled, ...]:
    if event.principals.decided_by == COORDINATOR:  # it orders one where the robot may not try at all
        return HANDLERS.reacts[RecoveryAttempted](state, event, now_us)
    return (end_of_attempt(state.fleet, event),)


def _on_own_attempt_failed(state: State, event: RecoveryAttemptFailed, now_us: int) -> tuple[Scheduled, ...]:
    """Report only the last failed attempt to the coordinator."""
    failure = open_failure(state, event.subject.action_id)
    if failure is not None and _may_try(state.budget, state.fleet, failure[1], event.number, now_us):
        return ()
    return HANDLERS.reacts[RecoveryAttemptFailed](state, event, now_us)


def _recovering_alone(table: HandlerTable) -> HandlerTable:
    """Let robots make their own attempts before the coordinator hears of a failure."""
    instead: dict[React, React] = {
        HANDLERS.reacts[ExecutionFailed]: _on_own_failure,
        HANDLERS.reacts[RecoveryAttempted]: _on_own_attempt,
        HANDLERS.reacts[RecoveryAttemptFailed]: _on_own_attempt_failed,
    }
    reacts = {
        event: tuple(instead.get(react, react) for react in reactions) for event, reactions in table.reacts.items()
    }
    return HandlerTable(
        {**table.decides, RetryAlone: _retry_alone, EndAttempt: _end_own_attempt},
        reacts,
        {**table.actors, RetryAlone: body},
    )


def _requester_named(state: State, event: Event) -> Event:
    """Record the task's owner as the requester where the requester is missing or the coordinator."""
    values = flat(event)
    task = state.task.get(values.get("task_id") or "")
    if task is not None and values.get("requested_by", "") in (None, COORDINATOR):
        return with_columns(event, requested_by=task.robot)
    return event


def _decided_by_robots(state: State, event: Event) -> Event:
    values = flat(event)
    if values.get("decided_by") != COORDINATOR:
        return event
    task = state.task.get(values["task_id"] or "")
    robot = values["executed_by"] or (None if task is None else task.robot)
    return event if robot is None else decided_by(event, robot)


_now = partial(on_view, "knowledge", _copy_of_now)
_served_at_once = partial(on_view, "fleet", zeroed("service_us"))

_OF_CFC = (
    Knockout("safe-stop-claims", "cfc", {cfc_execution.SafeStop: decide_nothing}),
    Knockout(
        "synced-copies",
        "cfc",
        {
            coordinator.ProcessWork: _now(cfc.process),
            cfc.CommandReviewed: _now(cfc.command_reviewed),
            DecideRoutine: _now(cfc_execution.decide_routine),
        },
    ),
    Knockout(
        "coordinator-queue",
        "cfc",
        {
            coordinator.ReachCoordinator: _served_at_once(coordinator.reach_coordinator),
            GoOnWithoutHelp: _served_at_once(go_on_without_help),
        },
    ),
    Knockout("central-recovery", "cfc", change=_recovering_alone),
    Knockout("unnamed-requests", "cfc", change=in_every_decision(_requester_named)),
    Knockout("central-decisions", "cfc", change=in_every_decision(_decided_by_robots)),
)


def _passed_at_once(state: State, command: dhma_execution.PassExecution) -> tuple[Event, ...]:
    """Let the sender release at the instant at which the receiver claims."""
    events = dhma_execution.pass_execution(state, command)
    acknowledged = dhma_execution.acknowledge_execution(
        state, dhma_execution.AcknowledgeExecution(command.action_id, command.round, command.sender)
    )
    return (*acknowledged, *events)


def _snapshots_of_now(state: State) -> Any:
    """Return the knowledge with snapshots of the policy in force at every robot."""
    return state.knowledge.__replace__(
        snapshot={robot: in_force(state.world.local, robot) for robot in state.fleet.robots}
    )


def _talking_in_no_time(table: HandlerTable) -> HandlerTable:
    """Deliver messages between the agents of a robot at once; they are recorded as before."""
    quick = partial(on_view, "fleet", zeroed("hop_ppm"))
    return HandlerTable(
        table.decides, {event: tuple(map(quick, reactions)) for event, reactions in table.reacts.items()}, table.actors
    )


def _decided_as_one(_state: State, event: Event) -> Event:
    agent: Agent | None = flat(event).get("decided_by")
    if agent is None or not agent.startswith("agent/"):
        return event
    return decided_by(event, robot_of(agent))


_policy_now = partial(on_view, "knowledge", _snapshots_of_now)

_OF_DHMA = (
    Knockout("acknowledged-handoffs", "dhma", {dhma_execution.PassExecution: _passed_at_once}),
    Knockout("planner-claims", "dhma", change=leaving_out(AuthorityClaimed, agents.EngagePlanner)),
    Knockout("recovery-disputes", "dhma", {Dispute: decide_nothing}),
    Knockout("contract-questioning", "dhma", change=leaving_out(ContractQuestioned, agents.EngagePlanner)),
    Knockout(
        "policy-snapshots",
        "dhma",
        {
            dhma_request.EvaluateBid: _policy_now(dhma_request.evaluate_bid),
            dhma_execution.PlanOwnStep: _policy_now(dhma_execution.plan_own_step),
            DecideRoutine: _policy_now(dhma_execution.decide_routine),
        },
    ),
    Knockout("hop-latency", "dhma", change=_talking_in_no_time),
    Knockout("handoff-records", "dhma", {agents.HandOver: decide_nothing}),
    Knockout("agent-decisions", "dhma", change=in_every_decision(_decided_as_one)),
    Knockout("nested-queries", "dhma", {dhma_execution.RunOutsider: decide_nothing}),
)


KNOCKOUTS: tuple[Knockout, ...] = _OF_FSAR + _OF_CFC + _OF_DHMA
assert {(knockout.architecture, knockout.name) for knockout in KNOCKOUTS} == {
    (architecture, name) for architecture, names in MECHANISMS_OF.items() for name in names
}


def knock_out(table: HandlerTable, architecture: Architecture, configuration: Configuration) -> HandlerTable:
    """Return the architecture's table without the mechanisms that the configuration lacks, but for handlers' checks."""
    for knockout in KNOCKOUTS:
        if knockout.architecture == architecture and knockout.name in removed_mechanisms(configuration):
            table = knockout.taken_out_of(table)
    return table
