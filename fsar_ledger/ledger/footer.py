"""What the footer and the page headers of a Parquet file say, read without trust (Thrift compact protocol).

pyarrow ends the process where a footer contradicts itself in some ways (another type in a column than in the schema, for one),
so what a verifier looks at is read here, from bytes, before pyarrow looks.
"""

import msgspec

TYPES = ("BOOLEAN", "INT32", "INT64", "INT96", "FLOAT", "DOUBLE", "BYTE_ARRAY", "FIXED_LEN_BYTE_ARRAY")
_TRUE, _FALSE, _BYTE, _I16, _I32, _I64, _DOUBLE, _BINARY, _LIST, _SET, _MAP, _STRUCT = range(1, 13)
_NUMBERS = (_I16, _I32, _I64)
_DATA, _INDEX, _DICTIONARY, _DATA_V2 = range(4)
_MAX_DEPTH = 8

Struct = dict[int, "Value"]
Value = int | bytes | list["Value"] | Struct


class Column(msgspec.Struct, frozen=True):
    """One column of the only row group. Units: `at`, `stored_bytes` bytes. `nulls`, `least` and `most` are the statistics; None where there are none.

    `least` and `most` hold each bound once for each way in which it is stated, as the file holds it. `has_index` is true where a page index or a
    Bloom filter stands somewhere.
    """

    path: str
    type: str
    at: int
    stored_bytes: int
    nulls: int | None
    least: tuple[bytes, ...]
    most: tuple[bytes, ...]
    has_index: bool


class Page(msgspec.Struct, frozen=True):
    """One page. Units: `stored_bytes` and `unpacked_bytes` without the header, bytes."""

    values: int
    encoding: int
    stored_bytes: int
    unpacked_bytes: int
    is_data: bool


def read_footer(data: bytes) -> tuple[tuple[Column, ...], bool]:
    """The columns of the file with this footer, and whether it declares an order of its rows.

    Raises:
        ValueError or IndexError: It is none, has not exactly one row group, or leads elsewhere.
    """
    footer, _ = read_struct(data, 0)
    groups = _list(footer, 4)
    if len(groups) != 1:
        raise ValueError(f"{len(groups)} row groups, expected 1")
    group = _as_struct(groups[0])
    return tuple(map(_column, _list(group, 1))), bool(group.get(4))


def _column(chunk: Value) -> Column:
    chunk = _as_struct(chunk)
    if chunk.keys() & {1, 8, 9}:
        raise ValueError("a column in another file or encrypted, expected it in this one")
    about = _as_struct(chunk.get(3, {}))
    kind = count_in(about, 1)
    if kind >= len(TYPES):
        raise ValueError(f"a column of type {kind}, expected one of Parquet's")
    starts = [count_in(about, field) for field in (9, 11) if field in about]
    stated = _as_struct(about.get(12, {}))
    least, most = (tuple(value for field in fields if isinstance(value := stated.get(field), bytes)) for fields in ((6, 2), (5, 1)))
    return Column(
        ".".join(_text(part) for part in _list(about, 3)),
        TYPES[kind],
        min(starts, default=0),
        count_in(about, 7),
        count_in(stated, 3) if 3 in stated else None,
        least,
        most,
        bool(chunk.keys() & {4, 5, 6, 7} or about.keys() & {14, 15}),
    )


def read_page(data: bytes) -> tuple[Page, int]:
    """The page whose header these bytes begin with, and the length of the header. Raises: ValueError or IndexError if they are none."""
    header, length = read_struct(data, 0)
    kind, unpacked, stored = (count_in(header, field) for field in (1, 2, 3))
    fields = {_DATA: (5, 1, 2), _DICTIONARY: (7, 1, 2), _DATA_V2: (8, 1, 4)}.get(kind)
    if fields is None or fields[0] not in header:
        raise ValueError(f"a page of kind {kind}, expected data or a dictionary")
    part = _as_struct(header[fields[0]])
    return Page(count_in(part, fields[1]), count_in(part, fields[2]), stored, unpacked, kind != _DICTIONARY), length


def count_in(struct: Struct, field: int) -> int:
    """The field, which counts something. Raises: ValueError if it does not."""
    value = struct.get(field)
    if not isinstance(value, int) or value < 0:
        raise ValueError(f"{value!r:.40} as field {field}, expected a count")
    return value


def _as_struct(value: Value) -> Struct:
    if not isinstance(value, dict):
        raise ValueError(f"{value!r:.40}, expected a struct")
    return value


def _list(struct: Struct, field: int) -> list[Value]:
    value = struct.get(field)
    if not isinstance(value, list):
        raise ValueError(f"{value!r:.40} as field {field}, expected a list")
    return value


def _text(value: Value) -> str:
    if not isinstance(value, bytes):
        raise ValueError(f"{value!r:.40}, expected a name")
    return value.decode()


def read_struct(data: bytes, at: int, depth: int = 0) -> tuple[Struct, int]:
    """The struct that begins here, its fields by number, and where it ends. Raises: ValueError or IndexError if there is none."""
    if depth > _MAX_DEPTH:
        raise ValueError(f"more than {_MAX_DEPTH} structs in each other, expected fewer")
    found: Struct = {}
    field = 0
    while head := data[at]:
        at += 1
        step, kind = head >> 4, head & 15
        if step:
            field += step
        else:
            field, at = _zigzag(data, at)
        if kind in (_TRUE, _FALSE):
            found[field] = int(kind == _TRUE)
        else:
            found[field], at = _value(data, at, kind, depth)
    return found, at + 1


def _value(data: bytes, at: int, kind: int, depth: int) -> tuple[Value, int]:
    if kind in _NUMBERS:
        return _zigzag(data, at)
    if kind == _BINARY:
        length, at = _varint(data, at)
        if at + length > len(data):
            raise ValueError(f"{length} bytes, expected at most the {len(data) - at} that are left")
        return data[at : at + length], at + length
    if kind == _STRUCT:
        return read_struct(data, at, depth + 1)
    if kind == _LIST:
        return _values(data, at, depth)
    if kind in (_BYTE, _TRUE, _FALSE):
        return data[at], at + 1
    raise ValueError(f"a field of type {kind}, expected numbers, bytes, lists and structs")


def _values(data: bytes, at: int, depth: int) -> tuple[list[Value], int]:
    size, kind = data[at] >> 4, data[at] & 15
    at += 1
    if size == 15:
        size, at = _varint(data, at)
    if size > len(data) - at:  # each value takes a byte at least
        raise ValueError(f"a list of {size}, expected at most the {len(data) - at} bytes that are left")
    found: list[Value] = []
    for _ in range(size):
        value, at = _value(data, at, kind, depth + 1)
        found.append(value)
    return found, at


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while (byte := data[at]) & 0x80:
        value |= (byte & 0x7F) << shift
        shift, at = shift + 7, at + 1
        if shift > 63:
            raise ValueError("a number of more than 64 bits, expected a shorter one")
    return value | byte << shift, at + 1


def _zigzag(data: bytes, at: int) -> tuple[int, int]:
    value, at = _varint(data, at)
    return value >> 1 ^ -(value & 1), at
