"""`study show` shows stored results and whether they are stale; the verbs that were studies work as before."""

from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

from fsar_ledger.api.verbs import VERBS
from fsar_ledger.cli.app import app
from tests.studies.conftest import study

from .conftest import Call, one_message

SMALL = ("--metric", "human_intervention")


@pytest.mark.parametrize(
    ("name", "parts"),
    [
        ("calibration", ("world.context_rate_per_s", "distance_margins")),
        ("predictions", ("encounters", "internal events (inward)")),
        ("comparison", ("ours_one_team", "twenty-four")),
    ],
)
def test_a_packaged_result_is_shown_and_rests_on_what_there_is(call: Call, name: str, parts: tuple[str, ...]) -> None:
    called = call("study", "show", name)
    assert (called.code, called.err) == (0, "")
    assert all(part in called.out for part in parts)
    assert called.out.endswith("\nnothing that it rests on has changed since\n")


def test_effects_are_shown_as_when_they_were_found(call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fsar_ledger.studies.sensitivity.sensitivity", lambda out, **_: study(Path(out)))
    file = tmp_path / "effects.json"
    ran = call("study", "run", "sensitivity", "--out", file)
    assert (ran.code, ran.err) == (0, "")
    assert call("study", "show", "sensitivity", file).out == ran.out.replace(
        f"{file}\n", "nothing that it rests on has changed since\n"
    )


@pytest.mark.parametrize(
    ("name", "now", "before", "said"),
    [
        ("calibration", '"model_version": "2"', '"model_version": "1"', "of model '1', expected model '2'"),
        ("comparison", '"facts/conflicts": "', '"facts/conflicts": "0', "changed since: facts/conflicts"),
        ("comparison", '"parameters": "{', '"parameters": "{ ', "expected those of this version"),
        ("calibration", '"rules"', '"other"', "that name no queries"),
    ],
)
def test_a_result_that_rests_on_something_else_is_stale(
    call: Call, tmp_path: Path, name: str, now: str, before: str, said: str
) -> None:
    text = files("fsar_ledger.reports").joinpath(f"{name}.json").read_text()
    assert now in text
    (tmp_path / "result.json").write_text(text.replace(now, before))
    *_, last = call("study", "show", name, tmp_path / "result.json").out.splitlines()
    assert last.startswith("stale: found results ")
    assert said in last


def test_what_cannot_be_shown_is_one_message(call: Call, tmp_path: Path) -> None:
    (tmp_path / "text").write_text("no result")
    one_message(call("study", "show", "calibrations"), 2, "calibration")
    one_message(call("study", "show", "sensitivity"), 2, "the package has none")
    one_message(call("study", "show", "comparison", tmp_path / "text"), 1, "study run comparison", "write it again")
    one_message(call("study", "show", "comparison", tmp_path / "none"), 2, "cannot be read")


def test_the_verbs_of_before_are_the_studies_and_no_help_lists_them(call: Call, ledger: Path) -> None:
    commands: Any = get_command(app)
    for family in ("study", "maintain"):
        assert commands.commands[family]
    of_before = {verb.old: verb for verb in VERBS.values() if verb.old}
    assert set(of_before) == {
        *("calibrate", "predict", "judge", "sensitivity", "multiverse"),
        *("recover", "upgrade", "compact"),
    }
    for old, verb in of_before.items():
        assert old not in [*commands.commands]
        assert commands.commands[old].help == verb.help
        assert f"  {old} " not in call("--help").out
    assert call("multiverse", ledger, *SMALL).out == call("study", "run", "multiverse", ledger, *SMALL).out
