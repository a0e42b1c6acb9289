"""RoboOS: the master plans a whole task, sends subtasks to robots one by one, and takes the results; its store.

Source: master/agents/agent.py, publish_global_task and _handle_result.

- The store is read once, before the planning, which names the robot of every subtask. Robots shown idle are preferred
  (planner.py, _get_prompt_from_memory). In the source a language model chooses among them; ours takes the nearest, as
  the other architectures do.
- Tasks are planned side by side: each has its own request thread (master/run.py), so the master has no queue.
- Steps of one task depend on each other, so each is a group of its own: the next is sent when the result of the one
  before is back. The source does not wait for the last group; here the task is done when its last result is.
- One message takes a subtask to the robot and one brings its result. The master waits for it longer than any run lasts
  (communication.py: 6000 s).
- Any result sets the robot idle, even a failed one, and even while the robot serves another subtask.
- No result is used for the next step ("TODO: Task result should be refered to the next step determination"), so the
  source sends the next group after a failure as well. Our choice: the task is given up then. Our steps need the earlier
  ones, robots of our world would execute them all the same, and nothing in the source repeats a failed subtask.
- A language model may fail to plan; ours does not. The one task without a plan is one with a step for which the store
  has no capable robot: it is planned `planning_retries` times more on the same reading of the store, and then ignored.
- Only the master has a channel to a robot, so an outsider's request to one has no effect.

The shared store has one entry for each robot. The master writes `busy` when it sends a subtask and `idle` when a result
comes; there is no periodic copy. A robot registers as idle when it connects, and its heartbeat renews the expiry of the
entry (slaver/run.py, connect_to_robot and _heartbeat_loop). Redis adds two facts: the master's SET removes the expiry
until the next heartbeat, and an entry that has expired comes back neither by a heartbeat nor by the master
(communication.py, update_json_field_py), but only when the robot connects again.

`idle` is the availability `ready` here. Reading and writing the store takes no time: the source has it beside the
master. While the fleet has no task, heartbeats go on and are not recorded: the last one on record does not expire.

A robot serves one subtask at a time, in order of arrival, and sends one result back. Source: slaver/run.py, handle_task
and _execute_task: one agent and one lock a robot. Nothing is checked. Our choices: with the dial `gate`, a subtask is
refused on arrival, and a refusal is a result like any other; a subtask of a task that was given up comes back as a
result, too. The source has no way to cancel one; here a queued one is withdrawn with its task, as under every
architecture (reading R3), which is kinder where tasks run late.
"""

from fsar_ledger.events import Event
from fsar_ledger.events.authority import AuthorityClaimed
from fsar_ledger.events.envelope import (
    COORDINATOR,
    Availability,
    Parties,
    Principals,
    RequestSubject,
    Robot,
    Subject,
    robot_named,
)
from fsar_ledger.events.execution import ExecutionFinished, ExecutionWithdrawn
from fsar_ledger.events.knowledge import StoreEntryWritten
from fsar_ledger.events.request import CommandIssued, RequestDenied
from fsar_ledger.events.task import StepBegan, StepCompleted, TaskAbandoned, TaskPlanned
from fsar_ledger.events.world import OutsiderRequestInjected, RobotCameBack, SnapshotPhaseSet, TaskArrived
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.request import Request
from fsar_ledger.projections.task import Task
from fsar_ledger.runtime.handlers.attribution import capable
from fsar_ledger.runtime.handlers.authority import release
from fsar_ledger.runtime.handlers.commands import (
    ActionCommand,
    BeginStep,
    Command,
    Handlers,
    React,
    RobotCommand,
    Scheduled,
    at_once,
    commanded_robot,
    message,
    nobody,
    open_request,
)
from fsar_ledger.runtime.handlers.execution import queued
from fsar_ledger.runtime.handlers.policy import own_policy
from fsar_ledger.runtime.handlers.task import begin_step, on_arrival, on_completed

NO_CHANNEL = "no channel"

HANDLERS = Handlers()


class Heartbeat(RobotCommand):
    """Renew the expiry of the robot's entry; its last writing there holds until `until_us` (run time, 0: for ever)."""

    until_us: int


class Connect(RobotCommand):
    """Register the robot, which has just been switched on."""


