"""Mechanisms that can be taken out one at a time, to show which number each of them carries.

A switch changes decisions of one architecture and leaves the world as it is. The four mechanisms of the paper's ablation are known to the
handlers; what stands in the place of any other one stands here, and no switch is on in a configuration that does not name it.
"""

from collections.abc import Callable, Mapping
from functools import lru_cache, partial, wraps
from types import MappingProxyType
from typing import Any, NamedTuple

import msgspec

from fsar_ledger.constants import Structure
from fsar_ledger.events import Event
from fsar_ledger.events.authority import AuthorityClaimed
from fsar_ledger.events.configuration import MECHANISMS_OF, Configuration, lacks, without
from fsar_ledger.events.envelope import (
    COORDINATOR,
    Agent,
    Architecture,
    Parties,
    Robot,
    as_robot,
    flat,
    robot_of,
    with_columns,
)
from fsar_ledger.events.execution import ExecutionFailed, RoutinePerformed
from fsar_ledger.events.recovery import FailureResolved, RecoveryAttempted, RecoveryAttemptFailed
from fsar_ledger.events.request import ContractQuestioned, RequestClosed
from fsar_ledger.projections.execution import Action
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.recovery import Recovery
from fsar_ledger.projections.world import in_force
from fsar_ledger.runtime.architectures.cfc import coordinator as cfc_coordinator
from fsar_ledger.runtime.architectures.cfc import execution as cfc_execution
from fsar_ledger.runtime.architectures.cfc import recovery as cfc_recovery
from fsar_ledger.runtime.architectures.cfc import request as cfc_request
from fsar_ledger.runtime.architectures.dhma import agents as dhma_agents
from fsar_ledger.runtime.architectures.dhma import authority as dhma_authority
from fsar_ledger.runtime.architectures.dhma import execution as dhma_execution
from fsar_ledger.runtime.architectures.dhma import recovery as dhma_recovery
from fsar_ledger.runtime.architectures.dhma import request as dhma_request
from fsar_ledger.runtime.architectures.dhma import talk as dhma_talk
from fsar_ledger.runtime.architectures.fsar import authority as fsar_authority
from fsar_ledger.runtime.architectures.fsar import request as fsar_request
from fsar_ledger.runtime.architectures.wiring import Wiring
from fsar_ledger.runtime.handlers.actors import body
from fsar_ledger.runtime.handlers.attribution import on_shift, parties
from fsar_ledger.runtime.handlers.commands import (
    CloseRequest,
    Command,
    Decide,
    DecideRoutine,
    Draw,
    EndAttempt,
    React,
    Scheduled,
    StartAction,
)
from fsar_ledger.runtime.handlers.execution import holds_robot, started
from fsar_ledger.runtime.handlers.recovery import attempt_result, attempt_succeeds, budget, open_failure

Rewire = Callable[[Wiring], Wiring]


class Switch(NamedTuple):
    """One mechanism: its name, whose it is, and the decisions without it.

    `decides` replaces whole decisions; `rewire` changes the wiring in another way. A mechanism that the handlers know has neither.
    """

    name: str
    architecture: Architecture
    decides: Mapping[type[Command], Decide] = MappingProxyType({})
    rewire: Rewire | None = None

    @property
    def mechanism(self) -> str:
        """What it is, and what stands in its place."""
        return MECHANISMS_OF[self.architecture][self.name]

    @property
    def configuration(self) -> Configuration:
        """The architecture without this mechanism alone."""
        return without([self.name])

    def taken_out(self, whole: Wiring) -> Wiring:
        """The wiring without the mechanism."""
        with_columns = whole if self.rewire is None else self.rewire(whole)
        return Wiring({**with_columns.decides, **self.decides}, with_columns.reacts, with_columns.actors)


def switched(whole: Wiring, architecture: Architecture, configuration: Configuration) -> Wiring:
    """The architecture's wiring without what the configuration lacks; what its handlers look at themselves is still in it."""
    for switch in SWITCHES:
        if switch.architecture == architecture and switch.name in lacks(configuration):
            whole = switch.taken_out(whole)
    return whole


# --- how decisions are with_columns ---


def _nothing(_state: State, _command: Command) -> tuple[Event, ...]:
    return ()


