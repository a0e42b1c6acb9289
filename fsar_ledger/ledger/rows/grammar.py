"""Regular expressions for the bytes of a segment's footer and page headers. Anything else is refused.

A footer is Thrift (compact protocol), which can encode one thing in many ways, and some things twice. Libraries choose
differently among them, so one file could have two contents. Here each struct is spelled out field by field, as the only
writer (Apache Arrow, called as in `segment.to_parquet`) makes it. Unknown, missing, repeated and reordered fields,
negative counts and overlong numbers then need no checks: they do not match. Matching takes microseconds.

Fields come in this order, with their numbers in Parquet's own definition; those in brackets may be omitted:

```
FileMetaData       1 version = 2, 2 schema (exactly as `schema_bytes` has it), 3 num_rows, 4 one row group,
                   6 created_by, 7 column_orders, all TYPE_ORDER
RowGroup           1 columns, one per column of the schema, 2 total_byte_size, 3 num_rows, 5 file_offset = 4,
                   6 total_compressed_size
ColumnChunk        2 file_offset = 0, 3 meta_data
ColumnMetaData     1 type, 2 encodings, 3 path_in_schema, 4 codec = ZSTD, 5 num_values, 6 total_uncompressed_size,
                   7 total_compressed_size, 9 data_page_offset, 11 dictionary_page_offset (strings only),
                   [12 statistics: `run_id`, `seq`, `time_us` only], 13 encoding_stats, [16 size_statistics]
Statistics         integers: 1 max, 2 min, 3 null_count = 0, 5 max_value = max, 6 min_value = min,
                   [7, 8 exact: true]; `run_id`: the same without 1 and 2, and without 5 to 8 where the bounds
                   are too long
SizeStatistics     1 unencoded_byte_array_data_bytes (strings only), 2 and 3 the histograms of levels, which have
                   as many numbers as there are levels
PageHeader,        1 type = 2, 2 uncompressed_page_size, 3 compressed_page_size, 4 crc,
  dictionary       7: 1 num_values, 2 encoding = PLAIN, 3 is_sorted = false
PageHeader, data   1 type = 0, 2 uncompressed_page_size, 3 compressed_page_size, 4 crc,
                   5: 1 num_values, 2 encoding, 3 and 4 levels in RLE, 5 statistics
```

The statistics of a page are empty, or written as those of the column chunk. Encodings: strings and lists of strings
PLAIN (dictionary, and data once the dictionary is full) and RLE_DICTIONARY; integers DELTA_BINARY_PACKED; booleans
PLAIN. `encodings` and `encoding_stats` agree with the pages.
"""

import re
from functools import cache
from typing import NamedTuple

import pyarrow as pa

from fsar_ledger.ledger.rows.schema import COLUMNS, Kind

MAGIC = b"PAR1"
HAS_STATISTICS = ("run_id", "seq", "time_us")
"""The columns that may have statistics. Statistics of other columns would save readers no work."""
_TYPES: dict[Kind, int] = {"boolean": 0, "integer": 2, "string": 6, "strings": 6}
_ENCODINGS: dict[Kind, bytes] = {
    "boolean": b"\x25\x06\x00",
    "integer": b"\x25\x06\x0a",
    "string": b"\x35\x00\x06\x10",
    "strings": b"\x35\x00\x06\x10",
}
_EVEN = b"".join(re.escape(bytes([byte])) for byte in range(0, 0x80, 2))
_EVEN_ON = b"".join(re.escape(bytes([byte])) for byte in range(0x80, 0x100, 2))
# A number from 0 to 2^34 - 1, zigzag, in its shortest form.
_N = rb"(?:[" + _EVEN_ON + rb"][\x80-\xff]{0,3}+[\x01-\x7f]|[" + _EVEN + rb"])"
_SUM = rb"(?:[\x80-\xff]{4}[\x01-\x0f]|[\x80-\xff]{0,3}+[\x01-\x7f]|\x00)"  # any 32 bits
_IS_EXACT = rb"(?:\x11\x11)?"
_INTEGER_BOUNDS = rb"\x18\x08(.{8})\x18\x08(.{8})\x16\x00\x28\x08(.{8})\x18\x08(.{8})" + _IS_EXACT + rb"\x00"
_WITHOUT_GROUPS = _INTEGER_BOUNDS.replace(b"(.{8})", b".{8}")

INTEGER_BOUNDS = re.compile(_INTEGER_BOUNDS, re.DOTALL)
"""The statistics of integers: maximum, minimum, and both again."""
_LENGTH = rb"([\x80-\xff][\x01-\x7f]|[\x00-\x7f])"
MOST = re.compile(rb"[\x1c]\x36\x00\x28" + _LENGTH, re.DOTALL)
LEAST = re.compile(rb"\x18" + _LENGTH, re.DOTALL)
BOUNDS_END = re.compile(_IS_EXACT + rb"\x00", re.DOTALL)
"""The end of the statistics of strings. `MOST` and `LEAST` each end with the length of the bound that follows."""
UNBOUNDED = b"\x1c\x36\x00\x00"
"""The statistics of strings that are too long to be bounds: only a null count of 0."""

