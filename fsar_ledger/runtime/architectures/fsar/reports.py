"""What robots report of themselves: the answers of a live fleet to the questions asked at the ports.

Each is a command from outside by the robot itself. Only the robot reports that it judges, starts or ends; until then
whatever waits for the report waits, within the budgets of recovery and of answers.
"""

from typing import get_args

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import PolicyOutcome, PolicyScope, Robot, Supervisor
from fsar_ledger.events.recovery import AssistanceDeclined, AssistanceRequested
from fsar_ledger.events.request import RequestDenied
from fsar_ledger.events.supervision import ActuatorServiced
from fsar_ledger.events.world import (
    ActuatorDegraded,
    ContextChanged,
    Grade,
    PolicyWindowClosed,
    PolicyWindowOpened,
    RobotCameBack,
    RobotWentOff,
    SupervisorLeft,
    SupervisorReturned,
)
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.world import GRADES
from fsar_ledger.runtime.handlers.assistance import help_failed, helped
from fsar_ledger.runtime.handlers.attribution import recorded_by
from fsar_ledger.runtime.handlers.commands import (
    EndAssistance,
    EndAttempt,
    Handlers,
    Scheduled,
    StartAction,
    open_failure,
)
from fsar_ledger.runtime.handlers.public import (
    PublicCommand,
    RobotReport,
    absent_robot,
    carried_out,
    made_from,
    outdated,
    rejected,
    unknown_supervisor,
    unknown_word,
)
from fsar_ledger.runtime.ports import UNKNOWN_US, Ask

from .availability import heard
from .execution import start
from .helpers import agreed_to_help
from .recovery import AskPeers, end_assistance, end_attempt
from .request import EvaluateRequest, evaluate_request

HANDLERS = Handlers()
DECLINED = "declined"
"""The reason of a denial by a robot's own judgement, beyond what policy, trust and authority say."""


class JudgeRequest(RobotReport):
    """Judge a request to the robot: it may refuse what all rules allow, but not allow what they deny."""

    robot: Robot
    action_id: str
    accepts: bool


class JudgeAssistance(RobotReport):
    """Answer whether the robot helps with the failure about which it was asked."""

    robot: Robot
    action_id: str
    accepts: bool


class ReportStart(RobotReport):
    """Begin to execute: the robot moves only if this is not refused. Units: `lasts_us` microseconds; None: unknown."""

    robot: Robot
    action_id: str
    lasts_us: int | None = None


class ReportAttempt(RobotReport):
    """Report how the robot's own attempt to recover ended."""

    robot: Robot
    action_id: str
    succeeded: bool


class ReportAssistance(RobotReport):
    """Report how the help with another robot's failure ended, and if it did not help, for what cause."""

    robot: Robot
    action_id: str
    succeeded: bool
    cause: str = "not told"


class ReportPresence(RobotReport):
    """Report that the robot goes off, or is back."""

    robot: Robot
    is_on: bool


class ReportShift(PublicCommand):
    """Report that a supervisor leaves, or has returned."""

    supervisor: Supervisor
    is_on: bool


class ReportActuator(PublicCommand):
    """Report the grade to which the robot's actuator is degraded; None: it has been serviced."""

    robot: Robot
    grade: Grade | None


class ReportContext(PublicCommand):
    """Report that the context in which the robot works has changed."""

    robot: Robot


class ReportWindow(PublicCommand):
    """Report that a window begins in which the robot's own policy, or the fleet's, has this outcome; None: it ends."""

    robot: Robot
    scope: PolicyScope
    window: str
    outcome: PolicyOutcome | None


@HANDLERS.decide(JudgeRequest)
def judge_request(state: State, command: JudgeRequest) -> tuple[Event, ...]:
    """Evaluate the request as it is now, or deny it by the robot's own judgement. Paper: eq:admissible, phase 4."""
    request = state.request.open.get(command.action_id)
    executor = request.candidates[0] if request is not None and request.candidates else None
    refused = outdated(state.fleet, command.robot, command.fence)
    if refused is None and (request is None or request.is_over or request.is_accepted):
        refused = f"unknown or settled request {command.action_id}, expected one that waits for {command.robot}"
    if refused is None and executor != command.robot:
        refused = f"the request goes to {executor or 'nobody'}, expected its judgement"
    if refused is None and command.action_id in state.execution.actions:
        refused = f"{command.action_id} is admitted already, expected one that waits for {command.robot}"
    if refused is not None or request is None:
        return rejected(command, command.action_id, refused or "", command.robot)
    if command.accepts:
        return evaluate_request(state, EvaluateRequest(command.action_id, now_us=command.now_us))
    parties = recorded_by(state, command.robot, requested_by=request.requester, executed_by=command.robot)
    return (RequestDenied(request.request_subject, parties.decided(command.robot), DECLINED),)


