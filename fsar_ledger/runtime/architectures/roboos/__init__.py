"""RoboOS: one master plans whole tasks and sends subtasks to robots, which recover by a local checklist.

Source: github.com/FlagOpen/RoboOS at 35d6fe7 (its files were read in the fork xiaow190/RoboOS, 32f6c1a), and its store,
`communication.py` of flag_scale. Paper: tab:baseline_context.

There is no policy, trust or supervisor check anywhere in the source, so a declared rule reaches nothing here and
violations are structural; the dial `gate` adds a check of the robot's own policy. A record names the robot and the
task, never a requester or a supervisor (slaver/run.py, _send_result).

This module holds recovery: a robot recovers by the error's checklist, and its agent retries while it has steps left.
Source: slaver/robot/error_handler.py, error_definitions.py, core.py; slaver/agents/slaver_agent.py.

- The handler calls the methods of the error's list in order, logs each, and stops at the first that does not raise. In
  the source the methods are stubs: what they do is taken from their descriptions, and in our world a method raises if
  it does not resolve the failure. A move from the robot itself to another, a human or the brain is an escalation.
- An obstruction is E101: another path, another idle robot, manual assistance, the brain.
- No error of the source is a worn actuator. Our choice is E302 (an object drops): the tool is called again, no more;
  the dial `worn_error` has E303 instead. The source has manual assistance in E101 alone; see the dial `manual_help`.
- Another path and the same tool are attempts of the robot itself, "near position" several ("retry multiple times": as
  many as the local level of our other architectures has).
- Another robot is one that the store shows idle. The list says that it completes the task instead, core.py that it
  assists. Ours assists: the master waits for the result of the robot that it has sent the subtask to. A robot under its
  lock declines; nothing is written to the store while one helps.
- Manual assistance is a broadcast to anyone nearby; in our world H_F answers it, and no record names the human.
- The brain "only saves the error": nothing follows from it.
- The handler runs within the call of a tool. When its list has not helped, the agent calls the tool again, up to
  `max_steps` calls ("While the objective is not reached, the agent will perform a cycle of action and observation").
  Then its answer is a failed result.
"""

from typing import Literal

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import FLEET_SUPERVISOR, FailureCause, Principals, Robot, with_columns
from fsar_ledger.events.execution import (
    ExecutionFailed,
    ExecutionFinished,
    ExecutionPaused,
    RoutinePerformed,
    RoutineWithheld,
)
from fsar_ledger.events.recovery import (
    AssistanceAdmitted,
    AssistanceDeclined,
    AssistanceFailed,
    AssistanceRequested,
    FailureResolved,
    RecoveryAttempted,
)
from fsar_ledger.events.supervision import SupervisorCalled, SupervisorResponded
from fsar_ledger.events.world import ContextChanged
from fsar_ledger.projections.execution import Action
from fsar_ledger.projections.fleet import Fleet
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.recovery import Recovery
from fsar_ledger.projections.world import is_linked
from fsar_ledger.runtime.architectures import COMMON, HandlerTable
from fsar_ledger.runtime.handlers import assistance, supervision
from fsar_ledger.runtime.handlers.attribution import helpers, parties
from fsar_ledger.runtime.handlers.commands import (
    ActionCommand,
    Command,
    Decide,
    DecideRoutine,
    EndAssistance,
    EndAttempt,
    Failure,
    Handlers,
    HelpCommand,
    Respond,
    Scheduled,
    StartAction,
    TakeTurn,
    body,
    commanded_robot,
    helping,
    message,
    open_failure,
)
from fsar_ledger.runtime.handlers.execution import approach, pause_running, resume_when_replanned, start
from fsar_ledger.runtime.handlers.recovery import attempt_failed, attempt_succeeds, attempted, end_of_attempt, escalated
from fsar_ledger.runtime.handlers.supervision import RespondToCall

from . import master
from .master import is_shown_idle, may, on_record

HANDLERS = Handlers()


@HANDLERS.decide(DecideRoutine, commanded_robot)
def decide_routine(state: State, command: DecideRoutine) -> tuple[Event, ...]:
    """Perform the routine operation; with the gate, withhold a motion that the robot's own policy denies."""
    principals = on_record(command.robot).decided(command.robot)
    if command.operation == "motion" and not may(state, command.robot, None, None):
        return (RoutineWithheld(principals, command.robot, command.operation),)
    return (RoutinePerformed(principals, command.robot, command.operation),)


HANDLERS.decide(TakeTurn, body)(approach)
HANDLERS.decide(StartAction, body)(start)
HANDLERS.react(ContextChanged)(pause_running)
# The robot's own agent replans: it turns from observation to action by itself (slaver_agent.py, run).
HANDLERS.react(ExecutionPaused)(resume_when_replanned)


