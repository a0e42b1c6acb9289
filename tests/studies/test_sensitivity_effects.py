"""Every constant is varied within its range, and effects and indices are as defined."""

import json
import math
from pathlib import Path

import msgspec
import numpy as np
import pytest

from fsar_ledger.designs.constants import Constants, negatives, origins
from fsar_ledger.events.configuration import PAPER_ARCHITECTURES
from fsar_ledger.runtime.experiment import Experiment
from fsar_ledger.runtime.simulation import SCENARIOS
from fsar_ledger.studies.factor_effects import (
    DELTA,
    Trajectory,
    design,
    elementary_effects,
    indices,
    summary,
    terms,
    trajectory,
)
from fsar_ledger.studies.factors import Factor, Setting, factors, setting
from tests.studies.conftest import NAMES, SOME

SALIB = json.loads((Path(__file__).parents[1] / "vectors" / "salib" / "polynomial.json").read_text())


def test_every_number_of_the_world_and_the_structure_is_a_factor_and_load_and_size_too() -> None:
    own = Constants()
    groups = {name for name in own.__struct_fields__ if getattr(own, name) is not None} | {"load"}
    expected = [name for name, word in origins().items() if word != "dial" and name.partition(".")[0] in groups]
    assert sorted(factor.name for factor in factors()) == sorted([*expected, "fleet.size"])
    assert {factor.origin for factor in factors()} == {"paper", "fitted", "chosen after fits", "chosen"}


def test_moving_no_factor_gives_the_package_s_own_world() -> None:
    assert setting(factors(), {}) == Setting(Constants(), 4)


def test_what_is_moved_changes_and_nothing_else() -> None:
    for factor in factors():
        low, high = (setting(factors(), {factor.name: position}) for position in (0.0, 1.0))
        if factor.name in ("load.teams_working", "load.interval_s"):
            assert low == high == Setting(Constants(), 4)  # one team, one set: nothing to tell apart
            continue
        changed = msgspec.to_builtins(low), msgspec.to_builtins(high)
        assert changed[0] != changed[1]
        part, _, name = factor.name.partition(".")
        if part == "fleet":
            assert (low.fleet_size, high.fleet_size) == (4, 8)
            assert low.constants == high.constants
        elif part != "load":
            for one in changed:
                one["constants"][part].pop(name.partition(".")[0])
            assert changed[0] == changed[1]


def test_lengths_are_halved_to_doubled_shares_stay_shares_and_counts_whole() -> None:
    at = {factor.name: (factor.value_at(0.0), factor.value_at(1.0)) for factor in factors()}
    assert at["world.window_mean_s"] == (Constants().world.window_mean_s / 2, Constants().world.window_mean_s * 2)
    assert at["world.degraded_reliability"] == (0.428571, 0.75)
    assert at["structure.local_attempts"] == (1, 4)
    assert at["structure.peer_helpers"] == (1, 2)
    for factor in factors():
        for position in (0.0, 1 / 3, 0.5, 2 / 3, 1.0):
            value = factor.value_at(position)
            if factor.kind == "share":
                assert 0 < value < (1 if isinstance(factor.value, float) else 1_000_000)
            if factor.kind == "count":
                assert isinstance(value, int)
                assert value >= 1


def test_the_name_of_a_constant_says_whether_it_is_a_share_or_a_count() -> None:
    """Otherwise a new one would be scaled out of its range unnoticed."""
    for factor in factors():
        if factor.name.endswith(("_share", "_probability", "_reliability")):
            assert factor.kind == "share"
        if (
            factor.name.startswith(("world.", "structure."))
            and isinstance(factor.value, int)
            and not factor.name.endswith(("_us", "_ppm"))
        ):
            assert factor.kind == "count"


