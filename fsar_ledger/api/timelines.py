"""The methods of `Ledger` that tell runs event by event, in words."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from .names import Run

if TYPE_CHECKING:
    from .lookup import AboutRun


class Timelines:
    """The part of `Ledger` that tells a run in order."""

    path: Path

    @property
    def demanded(self) -> str | None: ...  # noqa: D102

    def numbers(self) -> dict[str, int]:
        """Return the number of each run, by its name: the short name that every question takes for it."""
        from fsar_ledger.ledger.opening import open_for_answers
        from fsar_ledger.metrics.verified import is_verified_for_runs

        view = open_for_answers(self.path)
        is_verified_for_runs(view, self.demanded)
        return view.run_names.numbers()

    @contextmanager
    def about_run(self, run: Run | None, action: str | None = None) -> "Iterator[AboutRun]":
        """Yield what there is about one run; without a run, the database is perhaps over all events.

        Args:
            run: The run; None: the only one with this action or, without an action, the first.
            action: As `run` says.

        Raises:
            UsageError: There is no such run, or none or several have the action.
        """
        from fsar_ledger.ledger.opening import open_for_answers

        from .lookup import AboutRun, about_run, numbers_of

        if run is not None or not action:
            with about_run(open_for_answers(self.path), run, self.demanded) as found:
                yield found
            return
        from fsar_ledger.metrics.database import connect

        from .explain import run_with

        with connect(self.path, demanded=self.demanded) as database:
            name = run_with(database, self.path, action)
            yield AboutRun(database, name, numbers_of(database).get(name))
