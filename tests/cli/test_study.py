"""`study show` shows stored results and whether they are stale."""

from importlib.resources import files
from pathlib import Path

import pytest

from fsar_ledger.metrics import study_results
from tests.studies.conftest import study

from .conftest import Call, one_message


@pytest.mark.parametrize(
    ("name", "parts"),
    [
        ("calibration", ("world.context_rate_per_s", "distance_margins")),
        ("predictions", ("encounters", "internal events (inward)")),
        ("comparison", ("ours_one_team", "twenty-eight")),
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
        ("calibration", '"model_version": "3"', '"model_version": "1"', "of model '1', expected model '3'"),
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


def test_what_cannot_be_shown_is_one_message(call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "text").write_text("no result")
    one_message(call("study", "show", "calibrations"), 2, "calibration")
    one_message(call("study", "show", "comparison", tmp_path / "text"), 1, "study run comparison", "write it again")
    one_message(call("study", "show", "comparison", tmp_path / "none"), 2, "cannot be read")
    monkeypatch.setattr(study_results, "packaged", lambda _kind: None)
    one_message(call("study", "show", "sensitivity"), 2, "the package has none")
