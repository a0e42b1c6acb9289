"""A fleet to look at: four robots and a supervisor, each a process of its own that has only a token and the address.

A robot is a program that follows the events that name it and answers what it is asked, as a real one would. It keeps no
state that it could not have again from its events.
"""

import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from threading import Event, Thread
from typing import Any

import msgspec

from .client import Client, FollowedEvent
from .principals import add_principal

HUMAN, HUB, TOKEN = "supervisor/fleet", "service/demo", "FSAR_LEDGER_TOKEN"


class Story(msgspec.Struct, frozen=True):
    """What goes wrong at a robot: the cause at its n-th execution (from 1), and whether it can help.

    `attempts`: whether its own attempts to recover succeed; `helps`: whether it agrees to help; `leaves_at`: during
    this execution it goes off, and comes back after a while.
    """

    fails_at: Mapping[int, str] = {}
    attempts: bool = False
    helps: bool = False
    leaves_at: int = 0


STORIES: Mapping[str, Story] = {
    "robot/A1": Story(),
    "robot/B1": Story(fails_at={2: "hinge jammed"}),
    "robot/C1": Story(helps=True),
    "robot/D1": Story(leaves_at=1),
}


_PASSING = ("CommandGiven", "CommandRejected", "AuthorityClaimed", "AuthorityReleased")
"""What says nothing of where an action stands."""


class Robot:
    """The program of one robot.

    Args:
        way: Its way to the service.
        name: Its principal.
        story: What goes wrong.
        pause: Waits so many steps.
    """

    def __init__(self, way: Client, name: str, story: Story, pause: Callable[[float], None]) -> None:
        self._way, self._name, self._story, self._pause = way, name, story, pause
        self._waiting: list[str] = []
        self._executions = 0

    def run(self, known: int) -> None:
        """Answer until the service is gone; of the first so many events only what is still open.

        Raises: Refused: The service is away, or does not know the robot.
        """
        latest: dict[str, FollowedEvent] = {}
        events = self._way.events(after=-1)
        for event in events:
            if event.type not in _PASSING and (action := _action(event)) is not None:
                latest[action] = event
            if event.type == "ExecutionStarted" and event.columns.get("robot") == self._name:
                self._executions += 1
            if event.seq >= known - 1:
                break
        for event in latest.values():
            if event.type == "ExecutionStarted" and event.columns.get("robot") == self._name:
                self._finish(f"{_action(event)}")  # this program ended in the middle of it
            else:
                self.answer(event)
        for event in events:
            self.answer(event)

    def answer(self, event: FollowedEvent) -> None:
        """Answer one event."""
        action, mine, named = _action(event), self._name, event.columns
        if event.type == "RequestIssued" and named.get("executed_by") == mine:
            self._say("JudgeRequest", action_id=action, accepts=True)
        elif _can_begin(event) and named.get("robot") == mine:
            self._waiting.append(f"{action}")
            self._work()
        elif event.type == "RecoveryAttempted" and named.get("robot") == mine:
            self._pause(1)
            self._say("ReportAttempt", action_id=action, succeeded=self._story.attempts)
        elif event.type == "AssistanceRequested" and named.get("helper") == mine:
            self._say("JudgeAssistance", action_id=action, accepts=self._story.helps)
        elif event.type == "AssistanceAdmitted" and named.get("helper") == mine:
            self._pause(1)
            self._say("ReportAssistance", action_id=action, succeeded=True)
        elif event.type == "FailureResolved" and named.get("robot") == mine:
            self._finish(f"{action}")
        elif event.type == "ExecutionWithdrawn" and action in self._waiting:
            self._waiting.remove(f"{action}")
        elif event.type == "ExecutionFinished" and named.get("executed_by") == mine:
            self._work()

    def _work(self) -> None:
        """Begin what waits, if it is its turn."""
        for action in tuple(self._waiting):
            if self._say("ReportStart", action_id=action):
                self._waiting.remove(action)
                self._executions += 1
                self._execute(action)

    def _execute(self, action: str) -> None:
        self._pause(1)
        if (cause := self._story.fails_at.get(self._executions)) is not None:
            self._say("ReportFailure", action_id=action, cause=cause)
            return
        if self._executions == self._story.leaves_at:
            self._say("ReportPresence", is_on=False)
            self._pause(4)
            self._say("ReportPresence", is_on=True)
        self._finish(action)

    def _finish(self, action: str) -> None:
        self._pause(1)
        self._way.give("ReportResult", executor=self._name, action_id=action, result="success")

    def _say(self, command: str, **fields: Any) -> bool:
        return self._way.give(command, robot=self._name, **fields).rejected is None


def _can_begin(event: FollowedEvent) -> bool:
    """Return whether a robot that is free can begin the action now."""
    return event.type == "ApproachStarted" or (event.type == "ExecutionQueued" and not event.columns["has_approach"])


def _action(event: FollowedEvent) -> str | None:
    """Return the action that an event is about."""
    return event.columns.get("action_id", event.columns.get("failed_action"))


