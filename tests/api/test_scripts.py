"""A plain script may call whatever starts processes, without `if __name__ == "__main__"`, and ends quietly."""

import sys
from pathlib import Path

import pytest

import fsar_ledger
from tests.running import ran

SCRIPT = """
import fsar_ledger

print("begun")
made = fsar_ledger.simulate("made", architecture="fsar", scenario="door-relay", runs=26, workers=2)
print(made.result.runs_made, made.ledger.verify(workers=2).ok, made.ledger.sql("SELECT count(*) AS n FROM runs").rows())
"""


@pytest.mark.slow
def test_a_script_runs_once_whatever_processes_it_starts(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    done = ran([sys.executable, str(script)], cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines() == ["begun", "26 True [{'n': 26}]"]


@pytest.mark.slow
def test_a_script_that_asks_ends_without_a_word(ledger: fsar_ledger.Ledger) -> None:
    # What is kept until the end of the process keeps DuckDB's objects, too, which are then said to be leaked.
    script = f"import fsar_ledger\nledger = fsar_ledger.open_ledger({str(ledger.path)!r})\nledger.metrics()\n"
    done = ran([sys.executable, "-c", script])
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