def _seeing(slot: str, with_columns: Callable[[State], Any], decide: Callable[..., Any]) -> Callable[..., Any]:
    """The same decision, or reaction, on a state of which one slot is another."""

    @wraps(decide)
    def seen(state: State, *about: Any) -> Any:
        other = State.__new__(State)
        for name in State.__slots__:
            setattr(other, name, getattr(state, name))
        setattr(other, slot, with_columns(state))
        return decide(other, *about)

    return seen


def _retold(change: Callable[[State, Event], Event | None], decide: Decide) -> Decide:
    """The same decision, with its events with_columns one by one, or left out."""

    @wraps(decide)
    def retold(state: State, command: Command) -> tuple[Event, ...]:
        return tuple(
            with_columns for event in decide(state, command) if (with_columns := change(state, event)) is not None
        )

    return retold


def _everywhere(change: Callable[[Decide], Decide]) -> Rewire:
    def rewired(whole: Wiring) -> Wiring:
        return Wiring(
            {command: change(decide) for command, decide in whole.decides.items()}, whole.reacts, whole.actors
        )

    return rewired


def _leaving_out(kind: type[Event], command: type[Command]) -> Rewire:
    """The decision on this command makes no event of this type."""

    def rewired(whole: Wiring) -> Wiring:
        retold = _retold(lambda _state, event: None if isinstance(event, kind) else event, whole.decides[command])
        return Wiring({**whole.decides, command: retold}, whole.reacts, whole.actors)

    return rewired


def _decided_by(event: Event, robot: Robot | None) -> Event:
    return with_columns(event, decided_by=robot, path=() if robot is None else (robot,))


@lru_cache(maxsize=4)
def _instead(structure: Structure, name: str) -> Structure:
    return msgspec.structs.replace(structure, **{name: 0})


def _in_no_time(name: str) -> Callable[[State], Any]:
    """The fleet, with this length of its structure 0."""
    return lambda state: msgspec.structs.replace(state.fleet, structure=_instead(state.fleet.structure, name))


# --- FSAR ---


def _closed_by_requester(state: State, command: CloseRequest) -> tuple[Event, ...]:
    events = fsar_request.close_request(state, command)
    return tuple(
        _decided_by(event, as_robot(event.principals.requested_by))
        if isinstance(event, RequestClosed) and event.principals.requested_by is not None
        else event
        for event in events
    )


def _started_unchecked(state: State, command: StartAction) -> tuple[Event, ...]:
    """The action runs as soon as its robot is there for it."""
    action = state.execution.actions.get(command.action_id)
    if action is None or action.stage not in ("queued", "approaching", "preempted") or not holds_robot(state, action):
        return ()
    if action.stage == "preempted" and action.has_approach:  # it has to come back first
        return ()
    return (started(state, action, command),)


def _starting_unchecked(*, is_delegated: bool) -> Rewire:
    """What others asked for, or what is the robot's own, starts unchecked; the other of them as before."""

    def rewired(whole: Wiring) -> Wiring:
        checked = whole.decides[StartAction]

        @wraps(checked)
        def start(state: State, command: Any) -> tuple[Event, ...]:
            action = state.execution.actions.get(command.action_id)
            is_meant = action is not None and action.is_delegated == is_delegated
            return _started_unchecked(state, command) if is_meant else checked(state, command)

        return Wiring({**whole.decides, StartAction: start}, whole.reacts, whole.actors)

    return rewired


def _moved_unchecked(state: State, command: DecideRoutine) -> tuple[Event, ...]:
    robot = command.robot
    parties = Parties(requested_by=robot, executed_by=robot, supervised_by=on_shift(state, robot))
    return (RoutinePerformed(parties.decided(robot), robot, command.operation),)


# --- CFC ---


def _copy_of_now(state: State) -> Any:
    """What is known, with a copy that shows the robots as they are."""
    (copy,) = cfc_coordinator.sync(state, cfc_coordinator.Sync())
    return msgspec.structs.replace(state.knowledge, copy=copy)


class RetryAlone(Command):
    """The robot has seen its own failure."""

    action_id: str


def _may_try(state: State, recovery: Recovery, tried: int, now_us: int) -> bool:
    """The robot may try again after so many attempts: neither their number nor the time of its budget is spent."""
    allowed = budget(state, recovery.robot, "local")
    return tried < allowed.n_max and now_us < recovery.detected_us + allowed.t_max_us


