"""What is committed of the page is what its sources give, and it bundles nothing that would need a licence."""

import json
import re
import shutil
import sys
from pathlib import Path

import pytest

from tests.running import ran

ROOT = Path(__file__).resolve().parents[2]
SOURCES = ROOT / "fsar_ledger/view/src"


@pytest.mark.slow
def test_the_script_and_the_style_are_those_that_their_sources_give() -> None:
    if shutil.which("node") is None or not (ROOT / "build/page/installed.json").exists():
        pytest.skip("make test-all installs what builds the page")
    done = ran([sys.executable, ".ci/page.py", "--check"], cwd=ROOT)
    assert (done.returncode, done.stderr) == (0, "")


def test_the_page_depends_on_no_library_and_its_tools_are_pinned_by_hash_alone() -> None:
    package = json.loads((SOURCES / "package.json").read_text("utf-8"))
    assert "dependencies" not in package
    lock = json.loads((SOURCES / "package-lock.json").read_text("utf-8"))
    tools = {name: one for name, one in lock["packages"].items() if name}
    assert all(one["dev"] and one["integrity"].startswith("sha512-") for one in tools.values())
    assert not any("resolved" in one for one in tools.values())
    assert package["devDependencies"].items() == lock["packages"][""]["devDependencies"].items()


def test_the_sources_import_each_other_and_nothing_else() -> None:
    for source in SOURCES.glob("*.ts"):
        text = source.read_text("utf-8")
        assert all(name.startswith("./") for name in re.findall(r'(?:from|import) "([^"]+)"', text)), source
        assert [line for line in text.splitlines() if len(line) > 120] == [], source
        assert len(text.splitlines()) <= 400, source
