"""A study of a linear world with known effects."""

import math
from pathlib import Path
from typing import Any

import pytest

from fsar_ledger.designs.constants import Constants
from fsar_ledger.metrics.effects import Sensitivity
from fsar_ledger.metrics.study_results import read
from fsar_ledger.studies.evaluations import CELLS, Answer, Question
from fsar_ledger.studies.factors import factors
from fsar_ledger.studies.sensitivity import sensitivity

NAMES = (
    "world.message",
    "world.window_mean_s",
    "world.context_rate_per_s",
    "structure.sync_period_us",
    "load.task_sets",
)
SOME = tuple(factor for name in NAMES for factor in factors() if factor.name == name)
SMALL = {"trajectories": 4, "runs": 1, "points": 64, "workers": 1}


def doublings(value: float, base: float) -> float:
    return math.log2(value / base)


def linear(question: Question) -> Answer:
    """Return the numbers of a linear world.

    Two lengths move all cells, a rate adds what differs between seeds, task sets add one set's share, and the period
    adds nothing.
    """
    world, load = question.setting.constants.world, question.setting.constants.load
    value = 3 * doublings(world.message.high_s, 0.5) - doublings(world.window_mean_s, Constants().world.window_mean_s)
    sets = 1 if load is None else load.task_sets
    value += 0.25 * (sets - 1) + 0.125 * (question.seed % 3) * doublings(
        world.context_rate_per_s, Constants().world.context_rate_per_s
    )
    return (None, *[value] * (len(CELLS) - 1))


def study(out: Path, **changes: Any) -> Sensitivity:
    return sensitivity(out, **{**SMALL, "ask": linear, "subject": SOME, **changes})


@pytest.fixture(scope="session")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("sensitivity") / "effects.json"
    study(path)
    return path


@pytest.fixture(scope="session")
def found(file: Path) -> Sensitivity:
    return read(file, Sensitivity)
