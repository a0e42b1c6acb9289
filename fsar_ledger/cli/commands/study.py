"""The commands `study run NAME` and `study show`."""

from pathlib import Path
from typing import Annotated

import typer

from fsar_ledger import printable
from fsar_ledger.cli import completing
from fsar_ledger.cli.memory import reading
from fsar_ledger.cli.options import (
    CsvOption,
    JsonOption,
    LedgerArgument,
    PoolOption,
    RawOption,
    SvgOption,
    VerifiedOption,
    WideOption,
    WorkersOption,
    examples,
)
from fsar_ledger.cli.progress import Progress
from fsar_ledger.cli.terminal import show

group = typer.Typer()
run = typer.Typer()
group.add_typer(run, name="run")

OutOption = Annotated[
    Path,
    typer.Option("--out", metavar="FILE", help="The result, as JSON; replaced if it exists.", show_default=False),
]


@group.callback()
def _study() -> None:
    """Run a study of the model, or show the result of one."""


@run.callback()
def _run() -> None:
    """Run a study."""


@run.command("calibration", epilog=examples("fsar-ledger study run calibration --out out/calibration.json"))
def calibration(out: OutOption, workers: WorkersOption = None) -> None:
    """Fit the constants again as registered; takes the better part of an hour.

    The fit is to the paper's results table alone. `reports/registration.toml` names the constants and their ranges. The
    result says where the fit began, what the data identify and what was accepted.
    """
    from fsar_ledger.studies.calibration import calibrate

    with Progress("tried", "parameter sets") as progress:
        calibrate(out, workers=workers, progress=progress)
    show(printable.line(f"{out}"))


@run.command("predictions", epilog=examples("fsar-ledger study run predictions --out out/predictions.json"))
def predictions(out: OutOption, workers: WorkersOption = None) -> None:
    """Simulate the experiments registered for prediction, and write their numbers; takes minutes.

    These are ablations, larger fleets, loads, encounter rates, other seeds and pairs of ablations, with the constants
    as they are. No number of the paper is read. `reports/registration.toml` says what is predicted, and what the
    paper's claims imply for it.
    """
    from fsar_ledger.studies.predictions import predict

    with Progress("played", "experiments") as progress:
        predict(out, workers=workers, progress=progress)
    show(printable.line(f"{out}"))


@run.command(
    "comparison",
    epilog=examples("fsar-ledger study run comparison out/predictions.json --out out/comparison.json"),
)
def comparison(
    predictions: Annotated[
        Path, typer.Argument(metavar="PREDICTIONS", help="What `study run predictions` wrote.", show_default=False)
    ],
    out: OutOption,
) -> None:
    """Compare predicted numbers with the paper's, and with what its claims were registered to imply.

    Nothing is simulated. In the source of this package, `reports/predictions.json` holds the predictions made right
    after the fit, and `reports/comparison.json` their comparison.
    """
    from fsar_ledger.studies.comparison import judge

    judge(predictions, out)
    show(printable.line(f"{out}"))


@run.command(
    "sensitivity",
    epilog=examples(
        "fsar-ledger study run sensitivity --out out/sensitivity.parquet --svg out/sensitivity.svg",
        "fsar-ledger study run sensitivity --out out/short.parquet --trajectories 2 --runs 1 --points 0",
    ),
)
def sensitivity(
    out: Annotated[
        Path,
        typer.Option(
            "--out", metavar="FILE", help="The effects, as Parquet; replaced if it exists.", show_default=False
        ),
    ],
    trajectories: Annotated[int, typer.Option(metavar="N", help="How often each factor is moved.")] = 20,
    runs: Annotated[int, typer.Option(metavar="N", help="Runs per scenario and architecture of each evaluation.")] = 10,
    points: Annotated[
        int, typer.Option(metavar="N", help="Evaluations for the Sobol indices; 0: none, only the screening.")
    ] = 512,
    svg: Annotated[
        Path | None,
        typer.Option(
            "--svg", metavar="FILE", help="Also draw them, as SVG; replaced if it exists.", show_default=False
        ),
    ] = None,
    workers: WorkersOption = None,
    wide: WideOption = False,
) -> None:
    """Measure how much each number depends on each constant; takes most of an hour on two cores.

    Morris screening varies every constant of the world and of the structure, the load and the fleet size. Sobol indices
    then give the part of each number's variance that is due to each of the dozen constants that move a number furthest.
    An interrupted study continues where it stopped.
    """
    from fsar_ledger.cli.studies import effects
    from fsar_ledger.ledger.store.paths import require_outside
    from fsar_ledger.publishing import publish
    from fsar_ledger.report.sensitivity import heat_map
    from fsar_ledger.studies.sensitivity import sensitivity as study

    if svg is not None:
        require_outside(svg, f"--svg {svg}")
    with Progress("evaluated", "points") as progress:
        found = study(out, trajectories=trajectories, runs=runs, points=points, workers=workers, progress=progress)
    show(printable.joined(*effects(found, wide=wide), printable.line(f"{out}")))
    if svg is not None:
        publish(svg, heat_map(found))
        show(printable.line(f"{svg}"))


