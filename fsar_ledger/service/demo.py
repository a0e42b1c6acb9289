"""A demo fleet: four robots and two supervisors, each a process of its own that has a token and the address.

A robot is a program that follows the events that name it and answers requests, as a real one would. It keeps no state
that it could not restore from its events.
"""

import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from threading import Event, Thread
from typing import Any, NamedTuple

import msgspec

from fsar_ledger.designs.constants import Structure
from fsar_ledger.ledger.store.paths import beside

from . import add_principal
from .client import Client, FollowedEvent

HUMAN, OWN, HUB, TOKEN = "supervisor/fleet", "supervisor/C1", "service/demo", "FSAR_LEDGER_TOKEN"
"""The fleet's supervisor, one of a single robot, the service that brings the work, and the variable of the token."""


class Story(msgspec.Struct, frozen=True):
    """The failures of a robot: the cause at its n-th execution (from 1), and whether it can help.

    `attempts`: whether its own attempts to recover succeed; `helps`: whether it agrees to help; `off_at`: the execution
    during which it goes off for a while; `leaves_at`: the one during which it leaves the fleet, and returns.
    """

    fails_at: Mapping[int, str] = {}
    attempts: bool = False
    helps: bool = False
    off_at: int = 0
    leaves_at: int = 0


STORIES: Mapping[str, Story] = {
    "robot/A1": Story(),
    "robot/B1": Story(fails_at={2: "hinge jammed"}),
    "robot/C1": Story(fails_at={1: "wheel slips"}, helps=True),
    "robot/D1": Story(off_at=1, leaves_at=2),
}


_PASSING = ("CommandGiven", "CommandRejected", "AuthorityClaimed", "AuthorityReleased")
"""The types of events that do not show the status of an action."""
_JUDGED = ("RequestAdmitted", "RequestDenied", "RequestClosed")
_MEMBER = ("role", "team", "supervisor", "domain", "place", "public_key")


class Robot:
    """The program of one robot.

    Args:
        client: Its connection to the service.
        name: Its principal.
        story: Its failures.
        pause: Waits this many steps.
    """

    def __init__(self, client: Client, name: str, story: Story, pause: Callable[[float], None]) -> None:
        self._client, self._name, self._story, self._pause = client, name, story, pause
        self._asked: list[str] = []
        self._withdrawn: set[str] = set()
        self._waiting: list[str] = []
        self._executions = 0
        self._joined: dict[str, Any] = {}
        self._is_away, self._fence = False, None

    def run(self, known: int) -> None:
        """Answer events until the service is gone; of the first `known` events, only those that are still open.

        Raises: Refused: The service is unavailable, or does not know the robot.
        """
        latest: dict[str, FollowedEvent] = {}
        events = self._client.events(after=-1)
        for event in events:
            self._learn(event)
            if event.type not in _PASSING and (action := _action(event)) is not None:
                latest[action] = event
            if event.type == "ExecutionStarted" and event.columns.get("robot") == self._name:
                self._executions += 1
            if event.seq >= known - 1:
                break
        if self._is_away:
            self._return()
        self._judge(*self._asked)
        for event in latest.values():
            if event.type == "ExecutionStarted" and event.columns.get("robot") == self._name:
                self._finish(f"{_action(event)}")  # this program ended in the middle of it
            else:
                self.answer(event)
        for event in events:
            self._learn(event)
            self.answer(event)

    def _learn(self, event: FollowedEvent) -> None:
        """Keep what the event says of this robot, and of requests to it."""
        columns, action = event.columns, f"{_action(event)}"
        if event.type == "RequestIssued" and columns.get("executed_by") == self._name:
            self._asked.append(action)
        elif event.type in _JUDGED and action in self._asked:
            self._asked.remove(action)
        elif event.type == "ExecutionWithdrawn" and columns["robot"] == self._name:
            self._withdrawn.add(action)
        elif columns.get("robot") == self._name and event.type in ("RobotJoined", "RobotDeparted", "RobotReturned"):
            self._joined = self._joined or {name: columns[name] for name in _MEMBER if name in columns}
            self._is_away = event.type == "RobotDeparted"
            self._fence = columns.get("fence")

    def _judge(self, *actions: str) -> None:
        """Accept these requests; one that has to wait for another is judged again when that one is decided."""
        for action in actions:
            self._say("JudgeRequest", action_id=action, accepts=True)

    def _return(self) -> None:
        self._client.give("JoinFleet", robot=self._name, **self._joined)

    def answer(self, event: FollowedEvent) -> None:
        """Answer one event."""
        action, name, columns = _action(event), self._name, event.columns
        if event.type == "RequestIssued" and action in self._asked:
            self._pause(1)
            self._judge(f"{action}")
        elif event.type in _JUDGED or (event.type == "SupervisorResponded" and columns["purpose"] == "ordering"):
            self._judge(*self._asked)
        elif _can_begin(event) and columns.get("robot") == name:
            self._waiting.append(f"{action}")
            self._work()
        elif event.type == "RecoveryAttempted" and columns.get("robot") == name:
            self._pause(1)
            self._say("ReportAttempt", action_id=action, succeeded=self._story.attempts)
        elif event.type == "AssistanceRequested" and columns.get("helper") == name:
            self._say("JudgeAssistance", action_id=action, accepts=self._story.helps)
        elif event.type == "AssistanceAdmitted" and columns.get("helper") == name:
            self._pause(1)
            self._say("ReportAssistance", action_id=action, succeeded=True)
        elif event.type == "FailureResolved" and columns.get("robot") == name and action not in self._withdrawn:
            self._finish(f"{action}")
        elif event.type == "ExecutionWithdrawn" and action in self._waiting:
            self._waiting.remove(f"{action}")
        elif event.type == "ExecutionFinished" and columns.get("executed_by") == name:
            self._work()

    def _work(self) -> None:
        """Begin each waiting action whose turn it is."""
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
            self._client.give("LeaveFleet", robot=self._name)
            self._pause(4)
            self._return()
            return
        if self._executions == self._story.off_at:
            self._say("ReportPresence", is_on=False)
            self._pause(4)
            self._say("ReportPresence", is_on=True)
        self._finish(action)

    def _finish(self, action: str) -> None:
        self._pause(1)
        self._client.give("ReportResult", executor=self._name, action_id=action, result="success", fence=self._fence)

    def _say(self, command: str, **fields: Any) -> bool:
        return self._client.give(command, robot=self._name, fence=self._fence, **fields).rejected is None


