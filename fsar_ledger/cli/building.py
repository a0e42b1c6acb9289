"""Commands from verbs: the options from the signature of the function, and the call from what was given."""

import inspect
import re
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated, Any, get_args

import typer

from fsar_ledger.api.verbs import Option, Verb, declared

from . import completing, options
from .memory import bounded

TAKEN: dict[str, tuple[str, Any, object]] = {
    "verified": ("verified", options.VerifiedOption, False),
    "json": ("as_json", options.JsonOption, False),
    "csv": ("as_csv", options.CsvOption, False),
    "ndjson": ("as_ndjson", options.NdjsonOption, False),
    "raw": ("raw", options.RawOption, False),
    "limit": ("limit", options.LimitOption, options.SHOWN_ROWS),
    "wide": ("wide", options.WideOption, False),
    "memory": ("memory", options.ReadingMemoryOption, None),
}
"""What a command can have beside the options of its verb: the name of each, its declaration, and its default."""


def callback(verb: Verb) -> Callable[..., None]:
    """Return the function of a verb's command, for typer."""
    parameters = verb.parameters.values()
    own = {one.name: found for one in parameters if isinstance(found := declared(one), Option)}
    ledgers = [one.name for one in parameters if _names_ledger(one.annotation)]
    reads = ledgers[:1] == ["ledger"] and not any(found.flag == "--memory" for found in own.values())
    taken = [TAKEN[name] for name in (*verb.takes, *(["memory"] if reads else []))]

    def call(context: typer.Context, **given: Any) -> None:
        from .render import respond
        from .streaming import Form

        beside = {name: given.pop(name) for name, _, _ in taken}
        memory, verified = beside.pop("memory", None), beside.pop("verified", False)
        for name, found in own.items():
            if found.metavar == "NAME=VALUE":
                given[name] = options.parameters_of(given[name])
        asked = {name for name in verb.beside if given.pop(name)}
        form = Form(**beside)
        places = [given[name] for name in ledgers]
        with bounded(memory, *places, workers=given.get("workers")) if reads else nullcontext():
            code = respond(verb, given, ledgers, form, asked, verified=verified, now_s=context.obj)
        if code:
            raise typer.Exit(code)

    accepted = [_keyword("context", typer.Context)]
    accepted += [_keyword("ledger", options.LedgerArgument)] if ledgers[:1] == ["ledger"] else []
    accepted += [_accepted(one, own[one.name]) for one in parameters if one.name in own]
    accepted += [_switch(name, found) for name, found in verb.beside.items()]
    accepted += [_keyword(*one) for one in taken]
    call.__signature__ = inspect.Signature(accepted)  # type: ignore[attr-defined]
    call.__annotations__ = {one.name: one.annotation for one in accepted}
    return call


def _keyword(name: str, annotation: Any, default: object = inspect.Parameter.empty) -> inspect.Parameter:
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, annotation=annotation, default=default)


def _switch(name: str, found: Option) -> inspect.Parameter:
    return _keyword(name, Annotated[bool, typer.Option(found.flag, help=found.help)], False)


def _accepted(one: inspect.Parameter, found: Option) -> inspect.Parameter:
    """Return the parameter as typer knows it."""
    told: dict[str, Any] = {"metavar": found.metavar, "help": found.help}
    if found.default is not None or one.default in (None, inspect.Parameter.empty):
        told["show_default"] = found.default or False
    if found.complete is not None:
        told["autocompletion"] = getattr(completing, found.complete)
    if found.least is not None:
        told["min"] = found.least
    if found.environment is not None:
        told["envvar"] = found.environment
    info = typer.Argument(**told) if found.flag is None else typer.Option(found.flag, **told)
    return _keyword(one.name, Annotated[_accepted_type(one), info], one.default)


def _accepted_type(one: inspect.Parameter) -> Any:
    """Return the type that the command line reads: a path or text where Python takes more than these."""
    words = set(re.findall(r"\w+", str(get_args(one.annotation)[0])))
    kinds = {"PathLike": Path, "Ledger": Path, "str": str, "Literal": str, "bool": bool, "int": int, "float": float}
    read: Any = next(kind for name, kind in kinds.items() if name in words)
    read = list[read] if words & {"Sequence", "Mapping"} else read
    return read | None if one.default in (None, ()) else read


def _names_ledger(annotation: Any) -> bool:
    """Return whether a parameter is a ledger: such an annotation is text, since verbs are imported before `Ledger`."""
    return "Ledger" in re.findall(r"\w+", str(annotation).partition("(metavar")[0])
