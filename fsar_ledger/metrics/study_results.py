"""The result files of the studies: their contents, what they rest on, and what of that has changed since.

A study (`fsar_ledger/studies`) writes one; the report and later studies read it. Each names the version of the model,
and has a digest of the SQL of every query that judged its runs, so that a number that no query gives any more is not
mistaken for a result. Units are those of the queries (shares in [0, 1], seconds).
"""

from collections.abc import Iterable, Iterator, Mapping
from hashlib import sha256
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import msgspec

from fsar_ledger.base.errors import FsarLedgerError, UsageError
from fsar_ledger.base.parameters import read_parameters

from .definitions import definitions_sql, measured_sql, metrics, published_metrics
from .library import Library, Query, library, plain_sql
from .verdicts import Answer

METRICS, CLAIMS = "metric_summary", "case_claims"
"""The relations from which the results, and the claims of the cases, are read."""


Row = dict[str, Any]
"""A row of a displayed table."""


def rows_of(parts: Iterable[msgspec.Struct], *left_out: str) -> list[Row]:
    """Return the parts of a result as rows of a table, without the fields that are left out."""
    return [
        {name: value for name, value in msgspec.structs.asdict(part).items() if name not in left_out} for part in parts
    ]


class Result(msgspec.Struct, frozen=True):
    """The result of a study: a file of this package, or one written by the command `MADE_BY`."""

    FILE: ClassVar[str]
    MADE_BY: ClassVar[str]
    RELATIONS: ClassVar[tuple[str, ...]] = (METRICS,)
    """The relations from which its numbers are read."""

    def tables(self) -> Iterator[list[Row]]:
        """Yield the tables in which it is displayed."""
        yield from ()

    def summary(self) -> str:
        """Return a sentence about the whole result, or an empty text."""
        return ""


class GroundedResult(Result, frozen=True, kw_only=True):
    """A result that names the model, the constants and the queries that it rests on."""

    model_version: str
    parameters: str
    rules: dict[str, str]

    def __post_init__(self) -> None:
        read_parameters(self.parameters)


class Objective(msgspec.Struct, frozen=True):
    """The objective of the fit: a description, and its value before and after."""

    description: str
    start: float | None = None
    accepted: float | None = None


class Parameter(msgspec.Struct, frozen=True, kw_only=True):
    """One fitted constant: its range, start and accepted value in `unit`, and whether the data identify it."""

    name: str
    unit: str
    low: float | None = None
    high: float | None = None
    start: float
    accepted: float
    meaning: str = ""
    identified: bool | None = None


class Residual(msgspec.Struct, frozen=True):
    """One cell after the fit: paper and fitted mean (stored units), and their distance in margins of the metric.

    `slopes` is how its distance changes with each free constant, in margins per half range, in the order of the
    parameters; empty in a record of a version before 0.10.0.
    """

    metric: str
    architecture: str
    paper: float
    ours: float | None
    distance_margins: float | None = None
    slopes: tuple[float, ...] = ()


class Direction(msgspec.Struct, frozen=True):
    """One direction of the parameter space: its singular value in the Jacobian of the fit, and the largest weights.

    A row of that Jacobian counts as much as its cell does in the fit's loss.
    """

    singular_value: float
    identified: bool
    weights: dict[str, float] = {}


class Search(msgspec.Struct, frozen=True):
    """One search of the fit: its runs, the objective where it began and ended, and the constants at its end."""

    runs_per_scenario: int
    start: float
    reached: float
    ended_at: dict[str, float]


class Calibration(Result, frozen=True, kw_only=True):
    """The result of the fit.

    Every part is optional and unknown keys are skipped, so that a report can be made before, during and after a fit;
    the report says which parts are absent.
    """

    FILE: ClassVar[str] = "calibration.json"
    MADE_BY: ClassVar[str] = "fsar-ledger study run calibration --out FILE"

    objective: Objective | None = None
    seeds: list[int] = []
    runs_per_scenario: int | None = None
    evaluations: int | None = None
    cpu_minutes: float | None = None
    model_version: str | None = None
    rules: dict[str, str] | None = None
    command: str | None = None
    parameters: list[Parameter] = []
    residuals: list[Residual] = []
    directions: list[Direction] = []
    searches: list[Search] = []

    def tables(self) -> Iterator[list[Row]]:
        """Yield the constants, and the cells."""
        yield rows_of(self.parameters)
        yield rows_of(self.residuals, "slopes")


class Predicted(msgspec.Struct, frozen=True, kw_only=True):
    """One predicted number: its experiment, and the metric's mean, SD per run, runs and 95 % interval, in its unit.

    `seed` None: the runs of all registered seeds. `teams_working` None: all teams. `scenario` None: all scenarios.
    """

    of: str
    seed: int | None
    fleet_size: int
    teams_working: int | None
    encounter_mean_s: float
    configuration: str
    architecture: str
    scenario: str | None
    metric: str
    mean: float | None
    sd: float | None
    n: int
    ci_low: float | None
    ci_high: float | None


class Claim(msgspec.Struct, frozen=True, kw_only=True):
    """One claim of the paper's cases, as in `cases/case_claims`: what is counted, of how many, and their ratio.

    The counts and the ratio are None where no case arose.
    """

    case_number: int
    claim: str
    is_taken: bool
    architecture: str
    runs: int
    numerator: int | None
    denominator: int | None
    value: float | None


