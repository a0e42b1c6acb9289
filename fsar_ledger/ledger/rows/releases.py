"""The columns that each release wrote.

A commit record names the release of its events, so a reader knows whether it can read them.

`columns/N.N.N.txt` holds the columns of one release as text; its SHA-256 is the `schema_sha256` of the records that
name the release. A release that changes no event type has no such file: its records name the release before. Columns
are added, and never changed or removed, so rows of an earlier release are rows of today with NULL in later columns.
"""

from collections.abc import Sequence
from importlib.resources import files

import pyarrow as pa

from fsar_ledger.ledger.rows.schema import SCHEMA, described, fingerprint

RELEASE = "0.13.0"
"""The first release with the current event types. Any change to them makes this the next release."""


def parse_columns(where: str, text: str) -> pa.Schema:
    """Parse the columns in this text, which must be among today's.

    Raises:
        TypeError: Today's columns lack one of them or changed it, so that ledgers of that release could not be read.
    """
    names = [line.partition(" ")[0] for line in text.splitlines()]
    schema = pa.schema([SCHEMA.field(name) for name in SCHEMA.names if name in names])
    if described(schema) != text:
        changed = sorted(set(text.splitlines()) - set(described(schema).splitlines())) or [
            "the columns in another order"
        ]
        raise TypeError(
            f"{where}: found {changed[0]}, which today's columns do not have; keep each column as it was, and its "
            "event type in RETIRED_TYPES"
        )
    return schema


def _number(release: str) -> tuple[int, ...] | None:
    """Return the three numbers of a release; None for any other text."""
    parts = release.split(".")
    if len(parts) != 3 or not all(
        part.isascii() and part.isdecimal() and len(part) < 10 and part == str(int(part)) for part in parts
    ):
        return None
    return tuple(map(int, parts))


def _released() -> dict[str, pa.Schema]:
    """Return the columns of every release that has a file, the first release first."""
    found = {file.name.removesuffix(".txt"): file for file in (files("fsar_ledger.ledger.rows") / "columns").iterdir()}
    return {
        release: parse_columns(found[release].name, found[release].read_text("utf-8"))
        for release in sorted(found, key=lambda release: _number(release) or ())
    }


SCHEMAS: dict[str, pa.Schema] = _released() | {RELEASE: SCHEMA}
"""The columns of every release that this version reads, including its own."""

FINGERPRINTS: dict[str, str] = {release: fingerprint(schema) for release, schema in SCHEMAS.items()}
"""The fingerprint of the columns of each release; several may have the same."""


def is_later(release: str) -> bool:
    """Return whether this names a release whose events came after those of `RELEASE`."""
    number = _number(release)
    own = _number(RELEASE)
    return number is not None and own is not None and number > own


def widened(table: pa.Table, names: Sequence[str], schema: pa.Schema) -> pa.Table:
    """Return the rows with all columns of today's schema, in its order, with NULL in those that are missing."""
    fields = [field for field in schema if field.name in names]
    present = set(table.column_names)
    if len(present) == len(fields):
        return table
    columns = [
        table.column(field.name) if field.name in present else pa.nulls(table.num_rows, field.type) for field in fields
    ]
    return pa.Table.from_arrays(columns, schema=pa.schema(fields))
