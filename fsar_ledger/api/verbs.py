"""What a verb is: one function, whose signature and docstring are those of Python and of the command line.

A parameter of a verb has its declaration in place of its default (`declare`, `switch`, `argument`), which names the
true default; a parameter that must be given, and one that several verbs share, has an `Option` in its annotation.
`cli/building.py` makes the options of the command of them, and the docstring gets its `Args:` from them. A parameter
without one is for Python alone.
Modules of verbs are imported to show a help text, so they import what takes time inside their functions.

The number of processes that a piece of work is worth is told here, too (`workers_of`), beside the option for it.
"""

import inspect
import os
import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, TypeVar

from fsar_ledger.base.errors import UsageError, option

from .names import By, Names, Place, Pool, Run, require_whole

if TYPE_CHECKING:
    from .ledger import Ledger

RUNTIME = Path(__file__).resolve().parents[1] / "runtime"
_Function = TypeVar("_Function", bound=Callable[..., Any])

JSON = ("verified", "json")
"""What every verb takes whose answer holds for a ledger: compare its rows first, and answer as JSON."""
WIDE = (*JSON, "wide")
"""What also those take whose text has a table."""
ROWS = (*JSON, "csv", "ndjson", "raw", "wide")
"""What those take whose answer is rows."""
STREAM = (*JSON, "csv", "ndjson", "raw", "limit", "wide")
"""What those take whose answer can be long."""

NOTHING_CHANGED = "nothing was changed"
"""What most interrupted calls leave."""


def either(names: Iterable[str]) -> str:
    """Return the names, sorted, as a choice."""
    *others, last = sorted(names)
    return f"{', '.join(others)} or {last}"


class Option(NamedTuple):
    """An option of the command line, or an argument if it has no flag; a switch has no metavar.

    `default` says what holds without it, where the value of the parameter does not. `complete` names the
    values that a shell is offered (`cli/building.py`).
    """

    flag: str | None
    metavar: str | None
    help: str
    default: str | None = None
    complete: str | None = None
    least: int | None = None
    most: int | None = None
    environment: str | None = None
    value: Any = None
    """The value of the parameter without it, where it stands in place of that."""


class Shows(NamedTuple):
    """The command line shows the progress of the call, in these words; it is no option.

    `instead` has other verbs for calls with a switch.
    """

    verb: str
    unit: str
    instead: Mapping[str, str] = {}


class Gives(NamedTuple):
    """The command line gives one of these; it is no option.

    `now`: the present time, in seconds since 1970, and `clock`: a function that returns it. `ticks`: a function that
    returns seconds that never go back. `pause`: a function that waits so many seconds, and ends when nobody reads any
    more. `say`: a function that tells the operator a line. `show`: one that shows a part of the answer. `showing`: as
    `base.progress.Showing`. `walk`: lets a user walk through a run by keys; None where there are none.
    """

    what: Literal["now", "clock", "ticks", "pause", "say", "show", "showing", "walk"]


class Verb(NamedTuple):
    """A verb: its name on the command line, its function, and the rest of what `verb` declares."""

    name: str
    function: Callable[..., Any]
    call: Callable[..., Any]
    takes: tuple[str, ...]
    examples: tuple[str, ...]
    beside: Mapping[str, Option]
    after_interruption: str
    is_apart: Callable[[Mapping[str, Any]], bool]
    arrange: Callable[[dict[str, Any]], None]
    memory_factor: int

    @property
    def parameters(self) -> dict[str, inspect.Parameter]:
        """Return the parameters of the function, then those that `call` adds; a default of `call` counts."""
        found = dict(inspect.signature(self.function).parameters)
        for name, one in inspect.signature(self.call).parameters.items():
            if name not in found and declared(one) is not None:
                found[name] = one
            elif name in found and one.default is not inspect.Parameter.empty:
                found[name] = found[name].replace(default=one.default)
        return found

    @property
    def help(self) -> str:
        """Return the text that Python and the command line share."""
        return help_in(inspect.getdoc(self.function) or "")


VERBS: dict[str, Verb] = {}
"""The verbs of the modules that are imported, by name."""


def help_in(docstring: str) -> str:
    """Return the docstring up to its sections, of which `Raises:` may also follow on the first line."""
    return re.split(r"\s+(?:Args|Raises):", docstring)[0]


