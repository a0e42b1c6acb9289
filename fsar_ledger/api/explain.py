"""List the requests of a run, and give an account of one of them.

The rows are those of `queries/audit/requests.sql`, `request_timeline.sql` and `failure_timeline.sql`.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import msgspec

from fsar_ledger import printable
from fsar_ledger.errors import UsageError, option
from fsar_ledger.ledger.store.paths import require_outside
from fsar_ledger.metrics.database import Database, plain_rows

from .lookup import AboutRun, names_on_record, no_run, numbers_of, resting_on_rows
from .provenance import Provenance, of_rows
from .table import Table

if TYPE_CHECKING:
    from os import PathLike

Rows = list[dict[str, Any]]

GROUNDS = """
    SELECT DISTINCT unnest(ground_seqs) AS seq
    FROM named_grounds
    WHERE run_id = $run AND (
        seq = $seq
        OR seq IN (SELECT call.seq FROM supervisor_called AS call WHERE call.run_id = $run AND call.seq IN $told)
    )
    ORDER BY seq
"""
"""The windows and rules of the event that decided a request, and of the calls for review that are told of it."""


class Account(msgspec.Struct, frozen=True):
    """The account of one request: who asked, who allowed or denied, who acted, who supervised.

    `timeline` has a row for each step, `recovery` one for each attempt after a failure, level by level. `grounds` are
    the positions in the run of the windows and rules under which the request was put to review, or denied by the
    decisive event.
    """

    run: str
    action: str
    parties: dict[str, Any]
    timeline: Rows
    recovery: Rows
    grounds: tuple[int, ...]
    is_failure: bool
    provenance: Provenance

    @property
    def decisive_seq(self) -> int:
        """The position in the run of the event that decided the result, else of the last one told."""
        seq = self.parties["seq"]
        return int(self.timeline[-1]["seq"] if seq is None else seq)

    def draw(self, file: "str | PathLike[str]", kind: Literal["svg", "pdf"] | None = None) -> None:
        """Draw the timeline, or the levels of a failure's recovery, as SVG or PDF; the file is replaced if it exists.

        `kind` decides the format, else the suffix of the file.

        Raises:
            UsageError: Neither gives a format, or the file lies inside a ledger.
            WriteFailed: The file cannot be written.
        """
        from fsar_ledger.publishing import publish
        from fsar_ledger.report import sequence

        place = Path(file)
        form = place.suffix[1:] if kind is None else kind
        if form not in ("svg", "pdf"):
            raise UsageError(f"{place}: expected a name that ends in .svg or .pdf")
        require_outside(place, str(place))
        rows, figure = (self.recovery, sequence.ladder) if self.is_failure else (self.timeline, sequence.sequence)
        publish(place, figure(rows, form))


def account(about: AboutRun, ledger: Path, request: str | None, failure: str | None) -> Account:
    """Give an account of this action, as a request or as a failure.

    Raises:
        UsageError: The run has no such action, the action has not failed, or both or neither are named.
    """
    database, run, number = about
    if "" in (request, failure):
        empty = option("request" if request == "" else "failure")
        raise UsageError(
            f"{empty}: found an empty name, expected an action; explain without {empty} lists the requests"
        )
    action = request or failure
    if action is None or (request is not None and failure is not None):
        raise UsageError(
            "explain: expected the name of a request or of a failure; requests() lists the requests of a run"
        )
    timeline = _asked(database, "request_timeline", run, action)
    if not timeline:
        with resting_on_rows(database.rows_verified):
            raise UsageError(_no_action(database, ledger, run, action, number))
    (parties,) = _asked(database, "requests", run, action)
    recovery = _asked(database, "failure_timeline", run, action)
    if failure is not None and not recovery:
        with resting_on_rows(database.rows_verified):
            raise UsageError(
                f"{option('failure', failure)}: found no failure of this action in run {run}; "
                f"{option('request', failure)} shows what happened"
            )
    grounds = database.rows(GROUNDS, {"run": run, "seq": parties["seq"], "told": [row["seq"] for row in timeline]})
    found = tuple(row["seq"] for row in grounds)
    return Account(run, action, parties, timeline, recovery, found, failure is not None, _about(database, run))


def requests(database: Database, run: str) -> Table:
    """Return the requests of a run, one row each."""
    return Table(database.query("audit/requests", {"run": run, "action": "all"}), _about(database, run))


def run_with(database: Database, ledger: Path, action: str) -> str:
    """Return the only run that has the action. Raises: UsageError if there is none, or several."""
    sql = """
        SELECT run_id FROM run_numbers
        WHERE run_id IN (SELECT run_id FROM keyed_events WHERE action_id = $action)
        ORDER BY number
    """
    found = [str(row["run_id"]) for row in database.rows(sql, {"action": action})]
    if len(found) > 1:
        numbers = numbers_of(database)
        named = printable.some(printable.value(str(numbers.get(run, run))) for run in found)
        raise UsageError(
            f"{printable.value(action)}: found this action in {len(found):,} runs, expected the run, too; give "
            f"{option('run')} one of {named}"
        )
    if found:
        return found[0]
    runs = [row["run_id"] for row in database.rows("SELECT run_id FROM run_numbers")]
    only = str(runs[0]) if len(runs) == 1 else None
    number = numbers_of(database).get(only) if only else None
    with resting_on_rows(database.rows_verified):
        raise UsageError(_no_action(database, ledger, only, action, number) if runs else no_run(ledger))


def _about(database: Database, run: str) -> Provenance:
    return of_rows(database, database.library.find("audit/request_timeline"), run)


def _asked(database: Database, query: str, run: str, action: str) -> Rows:
    return plain_rows(database.query(f"audit/{query}", {"run": run, "action": action}))


def _no_action(database: Database, ledger: Path, run: str | None, asked: str, number: int | None = None) -> str:
    """Say that the run, or with None every run, lacks the action; name the nearest, and how to list those there are."""
    place = "any run" if run is None else f"run {printable.value(run)}"
    hint = printable.did_you_mean(asked, names_on_record(database, "action", run)) or ";"
    called = (
        f"query requests {printable.word(ledger)}"
        if run is None
        else f"explain {printable.word(ledger)} --run {printable.word(run if number is None else number)}"
    )
    return f"{asked}: there is no such request in {place}{hint} `fsar-ledger {called}` lists them"
