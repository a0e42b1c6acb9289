"""A ledger in Python: a method for every command that reads one, under the same name."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from fsar_ledger.errors import UsageError
from fsar_ledger.ledger.opening import open_for_answers

from .integrity import Integrity
from .lookup import parameters_of, robot_of, run_of, time_of
from .names import By, Place, Pool, Run, Time, by_scenario, names_of, pools_seeds
from .replays import Replays
from .timelines import Timelines
from .workload import Progress, readers_of

if TYPE_CHECKING:
    import pyarrow as pa

    from fsar_ledger.ledger.store.view import Head
    from fsar_ledger.metrics.database import Database
    from fsar_ledger.metrics.progress import Showing
    from fsar_ledger.metrics.sandbox import Limits

    from .audit import Audit
    from .compare import Comparison
    from .events import Events
    from .explain import Account
    from .files import Written
    from .info import Contents
    from .multiverse import MultiverseResult
    from .open import Opened
    from .provenance import Provenance
    from .statistics import Statistics
    from .table import Table


class Ledger(Timelines, Replays, Integrity):
    """A ledger to query. Each answer holds for the newest commit at that moment, and names its head.

    A run is given by its name, its number (`numbers()`), or a part of its name that no other run has; a robot as `B1`
    or `robot/B1`; a time of the run in seconds, or as text: `46.6`, `46.6s` or `46600ms`.

    Args:
        path: The folder of the ledger.
        demanded: The SHA-256 of the newest record, whose rows were just compared with its root; answers about any other
            head are refused.
    """

    def __init__(self, path: Place, *, demanded: str | None = None) -> None:
        self.path = Path(path)
        self._demanded = demanded

    def __repr__(self) -> str:
        return f"Ledger({str(self.path)!r})"

    @property
    def head(self) -> "Head":
        """Return the present head: commits, events and the root over them. Raises: As `open_ledger`."""
        return open_for_answers(self.path).head

    # --- what it holds ---

    def info(self) -> "Contents":
        """Return the plans, which of their runs are there, and the parameters of their worlds."""
        from .info import contents

        return contents(self.path, self._demanded)

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
        return Events(self.path, Filter(name, since_us, until_us, robot), self._demanded)

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

    def sql(self, select: str, *, seconds: int | None = None, memory_mib: int | None = None) -> "Table":
        """Answer a SELECT of your own in a locked-down process that can read this ledger and nothing else.

        Args:
            select: One SELECT in DuckDB's SQL, over `events`, a view for each event type, and the packaged queries by
                the last parts of their names; one with parameters is called, as in `denials(run := 1)`. `SHOW TABLES`
                lists them, `DESCRIBE NAME` the columns of one.
            seconds: The time limit; None: 60.
            memory_mib: The memory limit, at least 1024; None: 4096.

        Raises:
            QueryFailed: It is not one SELECT, fails, needs something outside the ledger, or meets a limit.
        """
        from fsar_ledger.metrics.untrusted import table_untrusted

        from .limits import limits_of
        from .provenance import Provenance
        from .table import Table

        rows, head, rows_verified = table_untrusted(self.path, select, limits_of(seconds, memory_mib), self._demanded)
        return Table(rows, Provenance(head, rows_verified))

    @contextmanager
    def stream(
        self, select: str, limits: "Limits"
    ) -> "Iterator[tuple[Provenance, list[str], Iterator[pa.RecordBatch]]]":
        """Yield the answer of `sql` in Arrow batches, so that a long one is never in memory at once."""
        from fsar_ledger.metrics.untrusted import stream_untrusted

        from .provenance import Provenance

        with stream_untrusted(self.path, select, limits, self._demanded) as found:
            yield Provenance(found.head, found.rows_verified), found.columns, found.batches

    def requests(self, run: Run | None = None) -> "Table":
        """Return the requests of a run, the first by default: who asked, allowed, executed, supervised; the result."""
        from .explain import requests

        with self.about_run(run) as (database, name, _):
            return requests(database, name)

    def explain(self, run: Run | None = None, request: str | None = None, failure: str | None = None) -> "Account":
        """Give an account of a request of a run, or of a failure, level by level.

        Without `run` it is the only one that has the request.

        Raises:
            UsageError: There is no such request, several runs have it, it has not failed, or both or neither are named.
        """
        from .explain import account

        with self.about_run(run, request or failure) as about:
            return account(about, self.path, request, failure)

    # --- judgement ---

    def metrics(self, by: By = None, pool: Pool = None) -> "Table":
        """Judge the ledger by its metrics, a row for each metric, architecture and setting.

        Args:
            by: `scenario` for a row for each scenario.
            pool: `seeds` to pool the runs of all seeds.
        """
        from fsar_ledger.metrics.results import MetricRow, metric_rows

        from .provenance import of_judgement
        from .table import Table, of_structs

        per_scenario, pooled = by_scenario(by), pools_seeds(pool)
        with self.database() as database:
            rows = of_structs(metric_rows(database, by_scenario=per_scenario, pools_seeds=pooled), MetricRow)
            rows = rows if per_scenario else rows.drop_columns(["scenario"])
            return Table(rows, of_judgement(database))

    def statistics(self, pool: Pool = None) -> "Statistics":
        """Compare the architectures in pairs, and FSAR with itself without a mechanism.

        The answer has tests and effect sizes, and says what is not compared.
        """
        from .statistics import compute_statistics

        pooled = pools_seeds(pool)
        with self.database() as database:
            return compute_statistics(database, pooled=pooled)

    def compare(
        self,
        first: str | None = None,
        second: str | None = None,
        other: "Ledger | Place | None" = None,
        by: By = None,
        pool: Pool = None,
    ) -> "Comparison":
        """Compare two sides in pairs, as `ARCHITECTURE[:CONFIGURATION][@CONSTANTS][/ROBOTS]`.

        The second side may be of another ledger.
        """
        from .compare import compare_sides

        ledgers = [self] if other is None else [self, other if isinstance(other, Ledger) else Ledger(other)]
        return compare_sides(ledgers, (first, second), by_scenario=by_scenario(by), pooled=pools_seeds(pool))

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

    def audit(
        self,
        invariant: str | Sequence[str] | None = None,
        architecture: str | Sequence[str] | None = None,
        *,
        progress: Progress | None = None,
    ) -> "Audit":
        """Check the invariants I1 to I5 and A1 to A5, or those named, on the runs of all or these architectures.

        `progress` is called with how often an invariant was judged, on some of the runs, and how often that will be.
        """
        from .audit import audit_runs

        view = open_for_answers(self.path)
        return audit_runs(view, self._demanded, names_of(invariant) or (), names_of(architecture) or (), progress)

    # --- files ---

    def export(
        self,
        out: Place,
        query: str | None = None,
        parameters: Mapping[str, object] | None = None,
        *,
        raw: bool = False,
        tiles: bool = False,
        progress: Progress | None = None,
    ) -> "Written":
        """Write every event, or the answer of a query, to a .csv, .parquet, .ndjson or .jsonl file.

        Args:
            out: The file; replaced if it exists.
            tiles: Write the hashes of the tree to the new folder `out` instead, as C2SP tlog-tiles, and the checkpoint.
            query: The name of a query; None: every event as it is stored.
            parameters: The parameters of the query.
            raw: Do not escape text in CSV that a terminal or a spreadsheet would act on.
            progress: Called with the commits whose events were written, and their number.

        Raises:
            UsageError: The file has another suffix, or lies inside a ledger.
            WriteFailed: The file cannot be written.
        """
        from .files import Written, require_place, write_events, write_table

        file = Path(out)
        if tiles:
            if query is not None or parameters or raw:
                raise UsageError("export: found tiles and a query, parameters or raw text, expected tiles alone")
            from .tiles import write_tiles

            return write_tiles(self.path, file, demanded=self._demanded, progress=progress)
        require_place(file)
        if query is not None:
            found = self.query(query, **(parameters or {}))
            return Written(write_table(file, found.stored, raw=raw), found.provenance)
        if parameters:
            raise UsageError(f"export: found parameter {next(iter(parameters))} and no query, expected both or neither")
        return write_events(self.path, file, raw=raw, demanded=self._demanded, progress=progress)

    def open(self, out: Place | None = None, *, progress: Progress | None = None) -> "Opened":
        """Write a DuckDB file with every view and packaged query of the present head, for other programs.

        Args:
            out: A .duckdb file, replaced if `open` wrote it; None: named as the ledger, in the working folder.
            progress: Called with the views and queries that were written, and their number.

        Raises:
            UsageError: The file has another suffix, lies inside a ledger, or is not one of `open`.
            WriteFailed: The file cannot be written.
        """
        from .open import write_database

        return write_database(self.path, None if out is None else Path(out), self._demanded, progress)

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

        with connect(self.path, demanded=self._demanded) as database:
            yield database
