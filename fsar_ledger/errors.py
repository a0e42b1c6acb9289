"""What can go wrong, as one tree.

```
FsarLedgerError            every error that a user can meet          exit code
├── UsageError             what was asked for does not make sense    2
│   ├── InvalidExperiment      unknown or impossible parameters
│   ├── InvalidRun             a run that no ledger may hold; also a ValueError
│   ├── UnknownQuery           no query of that name
│   ├── QueryFailed            SQL or its parameters are wrong
│   ├── LimitReached           more memory is needed than was allowed
│   ├── NotALedger             the path exists and is no ledger, or does not exist
│   └── FormatVersionMismatch  the ledger was written in another format
├── NotCosigned            too few witnesses cosigned                1
├── WriteFailed            the disk refused: full, read-only, gone   1
│   └── SequenceConflict       another writer took the commit number
├── WorkerDied             a process that worked for the command     1
└── LedgerCorrupted        the ledger contradicts itself             3
    ├── UnknownEventTag        a stored type that this version does not know
    └── ReplayMismatch         replay gives other events than those stored
```
"""


class FsarLedgerError(Exception):
    """The message says where, what was found, what was expected and what to do; of several messages, each is an argument."""

    exit_code = 1

    def __str__(self) -> str:
        return "\n".join(map(str, self.args))


class UsageError(FsarLedgerError):
    """What was asked for does not make sense."""

    exit_code = 2


class InvalidExperiment(UsageError):
    """Unknown or impossible parameters of an experiment."""


class InvalidRun(UsageError, ValueError):
    """A run that `verify` would condemn, or no reader take; it was not written."""


class UnknownQuery(UsageError):
    """There is no query of that name."""


class QueryFailed(UsageError):
    """DuckDB refused a query or its parameters."""


class LimitReached(UsageError):
    """What was asked for needs more memory than it may take."""


class NotALedger(UsageError):
    """The path is not a ledger."""


class FormatVersionMismatch(UsageError):
    """The ledger was written in a format that this version does not read."""


class NotCosigned(FsarLedgerError):
    """Fewer witnesses cosigned than a policy demands."""


class WriteFailed(FsarLedgerError):
    """The disk refused to store what was asked; the ledger is as it was."""


class SequenceConflict(WriteFailed):
    """Another writer committed under the number that this one expected to take."""


class WorkerDied(FsarLedgerError):
    """A process that worked for the command was ended from outside, so the command could not finish; nothing is known of what it did not do."""


class LedgerCorrupted(FsarLedgerError):
    """The ledger contradicts itself."""

    exit_code = 3


class UnknownEventTag(LedgerCorrupted):
    """A stored event has a type that this version does not know."""


class ReplayMismatch(LedgerCorrupted):
    """Replay gives other events than those that are stored."""
