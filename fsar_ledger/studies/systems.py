"""Runs every architecture in the same worlds: at several fleet sizes, over each of its dials, in other worlds.

Nothing is fitted, and no result decides a dial: `designs/dials.py` is frozen by a commit before the first of these runs
is counted (`python -m tests.history`). Paper: tab:baseline_context.
"""

from collections.abc import Iterator, Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Literal

import msgspec

from fsar_ledger.api.names import Place
from fsar_ledger.api.verbs import workers_of
from fsar_ledger.base.progress import Progress
from fsar_ledger.designs.constants import Constants, write_constants
from fsar_ledger.designs.dials import TRIED
from fsar_ledger.events.configuration import ARCHITECTURES
from fsar_ledger.metrics.definitions import features, metrics
from fsar_ledger.metrics.registration import registration
from fsar_ledger.metrics.results import metric_rows, take_seeds_together
from fsar_ledger.metrics.robustness import HeldRank, NamedShares, SystemGrade, SystemNumber, Systems
from fsar_ledger.runtime.experiment import Experiment
from fsar_ledger.runtime.own import with_values
from fsar_ledger.runtime.simulation import SCENARIOS

from .evaluations import Answer, Evaluate, Question, evaluating, simulated
from .factors import Setting, factors, setting
from .result import RESUME_ADVICE, grounds, write

SEEDS = registration().verdicts.seeds
"""The seeds of the verdicts: at four robots, the numbers of the paper's three equal those of the report's tables."""
RUNS = {4: 50, 8: 20, 16: 10}
"""Runs of each scenario and seed, by fleet size."""
DIAL_SIZES = {"alliance.stagger_us": tuple(RUNS)}
"""Fleet sizes at which a dial is tried; other dials are tried with four robots."""
MOVED_RUNS = 20
"""Runs of each scenario where a constant is moved."""
METRICS = tuple(metric.name for metric in metrics())
FEATURES = features()
GRADES = ("none", "partial", "full")
FIELDS = ("origin", "executor", "supervisor")
OF_METRIC = ("n", "mean", "ci_low", "ci_high", "sd")
WIDTH = len(METRICS) * len(OF_METRIC) + len(FEATURES) + len(FIELDS)
NAMED_SQL = f"""
    SELECT {", ".join(f"avg({field}_is_named::INTEGER) AS {field}" for field in FIELDS)} FROM true_principals
"""


class SystemQuestion(Question, frozen=True):
    """What to evaluate of one architecture, over several seeds."""

    architecture: str
    seeds: tuple[int, ...]

    @property
    def key(self) -> str:
        """Return a digest of everything that the answer depends on, except the program."""
        setting = self.setting
        parts = (write_constants(setting.constants), setting.fleet_size, self.seeds, self.runs, self.architecture)
        return sha256(msgspec.json.encode(parts)).hexdigest()[:32]


class Trial(msgspec.Struct, frozen=True):
    """One trial: an architecture at a fleet size, or with one of its dials at a value."""

    architecture: str
    fleet_size: int
    dial: str | None = None
    value: int | None = None

    @property
    def question(self) -> SystemQuestion:
        """Return the question to evaluate."""
        constants = Constants() if self.dial is None else with_values(Constants(), {self.dial: self.value})
        seeds = SEEDS if self.dial is None else SEEDS[:1]
        runs = RUNS[self.fleet_size]
        return SystemQuestion(Setting(constants, self.fleet_size), seeds[0], runs, self.architecture, seeds)


class MovedConstant(msgspec.Struct, frozen=True):
    """A constant, the load or the fleet size at an end of its range, everything else at its base."""

    name: str
    setting: Setting

    def question(self, architecture: str) -> SystemQuestion:
        """Return the question to evaluate for one architecture."""
        return SystemQuestion(self.setting, SEEDS[0], MOVED_RUNS, architecture, SEEDS[:1])


def trials() -> list[Trial]:
    """Return every architecture at every size, and every value of every dial."""
    sizes = [Trial(architecture, size) for size in RUNS for architecture in ARCHITECTURES]
    return sizes + [
        Trial(name.partition(".")[0], size, name, value)
        for name, values in TRIED.items()
        for size in DIAL_SIZES.get(name, (4,))
        for value in values
    ]


def moved_constants() -> list[MovedConstant]:
    """Return each factor of the sensitivity at either end of its range, except where that is the base."""
    every_factor = factors()
    base = setting(every_factor, {})
    return [
        moved
        for factor in every_factor
        for position in (0.0, 1.0)
        if (
            moved := MovedConstant(
                f"{factor.name}={factor.value_text(position)}", setting(every_factor, {factor.name: position})
            )
        )
        and moved.setting != base
    ]