def _retried(state: State, action: Action, recovery: Recovery) -> RecoveryAttempted:
    return RecoveryAttempted(
        subject=action.subject,
        principals=parties(state, action).decided(action.robot),
        robot=action.robot,
        failure=recovery.failure,
        number=recovery.number + 1,
        level="local",
        deadline_us=recovery.detected_us + budget(state, action.robot, "local").t_max_us,
        failed_action=action.action_id,
    )


def _retry_alone(state: State, command: RetryAlone) -> tuple[Event, ...]:
    failure = open_failure(state, command.action_id)
    return () if failure is None else (_retried(state, *failure),)


def _end_own_attempt(state: State, command: EndAttempt) -> tuple[Event, ...]:
    """The robot tries as often, and as long, as any robot may; then it is the coordinator's."""
    failure = open_failure(state, command.action_id)
    if failure is None or failure[1].number != command.number:
        return ()
    action, recovery = failure
    if attempt_succeeds(state, recovery, command):
        return (FailureResolved(action.subject, action.robot, recovery.failure, "local"),)
    result, achieved = attempt_result(state, action, recovery)
    failed = RecoveryAttemptFailed(
        subject=action.subject,
        robot=action.robot,
        failure=recovery.failure,
        number=command.number,
        result=result,
        achieved=achieved,
    )
    if _may_try(state, recovery, command.number, command.now_us):
        return (failed, _retried(state, action, recovery))
    return (failed,)


def _on_own_failure(state: State, event: ExecutionFailed, now_us: int) -> tuple[Scheduled, ...]:
    if _may_try(state, state.recovery[event.subject.action_id], 0, now_us):
        return (Scheduled(RetryAlone(event.subject.action_id)),)
    return cfc_recovery.REACTS[ExecutionFailed](state, event, now_us)


def _on_own_attempt(state: State, event: RecoveryAttempted, now_us: int) -> tuple[Scheduled, ...]:
    if event.principals.decided_by == COORDINATOR:  # it orders one where the robot may not try at all
        return cfc_recovery.REACTS[RecoveryAttempted](state, event, now_us)
    key = f"{event.failed_action}/{event.failure}/{event.number}"
    end = EndAttempt(event.failed_action, event.number)
    return (
        Scheduled(
            end, state.fleet.structure.retry_preparation_us, (Draw("retry", key),), Draw("reliability", "retry/" + key)
        ),
    )


def _on_own_attempt_failed(state: State, event: RecoveryAttemptFailed, now_us: int) -> tuple[Scheduled, ...]:
    """The coordinator hears of the last one alone."""
    failure = open_failure(state, event.subject.action_id)
    if failure is not None and _may_try(state, failure[1], event.number, now_us):
        return ()
    return cfc_recovery.REACTS[RecoveryAttemptFailed](state, event, now_us)


def _recovering_alone(whole: Wiring) -> Wiring:
    """No word of a failure reaches the coordinator before the robot's own attempts are over."""
    instead: dict[React, React] = {
        cfc_recovery.REACTS[ExecutionFailed]: _on_own_failure,
        cfc_recovery.REACTS[RecoveryAttempted]: _on_own_attempt,
        cfc_recovery.REACTS[RecoveryAttemptFailed]: _on_own_attempt_failed,
    }
    reacts = {event: tuple(instead.get(react, react) for react in several) for event, several in whole.reacts.items()}
    return Wiring(
        {**whole.decides, RetryAlone: _retry_alone, EndAttempt: _end_own_attempt},
        reacts,
        {**whole.actors, RetryAlone: body},
    )


def _requester_named(state: State, event: Event) -> Event:
    """What names no requester, or the coordinator as such, names the robot whose task it is."""
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
    return event if robot is None else _decided_by(event, robot)


# --- DHMA ---


def _passed_at_once(state: State, command: dhma_authority.PassExecution) -> tuple[Event, ...]:
    """The sender lets go in the same instant in which the receiver claims."""
    events = dhma_authority.pass_execution(state, command)
    acknowledged = dhma_authority.acknowledge_execution(
        state, dhma_authority.AcknowledgeExecution(command.action_id, command.round, command.sender)
    )
    return (*acknowledged, *events)


