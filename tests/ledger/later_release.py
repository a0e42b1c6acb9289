"""A made-up later release: a copy of the package whose event types were changed, in a process of its own.

The changes follow docs/contributing/event-version.md.

`StepBegan` went through two versions: v2 has `is_own`, v3 has `is_delegated` instead. `RobotJoined` has a new optional
field `depot`.
"""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple, Self

import fsar_ledger
from fsar_ledger.ledger.rows import schema

ROOT = Path(__file__).resolve().parents[2]


def after(release: str) -> str:
    """Return the number of the next minor release."""
    major, minor, _ = map(int, release.split("."))
    return f"{major}.{minor + 1}.0"


RELEASE = after(max(fsar_ledger.__version__, schema.RELEASE, key=lambda text: [*map(int, text.split("."))]))

STEPS = '''
class StepBeganV1(Event, frozen=True, tag="StepBegan.v1"):
    """As it was until 0.3.0."""

    task_id: str
    action_id: str
    robot: str
    step: int
    attempt: int
    capability: str
    target_role: str | None = None


class StepBeganV2(Event, frozen=True, tag="StepBegan.v2"):
    """As it never was in a release."""

    task_id: str
    action_id: str
    robot: str
    step: int
    attempt: int
    capability: str
    is_own: bool
    target_role: str | None = None


def _second(event: StepBeganV1) -> StepBeganV2:
    kept = (event.task_id, event.action_id, event.robot, event.step, event.attempt, event.capability)
    return StepBeganV2(*kept, event.target_role is None, event.target_role)


def _third(event: StepBeganV2) -> StepBegan:
    return StepBegan(
        subject=Subject(event.task_id, event.action_id), robot=event.robot, step=event.step, attempt=event.attempt,
        capability=event.capability, is_delegated=not event.is_own, target_role=event.target_role,
    )


'''

UPCASTERS = "Upcaster(StepBeganV1, StepBeganV2, _second), Upcaster(StepBeganV2, StepBegan, _third)"

EDITS = (
    (
        "events/task.py",
        "class StepBegan(Event, frozen=True, kw_only=True):",
        'class StepBegan(Event, frozen=True, kw_only=True, tag="StepBegan.v3"):',
    ),
    (
        "events/task.py",
        "    capability: str\n    target_role",
        "    capability: str\n    is_delegated: bool\n    target_role",
    ),
    (
        "runtime/handlers/task.py",
        "            capability=capability,\n            target_role=",
        "            capability=capability,\n            is_delegated=bool(target),\n            target_role=",
    ),
    (
        "events/retired.py",
        "# See docs/decisions/evidence-is-never-rewritten.md.\n",
        f"{STEPS}# See docs/decisions/evidence-is-never-rewritten.md.\n",
    ),
    ("events/retired.py", "from .envelope import Event\n", "from .envelope import Event, Subject\n"),
    (
        "events/retired.py",
        "from .fleet import RunStarted\n",
        "from .fleet import RunStarted\nfrom .task import StepBegan\n",
    ),
    ("events/retired.py", "] = (RunStartedV1,", "] = (StepBeganV1, StepBeganV2, RunStartedV1,"),
    ("events/retired.py", "] = (adding(RunStartedV1", f"] = ({UPCASTERS}, adding(RunStartedV1"),
    ("events/fleet.py", '    domain: str = ""\n', '    domain: str = ""\n    depot: str | None = None\n'),
    ("ledger/rows/schema.py", f'RELEASE = "{schema.RELEASE}"', f'RELEASE = "{RELEASE}"'),
    ("queries/facts/cross_robot_records.sql", "'StepBegan.v1'", "'StepBegan.v3'"),
)


SERVE = """
import io, json, sys, traceback
from contextlib import redirect_stderr, redirect_stdout
from fsar_ledger.cli.app import run

for line in sys.stdin:
    code, words = json.loads(line)
    out, err, status = io.StringIO(), io.StringIO(), 0
    with redirect_stdout(out), redirect_stderr(err):
        try:
            if code is None:
                status = run(words)
            else:
                sys.argv[1:] = words
                exec(code, {})
        except Exception:
            status = 1
            traceback.print_exc()
    print(json.dumps([status, out.getvalue(), err.getvalue()]), flush=True)
"""
"""Answers each line (some code or None, and its arguments) with one line.

Starting a process for each would take most of the time.
"""


class Said(NamedTuple):
    """How a command of the later release ended, and what it printed."""

    code: int
    out: str
    err: str


class LaterRelease:
    """The later release, running in a folder of its own. Use as a context manager."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / "fsar_ledger", folder / "fsar_ledger", ignore=ignored)
        for name in ("queries", "reports"):
            shutil.copytree(ROOT / name, folder / "fsar_ledger" / name, ignore=ignored)
        for name, before, after in EDITS:
            file = folder / "fsar_ledger" / name
            text = file.read_text("utf-8")
            assert text.count(before) == 1, f"{name}: expected {before!r} once"
            file.write_text(text.replace(before, after), "utf-8")

    def __enter__(self) -> Self:
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, (self._folder, ROOT)))}
        command = [sys.executable, "-c", SERVE]
        self._process = subprocess.Popen(
            command, cwd=self._folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
        )
        return self

    def __exit__(self, *_: object) -> None:
        self._process.communicate()

    def call(self, *arguments: object) -> Said:
        """Run a command of this release with these arguments."""
        return self._ask(None, *arguments)

    def answer(self, *arguments: object) -> Any:
        """Return the JSON answer of a command."""
        done = self.call(*arguments, "--json")
        assert done.code == 0, done.err
        return json.loads(done.out)

    def run(self, code: str, *arguments: object) -> Any:
        """Return what this code prints as JSON."""
        done = self._ask(code, *arguments)
        assert done.code == 0, done.err
        return json.loads(done.out)

    def _ask(self, code: str | None, *arguments: object) -> Said:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps([code, [str(argument) for argument in arguments]]) + "\n")
        self._process.stdin.flush()
        return Said(*json.loads(self._process.stdout.readline()))