def supervise(way: Client, name: str, after: float, pause: Callable[[float], None]) -> None:
    """Answer each call to the supervisor after so many steps: approve it, or say that it is resolved.

    Raises: Refused: As `Robot.run`.
    """
    for event in way.events(after=-1):
        if event.type == "SupervisorCalled" and event.columns["supervisor"] == name:
            pause(after)
            way.give("RespondToCall", supervisor=name, action_id=event.columns["action_id"], approves=True)


TASKS: Sequence[tuple[str, Sequence[tuple[str, Sequence[str]]]]] = (
    ("a door relay", (("robot/A1", ("A navigate.indoor", "A door.open.secure B", "A navigate.indoor")),)),
    ("a failure that only a person resolves", (("robot/A1", ("A door.open.secure B", "A navigate.indoor")),)),
    ("two at one door", (("robot/A1", ("A door.open.secure B",)), ("robot/C1", ("C door.open.secure B",)))),
    ("a robot that goes off, under review", (("robot/A1", ("A carry.heavy D", "A navigate.indoor")),)),
)
"""The stories of the demo: what is told, and for each task whose it is and its steps."""
REVIEWED = "robot/D1"
"""The robot whose every admission the fleet's supervisor wants to see."""


def play(hub: Client, number: int, budget_s: float) -> Iterator[str]:
    """Bring the tasks of the story with this number, and yield how each ends."""
    open_tasks: dict[str, int] = {}
    for place, (robot, steps) in enumerate(TASKS[number][1], start=1):
        task = f"story{number + 1}-{place}"
        given = hub.give(
            "SubmitTask", key=task, robot=robot, task_id=task, steps=steps, budget_us=round(budget_s * 1e6)
        )
        open_tasks[task] = given.seq
    for event in hub.events(after=min(open_tasks.values())):
        if event.type in ("TaskCompleted", "TaskAbandoned") and event.columns["task_id"] in open_tasks:
            del open_tasks[event.columns["task_id"]]
            yield "completed" if event.type == "TaskCompleted" else "given up"
            if not open_tasks:
                return


class Demo:
    """A service and its robots, each a process, which is started again when it dies. Use it as a context manager.

    Args:
        ledger: The ledger; its principals stand beside it.
        by_hand: A person answers the calls to the fleet's supervisor, in the console.
        step_s: How long anything takes.
    """

    def __init__(self, ledger: Path, by_hand: bool, step_s: float) -> None:
        self._ledger, self._by_hand, self._step_s = ledger, by_hand, step_s
        self._principals = ledger.with_name(f"{ledger.name}.principals")
        self.tokens = {name: add_principal(self._principals, name) for name in (*STORIES, HUMAN, HUB)}
        with socket.create_server(("127.0.0.1", 0)) as free:
            self.url = f"http://127.0.0.1:{free.getsockname()[1]}"
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self._is_over = Event()
        self._watch = Thread(target=self._keep, name="demo", daemon=True)

    def __enter__(self) -> "Demo":
        """Start everything. Raises: WriteFailed if the service does not begin."""
        self._start("service")
        with self.way(HUMAN) as human:
            human.give("SetSupervisionDensity", issued_by=HUMAN, robot=REVIEWED, review_every=1, reason="demo")
        for name in (*STORIES, *(() if self._by_hand else (HUMAN,))):
            self._start(name)
        self._watch.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._is_over.set()
        if self._watch.is_alive():
            self._watch.join()
        for name in reversed(self.processes):
            self.processes[name].terminate()
            self.processes[name].wait()

    def way(self, name: str) -> Client:
        """Return a principal's way to the service."""
        return Client(self.url, self.tokens[name])

    def _start(self, name: str) -> None:
        python = (sys.executable, "-m")
        command: tuple[str, ...] = (*python, "fsar_ledger.service.demo", name, self.url, f"{self._step_s}")
        if name == "service":
            port = self.url.rpartition(":")[2]
            principals = ("--principals", f"{self._principals}")
            command = (*python, "fsar_ledger", "serve", f"{self._ledger}", *principals, "--port", port)
        environment = {**os.environ, TOKEN: self.tokens.get(name, "")}
        quiet = subprocess.DEVNULL
        self.processes[name] = subprocess.Popen(
            command, env=environment, stdin=quiet, stdout=quiet, stderr=quiet, start_new_session=True
        )

    def _keep(self) -> None:
        """Start again what has died, as whoever looks after robots does."""
        while not self._is_over.wait(0.2):
            for name, process in tuple(self.processes.items()):
                if process.poll() is not None and not self._is_over.is_set():
                    self._start(name)


def main() -> None:
    """Be the robot or the supervisor of this name at this service; the token is in the environment."""
    name, url, step_s = sys.argv[1:]

    def pause(seconds: float) -> None:
        time.sleep(seconds * float(step_s))

    with Client(url, os.environ[TOKEN]) as way:
        if name == HUMAN:
            supervise(way, name, 2, pause)
        else:
            Robot(way, name, STORIES[name], pause).run(way.known())


if __name__ == "__main__":
    main()