def declare(metavar: str | None, help: str, default: str | None = None, *, flag: str = "", **more: Any) -> Any:
    """Declare an option, in place of the default of its parameter, which is `value`; `flag`: if not the name of it.

    `default` is what the help says in place of that value, as "all" for None.
    """
    return Option(flag, metavar, help, default, **more)


def switch(help: str, *, flag: str = "") -> Any:
    """Declare a switch, in place of the default of its parameter, which is False."""
    return Option(flag, None, help, value=False)


def argument(metavar: str, help: str, default: str | None = None, **more: Any) -> Any:
    """Declare an argument, in an annotation or as `declare`."""
    return Option(None, metavar, help, default, **more)


def verb(
    *examples: str,
    takes: tuple[str, ...] = WIDE,
    name: str | None = None,
    call: Callable[..., Any] | None = None,
    beside: Mapping[str, Option] = {},
    after_interruption: str = NOTHING_CHANGED,
    is_apart: Callable[[Mapping[str, Any]], bool] = lambda _: False,
    arrange: Callable[[dict[str, Any]], None] = lambda _: None,
    memory_factor: int = 1,
) -> Callable[[_Function], _Function]:
    """Register a function as a verb of the command line, with calls that show how it is used.

    Args:
        examples: Calls without the name of the program, which a test runs, and other lines of a shell.
        takes: What the command takes beside the parameters of the function.
        name: The name on the command line; None: that of the function.
        call: Answers the command instead, with the same parameters and those that it declares.
        beside: Switches that the text of the answer looks at (`Screen.has`).
        after_interruption: What an interrupted call leaves.
        is_apart: Whether a call with these values works in a process that has a memory limit of its own.
        arrange: Changes the values of a call before its ledgers are opened.
        memory_factor: How many times the memory of other commands this one may take for each byte of the segments.
    """

    def register(function: _Function) -> _Function:
        _settle(function)
        if call is not None:
            _settle(call)
        called = name or function.__name__.replace("_", "-")
        calls = tuple(f"fsar-ledger {one}" if one.startswith(called) else one for one in examples)
        VERBS[called] = Verb(
            called,
            function,
            call or function,
            takes,
            calls,
            beside,
            after_interruption,
            is_apart,
            arrange,
            memory_factor,
        )
        function.__doc__ = _documented(function)
        return function

    return register


def _settle(function: Callable[..., Any]) -> None:
    """Give each parameter whose default is a declaration its true default, and the declaration as an annotation."""
    settled = []
    for name, one in inspect.signature(function).parameters.items():
        if isinstance(found := one.default, Option):
            found = found._replace(flag=f"--{name.replace('_', '-')}") if found.flag == "" else found
            one = one.replace(annotation=Annotated[one.annotation, found], default=found.value)
        settled.append(one)
    plain = [one for one in settled if one.kind is not one.KEYWORD_ONLY]
    function.__defaults__ = tuple(one.default for one in plain if one.default is not one.empty)
    function.__kwdefaults__ = {
        one.name: one.default for one in settled if one.kind is one.KEYWORD_ONLY and one.default is not one.empty
    }
    function.__annotations__.update({one.name: one.annotation for one in settled if one.annotation is not one.empty})


def declared(parameter: inspect.Parameter) -> Option | Shows | Gives | None:
    """Return what the annotation of a parameter declares."""
    found = getattr(parameter.annotation, "__metadata__", ())
    return next((one for one in found if isinstance(one, Option | Shows | Gives)), None)


def _documented(function: Callable[..., Any]) -> str:
    """Return the docstring with a line for each declared parameter."""
    text = inspect.getdoc(function) or ""
    options = ((one.name, declared(one)) for one in inspect.signature(function).parameters.values())
    lines = [f"    {name}: {one.help}" for name, one in options if isinstance(one, Option)]
    if not lines or "\n\nArgs:" in text:
        return text
    before, raises, after = text.partition("\n\nRaises:")
    return "\n".join([f"{before}\n\nArgs:", *lines]) + raises + after


