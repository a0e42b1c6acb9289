"""The methods of `Ledger` that tell runs event by event, in words."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from fsar_ledger.errors import UsageError

from .names import Run, Time

if TYPE_CHECKING:
    from .log import Pause
    from .lookup import AboutRun
    from .table import Table


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

    def log(
        self,
        run: Run | None = None,
        since: Time = None,
        until: Time = None,
        robot: str | None = None,
        about: str | Sequence[str] | None = None,
    ) -> "Table":
        """Return a readable line for each event of a run: who tells whom what, or does what, and when.

        Args:
            run: The run; None: the first; `all`: every run.
            since: Only from this time on.
            until: Only before this time, which may be after the end of the run.
            robot: Only events that name this robot.
            about: Only events of these concerns, such as `requests` or `policy,trust`.

        Raises:
            UsageError: There is no such run, robot or concern, the run has ended before `since`, or `until` is not
                after `since`.
        """
        from fsar_ledger.metrics.database import connect

        from .log import ALL, asked_of, timeline

        if run == ALL:
            with connect(self.path, demanded=self.demanded) as database:
                return timeline(database, asked_of(database, self.path, ALL, since, until, robot, about))
        with self.about_run(run) as (database, name, _):
            return timeline(database, asked_of(database, self.path, name, since, until, robot, about))

    def stream_log(
        self,
        since: Time = None,
        until: Time = None,
        robot: str | None = None,
        about: str | Sequence[str] | None = None,
        *,
        pause: "Pause | None" = None,
    ) -> "Iterator[Table]":
        """Yield the lines of all runs, as `log`, a table for each commit; with `pause`, go on as the ledger grows.

        Args:
            since: As in `log`.
            until: As in `log`.
            robot: As in `log`.
            about: As in `log`.
            pause: Called before each look for more commits, to wait a moment; None: end after those that are there.

        Raises:
            UsageError: As `log`; or `pause` is given, and only rows that were compared with the root will do.
            LedgerCorrupted: The ledger was damaged or replaced.
        """
        from fsar_ledger.metrics.database import connect

        from .log import ALL, about_of, asked_of, stream

        if pause is not None and self.demanded is not None:
            raise UsageError(
                "rows that will be committed later cannot have been compared with the root yet: expected a ledger that "
                "was opened without demanding that, or no waiting for more"
            )
        with connect(self.path, demanded=self.demanded) as database:
            asked = asked_of(database, self.path, ALL, since, until, robot, about, is_growing=pause is not None)
            provenance = about_of(database, asked)
        return stream(self.path, asked, provenance, self.demanded, pause)
