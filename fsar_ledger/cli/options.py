"""The arguments and options that commands share, and checks of their text."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from fsar_ledger.errors import QueryFailed

from . import completing

SHOWN_ROWS = 100
SCENARIOS = Path(__file__).parents[1] / "runtime/world/scenarios"


def named_in(folder: Path) -> str:
    """List the designs in a folder of the package by name; to import them would slow `--help` down."""
    *names, last = sorted(file.stem for file in folder.glob("*.toml"))
    return f"{', '.join(names)} or {last}"


LedgerArgument = Annotated[Path, typer.Argument(metavar="LEDGER", help="The folder of a ledger.", show_default=False)]
NewLedgerArgument = Annotated[
    Path,
    typer.Argument(metavar="OUT", help="A new folder, or that of a ledger to continue or enlarge.", show_default=False),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Answer as JSON, with the head (size, root) of the ledger.")]
NdjsonOption = Annotated[bool, typer.Option("--ndjson", help="Answer as JSON, one row a line and nothing else.")]
CsvOption = Annotated[bool, typer.Option("--csv", help="Answer as comma-separated values.")]
RawOption = Annotated[
    bool,
    typer.Option("--raw", help="Do not escape text in CSV, not even control characters and spreadsheet formulas."),
]
VerifiedOption = Annotated[
    bool,
    typer.Option(
        "--verified",
        help="Answer only from rows that were compared with the root, as `verify` does. Unless `verify` has checked "
        "this head before, that takes some 4 s for a million events on two cores.",
    ),
]
LimitOption = Annotated[
    int, typer.Option("--limit", metavar="N", help="Show at most N rows of the table; 0 shows all.")
]
WideOption = Annotated[
    bool,
    typer.Option("--wide", help="Show every column and whole cells, not what fits the terminal; as when piped."),
]
PoolOption = Annotated[
    str | None,
    typer.Option("--pool", metavar="seeds", help="Pool the runs of all seeds.", show_default="each seed by itself"),
]
FileOption = Annotated[
    Path | None,
    typer.Option(
        "--file",
        metavar="FILE",
        help="Answer the SELECT in this file instead of NAME; `-` reads standard input.",
        show_default=False,
    ),
]
SecondsOption = Annotated[
    int | None,
    typer.Option("--seconds", metavar="N", help="The time limit for a SELECT of your own.", show_default="60"),
]
ReadingMemoryOption = Annotated[
    int | None,
    typer.Option(
        "--memory",
        metavar="MIB",
        help="The memory limit.",
        show_default="576, 192 for each core or worker beyond two, and 16 times the size of the segments",
    ),
]
QueryMemoryOption = Annotated[
    int | None,
    typer.Option(
        "--memory",
        metavar="MIB",
        help="The memory limit; for a SELECT of your own at least 1024.",
        show_default="4096 for a SELECT of your own; else as for `metrics`",
    ),
]
ParameterOption = Annotated[
    list[str] | None,
    typer.Option(
        "--param",
        metavar="NAME=VALUE",
        help="A parameter of the query; may be repeated.",
        show_default=False,
        autocompletion=completing.parameters,
    ),
]
WorkersOption = Annotated[
    int | None,
    typer.Option(
        "--workers",
        metavar="N",
        help="Processes at once; the answer is the same for any number.",
        show_default="one per core, if there is enough to do",
    ),
]
ArchitectureOption = Annotated[
    list[str] | None,
    typer.Option(
        "--architecture",
        metavar="NAME",
        help="fsar, cfc or dhma; may be repeated.",
        show_default="all; with --without, the one that has the mechanism",
        autocompletion=completing.architectures,
    ),
]
ScenarioOption = Annotated[
    list[str] | None,
    typer.Option(
        "--scenario",
        metavar="NAME",
        help=f"{named_in(SCENARIOS)}; may be repeated. Or one of your own: a .toml file (docs/own-fleet.md).",
        show_default="the paper's five",
        autocompletion=completing.scenarios,
    ),
]
FleetOption = Annotated[
    str | None,
    typer.Option("--fleet", metavar="FILE", help="A .toml file with a fleet of your own.", show_default="the paper's"),
]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="NAME=VALUE",
        help="A new value of a constant, such as world.review_share=0.5; may be repeated.",
        show_default=False,
        autocompletion=completing.constants,
    ),
]
WithoutOption = Annotated[
    list[str] | None,
    typer.Option(
        "--without",
        metavar="MECHANISM",
        help="Remove a mechanism of FSAR: trust-evaluation, policy-composition, layered-recovery or shared-registry "
        "(docs/model.md lists more, also of CFC and DHMA), or several of one architecture, joined by +. May be "
        "repeated, for one configuration each.",
        show_default=False,
        autocompletion=completing.mechanisms,
    ),
]

WorkflowOption = Annotated[
    list[str] | None,
    typer.Option(
        "--workflow",
        metavar="NAME",
        help=(
            "Play one of the paper's workflows under FSAR instead: door-relay, layered-recovery or "
            "human-supervision; may be repeated."
        ),
        show_default=False,
        autocompletion=completing.workflows,
    ),
]
FleetSizeOption = Annotated[
    int | None,
    typer.Option(
        "--fleet-size",
        metavar="N",
        help="Robots: a multiple of 4, since a team has four roles, or of the size of your --fleet.",
        show_default="one team",
    ),
]
TeamsWorkingOption = Annotated[
    int | None,
    typer.Option(
        "--teams-working",
        metavar="N",
        help="Teams that have tasks; the others stand by and can be asked.",
        show_default="all",
    ),
]
TaskSetsOption = Annotated[
    int,
    typer.Option(
        "--task-sets", metavar="N", help="How often each team that works gets the tasks of its scenario, 30 s apart."
    ),
]
RunsOption = Annotated[
    int | None,
    typer.Option(
        metavar="N", help="Runs per scenario (or workflow) and architecture.", show_default="20; with --workflow, 1"
    ),
]
OneRunOption = Annotated[
    str,
    typer.Option(
        "--run",
        metavar="RUN",
        help="A run: its number, its name, or a unique part of it.",
        autocompletion=completing.runs,
    ),
]
SvgOption = Annotated[
    Path | None,
    typer.Option("--svg", metavar="FILE", help="Also draw it, as SVG; replaced if it exists.", show_default=False),
]
KeyOption = Annotated[
    Path | None,
    typer.Option(
        "--key",
        metavar="FILE",
        envvar="FSAR_LEDGER_KEY",
        help="Sign with this key, of `fsar-ledger key new`.",
        show_default="leave the ledger unsigned",
    ),
]
AdoptOption = Annotated[
    bool, typer.Option("--adopt", help="Continue a ledger that another key signed, or none; verify it first.")
]
OriginOption = Annotated[
    str | None,
    typer.Option(
        "--origin",
        metavar="NAME",
        help="Publish the ledger under this name, such as host/path.",
        show_default="the key's name, else fsar-ledger/simulated",
    ),
]
TrustedKeyOption = Annotated[
    str | None,
    typer.Option(
        "--trusted-key",
        metavar="KEY",
        help="Require the signature of this public key: a .pub file, or the key itself.",
        show_default=False,
    ),
]
WorkflowLedgerOption = Annotated[
    Path | None,
    typer.Option(
        "--workflows",
        metavar="LEDGER",
        help="A ledger of the paper's three workflows.",
        show_default="say that there is none",
    ),
]
OnlyOption = Annotated[
    list[str] | None,
    typer.Option(
        "--only",
        metavar="EXPERIMENT",
        help="results (always made), ablation, scaling or workflows; may be repeated.",
        show_default="all",
    ),
]
ReproducedRunsOption = Annotated[
    int | None,
    typer.Option(
        "--runs", metavar="N", help="Runs of each scenario.", show_default="results 200, ablation 40, scaling 20"
    ),
]
BesideOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--with",
        metavar="LEDGER",
        help="Another ledger to show, of ablations, larger fleets or workflows; may be repeated.",
        show_default="say what is missing",
    ),
]
SensitivityOption = Annotated[
    Path | None,
    typer.Option(
        "--sensitivity", metavar="FILE", help="A file of `study run sensitivity`.", show_default="say how to make one"
    ),
]

NumbersOption = Annotated[
    Path | None,
    typer.Option(
        "--numbers",
        metavar="FILE",
        help="Write all numbers of the report, as JSON; replaced if it exists.",
        show_default="not written",
    ),
]


def examples(*lines: str) -> str:
    """Return the end of a command's help: examples, which a test runs."""
    return "\b\nExamples:\n" + "\n".join(f"  {line}" for line in lines)


def parameters_of(pairs: Sequence[str] | None) -> dict[str, str]:
    """Return the values of `--param name=value`, by name.

    Raises:
        QueryFailed: A pair is not NAME=VALUE, or a name is given twice.
    """
    values: dict[str, str] = {}
    for pair in pairs or ():
        name, equals, value = pair.partition("=")
        if not equals or not name:
            raise QueryFailed(f"--param {pair!r}: expected NAME=VALUE, as in --param robot=robot/A1")
        if name in values:
            raise QueryFailed(
                f"--param {pair!r}: {name} already has the value {values[name]!r}, expected one value for each name"
            )
        values[name] = value
    return values
