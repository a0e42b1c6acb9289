"""Verbs: functions whose signature and docstring serve both Python and the command line.

A parameter of a verb has its declaration in place of its default (`declare`, `switch`, `argument`), which names the
true default; a required parameter, and one that several verbs share, has an `Option` in its annotation.
`cli/building.py` makes the options of the command from them, and the docstring gets its `Args:` from them. A parameter
without one is for Python alone.
Modules of verbs are imported to show a help text, so they import slow modules inside their functions.

`workers_of` chooses the number of processes for a piece of work; it is here, beside the option for it.
"""

import inspect
import os
import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, TypeVar

from fsar_ledger.base.errors import UsageError, checked, option

from .names import By, Names, Place, Pool, Run, require_whole

if TYPE_CHECKING:
    from .ledger import Ledger

RUNTIME = Path(__file__).resolve().parents[1] / "runtime"
_Function = TypeVar("_Function", bound=Callable[..., Any])

JSON = ("verified", "json")
"""The options of a verb whose answer holds for a ledger: compare its rows first, and answer as JSON."""
WIDE = (*JSON, "wide")
"""The options of a verb whose text has a table."""
ROWS = (*JSON, "csv", "ndjson", "raw", "wide")
"""The options of a verb whose answer is rows."""
STREAM = (*JSON, "csv", "ndjson", "raw", "limit", "wide")
"""The options of a verb whose answer can be long."""

NOTHING_CHANGED = "nothing was changed"
"""The effect of most interrupted calls."""


def either(names: Iterable[str]) -> str:
    """Return the sorted names as `a, b or c`."""
    *others, last = sorted(names)
    return f"{', '.join(others)} or {last}"


class Option(NamedTuple):
    """An option of the command line, or an argument if it has no flag; a switch has no metavar.

    `default` describes the default if the value of the parameter does not. `complete` names the values that a shell
    is offered (`cli/building.py`).
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
    """The true default of the parameter, if the option is declared in its place."""


class Shows(NamedTuple):
    """A parameter for progress, which the command line shows in these words; not an option.

    `instead` has other verbs for calls with a switch.
    """

    verb: str
    unit: str
    instead: Mapping[str, str] = {}


class Gives(NamedTuple):
    """A parameter that the command line supplies; not an option.

    `now`: the present time, in seconds since 1970, and `clock`: a function that returns it. `ticks`: a function that
    returns seconds that never go back. `pause`: a function that waits this many seconds, or ends when the output is
    closed. `say`: a function that prints a line for the operator. `show`: one that prints a part of the answer.
    `showing`: as `base.progress.Showing`. `walk`: lets a user step through a run by keys; None without a keyboard.
    """

    what: Literal["now", "clock", "ticks", "pause", "say", "show", "showing", "walk"]


class Verb(NamedTuple):
    """A verb: its name on the command line, its function, and the other arguments of `verb`."""

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
        parameters = dict(inspect.signature(self.function).parameters)
        for name, parameter in inspect.signature(self.call).parameters.items():
            if name not in parameters and declared(parameter) is not None:
                parameters[name] = parameter
            elif name in parameters and parameter.default is not inspect.Parameter.empty:
                parameters[name] = parameters[name].replace(default=parameter.default)
        return parameters

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
    """Declare an option in place of its parameter's default, which is `value`; `flag` defaults to the name.

    `default` is what the help shows in place of that value, such as "all" for None.
    """
    return Option(flag, metavar, help, default, **more)


def switch(help: str, *, flag: str = "") -> Any:
    """Declare a switch in place of its parameter's default, which is False."""
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
    """Register a function as a verb of the command line, with example calls.

    Args:
        examples: Calls without the name of the program, which a test runs, and other lines of a shell.
        takes: The options of the command beside the parameters of the function.
        name: The name on the command line; None: that of the function.
        call: Answers the command instead, with the same parameters and those that it declares.
        beside: Switches that affect only the text of the answer (`Screen.has`).
        after_interruption: The effect of an interrupted call.
        is_apart: Whether a call with these values runs in a process with its own memory limit.
        arrange: Changes the values of a call before its ledgers are opened.
        memory_factor: The memory allowed for each byte of the segments, as a multiple of that of other commands.

    Raises: TypeError for a function without a docstring.
    """

    def register(function: _Function) -> _Function:
        if __debug__ and not function.__doc__:
            place = f"{function.__module__}.{function.__name__}"
            raise TypeError(f"{place}: found no docstring, expected one, whose first line is the help of the command")
        _settle(function)
        if call is not None:
            _settle(call)
        function.__doc__ = _documented(function)
        function = checked(function)
        command = name or function.__name__.replace("_", "-")
        calls = tuple(f"fsar-ledger {example}" if example.startswith(command) else example for example in examples)
        VERBS[command] = Verb(
            command,
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
        return function

    return register


def _settle(function: Callable[..., Any]) -> None:
    """Replace each default that is a declaration by the true one, and move the declaration to the annotation."""
    settled = []
    for name, parameter in inspect.signature(function).parameters.items():
        if isinstance(declaration := parameter.default, Option):
            declaration = (
                declaration._replace(flag=f"--{name.replace('_', '-')}") if declaration.flag == "" else declaration
            )
            parameter = parameter.replace(
                annotation=Annotated[parameter.annotation, declaration], default=declaration.value
            )
        settled.append(parameter)
    positional = [parameter for parameter in settled if parameter.kind is not parameter.KEYWORD_ONLY]
    function.__defaults__ = tuple(
        parameter.default for parameter in positional if parameter.default is not parameter.empty
    )
    function.__kwdefaults__ = {
        parameter.name: parameter.default
        for parameter in settled
        if parameter.kind is parameter.KEYWORD_ONLY and parameter.default is not parameter.empty
    }
    function.__annotations__.update(
        {parameter.name: parameter.annotation for parameter in settled if parameter.annotation is not parameter.empty}
    )


def declared(parameter: inspect.Parameter) -> Option | Shows | Gives | None:
    """Return what the annotation of a parameter declares."""
    metadata = getattr(parameter.annotation, "__metadata__", ())
    return next((item for item in metadata if isinstance(item, Option | Shows | Gives)), None)


def _documented(function: Callable[..., Any]) -> str:
    """Return the docstring with a line for each declared parameter."""
    text = inspect.getdoc(function) or ""
    options = ((parameter.name, declared(parameter)) for parameter in inspect.signature(function).parameters.values())
    lines = [f"    {name}: {declaration.help}" for name, declaration in options if isinstance(declaration, Option)]
    if not lines or "\n\nArgs:" in text:
        return text
    body, raises, rest = text.partition("\n\nRaises:")
    return "\n".join([f"{body}\n\nArgs:", *lines]) + raises + rest


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
        "all",
        complete="invariants",
    ),
]
ONE_ARCHITECTURE = either(file.parent.name for file in RUNTIME.glob("architectures/*/__init__.py"))
"""The architectures, by their folders; importing them would slow `--help` down."""
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
    str | None, Option("--second", "NAME", "As --first; from OTHER, if it is given.", "the other of two")
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
        "Sign with this key, made by `fsar-ledger key new`.",
        "leave the ledger unsigned",
        environment="FSAR_LEDGER_KEY",
    ),
]
OriginOption = Annotated[
    str | None,
    Option("--origin", "NAME", "Publish a new ledger under this name.", "the key's name, else a general one"),
]
AdoptOption = Annotated[
    bool, Option("--adopt", None, "Allow signing on top of commits that this key did not sign; verify them first.")
]
WorkersOption = Annotated[
    int | None,
    Option(
        "--workers",
        "N",
        "Number of processes; the answer does not depend on it.",
        "one per core, if there is enough to do",
    ),
]


