"""The command `explain`: the requests of a run, or one of them as text, JSON or a figure."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from fsar_ledger import printable
from fsar_ledger.cli.options import (
    FailureOption,
    JsonOption,
    LedgerArgument,
    PdfOption,
    RequestOption,
    RunOption,
    SvgOption,
    VerifiedOption,
    WideOption,
    examples,
)
from fsar_ledger.cli.terminal import show, width_of_names
from fsar_ledger.errors import UsageError

if TYPE_CHECKING:
    from fsar_ledger.api.table import Table

EXAMPLES = examples(
    "fsar-ledger explain out/ledger",
    "fsar-ledger explain out/ledger --run 1 --request A1-1/2.1",
    "fsar-ledger explain out/ledger --run 2 --request A1-1/2.1 --svg out/request.svg",
    "fsar-ledger explain out/ledger --run 1 --json",
)

Kind = Literal["svg", "pdf"]
Timeline = list[dict[str, Any]]
Run = tuple[str, int | None]
"""The name of a run, and the number that names it, where it has one."""

COLUMNS = (
    "began_s",
    "action_id",
    "capability",
    "asked_by",
    "allowed_by",
    "denied_by",
    "denied_under",
    "executed_by",
    "supervised_by",
    "failures",
    "result",
    "seq",
)
LATER = ("capability", "denied_under", "executed_by", "supervised_by", "failures")
"""Columns that a terminal shows if there is room beside the others."""
PARTIES = ("asked_by", "allowed_by", "denied_by", "denied_under", "executed_by", "supervised_by")
DENIED = ("denied_by", "denied_under")
UNKNOWN = "not on record"
BESIDE = 24
"""Characters of a step beside its names and words: time, seq and gaps."""
WORDS, MAX_WORDS = ("message", "note"), 1_000


def explain(
    ledger: LedgerArgument,
    run: RunOption = None,
    request: RequestOption = None,
    failure: FailureOption = None,
    svg: SvgOption = None,
    pdf: PdfOption = None,
    verified: VerifiedOption = False,
    as_json: JsonOption = False,
    wide: WideOption = False,
) -> None:
    """Show the timeline of a request: who asked, who allowed or denied, who acted, who supervised.

    Each line has its position in the run (seq), which `prove RUN:SEQ` takes. For a request that failed, also what
    recovery tried at each level, for how long, and why it moved on. Without --request and --failure, list the requests
    of the run.
    """
    from fsar_ledger.api.explain import account, requests
    from fsar_ledger.cli.answering import opened, warn
    from fsar_ledger.cli.output import json_text, run_text
    from fsar_ledger.ledger.store.paths import require_outside

    kinds: tuple[tuple[Kind, Path | None], ...] = (("svg", svg), ("pdf", pdf))
    files = {kind: path for kind, path in kinds if path is not None}
    if request is not None and failure is not None:
        raise UsageError(
            f"--request {request} and --failure {failure}: expected one of them; --request shows a failure, too"
        )
    if files and request is None and failure is None:
        raise UsageError(f"--{next(iter(files))}: found no request to draw; give --request ACTION or --failure ACTION")
    for kind, path in files.items():
        require_outside(path, f"--{kind} {path}")
    asked = opened(ledger, verified=verified)
    with asked.about_run(run, request or failure) as about:
        database, name, number = about
        if request is None and failure is None:
            listed = requests(database, name)
        else:
            told = account(about, ledger, request, failure)
    if request is None and failure is None:
        warn(ledger, listed.provenance)
        _list(ledger, (name, number), listed, as_json=as_json, wide=wide)
        return
    for kind, path in files.items():
        told.draw(path, kind=kind)
    warn(ledger, told.provenance)
    if as_json:
        answer = {"parties": told.parties, "timeline": told.timeline, "recovery": told.recovery}
        provenance = told.provenance
        show(
            json_text(
                provenance.head,
                {**provenance.answer(), "run": name, "action": told.action, **answer},
                provenance.rows_verified,
            )
        )
        return
    steps, parties = shown(told.timeline if failure is None else []), shown([told.parties])[0]
    lines = _told(run_text(name, number), told.action, steps, parties)
    hints = [_proof(ledger, (name, number), told.decisive_seq)]
    hints += [_proof(ledger, (name, number), seq, " (the window or rule)") for seq in told.grounds]
    show(printable.lines(*lines, *_recovered(shown(told.recovery)), "", *hints, *map(str, files.values())))


def shown(rows: Sequence[Mapping[str, Any]]) -> Timeline:
    """Return the rows with each text as people see it: `MAX_WORDS` characters of messages, fewer of names."""
    return [
        {
            name: printable.value(found, MAX_WORDS if name in WORDS else printable.MAX_VALUE)
            if isinstance(found, str)
            else found
            for name, found in row.items()
        }
        for row in rows
    ]


def _list(ledger: Path, run: Run, found: "Table", *, as_json: bool, wide: bool) -> None:
    """Show the requests of a run."""
    from fsar_ledger.cli.output import json_text, run_text, run_word
    from fsar_ledger.cli.tables import is_fitted, table

    provenance, rows = found.provenance, found.rows()
    if as_json:
        answer = {**provenance.answer(), "run": run[0], "requests": rows}
        show(json_text(provenance.head, answer, provenance.rows_verified))
    elif not rows:
        nothing = (
            "no requests on record; not all that a request leaves was observed"
            if provenance.not_observed
            else "no requests"
        )
        show(printable.lines(run_text(*run), nothing))
    else:
        began = [{**row, "began_s": f"{row['began_s']:.3f}"} for row in rows]
        hint = (
            f"`fsar-ledger explain {printable.word(ledger)} --run {run_word(*run)} --request "
            f"{printable.word(rows[0]['action_id'])}` tells one of them"
        )
        shown = table(began, sorted(COLUMNS, key=LATER.__contains__) if is_fitted(wide=wide) else COLUMNS, wide=wide)
        show(printable.joined(printable.lines(run_text(*run), ""), shown, printable.lines("", hint)))


def _told(run: str, action: str, timeline: Timeline, parties: Mapping[str, Any]) -> Iterator[str]:
    """Yield the words for the run, the action, a line for each step, and the parties."""
    yield run
    what = f", {parties['capability']}" if parties["capability"] else ""
    yield f"action {printable.value(action)}{what}, begins at {parties['began_s']:.3f} s"
    between = [_between(row) for row in timeline]
    width = width_of_names(max(map(len, between), default=0), BESIDE)
    for row, names in zip(timeline, between, strict=True):
        note = f"  ({row['note']})" if row["note"] else ""
        if row["step"] <= 1:
            yield ""
        tie = " " if row["is_tied"] else "*"
        yield f"{row['time_s']:>10.3f} s {row['seq']:>6} {tie} {names:<{width}}  {row['message']}{note}"
    if not all(row["is_tied"] for row in timeline):
        yield "* the record names no action; its cause does"
    yield ""
    yield from (f"{name.replace('_', ' '):<14} {found}" for name, found in _parties(parties))
    took = "" if parties["ended_s"] is None else f", {parties['ended_s'] - parties['began_s']:.3f} s after it began"
    yield f"{'result':<14} {parties['result'] or 'not observed'}{took}"


def _parties(parties: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield who asked, allowed, denied (and when, under which window or rule), executed, supervised."""
    for name in PARTIES:
        if name in DENIED and not parties["denials"]:
            continue
        when = ""
        if name == "denied_by":
            times = "" if parties["denials"] == 1 else f"{parties['denials']} times, the last "
            when = f", {times}at {parties['denied_s']:.3f} s (seq {parties['denied_seq']})"
        yield name, f"{parties[name] or UNKNOWN}{when}"


def _proof(ledger: Path, run: Run, seq: int, what: str = "") -> str:
    """Return the call that proves an event, and what it is."""
    name, number = run
    event = printable.word(f"{name if number is None else number}:{seq}")
    return f"`fsar-ledger prove {printable.word(ledger)} {event}` proves event {seq}{what} to others"


def _between(row: Mapping[str, Any]) -> str:
    """Return who told whom; one name for a deed."""
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
            yield f"  {number} {level:<6}{spent_s:>9.3f} s"
            for row in stay:
                by = f", by {row['decided_by']}" if row["decided_by"] else ""
                yield f"{row['time_s']:>10.3f} s {row['seq']:>6}   {row['what']}{by}{_result(row, stay)}"


def _result(row: Mapping[str, Any], stay: Sequence[Mapping[str, Any]]) -> str:
    result = f": {row['result']}" if row["result"] else ""
    if row["achieved"]:
        result += f" ({row['achieved']})"
    if row["to_level"] is not None:
        attempts = sum(one["budget_s"] is not None for one in stay)
        budget = next((one["budget_s"] for one in stay if one["budget_s"] is not None), None)
        result += (
            "" if budget is None else f" ({printable.counted(attempts, 'attempt')} within {printable.number(budget)} s)"
        )
    return result
