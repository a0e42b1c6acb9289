"""What a forger does to a Parquet file: its footer and page headers as trees that can be altered and written again (Thrift compact protocol)."""

from collections.abc import Callable
from typing import Any

TRUE, FALSE, BYTE, I16, I32, I64, DOUBLE, BINARY, LIST, SET, MAP, STRUCT = range(1, 13)
Field = list[Any]
"""Number, type and value: an int, bytes, a Tree, or of a list the type of its items and the items."""
Tree = list[Field]
"""The fields of a struct, as they are written."""


def read_tree(data: bytes, at: int = 0) -> tuple[Tree, int]:
    """The struct that begins here, and where it ends."""
    found: Tree = []
    number = 0
    while head := data[at]:
        at += 1
        number += head >> 4
        value, at = _read(data, at, head & 15)
        found.append([number, head & 15, value])
    return found, at + 1


def _read(data: bytes, at: int, kind: int) -> tuple[Any, int]:
    if kind in (TRUE, FALSE):
        return kind == TRUE, at
    if kind == STRUCT:
        return read_tree(data, at)
    if kind == LIST:
        size, kind = data[at] >> 4, data[at] & 15
        size, at = _varint(data, at + 1) if size == 15 else (size, at + 1)
        items = []
        for _ in range(size):
            item, at = _read(data, at, kind)
            items.append(item)
        return (kind, items), at
    value, at = _varint(data, at)
    return (data[at : at + value], at + value) if kind == BINARY else (value >> 1 ^ -(value & 1), at)


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while data[at] > 127:
        value, shift, at = value | (data[at] & 127) << shift, shift + 7, at + 1
    return value | data[at] << shift, at + 1


def written(tree: Tree) -> bytes:
    """The bytes of a struct; fields out of order are written in the long form."""
    found, before = b"", 0
    for number, kind, value in tree:
        kind = (TRUE if value else FALSE) if kind in (TRUE, FALSE) else kind
        step = number - before
        found += bytes([step << 4 | kind]) if 0 < step < 16 else bytes([kind]) + number_bytes(number)
        found += b"" if kind in (TRUE, FALSE) else _written(kind, value)
        before = number
    return found + b"\x00"


def _written(kind: int, value: Any) -> bytes:
    if kind == STRUCT:
        return written(value)
    if kind == LIST:
        kind, items = value
        head = bytes([len(items) << 4 | kind]) if len(items) < 15 else bytes([0xF0 | kind]) + _varint_bytes(len(items))
        return head + b"".join(_written(kind, item) for item in items)
    return _varint_bytes(len(value)) + value if kind == BINARY else number_bytes(value)


def number_bytes(value: int) -> bytes:
    return _varint_bytes(value << 1 ^ value >> 63)


def _varint_bytes(value: int) -> bytes:
    found = b""
    while value > 127:
        found, value = found + bytes([value & 127 | 128]), value >> 7
    return found + bytes([value])


def field(tree: Tree, number: int) -> Field:
    return next(each for each in tree if each[0] == number)


def value(tree: Tree, *numbers: int) -> Any:
    """The value that is reached by field numbers, and places in lists."""
    found: Any = tree
    for number in numbers:
        found = found[1][number] if isinstance(found, tuple) else field(found, number)[2]
    return found


def put(tree: Tree, number: int, kind: int, new: Any) -> None:
    """The struct has this field, in its order, instead of what it had there."""
    tree[:] = sorted([*(each for each in tree if each[0] != number), [number, kind, new]], key=lambda each: int(each[0]))


def footer_of(data: bytes) -> tuple[bytes, Tree]:
    """What is before the footer, and the footer."""
    start = len(data) - 8 - int.from_bytes(data[-8:-4], "little")
    return data[:start], read_tree(data, start)[0]


def with_footer(body: bytes, footer: Tree) -> bytes:
    """The file with this footer."""
    end = written(footer)
    return body + end + len(end).to_bytes(4, "little") + b"PAR1"


def chunk(footer: Tree, column: int) -> Tree:
    """The column chunk."""
    found: Tree = value(footer, 4, 0, 1, column)
    return found


def about(footer: Tree, column: int) -> Tree:
    """The metadata of a column chunk."""
    found: Tree = value(chunk(footer, column), 3)
    return found


def start_of(footer: Tree, column: int) -> int:
    """Where the pages of a column begin."""
    return min(int(each[2]) for each in about(footer, column) if each[0] in (9, 11))


def moved(footer: Tree, since: int, by: int) -> None:
    """Whatever lies at this byte or behind it lies so many bytes further."""
    for column in range(len(value(footer, 4, 0, 1)[1])):
        for each in about(footer, column):
            if each[0] in (9, 11) and each[2] >= since:
                each[2] += by


def altered_page(data: bytes, column: int, page: int, alter: Callable[[Tree], None]) -> bytes:
    """The file with another header for that page of the column; offsets and sizes are made to fit."""
    body, footer = footer_of(data)
    meta = about(footer, column)
    at = start_of(footer, column)
    for _ in range(page):
        header, start = read_tree(body, at)
        at = start + value(header, 3)
    header, start = read_tree(body, at)
    alter(header)
    new = written(header)
    grown = len(new) - (start - at)
    moved(footer, at + 1, grown)
    field(meta, 6)[2] += grown
    field(meta, 7)[2] += grown
    field(value(footer, 4, 0), 2)[2] += grown
    field(value(footer, 4, 0), 6)[2] += grown
    return with_footer(body[:at] + new + body[start:], footer)
