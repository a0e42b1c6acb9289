"""A ledger in Python: a method for every command that reads one, under the same name."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import pyarrow as pa

from fsar_ledger.base.errors import checked
from fsar_ledger.base.progress import Progress
from fsar_ledger.ledger.opening import open_checked, open_for_answers
from fsar_ledger.metrics.library import library
from fsar_ledger.metrics.own_sql import group_of, listed, text_of
from fsar_ledger.metrics.verified import ensure_verified, is_remembered, is_verified_for_runs

from . import audit as _audit
from . import bisect as _bisect
from . import cause as _cause
from . import compare as _compare
from . import diff as _diff
from . import explain as _explain
from . import export as _export
from . import federate as _federate
from . import info as _info
from . import key as _key
from . import log as _log
from . import maintain as _maintain
from . import metrics as _metrics
from . import prove as _prove
from . import query as _query
from . import report as _report
from . import state as _state
from . import verify as _verify
from . import view as _view
from . import whatif as _whatif
from . import why as _why
from .lookup import AboutRun, about_run, parameters_of, recorded, resolve_run, robot_of, run_time, time_of
from .names import Place, Run, Time
from .verbs import readers_of

if TYPE_CHECKING:
    from fsar_ledger.ledger.rows.codec import LedgerRun
    from fsar_ledger.ledger.store.record import Head
    from fsar_ledger.metrics.database import Database

    from .events import Events
    from .table import Table


class Ledger:
    """A ledger to query. Each answer holds for the newest commit at that moment, and names its head.

    A run is given by its name, its number (`numbers()`), or a part of its name that no other run has; a robot as `B1`
    or `robot/B1`; a time of the run in seconds, or as text: `46.6`, `46.6s` or `46600ms`.

    Args:
        path: The folder of the ledger.
        demanded: The SHA-256 of the newest record, whose rows were just compared with its root; answers about any other
            head are refused. A function that compares them and returns it is called when the ledger is first read.
    """

    @checked
    def __init__(self, path: Place, *, demanded: str | Callable[[], str | None] | None = None) -> None:
        self.path = Path(path)
        self._demanded = demanded

    def __repr__(self) -> str:
        return f"Ledger({str(self.path)!r})"

    @property
    def demands(self) -> bool:
        """Return whether answers about all heads but one are refused."""
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

    # --- contents ---

    info = _info.info

    def runs(self) -> "Table":
        """Return a row for each run, with its number, architecture, configuration, scenario, seed and fleet size."""
        return self.query("staging/runs")

    @checked
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

        name = None
        if any(given is not None for given in (run, since, until, robot)):
            if run is not None:
                name = resolve_run(open_for_answers(self.path), run, self.demanded, is_whole=True)
            with self.database() as database:
                since, until = (
                    run_time(database, side, time, name) for side, time in (("since", since), ("until", until))
                )
                robot = None if robot is None else robot_of(database, robot, name)
                time_of(database, "since", since, name)
        since_us, until_us = span(since, until)
        return Events(self.path, Filter(name, since_us, until_us, robot), self.demanded)

    def numbers(self) -> dict[str, int]:
        """Return the number of each run, by its name: the short name that every question takes for it."""
        view = open_for_answers(self.path)
        is_verified_for_runs(view, self.demanded)
        return view.run_names.numbers()

    @contextmanager
    def about_run(self, run: Run | None, action: str | None = None, *, is_whole: bool = False) -> "Iterator[AboutRun]":
        """Yield a database about one run; without `run`, it may cover all events.

        Args:
            run: The run; None: the only one with this action or, without an action, the first.
            action: An action of the run, if `run` is None.
            is_whole: Include the runs that continue it.

        Raises:
            UsageError: There is no such run, or none or several have the action.
        """
        if run is not None or not action:
            with about_run(open_for_answers(self.path), run, self.demanded, is_whole=is_whole) as about:
                yield about
            return
        with self.database() as database:
            name = _explain.run_with(self, database, action)
            yield AboutRun(database, name, self.numbers().get(name))

    # --- queries ---

    @checked
    def query(self, name: str, /, **parameters: object) -> "Table":
        """Answer a packaged query (`queries()` lists them); a parameter of None has its default.

        Raises:
            UnknownQuery: There is no query or parameter of this name.
            UsageError: A parameter names nothing in the ledger, or is not a time of the run.
        """
        from fsar_ledger.metrics.provenance import of_rows

        from .table import Table

        query = library().find(name)
        runs = {parameter.name: parameter.default for parameter in query.parameters.values() if parameter.kind == "run"}
        chosen = {name: parameters[name] for name in runs if parameters.get(name) not in (None, runs[name])}
        with ExitStack() as stack:
            if chosen:  # a query about one run reads that run only
                [(parameter, run)] = chosen.items()
                view = open_for_answers(self.path)
                database, full, _ = stack.enter_context(about_run(view, run, self.demanded, is_whole=True))
                parameters = {**parameters, parameter: full}
            else:
                database = stack.enter_context(self.database())
            values = parameters_of(database, query, parameters)
            rows = database.query(name, values)
            return Table(rows, of_rows(database, query, full if chosen else None))

    @checked
    def queries(self, *, all: bool = False) -> "Table":
        """Return the packaged queries by group, each with its title and its parameters.

        Parameters have their defaults; None means that a value must be given.

        Args:
            all: Also the view of each event type and of each concern.
        """
        from .table import Table

        queries = listed(events=all)
        columns = {
            "group": pa.array([group_of(query) for query in queries], pa.string()),
            "name": pa.array([query.name for query in queries], pa.string()),
            "title": pa.array([query.header["Title"] for query in queries], pa.string()),
            "parameters": pa.array(
                [[(parameter.name, parameter.default) for parameter in query.parameters.values()] for query in queries],
                pa.map_(pa.string(), pa.string()),
            ),
        }
        return Table(pa.table(columns))

    @checked
    def query_text(self, name: str) -> str:
        """Return the SQL of a packaged query with its header, which says what its rows and its NULLs mean.

        Raises:
            UnknownQuery: There is no query of this name.
        """
        return text_of(name)

    sql = _query.sql
    requests = checked(_explain.requests)
    explain = _explain.explain

    log = _log.log
    stream_log = checked(_log.stream_log)

    # --- replays ---

    @checked
    def record(self, run: Run) -> "LedgerRun":
        """Return the record of a run: its events, each with its time and the seq of its cause.

        Raises:
            UsageError: There is no such run.
        """
        return recorded(self, open_for_answers(self.path), run)

    step = _state.step
    state = _state.state
    why = _why.why
    verdicts = checked(_why.verdicts)
    diff = _diff.diff
    fork = checked(_whatif.fork)
    whatif = _whatif.whatif
    changeable = checked(_whatif.changeable)
    cause = _cause.cause
    bisect = _bisect.bisect
    view = _view.view
    trace = checked(_view.trace)

    hand_over = _federate.hand_over

    # --- judgement ---

    metrics = _metrics.metrics
    statistics = _metrics.statistics
    compare = _compare.compare
    audit = _audit.audit
    verify = _verify.verify
    prove = _prove.prove
    witness_ask = _key.witness_ask
    multiverse = _metrics.multiverse

    # --- files ---

    export = _export.export
    open = _export.open
    report = _report.report
    recover = _maintain.recover
    upgrade = _maintain.upgrade
    compact = _maintain.compact

    @contextmanager
    def database(self) -> "Iterator[Database]":
        """Yield a DuckDB connection over the events and the packaged queries."""
        from fsar_ledger.metrics.database import connect

        with connect(self.path, demanded=self.demanded) as database:
            yield database


def demanded_head(ledger: Path, *, verified: bool, progress: Progress | None = None) -> str | None:
    """Compare the rows with the root and return the newest record's SHA-256; None if `verified` is not demanded.

    A remembered comparison is not repeated.

    Raises:
        LedgerCorrupted: The comparison found a problem.
        NotALedger, FormatVersionMismatch: As `open_for_answers`.
    """
    if not verified:
        return None
    newest = open_for_answers(ledger).record_sha256
    return newest if is_remembered(newest) else ensure_verified(ledger, readers_of(None, ledger), progress)


@checked
def open_ledger(path: Place, *, verified: bool = False, progress: Progress | None = None) -> Ledger:
    """Open the ledger in this folder.

    Args:
        path: The folder.
        verified: Compare all rows with the root first, as `verify` does, unless an earlier comparison of this head is
            remembered; then only compare the files with their hashes. Answers about later commits are then refused.
        progress: Called with the segments compared and their total.

    Raises:
        NotALedger, FormatVersionMismatch: The folder holds no ledger that this version reads.
        LedgerCorrupted: It contradicts itself.
    """
    demanded = demanded_head(Path(path), verified=verified, progress=progress)
    view = open_for_answers(Path(path)) if verified else open_checked(Path(path))
    if verified:
        view.segments()  # the remembered comparison may be of another folder, and this an altered copy
    return Ledger(path, demanded=demanded)
