"""Evaluate the simulator at many settings, and keep the answers in a file until the study is finished.

FILE.partial has a line for each finished evaluation, in any order. An interrupted study loses only what was running;
since answers are looked up by question, a finished study has the same result however often it was interrupted.
"""

import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor, as_completed
from contextlib import contextmanager
from functools import cache
from hashlib import sha256
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec

import fsar_ledger
from fsar_ledger.base.errors import UsageError, WriteFailed
from fsar_ledger.base.progress import Progress
from fsar_ledger.base.workers import WorkerPool, pool_of
from fsar_ledger.designs.constants import Constants, write_constants
from fsar_ledger.events.configuration import FULL, PAPER_ARCHITECTURES
from fsar_ledger.events.envelope import Architecture
from fsar_ledger.ledger.rows.codec import encode
from fsar_ledger.metrics.database import Database, connect, from_table
from fsar_ledger.metrics.results import MetricRow, measure_the_printed, metric_rows
from fsar_ledger.metrics.verdicts import MARGINS
from fsar_ledger.runtime.experiment import Experiment, run_experiment
from fsar_ledger.runtime.simulation import MODEL_VERSION, SCENARIOS, RunSpec, simulate_run

from .factor_effects import Vector
from .factors import Setting, constants_at
from .result import require_out

CELLS: tuple[tuple[str, str], ...] = tuple(
    (metric, architecture) for metric in MARGINS for architecture in PAPER_ARCHITECTURES
)
"""The 24 cells of the results table, in the order in which an evaluation answers them."""

Answer = tuple[float | None, ...]
"""The result of an evaluation: a number for each cell (unless a study evaluates others); None where undefined."""


class Question(msgspec.Struct, frozen=True):
    """What to evaluate: `runs` runs of each scenario and architecture at a setting, in the worlds of a seed."""

    setting: Setting
    seed: int
    runs: int

    @property
    def key(self) -> str:
        """Return a digest of everything that the answer depends on, except the program."""
        parts = (write_constants(self.setting.constants), self.setting.fleet_size, self.seed, self.runs)
        return sha256(msgspec.json.encode(parts)).hexdigest()[:32]


def question_at(point: Vector, seed: int, runs: int) -> Question:
    """Return the question for a point in the registered ranges, for a fleet of four."""
    return Question(Setting(constants_at(point), 4), seed, runs)


Evaluate = Callable[[Question], Answer]


def evaluate(question: Question) -> Answer:
    """Return the mean of each cell, measured by SQL; None where it is undefined."""
    setting = question.setting
    return means_of(measured(setting.constants, question.seed, question.runs, setting.fleet_size))


def measured(
    constants: Constants,
    seed: int,
    runs: int,
    fleet_size: int = 4,
    architectures: Sequence[Architecture] = PAPER_ARCHITECTURES,
) -> list[MetricRow]:
    """Return the metrics, computed in SQL, of `runs` runs of each scenario and architecture, all held in memory."""
    records = [
        simulate_run(RunSpec(seed, architecture, FULL, scenario, fleet_size, run), constants)
        for scenario in SCENARIOS
        for run in range(runs)
        for architecture in architectures
    ]
    with from_table(encode(records), threads=1) as database:
        measure_the_printed(database)
        return metric_rows(database)


def means_of(rows: Sequence[MetricRow]) -> Answer:
    """Return the mean of each cell among these rows of one setting."""
    means = {(row.metric, row.architecture): row.mean for row in rows}
    return tuple(means.get(cell) for cell in CELLS)


@contextmanager
def simulated(experiments: Iterable[Experiment], workers: int) -> Iterator[Database]:
    """Simulate experiments into a temporary ledger, for more runs than memory holds, and yield its database."""
    with TemporaryDirectory() as folder:
        ledger = Path(folder) / "ledger"
        with WorkerPool(workers) as pool:
            for experiment in experiments:
                run_experiment(ledger, experiment, pool)
        with connect(ledger) as database:
            yield database


class _Header(msgspec.Struct, frozen=True):
    """The first line: the program that answered."""

    package: str
    model_version: str
    program: str


PROGRAM = (
    ("fsar_ledger", "*.py"),
    ("fsar_ledger", "*.toml"),
    ("fsar_ledger.queries", "*.sql"),
    ("fsar_ledger.reports", "metrics.toml"),
)
"""The files on which an answer depends, besides its question."""


@cache
def _program() -> str:
    """Return a digest of all code, designs and queries: an answer of another program does not count."""
    digest = sha256()
    for package, pattern in PROGRAM:
        root = Path(str(files(package)))
        for path in sorted(root.rglob(pattern)):
            digest.update(f"{path.relative_to(root)}\0".encode() + path.read_bytes())
    return digest.hexdigest()[:32]


class _Line(msgspec.Struct, frozen=True):
    """One answer, and its seconds of CPU time."""

    key: str
    values: Answer
    cpu_s: float


