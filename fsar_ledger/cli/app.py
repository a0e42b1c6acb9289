"""The command line: its commands, and `run`, which turns a call into an exit code.

Only `terminal.py` prints, and only this module, `progress.py` and the witness's server read a clock. Every command body
imports what it needs, so that `--help` stays quick. A command that fails raises one of the errors of `errors.py`;
`run` turns it into one message on stderr and its exit code: 0 fine, 1 a write failed, a worker was killed or an audit
found something, 2 the call was wrong, 3 the ledger is damaged, 130 interrupted.
"""

import errno
import time
from collections.abc import Sequence
from contextlib import nullcontext
from functools import cache
from pathlib import Path
from typing import Annotated

import typer

from fsar_ledger import printable
from fsar_ledger.errors import FsarLedgerError

from . import fitting, judging, multiverse, recover, reporting, sensitivity, sides, trust, witness
from .memory import bounded, reading
from .options import (
    WORTH_ROBOTS,
    AdoptOption,
    ArchitectureOption,
    AuditedOption,
    CsvOption,
    FailureOption,
    FileOption,
    FleetSizeOption,
    InvariantOption,
    JsonOption,
    KeyOption,
    LedgerArgument,
    LimitOption,
    MemoryOption,
    NewLedgerArgument,
    OnlyOption,
    OriginOption,
    ParameterOption,
    PdfOption,
    QueryMemoryOption,
    RawOption,
    ReproducedRunsOption,
    RequestOption,
    RunOption,
    RunsOption,
    ScenarioOption,
    SecondsOption,
    SvgOption,
    TaskSetsOption,
    TeamsWorkingOption,
    VerifiedOption,
    WithoutOption,
    WorkersOption,
    WorkflowOption,
    examples,
    experiment_of,
    parameters_of,
    require_text,
    workers_of,
)
from .progress import Progress
from .terminal import Enough
from .terminal import say as _say
from .terminal import show as _show

INTERRUPTED = 130
CONTINUES = "what is committed stays, and the same command continues there"
AFTER_INTERRUPTION = {
    "simulate": CONTINUES,
    "reproduce": CONTINUES,
    "recover": "what was mended stays; run it again",
} | sensitivity.AFTER_INTERRUPTION
SHOWN_ROWS = 100

app = typer.Typer(
    name="fsar-ledger",
    help="Simulate robot fleets under three governance architectures, keep every event in an append-only ledger, and judge it by SQL.",
    epilog="\b\nStart here:\n  fsar-ledger reproduce              simulate, measure and typeset the paper's experiment\n"
    "  fsar-ledger simulate out/ledger    only simulate\n  fsar-ledger query --list           every question that has a name",
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 120},
)


@app.callback(invoke_without_command=True)
def _version(version: Annotated[bool, typer.Option("--version", help="Show the version and exit.")] = False) -> None:
    if version:
        from fsar_ledger import __version__

        _show(printable.line(f"fsar-ledger {__version__}"))
        raise typer.Exit(0)


