"""`reproduce` makes the paper's experiments and reports them, and what the README goes on with runs there."""

import json
import os
import shlex
import sys
from pathlib import Path

import pytest

from fsar_ledger.metrics.definitions import metrics
from tests.foreign.verbs import ask
from tests.quick import few
from tests.running import ran
from tests.test_documentation import readme_blocks

EXPERIMENTS = {"results": "", "ablation": "/ablation", "scaling": "/scaling", "workflows": "/workflows"}


def test_an_experiment_that_is_not_known_is_refused_before_anything_is_made(tmp_path: Path) -> None:
    said = ask("reproduce", "--out", tmp_path / "out", "--only", "ablations")
    assert (said.code, "did you mean ablation?" in said.err) == (2, True)
    assert not (tmp_path / "out").exists()


# that an experiment that is there is not made again, and a report has the same bytes again, is tested in parts as well
@pytest.mark.parametrize("only", few([("workflows",), ()], [], [("workflows",)]), ids=" ".join)
def test_reproduce_makes_the_experiments_that_are_asked_for_and_can_be_repeated(
    tmp_path: Path, only: tuple[str, ...]
) -> None:
    reproduced(tmp_path, *only)
    out = tmp_path / "fsar-out"
    before = {path.name: path.read_bytes() for path in out.iterdir() if path.is_file()}
    assert {"report.pdf", "reproduction.json"} <= before.keys()
    asked = [option for name in only for option in ("--only", name)]
    again = ask("reproduce", "--out", out, "--runs", 1, "--workers", 1, "--key", tmp_path / "fleet.key", *asked)
    assert again.code == 0, again.err
    assert {path.name: path.read_bytes() for path in out.iterdir() if path.is_file()} == before


@pytest.mark.slow
def test_every_command_of_the_readme_runs_as_printed_after_a_reproduction(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reproduced(tmp_path)
    _, *blocks = readme_blocks()
    surroundings = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    monkeypatch.chdir(tmp_path)
    for first, *others in map(str.splitlines, blocks):
        done = ran(["sh", "-c", first], env=surroundings)
        assert done.returncode == 0, f"{first}\n{done.stdout}{done.stderr}"
        assert done.stdout.strip(), first
        for line in others:  # none needs a shell, but for the comment at its end
            assert not set(line.partition("    #")[0].partition('"')[0]) & set("$*?|;&><"), line
            said = ask(*shlex.split(line, comments=True)[1:])
            assert said.code == 0, (line, said.err)
            assert said.out.strip(), line


def reproduced(folder: Path, *only: str) -> None:
    """The results and these experiments (none named: all) were done with one run of each scenario, complete and signed,
    in `fsar-out` of the folder."""
    out, key = folder / "fsar-out", folder / "fleet.key"
    assert ask("key", "new", key, "--name", "example.org/fleet").code == 0
    asked = [option for name in only for option in ("--only", name)]
    said = ask("reproduce", "--out", out, "--runs", 1, "--workers", "1", "--key", key, *asked)
    assert said.code == 0, said.err
    names = {"results", *only} if only else set(EXPERIMENTS)
    found = {path.name for path in out.iterdir()}
    assert found == {*names, "metrics.csv", "statistics.csv", "report.pdf", "reproduction.json"}
    assert len(said.out.splitlines()) == 2 + 3 * len(metrics()) + 3
    told = json.loads((out / "reproduction.json").read_text())
    assert told["ledgers"].keys() >= names  # of mechanisms too where an ablation is there
    for name in names:
        info = json.loads(ask("info", out / name, "--json").out)
        assert info["is_complete"], name
        assert info["head"]["root"] == told["ledgers"][name]["root"]
        origin = f"example.org/fleet{EXPERIMENTS[name]}"
        note = (out / name / "checkpoint").read_text()
        assert (note.split("\n")[0], f"\N{EM DASH} {origin} " in note) == (origin, True)
