"""The account of a request as lines."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any

from fsar_ledger import printable

from .answers import Screen

Timeline = list[dict[str, Any]]

PARTIES = ("asked_by", "allowed_by", "denied_by", "denied_under", "executed_by", "supervised_by")
DENIED = ("denied_by", "denied_under")
UNKNOWN = "not on record"
BESIDE = 24
"""Characters of a step beside its names and words: time, seq and gaps."""
WORDS, MAX_WORDS = ("message", "note"), 1_000


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


def account_lines(
    screen: Screen, who: tuple[str, str], timeline: Timeline, parties: Mapping[str, Any], recovery: Timeline
) -> Iterator[str]:
    """Yield the words for the run, the action (`who`), a line for each step, the parties, and the recovery."""
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
        yield f"{row['time_s']:>10.3f} s {row['seq']:>6} {tie} {names:<{width}}  {row['message']}{note}"
    if not all(row["is_tied"] for row in timeline):
        yield "* the record names no action; its cause does"
    yield ""
    yield from (f"{name.replace('_', ' '):<14} {found}" for name, found in _parties(parties))
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
            times = "" if parties["denials"] == 1 else f"{parties['denials']} times, the last "
            when = f", {times}at {parties['denied_s']:.3f} s (seq {parties['denied_seq']})"
        yield name, f"{parties[name] or UNKNOWN}{when}"


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
