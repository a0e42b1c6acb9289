"""What would have been: forks of the runs of a ledger, and the effect of their changes."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import msgspec

from fsar_ledger.analysis.bases import Base, base_of_record, repeated
from fsar_ledger.analysis.whatif import Effects, Pair, effects, forked, keep, simulated
from fsar_ledger.errors import UsageError, option
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.store.paths import require_outside
from fsar_ledger.ledger.store.read import Head, LedgerView
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
    seq at which they differ, and `parted_s` when that is, in seconds of run time; None: they do the same. Event 0 of
    the fork, which says from where it forks and what is changed, does not count.
    """

    base: LedgerRun
    record: LedgerRun
    changes: tuple[str, ...]
    parts_at: int | None

    @property
    def parted_s(self) -> float | None:
        """Return when they part."""
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
    forks: tuple[Fork, ...]
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


def fork_of(view: LedgerView, record: LedgerRun, asked: Asked) -> Fork:
    """Return the fork of a record of this ledger, in which every change has an effect. Raises: UsageError."""
    return _fork(_one(base_of_record(record, view.head.root), changes_of(asked)))


def what_if(
    view: LedgerView,
    provenance: Provenance,
    records: Sequence[LedgerRun] | None,
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
    root = view.head.root
    if records is not None:
        pairs = [_one(base_of_record(record, root), changes) for record in records]
    else:
        pairs = fork_pairs(view, changes, architectures, progress)
    judged = effects(pairs)
    kept = None if out is None else keep(out, pairs)
    found = tuple(_fork(pair) for pair in pairs)
    story = None if records is None else difference_of(found[0].base, found[0].record, (provenance,))
    return WhatIf(found[0].changes if found else (), found, judged, story, provenance, kept)


def fork_pairs(
    view: LedgerView, changes: Changes, architectures: Sequence[str], progress: Progress | None = None
) -> list[Pair]:
    """Return each simulated run of a ledger, or of these architectures, with its fork.

    Raises:
        UsageError: There is no such run, one cannot be made again, or no fork does anything else.
    """
    bases = [base_of_record(record, view.head.root) for record in _of(simulated(view.runs()), architectures)]
    pairs = forked(bases, changes, len(bases), progress)
    if changes and not any(pair.fork.parts_at for pair in pairs):
        repeated(bases[0]).fork_with_effect(changes)
        raise UsageError(f"none of {len(bases):,} runs does anything else with these changes; expected some effect")
    return pairs


def _one(base: Base, changes: Changes) -> Pair:
    return Pair(base, repeated(base).fork_with_effect(changes))


def _of(records: Iterable[LedgerRun], architectures: Sequence[str]) -> list[LedgerRun]:
    """Return the runs of these architectures, or all. Raises: UsageError if one of them has none."""
    found = list(records)
    names = {_architecture(one) for one in found}
    for asked in architectures:
        if asked not in names:
            hint = did_you_mean(asked, names) or ";"
            raise UsageError(
                f"{option('architecture', value(asked))}: there is no such run{hint} expected one of "
                f"{', '.join(sorted(names))}"
            )
    return [one for one in found if not architectures or _architecture(one) in architectures]


def _architecture(record: LedgerRun) -> str:
    started = record.events[0]
    assert isinstance(started, RunStarted)
    return started.architecture or ""


def _fork(pair: Pair) -> Fork:
    started = pair.fork.record.events[0]
    assert isinstance(started, RunStarted)
    return Fork(pair.base.record, pair.fork.record, started.changes or (), pair.fork.parts_at)
