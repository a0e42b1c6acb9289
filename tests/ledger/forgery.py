"""What a forger does to a ledger: change records, and chain and hash them again. Also a quick way to verify many
damaged copies."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

import msgspec
import pyarrow as pa

from fsar_ledger.ledger.rows import canonical, segment
from fsar_ledger.ledger.rows.schema import SCHEMA
from fsar_ledger.ledger.store import disk
from fsar_ledger.ledger.store.paths import commit_path, segment_path
from fsar_ledger.ledger.store.record import CommitRecord, sha256_hex
from fsar_ledger.ledger.store.walk import Names, find_segment
from fsar_ledger.ledger.verify import segment as verify_segment
from fsar_ledger.ledger.verify.segment import SecondReader, SegmentFacts, examine


def record_of(path: Path, number: int) -> CommitRecord:
    """Return the commit record as it is, unchecked."""
    return msgspec.json.decode(commit_path(path, number).read_bytes(), type=CommitRecord)


def forge(path: Path, number: int, /, **changes: object) -> None:
    """Change one record and chain all later records to it again, as a forger without our tests would."""
    records = [record_of(path, at) for at in range(len(list((path / "commits").iterdir())))]
    for at in range(number, len(records)):
        previous = sha256_hex(commit_path(path, at - 1).read_bytes() if at else (path / "ledger.json").read_bytes())
        own = changes if at == number else {}
        records[at] = msgspec.structs.replace(records[at], **{"previous_sha256": previous, **own})
        commit_path(path, at).write_bytes(canonical.document(records[at]))


def forge_segment(path: Path, number: int, table: pa.Table | bytes) -> None:
    """Put other rows into the segment and make its record fit the file, but not the tree."""
    data = table if isinstance(table, bytes) else bytes(segment.to_parquet(table))
    segment_path(path, number).write_bytes(data)
    forge(path, number, segment_sha256=sha256_hex(data), segment_bytes=len(data))


def table_of(path: Path, number: int) -> pa.Table:
    """Return the rows of a commit."""
    return segment.read_table(segment_path(path, number))


def changed(table: pa.Table, name: str, row: int, value: object) -> pa.Table:
    """Return the same rows except for one value."""
    values = table.column(name).to_pylist()
    values[row] = value
    at = SCHEMA.get_field_index(name)
    return table.set_column(at, SCHEMA.field(name), pa.array(values, SCHEMA.field(name).type))


class _Watched:
    """A record that notes which of its fields are read."""

    def __init__(self, record: CommitRecord, fields: set[str]):
        self._record, self._fields = record, fields

    def __getattr__(self, name: str) -> Any:
        self._fields.add(name)
        return getattr(self._record, name)


class Examined:
    """What the segments of a ledger hold, for quick verification of its damaged copies.

    Decoding takes nine tenths of the time of `verify`. The same file, number and fields that `examine` reads of the
    record give the same facts.
    """

    def __init__(self, path: Path):
        self._fields: set[str] = set()
        self._known: dict[tuple[object, ...], SegmentFacts] = {}
        for number in range(len(list((path / "commits").iterdir()))):
            file, record = segment_path(path, number), record_of(path, number)
            facts = examine(str(path), number, _Watched(record, self._fields))
            assert not facts.problems
            self._known[self._key(file.read_bytes(), number, record)] = facts

    def _key(self, data: bytes, number: int, record: CommitRecord) -> tuple[object, ...]:
        return sha256_hex(data), number, *(getattr(record, name) for name in sorted(self._fields))

    def __call__(
        self,
        ledger: str,
        number: int,
        record: CommitRecord | None,
        second_reader: SecondReader | None = None,
        names: Names | None = None,
    ) -> SegmentFacts:
        """As `examine`."""
        try:
            file = find_segment(Path(ledger), number, record, names).file if record is not None else ""
            known = record and self._known.get(self._key(disk.read_document(Path(ledger, file)), number, record))
        except OSError:
            known = None
        return (
            msgspec.structs.replace(known, file=file)
            if known
            else examine(ledger, number, record, second_reader, names)
        )


_examined: dict[tuple[tuple[str, str], ...], Examined] = {}


@contextmanager
def examined_once(ledger: Path | Examined) -> Iterator[None]:
    """Make `verify` and `recover` decode only segments that differ from those that this ledger holds now.

    Of equal ledgers, only the first is decoded.
    """
    if isinstance(ledger, Examined):
        examined = ledger
    else:
        held = tuple(
            (file.name, sha256_hex(file.read_bytes()))
            for part in ("commits", "segments")
            for file in sorted((ledger / part).iterdir())
        )
        if held not in _examined:
            _examined[held] = Examined(ledger)
        examined = _examined[held]
    with patch.object(verify_segment, "examine", examined):
        yield
