"""The verb `explain`: the requests of a run, and an account of one of them.

The rows are those of `queries/audit/requests.sql`, `request_timeline.sql` and `failure_timeline.sql`.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import msgspec

from fsar_ledger.base import printable
from fsar_ledger.base.errors import UsageError, option

from .answers import Answer, Screen, figure_place
from .names import Place, Run
from .verbs import WIDE, declare, verb

if TYPE_CHECKING:
    from fsar_ledger.metrics.database import Database
    from fsar_ledger.metrics.provenance import Provenance

    from .ledger import Ledger
    from .lookup import AboutRun
    from .table import Table

Rows = list[dict[str, Any]]
TIMELINE = "audit/request_timeline"
PARTIES = ("asked_by", "allowed_by", "denied_by", "denied_under", "executed_by", "supervised_by")
DENIED = ("denied_by", "denied_under")
UNKNOWN = "not on record"
BESIDE = 24
"""Characters of a step beside its names and words: time, seq and gaps."""
WORDS, MAX_WORDS = ("message", "note"), 1_000


COLUMNS = (
    *("began_s", "action_id", "capability", "asked_by", "allowed_by", "denied_by", "denied_under", "executed_by"),
    *("supervised_by", "failures", "result", "seq"),
)
LATER = ("capability", "denied_under", "executed_by", "supervised_by", "failures")
"""Columns that a terminal shows if there is room beside the others."""

FAILED = "SELECT seq FROM failures WHERE run_id = $run AND action_id = $action"
GROUNDS = """
    SELECT DISTINCT unnest(ground_seqs) AS seq
    FROM named_grounds
    WHERE run_id = $run AND (
        seq = $seq
        OR seq IN (SELECT call.seq FROM supervisor_called AS call WHERE call.run_id = $run AND call.seq IN $told)
    )
    ORDER BY seq