@app.command(
    epilog=examples(
        "fsar-ledger simulate out/ledger",
        "fsar-ledger simulate out/doors --architecture fsar --scenario door-relay --runs 3 --seed 7",
        "fsar-ledger simulate out/doors --architecture fsar --scenario door-relay --runs 5 --seed 7    # enlarges it",
        "fsar-ledger simulate out/untrusting --without trust-evaluation --runs 2",
        "fsar-ledger simulate out/workflows --workflow door-relay --workflow layered-recovery --workflow human-supervision",
        "fsar-ledger simulate out/signed --scenario door-relay --runs 1 --key out/fleet.key",
        "fsar-ledger simulate out/named --scenario door-relay --runs 1 --origin example.org/fleet",
        "fsar-ledger simulate out/large --architecture cfc --scenario fleet-contention --fleet-size 16 --teams-working 2 --runs 2",
    )
)
def simulate(
    out: NewLedgerArgument,
    architecture: ArchitectureOption = None,
    scenario: ScenarioOption = None,
    workflow: WorkflowOption = None,
    runs: RunsOption = None,
    seed: Annotated[int, typer.Option(metavar="N", help="Decides every draw of the world.")] = 42,
    fleet_size: FleetSizeOption = 4,
    teams_working: TeamsWorkingOption = None,
    task_sets: TaskSetsOption = 1,
    without: WithoutOption = None,
    origin: OriginOption = None,
    key: KeyOption = None,
    adopt: AdoptOption = False,
    workers: WorkersOption = None,
    as_json: JsonOption = False,
) -> None:
    """Simulate fleets; every event is appended to the ledger OUT.

    An interrupted simulation continues where it stopped when it is called again; with more --runs, or other scenarios, it enlarges what is there.
    """
    from fsar_ledger.runtime.experiment import carry_out

    from .simulated import simulated_text

    experiment = experiment_of(
        architecture, scenario, runs, seed, fleet_size, without, workflow, (teams_working, task_sets)
    )
    signer = trust.signer_of(key, adopts=adopt)
    processes = workers_of(workers, experiment.size * experiment.fleet_size // WORTH_ROBOTS)
    with Progress("simulated", "batches") as progress:
        made = carry_out(out, experiment, processes, progress, signer, trust.origin_of(origin), adopts=adopt)
    _show(simulated_text(out, made, trust.signed_lines(out, signer), as_json=as_json))


@app.command(epilog=examples("fsar-ledger info out/ledger", "fsar-ledger info out/ledger --json"))
@reading
def info(ledger: LedgerArgument, verified: VerifiedOption = False, as_json: JsonOption = False) -> None:
    """Show what a ledger holds, and whether it is complete.

    Its head, what was planned and what of it is there, its runs by model, seed, fleet size, architecture and configuration, and (with --json) the
    parameters of its worlds. Without a plan on record nothing says what is missing.
    """
    from .contents import contents
    from .output import json_text, table_text

    head, found = contents(ledger, verified=verified)
    if as_json:
        _show(json_text(head, {"ledger": str(ledger), "commits": head.commits, **found.answer()}, found.rows_verified))
        return
    standing = "" if found.rows_verified else " (the rows were not compared with it)"
    _show(
        printable.lines(
            f"{ledger}: {printable.counted(head.size, 'event')} in {printable.counted(head.commits, 'commit')}",
            f"root {head.root}{standing}",
            *found.summary(),
        )
    )
    if rows := found.rows():
        _show(printable.joined(printable.line(""), table_text(rows, list(rows[0]))))


app.command(epilog=judging.METRICS)(reading(judging.metrics))
app.command(epilog=judging.STATISTICS)(reading(judging.statistics))
app.command(epilog=sides.COMPARE)(reading(sides.compare))
app.command(epilog=multiverse.MULTIVERSE)(reading(multiverse.multiverse))


@app.command(
    epilog=examples(
        "fsar-ledger query --list",
        "fsar-ledger query metrics/policy_violations out/ledger --csv",
        "fsar-ledger query failures out/ledger --limit 20",
        "fsar-ledger query --file question.sql out/ledger --seconds 10",
    )
)
def query(
    name: Annotated[
        str | None,
        typer.Argument(metavar="NAME", help="A name of `query --list`; its last part is enough.", show_default=False),
    ] = None,
    ledger: Annotated[
        Path | None, typer.Argument(metavar="LEDGER", help="The folder of a ledger.", show_default=False)
    ] = None,
    param: ParameterOption = None,
    file: FileOption = None,
    list_all: Annotated[bool, typer.Option("--list", help="List every query with its title and parameters.")] = False,
    as_json: JsonOption = False,
    as_csv: CsvOption = False,
    raw: RawOption = False,
    limit: LimitOption = SHOWN_ROWS,
    verified: VerifiedOption = False,
    seconds: SecondsOption = None,
    memory: QueryMemoryOption = None,
) -> None:
    """Answer a question that has a name, or that stands in a file.

    The questions are the SQL files that come with the package; each says in its header what its rows and its NULLs mean. A file of
    your own is answered as `sql` answers, locked down; a name is not, and takes as long as it takes, within --memory.
    """
    from .output import queries_text
    from .questions import answer_query

    if list_all:
        _show(queries_text(as_json=as_json, as_csv=as_csv, raw=raw), raw=raw)
        return
    own = {"--seconds": seconds, "--memory": memory}
    with nullcontext() if file else bounded(memory, ledger):
        places = (name, ledger)
        for piece in answer_query(
            places,
            file,
            parameters_of(param),
            own,
            as_json=as_json,
            as_csv=as_csv,
            raw=raw,
            limit=limit,
            verified=verified,
        ):
            _show(piece, raw=raw)


@app.command(
    epilog=examples(
        'fsar-ledger sql out/ledger "SELECT type, count(*) AS events FROM events GROUP BY type ORDER BY events DESC"',
        "fsar-ledger sql out/ledger \"SELECT * FROM request_denied WHERE run_id LIKE '%door-relay%'\" --csv",
    )
)
def sql(
    ledger: LedgerArgument,
    select: Annotated[str, typer.Argument(metavar="SELECT", help="One SELECT in DuckDB's SQL.", show_default=False)],
    as_json: JsonOption = False,
    as_csv: CsvOption = False,
    raw: RawOption = False,
    limit: LimitOption = SHOWN_ROWS,
    verified: VerifiedOption = False,
    seconds: SecondsOption = None,
    memory: MemoryOption = None,
) -> None:
    """Answer a SELECT of your own.

    It can read `events`, one view for each event type, and the views of `query --list`; it runs in a locked-down process that can read
    this ledger and nothing else.
    """
    from .questions import answer_select, limits_of

    limits = limits_of({"--seconds": seconds, "--memory": memory})
    for piece in answer_select(
        ledger, select, limits, as_json=as_json, as_csv=as_csv, raw=raw, limit=limit, verified=verified
    ):
        _show(piece, raw=raw)


@app.command(
    epilog=examples(
        "fsar-ledger export out/ledger --out out/events.parquet",
        "fsar-ledger export out/ledger --query metrics/run_metrics --out out/run_metrics.csv",
    )
)
@reading
def export(
    ledger: LedgerArgument,
    out: Annotated[
        Path,
        typer.Option(
            "--out", metavar="FILE", help="A .csv or .parquet file; replaced if it exists.", show_default=False
        ),
    ],
    name: Annotated[
        str | None,
        typer.Option("--query", metavar="NAME", help="Export the answer of this query.", show_default="every event"),
    ] = None,
    param: ParameterOption = None,
    raw: RawOption = False,
    verified: VerifiedOption = False,
) -> None:
    """Write events, or the answer of a query, to a file.

    The format, CSV or Parquet, follows from the name of the file; lists are JSON text in CSV. Text in CSV is made harmless for spreadsheets and
    terminals unless --raw is given; Parquet always holds the values themselves.
    """
    from .files import export_events, export_query

    given = {"raw": raw, "verified": verified}
    rows = (
        export_events(ledger, out, **given)
        if name is None
        else export_query(ledger, name, parameters_of(param), out, **given)
    )
    _show(printable.line(f"{out}: {rows:,} rows"))


@app.command(
    epilog=examples(
        "fsar-ledger audit out/ledger --architecture fsar",
        "fsar-ledger audit out/ledger --architecture fsar --invariant i4 --json",
    )
)
@reading
def audit(
    ledger: LedgerArgument,
    invariant: InvariantOption = None,
    architecture: AuditedOption = None,
    verified: VerifiedOption = False,
    as_json: JsonOption = False,
) -> None:
    """Check the invariants I1 to I5 and A1 to A5.

    Counts the events that offend each, by architecture and configuration, and names the first. Exit code 0 if all hold on all runs, else 1.
    """
    from .audit import audit as check

    text, holds = check(ledger, invariant or (), architecture or (), as_json=as_json, verified=verified)
    _show(text)
    if not holds:
        raise typer.Exit(1)


app.command(epilog=trust.VERIFY)(reading(trust.verify))
app.command(epilog=trust.PROVE)(reading(trust.prove))
app.command("verify-proof", epilog=trust.VERIFY_PROOF)(trust.verify_proof)
app.add_typer(trust.keys, name="key")
app.add_typer(witness.witnesses, name="witness")
app.command(epilog=recover.RECOVER)(reading(recover.recover))


@app.command(
    epilog=examples(
        "fsar-ledger explain out/ledger",
        "fsar-ledger explain out/ledger --request A1-1/2.1",
        "fsar-ledger explain out/ledger --run cfc.full.door-relay --request A1-1/2.1 --svg out/request.svg",
        "fsar-ledger explain out/ledger --run fsar.full.failure-recovery-chain --json",
    )
)
@reading
def explain(
    ledger: LedgerArgument,
    run: RunOption = None,
    request: RequestOption = None,
    failure: FailureOption = None,
    svg: SvgOption = None,
    pdf: PdfOption = None,
    verified: VerifiedOption = False,
    as_json: JsonOption = False,
) -> None:
    """Tell the story of a request: who asked, who allowed, who acted, who supervised.

    For a request that failed also what recovery tried at each level, for how long, and why it went on. Without --request or --failure: the
    requests of the run.
    """
    from .explain import explain as tell

    _show(tell(ledger, run, request, failure, {"svg": svg, "pdf": pdf}, as_json=as_json, verified=verified))


app.command(epilog=reporting.REPORT)(reading(reporting.report))


app.command(epilog=fitting.CALIBRATE)(fitting.calibrate)
app.command(epilog=fitting.PREDICT)(fitting.predict)
app.command(epilog=fitting.JUDGE)(fitting.judge)


app.command(epilog=sensitivity.SENSITIVITY)(sensitivity.sensitivity)


@app.command(epilog=examples("fsar-ledger reproduce", "fsar-ledger reproduce --out out/paper --only results --runs 20"))
def reproduce(
    out: Annotated[
        Path, typer.Option("--out", metavar="FOLDER", help="Where the ledgers, the tables and the report go.")
    ] = Path("fsar-out"),
    only: OnlyOption = None,
    runs: ReproducedRunsOption = None,
    key: KeyOption = None,
    adopt: AdoptOption = False,
    workers: WorkersOption = None,
) -> None:
    """Do the paper's experiments, judge them, typeset the report.

    FOLDER then holds report.pdf, its numbers as reproduction.json, metrics.csv, statistics.csv and a ledger of each experiment: results/, ablation/,
    scaling/ and workflows/.
    The key signs results/ under its name NAME, and the others under NAME/ablation, NAME/scaling and NAME/workflows: no two trees have one origin.
    """
    from .reproduce import reproduce as do

    began = time.monotonic()
    text, head = do(out, workers_of(workers), trust.signer_of(key, adopts=adopt), adopts=adopt, only=only, runs=runs)
    took = f"{head.size:,} events, root {head.root}, {time.monotonic() - began:.0f} s"
    _show(printable.joined(text, printable.lines("", took, str(out / "report.pdf"))))


_commands = cache(lambda: typer.main.get_command(app))

NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
"""Why a help text that is written by others does not arrive."""


def run(arguments: Sequence[str]) -> int:
    """The command has run; returns its exit code. What a user can cause is one message on stderr, never a traceback."""
    try:
        require_text(arguments)
        code = _commands().main(
            args=list(arguments) or ["--help"],
            prog_name="fsar-ledger",
            standalone_mode=False,
            obj=lambda: int(time.time()),
        )
    except Enough:
        return 0
    except FsarLedgerError as problem:
        _say(*map(str, problem.args))
        return problem.exit_code
    except typer.TyperException as problem:
        context = getattr(problem, "ctx", None)
        _say(f"{problem.format_message()} (see `{context.command_path if context else 'fsar-ledger'} --help`)")
        return problem.exit_code
    except MemoryError:
        _say("memory: the system gave no more of it; close other programs, or do less at once")
        return 1
    except OSError as problem:
        if problem.filename is None and problem.errno not in NO_ROOM:
            raise
        _say(
            f"{problem.filename}: {problem.strerror}"
            if problem.filename
            else f"the output is incomplete ({problem.strerror}); write it where there is free space"
        )
        return 1
    except KeyboardInterrupt:
        code = INTERRUPTED
    if code == INTERRUPTED:
        _say(f"interrupted; {AFTER_INTERRUPTION.get(next(iter(arguments), ''), 'nothing was changed')}")
    return code if isinstance(code, int) else 0
