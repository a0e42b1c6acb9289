"""Run the study: screen all factors, choose the dozen that matter most, and attribute the variance to them.

Every trajectory has worlds of its own seed, the same at all its points, so the influence of the worlds on an effect
shows in the spread between trajectories. The polynomial uses one seed; all other factors are at their base there.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from fsar_ledger.api.names import Place
from fsar_ledger.api.verbs import workers_of
from fsar_ledger.base.errors import UsageError
from fsar_ledger.base.progress import Progress
from fsar_ledger.metrics.effects import Sensitivity, VariedCell, VariedFactor, that_matter
from fsar_ledger.metrics.verdicts import MARGINS

from .evaluations import CELLS, Answer, Evaluate, Evaluations, Question, evaluate, evaluating
from .factor_effects import (
    Indices,
    Matrix,
    Vector,
    by_chance,
    design,
    elementary_effects,
    indices,
    summary,
    terms,
    trajectory,
)
from .factors import Factor, factors, setting
from .result import RESUME_ADVICE, grounds, write

SEED = 20_270_001  # of the first trajectory, counting up; never used for a published number or a fit
BASE_SEED = SEED + 10_000  # of the repeats of the base, counting up
EMULATOR_SEED = SEED + 20_000
REPEATS = 10  # of the base in other worlds: they show the effect of chance alone
DOZEN = 12
DIGITS = 4  # written: more are meaningless, and the last bits of a sum differ between machines


class Size(msgspec.Struct, frozen=True):
    """The size of a study: trajectories, runs per scenario and architecture at each point, points for the polynomial.

    With 0 points there are no Sobol indices.
    """

    trajectories: int
    runs: int
    points: int

    def __post_init__(self) -> None:
        for name, least, most in (("trajectories", 2, 9_999), ("runs", 1, 9_999), ("points", 0, 1 << 16)):
            if not least <= getattr(self, name) <= most:
                raise UsageError(f"--{name} {getattr(self, name)}: expected {least} to {most}")


class _Study:
    """The questions of a study, and the evaluation of their answers."""

    def __init__(self, size: Size, subject: tuple[Factor, ...]) -> None:
        self.size, self.factors = size, subject
        self.names = [factor.name for factor in subject]
        self.paths = [trajectory(number, self.names) for number in range(size.trajectories)]
        self.points = [
            [self._question(self.names, point, SEED + number) for point in path.points]
            for number, path in enumerate(self.paths)
        ]
        self.bases = [self._question([], np.zeros(0), BASE_SEED + number) for number in range(REPEATS)]

    def _question(self, names: Sequence[str], positions: Vector, seed: int) -> Question:
        position_of = dict(zip(names, map(float, positions), strict=True))
        return Question(setting(self.factors, position_of), seed, self.size.runs)

    def screening(self) -> list[Question]:
        """Return all questions asked before the dozen is chosen."""
        return [*self.bases, *(question for path in self.points for question in path)]

    def of_dozen(self, dozen: Sequence[str]) -> tuple[Matrix, list[Question]]:
        """Return the design of the polynomial, and its questions."""
        positions = design(self.size.points, dozen)
        return positions, [self._question(dozen, point, EMULATOR_SEED) for point in positions]

    def result(self, screened: Sequence[Answer], evaluations: Evaluations) -> Sensitivity:
        """Return the effect of each factor on each cell, without Sobol indices."""
        bases = _matrix(screened[:REPEATS])
        outputs = _matrix(screened[REPEATS:]).reshape(self.size.trajectories, -1, len(CELLS))
        switches = [factor.is_switch for factor in self.factors]
        moves = np.array(
            [
                [elementary_effects(path, values, switches) for values in of_path.T]
                for path, of_path in zip(self.paths, outputs, strict=True)
            ]
        )
        return Sensitivity(
            **grounds(Sensitivity),
            fleet_size=4,
            seed=SEED,
            trajectories=self.size.trajectories,
            runs=self.size.runs,
            points=self.size.points,
            repeats=REPEATS,
            evaluations=evaluations.count,
            cpu_minutes=evaluations.cpu_minutes,
            dozen=(),
            cells=tuple(_cell(cell, bases[:, cell]) for cell in range(len(CELLS))),
            factors=tuple(_factor(factor, moves[:, :, number]) for number, factor in enumerate(self.factors)),
        )


def _cell(cell: int, bases: Vector) -> VariedCell:
    metric, architecture = CELLS[cell]
    known = bases[~np.isnan(bases)]
    deviation = float(np.std(known, ddof=1)) if len(known) > 1 else None
    chances = [None if deviation is None else by_chance(deviation, is_switch=is_switch) for is_switch in (False, True)]
    return VariedCell(
        metric=metric,
        architecture=architecture,
        margin=MARGINS[metric],
        base_mean=_rounded(float(np.mean(known)) if len(known) else None),
        by_chance=_rounded(chances[0]),
        by_chance_of_switch=_rounded(chances[1]),
        emulator_r2=None,
    )


def _factor(factor: Factor, moves: Matrix) -> VariedFactor:
    """Return the effects of a factor, from its effect on each trajectory (row) and cell (column)."""
    of_cells = [summary(of_cell) for of_cell in moves.T]
    numbers: dict[str, Any] = {
        name: tuple(_rounded(getattr(effects, name)) for effects in of_cells)
        for name in ("mu", "mu_star", "sigma", "mu_star_conf")
    }
    return VariedFactor(
        name=factor.name,
        origin=factor.origin,
        low=factor.value_text(0.0),
        base=factor.value_text(),
        high=factor.value_text(1.0),
        is_switch=factor.is_switch,
        effects=tuple(effects.count for effects in of_cells),
        **numbers,
    )


def sensitivity(
    out: Place,
    *,
    trajectories: int = 20,
    runs: int = 10,
    points: int = 512,
    workers: int | None = None,
    progress: Progress | None = None,
    ask: Evaluate = evaluate,
    subject: tuple[Factor, ...] | None = None,
) -> Sensitivity:
    """Measure how much each number depends on each constant, write the result and return it.

    Takes most of an hour. An interrupted study continues from the answers kept beside it.

    Args:
        out: The file.
        trajectories: How often each factor is moved.
        runs: Runs of each scenario and architecture in each evaluation.
        points: Evaluations for the Sobol indices; 0: only the screening.
        workers: Processes at once.
        progress: Called with the evaluations done and their total.
        ask: Answers a question, in another process unless `workers` is 1.
        subject: The factors to vary; None: all.

    Raises:
        UsageError: A size is out of its range; or as `evaluating`.
        WriteFailed, WorkerDied: As `evaluating`.
    """
    out, study = Path(out), _Study(Size(trajectories, runs, points), subject or factors())
    with evaluating(out, workers_of(workers), progress, ask) as evaluations:
        screening = study.screening()
        evaluations.expected = len({question.key for question in screening}) + points
        first = study.result(evaluations.answers(screening), evaluations)
        dozen = that_matter(first, DOZEN)
        positions, questions = study.of_dozen(dozen)
        outputs = _matrix(evaluations.answers(questions))
        chosen = [factor for name in dozen for factor in study.factors if factor.name == name]
        parts = [Indices(None, None, None)] * len(CELLS)
        if chosen and questions:
            polynomial = terms(chosen, positions)
            parts = [indices(polynomial, outputs[:, cell], len(dozen)) for cell in range(len(CELLS))]
        result = msgspec.structs.replace(
            _with_indices(first, parts, dozen),
            dozen=dozen,
            evaluations=evaluations.count,
            cpu_minutes=evaluations.cpu_minutes,
        )
        write(out, result, RESUME_ADVICE)
    return result


def _with_indices(result: Sensitivity, parts: Sequence[Indices], dozen: tuple[str, ...]) -> Sensitivity:
    replace = msgspec.structs.replace
    varied = {factor.name: factor for factor in result.factors}
    for position, name in enumerate(dozen):
        varied[name] = replace(
            varied[name],
            sobol_first=tuple(None if part.first is None else _rounded(part.first[position]) for part in parts),
            sobol_total=tuple(None if part.total is None else _rounded(part.total[position]) for part in parts),
        )
    cells = [replace(cell, emulator_r2=_rounded(part.r2)) for cell, part in zip(result.cells, parts, strict=True)]
    return replace(result, cells=tuple(cells), factors=tuple(varied.values()))


def _matrix(answers: Sequence[Answer]) -> Matrix:
    """Return a matrix with a row per answer and a column per cell, NaN where undefined."""
    rows = [[math.nan if value is None else value for value in answer] for answer in answers]
    return np.array(rows, dtype=np.float64).reshape(len(answers), len(CELLS))


def _rounded(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.{DIGITS}g}")