"""
"""The windows and rules of the event that decided a request, and of the calls for review in its timeline."""


class Account(Answer, msgspec.Struct, frozen=True):
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
    provenance: "Provenance"

    @property
    def decisive_seq(self) -> int:
        """The position in the run of the event that decided the result, else of the last one in the timeline."""
        seq = self.parties["seq"]
        return int(self.timeline[-1]["seq"] if seq is None else seq)

    def draw(self, file: Place, kind: Literal["svg", "pdf"] | None = None) -> None:
        """Draw the timeline, or the levels of a failure's recovery, as SVG or PDF; the file is replaced if it exists.

        `kind` is the format, by default that of the suffix.

        Raises:
            UsageError: Neither gives a format, or the file lies inside a ledger.
            WriteFailed: The file cannot be written.
        """
        from fsar_ledger.base.publishing import publish
        from fsar_ledger.report import sequence

        path, form = figure_place(file, kind)
        rows, figure = (self.recovery, sequence.ladder) if self.is_failure else (self.timeline, sequence.sequence)
        publish(path, figure(rows, form))

    def document(self, _: Screen) -> Mapping[str, object]:
        """Return the account."""
        rows = {"parties": self.parties, "timeline": self.timeline, "recovery": self.recovery}
        return {"run": self.run, "action": self.action, **rows}

    def text(self, screen: Screen) -> Iterator[printable.SafeText]:
        """Yield the timeline, the parties, the recovery, and how to prove what decided."""
        steps, parties = printable_rows([] if self.is_failure else self.timeline), printable_rows([self.parties])[0]
        lines = account_lines(screen, (self.run, self.action), steps, parties, printable_rows(self.recovery))
        hints = [screen.proof_hint(self.run, self.decisive_seq)]
        hints += [screen.proof_hint(self.run, seq, " (the window or rule)") for seq in self.grounds]
        yield printable.lines(*lines, "", *hints)


def _explain_or_list(ledger: "Ledger", run: Run | None, request: str | None, failure: str | None) -> Answer:
    if request is not None and failure is not None:
        raise UsageError(
            f"--request {request} and --failure {failure}: expected one of them; --request shows a failure, too"
        )
    if request is not None or failure is not None:
        return explain(ledger, run, request, failure)
    from .table import Listing

    name, rows = _requests(ledger, run)

    def hint(screen: Screen, first: Mapping[str, Any]) -> str:
        call = f"explain {printable.word(screen.path)} --run {screen.run_word(name)} --request"
        return f"`fsar-ledger {call} {printable.word(first['action_id'])}` shows one of them"

    return Listing(
        run=name,
        found=rows,
        time="began_s",
        nothing="requests",
        unseen="not everything that a request leaves on record was observed",
        hint=hint,
        undrawn="found no request to draw; give --request ACTION or --failure ACTION",
        columns=lambda is_fitted: sorted(COLUMNS, key=LATER.__contains__) if is_fitted else COLUMNS,
        name="requests",
    )


@verb(
    "explain out/ledger",
    "explain out/ledger --run 1 --request A1-1/2.1",
    "explain out/ledger --run 2 --request A1-1/2.1 --svg out/request.svg",
    "explain out/ledger --run 1 --json",
    takes=("svg", "pdf", *WIDE),
    call=_explain_or_list,
)
def explain(
    ledger: "Ledger",
    run: Run | None = declare(
        "RUN",
        "A run: its number, its name, or a part of it that no other run has.",
        "the first run, or the only one that has the ACTION",
        complete="runs",
    ),
    request: str | None = declare(
        "ACTION", "The request (action) to show, as in the list.", "list all", complete="actions"
    ),
    failure: str | None = declare(
        "ACTION", "The failed action whose recovery to show, level by level.", complete="actions"
    ),
) -> Account:
    """Show the timeline of a request: who asked, who allowed or denied, who acted, who supervised.

    Each line has its position in the run (seq), which `prove RUN:SEQ` takes. For a request that failed, also what
    recovery tried at each level, for how long, and why it moved on. Without --request and --failure, list the requests
    of the run.

    Raises:
        UsageError: There is no such request, several runs have it, it has not failed, or both or neither are named.
    """
    with ledger.about_run(run, request or failure, is_whole=True) as about:
        return _account(about, ledger.path, request, failure)


def requests(ledger: "Ledger", run: Run | None = None) -> "Table":
    """Return the requests of a run, the first by default: who asked, allowed, executed, supervised; the result."""
    return _requests(ledger, run)[1]


def _requests(ledger: "Ledger", run: Run | None) -> "tuple[str, Table]":
    from fsar_ledger.metrics.provenance import of_rows

    from .table import Table

    with ledger.about_run(run, is_whole=True) as (database, name, _):
        rows = database.query("audit/requests", {"run": name, "action": "all"})
        return name, Table(rows, of_rows(database, TIMELINE, name))


def _account(about: "AboutRun", ledger: Path, request: str | None, failure: str | None) -> Account:
    """Return the account of this action, as a request or as a failure.

    Raises:
        UsageError: The run has no such action, the action has not failed, or both or neither are named.
    """
    from fsar_ledger.metrics.provenance import of_rows

    from .lookup import resting_on_rows

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
    timeline = _rows(database, TIMELINE, run, action)
    if not timeline:
        with resting_on_rows(database.rows_verified):
            raise UsageError(_no_action(database, ledger, run, action, number))
    (parties,) = _rows(database, "audit/requests", run, action)
    recovery = _rows(database, "audit/failure_timeline", run, action)
    if failure is not None and not recovery:
        failed = database.rows(FAILED, {"run": run, "action": failure})
        found_none = "that it failed, and no record of its recovery," if failed else "no failure of this action"
        with resting_on_rows(database.rows_verified):
            raise UsageError(
                f"{option('failure', failure)}: found {found_none} in run {run}; "
                f"{option('request', failure)} shows what happened"
            )
    grounds = database.rows(GROUNDS, {"run": run, "seq": parties["seq"], "told": [row["seq"] for row in timeline]})
    ground_seqs = tuple(row["seq"] for row in grounds)
    provenance = of_rows(database, TIMELINE, run)
    return Account(run, action, parties, timeline, recovery, ground_seqs, failure is not None, provenance)


def run_with(ledger: "Ledger", database: "Database", action: str) -> str:
    """Return the only run that has the action. Raises: UsageError if there is none, or several."""
    from .lookup import no_run, resting_on_rows

    sql = """
        SELECT run_id FROM run_numbers
        WHERE run_id IN (SELECT run_id FROM keyed_events WHERE action_id = $action)
        ORDER BY number
    """
    matches = [str(row["run_id"]) for row in database.rows(sql, {"action": action})]
    if len(matches) > 1:
        numbers = ledger.numbers()
        listed = printable.list_few(printable.value(str(numbers.get(run, run))) for run in matches)
        raise UsageError(
            f"{printable.value(action)}: found this action in {len(matches):,} runs, expected the run, too; give "
            f"{option('run')} one of {listed}"
        )
    if matches:
        return matches[0]
    runs = [row["run_id"] for row in database.rows("SELECT run_id FROM run_numbers")]
    only = str(runs[0]) if len(runs) == 1 else None
    number = ledger.numbers().get(only) if only else None
    with resting_on_rows(database.rows_verified):
        raise UsageError(_no_action(database, ledger.path, only, action, number) if runs else no_run(ledger.path))


def _rows(database: "Database", query: str, run: str, action: str) -> Rows:
    from fsar_ledger.metrics.database import plain_rows

    return plain_rows(database.query(query, {"run": run, "action": action}))


def _no_action(database: "Database", ledger: Path, run: str | None, action: str, number: int | None) -> str:
    """Return the error text for an action that the run (None: any run) lacks, with the nearest and how to list them."""
    from fsar_ledger.metrics.sql_values import names_on_record

    where = "any run" if run is None else f"run {printable.value(run)}"
    hint = printable.did_you_mean(action, names_on_record(database, "action", run)) or ";"
    command = (
        f"query requests {printable.word(ledger)}"
        if run is None
        else f"explain {printable.word(ledger)} --run {printable.word(run if number is None else number)}"
    )
    return f"{action}: there is no such request in {where}{hint} `fsar-ledger {command}` lists them"


def printable_rows(rows: Sequence[Mapping[str, Any]]) -> Rows:
    """Return the rows with each text printable: at most `MAX_WORDS` characters of messages, fewer of names."""
    return [
        {
            name: printable.value(value, MAX_WORDS if name in WORDS else printable.MAX_VALUE)
            if isinstance(value, str)
            else value
            for name, value in row.items()
        }
        for row in rows
    ]


def account_lines(
    screen: Screen, who: tuple[str, str], timeline: Rows, parties: Mapping[str, Any], recovery: Rows
) -> Iterator[str]:
    """Yield lines on the run and action (`who`), each step, the parties, and the recovery."""
    run, action = who
    yield screen.run_text(run)
    what = f", {parties['capability']}" if parties["capability"] else ""
    yield f"action {printable.value(action)}{what}, begins at {parties['began_s']:.3f} s"
    between = [_between(row) for row in timeline]
    width = screen.width_of_names(max(map(len, between), default=0), BESIDE)
    for row, names in zip(timeline, between, strict=True):
        note = f"  ({row['note']})" if row["note"] else ""
        if row["step"] <= 1:
            yield ""
        tie = " " if row["is_tied"] else "*"
        when = f"{row['time_s']:>10.3f} s" if row["clock"] is None else row["clock"]
        yield f"{when} {row['seq']:>6} {tie} {names:<{width}}  {row['message']}{note}"
    if not all(row["is_tied"] for row in timeline):
        yield "* the record names no action; its cause does"
    yield ""
    yield from (f"{name.replace('_', ' '):<14} {text}" for name, text in _parties(parties))
    took = "" if parties["ended_s"] is None else f", {parties['ended_s'] - parties['began_s']:.3f} s after it began"
    yield f"{'result':<14} {parties['result'] or 'not observed'}{took}"
    yield from _recovered(recovery)


def _parties(parties: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield who asked, allowed, denied (and when, under which window or rule), executed, supervised."""
    for name in PARTIES:
        if name in DENIED and not parties["denials"]:
            continue
        when = ""
        if name == "denied_by":
            # Several denials need not all name who denied.
            several = ", " if parties["denials"] == 1 else f"; {parties['denials']} denials, the last "
            when = f"{several}at {parties['denied_s']:.3f} s (seq {parties['denied_seq']})"
        yield name, f"{parties[name] or UNKNOWN}{when}"


