"""The methods of `Ledger` that replay: moments, differences, what would have been, and why."""

from pathlib import Path
from typing import TYPE_CHECKING

from .lookup import run_of, time_of
from .names import Run, Time

if TYPE_CHECKING:
    from fsar_ledger.ledger.rows.codec import LedgerRun
    from fsar_ledger.projections.fold import State


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
        from fsar_ledger.ledger.store.opening import open_for_answers
        from fsar_ledger.metrics.database import connect
        from fsar_ledger.metrics.verified import is_verified

        with connect(self.path, demanded=self._demanded) as database:
            name = run_of(database, run, self.path)
        view = open_for_answers(self.path)
        is_verified(view, self._demanded)
        return record_of(view, name)

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
