"""Limits on the cost of reading a segment, checked before anything is unpacked.

A Parquet file of a few kilobytes can claim, and unpack to, any number of rows: one repeated value costs nothing to
store. So all page headers are read first, and a file that needs more than any batch of runs is refused.
"""

from collections.abc import Iterator

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

MAX_ROWS = 1 << 20
"""Events in one commit; a batch of 25 runs has about ten thousand.

For this many, `verify` needs a gigabyte: some 130 columns of 4 to 8 bytes, and working memory.
"""
MAX_SEGMENT_BYTES = 1 << 27
"""Bytes of a segment. An event takes 10 to 17 bytes; `MAX_ROWS` rows of 128 bytes still fit."""
MAX_UNPACKED_BYTES = 1 << 27
"""Bytes of all pages of a segment, unpacked. Those that our writer makes take 13 per event."""
MAX_TEXT_BYTES = 1 << 29
"""Bytes of all strings of a segment, each counted in every row: some 150 per event. The canonical rows take a little
more, but only a part is in memory at once.
"""
MAX_LIST_VALUES = 1 << 22
"""Values of all list columns, beyond one per row and column, which a NULL list takes too: 4 for each of `MAX_ROWS`.
"""

MAX_FOOTER_BYTES = 1 << 20
MAX_PAGES = 1 << 10
"""Pages of one column; pyarrow begins a new one after 20,000 rows or 1 MiB."""
MAX_BOUND_BYTES = 1 << 12
"""Bytes of a `run_id` in statistics, which omit a longer one."""
MAX_NAME_BYTES = MAX_BOUND_BYTES
"""Bytes of the `run_id` of a new run and the origin of a new ledger: every commit record contains them and must stay
small.
"""


def text_bytes(table: pa.Table) -> int:
    """Return the total bytes of the table's strings, each counted in every row, in dictionaries or not."""
    size = 0
    for values in _chunks(table):
        if pa.types.is_dictionary(values.type):
            size += pc.sum(pc.binary_length(values.dictionary).cast(pa.int64()).take(values.indices)).as_py() or 0
        elif pa.types.is_string(values.type):
            size += pc.sum(pc.binary_length(values).cast(pa.int64())).as_py() or 0
    return size


def has_more_text_than(table: pa.Table, most: int) -> bool:
    """Return whether `text_bytes` exceeds `most`.

    Fast if it would not even with the longest string of each column in every row.
    """
    longest = 0
    for values in _chunks(table):
        texts = values.dictionary if pa.types.is_dictionary(values.type) else values
        if pa.types.is_string(texts.type):
            longest += len(values) * _longest(texts)
    return longest > most and text_bytes(table) > most


def _chunks(table: pa.Table) -> Iterator[pa.Array]:
    """Yield the chunks of each column, lists flattened, without those that are all NULL."""
    for column in table.columns:
        for chunk in column.chunks:
            if chunk.null_count < len(chunk):  # most columns of a short run have none
                yield chunk.flatten() if pa.types.is_list(chunk.type) else chunk


def _longest(texts: pa.Array) -> int:
    """Return the length of the longest string in bytes."""
    ends = np.frombuffer(texts.buffers()[1] or bytes(4), np.int32)[texts.offset : texts.offset + len(texts) + 1]
    return int(np.diff(ends).max(initial=0))