def _can_begin(event: FollowedEvent) -> bool:
    """Return whether a free robot can begin the action now."""
    return event.type == "ApproachStarted" or (event.type == "ExecutionQueued" and not event.columns["has_approach"])


def _action(event: FollowedEvent) -> str | None:
    """Return the action that an event is about."""
    return event.columns.get("action_id", event.columns.get("failed_action"))


def supervise(client: Client, name: str, after: float, pause: Callable[[float], None]) -> None:
    """Answer each call to the supervisor after this many steps: approve, and let an urgent request go first.

    Raises: Refused: As `Robot.run`.
    """
    urgent: set[str] = set()
    for event in client.events(after=-1):
        columns = event.columns
        if event.type == "TaskArrived" and columns["is_time_critical"]:
            urgent.add(columns["task_id"])
        if event.type == "SupervisorCalled" and columns["supervisor"] == name:
            pause(after)
            other = columns.get("competing")
            preferred = other if other is not None and other.partition("/")[0] in urgent else None
            client.give(
                "RespondToCall", supervisor=name, action_id=columns["action_id"], approves=True, preferred=preferred
            )


class TaskOf(NamedTuple):
    """A task of a story: its robot, its steps, and whether it is time-critical."""

    robot: str
    steps: Sequence[str]
    is_urgent: bool = False


TASKS: Sequence[tuple[str, Sequence[TaskOf]]] = (
    ("a door relay", [TaskOf("robot/A1", ("A navigate.indoor", "A door.open.secure B", "A navigate.indoor"))]),
    ("a failure that only a person can resolve", [TaskOf("robot/A1", ("A door.open.secure B", "A navigate.indoor"))]),
    (
        "two at one door, one of them urgent",
        [TaskOf("robot/A1", ("A door.open.secure B",)), TaskOf("robot/C1", ("C door.open.secure B",), is_urgent=True)],
    ),
    ("a robot that goes off, under review", [TaskOf("robot/A1", ("A carry.heavy D", "A navigate.indoor"))]),
    ("a failure for the robot's own supervisor", [TaskOf("robot/C1", ("C navigate.indoor",))]),
    ("a robot that leaves, and returns", [TaskOf("robot/A1", ("A carry.heavy D",))]),
)
"""The stories of the demo: the title and the tasks of each."""
REVIEWED = "robot/D1"
"""The robot whose every admission the fleet's supervisor reviews."""


