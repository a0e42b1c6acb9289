"""Commands from verbs: the options from the signature of the function, and the call from the given values.

Completion: the functions that the shell calls import what they need then, and offer nothing on an error, since a shell
cannot show a message.
"""

import inspect
import os
import re
import signal
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, get_args

import typer
from typer.core import TyperCommand, TyperOption

from fsar_ledger.api.verbs import RAW, Option, Verb, argument, declared, stored, workers_of
from fsar_ledger.base import memory, printable
from fsar_ledger.base.errors import FsarLedgerError, LimitReached, QueryFailed, UsageError

from .terminal import say

if TYPE_CHECKING:
    from fsar_ledger.metrics.sql_values import Parameter

LEDGER = argument("LEDGER", "The folder of a ledger.")
TAKEN: Mapping[str, Option] = {
    "svg": Option("--svg", "FILE", "Also draw it as SVG; replaced if it exists."),
    "pdf": Option("--pdf", "FILE", "Also draw it as PDF; replaced if it exists."),
    "verified": Option(
        "--verified",
        None,
        "Compare all rows with the root before answering, as `verify` does. Unless `verify` has already checked "
        "this head, that takes about 4 s per million events on two cores.",
    ),
    "cluster": Option(
        "--cluster",
        "ADDRESS",
        "Have a Dask cluster do the work: tcp://HOST:PORT of its scheduler, or local:N for N processes.",
    ),
    "json": Option("--json", None, "Answer as JSON, with the head (size, root) of the ledger."),
    "csv": Option("--csv", None, "Answer as comma-separated values."),
    "ndjson": Option("--ndjson", None, "Answer as JSON, one row per line and nothing else."),
    "raw": RAW,
    "limit": Option("--limit", "N", "Show at most N rows of the table; 0 shows all.", value=100),
    "wide": Option("--wide", None, "Show all columns and whole cells, whatever the width, as when piped."),
    "memory": Option(
        "--memory",
        "MIB",
        "The memory limit.",
        "640 + 192 for each core or worker beyond two + 16 times the size of the segments",
    ),
}
"""The options of commands beside those of their verb; without a metavar a switch, without a value None by default."""


class Command(TyperCommand):
    """A command that refuses repeated options with one value, since all but one would be silently dropped."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the arguments.

        Raises:
            UsageError: An option that has one value is given several times.
            TyperException: Another mistake in the call; it has the command, whose help the message names.
        """
        if not ctx.resilient_parsing:  # as in completion, where the call is not yet whole
            try:
                _, _, order = self.make_parser(ctx).parse_args(args=list(args))
            except typer.TyperException as problem:
                vars(problem).update(ctx=ctx)  # the parser leaves it out
                raise
            for parameter, count in Counter(order).items():
                if isinstance(parameter, TyperOption) and count > 1 and not (parameter.multiple or parameter.is_flag):
                    raise UsageError(
                        f"{parameter.opts[0]}: found it {count} times, expected it once, since it has one value "
                        f"(see `{ctx.command_path} --help`)"
                    )
        return super().parse_args(ctx, args)


def command(verb: Verb, name: str) -> TyperCommand:
    """Return the command of a verb, under this name."""
    examples = "\b\nExamples:\n" + "\n".join(f"  {line}" for line in verb.examples)
    application = typer.Typer(add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)
    application.command(name, cls=Command, help=verb.help, epilog=examples)(_callback(verb))
    result = typer.main.get_command(application)
    assert isinstance(result, TyperCommand)
    return result