class Evaluations:
    """The evaluations of one study; answers are kept beside its result. `evaluating` opens and closes them.

    Args:
        path: The file that keeps the answers.
        ask: Answers a question, in another process if there is a pool.
        pool: The processes that evaluate; None: this one.
        progress: Called with the number of evaluations made, and the number to make.
        width: How many numbers an answer has.
    """

    def __init__(self, path: Path, ask: Evaluate, pool: Executor | None, progress: Progress | None, width: int) -> None:
        """Load the answers in the file, without a last line cut by an interruption.

        Raises:
            UsageError: Another version wrote the file, or it is something else.
            WriteFailed: It cannot be read or written.
        """
        self._path, self._ask, self._pool, self._progress, self._width = path, ask, pool, progress, width
        self._kept: dict[str, _Line] = {}
        self._used: set[str] = set()
        self._made = 0
        self.expected = 0
        """The expected number of evaluations of the study."""
        header = _Header(fsar_ledger.__version__, MODEL_VERSION, _program())
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            content = path.read_bytes() if path.exists() else b""
            lines = content[: content.rfind(b"\n") + 1].splitlines()
            self._read(lines, header)
            self._file = path.open("ab")
            self._file.truncate(sum(len(line) + 1 for line in lines))
            if not lines:
                self._write(header)
        except OSError as error:
            raise WriteFailed(
                f"{path}: cannot be written ({error.strerror or error}); free space or give another --out"
            ) from error
        self._at_start = len(self._kept)

    def _read(self, lines: list[bytes], header: _Header) -> None:
        try:
            if lines and msgspec.json.decode(lines[0], type=_Header) != header:
                raise UsageError(
                    f"{self._path}: found evaluations of another program, expected those of this one; remove the file "
                    "to begin again"
                )
            for line in lines[1:]:
                answer = msgspec.json.decode(line, type=_Line)
                if len(answer.values) != self._width:
                    raise msgspec.ValidationError(f"{len(answer.values)} values")
                self._kept[answer.key] = answer
        except msgspec.MsgspecError as error:
            raise UsageError(
                f"{self._path}: found a line that is not an evaluation ({error}); "
                "remove the file, or give another --out"
            ) from error

    def _write(self, line: msgspec.Struct) -> None:
        self._file.write(msgspec.json.encode(line) + b"\n")
        self._file.flush()

    def _add(self, key: str, timed: tuple[Answer, float]) -> None:
        line = _Line(key, *timed)
        try:
            self._write(line)
        except OSError as error:
            raise WriteFailed(
                f"{self._path}: cannot be written ({error.strerror}); make room and run it again, to continue from "
                "there"
            ) from error
        self._kept[key] = line
        self._made += 1
        if self._progress is not None:
            left = self.expected - self._at_start
            self._progress(self._made, max(left, self._made))

    def answers(self, questions: Sequence[Question]) -> list[Answer]:
        """Return the answer to each question; equal ones, and those of an interrupted study, are evaluated once.

        Raises: WriteFailed, WorkerDied.
        """
        keys = [question.key for question in questions]
        waiting = {key: question for key, question in zip(keys, questions, strict=True) if key not in self._kept}
        if self._pool is None:
            for key, question in waiting.items():
                self._add(key, _timed(self._ask, question))
        else:
            futures = {self._pool.submit(_timed, self._ask, question): key for key, question in waiting.items()}
            for future in as_completed(futures):
                self._add(futures[future], future.result())
        self._used.update(keys)
        return [self._kept[key].values for key in keys]

    @property
    def count(self) -> int:
        """Return the number of evaluations that the study has used."""
        return len(self._used)

    @property
    def cpu_minutes(self) -> float:
        """Return the minutes of CPU time that they took, however often the study was interrupted."""
        return round(sum(self._kept[key].cpu_s for key in self._used) / 60, 1)

    def close(self) -> None:
        """Close the file; nothing more is written."""
        self._file.close()

    def finish(self) -> None:
        """Delete the file: its answers are in the result. Raises: WriteFailed."""
        self.close()
        try:
            os.unlink(self._path)
        except OSError as error:
            raise WriteFailed(
                f"{self._path}: cannot be removed ({error.strerror}); the result is complete, remove the file by hand"
            ) from error


def _timed(ask: Evaluate, question: Question) -> tuple[Answer, float]:
    """Return the answer, and its seconds of CPU time."""
    began_s = time.process_time()
    values = ask(question)
    return values, round(time.process_time() - began_s, 3)


@contextmanager
def evaluating(
    out: Path,
    workers: int,
    progress: Progress | None,
    ask: Evaluate,
    width: int = len(CELLS),
) -> Iterator[Evaluations]:
    """Check that the result can be written, and yield the evaluations of its study.

    They are kept beside it, in FILE.partial, until the caller exits without an error, having written the result.

    Raises:
        UsageError: The result lies inside a ledger, or FILE.partial is of another version or something else.
        WriteFailed: One of the files cannot be written.
    """
    require_out(out)
    with pool_of(workers) as pool:
        evaluations = Evaluations(out.with_name(out.name + ".partial"), ask, pool, progress, width)
        try:
            yield evaluations
        except BaseException:
            evaluations.close()
            raise
    evaluations.finish()
