"""Compares FSAR with itself under the name of another architecture: the negative control of the whole evaluation.

Runs are processed as in the paper's experiment: simulated, committed to a ledger, measured and compared by SQL. On the
same seeds nothing may differ. On other seeds the runs differ only in their worlds, so each test may reject only as
often as its level says; there, `run_pairs` is replaced, since it pairs only runs that met the same world.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from fsar_ledger.api.names import Place
from fsar_ledger.api.verbs import workers_of
from fsar_ledger.base.progress import Progress
from fsar_ledger.designs.constants import Constants
from fsar_ledger.events.configuration import FULL, PAPER_ARCHITECTURES
from fsar_ledger.events.envelope import Architecture
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.metrics.database import Database, connect
from fsar_ledger.metrics.definitions import published_metrics
from fsar_ledger.metrics.registration import registration
from fsar_ledger.metrics.results import statistic_rows
from fsar_ledger.metrics.robustness import Placebo, Rejections, wilson
from fsar_ledger.metrics.verdicts import ALPHA
from fsar_ledger.runtime.simulation import SCENARIOS, RunSpec, handler_table_of, simulate_run

from .evaluations import Answer, Evaluate, Question, evaluating
from .factors import Setting
from .result import RESUME_ADVICE, grounds, write

FSAR, OTHER_NAME = PAPER_ARCHITECTURES[:2]
COMPARISON = f"{FSAR}-{OTHER_NAME}"
METRICS = tuple(metric.name for metric in published_metrics())
TESTS = ("p", "p_holm", "wilcoxon_p", "mcnemar_p")
"""The columns of `statistics/pairwise_tests` that are counted; `p` is that of the paper's t-test."""
ANY = "any of the eight"
UNLIKE_PAIRS_SQL = f"""
    SELECT
        '{COMPARISON}' AS comparison, 'architectures' AS family, 'full' AS configuration, firsts.fleet_size,
        firsts.seed, firsts.scenario, firsts.run, firsts.setting, firsts.run_id AS first_run_id,
        seconds.run_id AS second_run_id, NULL::VARCHAR AS differs
    FROM compared_runs AS firsts
    INNER JOIN compared_runs AS seconds ON firsts.scenario = seconds.scenario AND firsts.run = seconds.run
    WHERE firsts.architecture = '{FSAR}' AND seconds.architecture = '{OTHER_NAME}'
"""


def placebo(
    out: Place, *, workers: int | None = None, progress: Progress | None = None, ask: Evaluate | None = None
) -> Placebo:
    """Repeat the comparison as often as registered, write the result and return it.

    An interrupted study continues from the answers kept beside it.

    Raises: As `evaluating`; WriteFailed, WorkerDied.
    """
    out, sample = Path(out), registration().placebo
    setting = Setting(Constants(), 4)
    with evaluating(out, workers_of(workers), progress, ask or p_values, len(METRICS) * len(TESTS)) as evaluations:
        evaluations.expected = sample.size
        answers = evaluations.answers(
            [Question(setting, sample.seed + 2 * number, sample.runs) for number in range(sample.size)]
        )
        pairs, largest = on_same_seeds(Question(setting, sample.seed, sample.runs))
        result = Placebo(
            **grounds(Placebo),
            sample=sample,
            cpu_minutes=evaluations.cpu_minutes,
            alpha=ALPHA,
            pairs=pairs,
            largest_difference=largest,
            tests=list(rejections(answers)),
        )
        write(out, result, RESUME_ADVICE)
    return result


def on_same_seeds(question: Question) -> tuple[int, float | None]:
    """Return how many pairs met the same world, and the largest mean difference over all metrics."""
    with committed(question, question.seed) as database:
        rows = [row for row in statistic_rows(database) if row.metric in METRICS]
    means = [
        difference
        for row in rows
        for difference in (row.mean_difference, row.pooled_difference)
        if difference is not None
    ]
    return min((row.n for row in rows), default=0), max(map(abs, means), default=None)


def p_values(question: Question) -> Answer:
    """Return the p of each metric and test between runs with this seed and runs with the next one."""
    with committed(question, question.seed + 1) as database:
        database.hold("run_pairs", database.table(UNLIKE_PAIRS_SQL))
        rows = {row.metric: row for row in statistic_rows(database)}
    return tuple(getattr(rows.get(metric), test, None) for metric in METRICS for test in TESTS)


@contextmanager
def committed(question: Question, other_seed: int, other_name: Architecture = OTHER_NAME) -> Iterator[Database]:
    """Commit FSAR with one seed, and FSAR under the other name with the other, to a ledger; yield its database."""
    with TemporaryDirectory() as folder:
        ledger = Path(folder) / "ledger"
        with Writer(ledger, "fsar-ledger/placebo") as writer:
            for scenario in SCENARIOS:
                writer.append(stage(ledger, list(_runs(question, other_seed, other_name, scenario))))
        with connect(ledger, threads=1) as database:
            yield database


def _runs(question: Question, other_seed: int, other_name: Architecture, scenario: str) -> Iterator[LedgerRun]:
    setting = question.setting
    for name, seed in ((FSAR, question.seed), (other_name, other_seed)):
        for run in range(question.runs):
            spec = RunSpec(seed, name, FULL, scenario, setting.fleet_size, run)
            yield simulate_run(spec, setting.constants, handler_table_of(FSAR))


def rejections(answers: Sequence[Answer]) -> Iterator[Rejections]:
    """Yield how often each test of each metric rejects, and how often Holm's rejects any; without tests never made."""
    for group, metric in enumerate(METRICS):
        for test, name in enumerate(TESTS):
            yield from _rejections(metric, name, [answer[group * len(TESTS) + test] for answer in answers])
    holm = TESTS.index("p_holm")
    smallest = [min((p for p in answer[holm :: len(TESTS)] if p is not None), default=None) for answer in answers]
    yield from _rejections(ANY, TESTS[holm], smallest)


def _rejections(metric: str, test: str, p_values: Sequence[float | None]) -> Iterator[Rejections]:
    known = [p for p in p_values if p is not None]
    rejected = sum(p < ALPHA for p in known)
    share = wilson(rejected, len(known)).rounded()
    if known:
        yield Rejections(
            metric=metric,
            test=test,
            rejected=rejected,
            kept=len(known) - rejected,
            undefined=len(p_values) - len(known),
            share=share.share,
            low=share.low,
            high=share.high,
        )