Method = Literal["another path", "same tool", "near position", "another robot", "manual help", "brain"]

E101: tuple[Method, ...] = ("another path", "another robot", "manual help", "brain")
E302: tuple[Method, ...] = ("same tool",)
E303: tuple[Method, ...] = ("near position", "another robot", "brain")


class StartChecklist(ActionCommand):
    """Call the first method of the checklist."""


class AskAnother(ActionCommand):
    """Move on from a robot that did not help to the next method, after `asked` robots were asked."""

    failure: int
    asked: int


class ReachHelper(HelpCommand):
    """Deliver the call for help to the other robot."""


class GoOnWithoutHelp(HelpCommand):
    """Stop waiting for the other robot's answer."""

    failure: int


def checklist(fleet: Fleet, cause: FailureCause | None) -> tuple[Method, ...]:
    """Return the methods against this failure, in order."""
    dials = fleet.roboos
    worn = E303 if dials.worn_error == 303 else E302
    methods = E101 if cause == "obstruction" else worn
    if dials.manual_help == 0:
        return tuple(method for method in methods if method != "manual help")
    if dials.manual_help == 2 and "manual help" not in methods:
        head = tuple(method for method in methods if method != "brain")
        return (*head, "manual help", *methods[len(head) :])
    return methods


@HANDLERS.decide_on(open_failure, StartChecklist, body)
def start_checklist(state: State, command: StartChecklist, failure: Failure) -> tuple[Event, ...]:
    """Begin with the robot's own attempt, as every list does."""
    action, recovery = failure
    return (_attempted(state, action, recovery, command.now_us),)


@HANDLERS.decide_on(open_failure, EndAttempt, body)
def end_attempt(state: State, command: EndAttempt, failure: Failure) -> tuple[Event, ...]:
    """Resolve the failure, or call the next method of the list."""
    action, recovery = failure
    if recovery.number != command.number:
        return ()
    if attempt_succeeds(state.world, recovery, command):
        return (FailureResolved(action.subject, action.robot, recovery.failure, "local"),)
    failed = attempt_failed(state.registry, state.world, action, recovery)
    if (1 + recovery.number) % _attempts_of_call(state.fleet, recovery):
        return (failed, _attempted(state, action, recovery, command.now_us))
    return (failed, *_next_method(state, action, recovery, command.now_us))


@HANDLERS.decide_on(open_failure, AskAnother, body)
def ask_another(state: State, command: AskAnother, failure: Failure) -> tuple[Event, ...]:
    """Call the next method after a robot that declined or could not help."""
    action, recovery = failure
    if (recovery.failure, len(recovery.tried)) != (command.failure, command.asked) or recovery.level == "human":
        return ()
    return _next_method(state, action, recovery, command.now_us)


@HANDLERS.decide_on(open_failure, GoOnWithoutHelp, body)
def go_on_without_help(state: State, command: GoOnWithoutHelp, failure: Failure) -> tuple[Event, ...]:
    """Call the next method after a robot that did not answer in time. Reading: R44."""
    action, recovery = failure
    if (recovery.failure, recovery.awaited) != (command.failure, command.helper):
        return ()
    return _next_method(state, action, recovery, command.now_us)


def _attempts_of_call(fleet: Fleet, recovery: Recovery) -> int:
    """Return how often the robot itself tries within one call of the tool: the call, then the head of the list."""
    is_near = "near position" in checklist(fleet, recovery.cause)
    return 1 + (max(1, fleet.structure.local_attempts) if is_near else 1)


def _attempted(state: State, action: Action, recovery: Recovery, now_us: int) -> RecoveryAttempted:
    """Return the attempt.

    The source has no limit of time: the deadline is that of the structure, and nothing here reads it.
    """
    deadline_us = now_us + state.fleet.structure.local_budget_us
    return attempted(action, recovery, _by_robot(action.robot), deadline_us)


def _by_robot(robot: Robot) -> Principals:
    return on_record(robot).decided(robot)


