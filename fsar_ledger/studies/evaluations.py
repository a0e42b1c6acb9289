"""Evaluate the simulator at a setting, and keep the answers in a file until the study is finished.

FILE.partial has a line for each finished evaluation, in any order. An interrupted study loses only what was running;
and since answers are looked up by their question, a finished study has the same bytes however often it was interrupted.
"""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import as_completed
from contextlib import contextmanager
from functools import cache
from hashlib import sha256
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec

import fsar_ledger
from fsar_ledger.base.errors import UsageError, WriteFailed
from fsar_ledger.base.workers import WorkerPool
from fsar_ledger.designs.constants import Constants, write_constants
from fsar_ledger.events.configuration import FULL
from fsar_ledger.events.envelope import Architecture
from fsar_ledger.ledger.rows.codec import encode
from fsar_ledger.metrics.database import Database, connect, from_table
from fsar_ledger.metrics.results import MetricRow, metric_rows
from fsar_ledger.metrics.verdicts import MARGINS
from fsar_ledger.runtime.experiment import Experiment, run_experiment
from fsar_ledger.runtime.simulation import ARCHITECTURES, MODEL_VERSION, SCENARIOS, RunSpec, simulate_run

from .factors import Setting

CELLS: tuple[tuple[str, str], ...] = tuple(
    (metric, architecture) for metric in MARGINS for architecture in ARCHITECTURES
)
"""The 24 cells of the results table, in the order in which an evaluation answers them."""

Answer = tuple[float | None, ...]


class Question(msgspec.Struct, frozen=True):
    """An evaluation: so many runs of each scenario and architecture at a setting, in the worlds of a seed."""

    setting: Setting
    seed: int
    runs: int

    @property
    def key(self) -> str:
        """Return a digest of everything that the answer depends on, except the program."""
        parts = (write_constants(self.setting.constants), self.setting.fleet_size, self.seed, self.runs)
        return sha256(msgspec.json.encode(parts)).hexdigest()[:32]


Evaluate = Callable[[Question], Answer]


def evaluate(question: Question) -> Answer:
    """Return the mean of each cell, measured by SQL; None where it is undefined."""
    setting = question.setting
    rows = measured(setting.constants, question.seed, question.runs, setting.fleet_size)
    means = {(row.metric, row.architecture): row.mean for row in rows}
    return tuple(means.get(cell) for cell in CELLS)


def measured(
    constants: Constants,
    seed: int,
    runs: int,
    fleet_size: int = 4,
    architectures: Sequence[Architecture] = ARCHITECTURES,
) -> list[MetricRow]:
    """Return the metrics, computed in SQL, of so many runs of each scenario and architecture, with all in memory."""
    records = [
        simulate_run(RunSpec(seed, architecture, FULL, scenario, fleet_size, run), constants)
        for scenario in SCENARIOS
        for run in range(runs)
        for architecture in architectures
    ]
    with from_table(encode(records), threads=1) as database:
        return metric_rows(database)


@contextmanager
def simulated(experiment: Experiment, workers: int) -> Iterator[Database]:
    """Simulate an experiment into a temporary ledger, for more runs than memory holds, and yield its database."""
    with TemporaryDirectory() as folder:
        ledger = Path(folder) / "ledger"
        run_experiment(ledger, experiment, workers)
        with connect(ledger) as database:
            yield database


class _Header(msgspec.Struct, frozen=True):
    """The first line: which program answered."""

    package: str
    model_version: str
    program: str


@cache
def _program() -> str:
    """Return a digest of all code and queries: an answer of another program does not count."""
    digest = sha256()
    for package, kind in (("fsar_ledger", "py"), ("fsar_ledger.queries", "sql")):
        root = Path(str(files(package)))
        for path in sorted(root.rglob(f"*.{kind}")):
            digest.update(f"{path.relative_to(root)}\0".encode() + path.read_bytes())
    return digest.hexdigest()[:32]


class _Line(msgspec.Struct, frozen=True):
    """One answer."""

    key: str
    values: Answer


class Answers:
    """All answers so far, and the file that keeps them."""

    def __init__(self, path: Path) -> None:
        """Load the answers in the file, without a last line that an interruption cut.

        Raises:
            UsageError: Another version wrote the file, or it is something else.
            WriteFailed: It cannot be read or written.
        """
        self._path = path
        self.found: dict[str, Answer] = {}
        header = _Header(fsar_ledger.__version__, MODEL_VERSION, _program())
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            whole = path.read_bytes() if path.exists() else b""
            lines = whole[: whole.rfind(b"\n") + 1].splitlines()
            self._read(lines, header)
            self._file = path.open("ab")
            self._file.truncate(sum(len(line) + 1 for line in lines))
            if not lines:
                self._write(header)
        except OSError as error:
            raise WriteFailed(
                f"{path}: cannot be written ({error.strerror or error}); free space or give another --out"
            ) from error

    def _read(self, lines: list[bytes], header: _Header) -> None:
        try:
            if lines and msgspec.json.decode(lines[0], type=_Header) != header:
                raise UsageError(
                    f"{self._path}: found evaluations of another program, expected those of this one; remove the file "
                    "to begin again"
                )
            for line in lines[1:]:
                one = msgspec.json.decode(line, type=_Line)
                if len(one.values) != len(CELLS):
                    raise msgspec.ValidationError(f"{len(one.values)} values")
                self.found[one.key] = one.values
        except msgspec.MsgspecError as error:
            raise UsageError(
                f"{self._path}: found a line that is no evaluation ({error}); remove the file, or give another --out"
            ) from error

    def _write(self, line: msgspec.Struct) -> None:
        self._file.write(msgspec.json.encode(line) + b"\n")
        self._file.flush()

    def add(self, key: str, values: Answer) -> None:
        """Add an answer and write it. Raises: WriteFailed."""
        try:
            self._write(_Line(key, values))
        except OSError as error:
            raise WriteFailed(
                f"{self._path}: cannot be written ({error.strerror}); make room and call it again, which goes on from "
                "there"
            ) from error
        self.found[key] = values

    def finish(self) -> None:
        """Delete the file: its answers are in the result. Raises: WriteFailed."""
        self.close()
        try:
            os.unlink(self._path)
        except OSError as error:
            raise WriteFailed(
                f"{self._path}: cannot be removed ({error.strerror}); the result is complete, remove the file by hand"
            ) from error

    def close(self) -> None:
        """Close the file; nothing more is written."""
        self._file.close()


def answer_all(
    questions: Mapping[str, Question], answers: Answers, ask: Evaluate, workers: int, told: Callable[[], None]
) -> None:
    """Answer each question that has no answer yet; `told` is called for each new one.

    Raises: WriteFailed, WorkerDied.
    """
    waiting = {key: question for key, question in questions.items() if key not in answers.found}
    if workers == 1 or len(waiting) < 2:
        for key, question in waiting.items():
            answers.add(key, ask(question))
            told()
        return
    with WorkerPool(workers) as pool:
        futures = {pool.submit(ask, question): key for key, question in waiting.items()}
        for future in as_completed(futures):
            answers.add(futures[future], future.result())
            told()