def _between(row: Mapping[str, Any]) -> str:
    """Return `sender -> receiver` of a message, or the one name of an act."""
    sender = row["sender"] or "?"
    return f"{sender} -> {row['receiver'] or '?'}" if row["kind"] == "message" else sender


def _recovered(recovery: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Yield each failure, level by level: how long, what was tried with which result, and why the level was left."""
    for failure, steps in groupby(recovery, key=lambda row: row["failure"]):
        yield ""
        yield f"failure {failure}"
        for (number, level, spent_s), rows in groupby(
            steps, key=lambda row: (row["level_number"], row["level"], row["spent_s"])
        ):
            stay = list(rows)
            spent = "?" if spent_s is None else f"{spent_s:.3f}"
            yield f"  {number} {level:<6}{spent:>9} s"
            for row in stay:
                by = f", by {row['decided_by']}" if row["decided_by"] else ""
                yield f"{row['time_s']:>10.3f} s {row['seq']:>6}   {row['what']}{by}{_result(row, stay)}"


def _result(row: Mapping[str, Any], stay: Sequence[Mapping[str, Any]]) -> str:
    result = f": {row['result']}" if row["result"] else ""
    if row["achieved"]:
        result += f" ({row['achieved']})"
    if row["to_level"] is not None:
        attempts = sum(step["budget_s"] is not None for step in stay)
        budget = next((step["budget_s"] for step in stay if step["budget_s"] is not None), None)
        result += (
            "" if budget is None else f" ({printable.counted(attempts, 'attempt')} within {printable.number(budget)} s)"
        )
    return result