def play(hub: Client, number: int, budget_s: float) -> Iterator[str]:
    """Submit the tasks of the story with this number, and yield how each ends."""
    open_tasks: dict[str, int] = {}
    for index, spec in enumerate(TASKS[number][1], start=1):
        task = f"story{number + 1}-{index}"
        decision = hub.give(
            "SubmitTask",
            key=task,
            robot=spec.robot,
            task_id=task,
            steps=spec.steps,
            budget_us=round(budget_s * 1e6),
            is_time_critical=spec.is_urgent,
        )
        open_tasks[task] = decision.seq
    for event in hub.events(after=min(open_tasks.values())):
        if event.type in ("TaskCompleted", "TaskAbandoned") and event.columns["task_id"] in open_tasks:
            del open_tasks[event.columns["task_id"]]
            yield "completed" if event.type == "TaskCompleted" else "given up"
            if not open_tasks:
                return


class Demo:
    """A service and its robots, each a process that is restarted when it dies. Use it as a context manager.

    Args:
        ledger: The ledger; the file of its principals lies beside it.
        by_hand: A person answers the calls to the fleet's supervisor, in the console.
        step_s: How long each step takes.
    """

    def __init__(self, ledger: Path, by_hand: bool, step_s: float) -> None:
        self._ledger, self._by_hand, self._step_s = ledger, by_hand, step_s
        self._principals = beside(ledger, ".principals")
        self.tokens = {name: add_principal(self._principals, name) for name in (*STORIES, HUMAN, OWN, HUB)}
        with socket.create_server(("127.0.0.1", 0)) as free:
            self.url = f"http://127.0.0.1:{free.getsockname()[1]}"
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self._is_over = Event()
        self._watch = Thread(target=self._keep, name="demo", daemon=True)

    def __enter__(self) -> "Demo":
        """Start everything. Raises: WriteFailed if the service does not begin."""
        try:
            self._start("service")
            with self.client(HUMAN) as human:
                human.give("SetSupervisionDensity", issued_by=HUMAN, robot=REVIEWED, review_every=1, reason="demo")
            for name in (*STORIES, OWN, *(() if self._by_hand else (HUMAN,))):
                self._start(name)
            self._watch.start()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._is_over.set()
        if self._watch.is_alive():
            self._watch.join()
        for name in reversed(self.processes):
            self.processes[name].terminate()
            self.processes[name].wait()

    def client(self, name: str) -> Client:
        """Return a client of the service that speaks as this principal."""
        return Client(self.url, self.tokens[name])

    def _start(self, name: str) -> None:
        python = (sys.executable, "-m")
        command: tuple[str, ...] = (*python, "fsar_ledger.service.demo", name, self.url, f"{self._step_s}")
        if name == "service":
            port = self.url.rpartition(":")[2]
            principals = ("--principals", f"{self._principals}")
            back_off = f"structure.back_off_us={round(Structure().back_off_us * self._step_s)}"
            command = (
                *python,
                "fsar_ledger",
                "serve",
                f"{self._ledger}",
                *principals,
                "--port",
                port,
                "--set",
                back_off,
            )
        environment = {**os.environ, TOKEN: self.tokens.get(name, "")}
        quiet = subprocess.DEVNULL
        self.processes[name] = subprocess.Popen(
            command, env=environment, stdin=quiet, stdout=quiet, stderr=quiet, start_new_session=True
        )

    def _keep(self) -> None:
        """Restart processes that have died, as the operator of real robots would."""
        while not self._is_over.wait(0.2):
            for name, process in tuple(self.processes.items()):
                if process.poll() is not None and not self._is_over.is_set():
                    self._start(name)


def main() -> None:
    """Run the robot or the supervisor of this name at this service; the token is in the environment."""
    name, url, step_s = sys.argv[1:]

    def pause(seconds: float) -> None:
        time.sleep(seconds * float(step_s))

    with Client(url, os.environ[TOKEN]) as client:
        if name in (HUMAN, OWN):
            supervise(client, name, 2, pause)
        else:
            Robot(client, name, STORIES[name], pause).run(client.known())


if __name__ == "__main__":
    main()