@run.command(
    "multiverse",
    epilog=examples(
        "fsar-ledger study run multiverse out/ledger",
        "fsar-ledger study run multiverse out/ledger --metric authority_conflicts --json",
        "fsar-ledger study run multiverse out/ledger --metric human_intervention --svg out/multiverse.svg",
    ),
)
@reading
def multiverse(
    ledger: LedgerArgument,
    metric: Annotated[
        list[str] | None,
        typer.Option("--metric", metavar="NAME", help="Only this metric; may be repeated.", show_default="all"),
    ] = None,
    pool: PoolOption = None,
    svg: SvgOption = None,
    verified: VerifiedOption = False,
    as_json: JsonOption = False,
    as_csv: CsvOption = False,
    raw: RawOption = False,
    wide: WideOption = False,
) -> None:
    """Compute the results table under every reading that the paper's text allows.

    For each cell: the paper's number, ours, the lowest and the highest mean over all combinations of readings, and the
    reading that moves it most when it alone replaces ours. For each metric: whether the order of the architectures is
    the same under all combinations, under how many FSAR is best, and the smallest combinations that change either.
    Nothing is simulated again. --json also has the mean under each combination.
    """
    from fsar_ledger.api.fields import csv_text, plain
    from fsar_ledger.cli.answering import opened, warn
    from fsar_ledger.cli.output import answer_json, check_form
    from fsar_ledger.cli.studies import every_reading
    from fsar_ledger.ledger.store.paths import require_outside
    from fsar_ledger.metrics.multiverse import Cell, Multiverse

    check_form(as_json=as_json, as_csv=as_csv, raw=raw)
    if svg is not None:
        require_outside(svg, f"--svg {svg}")
    asked = opened(ledger, verified=verified)
    with Progress("read", "combinations of readings") as progress:
        found = asked.multiverse(metric, pool, progress=progress)  # type: ignore[arg-type]
    provenance = found.provenance
    if as_json:
        answer = {name: getattr(found, name) for name in Multiverse.__struct_fields__}
        show(answer_json(provenance, answer))
    elif as_csv:
        show(csv_text(plain(found.cells), Cell.__struct_fields__, raw=raw), raw=raw)
    else:
        show(printable.joined(*every_reading(found, wide=wide)))
    if svg is not None:
        found.draw(svg)
    warn(ledger, provenance)


@group.command(
    "show",
    epilog=examples("fsar-ledger study show comparison", "fsar-ledger study show calibration out/calibration.json"),
)
def study_show(
    name: Annotated[
        str,
        typer.Argument(
            metavar="NAME",
            help="calibration, predictions, comparison or sensitivity.",
            autocompletion=completing.studies,
            show_default=False,
        ),
    ],
    file: Annotated[
        Path | None,
        typer.Argument(metavar="FILE", help="What `study run NAME` wrote.", show_default="the result in this package"),
    ] = None,
    wide: WideOption = False,
) -> None:
    """Show the result of a study as tables, and whether what it rests on has changed since.

    It rests on the version of the model, the constants and the queries that judged its runs. The package has results of
    the calibration, the predictions and the comparison; that of `study run multiverse` is in no file.
    """
    from fsar_ledger.cli.studies import shown

    show(printable.joined(*shown(name, file, wide=wide)))