def _callback(verb: Verb) -> Callable[..., None]:
    parameters = verb.parameters.values()
    options = {parameter.name: entry for parameter in parameters if isinstance(entry := declared(parameter), Option)}
    ledgers = [parameter.name for parameter in parameters if _names_ledger(parameter.annotation)]
    other_ledgers = [name for name, option in options.items() if option.metavar == "LEDGER" and name not in ledgers]
    has_limit = "ledger" in ledgers and not any(option.flag == "--memory" for option in options.values())
    taken = {name: TAKEN[name] for name in (*verb.takes, *(["memory"] if has_limit else []))}

    def call(context: typer.Context, **given: Any) -> None:
        from .render import Form, respond

        beside = {name: given.pop(name) for name in taken}
        memory_mib = beside.get("memory", given.get("memory_mib"))
        judges, shared = _shared(beside.get("cluster"))
        for name, option in options.items():
            if option.metavar == "NAME=VALUE" and option.flag == "--param":
                given[name] = parameters_of(given[name])
        switches = {name for name in verb.beside if given.pop(name)}
        drawn = {kind: file for kind in ("svg", "pdf") if (file := beside.get(kind)) is not None}
        forms = {f"as_{name}": beside.get(name, False) for name in ("json", "csv", "ndjson")}
        form = Form(**forms, **{name: beside[name] for name in ("raw", "limit", "wide") if name in beside})
        verb.arrange(given)
        is_bounded = "ledger" in ledgers and not verb.is_apart(given)
        paths = [given[name] for name in ledgers] + [path for name in other_ledgers for path in _several(given[name])]
        # A process that judges takes as much memory as two that verify.
        workers = given.get("workers") or (2 + 2 * judges if judges else None)
        limit = partial(bounded, memory_mib, *paths, workers=workers, memory_factor=verb.memory_factor)
        with shared, limit() if is_bounded else nullcontext():
            verified = beside.get("verified", False)
            code = respond(verb, given, ledgers, form, switches, drawn, verified=verified, clock=context.obj)
        if code:
            raise typer.Exit(code)

    accepted = [inspect.Parameter("context", inspect.Parameter.KEYWORD_ONLY, annotation=typer.Context)]
    if ledgers[:1] == ["ledger"] and "ledger" not in options:
        accepted.append(_accepted("ledger", Path, inspect.Parameter.empty, LEDGER))
    accepted += [
        _accepted(one.name, _type_of(one), one.default, options[one.name]) for one in parameters if one.name in options
    ]
    accepted += [_accepted(name, bool, False, option) for name, option in verb.beside.items()]
    kinds = {None: bool, "FILE": Path | None, "ADDRESS": str | None, "N": int, "MIB": int | None}
    accepted += [
        _accepted(name, kinds[option.metavar], False if option.metavar is None else option.value, option)
        for name, option in taken.items()
    ]
    call.__signature__ = inspect.Signature(accepted)  # type: ignore[attr-defined]
    call.__annotations__ = {parameter.name: parameter.annotation for parameter in accepted}
    return call


def _shared(address: str | None) -> tuple[int, AbstractContextManager[None]]:
    """Return how many processes of this machine the cluster at this address has, and the context in which it works.

    They are 0 and a null context if none is named.
    """
    if address is None:
        return 0, nullcontext()
    from fsar_ledger.base.workers import cluster, local_processes

    return local_processes(address) or 0, cluster(address)


def _accepted(name: str, kind: Any, default: object, option: Option) -> inspect.Parameter:
    extra: dict[str, Any] = {"metavar": option.metavar, "help": option.help, "min": option.least, "max": option.most}
    extra |= {"envvar": option.environment}
    if option.default is not None or default in (None, inspect.Parameter.empty):
        extra["show_default"] = option.default or False
    if option.complete is not None:
        extra["autocompletion"] = offered(option.complete)
    info = typer.Argument(**extra) if option.flag is None else typer.Option(option.flag, **extra)
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, annotation=Annotated[kind, info], default=default)


def _type_of(parameter: inspect.Parameter) -> Any:
    """Return the type that the command line reads: a path or text if Python takes more than these."""
    words = set(re.findall(r"\w+", str(get_args(parameter.annotation)[0])))
    kinds = {"PathLike": Path, "Ledger": Path, "str": str, "Literal": str, "bool": bool, "int": int, "float": float}
    result: Any = next(kind for name, kind in kinds.items() if name in words)
    result = list[result] if words & {"Sequence", "Mapping"} else result
    return result | None if parameter.default in (None, ()) else result


