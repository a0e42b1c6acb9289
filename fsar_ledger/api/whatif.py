"""What would have been: forks of the runs of a ledger, and the effect of their changes."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import msgspec

from fsar_ledger.analysis.bases import base_of_record, repeated
from fsar_ledger.analysis.records import record_of, starts_of
from fsar_ledger.analysis.whatif import Effects, Pair, Parted, effects, forked, keep
from fsar_ledger.errors import UsageError, option
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.ledger.chain.read import View
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.store.paths import require_outside
from fsar_ledger.ledger.store.view import Head
from fsar_ledger.printable import did_you_mean, value
from fsar_ledger.runtime.change_texts import parsed, read_changes
from fsar_ledger.runtime.changes import Changes

from .difference import Diff, difference_of
from .provenance import Provenance
from .workload import Progress

Asked = str | Sequence[str]
"""Changes as texts (`docs/replay.md`); one that ends in `.toml` is a file of them."""


class Fork(msgspec.Struct, frozen=True):
    """A fork of a recorded run.

    `record` is what happens in it, as `Ledger.record` returns it; `base` the run as recorded. `parts_at` is the first
    seq at which they differ; None: they do the same. Event 0 of the fork, which says from where it forks and what is
    changed, does not count.
    """

    base: LedgerRun
    record: LedgerRun
    changes: tuple[str, ...]
    parts_at: int | None

    @property
    def parted_s(self) -> float | None:
        """Return when they part, in seconds of run time."""
        if self.parts_at is None:
            return None
        times = [run.times_us[self.parts_at] for run in (self.base, self.record) if self.parts_at < len(run.times_us)]
        return min(times) / 1_000_000


class WhatIf(msgspec.Struct, frozen=True):
    """Forks with the same changes, and the effects on every metric.

    `story` says where base and fork of a single run part, and why; None: there are several. `kept` is the head of the
    ledger in which they were stored, each beside its base; None: nowhere.
    """

    changes: tuple[str, ...]
    forks: tuple[Parted, ...]
    effects: list[Effects]
    story: Diff | None
    provenance: Provenance
    kept: Head | None

    @property
    def diverging(self) -> int:
        """Return how many forks do not do the same as their base."""
        return sum(one.parts_at is not None for one in self.forks)


def changes_of(asked: Asked) -> Changes:
    """Return the changes of these texts and files. Raises: UsageError."""
    found: Changes = ()
    for one in [asked] if isinstance(asked, str) else asked:
        found += read_changes(Path(one)) if one.endswith(".toml") else parsed([one])
    return found


def fork_of(view: View, record: LedgerRun, asked: Asked) -> Fork:
    """Return the fork of a record of this ledger, in which every change has an effect. Raises: UsageError."""
    pair = _one(view, record, changes_of(asked))
    started = pair.fork.record.events[0]
    assert isinstance(started, RunStarted)
    return Fork(record, pair.fork.record, started.changes or (), pair.fork.parts_at)


def what_if(
    view: View,
    provenance: Provenance,
    record: LedgerRun | None,
    asked: Asked,
    architectures: Sequence[str],
    out: Path | None,
    progress: Progress | None,
) -> WhatIf:
    """Fork one run, in which every change must mean something, or with None all simulated runs, and judge them.

    Raises:
        UsageError: A change is not one, or means nothing; a run cannot be made again; `out` is the ledger itself.
    """
    changes = changes_of(asked)
    if out is not None:
        if out.resolve() == view.path.resolve():
            raise UsageError(f"{option('out', out)}: found the ledger of the bases, expected another place")
        require_outside(out.parent, option("out", out))
    texts = tuple(map(str, changes))
    if record is not None:
        pair = _one(view, record, changes)
        found, judged = effects([pair])
        story = difference_of(record, pair.fork.record, (provenance,))
        kept = None if out is None else keep(out, [pair])
        return WhatIf(texts, tuple(found), judged, story, provenance, kept)
    runs = runs_of(view, architectures)
    counted = None if progress is None else lambda done: progress(done, len(runs))
    found, judged = effects(fork_pairs(view, runs, changes), counted)
    if changes and not any(one.parts_at for one in found):
        _one(view, record_of(view, runs[0]), changes)  # says why it has no effect there
        raise UsageError(f"none of {len(runs):,} runs does anything else with these changes; expected some effect")
    kept = None if out is None else keep(out, fork_pairs(view, runs, changes))
    return WhatIf(texts, tuple(found), judged, None, provenance, kept)


def runs_of(view: View, architectures: Sequence[str]) -> list[str]:
    """Return the simulated runs of these architectures, or all, but no forks.

    Raises:
        UsageError: There is none.
    """
    starts = [(run, started) for run, started in starts_of(view) if started.kind == "simulated" and not started.changes]
    names = {started.architecture or "" for _, started in starts}
    for asked in architectures:
        if asked not in names:
            hint = did_you_mean(asked, names) or ";"
            raise UsageError(
                f"{option('architecture', value(asked))}: there is no such run{hint} expected one of "
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
    return forked((base_of_record(record, view.head.root) for record in records), changes)


def _one(view: View, record: LedgerRun, changes: Changes) -> Pair:
    base = base_of_record(record, view.head.root)
    return Pair(base, repeated(base).fork_with_effect(changes))
