"""What a person sees who answers for a fleet: the calls that wait, and the robots. Paper: sec:model:supervision.

The page itself is `console.html`, with its script and style beside it.
"""

from collections.abc import Iterator
from pathlib import Path

import msgspec

from fsar_ledger.events.envelope import FLEET_SUPERVISOR, Robot, recorded_robot
from fsar_ledger.events.supervision import SupervisorCalled
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.policy import rules_in_force
from fsar_ledger.projections.supervision import density
from fsar_ledger.projections.task import given_up_us
from fsar_ledger.projections.trust import scope_of
from fsar_ledger.runtime.handlers.supervision import is_settled

FILES = {
    "/console": ("console.html", "text/html"),
    "/console.js": ("console.js", "text/javascript"),
    "/console.css": ("console.css", "text/css"),
}


class Reply(msgspec.Struct, frozen=True):
    """What a person can say to a call, as the fields of `RespondToCall`."""

    label: str
    approves: bool
    preferred: str | None = None


class OpenCall(msgspec.Struct, frozen=True):
    """A call that waits for an answer.

    `why`: under which rule it came; `known`: what is known about it, a sentence each; `otherwise`: what happens if
    nobody answers. `ends_us`: run time at which the task is given up; None: it belongs to none.
    """

    action_id: str
    purpose: str
    supervisor: str
    title: str
    why: str
    known: tuple[str, ...]
    otherwise: str
    ends_us: int | None
    replies: tuple[Reply, ...]


class RobotSeen(msgspec.Struct, frozen=True):
    """A robot: whom it answers to, whether it is away, what it does or why not, and how many actions wait for it."""

    robot: str
    role: str
    supervisor: str
    is_away: bool
    does: str | None
    waiting: int


class Overview(msgspec.Struct, frozen=True):
    """What the console shows to one principal. Units: `now_us` run time."""

    principal: str
    run: str
    now_us: int
    calls: tuple[OpenCall, ...]
    robots: tuple[RobotSeen, ...]
    tasks: tuple[str, ...]


def overview(state: State, now_us: int, principal: str, run: str) -> Overview:
    """Return what the principal may see: a supervisor the calls to it, everybody else all calls."""
    calls = tuple(_calls(state, principal if principal.startswith("supervisor/") else None))
    return Overview(principal, run, now_us, calls, tuple(_robots(state)), tuple(state.task))


def _calls(state: State, supervisor: str | None) -> Iterator[OpenCall]:
    for call in state.supervision.calls.values():
        about = call.subject.action_id
        if is_settled(state, call) or supervisor not in (None, call.supervisor):
            continue
        task = state.task.get(call.subject.task_id)
        ends_us = None if task is None else given_up_us(task, state.fleet)
        title, why, replies = _asked(state, call)
        otherwise = "Nothing happens: what waits for the answer goes on waiting"
        otherwise += "." if ends_us is None else f", until task {call.subject.task_id} is given up."
        yield OpenCall(
            about, call.purpose, call.supervisor, title, why, tuple(_known(state, call)), otherwise, ends_us, replies
        )


def _asked(state: State, call: SupervisorCalled) -> tuple[str, str, tuple[Reply, ...]]:
    """Return what is asked, under which rule, and what can be said."""
    about = call.subject.action_id
    executor, capability, requester = _parties(state, about)
    if call.purpose == "review":
        title = f"May {executor or 'the robot'} do {capability}" + (f" for {requester}?" if requester else "?")
        why = "; ".join(_rules(state, executor, capability, call.subject.task_id)) or "A rule asked for a review."
        return title, why, (Reply("Approve", True), Reply("Refuse", False))
    if call.purpose == "recovery":
        title = f"{executor or 'A robot'} failed at {capability}, and nothing has helped. Is it resolved?"
        return title, "Recovery has reached its last level, a person.", (Reply("It is resolved", True),)
    other = call.competing or ""
    title = f"Two requests want {executor or 'the same robot'}: {about} and {other}. Which goes first?"
    replies = tuple(Reply(f"{one} first", True, one) for one in (about, other) if one)
    why = "The fleet's supervisor orders requests for one robot when one of them is time-critical."
    return title, why, replies


def _parties(state: State, about: str) -> tuple[Robot | None, str, str | None]:
    """Return the executor, the capability and the requester of an action or a request."""
    if (action := state.execution.actions.get(about)) is not None:
        return action.robot, action.capability, action.requested_by if action.is_delegated else None
    request = state.request.open[about]
    executor = request.candidates[0] if request.candidates else request.target
    return executor, request.capability, request.requester


def _rules(state: State, executor: Robot | None, capability: str, task: str) -> Iterator[str]:
    """Yield each rule, window and density that puts this before a person."""
    if executor is None:
        return
    for rule in rules_in_force(state.policy):
        is_about = rule.capability in (None, capability) and rule.context in (None, task)
        if rule.robot == executor and rule.outcome == "review" and is_about:
            yield f"A {rule.scope} rule asks for a review of {rule.capability or 'everything'} at {executor}"
    for scope in ("local", "fleet"):
        for window, outcome in getattr(state.world, scope).get(executor, ()):
            if outcome == "review":
                yield f"The {scope} window {window} asks for a review at {executor}"
    if (every := density(state.supervision, executor)) > 0:
        yield f"One in {every} admissions by {executor} is reviewed"


def _known(state: State, call: SupervisorCalled) -> Iterator[str]:
    about = call.subject.action_id
    executor, _, requester = _parties(state, about)
    task = state.task.get(call.subject.task_id)
    other = state.request.open.get(call.competing or "")
    for one in (task, None if other is None else state.task.get(other.task_id)):
        if one is not None:
            urgent = ", time-critical" if one.is_time_critical else ""
            yield f"Task {one.task_id} of {one.robot}, step {one.step + 1} of {len(one.steps)}{urgent}."
    if executor is not None and requester is not None and requester in state.fleet.robots:
        trusted = scope_of(state.trust, executor, recorded_robot(requester), None, None)
        yield f"{executor} trusts {requester}: {trusted}."
    if (recovery := state.recovery.get(about)) is not None:
        yield f"Cause: {recovery.cause or 'not known'}. Attempts of its own: {recovery.number}."
        yield f"Asked for help: {', '.join(recovery.tried) or 'nobody could help'}."
    for robot in (recorded_robot(name) for name in (executor, requester) if name is not None):
        if (away := _away(state, robot)) is not None:
            yield f"{robot} is away: {away}."


def _robots(state: State) -> Iterator[RobotSeen]:
    for robot, member in state.fleet.robots.items():
        current = state.execution.current.get(robot)
        action = None if current is None else state.execution.actions.get(current)
        does = current if action is None else f"{action.capability} ({action.action_id}, {action.stage})"
        away = _away(state, robot)
        waiting = len(state.execution.queues.get(robot, ()))
        supervisor = member.supervisor or FLEET_SUPERVISOR
        yield RobotSeen(robot, member.role, supervisor, away is not None, away or does, waiting)


def _away(state: State, robot: Robot) -> str | None:
    """Return how the robot is away, if it is."""
    if (how := state.fleet.departed.get(robot)) is not None:
        return f"has left the fleet ({how})"
    if robot in state.knowledge.suspected:
        return "not heard of any more"
    return "off" if robot in state.world.off else None


def page_file(name: str) -> bytes:
    """Return a file of the page."""
    return (Path(__file__).parent / name).read_bytes()
