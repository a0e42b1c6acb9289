"""A made-up later release: a copy of the package in which event types were changed the way the README says, run in processes of its own.

`StepBegan` went through two versions: v2 said `is_own`, v3 says `is_delegated` instead; `RobotJoined` has a new optional field `depot`.
"""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
RELEASE = "0.4.0"

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
    return StepBeganV2(event.task_id, event.action_id, event.robot, event.step, event.attempt, event.capability, event.target_role is None, event.target_role)


def _third(event: StepBeganV2) -> StepBegan:
    return StepBegan(event.task_id, event.action_id, event.robot, event.step, event.attempt, event.capability, not event.is_own, event.target_role)


'''

UPCASTERS = "Upcaster(StepBeganV1, StepBeganV2, _second), Upcaster(StepBeganV2, StepBegan, _third)"

EDITS = (
    ("events/task.py", "class StepBegan(Event, frozen=True):", 'class StepBegan(Event, frozen=True, tag="StepBegan.v3"):'),
    ("events/task.py", "    capability: str\n    target_role", "    capability: str\n    is_delegated: bool\n    target_role"),
    ("runtime/handlers/task.py", "            capability,\n            target[0]", "            capability,\n            bool(target),\n            target[0]"),
    ("events/retired.py", "from .upcasting import Upcaster\n", f"from .task import StepBegan\nfrom .upcasting import Upcaster\n{STEPS}"),
    ("events/retired.py", "] = (RunStartedV1,)\n", "] = (RunStartedV1, StepBeganV1, StepBeganV2)\n"),
    ("events/retired.py", "] = (Upcaster(RunStartedV1", f"] = ({UPCASTERS}, Upcaster(RunStartedV1"),
    ("events/fleet.py", '    domain: str = ""\n', '    domain: str = ""\n    depot: str | None = None\n'),
    ("ledger/releases.py", 'RELEASE = "0.3.0"', f'RELEASE = "{RELEASE}"'),
    ("queries/facts/cross_robot_records.sql", "'StepBegan.v1'", "'StepBegan.v3'"),
)


class LaterRelease:
    """The later release in a folder of its own."""

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

    def call(self, *arguments: object) -> subprocess.CompletedProcess[str]:
        """The command of this release, with these arguments."""
        return self._python("-m", "fsar_ledger", *map(str, arguments))

    def answer(self, *arguments: object) -> Any:
        """What the command says as JSON."""
        done = self.call(*arguments, "--json")
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    def run(self, code: str, *arguments: object) -> Any:
        """What this code, which prints JSON, prints."""
        done = self._python("-c", code, *map(str, arguments))
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    def _python(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        paths = os.pathsep.join(map(str, (self._folder, ROOT)))
        environment = {**os.environ, "PYTHONPATH": paths}
        return subprocess.run([sys.executable, *arguments], cwd=self._folder, capture_output=True, text=True, check=False, env=environment)
