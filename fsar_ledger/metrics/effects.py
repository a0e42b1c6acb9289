"""The result file of the sensitivity study: what each constant does to each cell, as Parquet."""

from pathlib import Path
from typing import Any

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq

from fsar_ledger.base.errors import UsageError
from fsar_ledger.base.parameters import BadParameters, read_parameters

from .definitions import published_metrics

METADATA = b"fsar-ledger-sensitivity"
MADE_BY = "fsar-ledger study run sensitivity --out FILE.parquet"
ARCHITECTURES = ("fsar", "cfc", "dhma")


class Effect(msgspec.Struct, frozen=True, kw_only=True):
    """What one factor does to one cell over its whole range, `low` to `high`; for a switch, between its settings.

    `mu`, `mu_star`, `sigma` and `mu_star_conf` (half of the 95 % interval of `mu_star`) are in the metric's unit, over
    `effects` moves; `by_chance` is the most that `mu_star` could be if only chance moved the cell. The columns
    `_margins` are the same divided by the metric's margin. `sobol_first` and `sobol_total` are parts of the cell's
    variance while the factors that matter most vary together; `emulator_r2` says how well the polynomial behind them
    predicts points it has not seen. None: the cell was undefined, or the factor is not among those.
    """

    metric: str
    architecture: str
    factor: str
    origin: str
    low: str
    base: str
    high: str
    base_mean: float | None
    margin: float
    effects: int
    mu: float | None
    mu_star: float | None
    sigma: float | None
    mu_star_conf: float | None
    by_chance: float | None
    mu_margins: float | None
    mu_star_margins: float | None
    sigma_margins: float | None
    mu_star_conf_margins: float | None
    by_chance_margins: float | None
    sobol_first: float | None
    sobol_total: float | None
    emulator_r2: float | None


class About(msgspec.Struct, frozen=True, kw_only=True):
    """The model, the base constants, the queries, and how many evaluations and runs the effects come from.

    `rules` None: the file is of a version before 0.9.0, which did not name the queries.
    """

    model_version: str
    parameters: str
    fleet_size: int
    seed: int
    trajectories: int
    runs: int
    points: int
    repeats: int
    evaluations: int
    factors: tuple[str, ...]
    dozen: tuple[str, ...]
    """The factors that matter most (`that_matter`), the one that moves a cell furthest first."""
    rules: dict[str, str] | None = None


class Sensitivity(msgspec.Struct, frozen=True):
    """The content of a file."""

    about: About
    effects: tuple[Effect, ...]


_TYPES: dict[Any, pa.DataType] = {str: pa.string(), int: pa.int64(), float: pa.float64(), float | None: pa.float64()}
SCHEMA = pa.schema(
    [pa.field(field.name, _TYPES[field.type], field.type == float | None) for field in msgspec.structs.fields(Effect)]
)


def parquet(found: Sensitivity) -> bytes:
    """Return the content of the file: the rows, with `about` in the metadata."""
    schema = SCHEMA.with_metadata({METADATA: msgspec.json.encode(found.about)})
    table = pa.Table.from_pylist([msgspec.structs.asdict(effect) for effect in found.effects], schema=schema)
    written = pa.BufferOutputStream()
    pq.write_table(table, written, compression="zstd")
    return bytes(written.getvalue())


def open_effects(path: Path) -> Sensitivity:
    """Return the effects in the file. Raises: UsageError if it cannot be read or is another kind of file."""
    if not path.is_file():
        raise UsageError(f"{path}: found no such file, expected one of `{MADE_BY}`")
    try:
        with path.open("rb") as file:  # pyarrow would expand a leading `~`
            table = pq.ParquetFile(file).read()
        about = msgspec.json.decode((table.schema.metadata or {}).get(METADATA, b""), type=About)
        effects = msgspec.convert(table.select(SCHEMA.names).to_pylist(), tuple[Effect, ...])
        read_parameters(about.parameters)
    except (pa.ArrowException, KeyError, msgspec.MsgspecError, BadParameters) as error:
        raise UsageError(
            f"{path}: found no file of effects ({str(error).splitlines()[0]:.200}), expected one of `{MADE_BY}`"
        ) from error
    except OSError as error:
        raise UsageError(
            f"{path}: cannot be read ({error.strerror or str(error):.200}), expected a file of `{MADE_BY}`"
        ) from error
    grid = {
        (spec.name, architecture, factor)
        for spec in published_metrics()
        for architecture in ARCHITECTURES
        for factor in about.factors
    }
    if (
        {(one.metric, one.architecture, one.factor) for one in effects} != grid
        or len(effects) != len(grid)
        or not set(about.dozen) <= set(about.factors)
    ):
        raise UsageError(
            f"{path}: found no file of effects (a row for each cell and factor is not there), expected one of "
            f"`{MADE_BY}`"
        )
    return Sensitivity(about, effects)


def reach(found: Sensitivity) -> dict[str, float]:
    """Return how far each factor moves the cell that it moves furthest, in margins, the largest first.

    Equal ones keep the order of the file.
    """
    furthest = dict.fromkeys(found.about.factors, 0.0)
    for effect in found.effects:
        furthest[effect.factor] = max(furthest[effect.factor], effect.mu_star_margins or 0.0)
    return dict(sorted(furthest.items(), key=lambda item: -item[1]))


def that_matter(found: Sensitivity, most: int) -> tuple[str, ...]:
    """Return the `most` factors that matter most, the one with the longest reach first.

    They are the one that moves each metric furthest, then those that move any cell furthest. By reach alone, a metric
    with a narrow margin would fill the list.
    """
    furthest: dict[str, tuple[float, str]] = {}
    for effect in found.effects:
        if effect.mu_star_margins and effect.mu_star_margins > furthest.get(effect.metric, (0.0, ""))[0]:
            furthest[effect.metric] = effect.mu_star_margins, effect.factor
    by_reach = [name for name, margins in reach(found).items() if margins > 0]
    chosen = dict.fromkeys([*(name for _, name in furthest.values()), *by_reach])
    return tuple(sorted(list(chosen)[:most], key=by_reach.index))


def dozen(found: Sensitivity) -> list[dict[str, Any]]:
    """Return a row for each factor that matters most: the cell it moves furthest, how far, its part of the variance."""
    rows: list[dict[str, Any]] = []
    for name in found.about.dozen:
        of_factor = [effect for effect in found.effects if effect.factor == name]
        most = max(of_factor, key=lambda effect: effect.mu_star_margins or 0.0)
        rows.append(
            {
                "factor": name,
                "from": most.origin,
                "range": f"{most.low} to {most.high}" if " to " not in most.low else f"({most.low}) to ({most.high})",
                "cells": sum((effect.mu_star_margins or 0.0) >= 1 for effect in of_factor),
                "metric": most.metric,
                "architecture": most.architecture,
                "mu_margins": most.mu_margins,
                "mu_star_margins": most.mu_star_margins,
                "conf": most.mu_star_conf_margins,
                "by_chance": most.by_chance_margins,
                "sobol_first": most.sobol_first,
                "sobol_total": most.sobol_total,
                "r2": most.emulator_r2,
            }
        )
    return rows
