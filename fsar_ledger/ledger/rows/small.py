"""Check and encode a few events at once, without columns: what goes into a journal."""

from collections.abc import Sequence
from functools import lru_cache

from fsar_ledger.base.errors import InvalidRun
from fsar_ledger.events import CONCERNS
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.ledger.rows.blocks import Block
from fsar_ledger.ledger.rows.check import disordered, unprintable
from fsar_ledger.ledger.rows.codec import encode_coded, encode_lines
from fsar_ledger.ledger.rows.encoding import MARK_OF, OPENING, Plain, marks_of, plain_lines, plain_rows
from fsar_ledger.ledger.rows.runs import LedgerRun, overlong, refusal, require_runs, unreadable
from fsar_ledger.ledger.rows.schema import LAYOUTS, OPENINGS, STANDS_ALONE, concerns_admitted

_TAG_OF: dict[type, str] = {layout.cls: tag for tag, layout in LAYOUTS.items()}


def rows_of(runs: Sequence[LedgerRun]) -> tuple[bytes, tuple[Block, ...]]:
    """Return the rows of these runs, the canonical bytes of each with a line feed after it, and their blocks.

    Raises: InvalidRun for whatever `stage` refuses, but for its bounds on a segment.
    """
    if not runs:
        raise InvalidRun("found no runs to commit, expected at least 1")
    if len(runs) == 1 and (going_on := _going_on(runs[0])) is not None:
        return going_on
    plain = plain_rows(runs)
    if plain is None or not plain.rows or len(runs) > 1:
        require_runs(runs)
    rows, marks = plain or Plain(b"\n".join((*encode_lines(runs), b"")), tuple(map(marks_of, runs)))
    if (plain is None and not _is_printable(rows)) or not all(map(_is_in_order, runs, marks)):
        table = encode_coded(runs)
        if flaw := unprintable(table):
            raise InvalidRun(f"{flaw}; give it another name")
        if flaw := disordered(table):
            raise refusal(flaw)
    begun = [run for run in runs if not run.first]
    if begun and (flaw := unreadable(begun) or overlong(begun)):  # of the others, the ledger holds the name
        raise refusal(flaw)
    return rows, tuple(map(_block, runs, marks))


def _going_on(run: LedgerRun) -> tuple[bytes, tuple[Block]] | None:
    """Return, as `rows_of`, what follows of a run that has begun; None unless it is plain that nothing is wrong."""
    if not run.first or (lines := plain_lines(run)) is None:
        return None
    rows, marks = lines
    return (rows, (_block(run, marks),)) if rows and _is_in_order(run, marks) else None


def _is_printable(rows: bytes) -> bool:
    """Return whether it is plain that all text in these rows, canonical JSON, is printable.

    JSON escapes other ASCII than DEL by a backslash. Looking at bytes takes a tenth of the time of looking at text.
    """
    text = rows.replace(b"\n", b"")
    return b"\\" not in text and b"\x7f" not in text and (text.isascii() or text.decode().isprintable())


@lru_cache
def _concerns(marks: int) -> tuple[str, ...]:
    return tuple(sorted(concern for concern, mark in MARK_OF.items() if marks & mark))


def _is_in_order(run: LedgerRun, marks: int) -> bool:
    """Return whether it is plain that nothing is wrong with the order of these events and the run's beginning."""
    times = run.times_us
    if marks & OPENING or (len(times) > 1 and list(times) != sorted(times)):
        return False
    if run.first:
        return True
    first, observes = _TAG_OF[type(run.events[0])], _observes(run)
    return (
        first in OPENINGS
        and getattr(run.events[0], "records", None) is None
        and (first not in STANDS_ALONE or len(run.events) == 1)
        and (observes is None or (set(observes) <= set(CONCERNS) and set(_concerns(marks)) <= set(observes)))
    )


def _block(run: LedgerRun, marks: int) -> Block:
    return Block(
        run.run_id,
        run.first,
        len(run.events),
        run.times_us[0],
        run.times_us[-1],
        _observes(run),
        _concerns(marks) if run.first else (),
        not run.first and _TAG_OF[type(run.events[0])] in STANDS_ALONE,
    )


def _observes(run: LedgerRun) -> tuple[str, ...] | None:
    """Return the concerns that the run's events may have, as event 0 says; None if it is not here or says nothing."""
    if run.first or not isinstance(started := run.events[0], RunStarted):
        return None
    return concerns_admitted(started.observes, started.records)
