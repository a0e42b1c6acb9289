"""The errors of the package, as one tree.

```
FsarLedgerError            every error that a user can meet          exit code
├── UsageError             the request does not make sense           2
│   ├── InvalidExperiment      unknown or impossible parameters
│   ├── InvalidRun             a run that may not be stored; also a ValueError
│   │   └── CommitTooLarge         more than one commit may hold
│   ├── UnknownQuery           no query of that name
│   ├── InvalidQuery           a packaged query with a wrong header; also a ValueError
│   ├── QueryFailed            SQL or its parameters are wrong
│   ├── LimitReached           more memory is needed than was allowed
│   ├── NotALedger             the path does not exist or is no ledger
│   └── FormatVersionMismatch  the ledger was written in another format
├── NotCosigned            too few witnesses cosigned                1
├── WriteFailed            the disk refused: full, read-only, gone   1
│   └── SequenceConflict       another writer took the commit number
├── WorkerDied             a worker process was ended from outside   1
└── LedgerCorrupted        the ledger contradicts itself             3
    ├── UnknownEventTag        a stored type that this version does not know
    └── ReplayMismatch         replay gives events other than those stored
```

Here is also what refuses arguments of another type than a function takes, before it does anything (`checked`).
"""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from datetime import datetime
from functools import wraps
from inspect import Parameter, signature
from numbers import Integral, Real
from os import PathLike
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, cast, get_args, get_origin

_Function = TypeVar("_Function", bound=Callable[..., Any])

_OPTION_OF_PARAMETER = {
    "memory_mib": "memory",
    "settings": "set",
    "since": "from",
    "until": "to",
    "second": "with",
    "mapping": "with",
    "format": "as",
}
_SECRET = re.compile(r"(PRIVATE\+KEY\+)[^\s'\"]+")
_is_command_line = ContextVar("is_command_line", default=False)


@contextmanager
def named_as_options() -> Iterator[None]:
    """Name parameters as command-line options in the errors raised inside."""
    token = _is_command_line.set(True)
    try:
        yield
    finally:
        _is_command_line.reset(token)


def option(name: str, value: object = None) -> str:
    """Return a parameter's name, with its value if there is one, as the caller gave it.

    In Python that is `trusted_key=KEY`, on the command line `--trusted-key KEY`.
    """
    if not _is_command_line.get():
        return name if value is None else f"{name}={value}"
    flag = f"--{_OPTION_OF_PARAMETER.get(name, name).replace('_', '-')}"
    return flag if value is None else f"{flag} {value}"


class FsarLedgerError(Exception):
    """An error that a user can meet.

    The message says where, what was found, what was expected and what to do; each argument is a message. A secret key
    given in place of another file is not quoted.
    """

    exit_code = 1

    def __init__(self, *messages: object) -> None:
        super().__init__(*(_SECRET.sub(r"\1(not shown)", f"{message}") for message in messages))

    def __str__(self) -> str:
        return "\n".join(map(str, self.args))


class UsageError(FsarLedgerError):
    """The request does not make sense."""

    exit_code = 2


class InvalidExperiment(UsageError):
    """A parameter of the experiment is unknown or impossible."""


class InvalidRun(UsageError, ValueError):
    """The run would fail `verify` or could not be read, so it was not written."""


class CommitTooLarge(InvalidRun):
    """The runs exceed the limits of one commit; they may be committed in parts."""


class UnknownQuery(UsageError):
    """No query has that name."""


class InvalidQuery(UsageError, ValueError):
    """The header of a packaged query lacks something, or has it twice."""


class QueryFailed(UsageError):
    """DuckDB refused a query or its parameters."""


class LimitReached(UsageError):
    """The request needs more memory than allowed."""


class NotALedger(UsageError):
    """The path is not a ledger."""


class FormatVersionMismatch(UsageError):
    """The ledger was written in a format that this version does not read."""


class NotCosigned(FsarLedgerError):
    """Fewer witnesses cosigned than the policy requires."""


class WriteFailed(FsarLedgerError):
    """The disk refused to store the data; the ledger is unchanged."""


class SequenceConflict(WriteFailed):
    """Another writer committed under the number that this one expected to use."""