def entry(state: State, robot: Robot) -> StoreEntryWritten:
    """Return the robot's entry as last written; every robot connects at the beginning of the run."""
    last = state.knowledge.store.get(robot)
    return _registered(state, robot, 0) if last is None else last


def is_stored(state: State, robot: Robot, now_us: int) -> bool:
    """Return whether the store has an entry of the robot that has not expired."""
    until_us = entry(state, robot).until_us
    return until_us is None or until_us > now_us


def is_shown_idle(state: State, robot: Robot, now_us: int) -> bool:
    """Return whether the store shows the robot as idle."""
    return is_stored(state, robot, now_us) and entry(state, robot).availability == "ready"


def entry_written(state: State, robot: Robot, availability: Availability, now_us: int) -> tuple[StoreEntryWritten, ...]:
    """Return what the master writes into the robot's entry: nothing if it has expired."""
    if not is_stored(state, robot, now_us):
        return ()
    return (StoreEntryWritten(robot=robot, availability=availability, until_us=None, written_by=COORDINATOR),)


def _registered(state: State, robot: Robot, now_us: int) -> StoreEntryWritten:
    until_us = now_us + state.fleet.roboos.expiry_us
    return StoreEntryWritten(robot=robot, availability="ready", until_us=until_us, written_by=robot)


@HANDLERS.decide(Heartbeat, commanded_robot)
def beat(state: State, command: Heartbeat) -> tuple[StoreEntryWritten, ...]:
    """Renew the expiry, unless the robot has connected again since or the entry has expired."""
    robot, expiry_us = command.robot, state.fleet.roboos.expiry_us
    is_last = state.knowledge.beats.get(robot, expiry_us) == command.until_us
    if not (is_last and is_stored(state, robot, command.now_us)):
        return ()
    is_at_rest = command.now_us > state.fleet.structure.watch_us and not state.task
    availability, until_us = entry(state, robot).availability, None if is_at_rest else command.now_us + expiry_us
    return (StoreEntryWritten(robot=robot, availability=availability, until_us=until_us, written_by=robot),)


@HANDLERS.decide(Connect, commanded_robot)
def connect(state: State, command: Connect) -> tuple[StoreEntryWritten, ...]:
    """Register the robot as idle, whatever it has in hand (slaver/run.py, connect_to_robot)."""
    return (_registered(state, command.robot, command.now_us),)


