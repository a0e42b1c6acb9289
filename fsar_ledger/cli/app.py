"""The typer application, and `run`, which turns a call into an exit code.

A command is a verb (`api/verbs.py`). Only `terminal.py` prints, and only this package reads a clock. Verbs import what
they need when they are called, so that `--help` stays fast. A command that fails raises an error of `errors.py`; `run`
turns it into one message on stderr and its exit code: 0 fine, 1 a write failed, a worker was killed or an audit found
something, 2 the call was wrong, 3 the ledger is damaged, 130 interrupted.
"""

import errno
import re
import time
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from importlib import import_module
from itertools import chain
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from fsar_ledger import __version__
from fsar_ledger.api.verbs import NOTHING_CHANGED, VERBS, Verb, help_in
from fsar_ledger.base import printable
from fsar_ledger.base.errors import FsarLedgerError, UsageError, named_as_options

from .building import command
from .terminal import OutputClosed, say, show

INTERRUPTED = 130
GROUPS = {
    "Record": ("simulate", "record", "import", "federate", "hand-over", "serve", "principal", "demo", "shards"),
    "Ask": (
        *("info", "metrics", "statistics", "compare"),
        *("query", "sql", "export", "open", "explain", "log"),
    ),
    "Replay": ("state", "step", "why", "diff", "whatif", "cause", "bisect", "view"),
    "Prove": ("audit", "verify", "prove", "verify-proof", "key", "witness"),
    "The paper": ("reproduce", "report", "study"),
    "Maintain": ("maintain",),
}
"""The commands in the groups and the order of the help."""
FAMILIES = {
    "key": "Make keys that sign ledgers.",
    "maintain": "Repair a ledger, convert it to the present format, or merge its segments.",
    "principal": "Register the robots, people and programs that may use a service.",
    "study": "Run a study of the model, or show the result of one.",
    "study run": "Run a study.",
    "witness": "Run a witness, which checks that ledgers only grow, or have your own ledger cosigned by witnesses.",
}
"""The help of each group of commands whose names begin with the same words."""
HOMES = {
    "demo": ("fsar_ledger.api.serve",),
    "hand-over": ("fsar_ledger.api.federate",),
    "import": ("fsar_ledger.api.record",),
    "open": ("fsar_ledger.api.export",),
    "principal": ("fsar_ledger.api.serve",),
    "reproduce": ("fsar_ledger.api.report",),
    "shards": ("fsar_ledger.api.record",),
    "sql": ("fsar_ledger.api.query",),
    "statistics": ("fsar_ledger.api.metrics",),
    "step": ("fsar_ledger.api.state",),
    "study": ("fsar_ledger.studies.verbs", "fsar_ledger.api.metrics"),
    "verify-proof": ("fsar_ledger.api.prove",),
    "witness": ("fsar_ledger.api.key",),
}
"""The modules of verbs that are not in the API module of the same name."""


class Commands(Mapping[str, Any]):
    """The commands by name; each is created when it is asked for, since a call needs only one."""

    def __iter__(self) -> Iterator[str]:
        return chain.from_iterable(GROUPS.values())

    def __len__(self) -> int:
        return sum(map(len, GROUPS.values()))

    def __getitem__(self, name: str) -> Any:
        if name not in list(self):
            raise KeyError(name)
        return _build_command(name, _verbs(name))


class Family(TyperGroup):
    """A group of commands whose names begin with the same words."""

    def format_commands(self, _: Any, formatter: Any) -> None:
        """Write the first line of the help of each command, whole."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, (child.help or "").partition("\n")[0]) for name, child in self.commands.items()])


class Verbs(TyperGroup):
    """All commands, in groups."""

    def __init__(self, **given: Any) -> None:
        super().__init__(**given)
        self.commands = Commands()  # type: ignore[assignment]  # nothing adds to it

    def list_commands(self, _: Any) -> list[str]:
        """Return the names of the commands in the order of the help."""
        return list(self.commands)

    def format_commands(self, _: Any, formatter: Any) -> None:
        """Write what each command does, group by group."""
        for group, names in GROUPS.items():
            with formatter.section(group):
                formatter.write_dl([(name, _summary(name)) for name in names])


def _verbs(name: str) -> list[Verb]:
    """Return the verbs whose names are or begin with this word, from the module that declares them."""
    homes = _homes(name)
    for home in homes:
        import_module(home)
    verbs = [verb for verb in VERBS.values() if verb.name.partition(" ")[0] == name]
    return sorted(verbs, key=lambda verb: homes.index(verb.function.__module__))


def _homes(name: str) -> tuple[str, ...]:
    return HOMES.get(name, (f"fsar_ledger.api.{name}",))


def _summary(name: str) -> str:
    """Return the first line of the help of a command.

    It is read from the source, since importing every module takes longer than the rest of the help.
    """
    if name in FAMILIES:
        return FAMILIES[name]
    path = Path(__file__).parents[1] / f"api/{_homes(name)[0].rpartition('.')[2]}.py"
    source = path.read_text("utf-8")
    by_function = rf'^def {name.replace("-", "_")}\(.*?"""(.*?)$'
    by_name = rf'^    name="{name}",$.*?^def \w+\(.*?"""(.*?)$'
    match = re.search(by_name, source, re.DOTALL | re.MULTILINE) or re.search(
        by_function, source, re.DOTALL | re.MULTILINE
    )
    assert match is not None, f"{path}: found no docstring of {name}, expected one"
    return help_in(match[1].removesuffix('"""'))


def _build_command(words: str, verbs: Sequence[Verb]) -> Any:
    """Return the command of the verb of this name, or the family of those that begin with these words."""
    if words not in FAMILIES:
        return command(next(verb for verb in verbs if verb.name == words), words.rpartition(" ")[2])
    next_words = dict.fromkeys(
        verb.name.split()[len(words.split())] for verb in verbs if verb.name.startswith(f"{words} ")
    )
    family = Family(name=words.rpartition(" ")[2], help=FAMILIES[words], rich_markup_mode=None)
    for word in next_words:
        family.add_command(_build_command(f"{words} {word}", verbs), word)
    return family


def _left_by(arguments: Sequence[str]) -> str:
    line = f"{' '.join(arguments)} "
    return next(
        (verb.after_interruption for verb in VERBS.values() if line.startswith(f"{verb.name} ")),
        NOTHING_CHANGED,
    )


app = typer.Typer(
    name="fsar-ledger",
    cls=Verbs,
    help=(
        "Simulate robot fleets under several governance architectures, keep every event in an append-only ledger, and "
        "judge it in SQL."
    ),
    epilog="\b\nStart here:\n  fsar-ledger reproduce              run the paper's experiments and report\n"
    "  fsar-ledger simulate out/ledger    only simulate\n"
    "  fsar-ledger query --list           list the packaged queries",
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 120},
)


@app.callback(invoke_without_command=True)
def _version(version: Annotated[bool, typer.Option("--version", help="Show the version and exit.")] = False) -> None:
    if version:
        show(printable.line(f"fsar-ledger {__version__}"))
        raise typer.Exit(0)


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
    except OutputClosed:
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
        say(f"interrupted; {_left_by(arguments)}")
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
