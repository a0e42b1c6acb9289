"""The hot paths of the codec in C (`_codec.c`), where they were built; each has a twin in Python.

| in C | from | to | twin |
|---|---|---|---|
| `write_events` | the events of a run | rows, lines of canonical JSON | `codec.encode_lines` |
| `write_rows` | columns | rows | `canonical.from_table` |
| `read_rows` | rows | columns | `codec.encode_coded`, `tables.table_of` |
"""

# See docs/decisions/c-is-optional.md.
try:
    from fsar_ledger.ledger.rows import _codec
except ImportError:  # it was not built, as without a compiler
    _codec = None  # type: ignore[assignment]

codec = _codec
"""The functions of the table; None where they were not built."""
IS_COMPILED = codec is not None
