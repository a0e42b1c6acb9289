"""Explanations, for messages, of why a footer or a page header is not one of ours.

What `grammar` did not match is read again, field by field (Thrift compact protocol). Nothing is decided here: a file
that gets this far is refused in any case.
"""

from collections.abc import Iterator

import pyarrow as pa

from fsar_ledger.ledger.rows.schema import COLUMNS, Kind

TYPES = ("BOOLEAN", "INT32", "INT64", "INT96", "FLOAT", "DOUBLE", "BYTE_ARRAY", "FIXED_LEN_BYTE_ARRAY")
_TRUE, _FALSE, _BYTE, _I16, _I32, _I64, _DOUBLE, _BINARY, _LIST, _SET, _MAP, _STRUCT = range(1, 13)
_NUMBERS = (_I16, _I32, _I64)
_MAX_DEPTH = 8
_MAX_HEADER_BYTES = 1 << 14
_OTHERWISE = "fields in another order, of another kind, or with other values than a segment has"
_FOOTER = {5: "key-value metadata", 8: "an encryption", 9: "an encryption"}
_GROUP = {4: "a declared order of rows"}
_CHUNK = {
    1: "a column in another file",
    **dict.fromkeys((4, 5, 6, 7), "an index or a Bloom filter"),
    **dict.fromkeys((8, 9), "a column that is encrypted"),
}
_ABOUT = {8: "key-value metadata", 10: "an index page", **dict.fromkeys((14, 15), "an index or a Bloom filter")}

Struct = dict[int, "Value"]
Value = int | bytes | list["Value"] | Struct

_ENCODINGS: dict[Kind, list[Value]] = {"string": [0, 3, 8], "strings": [0, 3, 8], "integer": [3, 5], "boolean": [3, 0]}


def explain_footer(data: bytes, schema: pa.Schema) -> str:
    """Return why these bytes are not the footer of a segment with these columns."""
    try:
        footer, end = read_struct(data, 0)
        found = next(_faults(footer, schema), None)
    except IndexError:
        return "the footer: half of it, expected all"
    except (ValueError, RecursionError) as error:
        return f"the footer: {error}"
    if found is None:
        found = (
            f"{len(data) - end} bytes after its end, expected none"
            if end != len(data)
            else f"{_OTHERWISE}, expected those of its format"
        )
    return f"the footer: {found}"


def explain_page(data: bytes, at: int) -> str:
    """Return why no page of ours begins here."""
    try:
        header, _ = read_struct(data[at : at + _MAX_HEADER_BYTES], 0)
        for field in (2, 3):
            _count(header, field)
        about = next((_struct(header[field]) for field in (5, 7, 8) if field in header), None)
        if about is None or 8 in header:
            return f"a page of kind {header.get(1)!r:.40}, expected data (0) or a dictionary (2)"
        _count(about, 1)
        encoding = about.get(2)
    except IndexError:
        return f"half a page header at byte {at}, expected all of it"
    except (ValueError, RecursionError) as error:
        return f"a page at byte {at}: {error}"
    if 4 not in header:
        return f"a page at byte {at} without a checksum, expected one"
    return (
        f"a page in encoding {encoding!r:.40} with {_OTHERWISE} (byte {at}), expected PLAIN, RLE_DICTIONARY for "
        "text, DELTA_BINARY_PACKED for integers"
    )


def _faults(footer: Struct, schema: pa.Schema) -> Iterator[str]:
    """Yield what is wrong with a footer; nothing if that is not found here."""
    yield from _extra(footer, {1, 2, 3, 4, 6, 7}, _FOOTER)
    groups = _list(footer, 4)
    if len(groups) != 1:
        yield f"{len(groups)} row groups, expected 1"
    group = _struct(groups[0])
    yield from _extra(group, {1, 2, 3, 5, 6}, _GROUP)
    chunks = [_struct(chunk) for chunk in _list(group, 1)]
    names = [_path(chunk) for chunk in chunks]
    for at in range(max(len(chunks), len(schema))):
        found, expected = names[at] if at < len(names) else None, _expected(schema, at)
        if found != expected:
            yield f"column {at} as {found}, expected {expected} as in the columns of a release"
    for (name, _), chunk in zip(names, chunks, strict=True):
        yield from _faults_of_column(name, chunk, schema)


