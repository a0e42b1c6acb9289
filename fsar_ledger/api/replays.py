"""The methods of `Ledger` that replay: moments, differences, what would have been, and why."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from fsar_ledger.errors import UsageError

from .lookup import robot_of, time_of
from .names import Place, Run, Time, names_of

if TYPE_CHECKING:
    from fsar_ledger.ledger.chain.read import View
    from fsar_ledger.ledger.rows.codec import LedgerRun

    from .bisect import Bisected
    from .causes import Caused
    from .difference import Diff
    from .ledger import Ledger
    from .moment import Moment
    from .pictures import Picture
    from .provenance import Provenance
    from .table import Table
    from .walks import Steps
    from .whatif import Asked, Fork, WhatIf
    from .whys import Why
    from .workload import Progress


class Replays:
    """The part of `Ledger` that replays runs."""

    path: Path
    _demanded: str | None

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
        return view, Provenance(view.head, is_verified(view, self._demanded))

    def _name(self, view: "View", run: Run) -> str:
        from .lookup import run_in

        return run_in(view, run, self._demanded)

    def state(
        self,
        run: Run,
        at: Time = None,
        *,
        robot: str | None = None,
        as_known_by: str | None = None,
        by_commit: int | None = None,
    ) -> "Moment":
        """Return how things stood in a run at a time: robots, requests, claims, recoveries, calls, tasks and the rest.

        Args:
            run: The run.
            at: The time within the run; None: its end.
            robot: Only what this robot has a part in.
            as_known_by: A decider, such as `coordinator` or `robot/A1`: also what it had been told by then.
            by_commit: Only from what the ledger had recorded after so many commits.

        Raises:
            UsageError: There is no such run, robot or decider, `at` is no time of the run, or the run came later.
        """
        from .lookup import about_run
        from .moment import moment

        view, provenance = self._view()
        with about_run(view, run, self._demanded) as (database, name, _):
            at_us = time_of(database, "at", at, name)
            whose = None if robot is None else robot_of(database, robot, name)
        return moment(view, provenance, name, at_us, whose, as_known_by, by_commit)

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
        with about_run(view, run, self._demanded) as (database, name, _):
            at_us = time_of(database, "at", at, name)
        return Steps(record_of(view, name), provenance, at_us)

    def diff(self, first: Run, second: Run, other: "Replays | Place | None" = None) -> "Diff":
        """Say in what two runs differ, where they part and why, and what they came to.

        Args:
            first: A run of this ledger.
            second: A run of this ledger, or of `other`.
            other: Another ledger.

        Raises:
            UsageError: There is no such run.
        """
        from .difference import difference_of

        theirs = self if other is None else other if isinstance(other, Replays) else type(self)(other)
        (_, own), (_, its) = self._view(), theirs._view()
        provenances = (own,) if other is None else (own, its)
        return difference_of(self.record(first), theirs.record(second), provenances)

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
        return fork_of(view, record_of(view, self._name(view, run)), changes)

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
        record = None if run is None else record_of(view, self._name(view, run))
        place = None if out is None else Path(out)
        return what_if(view, provenance, record, changes, names_of(architecture) or (), place, progress)

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
        found = repeated(base_of_record(record_of(view, self._name(view, run)), view.head.root)).changeable()
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
        record = record_of(view, self._name(view, run))
        return cause_of(record, provenance, outcome, lengths=lengths, futures=futures, progress=progress)

    def bisect(
        self,
        outcome: str,
        first: str | None = None,
        second: str | None = None,
        other: "Ledger | Place | None" = None,
        *,
        changes: "Asked | None" = None,
        architecture: str | Sequence[str] | None = None,
    ) -> "Bisected":
        """Find the first run in which two sides disagree on an outcome, and where the two part there.

        The sides are configurations, parameter sets or models, as in `compare`; or the runs as recorded and their forks
        with `changes`. Another ledger can be what another release made of the same experiment.

        Args:
            outcome: As in `cause`.
            first: As in `compare`.
            second: As in `compare`.
            other: Another ledger, which holds the second side.
            changes: As in `fork`, instead of two sides.
            architecture: With `changes`, only the runs of this one, or of these.

        Raises:
            UsageError: There is no such side or outcome, or nothing to pair.
            QueryFailed: The SELECT of the outcome fails.
        """
        from .bisect import bisect_changes, bisect_sides
        from .ledger import Ledger

        assert isinstance(self, Ledger)
        view, provenance = self._view()
        if changes is not None:
            if first is not None or second is not None or other is not None:
                raise UsageError("bisect: found changes and two sides, expected one or the other")
            return bisect_changes(view, provenance, changes, names_of(architecture) or (), outcome)
        if architecture is not None:
            raise UsageError("bisect: found an architecture without changes; sides name theirs")
        ledgers = [self] if other is None else [self, other if isinstance(other, Ledger) else Ledger(other)]
        provenances = tuple(one._view()[1] for one in ledgers)
        return bisect_sides(ledgers, provenances, (first, second), outcome)

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

        beside = None if other is None else Source(other.path, other._demanded)
        return write_page(Source(self.path, self._demanded), Path(out), run, second, beside)

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

        return write_trace(Source(self.path, self._demanded), Path(out), run)

    def why(self, event: str | tuple[Run, int], *, depth: int | None = 2) -> "Why":
        """Say why an event happened: its triggers, what the decision read, who wrote that, and what ports answered.

        Args:
            event: `RUN:SEQ`, as in `prove`, or a pair of run and seq.
            depth: 1: how the event came about; 2: and how the events came about that it rests on; and so on; None: all.

        Raises:
            UsageError: There is no such event, or the run cannot be made again, or not as it is recorded.
        """
        from fsar_ledger.analysis.records import record_of

        from .prove import asked_event, found_event
        from .whys import why_of

        view, provenance = self._view()
        if isinstance(event, str):
            run, seq = found_event(view, *asked_event(view, event, self._demanded), self._demanded)
        else:
            run, seq = self._name(view, event[0]), event[1]
        return why_of(record_of(view, run), provenance, seq, depth)

    def verdicts(self, run: Run, kind: str) -> "Table":
        """Return the verdicts of one kind on a run, each with the events that made it.

        Args:
            run: A run.
            kind: `violation` (a start against policy), `conflict` (of authority), `late` (a task), `unattributed` (a
                record that lacks a principal), or an invariant, as `i4`.

        Raises:
            UsageError: There is no such run or kind.
        """
        from .lookup import about_run
        from .whys import verdicts_of

        with about_run(self._view()[0], run, self._demanded) as (database, name, _):
            return verdicts_of(database, name, kind)