AnswersOption = Annotated[
    str | None,
    Option(
        "--answers",
        "model:SEED",
        "In the fork of a live run, let the simulation model give the answers that are not on record.",
        "nobody",
    ),
]
ByOption = Annotated[By, Option("--by", "scenario", "One row for each scenario.")]
PoolOption = Annotated[Pool, Option("--pool", "seeds", "Pool the runs of all seeds.", "each seed by itself")]
InvariantOption = Annotated[
    Names,
    Option(
        "--invariant",
        "NAME",
        "i1 to i5 or a1 to a5, or a whole name; may be repeated.",
        "all ten",
        complete="invariants",
    ),
]
ONE_ARCHITECTURE = either(file.parent.name for file in RUNTIME.glob("architectures/*/__init__.py"))
"""Which there are, by their folders; to import them would slow `--help` down."""
ArchitectureOption = Annotated[
    Names,
    Option(
        "--architecture",
        "NAME",
        f"Only the runs of {ONE_ARCHITECTURE}; may be repeated.",
        "all",
        complete="architectures",
    ),
]
SIDE = (
    "ARCHITECTURE[:CONFIGURATION][@CONSTANTS][/ROBOTS]: `fsar`, `fsar:without-layered-recovery`, `cfc@B`, "
    "`dhma/8`; constants by the letters of `info`."
)
FirstOption = Annotated[str | None, Option("--first", "NAME", SIDE, "the first of two")]
SecondOption = Annotated[
    str | None, Option("--second", "NAME", "The same; of OTHER, if it is given.", "the other of two")
]
OtherArgument = Annotated["Ledger | Place | None", argument("OTHER", "The ledger of the second side.", "the same")]
OneRunOption = Annotated[
    Run, Option("--run", "RUN", "A run: its number, its name, or a unique part of it.", complete="runs")
]
TrustedKeyOption = Annotated[
    str | None,
    Option("--trusted-key", "KEY", "Require the signature of this public key: a .pub file, or the key itself."),
]
RAW = Option("--raw", None, "Do not escape text in CSV, not even control characters and spreadsheet formulas.")
RawOption = Annotated[bool, RAW]
ParameterOption = Annotated[
    Mapping[str, object] | None,
    Option("--param", "NAME=VALUE", "A parameter of the query; may be repeated.", complete="parameters"),
]
KeyOption = Annotated[
    Place | None,
    Option(
        "--key",
        "FILE",
        "Sign with this key, of `fsar-ledger key new`.",
        "leave the ledger unsigned",
        environment="FSAR_LEDGER_KEY",
    ),
]
AdoptOption = Annotated[
    bool, Option("--adopt", None, "Continue a ledger that another key signed, or none; verify it first.")
]
WorkersOption = Annotated[
    int | None,
    Option(
        "--workers",
        "N",
        "Processes at once; the answer is the same for any number.",
        "one per core, if there is enough to do",
    ),
]


WORTH_ROBOTS = 320
"""Robots, summed over all runs, whose simulation takes about as long as a process takes to start (0.4 s)."""

LOG_BYTES = 1 << 24
"""More than the segments of the log of a federation have, whose events are few: only smaller ledgers may be one."""

WORTH_BYTES = 400 << 10
"""Bytes of segments whose verification takes about as long as a process takes to start (0.4 s)."""


def workers_of(asked: int | None, worth: int | None = None) -> int:
    """Return the number of processes: as asked, else of the cluster, else one per core, no more than the work is worth.

    Raises:
        UsageError: Fewer than one was asked for, or no whole number.
    """
    from fsar_ledger.base.workers import workers_of_cluster

    if asked is None and (found := workers_of_cluster()) is not None:
        return found
    if asked is None:
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        return cores if worth is None else max(1, min(cores, worth))
    require_whole(workers=asked)
    if asked < 1:
        raise UsageError(f"{option('workers', asked)}: expected at least 1; leave it out for one per core")
    return asked


def readers_of(asked: int | None, *ledgers: Path | None) -> int:
    """Return the number of processes that read these ledgers: as asked, else one per core, if there is enough to do.

    Raises: As `workers_of`.
    """
    return workers_of(asked, stored(*ledgers) // WORTH_BYTES)


def stored(*ledgers: Path | None) -> int:
    """Return the bytes of the segments of these ledgers, including staged ones, and of the shards of federations."""
    from fsar_ledger.ledger.store.paths import segment_bytes

    found = {ledger: segment_bytes(ledger) for ledger in ledgers if ledger is not None}
    small = [ledger for ledger, size in found.items() if size <= LOG_BYTES]
    if small:
        from fsar_ledger.ledger.opening import folders_of

        found |= {folder: segment_bytes(folder) for ledger in small for folder in folders_of(ledger)}
    return sum(found.values())