class Predictions(GroundedResult, frozen=True, kw_only=True):
    """All predictions, with the model, the constants and the queries that they rest on."""

    FILE: ClassVar[str] = "predictions.json"
    MADE_BY: ClassVar[str] = "fsar-ledger study run predictions --out FILE"
    RELATIONS: ClassVar[tuple[str, ...]] = (METRICS, CLAIMS)

    command: str = MADE_BY
    numbers: list[Predicted]
    cases: list[Claim]

    def tables(self) -> Iterator[list[Row]]:
        """Yield the numbers over all scenarios together, and the claims."""
        yield rows_of([number for number in self.numbers if number.scenario is None])
        yield rows_of(self.cases)


class Cell(msgspec.Struct, frozen=True, kw_only=True, rename={"kind": "class"}):
    """One printed cell beside its prediction.

    `ours` is with all teams working, `ours_one_team` with one, for larger fleets; `low` and `high` are the 90 %
    interval of (ours - paper); `gives` is whether this model gives the printed number, None where the paper does not
    specify what the cell depends on.
    """

    table: str
    metric: str
    architecture: str
    configuration: str
    fleet_size: int
    scenario: str | None
    kind: str
    paper: float
    ours: float | None
    ours_one_team: float | None
    n: int
    margin: float
    low: float | None
    high: float | None
    distance: float | None
    gives: Answer | None


class Check(msgspec.Struct, frozen=True):
    """A number and the interval in which it must lie; an end of None is open.

    `holds` is None if a number that the check needs is undefined.
    """

    what: str
    value: float | None
    low: float | None
    high: float | None
    holds: bool | None


class Outcome(msgspec.Struct, frozen=True, kw_only=True):
    """The outcome of one registered prediction, which holds if all its checks do.

    `holds` is None if no check fails but one cannot be made.
    """

    name: str
    implies: str
    holds: bool | None
    held: int
    of: int
    checks: list[Check]


class Comparison(GroundedResult, frozen=True, kw_only=True):
    """The printed cells of the results, ablation and scaling tables, and all predictions.

    Model, constants and queries are those of the predictions. The tests of the significance table and the numbers of
    the cases are in `report`.
    """

    FILE: ClassVar[str] = "comparison.json"
    MADE_BY: ClassVar[str] = "fsar-ledger study run comparison PREDICTIONS --out FILE"
    RELATIONS: ClassVar[tuple[str, ...]] = (METRICS, CLAIMS)

    command: str = MADE_BY
    cells: list[Cell]
    predictions: list[Outcome]

    def tables(self) -> Iterator[list[Row]]:
        """Yield the cells, and the predictions without their single checks."""
        yield rows_of(self.cells)
        yield rows_of(self.predictions, "checks")


_Result = TypeVar("_Result", bound=Result)


def packaged(kind: type[_Result], folder: Traversable | None = None) -> _Result | None:
    """Return the packaged result of this kind, or the one in this folder; None if there is none. Raises: As `read`."""
    path = (folder or files("fsar_ledger.reports")).joinpath(kind.FILE)
    return read(path, kind, f"reports/{kind.FILE}") if path.is_file() else None


def read(path: Path | Traversable, kind: type[_Result], name: str | None = None) -> _Result:
    """Return the result in the file; messages call it `name`.

    Raises:
        UsageError: It cannot be read.
        FsarLedgerError: It is another kind of file.
    """
    try:
        return msgspec.json.decode(path.read_bytes(), type=kind)
    except OSError as error:
        raise UsageError(
            f"{name or path}: cannot be read ({error.strerror}); expected what `{kind.MADE_BY}` writes"
        ) from error
    # ValueError: a number of thousands of digits
    except (msgspec.MsgspecError, RecursionError, ValueError) as error:
        raise FsarLedgerError(
            f"{name or path}: {error}; expected what `{kind.MADE_BY}` writes; write it again"
        ) from error


def encoded(result: Result) -> bytes:
    """Return the content of the file, with a line for each part of a list."""
    fields = [f"{_line(name)}: {_lines(part)}" for name, part in msgspec.to_builtins(result).items()]
    return ("{\n  " + ",\n  ".join(fields) + "\n}\n").encode()


def _lines(part: object) -> str:
    if isinstance(part, list | tuple) and part:
        return "[\n    " + ",\n    ".join(map(_line, part)) + "\n  ]"
    if isinstance(part, dict) and part:
        return "{\n    " + ",\n    ".join(f"{_line(name)}: {_line(item)}" for name, item in part.items()) + "\n  }"
    return _line(part)


def _line(part: object) -> str:
    return msgspec.json.format(msgspec.json.encode(part), indent=0).decode()


# See docs/decisions/results-name-their-queries.md.
def rules(*relations: str, of: Library | None = None) -> dict[str, str]:
    """Return a SHA-256 of the SQL of each query that these relations rest on, by name; comments and layout aside.

    The views of event types and concerns are left out, since they only select the fields of events. So is what a run
    does not observe: simulated runs observe everything, so that it changes no number of theirs. Of the registry of
    metrics only those of the paper are included, since another metric changes no number of theirs.
    """
    others = {metric.name for metric in metrics() if metric.paper is None} - set(relations) | {"unobservable"}
    queries = (of or library()).needs(relations, held=others)
    return {query.name: _digest(query) for query in sorted(queries, key=lambda query: query.name) if not query.tags}


def changed(recorded: Mapping[str, str], of: Library | None = None) -> list[str]:
    """Return the names of the recorded queries that judge differently now, or no longer exist."""
    queries = (of or library()).queries
    return [name for name, digest in recorded.items() if name not in queries or _digest(queries[name]) != digest]


def _digest(query: Query) -> str:
    sql_of = {
        "metrics/metric_definitions": definitions_sql,
        "metrics/metric_measurements": measured_sql,
    }.get(query.name)
    sql = query.sql if sql_of is None else sql_of(published_metrics())
    return sha256(plain_sql(sql).encode()).hexdigest()
