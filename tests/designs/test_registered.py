"""Designs that are added to the package are checked as a designer's own files are, before anything is simulated."""

import shutil
import sys
from pathlib import Path

from tests.running import ran

ROOT = Path(__file__).parents[2]
TASK = '[[tasks]]\nowner = "A"\nsteps = ["A door.open.basic B"]\n'
WRONG = {
    "other-name": ('name = "another"\n' + TASK, "1: name: found another, expected the name of the file, other-name"),
    "no-owner": (
        'name = "no-owner"\n' + TASK.replace('"A"', '"a"'),
        "3: tasks[0].owner: found a, expected one of the robots of fleet paper (A, B, C, D); did you mean A?",
    ),
    "no-capability": (
        'name = "no-capability"\n' + TASK.replace("basic", "basics"),
        "4: tasks[0].steps[0]: found door.open.basics, expected one of the capabilities of the fleet (",
    ),
    "workflow-torn": (
        'name = "workflow-torn"\n' + TASK + '[[wear]]\nrobot = "E"\ngrade = "slipping"\n',
        "6: wear[0].robot: found E, expected one of the robots of fleet paper (A, B, C, D)",
    ),
}
PROGRAM = """
import sys
from fsar_ledger.base.errors import UsageError
from fsar_ledger.runtime.experiment import Experiment
for name in sys.argv[1:]:
    try:
        Experiment(("fsar",), (name,), 1)
    except UsageError as error:
        print(error)
"""


def test_a_registered_scenario_or_workflow_that_cannot_happen_is_refused_with_its_line_and_field(
    tmp_path: Path,
) -> None:
    shutil.copytree(ROOT / "fsar_ledger", tmp_path / "fsar_ledger", ignore=shutil.ignore_patterns("__pycache__"))
    files = {}
    for name, (text, _) in WRONG.items():
        folder = "workflows" if name.startswith("workflow-") else "scenarios"
        files[name] = tmp_path / "fsar_ledger/runtime/world" / folder / f"{name}.toml"
        files[name].write_text(text)
    done = ran([sys.executable, "-c", PROGRAM, *WRONG], cwd=tmp_path, env={"PYTHONPATH": str(tmp_path)})
    assert done.stderr == ""
    for line, (name, (_, message)) in zip(done.stdout.splitlines(), WRONG.items(), strict=True):
        assert line.startswith(f"{files[name]}:{message}"), line