@HANDLERS.decide(JudgeAssistance)
def judge_assistance(state: State, command: JudgeAssistance) -> tuple[Event, ...]:
    """Admit or decline by the robot's own answer. Paper: sec:model:recovery, level 2."""
    refused = outdated(state.fleet, command.robot, command.fence)
    failure = open_failure(state, command.action_id)
    if refused is None and failure is not None and failure[0].stage == "withdrawn":
        refused = f"{failure[0].robot} has departed, expected a robot that is there to be helped"
    if refused is None and (failure is None or failure[1].awaited != command.robot):
        refused = f"{command.robot} is not asked about {command.action_id}, expected the answer of who is"
    if refused is not None or failure is None:
        return rejected(command, command.action_id, refused or "", command.robot)
    action, recovery = failure
    if command.accepts:
        return (agreed_to_help(state, action, recovery, command.robot),)
    return (AssistanceDeclined(action.subject, action.robot, command.robot, recovery.failure),)


def _not_its_own(state: State, command: ReportStart | ReportAttempt) -> str | None:
    """Return why the robot cannot report about the action, or None."""
    robot, action_id = command.robot, command.action_id
    action = state.execution.actions.get(action_id)
    refused = outdated(state.fleet, robot, command.fence)
    if refused is None and action is None:
        refused = f"unknown or finished action {action_id}, expected one of {robot}"
    if refused is None and action is not None and action.robot != robot:
        refused = f"{action.robot} executes {action_id}, expected its report"
    return refused


@HANDLERS.decide(ReportStart)
def report_start(state: State, command: ReportStart) -> tuple[Event, ...]:
    """Start the action, or hold it if policy, as the robot knows it now, requires it. Paper: sec:model:invariants."""
    refused = _not_its_own(state, command)
    if refused is None and command.lasts_us is not None and command.lasts_us < 1:
        refused = f"a length of {command.lasts_us} microseconds, expected at least 1"
    request = state.request.open.get(command.action_id)
    if refused is None and request is not None and not request.is_accepted and request.requester != command.robot:
        refused = (
            f"the acceptance of {command.action_id} has not gone out to {request.requester}, expected that first; "
            "a robot that is off sends nothing"
        )
    if refused is None:
        lasts_us = UNKNOWN_US if command.lasts_us is None else command.lasts_us
        if events := start(state, StartAction(command.action_id, now_us=command.now_us, answer=lasts_us)):
            return events
        stage = state.execution.actions[command.action_id].stage
        refused = f"{command.action_id} is {stage}, expected one whose turn it is at {command.robot}"
    return rejected(command, command.action_id, refused, command.robot)


@HANDLERS.decide(ReportAttempt)
def report_attempt(state: State, command: ReportAttempt) -> tuple[Event, ...]:
    """Resolve the failure, or continue with the next attempt or level. Paper: sec:model:recovery, level 1."""
    refused = _not_its_own(state, command)
    recovery = state.recovery.get(command.action_id)
    if refused is None and (recovery is None or recovery.level != "local" or not recovery.number):
        refused = f"no attempt of {command.robot} is under way, expected one"
    if refused is not None or recovery is None:
        return rejected(command, command.action_id, refused or "", command.robot)
    ended = EndAttempt(command.action_id, recovery.number, now_us=command.now_us, succeeded=command.succeeded)
    return end_attempt(state, ended)


