"""The answer of `explain`: the requests of a run, or the story of one of them as text, JSON or a figure. Nothing here prints.

The story is what `queries/audit/request_story.sql`, `requests.sql` and `failure_story.sql` answer; here it is only laid out.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

from fsar_ledger import printable
from fsar_ledger.errors import UsageError
from fsar_ledger.ledger.store.paths import require_outside
from fsar_ledger.metrics.database import Database, plain_rows
from fsar_ledger.printable import Shown

from .answering import answering, not_observed
from .options import did_you_mean
from .output import json_text, table_text

Story = list[dict[str, Any]]

COLUMNS = (
    "began_s",
    "action_id",
    "capability",
    "asked_by",
    "allowed_by",
    "executed_by",
    "supervised_by",
    "failures",
    "result",
)
PARTIES = ("asked_by", "allowed_by", "executed_by", "supervised_by")
UNKNOWN = "not on record"
WORDS, MAX_WORDS = ("message", "note"), 1_000


def explain(
    ledger: Path,
    run: str | None,
    request: str | None,
    failure: str | None,
    drawn: Mapping[str, Path | None],
    *,
    as_json: bool,
    verified: bool = False,
) -> Shown:
    """The text of the answer; `drawn` names the file of each kind of figure (svg, pdf) that is wanted, which is written.

    Raises:
        UsageError: the run or the action is unknown, has not failed, or what was asked for cannot be drawn, or not there: inside a ledger.
        WriteFailed: a figure cannot be written.
        NotALedger, FormatVersionMismatch, LedgerCorrupted: as `answering`.
    """
    files = {kind: path for kind, path in drawn.items() if path is not None}
    if request is not None and failure is not None:
        raise UsageError(
            f"--request {request} and --failure {failure}: expected one of them; --request tells a failure, too"
        )
    action = request or failure
    if files and action is None:
        raise UsageError(f"--{next(iter(files))}: found no request to draw; give --request ACTION or --failure ACTION")
    for kind, path in files.items():
        require_outside(path, f"--{kind} {path}")
    with answering(ledger, verified=verified) as database:
        name = _run(database, ledger, run)
        more = not_observed(database, "audit/request_story", name)
        if action is None:
            return _listed(database, ledger, name, more, as_json=as_json)
        story = _asked(database, "request_story", name, action)
        if not story:
            raise UsageError(_no_action(database, ledger, name, action))
        (parties,) = _asked(database, "requests", name, action)
        recovery = _asked(database, "failure_story", name, action)
        if failure is not None and not recovery:
            raise UsageError(
                f"--failure {failure}: found no failure of this action in run {name}; --request {failure} tells what happened"
            )
        head, rows_verified = database.head, database.rows_verified
    _draw(files, recovery if failure is not None else story, is_ladder=failure is not None)
    if as_json:
        return json_text(
            head,
            {**more, "run": name, "action": action, "parties": parties, "story": story, "recovery": recovery},
            rows_verified,
        )
    told = _told(name, action, shown(story if failure is None else []), shown([parties])[0])
    return printable.lines(*told, *_recovered(shown(recovery)), *map(str, files.values()))


def shown(rows: Sequence[Mapping[str, Any]]) -> Story:
    """The rows with each text as people see it; `MAX_WORDS` characters of what is said, of names fewer."""
    return [
        {
            name: printable.value(found, MAX_WORDS if name in WORDS else printable.MAX_VALUE)
            if isinstance(found, str)
            else found
            for name, found in row.items()
        }
        for row in rows
    ]


def _asked(database: Database, query: str, run: str, action: str = "all") -> Story:
    return plain_rows(database.query(f"audit/{query}", {"run": run, "action": action}))


def _run(database: Database, ledger: Path, asked: str | None) -> str:
    """The run of this name, else the first whose name begins so; the first of the ledger when none was asked for."""
    names = [row["run_id"] for row in database.rows("SELECT run_id FROM run_started")]
    if not names:
        raise UsageError(f"{ledger}: found no run, so there is nothing to explain")
    if asked is None:
        return str(names[0])
    if asked in names:
        return asked
    beginning = sorted(name for name in names if name.startswith(asked)) if asked else []
    if beginning:
        return str(beginning[0])
    raise UsageError(
        f"--run {asked}: there is no such run in {ledger}; {did_you_mean(asked, names)}`fsar-ledger query runs {printable.word(ledger)}` lists them"
    )


def _no_action(database: Database, ledger: Path, run: str, asked: str) -> str:
    known = [
        row["action_id"]
        for row in database.rows(
            "SELECT DISTINCT action_id FROM keyed_events WHERE run_id = $run AND action_id IS NOT NULL", {"run": run}
        )
    ]
    way = f"`fsar-ledger explain {printable.word(ledger)} --run {printable.word(run)}` lists them"
    return f"{asked}: there is no such request in run {printable.value(run)}; {did_you_mean(asked, known)}{way}"


def _listed(database: Database, ledger: Path, run: str, more: Mapping[str, object], *, as_json: bool) -> Shown:
    rows = _asked(database, "requests", run)
    if as_json:
        return json_text(database.head, {**more, "run": run, "requests": rows}, database.rows_verified)
    if not rows:
        return printable.lines(
            f"run {printable.value(run)}",
            "no requests on record; not all that a request leaves was observed" if more else "no requests",
        )
    began = [{**row, "began_s": f"{row['began_s']:.3f}"} for row in rows]
    hint = f"`fsar-ledger explain {printable.word(ledger)} --run {printable.word(run)} --request {printable.word(rows[0]['action_id'])}` tells one of them"
    return printable.joined(
        printable.lines(f"run {printable.value(run)}", ""), table_text(began, COLUMNS), printable.lines("", hint)
    )


def _told(run: str, action: str, story: Story, parties: Mapping[str, Any]) -> Iterator[str]:
    """Run and action, the story a line for each step, and the parties."""
    yield f"run {printable.value(run)}"
    yield f"action {printable.value(action)}" + (f", {parties['capability']}" if parties["capability"] else "")
    between = [_between(row) for row in story]
    width = max(map(len, between), default=0)
    for row, names in zip(story, between, strict=True):
        note = f"  ({row['note']})" if row["note"] else ""
        if row["step"] <= 1:
            yield ""
        yield f"{row['time_s']:>10.3f} s {' ' if row['is_tied'] else '*'} {names:<{width}}  {row['message']}{note}"
    if not all(row["is_tied"] for row in story):
        yield "* the record names no action; its cause does"
    yield ""
    yield from (f"{name.replace('_', ' '):<14} {parties[name] or UNKNOWN}" for name in PARTIES)
    took = "" if parties["ended_s"] is None else f", {parties['ended_s'] - parties['began_s']:.3f} s after it began"
    yield f"{'result':<14} {parties['result']}{took}"


def _between(row: Mapping[str, Any]) -> str:
    """Who told whom; one name for a deed."""
    sender = row["sender"] or "?"
    return f"{sender} -> {row['receiver'] or '?'}" if row["kind"] == "message" else sender


def _recovered(recovery: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Each failure, level by level: how long, what was tried with which result, and why the level was left."""
    for failure, steps in groupby(recovery, key=lambda row: row["failure"]):
        yield ""
        yield f"failure {failure}"
        for (number, level, spent_s), rows in groupby(
            steps, key=lambda row: (row["level_number"], row["level"], row["spent_s"])
        ):
            stay = list(rows)
            yield f"  {number} {level:<6}{spent_s:>9.3f} s"
            for row in stay:
                by = f", by {row['decided_by']}" if row["decided_by"] else ""
                yield f"{row['time_s']:>10.3f} s    {row['what']}{by}{_result(row, stay)}"


def _result(row: Mapping[str, Any], stay: Sequence[Mapping[str, Any]]) -> str:
    result = f": {row['result']}" if row["result"] else ""
    if row["achieved"]:
        result += f" ({row['achieved']})"
    if row["to_level"] is not None:
        attempts = sum(one["budget_s"] is not None for one in stay)
        budget = next((one["budget_s"] for one in stay if one["budget_s"] is not None), None)
        result += (
            "" if budget is None else f" ({attempts} {'attempt' if attempts == 1 else 'attempts'} within {budget:g} s)"
        )
    return result


def _draw(files: Mapping[str, Path], rows: Story, *, is_ladder: bool) -> None:
    if not files:
        return
    from fsar_ledger.report import sequence, typeset

    figure = sequence.ladder if is_ladder else sequence.sequence
    for kind, path in files.items():
        typeset.publish(path, figure(rows, kind))
