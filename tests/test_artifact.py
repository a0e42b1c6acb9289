"""Each row of `docs/artifact.md` shows its claim: the command gives the expected figure within its tolerance."""

import json
import shlex
import sys
from pathlib import Path
from typing import NamedTuple

import pytest

import fsar_ledger
from tests.running import ran

ROOT = Path(__file__).resolve().parent.parent


class Row(NamedTuple):
    """A claim, the command that shows it, what is expected, and by how much a number may differ."""

    claim: str
    command: str
    expected: str
    tolerance: str

    def is_shown_by(self, output: str) -> bool:
        """Tell whether this output shows the claim."""
        if not self.tolerance:
            return self.expected in output
        return abs(float(output.split()[-1]) - float(self.expected)) <= float(self.tolerance)


def rows() -> list[Row]:
    lines = (ROOT / "docs" / "artifact.md").read_text("utf-8").splitlines()
    table = [line for line in lines if line.startswith("| ")][1:]
    return [Row(*(cell.strip().strip("`") for cell in line.strip("|").split(" |"))) for line in table]


@pytest.mark.slow
def test_each_claim_is_shown_by_its_command(tmp_path: Path) -> None:
    assert len(rows()) > 15
    for row in rows():
        program, *arguments = shlex.split(row.command)
        assert program == "fsar-ledger"
        found = ran([sys.executable, "-m", "fsar_ledger", *arguments], cwd=tmp_path)
        assert row.is_shown_by(found.stdout), (row, found.stdout[-500:], found.stderr)


def test_a_figure_out_of_tolerance_is_found() -> None:
    [locality] = [row for row in rows() if row.claim.startswith("Decisions stay local")]
    assert locality.is_shown_by("mean\n0.93\n")
    assert not locality.is_shown_by("mean\n0.90\n")
    assert not rows()[0].is_shown_by("root 00\n")


def test_the_citation_is_of_this_version_and_license() -> None:
    cited = (ROOT / "CITATION.cff").read_text("utf-8")
    described = json.loads((ROOT / "codemeta.json").read_text("utf-8"))
    assert f"\nversion: {fsar_ledger.__version__}\n" in cited
    assert described["version"] == fsar_ledger.__version__
    assert "\nlicense: Apache-2.0\n" in cited
    assert described["license"].endswith("/Apache-2.0")
