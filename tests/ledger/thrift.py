"""Thrift's compact protocol, read and written: a forger can say anything, in any order, as often as wanted."""

from typing import NamedTuple, TypeAlias

TRUE, FALSE, BYTE, I16, I32, I64, DOUBLE, BINARY, LIST, SET, MAP, STRUCT = range(1, 13)


class Field(NamedTuple):
    """One field. A number is an int, text is bytes, a struct a list of fields, and a list its kind with its values."""

    number: int
    kind: int
    value: "Value"


class Listed(NamedTuple):
    """A list of values of one kind."""

    kind: int
    values: "list[Value]"


class Raw(NamedTuple):
    """A value given as its bytes, right or wrong."""

    data: bytes


Struct: TypeAlias = list[Field]
Value: TypeAlias = "int | bytes | Struct | Listed | Raw"


def read(data: bytes, at: int = 0) -> tuple[Struct, int]:
    """Read the struct that begins here; return it and where it ends."""
    found: Struct = []
    number = 0
    while head := data[at]:
        kind, step = head & 15, head >> 4
        at += 1
        if step:
            number += step
        else:
            number, at = _zigzag(data, at)
        value: Value = int(kind == TRUE)
        if kind not in (TRUE, FALSE):
            value, at = _value(data, at, kind)
        found.append(Field(number, kind, value))
    return found, at + 1


def _value(data: bytes, at: int, kind: int) -> tuple[Value, int]:
    if kind in (I16, I32, I64):
        return _zigzag(data, at)
    if kind == BINARY:
        length, at = _varint(data, at)
        return data[at : at + length], at + length
    if kind == STRUCT:
        return read(data, at)
    if kind == LIST:
        count, inner = data[at] >> 4, data[at] & 15
        at += 1
        if count == 15:
            count, at = _varint(data, at)
        values = []
        for _ in range(count):
            value, at = _value(data, at, inner)
            values.append(value)
        return Listed(inner, values), at
    return data[at], at + 1


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while data[at] & 0x80:
        value |= (data[at] & 0x7F) << shift
        shift, at = shift + 7, at + 1
    return value | data[at] << shift, at + 1


def _zigzag(data: bytes, at: int) -> tuple[int, int]:
    value, at = _varint(data, at)
    return value >> 1 ^ -(value & 1), at


def write(struct: Struct) -> bytes:
    """Write the struct as bytes, its fields in this order, repeated as they are in it."""
    found, last = b"", 0
    for number, kind, value in struct:
        if kind in (TRUE, FALSE):
            kind = TRUE if value else FALSE
        step = number - last
        found += bytes([step << 4 | kind]) if 0 < step < 16 else bytes([kind]) + number_bytes(number)
        found += b"" if kind in (TRUE, FALSE) else _bytes(kind, value)
        last = number
    return found + b"\0"


def _bytes(kind: int, value: Value) -> bytes:
    match value:
        case Raw(data):
            return data
        case Listed(inner, values):
            head = (
                bytes([len(values) << 4 | inner]) if len(values) < 15 else bytes([0xF0 | inner]) + varint(len(values))
            )
            return head + b"".join(_bytes(inner, one) for one in values)
        case bytes():
            return varint(len(value)) + value
        case int():
            return bytes([value & 0xFF]) if kind in (TRUE, FALSE, BYTE) else number_bytes(value)
        case _:
            return write(value)


def varint(value: int) -> bytes:
    """Encode a number that is not negative."""
    found = bytearray()
    while value > 0x7F:
        found.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*found, value])


def number_bytes(value: int) -> bytes:
    """Encode any number, zigzag."""
    return varint(value << 1 if value >= 0 else ~(value << 1))


def field(struct: Struct, number: int) -> "Value":
    """Return the value of the first field with this number."""
    return next(one.value for one in struct if one.number == number)


def has(struct: Struct, number: int) -> bool:
    """Return whether there is such a field."""
    return any(one.number == number for one in struct)


def put(struct: Struct, number: int, value: Value, kind: int | None = None) -> None:
    """Set the field to this value. A missing one is added in its place, with the given kind."""
    for at, one in enumerate(struct):
        if one.number == number:
            struct[at] = Field(number, one.kind if kind is None else kind, value)
            return
    assert kind is not None, f"no field {number}"
    at = next((at for at, one in enumerate(struct) if one.number > number), len(struct))
    struct.insert(at, Field(number, kind, value))
