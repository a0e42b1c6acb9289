"""Write a few events as lines of canonical JSON, straight from their structs, in C where it was built (`_encoding.c`).

`codec.encode_lines` gives the same bytes by type and column, in Python, and says what no row can hold.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, TypeAlias

from fsar_ledger.ledger.rows.runs import LedgerRun
from fsar_ledger.ledger.rows.schema import ENVELOPE, LAYOUTS, StoredType

Columns: TypeAlias = tuple[tuple[Any, ...], ...]

_KINDS = {
    kind: code
    for code, kind in enumerate(
        ("string", "integer", "boolean", "strings", "run_id", "seq", "time_us", "caused_by", "type")
    )
}
"""As in `_encoding.c`: the kinds of fields, then the columns that every row has."""


def _columns(layout: StoredType) -> Columns:
    """Return the columns of this event type as `_encoding.lines` wants them, in the order of a row."""
    found: dict[str, tuple[Any, ...]] = {
        field.name: (_KINDS[field.name], None, None, layout.tag, False, None) for field in ENVELOPE
    }
    for member in layout.members:
        for field in member.fields:
            place = (_KINDS[field.kind], member.name, member.part, field.name)
            found[field.name] = (*place, field.is_nullable, field.values)
    return tuple((kind, f'"{name}":'.encode(), *rest) for name, (kind, *rest) in sorted(found.items()))


_TYPES: dict[type, Columns] = {layout.cls: _columns(layout) for layout in LAYOUTS.values()}


def _compiled() -> Callable[..., bytes | None] | None:
    try:
        from fsar_ledger.ledger.rows import _encoding
    except ImportError:  # it was not built, as without a compiler
        return None
    return partial(_encoding.lines, _encoding.types(_TYPES))


_lines = _compiled()
IS_COMPILED = _lines is not None
"""Whether events are written in C."""


def plain_lines(run: LedgerRun) -> bytes | None:
    """Return the canonical bytes of the rows of this run, each with a line feed after it, if that is quick and plain.

    None says nothing about them: it was not built, or a row has text that is not plain ASCII, or no row can hold it.
    """
    if _lines is None:
        return None
    return _lines(run.run_id, run.first, _listed(run.times_us), _listed(run.caused_by), _listed(run.events))


def plain_rows(runs: Sequence[LedgerRun]) -> bytes | None:
    """Return the canonical bytes of the rows of these runs, as `plain_lines`; None if those of one are not plain."""
    found: list[bytes] = []
    for run in runs:
        if (lines := plain_lines(run)) is None:
            return None
        found.append(lines)
    return found[0] if len(found) == 1 else b"".join(found)


def _listed(values: Sequence[Any]) -> list[Any]:
    return values if type(values) is list else list(values)
