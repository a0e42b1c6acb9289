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


def called(command: str, place: Path) -> str:
    """Return what the command prints in this folder."""
    program, *arguments = shlex.split(command)
    assert program == "fsar-ledger"
    found = ran([sys.executable, "-m", "fsar_ledger", *arguments], cwd=place)
    assert found.returncode == 0, (command, found.stderr)
    return found.stdout


@pytest.mark.soak
def test_each_claim_is_shown_by_its_command(tmp_path: Path) -> None:
    assert len(rows()) > 15
    for row in rows():
        output = called(row.command, tmp_path)
        assert row.is_shown_by(output), (row, output[-500:])


@pytest.mark.slow
def test_each_claim_is_shown_where_the_summary_that_many_read_is_made_once(tmp_path: Path) -> None:
    first, *others = [row for row in rows() if row.command.startswith("fsar-ledger sql out/artifact ")]
    for row in rows():
        if row not in others:
            output = called(row.command, tmp_path)
            assert row.is_shown_by(output), (row, output[-500:])
    selects = [shlex.split(row.command)[3] for row in others]
    assert [shlex.split(row.command)[4:] for row in others] == [["--csv"]] * len(others)
    parts = [f"({select.replace('FROM metric_summary', 'FROM summary')})::VARCHAR" for select in selects]
    once = f"WITH summary AS MATERIALIZED (FROM metric_summary) SELECT unnest([{', '.join(parts)}]) AS shown"
    _, *answers = called(shlex.join([*shlex.split(first.command)[:3], once, "--csv"]), tmp_path).splitlines()
    assert len(answers) > 10
    for row, answer in zip(others, answers, strict=True):
        assert row.is_shown_by(answer), (row, answer)


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
