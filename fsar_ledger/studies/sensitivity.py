"""Run the study: screen all factors, take the dozen that matter most, and attribute the variance to them.

Every trajectory meets worlds of its own seed, the same at all its points, so the influence of the worlds on an effect
shows in the spread between trajectories. The polynomial uses one seed; all other factors are at their base there.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import msgspec
import numpy as np

from fsar_ledger.api.names import Place
from fsar_ledger.api.workload import workers_of
from fsar_ledger.base.errors import UsageError
from fsar_ledger.base.progress import Progress
from fsar_ledger.base.publishing import publish
from fsar_ledger.designs.constants import Constants, write_constants
from fsar_ledger.metrics.effects import About, Effect, Sensitivity, parquet, that_matter
from fsar_ledger.metrics.study_results import METRICS, rules
from fsar_ledger.metrics.verdicts import MARGINS
from fsar_ledger.runtime.simulation import MODEL_VERSION

from .evaluations import CELLS, Answers, Evaluate, Question, answer_all, evaluate
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
from .result import require_out

SEED = 20_270_001  # of the first trajectory, counting up; never used for a published number or a fit
BASE_SEED = SEED + 10_000  # of the repeats of the base, counting up
EMULATOR_SEED = SEED + 20_000
REPEATS = 10  # of the base in other worlds: they show what chance alone does
DOZEN = 12
DIGITS = 6  # written: the last bits of a sum differ between machines


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
    """The questions of a study, and the answers so far."""

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
        at = dict(zip(names, map(float, positions), strict=True))
        return Question(setting(self.factors, at), seed, self.size.runs)

    def screening(self) -> dict[str, Question]:
        """Return all questions before the dozen are known; equal settings are asked once."""
        return {question.key: question for question in (*self.bases, *(one for path in self.points for one in path))}

    def of_dozen(self, dozen: Sequence[str]) -> tuple[Matrix, list[Question]]:
        """Return the design of the polynomial, and its questions."""
        positions = design(self.size.points, dozen)
        return positions, [self._question(dozen, point, EMULATOR_SEED) for point in positions]

    def effects(self, found: Mapping[str, tuple[float | None, ...]]) -> list[Effect]:
        """Return the effect of each factor on each cell, in the order of the cells, without Sobol indices."""
        outputs = [_matrix(found, path) for path in self.points]
        bases = _matrix(found, self.bases)
        return [
            effect
            for cell in range(len(CELLS))
            for effect in self._of_cell(cell, [one[:, cell] for one in outputs], bases[:, cell])
        ]

    def _of_cell(self, cell: int, outputs: list[Vector], bases: Vector) -> Iterable[Effect]:
        metric, architecture = CELLS[cell]
        switches = [factor.is_switch for factor in self.factors]
        moves = np.array(
            [elementary_effects(path, values, switches) for path, values in zip(self.paths, outputs, strict=True)]
        )
        known = bases[~np.isnan(bases)]
        deviation = float(np.std(known, ddof=1)) if len(known) > 1 else None
        for number, factor in enumerate(self.factors):
            one = summary(moves[:, number])
            chance = None if deviation is None else by_chance(deviation, is_switch=factor.is_switch)
            lengths = {**msgspec.structs.asdict(one), "by_chance": chance}
            count = lengths.pop("count")
            margin = MARGINS[metric]
            yield Effect(
                metric=metric,
                architecture=architecture,
                factor=factor.name,
                origin=factor.origin,
                low=factor.shown(0.0),
                base=factor.shown(),
                high=factor.shown(1.0),
                base_mean=_rounded(float(np.mean(known)) if len(known) else None),
                margin=margin,
                effects=count,
                **{name: _rounded(length) for name, length in lengths.items()},
                **{
                    f"{name}_margins": _rounded(None if length is None else length / margin)
                    for name, length in lengths.items()
                },
                sobol_first=None,
                sobol_total=None,
                emulator_r2=None,
            )


def sensitivity(
    out: Place,
    *,
    trajectories: int = 20,
    runs: int = 10,
    points: int = 512,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Sensitivity:
    """Measure how much each number depends on each constant, and write the effects as Parquet.

    Takes most of an hour.

    Args:
        out: The file. An interrupted study continues from what is kept beside it.
        trajectories: How often each factor is moved.
        runs: Runs of each scenario and architecture in each evaluation.
        points: Evaluations for the Sobol indices; 0: only the screening.
        workers: Processes at once.
        progress: Called with the evaluations done and their total.

    Raises: As `study`.
    """
    return study(Path(out), Size(trajectories, runs, points), workers_of(workers), progress)


def study(
    out: Path,
    size: Size,
    workers: int = 1,
    progress: Progress | None = None,
    *,
    ask: Evaluate = evaluate,
    subject: tuple[Factor, ...] | None = None,
) -> Sensitivity:
    """Write the effects to the file, replacing it, and return them.

    This takes long; finished evaluations are kept in FILE.partial meanwhile.

    Args:
        out: The Parquet file.
        size: The size of the study.
        workers: Processes that evaluate.
        progress: Called with the number of evaluations made, and the number that there were to make.
        ask: Answers a question, in another process unless `workers` is 1.
        subject: The factors to vary; None: all.

    Raises:
        UsageError: The file does not end in .parquet, lies inside a ledger, or FILE.partial is of another version.
        WriteFailed: One of the files cannot be written.
        WorkerDied: A process was killed.
    """
    if out.suffix != ".parquet":
        raise UsageError(f"--out {out}: found a file name that ends in {out.suffix or 'nothing'!r}, expected .parquet")
    require_out(out)
    answers = Answers(out.with_name(out.name + ".partial"))
    try:
        found = _studied(_Study(size, subject or factors()), answers, ask, workers, progress)
    finally:
        answers.close()
    publish(out, parquet(found), advice="make room and call it again, which goes on from there")
    answers.finish()
    return found


def _studied(study: _Study, answers: Answers, ask: Evaluate, workers: int, progress: Progress | None) -> Sensitivity:
    screening = study.screening()
    open_ones = [key for key in screening if key not in answers.found]
    # What is kept beyond the screening are points of the polynomial, if an earlier study got that far.
    kept = len(answers.found) - (len(screening) - len(open_ones))
    total, made = len(open_ones) + max(0, study.size.points - kept), 0

    def told() -> None:
        nonlocal made
        made += 1
        if progress is not None:
            progress(made, max(total, made))

    answer_all(screening, answers, ask, workers, told)
    about = _about(study, len(screening))
    first = Sensitivity(about, tuple(study.effects(answers.found)))
    dozen = that_matter(first, DOZEN)
    positions, questions = study.of_dozen(dozen)
    answer_all({question.key: question for question in questions}, answers, ask, workers, told)
    chosen = [factor for name in dozen for factor in study.factors if factor.name == name]
    polynomial, outputs = (
        terms(chosen, positions) if chosen and len(questions) else None,
        _matrix(answers.found, questions),
    )
    parts = [
        Indices(None, None, None) if polynomial is None else indices(polynomial, outputs[:, cell], len(dozen))
        for cell in range(len(CELLS))
    ]
    effects = tuple(
        _with_indices(effect, parts[CELLS.index((effect.metric, effect.architecture))], dozen)
        for effect in first.effects
    )
    evaluations = len(screening.keys() | {question.key for question in questions})
    return Sensitivity(msgspec.structs.replace(about, dozen=dozen, evaluations=evaluations), effects)


def _about(study: _Study, evaluations: int) -> About:
    return About(
        model_version=MODEL_VERSION,
        parameters=write_constants(Constants()),
        fleet_size=4,
        seed=SEED,
        trajectories=study.size.trajectories,
        runs=study.size.runs,
        points=study.size.points,
        repeats=REPEATS,
        evaluations=evaluations,
        factors=tuple(study.names),
        dozen=(),
        rules=rules(METRICS),
    )


def _with_indices(effect: Effect, parts: Indices, dozen: tuple[str, ...]) -> Effect:
    if effect.factor not in dozen:
        return effect
    at = dozen.index(effect.factor)
    first, total = (None if one is None else _rounded(one[at]) for one in (parts.first, parts.total))
    return msgspec.structs.replace(effect, sobol_first=first, sobol_total=total, emulator_r2=_rounded(parts.r2))


def _matrix(found: Mapping[str, tuple[float | None, ...]], questions: Sequence[Question]) -> Matrix:
    """Return a row for each question, a column for each cell, NaN where it is undefined."""
    rows = [[math.nan if value is None else value for value in found[question.key]] for question in questions]
    return np.array(rows, dtype=np.float64).reshape(len(questions), len(CELLS))


def _rounded(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.{DIGITS}g}")