def _names_ledger(annotation: Any) -> bool:
    """Return whether a parameter is a ledger: such an annotation is text, since verbs are imported before `Ledger`."""
    return "Ledger" in re.findall(r"\w+", str(annotation).partition("(flag")[0])


def _several(value: Any) -> Sequence[Path | None]:
    return value if isinstance(value, list) else [value]


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


DESIGNS = Path(__file__).parents[1] / "runtime/world"
MOST = 1_000
"""Names offered; a terminal cannot show more."""


class Line(NamedTuple):
    """An incomplete command line: its arguments and options by name, and the word that is being typed."""

    given: Mapping[str, Any]
    typed: str


def offered(what: str) -> Callable[[typer.Context, str], list[str]]:
    """Return the function that typer calls for names of this kind.

    It offers only single words that a terminal shows as they are, and nothing if the line or the ledger is wrong.
    """

    def offer(ctx: typer.Context, incomplete: str) -> list[str]:
        try:
            names = [name for name in OFFERS[what](Line(_typed_values(ctx), incomplete)) if name.startswith(incomplete)]
        except (FsarLedgerError, OSError):
            return []
        return [name for name in names if printable.is_shown(name) and not any(map(str.isspace, name))][:MOST]

    return offer


def _typed_values(ctx: typer.Context) -> dict[str, Any]:
    """Return the arguments and options by name.

    After an option that still lacks its value, which is the one being typed, the arguments are not yet by name.
    """
    names = [parameter.name for parameter in ctx.command.params if parameter.param_type_name == "argument"]
    positional = {name: value for name, value in zip(names, ctx.args, strict=False) if name is not None}
    return {**ctx.params, **positional}


def _designs(folder: str) -> list[str]:
    return sorted(file.stem for file in (DESIGNS / folder).glob("*.toml"))


def _mechanisms(line: Line) -> Iterable[str]:
    """Return the mechanisms of all architectures; after a `+`, further ones."""
    from fsar_ledger.events.configuration import EVERY_MECHANISM

    begun, plus, _ = line.typed.rpartition("+")
    return [f"{begun}{plus}{name}" for name in EVERY_MECHANISM]


def _invariants(_: Line) -> Iterable[str]:
    from fsar_ledger.metrics.invariants import invariants

    return [invariant.relation.partition("_")[0] for invariant in invariants()]


def _constants(_: Line) -> Iterable[str]:
    from fsar_ledger.metrics.constant_names import names_of_constants

    return [f"{name}=" for name in names_of_constants()]


def _queries(line: Line) -> Iterable[str]:
    """Return the full names of the queries and, if no `/` is typed, also the last parts."""
    from fsar_ledger.metrics.library import library

    packaged = library()
    return [*packaged.queries, *(packaged.relations if line.typed and "/" not in line.typed else ())]


def _studies(_: Line) -> Iterable[str]:
    from fsar_ledger.studies.verbs import STUDIES

    return STUDIES


def _parameters(line: Line) -> Iterable[str]:
    """Return the parameters of the query that the line names, as `NAME=`, and after the `=` their values."""
    from fsar_ledger.metrics.library import library

    parameters = library().find(line.given.get("name") or line.given.get("query") or "").parameters
    name, equals, _ = line.typed.partition("=")
    if not equals:
        return [f"{parameter}=" for parameter in parameters]
    return [f"{name}={value}" for value in _values(line, parameters[name])] if name in parameters else []


def _architectures(_: Line) -> Iterable[str]:
    from fsar_ledger.events.configuration import ARCHITECTURES

    return ARCHITECTURES