def _snapshots_of_now(state: State) -> Any:
    """What is known, with snapshots that show every robot's policy as it is."""
    return msgspec.structs.replace(
        state.knowledge, snapshot={robot: in_force(state.world.local, robot) for robot in state.fleet.robots}
    )


def _talking_in_no_time(whole: Wiring) -> Wiring:
    """The agents of a robot hear each other at once; what they say is on record as before."""
    quick = partial(_seeing, "fleet", _in_no_time("hop_ppm"))
    return Wiring(
        whole.decides, {event: tuple(map(quick, several)) for event, several in whole.reacts.items()}, whole.actors
    )


def _decided_as_one(_state: State, event: Event) -> Event:
    decided_by: Agent | None = flat(event).get("decided_by")
    if decided_by is None or not decided_by.startswith("agent/"):
        return event
    return _decided_by(event, robot_of(decided_by))


_now = partial(_seeing, "knowledge", _copy_of_now)
_served_at_once = partial(_seeing, "fleet", _in_no_time("service_us"))
_policy_now = partial(_seeing, "knowledge", _snapshots_of_now)

SWITCHES: tuple[Switch, ...] = (
    Switch(
        "trust-evaluation",
        "fsar",
    ),
    Switch(
        "policy-composition",
        "fsar",
    ),
    Switch(
        "layered-recovery",
        "fsar",
    ),
    Switch(
        "shared-registry",
        "fsar",
    ),
    Switch("engine-closing", "fsar", {CloseRequest: _closed_by_requester}),
    Switch("boundary-revocation", "fsar", {fsar_authority.Revoke: _nothing}),
    Switch(
        "start-recheck",
        "fsar",
        rewire=_starting_unchecked(is_delegated=True),
    ),
    Switch(
        "own-work-check",
        "fsar",
        {DecideRoutine: _moved_unchecked},
        _starting_unchecked(is_delegated=False),
    ),
    Switch("safe-stop-claims", "cfc", {cfc_execution.SafeStop: _nothing}),
    Switch(
        "synced-copies",
        "cfc",
        {
            cfc_coordinator.ProcessWork: _now(cfc_request.process),
            cfc_request.CommandReviewed: _now(cfc_request.command_reviewed),
            DecideRoutine: _now(cfc_execution.decide_routine),
        },
    ),
    Switch(
        "coordinator-queue",
        "cfc",
        {
            cfc_coordinator.ReachCoordinator: _served_at_once(cfc_coordinator.reach_coordinator),
            cfc_recovery.GoOnWithoutHelp: _served_at_once(cfc_recovery.go_on_without_help),
        },
    ),
    Switch(
        "central-recovery",
        "cfc",
        rewire=_recovering_alone,
    ),
    Switch("unnamed-requests", "cfc", rewire=_everywhere(partial(_retold, _requester_named))),
    Switch("central-decisions", "cfc", rewire=_everywhere(partial(_retold, _decided_by_robots))),
    Switch("acknowledged-handoffs", "dhma", {dhma_authority.PassExecution: _passed_at_once}),
    Switch(
        "planner-claims",
        "dhma",
        rewire=_leaving_out(AuthorityClaimed, dhma_agents.EngagePlanner),
    ),
    Switch(
        "recovery-disputes",
        "dhma",
        {dhma_recovery.Dispute: _nothing},
    ),
    Switch(
        "contract-questioning",
        "dhma",
        rewire=_leaving_out(ContractQuestioned, dhma_agents.EngagePlanner),
    ),
    Switch(
        "policy-snapshots",
        "dhma",
        {
            dhma_request.EvaluateBid: _policy_now(dhma_request.evaluate_bid),
            dhma_execution.PlanOwnStep: _policy_now(dhma_execution.plan_own_step),
            DecideRoutine: _policy_now(dhma_execution.decide_routine),
        },
    ),
    Switch("hop-latency", "dhma", rewire=_talking_in_no_time),
    Switch("handoff-records", "dhma", {dhma_talk.HandOver: _nothing}),
    Switch("agent-decisions", "dhma", rewire=_everywhere(partial(_retold, _decided_as_one))),
    Switch("nested-queries", "dhma", {dhma_authority.RunOutsider: _nothing}),
)
assert {(one.architecture, one.name) for one in SWITCHES} == {
    (architecture, name) for architecture, names in MECHANISMS_OF.items() for name in names
}
