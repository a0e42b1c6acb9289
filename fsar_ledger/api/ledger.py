"""A ledger in Python: a method for every command that reads one, under the same name."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from fsar_ledger.ledger.opening import open_for_answers

from . import audit as _audit
from . import bisect as _bisect
from . import cause as _cause
from . import compare as _compare
from . import diff as _diff
from . import explain as _explain
from . import export as _export
from . import info as _info
from . import log as _log
from . import metrics as _metrics
from . import open as _open
from . import prove as _prove
from . import sql as _sql
from . import state as _state
from . import statistics as _statistics
from . import verify as _verify
from . import view as _view
from . import whatif as _whatif
from . import why as _why
from .integrity import Integrity
from .lookup import AboutRun, about_run, numbers_of, parameters_of, present, recorded, robot_of, run_of, time_of
from .names import Place, Pool, Run, Time, names_of, pools_seeds
from .workload import Progress, readers_of

if TYPE_CHECKING:
    from fsar_ledger.ledger.rows.codec import LedgerRun
    from fsar_ledger.ledger.store.view import Head
    from fsar_ledger.metrics.database import Database
    from fsar_ledger.metrics.progress import Showing

    from .events import Events
    from .multiverse import MultiverseResult
    from .table import Table
    from .walks import Steps


class Ledger(Integrity):
    """A ledger to query. Each answer holds for the newest commit at that moment, and names its head.

    A run is given by its name, its number (`numbers()`), or a part of its name that no other run has; a robot as `B1`
    or `robot/B1`; a time of the run in seconds, or as text: `46.6`, `46.6s` or `46600ms`.

    Args:
        path: The folder of the ledger.
        demanded: The SHA-256 of the newest record, whose rows were just compared with its root; answers about any other
            head are refused. A function that compares them and returns it is called when the ledger is first read.
    """

    def __init__(self, path: Place, *, demanded: str | Callable[[], str | None] | None = None) -> None:
        self.path = Path(path)
        self._demanded = demanded

    def __repr__(self) -> str:
        return f"Ledger({str(self.path)!r})"

    @property
    def demands(self) -> bool:
        """Return whether answers about any other head than one are refused."""
        return self._demanded is not None

    @property
    def demanded(self) -> str | None:
        """Return the newest record's SHA-256 if answers about any other head are refused."""
        if callable(self._demanded):
            self._demanded = self._demanded()
        return self._demanded

    @property
    def head(self) -> "Head":
        """Return the present head: commits, events and the root over them. Raises: As `open_ledger`."""
        return open_for_answers(self.path).head

    # --- what it holds ---

    info = _info.info

    def runs(self) -> "Table":
        """Return a row for each run, with its number, architecture, configuration, scenario, seed and fleet size."""
        return self.query("staging/runs")

    def events(
        self,
        run: Run | None = None,
        since: Time = None,
        until: Time = None,
        robot: str | None = None,
    ) -> "Events":
        """Return the events of a run, from `since` and before `until`, that name a robot; None: all.

        Raises:
            UsageError: There is no such run or robot, `since` is after the last event, or `until` not after `since`.
        """
        from .events import Events, Filter, span

        since_us, until_us = span(since, until)
        name = None
        if run is not None or robot is not None or since is not None:
            with self.database() as database:
                name = None if run is None else run_of(database, run, self.path)
                robot = None if robot is None else robot_of(database, robot, name)
                time_of(database, "since", since, name)
        return Events(self.path, Filter(name, since_us, until_us, robot), self.demanded)

    def numbers(self) -> dict[str, int]:
        """Return the number of each run, by its name: the short name that every question takes for it."""
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
        if run is not None or not action:
            with about_run(open_for_answers(self.path), run, self.demanded) as found:
                yield found
            return
        from .explain import run_with

        with self.database() as database:
            name = run_with(database, self.path, action)
            yield AboutRun(database, name, numbers_of(database).get(name))

    # --- questions ---

    def query(self, name: str, /, **parameters: object) -> "Table":
        """Answer a packaged query (`queries()` lists them); a parameter of None has its default.

        Raises:
            UnknownQuery: There is no query or parameter of this name.
            UsageError: A parameter names nothing that there is, or is no time of the run.
        """
        from .provenance import of_rows
        from .table import Table

        with self.database() as database:
            query = database.library.find(name)
            given = parameters_of(database, query, parameters, self.path)
            rows = database.query(name, given)
            return Table(rows, of_rows(database, query))

    def queries(self, *, all: bool = False) -> "Table":
        """Return the packaged queries by group, each with its title and its parameters.

        Parameters have their defaults; None means that a value must be given.

        Args:
            all: Also the view of each event type and of each concern.
        """
        import pyarrow as pa

        from fsar_ledger.metrics.groups import group_of, listed

        from .table import Table

        found = listed(events=all)
        columns = {
            "group": pa.array([group_of(one) for one in found], pa.string()),
            "name": pa.array([one.name for one in found], pa.string()),
            "title": pa.array([one.header["Title"] for one in found], pa.string()),
            "parameters": pa.array(
                [[(each.name, each.default) for each in one.parameters.values()] for one in found],
                pa.map_(pa.string(), pa.string()),
            ),
        }
        return Table(pa.table(columns))

    def query_text(self, name: str) -> str:
        """Return the SQL of a packaged query with its header, which says what its rows and its NULLs mean.

        Raises:
            UnknownQuery: There is no query of this name.
        """
        from fsar_ledger.metrics.groups import text_of

        return text_of(name)

    sql = _sql.sql
    requests = _explain.requests
    explain = _explain.explain

    log = _log.log
    stream_log = _log.stream_log

    # --- replays ---

    def record(self, run: Run) -> "LedgerRun":
        """Return the record of a run: its events, each with its time and the seq of its cause.

        Raises:
            UsageError: There is no such run.
        """
        return recorded(self, open_for_answers(self.path), run)

    def step(self, run: Run, at: Time = None) -> "Steps":
        """Return a walk through a run: to the next event, decision or refusal, to a cause, a time or a text.

        Args:
            run: The run.
            at: Where to begin; None: at event 0.

        Raises:
            UsageError: There is no such run, or `at` is no time of it.
        """
        from .walks import Steps

        view, provenance = present(self)
        with about_run(view, run, self.demanded) as (database, name, _):
            at_us = time_of(database, "at", at, name)
        return Steps(recorded(self, view, name), provenance, at_us)

    state = _state.state
    why = _why.why
    verdicts = _why.verdicts
    diff = _diff.diff
    fork = _whatif.fork
    whatif = _whatif.whatif
    changeable = _whatif.changeable
    cause = _cause.cause
    bisect = _bisect.bisect
    view = _view.view
    trace = _view.trace

    # --- judgement ---

    metrics = _metrics.metrics
    statistics = _statistics.statistics
    compare = _compare.compare
    audit = _audit.audit
    verify = _verify.verify
    prove = _prove.prove

    def multiverse(
        self, metric: str | Sequence[str] | None = None, pool: Pool = None, *, progress: Progress | None = None
    ) -> "MultiverseResult":
        """Compute the results table under every reading that the paper's text allows.

        `progress` is called with the combinations of readings that were read, and their number.
        """
        from .multiverse import read_multiverse

        pooled = pools_seeds(pool)
        with self.database() as database:
            return read_multiverse(database, names_of(metric), pools_seeds=pooled, progress=progress)

    # --- files ---

    export = _export.export
    open = _open.open

    def report(
        self,
        out: Place,
        *,
        beside: Sequence[Place] = (),
        workflows: Place | None = None,
        sensitivity: Place | None = None,
        numbers: Place | None = None,
        pool: Pool = None,
        workers: int | None = None,
        showing: "Showing | None" = None,
    ) -> None:
        """Typeset the evaluation as a PDF, after comparing all rows with their root.

        Args:
            out: The PDF; replaced if it exists.
            beside: Other ledgers to show, of ablations, larger fleets or workflows.
            workflows: A ledger of the workflows.
            sensitivity: A file of `fsar-ledger study run sensitivity`.
            numbers: A file for all its numbers, as JSON.
            pool: As in `metrics`.
            workers: As in `verify`.
            showing: Called with a verb and a unit for each step; returns a context that yields a progress function.
        """
        from fsar_ledger.metrics.progress import unseen
        from fsar_ledger.report import write_report

        def path(place: Place | None) -> Path | None:
            return None if place is None else Path(place)

        write_report(
            self.path,
            Path(out),
            path(workflows),
            readers_of(workers, self.path),
            showing or unseen,
            beside=list(map(Path, beside)),
            pools_seeds=pools_seeds(pool),
            sensitivity=path(sensitivity),
            numbers_out=path(numbers),
        )

    @contextmanager
    def database(self) -> "Iterator[Database]":
        """Yield a DuckDB connection over the events and the packaged queries."""
        from fsar_ledger.metrics.database import connect

        with connect(self.path, demanded=self.demanded) as database:
            yield database
