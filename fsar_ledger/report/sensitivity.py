"""Read, check and show the file that `fsar-ledger sensitivity` writes."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq

from fsar_ledger import printable
from fsar_ledger.errors import UsageError
from fsar_ledger.metrics.definitions import published_metrics
from fsar_ledger.parameters import BadParameters, read_parameters
from fsar_ledger.report import figures, printing, specs

METADATA = b"fsar-ledger-sensitivity"
MADE_BY = "fsar-ledger sensitivity --out FILE.parquet"
ARCHITECTURES = ("fsar", "cfc", "dhma")
BOUNDS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)  # of a cell of the heat map, in margins
SHOWN_FROM = 0.5  # margins: a factor that moves no cell this far is only counted
MAX_SHOWN = 46  # factors that fit on a page
MAX_NAMED = 5  # differing constants that a message names


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
    """The model, the base constants, and the number of evaluations and runs that the effects come from."""

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


class Sensitivity(msgspec.Struct, frozen=True):
    """The content of a file."""

    about: About
    effects: tuple[Effect, ...]


class Section(msgspec.Struct, frozen=True):
    """What the report shows: a sentence, the heat map of the effects (SVG) and the table of the dozen."""

    sentence: str
    figure: bytes | None = None
    table: printing.Table | None = None


_TYPES: dict[Any, pa.DataType] = {str: pa.string(), int: pa.int64(), float: pa.float64(), float | None: pa.float64()}
SCHEMA = pa.schema(
    [pa.field(field.name, _TYPES[field.type], field.type == float | None) for field in msgspec.structs.fields(Effect)]
)


def table_of(found: Sensitivity) -> pa.Table:
    """Return the rows as they are stored, with `about` in the metadata."""
    schema = SCHEMA.with_metadata({METADATA: msgspec.json.encode(found.about)})
    return pa.Table.from_pylist([msgspec.structs.asdict(effect) for effect in found.effects], schema=schema)


def section(found: Sensitivity | None, model_version: str | None, parameters: Mapping[str, str]) -> Section:
    """Return what a report about runs of this model says about the effects.

    `parameters` are the constants of these runs by dotted name, as `Findings` has them.
    """
    if found is None:
        return Section(
            f"How much each number depends on each constant was not looked at for this report; {MADE_BY} does it in "
            "most of an hour."
        )
    about, still = found.about, sum(furthest == 0 for furthest in reach(found).values())
    if about.model_version != model_version:
        return Section(f"The effects that were given are not of these runs: {_of_another_model(about, model_version)}.")
    theirs = dict(printing.flat("", read_parameters(about.parameters)))
    differing = [name for name in {**theirs, **parameters} if theirs.get(name) != parameters.get(name)]
    if differing:
        more = f" and {len(differing) - MAX_NAMED} more" if len(differing) > MAX_NAMED else ""
        named = ", ".join(map(printable.value, differing[:MAX_NAMED])) + more
        return Section(
            f"The effects that were given are not of these runs: found effects around other constants ({named}); make "
            f"them again: {MADE_BY}."
        )
    sentence = (
        f"{len(about.factors)} factors, all constants of world and structure, the load and the size of the fleet, were "
        f"each varied {about.trajectories} times, "
        f"over {about.evaluations} evaluations of {about.runs} runs per scenario and architecture; {still} of them "
        "move nothing."
    )
    return Section(sentence, heat_map(found), printing.table("sensitivity", dozen(found)))


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


def _of_another_model(about: About, expected: str | None) -> str:
    found, wanted = (printable.value(one or "unknown") for one in (about.model_version, expected))
    return f"found effects of model {found}, expected those of model {wanted}; make them again: {MADE_BY}"


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


def heat_map(found: Sensitivity, kind: str = "svg") -> bytes:
    """Draw the figure cell x factor: how far the factor moves the cell, in margins; dark is far, also in grey.

    A dot marks an effect within chance, a cross a cell that was undefined.
    """
    shown = [name for name, furthest in reach(found).items() if furthest >= SHOWN_FROM][:MAX_SHOWN] or list(
        found.about.factors[:1]
    )
    columns = [(spec.name, architecture) for spec in published_metrics() for architecture in ARCHITECTURES]
    at = {(effect.factor, effect.metric, effect.architecture): effect for effect in found.effects}
    spec = msgspec.structs.replace(specs.figure("sensitivity"), height_in=1.7 + 0.135 * len(shown))
    with figures.canvas(spec, 1, 1) as (figure, axes):
        panel = axes[0, 0]
        _cells(figure, panel, [[at.get((name, *column)) for column in columns] for name in shown])
        panel.set_yticks(range(len(shown)), [figures.label(name, 60) for name in shown], fontsize=6)
        panel.set_xticks(
            range(len(columns)), [architecture.upper() for _, architecture in columns], rotation=90, fontsize=6
        )
        top = panel.secondary_xaxis("top")
        titles = [one.short for one in published_metrics()]
        top.set_xticks([3 * number + 1 for number in range(len(titles))], titles, rotation=25, ha="left", fontsize=7)
        for axis in (panel, top):
            axis.tick_params(length=0)
        for number in range(1, len(titles)):
            panel.axvline(3 * number - 0.5, color="black", linewidth=0.5)
        return figures.rendered(figure, kind)


def _cells(figure: Any, panel: Any, rows: Sequence[Sequence[Effect | None]]) -> None:
    """Draw the squares and their scale."""
    import matplotlib as mpl
    from matplotlib.colors import BoundaryNorm

    values = [
        [math.nan if one is None or one.mu_star_margins is None else one.mu_star_margins for one in row] for row in rows
    ]
    colours = mpl.colormaps["Greys"].resampled(len(BOUNDS) + 1)
    image = panel.imshow(
        values,
        aspect="auto",
        cmap=colours,
        norm=BoundaryNorm(BOUNDS, colours.N, extend="both"),
        interpolation="nearest",
    )
    for height, row in enumerate(rows):
        for place, one in enumerate(row):
            if one is None or one.mu_star_margins is None:
                panel.plot(place, height, marker="x", markersize=3, color="black", markeredgewidth=0.5)
            elif one.mu_star_margins >= BOUNDS[0] and one.mu_star_margins <= (one.by_chance_margins or 0.0):
                dark = one.mu_star_margins >= BOUNDS[3]
                panel.plot(
                    place, height, marker=".", markersize=2.5, color="white" if dark else "black", markeredgewidth=0
                )
    bar = figure.colorbar(image, ax=panel, location="bottom", fraction=0.03, pad=0.02, aspect=50, ticks=BOUNDS)
    bar.ax.set_xticklabels([f"{bound:g}" for bound in BOUNDS], fontsize=6)
    bar.set_label("mean change of the cell over the range of the constant, in margins", fontsize=7)