WORTH_ROBOTS = 320
"""Robots, summed over all runs, whose simulation takes about as long as a process takes to start (0.4 s)."""

LOG_BYTES = 1 << 24
"""Only ledgers with fewer bytes of segments may be federations, whose logs have few events."""

WORTH_BYTES = 400 << 10
"""Bytes of segments whose verification takes about as long as a process takes to start (0.4 s)."""


def workers_of(asked: int | None, worth: int | None = None) -> int:
    """Return the number of processes: as given, else the cluster's, else one per core, at most what the work is worth.

    Raises:
        UsageError: The number is below 1, or not whole.
    """
    from fsar_ledger.base.workers import workers_of_cluster

    if asked is None and (count := workers_of_cluster()) is not None:
        return count
    if asked is None:
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        return cores if worth is None else max(1, min(cores, worth))
    require_whole(workers=asked)
    if asked < 1:
        raise UsageError(f"{option('workers', asked)}: expected at least 1; leave it out for one per core")
    return asked


def readers_of(asked: int | None, *ledgers: Path | None) -> int:
    """Return the number of processes that read these ledgers: as given, else one per core, if there is enough to do.

    Raises: As `workers_of`.
    """
    return workers_of(asked, stored(*ledgers) // WORTH_BYTES)


def stored(*ledgers: Path | None) -> int:
    """Return the bytes of the segments of these ledgers, including staged ones, and of the shards of federations."""
    from fsar_ledger.ledger.store.paths import segment_bytes

    sizes = {ledger: segment_bytes(ledger) for ledger in ledgers if ledger is not None}
    small = [ledger for ledger, size in sizes.items() if size <= LOG_BYTES]
    if small:
        from fsar_ledger.ledger.opening import folders_of

        sizes |= {folder: segment_bytes(folder) for ledger in small for folder in folders_of(ledger)}
    return sum(sizes.values())