def _faults_of_column(name: str, chunk: Struct, schema: pa.Schema) -> Iterator[str]:
    about = _struct(chunk.get(3, {}))
    yield from _extra(chunk, {2, 3}, _CHUNK, f" of column {name}")
    yield from _extra(about, {1, 2, 3, 4, 5, 6, 7, 9, 11, 12, 13, 16}, _ABOUT, f" of column {name}")
    for field in (4, 5, 6, 7, 9):
        _count(about, field)
    if about[4] != 6:
        yield f"column {name} in codec {about[4]!r}, expected 6 (zstd)"
    encodings = _ENCODINGS[COLUMNS[name.partition(".")[0]]]
    if _list(about, 2) != encodings:
        yield f"column {name} in encodings {about[2]!r:.40}, expected {encodings}"
    if 12 in about and name not in schema.names[:3]:
        yield f"statistics of column {name}, expected none but of {', '.join(schema.names[:3])}"
    if nulls := _struct(about.get(12, {})).get(3):
        yield f"statistics that say {nulls!r:.40} NULL of column {name}, expected none"


def _path(chunk: Struct) -> tuple[str, str]:
    """Return the path and the type of a column."""
    about = _struct(chunk.get(3, {}))
    kind = _count(about, 1)
    return ".".join(_text(part) for part in _list(about, 3)), TYPES[kind] if kind < len(TYPES) else f"type {kind}"


def _expected(schema: pa.Schema, at: int) -> tuple[str, str] | None:
    if at >= len(schema):
        return None
    name = schema.names[at]
    return {
        "string": (name, TYPES[6]),
        "strings": (f"{name}.list.element", TYPES[6]),
        "integer": (name, TYPES[2]),
        "boolean": (name, TYPES[0]),
    }[COLUMNS[name]]


def _extra(struct: Struct, known: set[int], names: dict[int, str], where: str = "") -> Iterator[str]:
    for field in sorted(struct.keys() - known):
        yield f"{names.get(field, f'field {field}')}{where}, expected none: readers may read other rows by it"


def _count(struct: Struct, field: int) -> int:
    """Return the field as a count. Raises: ValueError if it is not one."""
    value = struct.get(field)
    if not isinstance(value, int) or value < 0:
        raise ValueError(f"{value!r:.40} as field {field}, expected a count")
    return value


def _struct(value: Value) -> Struct:
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
    """Read the struct that begins here; return its fields by number, and where it ends.

    Raises: ValueError or IndexError if there is none.
    """
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
        if field in found:
            raise ValueError(f"field {field} twice in one struct, expected it once")
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
        return _values(data, at, depth + 1)
    if kind in (_BYTE, _TRUE, _FALSE):
        return data[at], at + 1
    raise ValueError(f"a field of type {kind}, expected numbers, bytes, lists and structs")


def _values(data: bytes, at: int, depth: int) -> tuple[list[Value], int]:
    if depth > _MAX_DEPTH:
        raise ValueError(f"more than {_MAX_DEPTH} structs in each other, expected fewer")
    size, kind = data[at] >> 4, data[at] & 15
    at += 1
    if size == 15:
        size, at = _varint(data, at)
    if size > len(data) - at:  # each value takes at least a byte
        raise ValueError(f"a list of {size}, expected at most the {len(data) - at} bytes that are left")
    found: list[Value] = []
    for _ in range(size):
        value, at = _value(data, at, kind, depth)
        found.append(value)
    return found, at


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while (byte := data[at]) & 0x80:
        value |= (byte & 0x7F) << shift
        shift, at = shift + 7, at + 1
        if shift > 63:
            raise ValueError("a number of more than 64 bits, expected a shorter one")
    if shift and not byte:
        raise ValueError("a number written longer than it need be, expected it as short as it can be")
    return value | byte << shift, at + 1


def _zigzag(data: bytes, at: int) -> tuple[int, int]:
    value, at = _varint(data, at)
    return value >> 1 ^ -(value & 1), at
