"""A quick way to verify many damaged copies of one ledger: what is the same is decoded only once."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

import msgspec

from fsar_ledger.ledger.log.hashing import sha256_hex
from fsar_ledger.ledger.rows import segment
from fsar_ledger.ledger.store import disk, read
from fsar_ledger.ledger.store.segments import find_segment
from fsar_ledger.ledger.verify import chain
from fsar_ledger.ledger.verify import segment as verify_segment
from fsar_ledger.ledger.verify.segment import SegmentFacts

MOST = 500
"""The most answers that are kept of each function."""
Call = Callable[..., Any]


def once(function: Call, key: Callable[..., object]) -> Call:
    """Return the function, which answers again what it answered for the same key; an error is never kept."""
    known: dict[object, Any] = {}

    def again(*arguments: Any, **named: Any) -> Any:
        asked = key(*arguments, **named)
        if asked not in known:
            answer = function(*arguments, **named)
            if len(known) == MOST:
                known.clear()
            known[asked] = answer, arguments  # kept, so that no other argument gets its identity
        return known[asked][0]

    return again


def _file(path: Path) -> str:
    try:
        return sha256_hex(disk.read_document(path))
    except OSError as error:
        return f"{path}: {error}"


def _examined(ledger: str, number: int, record: Any, names: Any, second_reader: object = None) -> object:
    file = find_segment(Path(ledger), number, record, names).file
    return number, record, names, second_reader, _file(Path(ledger, file))


def _patched(module: object, name: str, key: Callable[..., object]) -> Any:
    return patch.object(module, name, once(getattr(module, name), key))


@contextmanager
def decoded_once() -> Iterator[None]:
    """Make `verify` decode each segment, and the rows of each frame of a journal, only once, inside the block."""
    examine = once(verify_segment.examine, _examined)

    def placed(ledger: str, number: int, record: Any, names: Any, *rest: Any) -> SegmentFacts:
        file = find_segment(Path(ledger), number, record, names).file
        facts: SegmentFacts = examine(ledger, number, record, names, *rest)
        return msgspec.structs.replace(facts, file=file)

    def of_file(path: Path, columns: list[str] | None = None) -> object:
        return _file(path), tuple(columns or ())

    with (
        patch.object(verify_segment, "examine", placed),
        _patched(segment, "read_table", of_file),
        _patched(read, "check_layout", lambda _, data: sha256_hex(data)),
        _patched(chain, "table_of", lambda _, rows: tuple(rows)),
        _patched(chain, "first_flaw", lambda table, **_: id(table)),
    ):
        yield
