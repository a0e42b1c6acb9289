"""The methods of `Ledger` that replay: moments, differences, what would have been, and why."""

from pathlib import Path
from typing import TYPE_CHECKING

from .lookup import time_of
from .names import Place, Run, Time

if TYPE_CHECKING:
    from fsar_ledger.ledger.rows.codec import LedgerRun
    from fsar_ledger.ledger.store.view import View

    from .ledger import Ledger
    from .pictures import Picture
    from .provenance import Provenance
    from .walks import Steps


class Replays:
    """The part of `Ledger` that replays runs."""

    path: Path

    @property
    def demanded(self) -> str | None: ...  # noqa: D102

    if TYPE_CHECKING:

        def __init__(self, path: Place, *, demanded: str | None = None) -> None: ...

    def record(self, run: Run) -> "LedgerRun":
        """Return the record of a run: its events, each with its time and the seq of its cause.

        Raises:
            UsageError: There is no such run.
        """
        from fsar_ledger.analysis.records import record_of

        view, _ = self._view()
        return record_of(view, self._name(view, run))

    def _view(self) -> "tuple[View, Provenance]":
        from fsar_ledger.ledger.opening import open_for_answers
        from fsar_ledger.metrics.verified import is_verified

        from .provenance import Provenance

        view = open_for_answers(self.path)
        return view, Provenance(view.head, is_verified(view, self.demanded))

    def _name(self, view: "View", run: Run) -> str:
        from .lookup import run_in

        return run_in(view, run, self.demanded)

    def step(self, run: Run, at: Time = None) -> "Steps":
        """Return a walk through a run: to the next event, decision or refusal, to a cause, a time or a text.

        Args:
            run: The run.
            at: Where to begin; None: at event 0.

        Raises:
            UsageError: There is no such run, or `at` is no time of it.
        """
        from fsar_ledger.analysis.records import record_of

        from .lookup import about_run
        from .walks import Steps

        view, provenance = self._view()
        with about_run(view, run, self.demanded) as (database, name, _):
            at_us = time_of(database, "at", at, name)
        return Steps(record_of(view, name), provenance, at_us)

    def view(
        self,
        out: Place,
        run: Run | None = None,
        second: Run | None = None,
        other: "Ledger | None" = None,
    ) -> "Picture":
        """Write a page of HTML that shows a run: lanes, a time cursor, every event; it needs no network.

        Args:
            out: A file whose name ends in .html; replaced if it exists.
            run: The run; None: the first.
            second: Another run, shown below the first; their first difference is marked.
            other: The ledger that holds `second`; None: this one. Without `second`: its run of the same name.

        Raises:
            UsageError: There is no such run, both are the same, `out` has another suffix or lies inside a ledger.
            WriteFailed: The file cannot be written.
        """
        from .pictures import Source, write_page

        beside = None if other is None else Source(other.path, other.demanded)
        return write_page(Source(self.path, self.demanded), Path(out), run, second, beside)

    def trace(self, out: Place, run: Run | None = None) -> "Picture":
        """Write a run as trace events, which ui.perfetto.dev opens: for runs too long for a page.

        Args:
            out: A file whose name ends in .json; replaced if it exists.
            run: The run; None: the first.

        Raises:
            UsageError: There is no such run, or `out` has another suffix or lies inside a ledger.
            WriteFailed: The file cannot be written.
        """
        from .pictures import Source, write_trace

        return write_trace(Source(self.path, self.demanded), Path(out), run)
