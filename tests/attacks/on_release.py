"""Shows that the attacks succeed on an earlier commit: `python -m tests.attacks.on_release ff02425 [TEST ...]`.

Checks that commit out beside this one, runs every test of this folder against its command line, and exits with 0 if
each fails there.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from tests.attacks.conftest import ATTACKED, ROOT


class Outcomes:
    """A pytest plugin that notes which tests passed, failed, or could not begin."""

    def __init__(self) -> None:
        self.of: dict[str, set[str]] = {"passed": set(), "failed": set(), "broken": set()}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when == "call":
            self.of[report.outcome if report.outcome != "skipped" else "broken"].add(report.nodeid)
        elif report.outcome != "passed":
            self.of["broken"].add(report.nodeid)


def check_out(revision: str, place: Path) -> None:
    """Put the files of that revision into this folder, so that its package runs from there."""
    archive = subprocess.run(["git", "archive", revision], cwd=ROOT, check=True, capture_output=True).stdout
    subprocess.run(["tar", "-x", "-C", str(place)], input=archive, check=True)
    for folder in ("queries", "reports"):  # within the package, where an installation has them
        (place / "fsar_ledger" / folder).symlink_to(place / folder)


def main(revision: str, tests: list[str]) -> int:
    """Run the attacks; return 0 if every one succeeds on the revision."""
    with tempfile.TemporaryDirectory() as place:
        check_out(revision, Path(place))
        os.environ[ATTACKED] = place
        outcomes = Outcomes()
        pytest.main(
            ["-q", "--tb=line", "-p", "no:cacheprovider", "-m", "", *(tests or ["tests/attacks"])], plugins=[outcomes]
        )
    for outcome in ("passed", "broken"):
        for name in sorted(outcomes.of[outcome]):
            print(f"{name}: {'the attack fails on' if outcome == 'passed' else 'cannot be tried on'} {revision} too")
    succeeded, not_tried = len(outcomes.of["failed"]), len(outcomes.of["broken"])
    defended = len(outcomes.of["passed"])
    print(f"{succeeded} attacks succeed on {revision}, {defended} do not, {not_tried} cannot be tried")
    return 0 if succeeded and not defended and not not_tried else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], sys.argv[2:]))