def systems(
    out: Place, *, workers: int | None = None, progress: Progress | None = None, ask: Evaluate | None = None
) -> Systems:
    """Run all trials, write the result and return it. An interrupted study continues from the answers kept beside it.

    Raises: As `evaluating`; WriteFailed, WorkerDied.
    """
    out, tried, moved = Path(out), trials(), moved_constants()
    elsewhere = {name: [constant.question(name) for constant in moved] for name in ARCHITECTURES}
    with evaluating(out, workers_of(workers), progress, ask or answer, WIDTH) as evaluations:
        questions = [trial.question for trial in tried]
        evaluations.expected = len({question.key for group in (questions, *elsewhere.values()) for question in group})
        answers = evaluations.answers(questions)
        ranked = {name: evaluations.answers(group) for name, group in elsewhere.items()}
        declared = dict(zip((trial.architecture for trial in tried), answers[: len(ARCHITECTURES)], strict=False))
        result = Systems(
            **grounds(Systems),
            seeds=SEEDS,
            runs={str(size): runs for size, runs in RUNS.items()},
            cpu_minutes=evaluations.cpu_minutes,
            numbers=[
                number for trial, values in zip(tried, answers, strict=True) for number in _numbers(trial, values)
            ],
            grades=[grade for name, values in declared.items() for grade in _grades(name, values)],
            named=[_named_shares(name, values) for name, values in declared.items()],
            moved_runs=MOVED_RUNS,
            held=list(held_ranks([constant.name for constant in moved], ranked)),
        )
        write(out, result, RESUME_ADVICE)
    return result


def answer(question: Question) -> Answer:
    """Return the metrics, the grades and the shares of names of one architecture, over all seeds."""
    assert isinstance(question, SystemQuestion)
    setting, subject = question.setting, (question.architecture,)
    experiments = [
        Experiment(subject, SCENARIOS, question.runs, seed, setting.fleet_size, constants=setting.constants)
        for seed in question.seeds
    ]
    with simulated(experiments, 1) as database:
        take_seeds_together(database)
        rows = {row.metric: row for row in metric_rows(database)}
        measured = [getattr(rows[name], column) for name in METRICS for column in OF_METRIC]
        shown_grades = {row["feature"]: row["grade"] for row in database.rows("SELECT * FROM architecture_features")}
        [named] = database.rows(NAMED_SQL)
    grades = [None if (grade := shown_grades[feature]) is None else float(GRADES.index(grade)) for feature in FEATURES]
    return (*measured, *grades, *(named[field] for field in FIELDS))


def _numbers(trial: Trial, values: Answer) -> Iterator[SystemNumber]:
    for position, metric in enumerate(METRICS):
        n, mean, low, high, sd = values[position * len(OF_METRIC) : (position + 1) * len(OF_METRIC)]
        yield SystemNumber(
            **msgspec.structs.asdict(trial), metric=metric, n=int(n or 0), mean=mean, low=low, high=high, sd=sd
        )


def held_ranks(moved: Sequence[str], answers: Mapping[str, Sequence[Answer]]) -> Iterator[HeldRank]:
    """Yield how FSAR compares with each other architecture by each metric, from the answers in these settings."""
    for other in [name for name in answers if name != "fsar"]:
        for position, metric in enumerate(METRICS):
            sides = {
                name: _side(ours, theirs, position * len(OF_METRIC))
                for name, ours, theirs in zip(moved, answers["fsar"], answers[other], strict=True)
            }
            higher, lower = (
                tuple(name for name, side in sides.items() if side == wanted) for wanted in ("higher", "lower")
            )
            yield HeldRank(
                architecture=other,
                metric=metric,
                settings=sum(side is not None for side in sides.values()),
                higher=len(higher),
                lower=len(lower),
                against=min(higher, lower, key=len),
            )


def _side(ours: Answer, theirs: Answer, offset: int) -> Literal["higher", "lower", "alike"] | None:
    """Return on which side of the other's interval ours lies; None where one of them is undefined."""
    low, high = offset + OF_METRIC.index("ci_low"), offset + OF_METRIC.index("ci_high")
    our_low, our_high, their_low, their_high = ours[low], ours[high], theirs[low], theirs[high]
    if our_low is None or our_high is None or their_low is None or their_high is None:
        return None
    return "higher" if our_low > their_high else "lower" if our_high < their_low else "alike"


def _grades(architecture: str, values: Sequence[float | None]) -> Iterator[SystemGrade]:
    numbers = values[len(METRICS) * len(OF_METRIC) :][: len(FEATURES)]
    for feature, grade in zip(FEATURES, numbers, strict=True):
        yield SystemGrade(
            architecture=architecture, feature=feature, grade=None if grade is None else GRADES[int(grade)]
        )


def _named_shares(architecture: str, values: Sequence[float | None]) -> NamedShares:
    return NamedShares(architecture=architecture, **dict(zip(FIELDS, values[-len(FIELDS) :], strict=True)))