def _next_method(state: State, action: Action, recovery: Recovery, now_us: int) -> tuple[Event, ...]:
    """Call another robot, then a human, then the brain, as far as the list has them; then the tool again, or fail."""
    methods, by_robot = checklist(state.fleet, recovery.cause), _by_robot(action.robot)
    if "another robot" in methods:
        helper = _idle_robot(state, action, recovery, now_us)
        if helper is not None:
            escalation = (escalated(action, recovery, by_robot, "peer"),) if recovery.level != "peer" else ()
            return (
                *escalation,
                AssistanceRequested(
                    subject=action.subject,
                    principals=by_robot,
                    robot=action.robot,
                    helper=helper,
                    failure=recovery.failure,
                    level="peer",
                    failed_action=action.action_id,
                ),
            )
    if "manual help" in methods:
        call = SupervisorCalled(subject=action.subject, supervisor=FLEET_SUPERVISOR, purpose="recovery")
        return (escalated(action, recovery, by_robot, "human"), call)
    saved = (escalated(action, recovery, by_robot, "fleet", "saved"),) if "brain" in methods else ()
    calls = (1 + recovery.number) // _attempts_of_call(state.fleet, recovery)
    if calls < state.fleet.roboos.max_steps:
        return (*saved, _attempted(state, action, recovery, now_us))
    return (*saved, _failed_result(state, action))


def _idle_robot(state: State, action: Action, recovery: Recovery, now_us: int) -> Robot | None:
    """Return the nearest robot that could help, that the store shows idle, and that was not asked; None if offline."""
    if not is_linked(state.world, action.robot):
        return None
    able = helpers(state.fleet, state.registry, action, recovery.cause)
    untried = (robot for robot in able if robot not in recovery.tried)
    return next((robot for robot in untried if is_shown_idle(state, robot, now_us)), None)


def _failed_result(state: State, action: Action) -> ExecutionFinished:
    """Return the end of a subtask that was not done: the agent has reached its last step."""
    return ExecutionFinished(action.subject, parties(state, action), action.robot, "failure")


@HANDLERS.decide_on(open_failure, ReachHelper, helping)
def reach_helper(state: State, command: ReachHelper, failure: Failure) -> tuple[Event, ...]:
    """Help, or decline under the lock. Nothing is evaluated, so no decision is recorded."""
    return assistance.ordered(state, command, failure, "peer")


@HANDLERS.decide(EndAssistance, helping)
def end_assistance(state: State, command: EndAssistance) -> tuple[Event, ...]:
    """Free the helper, whether or not it resolved the failure."""
    return assistance.end_assistance(state, command, "peer")


def respond(state: State, command: Respond) -> tuple[Event, ...]:
    """Let the human who heard the broadcast help."""
    return _unnamed(supervision.respond(state, command))


def respond_to_call(state: State, command: RespondToCall) -> tuple[Event, ...]:
    """Let the supervisor who was called answer the open call."""
    return _unnamed(supervision.respond_to_call(state, command))


def _unnamed(events: tuple[Event, ...]) -> tuple[Event, ...]:
    """Return the events without the human who answered, whom RoboOS does not record."""
    return tuple(
        with_columns(event, decided_by=None, supervised_by=None, path=())
        if isinstance(event, SupervisorResponded)
        else event
        for event in events
    )


@HANDLERS.react(ExecutionFailed)
def _on_failure(_state: State, event: ExecutionFailed, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(StartChecklist(event.subject.action_id)),)


@HANDLERS.react(RecoveryAttempted)
def _on_attempt(state: State, event: RecoveryAttempted, _now_us: int) -> tuple[Scheduled, ...]:
    return (end_of_attempt(state.fleet, event),)


@HANDLERS.react(AssistanceRequested)
def _on_request(state: State, event: AssistanceRequested, _now_us: int) -> tuple[Scheduled, ...]:
    asked = len(state.recovery[event.failed_action].tried)
    hop = "peer" if asked == 1 else f"peer/{asked - 1}"
    call = message(event.robot, f"{event.failed_action}/{event.failure}", hop)
    timeout = GoOnWithoutHelp(event.failed_action, event.helper, event.failure)
    return (
        Scheduled(ReachHelper(event.failed_action, event.helper), 0, (call,)),
        Scheduled(timeout, state.fleet.answer_us),
    )


HANDLERS.react(AssistanceAdmitted)(assistance.end_once_answered)


@HANDLERS.react(AssistanceDeclined, AssistanceFailed)
def _on_no_help(state: State, event: AssistanceDeclined | AssistanceFailed, _now_us: int) -> tuple[Scheduled, ...]:
    recovery = state.recovery.get(event.subject.action_id)
    if recovery is None:
        return ()
    key = f"{event.subject.action_id}/{event.failure}"
    word = "no help" if isinstance(event, AssistanceFailed) else "decline"
    reply = message(event.helper, key, f"{word}/{event.helper}")
    another = AskAnother(event.subject.action_id, event.failure, len(recovery.tried))
    return (Scheduled(another, 0, (reply,)),)


OWN: dict[type[Command], Decide] = {Respond: respond, RespondToCall: respond_to_call}

ROBOOS: HandlerTable = HandlerTable.of(
    *COMMON,
    assistance,
    master,
    HANDLERS,
    own=OWN,
    instead=master.INSTEAD,
)
