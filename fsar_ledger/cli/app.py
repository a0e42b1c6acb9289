"""The command line: its commands, and `run`, which turns a call into an exit code.

Only `terminal.py` prints, and only this module, `progress.py` and the witness's server read a clock. Every command body
imports what it needs, so that `--help` stays quick. A command that fails raises one of the errors of `errors.py`;
`run` turns it into one message on stderr and its exit code: 0 fine, 1 a write failed, a worker was killed or an audit
found something, 2 the call was wrong, 3 the ledger is damaged, 130 interrupted.
"""

import errno
import time
from collections.abc import Sequence
from functools import cache
from typing import Annotated

import typer

from fsar_ledger import printable
from fsar_ledger.errors import FsarLedgerError, named_as_options

from . import (
    audit,
    calibrate,
    compare,
    explain,
    export,
    info,
    judge,
    key,
    metrics,
    multiverse,
    predict,
    prove,
    query,
    recover,
    report,
    reproduce,
    sensitivity,
    simulate,
    sql,
    statistics,
    verify,
    verify_proof,
    witness,
)
from .memory import reading
from .options import require_text
from .terminal import Enough, say, show

INTERRUPTED = 130
CONTINUES = "what is committed stays, and the same command continues there"
AFTER_INTERRUPTION = {
    "simulate": CONTINUES,
    "reproduce": CONTINUES,
    "recover": "what was mended stays; run it again",
} | sensitivity.AFTER_INTERRUPTION

app = typer.Typer(
    name="fsar-ledger",
    help=(
        "Simulate robot fleets under three governance architectures, keep every event in an append-only ledger, and "
        "judge it by SQL."
    ),
    epilog="\b\nStart here:\n  fsar-ledger reproduce              simulate, measure and typeset the paper's "
    "experiment\n"
    "  fsar-ledger simulate out/ledger    only simulate\n  fsar-ledger query --list           every question that has "
    "a name",
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 120},
)


@app.callback(invoke_without_command=True)
def _version(version: Annotated[bool, typer.Option("--version", help="Show the version and exit.")] = False) -> None:
    if version:
        from fsar_ledger import __version__

        show(printable.line(f"fsar-ledger {__version__}"))
        raise typer.Exit(0)


app.command(epilog=simulate.EXAMPLES)(simulate.simulate)
app.command(epilog=info.EXAMPLES)(reading(info.info))
app.command(epilog=metrics.EXAMPLES)(reading(metrics.metrics))
app.command(epilog=statistics.EXAMPLES)(reading(statistics.statistics))
app.command(epilog=compare.EXAMPLES)(reading(compare.compare))
app.command(epilog=multiverse.EXAMPLES)(reading(multiverse.multiverse))
app.command(epilog=query.EXAMPLES)(query.query)
app.command(epilog=sql.EXAMPLES)(sql.sql)
app.command(epilog=export.EXAMPLES)(reading(export.export))
app.command(epilog=audit.EXAMPLES)(reading(audit.audit))
app.command(epilog=verify.EXAMPLES)(reading(verify.verify))
app.command(epilog=prove.EXAMPLES)(reading(prove.prove))
app.command("verify-proof", epilog=verify_proof.EXAMPLES)(verify_proof.verify_proof)
app.add_typer(key.keys, name="key")
app.add_typer(witness.witnesses, name="witness")
app.command(epilog=recover.EXAMPLES)(reading(recover.recover))
app.command(epilog=explain.EXAMPLES)(reading(explain.explain))
app.command(epilog=report.EXAMPLES)(reading(report.report))
app.command(epilog=calibrate.EXAMPLES)(calibrate.calibrate)
app.command(epilog=predict.EXAMPLES)(predict.predict)
app.command(epilog=judge.EXAMPLES)(judge.judge)
app.command(epilog=sensitivity.EXAMPLES)(sensitivity.sensitivity)
app.command(epilog=reproduce.EXAMPLES)(reproduce.reproduce)


_commands = cache(lambda: typer.main.get_command(app))

NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
"""Why a help text that is written by others does not arrive."""


def run(arguments: Sequence[str]) -> int:
    """Run a command; return its exit code. What a user can cause is one message on stderr, never a traceback."""
    try:
        require_text(arguments)
        with named_as_options():
            code = _commands().main(
                args=list(arguments) or ["--help"],
                prog_name="fsar-ledger",
                standalone_mode=False,
                obj=lambda: int(time.time()),
            )
    except Enough:
        return 0
    except FsarLedgerError as problem:
        say(*map(str, problem.args))
        return problem.exit_code
    except typer.TyperException as problem:
        context = getattr(problem, "ctx", None)
        say(f"{problem.format_message()} (see `{context.command_path if context else 'fsar-ledger'} --help`)")
        return problem.exit_code
    except MemoryError:
        say("memory: the system gave no more of it; close other programs, or do less at once")
        return 1
    except OSError as problem:
        if problem.filename is None and problem.errno not in NO_ROOM:
            raise
        say(
            f"{problem.filename}: {problem.strerror}"
            if problem.filename
            else f"the output is incomplete ({problem.strerror}); write it where there is free space"
        )
        return 1
    except KeyboardInterrupt:
        code = INTERRUPTED
    if code == INTERRUPTED:
        say(f"interrupted; {AFTER_INTERRUPTION.get(next(iter(arguments), ''), 'nothing was changed')}")
    return code if isinstance(code, int) else 0
