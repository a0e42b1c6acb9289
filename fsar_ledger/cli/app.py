"""The typer application, and `run`, which turns a call into an exit code.

Every module of `commands` is a command. Only `terminal.py` prints, and only this module, `progress.py` and the
witness's server read a clock. Commands import what they need when they run, so that `--help` stays quick. A command
that fails raises an error of `errors.py`; `run` turns it into one message on stderr and its exit code: 0 fine, 1 a
write failed, a worker was killed or an audit found something, 2 the call was wrong, 3 the ledger is damaged, 130
interrupted.
"""

import errno
import time
from collections.abc import Sequence
from functools import cache
from importlib import import_module
from pkgutil import iter_modules
from typing import Annotated

import typer

from fsar_ledger import printable
from fsar_ledger.errors import FsarLedgerError, UsageError, named_as_options

from . import commands
from .commands import study
from .memory import reading
from .once import Command
from .terminal import Enough, say, show

INTERRUPTED = 130
ORDER = (
    *("simulate", "info", "metrics", "statistics", "compare"),
    *("query", "sql", "export", "open", "explain", "log"),
    *("state", "step", "why", "diff", "whatif", "cause", "bisect", "view"),
    *("audit", "verify", "prove", "verify_proof", "key", "witness", "recover", "upgrade", "compact", "report"),
    *("study", "reproduce"),
)
"""The commands in the order of the help; those that are not named here follow."""

app = typer.Typer(
    name="fsar-ledger",
    help=(
        "Simulate robot fleets under three governance architectures, keep every event in an append-only ledger, and "
        "judge it by SQL."
    ),
    epilog="\b\nStart here:\n  fsar-ledger reproduce              run the paper's experiments and report\n"
    "  fsar-ledger simulate out/ledger    only simulate\n"
    "  fsar-ledger query --list           every question that has a name",
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


def _register() -> None:
    """Register every module of `commands`."""
    names = {module.name: len(ORDER) for module in iter_modules(commands.__path__)}
    names |= {name: place for place, name in enumerate(ORDER)}
    for name in sorted(names, key=lambda one: (names[one], one)):
        module = import_module(f"{commands.__name__}.{name}")
        if hasattr(module, "group"):
            _once(module.group)
            app.add_typer(module.group, name=name)
            AFTER_INTERRUPTION.update(getattr(module, "AFTER_INTERRUPTION", {}))
        else:
            register = app.command(name.replace("_", "-"), cls=Command, epilog=module.EXAMPLES)
            register(reading(getattr(module, name)))
            if hasattr(module, "AFTER_INTERRUPTION"):
                AFTER_INTERRUPTION[name] = module.AFTER_INTERRUPTION
    for one in study.run.registered_commands:
        if one.name is not None and one.callback is not None:
            app.command(study.OLD_NAMES[one.name], cls=Command, epilog=one.epilog, hidden=True)(one.callback)


def _once(group: typer.Typer) -> None:
    """Let all commands of a group, and of groups in it, refuse an option that is given twice."""
    for one in group.registered_commands:
        one.cls = Command
    for inner in group.registered_groups:
        if inner.typer_instance is not None:
            _once(inner.typer_instance)


AFTER_INTERRUPTION: dict[str, str] = {}
"""By command, what an interrupted call leaves; other commands change nothing."""

_register()
_commands = cache(lambda: typer.main.get_command(app))

NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
"""Errors of writing that name no file: typer could not write a help text."""


def run(arguments: Sequence[str]) -> int:
    """Run a command and return its exit code. A user's mistake is one message on stderr, never a traceback."""
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
        say("out of memory; close other programs, or do less at once")
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
        called = " ".join([*arguments, ""])
        left = next((left for one, left in AFTER_INTERRUPTION.items() if called.startswith(f"{one} ")), None)
        say(f"interrupted; {left or 'nothing was changed'}")
    return code if isinstance(code, int) else 0


def require_text(arguments: Sequence[str]) -> None:
    """Check that every argument is UTF-8, since it may be a path, and DuckDB and JSON can name no other.

    Raises: UsageError if one is not.
    """
    for argument in arguments:
        if argument.encode("utf-8", "replace").decode() != argument:
            raise UsageError(
                f"{argument}: found bytes that are not UTF-8, expected UTF-8 in every path and option; give it "
                "another name"
            )
