"""Fits world laws and structural lengths to the paper's results table.

Gauss-Newton on the 24 cells of `results.csv` with common random numbers: every trial meets the same worlds.
A residual is (ours - paper) in standard errors at n = 100; the prior keeps each constant near its start.

Two of the paper's tables are read (`READ`). The means of the results table are what the fit aims at. The effect
sizes of the significance table say how much a cell weighs: a standard error comes from the larger of our SD and
the one that they imply (`verdicts.py`), for locality and attributability always the latter. So that table is not
held out in full, though no test in it is aimed at. The others (ablation, scaling, cases) are not read.

A fit is not evidence: the record says how many directions of the constants the 24 cells identify at all. Nor are
the constants that it leaves alone free of the cells: `constants.py` says of each whether it was chosen after fits.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import msgspec
import numpy as np

from fsar_ledger.constants import Constants
from fsar_ledger.errors import WriteFailed
from fsar_ledger.events.envelope import Architecture
from fsar_ledger.ledger.codec import encode
from fsar_ledger.ledger.place import require_outside
from fsar_ledger.metrics.database import connect, from_table
from fsar_ledger.metrics.results import MetricRow, metric_rows
from fsar_ledger.metrics.verdicts import compare
from fsar_ledger.runtime.experiment import Experiment, simulate
from fsar_ledger.runtime.simulation import ARCHITECTURES, MODEL_VERSION, SCENARIOS, RunSpec, simulate_run
from fsar_ledger.runtime.switches import SWITCHES, Switch
from fsar_ledger.workers import WorkerPool

READ = ("results", "significance")  # of the paper's tables: what is aimed at, and how much each cell of it weighs
SEED = 20260001  # never used for a published number
RUNS = 400  # per scenario and architecture, where a point is judged
SLOPE_RUNS = 80  # where only the slope around it is: the same worlds on both sides take most of the noise away
ROUNDS = 2
STEP = 0.12  # of the logarithm of a constant, for the central differences of the Jacobian
PRIOR = 0.25  # standard deviation of the logarithm of a constant around its start
LONGEST_STEP = 0.30
SCALES = (0.5, 1.0)  # of a step, tried in each round

Vector = np.ndarray[tuple[int], np.dtype[np.float64]]
Matrix = np.ndarray[tuple[int, int], np.dtype[np.float64]]
Progress = Callable[[int, int], None]


class Fitted(msgspec.Struct, frozen=True):
    """One constant that is fitted: where it lives, its unit and its start."""

    name: str
    unit: str
    start: float
    meaning: str


FITTED: tuple[Fitted, ...] = (
    Fitted("world.context_rate_per_s", "1/s", 0.0227, "context changes per robot"),
    Fitted("world.context_window_share", "share", 0.37, "context changes that close the robot's own policy"),
    Fitted("world.window_mean_s", "s", 11.5, "mean length of policy windows"),
    Fitted("world.review_share", "share", 0.06, "windows that ask for review"),
    Fitted("world.fleet_rule_rate_per_s", "1/s", 0.0063, "fleet rules on a robot's zone"),
    Fitted("world.obstruction_rate_per_s", "1/s", 0.0165, "obstructions in a robot's way"),
    Fitted("world.obstruction_mean_s", "s", 2.75, "mean length of obstructions"),
    Fitted("world.routine_rate_per_s", "1/s", 0.22, "routine operations per robot"),
    Fitted("world.motion_share", "share", 0.24, "routine operations that move the robot"),
    Fitted("world.absence_s", "s", 4.0, "length of the local supervisor's absence"),
    Fitted("world.budget_base_s", "s", 46.0, "base of the task budget"),
    Fitted("structure.sync_period_us", "us", 6_500_000, "CFC: copies are refreshed this often"),
    Fitted("structure.service_us", "us", 110_000, "CFC: the coordinator's time per item"),
    Fitted("structure.hop_ppm", "ppm", 750_000, "DHMA: an internal hop as a share of a message"),
    Fitted("structure.snapshot_period_us", "us", 13_000_000, "DHMA: planners refresh their snapshot this often"),
    Fitted("structure.engagement_us", "us", 2_800_000, "DHMA: the planner attends this long"),
    Fitted("structure.dispute_timeout_us", "us", 12_000_000, "DHMA: a disputed recovery gives up after this"),
    Fitted("structure.renegotiation_us", "us", 4_600_000, "DHMA: replanning a delegated action takes this much more"),
)


def with_values(values: Sequence[float]) -> Constants:
    """The constants with these values for the fitted ones, in the order of `FITTED`."""
    changes: dict[str, dict[str, Any]] = {"world": {}, "structure": {}}
    for fitted, value in zip(FITTED, values, strict=True):
        part, _, name = fitted.name.partition(".")
        changes[part][name] = rounded(value) if part == "world" else int(rounded(value))
    base = Constants()
    replace = msgspec.structs.replace
    return Constants(replace(base.world, **changes["world"]), replace(base.structure, **changes["structure"]))


def rounded(value: float) -> float:
    """Three significant digits: the data do not determine more."""
    return float(f"{value:.3g}")


def measure(constants: Constants, runs: int, architectures: Sequence[Architecture] = ARCHITECTURES, switch: Switch | None = None) -> list[MetricRow]:
    """The eight metrics, judged by SQL, of runs under these constants; `switch` takes one mechanism out. For few runs: all are held in memory."""
    structure = switch.structure() if switch is not None else None
    configuration = switch.configuration if switch is not None else "full"
    records = [
        simulate_run(RunSpec(SEED, architecture, configuration, scenario, 4, run), constants, structure)
        for scenario in SCENARIOS
        for run in range(runs)
        for architecture in architectures
    ]
    with from_table(encode(records), threads=1) as database:
        return metric_rows(database)


def measure_stored(constants: Constants, runs: int, workers: int) -> list[MetricRow]:
    """The same for many runs, through a ledger that is thrown away."""
    with TemporaryDirectory() as folder:
        ledger = Path(folder) / "ledger"
        simulate(ledger, Experiment(ARCHITECTURES, SCENARIOS, runs, SEED, constants=constants), workers)
        with connect(ledger) as database:
            return metric_rows(database)


def distances(rows: list[MetricRow]) -> Vector:
    """(ours - paper) of the 24 cells in standard errors at n = 100."""
    return np.array([cell.distance_se or 0.0 for cell in compare(rows)])


def slope_distances(values: Sequence[float]) -> Vector:
    """The distances on the few runs that slopes are taken from."""
    return distances(measure(with_values(values), SLOPE_RUNS))


def calibrate(out: Path, progress: Progress | None = None, workers: int = 2) -> None:
    """The record of the fit is in the file. Takes minutes.

    Raises:
        UsageError: the file lies inside a ledger.
        WriteFailed: the file cannot be written.
    """
    require_outside(out, f"--out {out}")
    _require_writable(out)
    starts = np.array([fitted.start for fitted in FITTED])
    total = _evaluations()
    steps = iter(range(1, total + 1))

    def advance() -> None:
        if progress is not None:
            progress(next(steps), total)

    def at(point: Vector) -> Constants:
        return with_values(list(starts * np.exp(point)))

    def judge(point: Vector) -> Vector:
        found = distances(measure_stored(at(point), RUNS, workers))
        advance()
        return found

    def slopes(points: list[Vector]) -> list[Vector]:
        with WorkerPool(workers) as pool:
            found = []
            for distance in pool.map(slope_distances, [list(starts * np.exp(point)) for point in points]):
                found.append(distance)
                advance()
            return found

    point = np.zeros(len(FITTED))
    now = judge(point)
    start_value, jacobian = objective(now, point), np.zeros((len(now), len(FITTED)))
    for _ in range(ROUNDS):
        jacobian = _jacobian(slopes, point)
        step = _step(jacobian, now, point)
        trials = [(judge(point + scale * step), point + scale * step) for scale in SCALES]
        best_now, best_point = min(trials, key=lambda trial: objective(*trial))
        if objective(best_now, best_point) < objective(now, point):
            now, point = best_now, best_point
    record = _record(starts, point, measure_stored(at(point), RUNS, workers), start_value, jacobian)
    record["switch_offs"] = _switch_offs(at(point))
    advance()
    _write(out, record)


def _evaluations() -> int:
    """How often the model is measured: the slopes and trials of each round, the start, and the accepted point."""
    return ROUNDS * (2 * len(FITTED) + len(SCALES)) + 2


def objective(found: Vector, point: Vector) -> float:
    """What the fit makes small: squared residuals in standard errors, plus the prior."""
    return float(found @ found + (point @ point) / PRIOR**2)


def _jacobian(slopes: Callable[[list[Vector]], list[Vector]], point: Vector) -> Matrix:
    """Change of each residual with the logarithm of each constant, by central differences on the same worlds."""
    shifts = np.eye(len(FITTED)) * STEP
    sides = slopes([point + shift for shift in shifts] + [point - shift for shift in shifts])
    up, down = np.array(sides[: len(FITTED)]), np.array(sides[len(FITTED) :])
    return np.asarray((up - down).T / (2 * STEP))


def _step(jacobian: Matrix, now: Vector, point: Vector) -> Vector:
    """The Gauss-Newton step under the prior, no constant by more than `LONGEST_STEP`."""
    normal = jacobian.T @ jacobian + np.eye(len(point)) / PRIOR**2
    step = -np.linalg.solve(normal, jacobian.T @ now + point / PRIOR**2)
    longest = float(np.abs(step).max())
    return np.asarray(step * min(1.0, LONGEST_STEP / longest) if longest > 0 else step)


def _record(starts: Vector, point: Vector, rows: list[MetricRow], start_value: float, jacobian: Matrix) -> dict[str, Any]:
    constants = with_values(list(starts * np.exp(point)))
    _, singular, directions = np.linalg.svd(jacobian * PRIOR, full_matrices=False)
    return {
        "objective": {
            "description": "sum over the 24 cells of ((ours - paper) / standard error at n = 100)^2, plus ((log of constant / start) / prior SD)^2; "
            "a standard error is from our SD or, if that is larger, from the one that significance.csv implies",
            "start": round(start_value, 3),
            "accepted": round(objective(distances(rows), point), 3),
        },
        "seeds": [SEED],
        "runs_per_scenario": RUNS,
        "evaluations": _evaluations(),
        "model_version": MODEL_VERSION,
        "command": "fsar-ledger calibrate --out FILE",
        "parameters": [_parameter(fitted, constants, directions, singular, index) for index, fitted in enumerate(FITTED)],
        "residuals": [
            {"metric": cell.metric, "architecture": cell.architecture, "paper": cell.paper, "ours": cell.ours, "distance_se": cell.distance_se}
            for cell in compare(rows)
        ],
        "directions": [
            {
                "singular_value": round(float(value), 3),
                "identified": bool(value > 1),
                "weights": {FITTED[index].name: round(float(row[index]), 2) for index in np.argsort(-np.abs(row))[:4]},
            }
            for value, row in zip(singular, directions, strict=True)
        ],
    }


def _parameter(fitted: Fitted, constants: Constants, directions: Matrix, singular: Vector, index: int) -> dict[str, Any]:
    """A constant is identified when the data alone determine it better than the prior does."""
    part, _, name = fitted.name.partition(".")
    information = float(((singular * directions[:, index]) ** 2).sum())
    return {
        "name": fitted.name,
        "unit": fitted.unit,
        "start": fitted.start,
        "accepted": getattr(getattr(constants, part), name),
        "meaning": fitted.meaning,
        "identified": information > 1,
    }


def _switch_offs(constants: Constants) -> list[dict[str, Any]]:
    """Each mechanism switched off once, under the accepted constants and on the same worlds."""
    whole = {(row.architecture, row.metric): row.mean for row in measure(constants, SLOPE_RUNS)}
    found: list[dict[str, Any]] = []
    for switch in SWITCHES:
        without = {row.metric: row.mean for row in measure(constants, SLOPE_RUNS, (switch.architecture,), switch)}
        of_switch = {"mechanism": switch.mechanism, "architecture": switch.architecture}
        found += [
            {**of_switch, "metric": metric, "with_mechanism": whole[switch.architecture, metric], "without": without[metric]} for metric in switch.metrics
        ]
    return found


def _require_writable(out: Path) -> None:
    """Minutes of work should not end in a refusal. Nothing is left behind."""
    probe = out.with_name(out.name + ".tmp")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        if out.is_dir():
            raise IsADirectoryError(None, "it is a folder")
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise WriteFailed(f"{out}: cannot be written ({error.strerror}); expected a path for the record of the fit") from error


def _write(out: Path, record: dict[str, Any]) -> None:
    data = msgspec.json.format(msgspec.json.encode(record), indent=2) + b"\n"
    try:
        temporary = out.with_name(out.name + ".tmp")
        temporary.write_bytes(data)
        temporary.replace(out)
    except OSError as error:
        raise WriteFailed(f"{out}: cannot be written ({error.strerror}); free space or give another path") from error