_SIZES = rb"\x15(%b)\x15(%b)\x15(%b)" % (_N, _N, _SUM)  # unpacked, stored, checksum
DICTIONARY_PAGE = re.compile(rb"\x15\x04" + _SIZES + rb"\x3c\x15(%b)\x15\x00\x12\x00\x00" % _N, re.DOTALL)
"""The header of a dictionary page: unpacked bytes, stored bytes, checksum, number of values."""


def _data_page(encodings: bytes, end: bytes) -> re.Pattern[bytes]:
    """Match the header of a data page: unpacked bytes, stored bytes, checksum, number of values, encoding.

    Statistics of text that follow are not matched.
    """
    return re.compile(
        rb"\x15\x00" + _SIZES + rb"\x1c\x15(%b)\x15([%b])\x15\x06\x15\x06\x1c" % (_N, encodings) + end, re.DOTALL
    )


_DATA_PAGES: dict[Kind, re.Pattern[bytes]] = {
    "boolean": _data_page(rb"\x00", rb"()\x00\x00\x00"),
    "integer": _data_page(rb"\x0a", rb"()\x00\x00\x00"),
    "string": _data_page(rb"\x10\x00", rb"()\x00\x00\x00"),
    "strings": _data_page(rb"\x10\x00", rb"()\x00\x00\x00"),
}
_RUN_ID_PAGE = _data_page(rb"\x10\x00", rb"(\x00\x00\x00)?")
_BOUNDED_PAGE = _data_page(rb"\x0a", rb"()(?:(%b)|\x00)\x00\x00" % _WITHOUT_GROUPS)


def number(value: int) -> bytes:
    """Encode a non-negative Thrift number (zigzag)."""
    return length(value << 1)


class _Numbers(dict[bytes, int]):
    """A decoder of non-negative Thrift numbers (zigzag), which caches the short ones; most are short."""

    def __missing__(self, data: bytes) -> int:
        if len(data) < 3:
            return self.setdefault(data, unsigned(data) >> 1)
        if len(data) == 3:  # as most offsets have
            return ((data[0] & 0x7F) | (data[1] & 0x7F) << 7 | data[2] << 14) >> 1
        return unsigned(data) >> 1


def unsigned(data: bytes) -> int:
    """Decode a Thrift number without undoing zigzag."""
    value = 0
    for byte in reversed(data):
        value = value << 7 | byte & 0x7F
    return value


DECODED = _Numbers()
"""The inverse of `number`."""


def length(value: int) -> bytes:
    """Encode a Thrift length."""
    encoded = bytearray()
    while value > 0x7F:
        encoded.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*encoded, value])


def text(value: bytes) -> bytes:
    """Encode a Thrift string."""
    return length(len(value)) + value


def listed(count: int, kind: int) -> bytes:
    """Encode the header of a Thrift list of this many values of one kind."""
    return bytes([count << 4 | kind]) if count < 15 else bytes([0xF0 | kind]) + length(count)


def schema_bytes(schema: pa.Schema) -> bytes:
    """Return the list of schema elements of these columns, exactly as written in Thrift."""
    names = schema.names
    elements = [b"\x35\x00\x18\x06schema\x15" + number(len(names)) + b"\x00"]
    for field in schema:
        kind, repetition = COLUMNS[field.name], b"\x02" if field.nullable else b"\x00"
        if kind == "strings":
            elements += [
                b"\x35" + repetition + b"\x18" + text(field.name.encode()) + b"\x15\x02\x15\x06\x4c\x3c\x00\x00\x00",
                b"\x35\x04\x18\x04list\x15\x02\x00",
                _leaf(b"element", "string", b"\x00"),
            ]
        else:
            elements.append(_leaf(field.name.encode(), kind, repetition))
    return listed(len(elements), 12) + b"".join(elements)


def _leaf(name: bytes, kind: Kind, repetition: bytes) -> bytes:
    is_text = b"\x25\x00\x4c\x1c\x00\x00" if kind == "string" else b""
    return b"\x15" + number(_TYPES[kind]) + b"\x25" + repetition + b"\x18" + text(name) + is_text + b"\x00"


def path_of(name: str) -> str:
    """Return the Parquet path of a column; for a list, that of its elements."""
    return f"{name}.list.element" if COLUMNS[name] == "strings" else name