OFFERS: Mapping[str, Callable[[Line], Iterable[str]]] = {
    "scenarios": lambda _: _designs("scenarios"),
    "workflows": lambda _: [name.removeprefix("workflow-") for name in _designs("workflows")],
    "architectures": _architectures,
    "mechanisms": _mechanisms,
    "invariants": _invariants,
    "constants": _constants,
    "queries": _queries,
    "studies": _studies,
    "runs": lambda line: _on_record(line, "run", None),
    "actions": lambda line: _on_record(line, "action", line.given.get("run")),
    "parameters": _parameters,
}
"""The names that are offered, by `Option.complete`."""


def _values(line: Line, one: "Parameter") -> Sequence[str]:
    """Return the values that a parameter can have: its default, and what the ledger has on record."""
    given = dict(pair.partition("=")[::2] for pair in line.given.get("param") or line.given.get("parameters") or ())
    default = [] if one.default is None else [one.default]
    return default if one.kind in ("time", "seq") else [*default, *_on_record(line, one.kind, given.get("run"))]


def _on_record(line: Line, kind: str, run: str | None) -> list[str]:
    """Return the names of this kind in the ledger that the line names, of one run or of all. Raises: As `connect`."""
    from fsar_ledger.api.lookup import resolve_run
    from fsar_ledger.ledger.opening import open_for_answers
    from fsar_ledger.metrics.database import connect_view
    from fsar_ledger.metrics.sql_values import names_on_record

    view = open_for_answers(Path(str(line.given.get("ledger") or "")))
    with connect_view(view) as database:
        return names_on_record(
            database, kind, None if run in (None, "all") else resolve_run(view, run, None, is_whole=True)
        )


LEAST_MIB = 256
BASE_BYTES = 640 << 20
PER_BYTE = 16
"""By default a command may take `BASE_BYTES`, and `PER_BYTE` bytes for each byte of the segments on disk. Most commands
need 300 MiB and 10; `report` takes some 40 for each byte (`Verb.memory_factor`). For a ledger of ten million events
`study run multiverse` and `open` need more, given by --memory: a larger default would also hold for a small file that
unpacks to much.
"""

PER_WORKER_BYTES = 192 << 20
"""Memory for each core or worker beyond two, since each has buffers of its own: `verify` takes 150 MiB for each."""

MACHINE_SHARE = 0.8


@contextmanager
def bounded(
    asked_mib: int | None, *ledgers: Path | None, workers: int | None = None, memory_factor: int = 1
) -> Iterator[None]:
    """Limit the memory of the command to the requested amount, or to what ledgers of this size need.

    Beyond that the command ends with one message and exit code 2.

    Raises:
        UsageError: The limit is less than a command needs to begin.
        LimitReached: The system, or a library with a limit of its own, refused more.
    """
    if asked_mib is not None and not LEAST_MIB <= asked_mib <= memory.MOST_MIB:
        raise UsageError(f"--memory {asked_mib}: expected at least {LEAST_MIB} and at most {memory.MOST_MIB} (MiB)")
    most = (
        default_bytes(*ledgers, workers=workers, memory_factor=memory_factor) if asked_mib is None else asked_mib << 20
    )

    def end() -> None:
        say(memory.exceeded_message())
        for child in memory.children():
            with suppress(OSError):
                os.kill(int(child), signal.SIGKILL)
        memory.remove_unfinished()
        os._exit(LimitReached.exit_code)

    with memory.limited(most, end):
        try:
            yield
        except MemoryError as error:
            raise LimitReached(memory.exceeded_message()) from error


def default_bytes(*ledgers: Path | None, workers: int | None = None, memory_factor: int = 1) -> int:
    """Return the default limit, which grows with the segments and workers, and is never all of the machine's memory.

    `memory_factor` is that of the verb.
    """
    more = max(0, (workers_of(None) if workers is None else workers) - 2)
    return min(
        BASE_BYTES + PER_WORKER_BYTES * more + memory_factor * PER_BYTE * stored(*ledgers),
        int(MACHINE_SHARE * memory.bytes_installed()),
    )