@HANDLERS.react(SnapshotPhaseSet)
def _first_beat(state: State, event: SnapshotPhaseSet, _now_us: int) -> tuple[Scheduled, ...]:
    dials = state.fleet.roboos
    delay_us = max(1, event.phase_ppm * dials.refresh_us // 1_000_000)
    return (Scheduled(Heartbeat(event.robot, dials.expiry_us), delay_us, (at_once(event.robot),)),)


@HANDLERS.react(StoreEntryWritten)
def _next_beat(state: State, event: StoreEntryWritten, _now_us: int) -> tuple[Scheduled, ...]:
    if event.written_by != event.robot or event.until_us is None:
        return ()
    beat = Heartbeat(event.robot, event.until_us)
    return (Scheduled(beat, state.fleet.roboos.refresh_us, (at_once(event.robot),)),)


@HANDLERS.react(TaskArrived)
def _on_work(state: State, _event: TaskArrived, _now_us: int) -> tuple[Scheduled, ...]:
    """Record heartbeats again, which were not recorded while there was no task."""
    at_rest = [robot for robot, until_us in state.knowledge.beats.items() if until_us == 0]
    return tuple(Scheduled(Heartbeat(robot, 0), 1, (at_once(robot),)) for robot in at_rest)


@HANDLERS.react(RobotCameBack)
def _on_back(_state: State, event: RobotCameBack, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(Connect(event.robot), 1, (at_once(event.robot),)),)


class PlanTask(Command):
    """Read the store and plan the task."""

    task_id: str


class IgnoreTask(Command):
    """Ignore a task for which no plan was found."""

    task_id: str


class BeginSubtask(BeginStep):
    """Begin the next step of the task, as the master."""


class SendSubtask(ActionCommand):
    """Send the step to the robot that the plan names."""


class TakeSubtask(ActionCommand):
    """Take the subtask that the master has sent."""

    task_id: str
    robot: Robot


class TakeResult(ActionCommand):
    """Take the result that the robot has sent back."""

    task_id: str
    robot: Robot


class RefuseOutsider(ActionCommand):
    """Refuse a request that does not come from the master."""


def on_record(robot: Robot) -> Parties:
    """Return the parties that RoboOS records: the robot alone (slaver/run.py, _send_result)."""
    return Parties(requested_by=None, executed_by=robot, supervised_by=None)


@HANDLERS.decide(PlanTask, nobody)
def plan_task(state: State, command: PlanTask) -> tuple[TaskPlanned, ...]:
    """Name a robot for every step from the store as it is now, before the planning."""
    task, dials = state.task.get(command.task_id), state.fleet.roboos
    if task is None:
        return ()
    chosen = [_named_for(state, task, step, command.now_us) for step in task.steps]
    robots = tuple(robot for robot in chosen if robot is not None)
    if len(robots) == len(chosen):
        ready_us = command.now_us + dials.planning_us
        return (TaskPlanned(task_id=task.task_id, robots=robots, ready_us=ready_us),)
    ready_us = command.now_us + (1 + dials.planning_retries) * dials.planning_us
    return (TaskPlanned(task_id=task.task_id, robots=(), ready_us=ready_us),)


def _named_for(state: State, task: Task, step: str, now_us: int) -> Robot | None:
    """Return the first robot in the store that can do the step, one shown idle if possible; None if there is none.

    A busy robot can be named: all that is checked of a plan is that its robots are registered (agent.py,
    reasoning_and_subtasks_is_right), and a subtask waits at the robot.
    """
    actor, capability, *target = step.split(" ")
    acting = robot_named(actor, task.team)
    able = capable(state.fleet, state.registry, capability, acting) if target else (acting,)
    stored = [robot for robot in able if is_stored(state, robot, now_us)]
    idle = (robot for robot in stored if is_shown_idle(state, robot, now_us))
    return next(idle, stored[0] if stored else None)


@HANDLERS.decide(IgnoreTask, nobody)
def ignore_task(state: State, command: IgnoreTask) -> tuple[TaskAbandoned, ...]:
    """Give up the task, of which nothing was done."""
    return (TaskAbandoned(command.task_id),) if command.task_id in state.task else ()


@HANDLERS.decide(BeginSubtask, nobody)
def begin_subtask(state: State, command: BeginSubtask) -> tuple[Event, ...]:
    """Begin the next step at the master, whether or not the robot whose task it is can hear it."""
    return begin_step(state, command)


@HANDLERS.decide_on(open_request, SendSubtask, nobody)
def send_subtask(state: State, command: SendSubtask, request: Request) -> tuple[Event, ...]:
    """Send the subtask, write `busy`, and claim the action until the result is back.

    An own step is a subtask like any other. The robot gets it whether or not it is busy by now.
    """
    task = state.task.get(request.task_id)
    if task is None or len(task.plan) < request.step:
        return ()
    robot = task.plan[request.step - 1]
    return (
        CommandIssued(
            subject=RequestSubject(request.task_id, request.action_id, None),
            principals=on_record(robot).decided(COORDINATOR),
            robot=robot,
            seen_busy=entry(state, robot).availability == "busy",
        ),
        *entry_written(state, robot, "busy", command.now_us),
        AuthorityClaimed(subject=request.subject, dimension="execution", claimant=COORDINATOR, reason="dispatch"),
        AuthorityClaimed(subject=request.subject, dimension="override", claimant=COORDINATOR, reason="dispatch"),
    )


@HANDLERS.decide(TakeResult, nobody)
def take_result(state: State, command: TakeResult) -> tuple[Event, ...]:
    """Write `idle`, whatever the result; continue after a success, and give up the task after anything else."""
    events = (
        *entry_written(state, command.robot, "ready", command.now_us),
        *release(state.authority, command.action_id),
    )
    request = open_request(state, command.action_id)
    if request is None or request.task_id not in state.task:
        return events
    if request.is_over or request.result is not None:
        return (*events, TaskAbandoned(request.task_id))
    return (*events, StepCompleted(request.subject))


@HANDLERS.decide_on(open_request, RefuseOutsider, nobody)
def refuse_outsider(_state: State, _command: RefuseOutsider, request: Request) -> tuple[RequestDenied, ...]:
    """Record that the request has no recipient: no principal of RoboOS decides it."""
    unknown = Principals(decided_by=None, requested_by=None, executed_by=None, supervised_by=None, path=())
    return (RequestDenied(RequestSubject(request.task_id, None, None), unknown, NO_CHANNEL),)


@HANDLERS.react(TaskPlanned)
def _on_plan(_state: State, event: TaskPlanned, now_us: int) -> tuple[Scheduled, ...]:
    next_command = BeginSubtask(event.task_id) if event.robots else IgnoreTask(event.task_id)
    return (Scheduled(next_command, max(1, event.ready_us - now_us)),)


@HANDLERS.react(StepBegan)
def _on_step(_state: State, event: StepBegan, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(SendSubtask(event.subject.action_id)),)


@HANDLERS.react(OutsiderRequestInjected)
def _on_outsider(_state: State, event: OutsiderRequestInjected, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(RefuseOutsider(event.task_id)),)


def _on_arrival(state: State, event: TaskArrived, now_us: int) -> tuple[Scheduled, ...]:
    """Schedule the planning: tasks are published to the master, not to a robot (master/run.py, publish_task)."""
    _begins, expires = on_arrival(state, event, now_us)
    return (Scheduled(PlanTask(event.task_id)), expires)


def _on_completed(_state: State, event: StepCompleted, _now_us: int) -> tuple[Scheduled, ...]:
    """Schedule the next step; the plan names its robot, so no segment is handed over."""
    return (Scheduled(BeginSubtask(event.subject.task_id)),)


@HANDLERS.decide(TakeSubtask, commanded_robot)
def take_subtask(state: State, command: TakeSubtask) -> tuple[Event, ...]:
    """Queue the subtask behind the lock; with the gate, refuse what the robot's own policy denies."""
    request, robot = open_request(state, command.action_id), command.robot
    if request is None:  # its task was given up meanwhile
        return (ExecutionWithdrawn(Subject(command.task_id, command.action_id), robot),)
    if not may(state, robot, request.capability, request.task_id):
        subject = RequestSubject(request.task_id, request.action_id, None)
        return (RequestDenied(subject, on_record(robot).decided(robot), "policy"),)
    return (queued(request, on_record(robot), robot, is_supervised=False),)


def may(state: State, robot: Robot, capability: str | None, context: str | None) -> bool:
    """Return whether the robot may do it: always, unless it has a gate and its own policy denies."""
    if not state.fleet.roboos.gate:
        return True
    return own_policy(state.policy, state.world, robot, capability, context) != "deny"


@HANDLERS.react(CommandIssued)
def _on_command(_state: State, event: CommandIssued, _now_us: int) -> tuple[Scheduled, ...]:
    task_id, action_id = event.subject.task_id, event.subject.action_id
    take = TakeSubtask(action_id, task_id, event.robot)
    return (Scheduled(take, 0, (message(COORDINATOR, action_id, 1),)),)


@HANDLERS.react(ExecutionFinished, ExecutionWithdrawn)
def _on_end(_state: State, event: ExecutionFinished | ExecutionWithdrawn, _now_us: int) -> tuple[Scheduled, ...]:
    return _reported(event.subject.action_id, event.subject.task_id, event.robot)


@HANDLERS.react(RequestDenied)
def _on_refusal(_state: State, event: RequestDenied, _now_us: int) -> tuple[Scheduled, ...]:
    task_id, action_id, robot = event.subject.task_id, event.subject.action_id, event.principals.executed_by
    if task_id is None or action_id is None or robot is None:  # an outsider's
        return ()
    return _reported(action_id, task_id, robot)


def _reported(action_id: str, task_id: str, robot: Robot) -> tuple[Scheduled, ...]:
    """Send the master the one message that a subtask brings back."""
    return (Scheduled(TakeResult(action_id, task_id, robot), 0, (message(robot, action_id, 4),)),)


INSTEAD: dict[React, React] = {on_arrival: _on_arrival, on_completed: _on_completed}