class Column(NamedTuple):
    """The bytes of one column in a segment.

    `about` is its chunk in the footer, up to the numbers. `chunk` matches the numbers (values, unpacked bytes, stored
    bytes, offset of the first data page, offset of the dictionary or nothing) and, except for `run_id`, the rest
    (statistics or None, encoding and size statistics). `page` matches the header of a page.
    """

    name: str
    kind: Kind
    about: bytes
    chunk: re.Pattern[bytes]
    page: re.Pattern[bytes]


class Footer:
    """The footer of segments with these columns.

    `begin` goes up to the number of rows. After that number come `group`, the columns, `GROUP_END` and `orders`.
    """

    def __init__(self, schema: pa.Schema) -> None:
        self.schema = schema
        self.columns = tuple(_column(field) for field in schema)
        count = listed(len(self.columns), 12)
        self.begin = b"\x15\x04\x19" + schema_bytes(schema) + b"\x16"
        self.group = b"\x19\x1c\x19" + count
        self.orders = b"\x19" + count + b"\x1c\x00\x00" * len(self.columns) + b"\x00"


ROWS = re.compile(rb"(%b)" % _N, re.DOTALL)
"""The number of rows."""
GROUP_END = re.compile(
    rb"\x16(%b)\x16(%b)\x26\x08\x16(%b)\x00\x28(.)(parquet-cpp-arrow version [-.0-9A-Za-z]{1,40}+)" % (_N, _N, _N),
    re.DOTALL,
)
"""After the columns: unpacked bytes, rows, stored bytes; length of the writer's name, and that name."""


def _column(field: pa.Field) -> Column:
    kind = COLUMNS[field.name]
    parts = path_of(field.name).encode().split(b".")
    path = listed(len(parts), 8) + b"".join(map(text, parts))
    about = b"\x26\x00\x1c\x15" + number(_TYPES[kind]) + b"\x19" + _ENCODINGS[kind] + b"\x19" + path + b"\x15\x0c"
    if field.name == "run_id":
        return Column(field.name, kind, about, _numbers(kind, b""), _RUN_ID_PAGE)
    is_bounded = field.name in HAS_STATISTICS
    end = _bounds(kind, is_bounded=is_bounded) + _rest(kind, is_nullable=field.nullable)
    return Column(field.name, kind, about, _numbers(kind, end), _BOUNDED_PAGE if is_bounded else _DATA_PAGES[kind])


@cache
def _numbers(kind: Kind, end: bytes) -> re.Pattern[bytes]:
    dictionary = rb"\x26(%b)" % _N if kind in ("string", "strings") else rb"()"
    return re.compile(rb"\x16(%b)\x16(%b)\x16(%b)\x26(%b)" % (_N, _N, _N, _N) + dictionary + end, re.DOTALL)


def _bounds(kind: Kind, *, is_bounded: bool) -> bytes:
    """Match the statistics of a column chunk and the beginning of the next field."""
    if is_bounded:
        return rb"(?:\x3c(%b)\x19|\x49)" % _WITHOUT_GROUPS
    return rb"()\x29" if kind in ("string", "strings") else rb"()\x49"


def _rest(kind: Kind, *, is_nullable: bool) -> bytes:
    """Match the rest of a column chunk: encoding and size statistics."""
    is_list, is_text = kind == "strings", kind in ("string", "strings")
    statistic = rb"\x15[\x00\x04]\x15[\x00\x0a\x10]\x15%b\x00" % _N
    repetitions = rb"\x26%b%b" % (_N, _N) if is_list else rb"\x06"
    levels = is_nullable + is_list
    definitions = bytes([(levels + 1) << 4 | 6]) if levels else b"\x06"
    histograms = repetitions + rb"\x19" + re.escape(definitions) + _N * (levels + 1 if levels else 0)
    sizes = (rb"\x16%b\x19" % _N if is_text else rb"\x29") + histograms
    return rb"([\x1c\x2c\x3c](?:%b){1,3})((?:\x3c%b\x00)?)\x00\x00" % (statistic, sizes)


RUN_ID_REST = re.compile(_rest("string", is_nullable=False), re.DOTALL)
"""The bytes after the statistics of `run_id`: encoding statistics, size statistics."""


@cache
def encoding_statistics(kind: Kind, dictionary: int, plain: int) -> bytes:
    """Return the encoding statistics of a column with this many data pages of either kind.

    The values of a page are in a dictionary or plain; pages of integers and booleans all count as `dictionary`.
    """
    if kind in ("string", "strings"):
        counts = [(2, 0, 1), (0, 0, plain), (0, 8, dictionary)]
    else:
        counts = [(0, 5, dictionary)] if kind == "integer" else [(0, 0, dictionary)]
    encoded = [
        b"\x15%b\x15%b\x15%b\x00" % (number(page), number(encoding), number(count))
        for page, encoding, count in counts
        if count
    ]
    return listed(len(encoded), 12) + b"".join(encoded)
