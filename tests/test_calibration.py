"""The fit reads the tables that it says, and the constants of the package are the ones that it accepted."""

import json
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from fsar_ledger import calibration
from fsar_ledger.calibration import FITTED, calibrate, objective, rounded, with_values
from fsar_ledger.constants import Constants
from fsar_ledger.errors import WriteFailed
from fsar_ledger.runtime.switches import SWITCHES

RECORD = json.loads(files("fsar_ledger.reports").joinpath("calibration.json").read_text())


def test_the_constants_are_those_that_the_recorded_fit_accepted() -> None:
    accepted = {parameter["name"]: parameter["accepted"] for parameter in RECORD["parameters"]}
    assert list(accepted) == [fitted.name for fitted in FITTED]
    assert with_values(list(accepted.values())) == Constants()


def test_no_constant_that_the_paper_prints_is_fitted() -> None:
    printed = {"world.degradation_probability", "world.degraded_reliability", "world.message", "structure.local_attempts", "structure.local_budget_us"}
    assert not printed & {fitted.name for fitted in FITTED}


def test_the_calibration_seed_is_not_the_published_one() -> None:
    assert 42 not in RECORD["seeds"]
    assert RECORD["seeds"] == [calibration.SEED]


def test_only_the_results_table_is_judged_against() -> None:
    source = Path(calibration.__file__).read_text()
    assert not [name for name in ("ablation.csv", "scaling.csv", "cases.csv") if name in source.split('"""', 2)[2]]


OPENED = """
import sys
opened = set()
sys.addaudithook(lambda name, arguments: opened.add(str(arguments[0])) if name == "open" else None)
from fsar_ledger import calibration
from fsar_ledger.constants import Constants
assert len(calibration.distances(calibration.measure(Constants(), 1))) == 24
print(*sorted(name.rpartition("/")[2].removesuffix(".csv") for name in opened if name.endswith(".csv")))
"""


def test_the_fit_reads_the_tables_that_it_says_and_no_other() -> None:
    done = subprocess.run([sys.executable, "-c", OPENED], capture_output=True, text=True, check=True)
    assert done.stdout.split() == list(calibration.READ)


def test_values_have_three_digits() -> None:
    assert [rounded(value) for value in (0.022749, 11.4999, 6_512_345.0)] == [0.0227, 11.5, 6_510_000.0]


def test_the_objective_adds_the_prior_to_the_squared_distances() -> None:
    assert objective(np.array([3.0, 4.0]), np.array([calibration.PRIOR])) == pytest.approx(26.0)


def test_the_step_goes_down_the_objective_of_a_linear_world() -> None:
    jacobian = np.array([[2.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    now, point = np.array([0.2, -0.1, 0.1]), np.zeros(2)
    step = calibration._step(jacobian, now, point)
    assert objective(now + jacobian @ step, step) < objective(now, point)
    gradient = jacobian.T @ (now + jacobian @ step) + step / calibration.PRIOR**2
    assert np.abs(gradient).max() < 1e-12


def test_no_step_is_longer_than_allowed() -> None:
    step = calibration._step(np.eye(2) * 10, np.array([-50.0, 1.0]), np.zeros(2))
    assert np.abs(step).max() == pytest.approx(calibration.LONGEST_STEP)


def test_a_mechanism_that_is_switched_off_changes_the_number_it_carries() -> None:
    for switch in SWITCHES[:2]:
        whole = {row.metric: row.mean for row in calibration.measure(Constants(), 3, (switch.architecture,))}
        without = {row.metric: row.mean for row in calibration.measure(Constants(), 3, (switch.architecture,), switch)}
        for metric in switch.metrics:
            assert whole[metric] != without[metric]


def test_a_path_that_cannot_be_written_is_refused_before_the_work(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for out in (tmp_path / "file" / "record.json", tmp_path):
        with pytest.raises(WriteFailed, match="cannot be written"):
            calibrate(out)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.slow
def test_the_record_of_a_small_fit_is_complete_and_the_same_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {"RUNS": 1, "SLOPE_RUNS": 1, "ROUNDS": 1, "FITTED": FITTED[:2], "SWITCHES": SWITCHES[:2], "WorkerPool": ThreadPoolExecutor}.items():
        monkeypatch.setattr(calibration, name, value)
    told: list[tuple[int, int]] = []
    for name in ("one.json", "two.json"):
        calibrate(tmp_path / name, lambda done, total: told.append((done, total)), workers=1)
    assert (tmp_path / "one.json").read_bytes() == (tmp_path / "two.json").read_bytes()
    assert told[-1] == (8, 8)
    record = json.loads((tmp_path / "one.json").read_text())
    assert record["objective"]["accepted"] <= record["objective"]["start"]
    assert len(record["residuals"]) == 24
    assert [parameter["name"] for parameter in record["parameters"]] == [fitted.name for fitted in FITTED[:2]]
    assert len(record["switch_offs"]) == sum(len(switch.metrics) for switch in SWITCHES[:2])