@HANDLERS.decide(ReportAssistance)
def report_assistance(state: State, command: ReportAssistance) -> tuple[Event, ...]:
    """Free the helper, whether or not it resolved the failure. Paper: sec:model:recovery, level 2."""
    failure = helped(state, command.action_id, command.robot)
    refused = outdated(state.fleet, command.robot, command.fence)
    if refused is None and failure is None:
        refused = f"{command.robot} does not help with {command.action_id}, expected its helper"
    if refused is not None or failure is None:
        return rejected(command, command.action_id, refused or "", command.robot)
    action, recovery = failure
    if not command.succeeded:
        return (help_failed(action, recovery, command.robot, command.cause),)
    ended = EndAssistance(command.action_id, command.robot, recovery.failure, now_us=command.now_us, answer=1)
    return end_assistance(state, ended)


@HANDLERS.decide(ReportPresence)
def report_presence(state: State, command: ReportPresence) -> tuple[Event, ...]:
    """Record that the robot is off, or back; with heartbeats, every report that it is on counts as one."""
    robot, is_off = command.robot, command.robot in state.world.off
    refused = outdated(state.fleet, robot, command.fence)
    beat = heard(state, robot) if command.is_on and state.fleet.membership.heartbeat_us > 0 else ()
    if refused is None and is_off is not command.is_on and not beat:
        refused = f"{robot} is {'on' if command.is_on else 'off'} already"
    change: tuple[Event, ...] = ()
    if is_off is command.is_on:
        change = (RobotCameBack(robot) if command.is_on else RobotWentOff(robot),)
    return carried_out(command, robot, refused, robot, *change, *beat)


@HANDLERS.decide(ReportShift)
def report_shift(state: State, command: ReportShift) -> tuple[Event, ...]:
    """Record that the supervisor has left, or returned."""
    refused = unknown_supervisor(state.fleet, command.supervisor)
    if refused is None and (command.supervisor in state.world.off_shift) is not command.is_on:
        refused = f"{command.supervisor} is {'on' if command.is_on else 'off'} shift already"
    change = SupervisorReturned(command.supervisor) if command.is_on else SupervisorLeft(command.supervisor)
    return carried_out(command, command.supervisor, refused, command.supervisor, change)


@HANDLERS.decide(ReportActuator)
def report_actuator(state: State, command: ReportActuator) -> tuple[Event, ...]:
    """Record how far the robot's actuator is degraded, or that it has been serviced."""
    refused = absent_robot(state.fleet, command.robot)
    if refused is None and command.grade is None and command.robot not in state.world.degraded:
        refused = f"the actuator of {command.robot} is sound already"
    if refused is None and command.grade is not None:
        refused = unknown_word("grade", command.grade, GRADES)
    change = (
        ActuatorServiced(command.robot) if command.grade is None else ActuatorDegraded(command.robot, command.grade)
    )
    return carried_out(command, command.robot, refused, command.robot, change)


@HANDLERS.decide(ReportContext)
def report_context(state: State, command: ReportContext) -> tuple[Event, ...]:
    """Record that the context has changed."""
    refused = absent_robot(state.fleet, command.robot)
    return carried_out(command, command.robot, refused, command.robot, ContextChanged(command.robot))


@HANDLERS.decide(ReportWindow)
def report_window(state: State, command: ReportWindow) -> tuple[Event, ...]:
    """Record that the window opens, or closes."""
    refused = absent_robot(state.fleet, command.robot)
    if refused is None and not command.window:
        refused = "the window has no name, expected one"
    refused = refused or unknown_word("scope", command.scope, get_args(PolicyScope))
    change: Event = PolicyWindowClosed(command.robot, command.scope, command.window)
    if command.outcome is not None:
        refused = refused or unknown_word("outcome", command.outcome, ("review", "deny"))
        change = made_from(PolicyWindowOpened, command)
    return carried_out(command, command.robot, refused, command.robot, change)


@HANDLERS.react(AssistanceRequested)
def _on_question(state: State, event: AssistanceRequested, _now_us: int) -> tuple[Scheduled, ...]:
    """Schedule the end of the answer time of a live peer."""
    if not state.fleet.is_live:
        return ()
    asked, since_us = len(state.recovery[event.failed_action].tried), event.since_us or 0
    timeout = AskPeers(event.failed_action, since_us, asked, event.failure, is_last=True)
    return (Scheduled(timeout, state.fleet.answer_us, ask=Ask("decision", "help", f"{event.failed_action}/late")),)
