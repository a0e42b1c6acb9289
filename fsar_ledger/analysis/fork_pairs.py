"""The forks that a question asks for: its changes, the runs of a ledger, and each beside its fork."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from fsar_ledger.base import printable
from fsar_ledger.base.errors import UsageError, option
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.store.read import View
from fsar_ledger.runtime.change_texts import parsed, read_changes
from fsar_ledger.runtime.changes import Changes

from .fork_base import base_of_record, rerun
from .records import starts_of
from .whatif import Pair, forks_of


def changes_of(asked: str | Sequence[str]) -> Changes:
    """Return the changes of these texts and files. Raises: UsageError."""
    found: Changes = ()
    for one in [asked] if isinstance(asked, str) else asked:
        found += read_changes(Path(one)) if one.endswith(".toml") else parsed([one])
    return found


def runs_of(view: View, architectures: Sequence[str]) -> list[str]:
    """Return the simulated runs of these architectures, or all, but no forks.

    Raises:
        UsageError: There is none.
    """
    starts = [(run, started) for run, started in starts_of(view) if started.kind == "simulated" and not started.changes]
    names = {started.architecture or "" for _, started in starts}
    for asked in architectures:
        if asked not in names:
            hint = printable.did_you_mean(asked, names) or ";"
            raise UsageError(
                f"{option('architecture', printable.value(asked))}: there is no such run{hint} expected one of "
                f"{', '.join(sorted(names)) or 'none: it holds no simulated run'}"
            )
    found = [run for run, started in starts if not architectures or started.architecture in architectures]
    if not found:
        raise UsageError(f"{view.path}: found no simulated run that is not a fork itself, expected some to fork from")
    return found


def fork_pairs(view: View, runs: Sequence[str], changes: Changes) -> Iterator[Pair]:
    """Yield these runs of a ledger, each with its fork. Raises: UsageError if one cannot be made again."""
    asked = set(runs)
    records = (record for record in view.runs() if record.run_id in asked)
    return forks_of((base_of_record(record, view.head.root) for record in records), changes)


def fork_of(view: View, record: LedgerRun, changes: Changes) -> Pair:
    """Return the run with its fork. Raises: UsageError if it cannot be made again, or the changes have no effect."""
    base = base_of_record(record, view.head.root)
    return Pair(base, rerun(base).fork_with_effect(changes))
