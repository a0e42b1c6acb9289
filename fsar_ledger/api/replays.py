"""The methods of `Ledger` that replay: moments, differences, what would have been, and why."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from .lookup import run_of, time_of
from .names import Place, Run, Time, names_of

if TYPE_CHECKING:
    from fsar_ledger.ledger.rows.codec import LedgerRun
    from fsar_ledger.ledger.store.read import LedgerView
    from fsar_ledger.projections.fold import State

    from .causes import Caused
    from .provenance import Provenance
    from .table import Table
    from .whatif import Asked, Fork, WhatIf
    from .workload import Progress


class Replays:
    """The part of `Ledger` that replays runs."""

    path: Path
    _demanded: str | None

    def record(self, run: Run) -> "LedgerRun":
        """Return the record of a run: its events, each with its time and the seq of its cause.

        Raises:
            UsageError: There is no such run.
        """
        from fsar_ledger.analysis.records import record_of

        view, _ = self._view()
        return record_of(view, self._name(run))

    def _view(self) -> "tuple[LedgerView, Provenance]":
        from fsar_ledger.ledger.store.opening import open_for_answers
        from fsar_ledger.metrics.verified import is_verified

        from .provenance import Provenance

        view = open_for_answers(self.path)
        return view, Provenance(view.head, is_verified(view, self._demanded))

    def _name(self, run: Run) -> str:
        from fsar_ledger.metrics.database import connect

        with connect(self.path, demanded=self._demanded) as database:
            return run_of(database, run, self.path)

    def state(self, run: Run, at: Time = None) -> "State":
        """Return the state of a run at a time, or at its end: tasks, queues, trust, policies.

        Raises:
            UsageError: There is no such run, or `at` is no time of it.
        """
        from fsar_ledger.metrics.database import connect
        from fsar_ledger.projections.fold import fold

        record = self.record(run)
        with connect(self.path, demanded=self._demanded) as database:
            until_us = time_of(database, "at", at, record.run_id)
        timed = zip(record.times_us, record.events, strict=True)
        return fold(event for time_us, event in timed if until_us is None or time_us <= until_us)

    def fork(self, run: Run, changes: "Asked") -> "Fork":
        """Fork a run: repeat it up to the first change, and play on under the same draws. Nothing is stored.

        Args:
            run: A simulated run of this model version.
            changes: Texts such as `drop window:fleet/B1/0`, or the names of `.toml` files; none gives a null fork.

        Raises:
            UsageError: There is no such run, it cannot be made again, or a change is none or has no effect.
        """
        from fsar_ledger.analysis.records import record_of

        from .whatif import fork_of

        view, _ = self._view()
        return fork_of(view, record_of(view, self._name(run)), changes)

    def whatif(
        self,
        changes: "Asked",
        run: Run | None = None,
        *,
        architecture: str | Sequence[str] | None = None,
        out: Place | None = None,
        progress: "Progress | None" = None,
    ) -> "WhatIf":
        """Fork a run, or all of them, and measure what the changes do to every metric, in pairs.

        Args:
            changes: As in `fork`.
            run: A run; None: all simulated runs. In one of them what a name does not mean there changes nothing.
            architecture: Only the runs of this one, or of these.
            out: A ledger to store the forks in, each beside its base; created if there is none.
            progress: Called with the forks that were played, and their number.

        Raises:
            UsageError: As `fork`; or no run does anything else; or `out` lies inside a ledger.
            WriteFailed: `out` cannot be written.
        """
        from fsar_ledger.analysis.records import record_of

        from .whatif import what_if

        view, provenance = self._view()
        records = None if run is None else [record_of(view, self._name(run))]
        place = None if out is None else Path(out)
        return what_if(view, provenance, records, changes, names_of(architecture) or (), place, progress)

    def changeable(self, run: Run) -> "Table":
        """Return what the changes of a run can name: the facts of its world, and what it asks at its ports.

        The answer has a row for each: its name, a shorter one, when it begins and ends, and what happens or is the
        answer.

        Raises:
            UsageError: There is no such run, or it cannot be made again.
        """
        from fsar_ledger.analysis.bases import Changeable, base_of_record, repeated
        from fsar_ledger.analysis.records import record_of

        from .table import Table, of_structs

        view, provenance = self._view()
        found = repeated(base_of_record(record_of(view, self._name(run)), view.head.root)).changeable()
        return Table(of_structs(found, Changeable), provenance)

    def cause(
        self,
        run: Run,
        outcome: str,
        *,
        lengths: bool = False,
        futures: int = 50,
        progress: "Progress | None" = None,
    ) -> "Caused":
        """Find a smallest set of facts and answers that suffices for an outcome, and when it became unavoidable.

        Args:
            run: A simulated run of this model version.
            outcome: A condition on a metric (`policy_violations > 0`) or on the number of violations of an invariant
                (`i3 > 0`), or a SELECT of the `run_id` of each run that has it.
            lengths: Whether the lengths of messages, ways, executions and responses count as causes, too.
            futures: How many futures to draw from each moment; 0: none.
            progress: Called with the runs that were played, and their number, where it is known.

        Raises:
            UsageError: The run does not have the outcome, or it cannot be made again.
            QueryFailed: The SELECT fails.
        """
        from fsar_ledger.analysis.records import record_of

        from .causes import cause_of

        view, provenance = self._view()
        record = record_of(view, self._name(run))
        return cause_of(record, provenance, outcome, lengths=lengths, futures=futures, progress=progress)