@pytest.mark.parametrize("end", [0.0, 1.0])
def test_runs_take_the_constants_at_the_ends_of_all_ranges(end: float) -> None:
    for names in ([factor.name for factor in factors()], *([factor.name] for factor in factors())):
        at = setting(factors(), dict.fromkeys(names, end))
        assert negatives(at.constants) == []
        Experiment(PAPER_ARCHITECTURES, SCENARIOS, 1, 1, at.fleet_size, constants=at.constants)


def test_effects_and_indices_are_those_of_salib() -> None:
    """The numbers are those of SALib 1.6.0; `what` in the file says how they were made."""
    points, outputs = np.array(SALIB["points"]) / 3, np.array(SALIB["outputs"])
    steps = points.shape[1] + 1
    moves = []
    for start in range(0, len(points), steps):
        path = points[start : start + steps]
        order = tuple(int(np.flatnonzero(path[step] != path[step + 1])[0]) for step in range(steps - 1))
        moves.append(elementary_effects(Trajectory(path, order), outputs[start : start + steps], [False] * 6))
    ours = [summary(np.array(moves)[:, factor]) for factor in range(6)]
    for name in ("mu", "mu_star", "sigma"):
        assert [getattr(one, name) for one in ours] == pytest.approx(SALIB[name], abs=1e-12)
    assert [one.mu_star_conf for one in ours] == pytest.approx(SALIB["mu_star_conf"], rel=0.01)  # drawn by SALib

    subject = [Factor(name, "scaled", 1.0, "chosen") for name in "abcd"] + [
        SOME[-1],
        Factor("f", "scaled", 1.0, "chosen"),
    ]
    positions = design(256, [factor.name for factor in subject])
    a, b, c, d, e, _ = positions.T
    parts = indices(terms(subject, positions), 3 * a - 2 * b**2 + 4 * c * d + np.where(e >= 0.5, 1.5, 0.0) * a, 6)
    assert parts.r2 == pytest.approx(1)
    assert parts.first == pytest.approx(SALIB["first"], abs=2e-3)
    assert parts.total == pytest.approx(SALIB["total"], abs=2e-3)


def test_a_trajectory_moves_each_factor_once_by_one_step() -> None:
    path = trajectory(3, NAMES)
    assert sorted(path.moved) == [0, 1, 2, 3, 4]
    for step, factor in enumerate(path.moved):
        moved = path.points[step + 1] - path.points[step]
        assert np.abs(moved[factor]) == pytest.approx(DELTA)
        assert np.count_nonzero(moved) == 1
    assert set(np.round(path.points.ravel() * 3, 9)) <= {0, 1, 2, 3}
    assert {tuple(trajectory(number, NAMES).points[0]) for number in range(20)} != {tuple(path.points[0])}


def test_a_cell_that_is_undefined_somewhere_hides_the_effects_beside_it_and_no_other() -> None:
    path = trajectory(0, NAMES)
    outputs = path.points[:, 0].copy()
    outputs[2] = math.nan
    effects = elementary_effects(path, outputs, [False] * 5)
    assert {path.moved.index(factor) for factor in np.flatnonzero(np.isnan(effects))} == {1, 2}
    known = summary(np.array([1.0, math.nan, -3.0]))
    assert (known.count, known.mu, known.mu_star) == (2, -1.0, 2.0)
    assert summary(np.array([1.0, math.nan])).mu_star is None


def test_no_index_is_given_where_the_polynomial_says_too_little() -> None:
    positions = design(64, NAMES)
    polynomial = terms(SOME, positions)
    noise = np.array([hash((index, 7919)) % 1009 for index in range(64)], dtype=np.float64)
    poor = indices(polynomial, noise, 5)
    assert poor.r2 is not None
    assert poor.r2 < 0.8
    assert poor.first is None
    for outputs in (np.zeros(64), np.where(np.arange(64) == 5, math.nan, positions[:, 0])):
        assert indices(polynomial, outputs, 5) == indices(terms(SOME, positions[:10]), positions[:10, 0], 5)
