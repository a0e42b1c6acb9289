"""Commands from verbs: the options from the signature of the function, and the call from what was given."""

import inspect
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated, Any, get_args

import typer
from typer.core import TyperCommand, TyperOption

from fsar_ledger.api.verbs import RAW, Option, Verb, argument, declared
from fsar_ledger.base.errors import QueryFailed, UsageError

from . import completing
from .memory import bounded

LEDGER = argument("LEDGER", "The folder of a ledger.")
TAKEN: Mapping[str, Option] = {
    "svg": Option("--svg", "FILE", "Also draw it, as SVG; replaced if it exists."),
    "pdf": Option("--pdf", "FILE", "Also draw it, as PDF; replaced if it exists."),
    "verified": Option(
        "--verified",
        None,
        "Answer only from rows that were compared with the root, as `verify` does. Unless `verify` has checked "
        "this head before, that takes some 4 s for a million events on two cores.",
    ),
    "json": Option("--json", None, "Answer as JSON, with the head (size, root) of the ledger."),
    "csv": Option("--csv", None, "Answer as comma-separated values."),
    "ndjson": Option("--ndjson", None, "Answer as JSON, one row a line and nothing else."),
    "raw": RAW,
    "limit": Option("--limit", "N", "Show at most N rows of the table; 0 shows all.", value=100),
    "wide": Option("--wide", None, "Show every column and whole cells, not what fits the terminal; as when piped."),
    "memory": Option(
        "--memory",
        "MIB",
        "The memory limit.",
        "576, 192 for each core or worker beyond two, and 16 times the size of the segments",
    ),
}
"""What a command can have beside the options of its verb; without a metavar it is a switch, without a value None."""


class Command(TyperCommand):
    """A command that refuses an option with one value that is given several times: one would be dropped in silence."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the arguments.

        Raises:
            UsageError: An option that has one value is given several times.
            TyperException: Another mistake of the call; it knows the command, whose help the message names.
        """
        if not ctx.resilient_parsing:  # as in completion, where the call is not yet whole
            try:
                _, _, given = self.make_parser(ctx).parse_args(args=list(args))
            except typer.TyperException as problem:
                vars(problem).update(ctx=ctx)  # the parser leaves it out
                raise
            for one, count in Counter(given).items():
                if isinstance(one, TyperOption) and count > 1 and not (one.multiple or one.is_flag):
                    raise UsageError(
                        f"{one.opts[0]}: found it {count} times, expected it once, since it has one value "
                        f"(see `{ctx.command_path} --help`)"
                    )
        return super().parse_args(ctx, args)


def command(verb: Verb, name: str) -> TyperCommand:
    """Return the command of a verb, under this name."""
    examples = "\b\nExamples:\n" + "\n".join(f"  {line}" for line in verb.examples)
    made = typer.Typer(add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)
    made.command(name, cls=Command, help=verb.help, epilog=examples)(_callback(verb))
    found = typer.main.get_command(made)
    assert isinstance(found, TyperCommand)
    return found


def _callback(verb: Verb) -> Callable[..., None]:
    parameters = verb.parameters.values()
    own = {one.name: found for one in parameters if isinstance(found := declared(one), Option)}
    ledgers = [one.name for one in parameters if _names_ledger(one.annotation)]
    stored = [name for name, found in own.items() if found.metavar == "LEDGER" and name not in ledgers]
    has_limit = "ledger" in ledgers and not any(found.flag == "--memory" for found in own.values())
    taken = {name: TAKEN[name] for name in (*verb.takes, *(["memory"] if has_limit else []))}

    def call(context: typer.Context, **given: Any) -> None:
        from .render import Form, respond

        beside = {name: given.pop(name) for name in taken}
        most = beside.get("memory", given.get("memory_mib"))
        for name, found in own.items():
            if found.metavar == "NAME=VALUE" and found.flag == "--param":
                given[name] = parameters_of(given[name])
        asked = {name for name in verb.beside if given.pop(name)}
        drawn = {kind: file for kind in ("svg", "pdf") if (file := beside.get(kind)) is not None}
        forms = {f"as_{name}": beside.get(name, False) for name in ("json", "csv", "ndjson")}
        form = Form(**forms, **{name: beside[name] for name in ("raw", "limit", "wide") if name in beside})
        verb.arrange(given)
        is_bounded = "ledger" in ledgers and not verb.is_apart(given)
        read = [given[name] for name in ledgers] + [place for name in stored for place in _several(given[name])]
        with bounded(most, *read, workers=given.get("workers")) if is_bounded else nullcontext():
            demands = beside.get("verified", False)
            code = respond(verb, given, ledgers, form, asked, drawn, verified=demands, clock=context.obj)
        if code:
            raise typer.Exit(code)

    accepted = [inspect.Parameter("context", inspect.Parameter.KEYWORD_ONLY, annotation=typer.Context)]
    if ledgers[:1] == ["ledger"] and "ledger" not in own:
        accepted.append(_accepted("ledger", Path, inspect.Parameter.empty, LEDGER))
    accepted += [
        _accepted(one.name, _type_of(one), one.default, own[one.name]) for one in parameters if one.name in own
    ]
    accepted += [_accepted(name, bool, False, found) for name, found in verb.beside.items()]
    kinds = {None: bool, "FILE": Path | None, "N": int, "MIB": int | None}
    accepted += [
        _accepted(name, kinds[found.metavar], False if found.metavar is None else found.value, found)
        for name, found in taken.items()
    ]
    call.__signature__ = inspect.Signature(accepted)  # type: ignore[attr-defined]
    call.__annotations__ = {one.name: one.annotation for one in accepted}
    return call


def _accepted(name: str, kind: Any, default: object, found: Option) -> inspect.Parameter:
    told: dict[str, Any] = {"metavar": found.metavar, "help": found.help, "min": found.least, "max": found.most}
    told |= {"envvar": found.environment}
    if found.default is not None or default in (None, inspect.Parameter.empty):
        told["show_default"] = found.default or False
    if found.complete is not None:
        told["autocompletion"] = completing.offered(found.complete)
    info = typer.Argument(**told) if found.flag is None else typer.Option(found.flag, **told)
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, annotation=Annotated[kind, info], default=default)


def _type_of(one: inspect.Parameter) -> Any:
    """Return the type that the command line reads: a path or text where Python takes more than these."""
    words = set(re.findall(r"\w+", str(get_args(one.annotation)[0])))
    kinds = {"PathLike": Path, "Ledger": Path, "str": str, "Literal": str, "bool": bool, "int": int, "float": float}
    read: Any = next(kind for name, kind in kinds.items() if name in words)
    read = list[read] if words & {"Sequence", "Mapping"} else read
    return read | None if one.default in (None, ()) else read


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
