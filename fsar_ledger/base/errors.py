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
"""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_OPTION_OF_PARAMETER = {
    "memory_mib": "memory",
    "settings": "set",
    "since": "from",
    "until": "to",
    "second": "with",
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
