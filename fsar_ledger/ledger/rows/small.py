"""Check and encode a few events at once, without columns: what goes into a journal."""

from collections.abc import Sequence
from operator import le

from fsar_ledger.errors import InvalidRun
from fsar_ledger.events.concerns import CONCERNS
from fsar_ledger.ledger.rows.blocks import Block
from fsar_ledger.ledger.rows.check import disordered, unprintable
from fsar_ledger.ledger.rows.codec import encode_coded, encode_lines
from fsar_ledger.ledger.rows.encoding import plain_rows
from fsar_ledger.ledger.rows.runs import LedgerRun, overlong, refusal, require_runs, unreadable
from fsar_ledger.ledger.rows.schema import CONCERNED, LAYOUTS, OPENINGS, STANDS_ALONE

_TAG_OF: dict[type, str] = {layout.cls: tag for tag, layout in LAYOUTS.items()}


def rows_of(runs: Sequence[LedgerRun]) -> tuple[bytes, tuple[Block, ...]]:
    """Return the rows of these runs, the canonical bytes of each with a line feed after it, and their blocks.

    Raises: InvalidRun for whatever `store.append.stage` refuses, but for its bounds on a segment.
    """
    if not runs:
        raise InvalidRun("found no runs to commit, expected at least 1")
    require_runs(runs)
    plain = plain_rows(runs)
    rows = b"\n".join((*encode_lines(runs), b"")) if plain is None else plain
    tags = list(map(_tags, runs))
    if (plain is None and not _is_printable(rows)) or not all(map(_is_in_order, runs, tags)):
        table = encode_coded(runs)
        if flaw := unprintable(table):
            raise InvalidRun(f"{flaw}; give it another name")
        if flaw := disordered(table):
            raise refusal(flaw)
    if flaw := unreadable(runs) or overlong(runs):
        raise refusal(flaw)
    return rows, tuple(map(_block, runs, tags))


def _is_printable(rows: bytes) -> bool:
    """Return whether it is plain that all text in these rows, canonical JSON, is printable.

    JSON escapes other ASCII than DEL by a backslash. Looking at bytes takes a tenth of the time of looking at text.
    """
    text = rows.replace(b"\n", b"")
    return b"\\" not in text and b"\x7f" not in text and (text.isascii() or text.decode().isprintable())


def _is_in_order(run: LedgerRun, tags: Sequence[str]) -> bool:
    """Return whether it is plain that nothing is wrong with the order of these events and the run's beginning."""
    begins = run.first == 0
    first, *others = tags
    if begins != (first in OPENINGS) or any(tag in OPENINGS or tag in STANDS_ALONE for tag in others):
        return False
    if begins and len(run.events) > 1 and (first in STANDS_ALONE or type(run.events[0]) in map(type, run.events[1:])):
        return False
    observes = _observes(run)
    return all(map(le, run.times_us, run.times_us[1:])) and (
        observes is None or (set(observes) <= set(CONCERNS) and set(_concerns(tags)) <= set(observes))
    )


def _block(run: LedgerRun, tags: Sequence[str]) -> Block:
    return Block(
        run.run_id,
        run.first,
        len(run.events),
        run.times_us[0],
        run.times_us[-1],
        _observes(run),
        _concerns(tags) if run.first else (),
        tags[0] in STANDS_ALONE,
    )


def _tags(run: LedgerRun) -> list[str]:
    """Return the types of the run's events, each once, that of the first one first."""
    return [_TAG_OF[kind] for kind in dict.fromkeys(map(type, run.events))]


def _observes(run: LedgerRun) -> tuple[str, ...] | None:
    """Return what the run's event 0 says that it observes; None if that says nothing, or is not here."""
    found: tuple[str, ...] | None = None if run.first else getattr(run.events[0], "observes", None)
    return found


def _concerns(tags: Sequence[str]) -> tuple[str, ...]:
    return tuple(sorted({CONCERNED[tag] for tag in tags if tag in CONCERNED}))