class WorkerDied(FsarLedgerError):
    """A worker process was ended from outside, so the command could not finish.

    Nothing is known about the unfinished work.
    """


class LedgerCorrupted(FsarLedgerError):
    """The ledger contradicts itself."""

    exit_code = 3


class UnknownEventTag(LedgerCorrupted):
    """A stored event has a type that is unknown to this version."""


class ReplayMismatch(LedgerCorrupted):
    """Replay gives events other than those stored."""


def checked(function: _Function) -> _Function:
    """Return the function, which then refuses arguments of another type than its annotations name.

    The command line cannot give such arguments. What has an error of its own is not checked: dates, and text that may
    be a number, such as a run or a time. Nor are annotations in quotes.
    """
    takes = signature(function)
    several = (Parameter.VAR_POSITIONAL, Parameter.VAR_KEYWORD)
    kinds = {name: _kinds(one.annotation) for name, one in takes.parameters.items() if one.kind not in several}

    @wraps(function)
    def call(*given: Any, **named: Any) -> Any:
        try:
            arguments = takes.bind(*given, **named).arguments
        except TypeError:  # the function itself says which argument is missing, or one too many
            return function(*given, **named)
        for name, value in arguments.items():
            if name in kinds and not _fits(value, kinds[name]):
                raise UsageError(f"{option(name)}: found {value!r:.80}, expected {_words(kinds[name])}")
        return function(*given, **named)

    return cast(_Function, call)


def _kinds(annotation: Any) -> list[Any]:
    """Return the types that an annotation names; none if it is not checked."""
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _kinds(arguments[0])
    if origin in (Union, UnionType):
        kinds = [_kinds(argument) for argument in arguments]
        names = {kind for inside in kinds for kind in inside}
        is_read = datetime in names or (str in names and names & {int, float})
        return [] if is_read or not all(kinds) else [kind for inside in kinds for kind in inside]
    if origin is Literal:
        return [type(arguments[0])]
    return (
        [annotation] if isinstance(origin or annotation, type) and annotation not in (Parameter.empty, object) else []
    )


def _fits(value: object, kinds: Sequence[Any]) -> bool:
    """Return whether the value has one of these types, or none is asked for."""
    return not kinds or any(_has_type(value, get_origin(kind) or kind, get_args(kind)) for kind in kinds)


def _has_type(value: object, base: Any, arguments: tuple[Any, ...]) -> bool:
    if base in (int, float):
        return isinstance(value, Integral if base is int else Real) and not isinstance(value, bool)
    if base in (str, tuple, Callable) or not issubclass(base, Iterable):
        return isinstance(value, (tuple, list) if base is tuple else base)
    if issubclass(base, Mapping):
        inside = [_kinds(argument) for argument in arguments]
        return isinstance(value, Mapping) and all(all(map(_fits, item, inside)) for item in value.items())
    if isinstance(value, str | bytes) or not isinstance(value, Iterable):
        return False
    return isinstance(value, Iterator) or all(_fits(item, _kinds(arguments[0])) for item in value)


_NAMES: Mapping[Any, str] = {
    str: "text",
    int: "a whole number",
    float: "a number",
    bool: "True or False",
    tuple: "a pair",
    PathLike: "a path",
    Callable: "a function",
}


def _words(kinds: Sequence[Any]) -> str:
    """Return the names of types for people."""
    words = [_word(get_origin(kind) or kind, get_args(kind)) for kind in kinds if kind is not NoneType]
    return " or ".join(word for word in words if word != "text" or "a path" not in words)


def _word(base: Any, arguments: tuple[Any, ...]) -> str:
    if base in _NAMES or not issubclass(base, Iterable):
        return _NAMES.get(base, f"{'an' if base.__name__[0] in 'AEIO' else 'a'} {base.__name__}")
    if issubclass(base, Mapping):
        return "a mapping of names" if arguments else "a mapping"
    (*_, inside) = _kinds(arguments[0])
    word = _NAMES.get(get_origin(inside) or inside)
    return f"a list of {inside.__name__ if word is None else word.split()[-1] + 's'}"
