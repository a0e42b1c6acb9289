"""What a segment may cost to read, found out before anything is unpacked.

A Parquet file of a few kilobytes can claim, and unpack to, any number of rows: one repeated value costs nothing to
store. So the headers of all its pages are read first, and a file that asks for more than any batch of runs needs is
refused.
"""

import pyarrow as pa
import pyarrow.compute as pc

MAX_ROWS = 1 << 20
"""Events in one commit; a batch of 25 runs has some ten thousand.

So many take `verify` a gigabyte: 122 columns of 4 to 8 bytes, and work.
"""
MAX_SEGMENT_BYTES = 1 << 27
"""One event takes 10 to 17 bytes; so many rows of 128 bytes still fit."""
MAX_UNPACKED_BYTES = 1 << 27
"""All pages of a segment, unpacked: 13 bytes an event as we write them."""
MAX_TEXT_BYTES = 1 << 29
"""All strings of a segment, each written out where it stands, some 150 bytes an event; its canonical rows are a little
more, a part of them at once.
"""
MAX_LIST_VALUES = 1 << 22
"""Elements of all columns of lists, beyond one a row and column that says that there is none: 4 for each of the most
rows.
"""

MAX_FOOTER_BYTES = 1 << 20
MAX_PAGES = 1 << 10
"""Of one column: pyarrow begins a new page after 20,000 rows or 1 MiB."""
MAX_BOUND_BYTES = 1 << 12
"""A longer `run_id` is no bound in statistics."""
MAX_NAME_BYTES = MAX_BOUND_BYTES
"""Of the `run_id` of a new run and the origin of a new ledger, which stand in every record, and a record is a small
file.
"""


def text_bytes(table: pa.Table) -> int:
    """Return the bytes of all strings of the table, each counted in every row that has it.

    Codes into a dictionary count as the strings that they stand for.
    """
    size = 0
    for column in table.columns:
        for chunk in column.chunks:
            if chunk.null_count == len(chunk):  # most columns of a short run
                continue
            values = chunk.flatten() if pa.types.is_list(chunk.type) else chunk
            if pa.types.is_dictionary(values.type):
                size += pc.sum(pc.binary_length(values.dictionary).cast(pa.int64()).take(values.indices)).as_py() or 0
            elif pa.types.is_string(values.type):
                size += pc.sum(pc.binary_length(values).cast(pa.int64())).as_py() or 0
    return size


def has_more_text_than(table: pa.Table, most: int) -> bool:
    """Return whether `text_bytes` is more than this.

    Quick where even the longest string of each column in every row would not be.
    """
    longest = 0
    for column in table.columns:
        for chunk in column.chunks:
            values = chunk.flatten() if pa.types.is_list(chunk.type) else chunk
            texts = values.dictionary if pa.types.is_dictionary(values.type) else values
            if pa.types.is_string(texts.type):
                longest += len(values) * (pc.max(pc.binary_length(texts)).as_py() or 0)
    return longest > most and text_bytes(table) > most
