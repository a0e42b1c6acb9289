"""The Makefile passes the folder of its output on as it was given, whatever its name."""

import json
import re
import shutil
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

from tests.quick import few

ROOT = Path(__file__).resolve().parents[1]
RECORDER = f"""#!{sys.executable}
import json, sys
with open("calls", "a") as calls:
    print(json.dumps(sys.argv[1:]), file=calls)
"""


TARGETS = ("reproduce", "soak-sensitivity", "fleets", "bench", "clean")


@pytest.mark.parametrize("out", ["my out", 'it\'s "mine"; *', "~"])
@pytest.mark.parametrize("target", few(TARGETS, ["reproduce", "clean"]))
def test_the_output_goes_into_the_folder_that_was_named(tmp_path: Path, target: str, out: str) -> None:
    shutil.copy(ROOT / "Makefile", tmp_path)
    (tmp_path / "bin").mkdir()
    for name in ("fsar-ledger", "python"):
        (tmp_path / "bin" / name).write_text(RECORDER)
        (tmp_path / "bin" / name).chmod(0o755)
    beside = {*out.split(), "keep"}
    for name in {out, *beside}:
        (tmp_path / name).mkdir(exist_ok=True)
    done = [word for one in (".venv/.ready", ".venv/.ready-test") for word in ("-o", one)]
    for one in done[1::2]:
        (tmp_path / one).parent.mkdir(exist_ok=True)
        (tmp_path / one).touch()
    command = ["make", "-s", *done, target, f"OUT={out}", "BIN=bin", "PYTHON=true"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    if target == "clean":
        assert not (tmp_path / out).exists()
        assert all((tmp_path / name).exists() for name in beside - {out})
        return
    calls = (tmp_path / "calls").read_text()
    words = [word for call in calls.splitlines() for word in json.loads(call)]
    assert [word for word in words if out in word] == [word for word in words if word.startswith(out)]
    assert any(word == out or word.startswith(f"{out}/") for word in words)


def test_what_it_imports_is_there() -> None:
    imports = re.findall(r"from (fsar_ledger\S*) import ([\w, ]+)", (ROOT / "Makefile").read_text("utf-8"))
    assert imports
    for module, names in imports:
        assert set(names.split(", ")) <= vars(import_module(module)).keys()


def test_each_module_of_tests_that_make_calls_does_something() -> None:
    called = re.findall(r"python -m (tests[\w.]+)", (ROOT / "Makefile").read_text("utf-8"))
    assert len(called) > 8
    for module in called:
        text = (ROOT / f"{module.replace('.', '/')}.py").read_text("utf-8")
        assert '\nif __name__ == "__main__":\n' in text, module
