"""The fixes of `tests/reverts` still stand in their files, and each names a test that exists."""

import re
import sys
from pathlib import Path

import pytest

from tests.reverts import ROOT, reverted, reverts
from tests.running import ran

FIXES = reverts()
LINES = {*(f"1.{number}" for number in range(1, 10)), *(f"2.{number}" for number in range(1, 8))}


@pytest.mark.parametrize("name", FIXES)
def test_a_fix_stands_once_where_it_can_be_taken_out(name: str) -> None:
    for change in FIXES[name].change:
        text = (ROOT / change.file).read_text("utf-8")
        assert reverted(text, change) != text


def test_code_without_a_fix_has_no_undefined_name(tmp_path: Path) -> None:
    for name, fix in FIXES.items():
        for number, change in enumerate(fix.change):
            if change.file.endswith(".py"):
                text = reverted((ROOT / change.file).read_text("utf-8"), change)
                (tmp_path / f"{name}-{number}.py").write_text(text)
    checked = ran([sys.executable, "-m", "ruff", "check", "--isolated", "--select", "F821", str(tmp_path)])
    assert checked.returncode == 0, checked.stdout


@pytest.mark.parametrize("name", FIXES)
def test_a_fix_names_a_test_that_exists(name: str) -> None:
    file, *_, test = FIXES[name].test.split("::")
    assert re.search(rf"^( {{4}})?def {test.partition('[')[0]}\(", (ROOT / file).read_text("utf-8"), re.MULTILINE)


def test_every_line_of_the_right_answers_has_a_fix() -> None:
    assert {fix.line for fix in FIXES.values()} >= LINES


@pytest.mark.slow
def test_a_fix_that_names_a_case_of_a_test_names_one_that_exists() -> None:
    named = {fix.test for fix in FIXES.values() if "[" in fix.test}
    files = sorted({test.partition("::")[0] for test in named})
    listed = ran([sys.executable, "-m", "pytest", "--collect-only", "-m", "", *files], cwd=ROOT).stdout.splitlines()
    assert named <= {*listed}
