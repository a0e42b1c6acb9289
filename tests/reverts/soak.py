"""Takes each fix out alone and demands that its test fails by its own assertion: `python -m tests.reverts.soak [NAME
...]`.

The tree is copied once a fix, so that nothing here is ever changed. A test that cannot be collected, ends in another
exception, or passes, is no evidence; the exit code is then 1.
"""

import os
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET
from pathlib import Path

from tests.reverts import ROOT, Revert, reverted, reverts

ASSERTED = ("assert", "AssertionError", "Failed: DID NOT RAISE", "Failed: DID NOT WARN")


def copy_tree(place: Path) -> None:
    """Copy what is under version control, or would be, so that its package runs from there."""
    names = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        check=True,
        capture_output=True,
    ).stdout
    subprocess.run(["tar", "-c", "--null", "-T", "-", "-f", str(place / "tree.tar")], cwd=ROOT, input=names, check=True)
    subprocess.run(["tar", "-x", "-f", "tree.tar"], cwd=place, check=True)
    for folder in ("queries", "reports"):  # as the installed package has them
        (place / "fsar_ledger" / folder).symlink_to(place / folder)


def outcome_of(place: Path, test: str) -> str:
    """Run the test in that tree; return `asserted` if it fails by an assertion, else what happened instead."""
    environment = os.environ | {"PYTHONPATH": str(place), "PYTHONDONTWRITEBYTECODE": "1"}
    report = place / "report.xml"
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-x",
        "-m",
        "",
        "-p",
        "no:cacheprovider",
        f"--junitxml={report}",
        test,
    ]
    done = subprocess.run(command, cwd=place, env=environment, capture_output=True, text=True, check=False)
    if not report.exists():
        return f"no test ran: {done.stdout[-300:]} {done.stderr[-300:]}"
    cases = list(ET.parse(report).iter("testcase"))
    failures = [failure.get("message", "") for case in cases for failure in case.findall("failure")]
    errors = [error.get("message", "") for case in cases for error in case.findall("error")]
    if errors or not cases:
        return f"the test could not begin: {(errors or [done.stdout[-300:]])[0]:.300}"
    if not failures:
        return "the test passes"
    return "asserted" if failures[0].startswith(ASSERTED) else f"the test fails otherwise: {failures[0]:.300}"


def tried(revert: Revert) -> str:
    """Take the fix out of a copy of the tree and return what its test does."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        copy_tree(place)
        for change in revert.change:
            path = place / change.file
            path.write_text(reverted(path.read_text("utf-8"), change), "utf-8")
        return outcome_of(place, revert.test)


def main(names: list[str]) -> int:
    """Return the exit code: 0 if each of these fixes (all, unless some are named) has a test that fails without it."""
    known = reverts()
    silent = []
    for name in names or known:
        outcome = tried(known[name])
        print(f"{known[name].line:4} {name}: {outcome} ({known[name].test})", flush=True)
        if outcome != "asserted":
            silent.append(name)
    tests = len(names or known)
    print(
        f"{tests} fixes taken out, {tests - len(silent)} tests failed by an assertion, {len(silent)} did "
        f"not{': ' + ', '.join(silent) if silent else ''}"
    )
    return 1 if silent else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
