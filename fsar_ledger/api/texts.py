"""Arrow columns as text, a column at a time: what each value is in CSV and in JSON.

A column whose text nothing would change is taken as it is; of others, each distinct value goes once through the
function for a single value (`fields.field_text`, `printable`). So the text of a column is to the byte that of its
values.
"""

from collections.abc import Callable
from typing import Any

import msgspec
import pyarrow as pa
import pyarrow.compute as pc

from fsar_ledger import printable
from fsar_ledger.errors import QueryFailed

from .fields import encodable, field_text

_SEEN = bytes(range(0x20, 0x7F))
_JSON_PLAIN = bytes(set(_SEEN) - set(b'"\\'))
_CSV_PLAIN = bytes(set(_SEEN) - set(b"\\"))
_CSV_BARE = bytes(set(range(256)) - set(b',"\r\n'))
_FORMULA = r"^'*[ ]*[=+\-@]"
"""What may be a formula in text of visible ASCII."""
_QUOTED = '[,"\r\n]'
_SIMPLE = (pa.types.is_string, pa.types.is_integer, pa.types.is_boolean, pa.types.is_floating)
_LEAST, _MOST = 1e-4, 1e16
"""From the one and below the other, numbers have no exponent in CSV, nor in JSON."""

Encode = Callable[[Any], str]


def csv_lines(batch: pa.RecordBatch, *, raw: bool = False) -> str:
    """Return the rows as lines of comma-separated values, as `fields.csv_text` makes them. Raises: as `json_lines`."""
    if not batch.num_columns:
        return "\n" * int(batch.num_rows)
    columns = [csv_texts(column, raw=raw) for column in batch.columns]
    lines = pc.binary_join_element_wise(*map(_quoted_if_needed, columns), ",")
    if batch.num_columns == 1:
        lines = pc.if_else(pc.equal(lines, ""), '""', lines)
    if raw or not all(map(_is_bare, columns)):
        # A bare CR ends a row for some readers.
        broken = pc.match_substring(lines, "\r")
        if pc.any(broken).as_py():
            lines = pc.if_else(broken, pc.binary_join_element_wise(*map(_quoted, columns), ","), lines)
    return _joined(pc.binary_join_element_wise(lines, "", "\n"))


def json_lines(batch: pa.RecordBatch) -> str:
    """Return a JSON object for each row, one a line, in ASCII.

    Raises:
        QueryFailed: Python cannot hold a date or time.
    """
    return _joined(_objects(batch, '{"', '":', ',"', "}\n"))


def json_items(batch: pa.RecordBatch) -> str:
    """Return the rows as items of an indented list, a comma and a line feed after each. Raises: as `json_lines`."""
    return _joined(_objects(batch, '    {\n      "', '": ', ',\n      "', "\n    },\n", indent=6))


def csv_texts(column: pa.Array, *, raw: bool = False) -> pa.Array:
    """Return each value as `field_text` gives it, not yet quoted; NULL is the empty text."""
    kind = column.type
    if pa.types.is_string(kind):
        return (column if raw else harmless(column)).fill_null("")
    if pa.types.is_floating(kind):
        return _float_fields(column)
    if pa.types.is_list(kind) and _is_simple(kind.value_type):
        texts = _list_texts(column, "", in_ascii=not raw)
        return pc.if_else(column.is_valid(), texts, "")
    return _texts(column, lambda value: field_text(value, raw=raw), "")


def harmless(column: pa.Array) -> pa.Array:
    """Return each text as `printable.field` makes it."""
    other = pc.match_substring_regex(column, _FORMULA)
    if not _holds_only(column, _CSV_PLAIN):
        other = pc.or_kleene(other, pc.match_substring_regex(column, r"[^ -\[\]-~]"))
    return _replaced(column, other, column, printable.field)


def json_texts(column: pa.Array, indent: int | None = None, *, in_ascii: bool = True) -> pa.Array:
    """Return each value as JSON; NULL is `null`. With `indent`, lists that lie so deep take a line for each item."""

    def encode(value: object) -> str:
        data = msgspec.json.encode(encodable(msgspec.to_builtins(value)))
        if indent is not None:
            data = msgspec.json.format(data, indent=2).replace(b"\n", b"\n" + b" " * indent)
        return printable.ascii_json(data.decode()) if in_ascii else data.decode()

    kind = column.type
    if pa.types.is_string(kind):
        plain = pc.binary_join_element_wise('"', column, '"', "")
        if _holds_only(column, _JSON_PLAIN):
            return plain.fill_null("null")
        found = pc.match_substring_regex(column, r"[^ !#-\[\]-~]")
        return _replaced(plain, found, column, encode).fill_null("null")
    if pa.types.is_floating(kind):
        return _float_texts(column)
    if pa.types.is_list(kind) and _is_simple(kind.value_type):
        between = "" if indent is None else "\n" + " " * (indent + 2)
        texts = _list_texts(column, between, between[:-2], in_ascii=in_ascii)
        return pc.if_else(column.is_valid(), texts, "null")
    return _texts(column, encode, "null")


def _objects(
    batch: pa.RecordBatch, before: str, colon: str, comma: str, after: str, indent: int | None = None
) -> pa.Array:
    """Return each row as the text of an object; each name lies between `before` or `comma`, and `colon`."""
    parts: list[pa.Array | str] = []
    for at, (name, column) in enumerate(zip(batch.schema.names, batch.columns, strict=True)):
        quoted = printable.ascii_json(msgspec.json.encode(name).decode())
        parts += [f"{comma if at else before}{quoted[1:-1]}{colon}", json_texts(column, indent)]
    return pc.binary_join_element_wise(*parts, after, "")


def _texts(column: pa.Array, encode: Encode, null: str) -> pa.Array:
    """Return the texts of values of any type."""
    kind = column.type
    if pa.types.is_integer(kind) or pa.types.is_boolean(kind):
        return pc.cast(column, pa.string()).fill_null(null)
    if pa.types.is_decimal(kind) and kind.scale == 0:
        return pa.array([null if one is None else str(int(one)) for one in _values(column)], pa.string())
    if pa.types.is_nested(kind) or pa.types.is_interval(kind) or pa.types.is_null(kind):
        return pa.array([null if one is None else encode(one) for one in _values(column)], pa.string())
    coded = column.dictionary_encode()
    texts = [null if one is None else encode(one) for one in _values(coded.dictionary)]
    return pa.array(texts, pa.string()).take(coded.indices).fill_null(null)


def _values(column: pa.Array) -> list[Any]:
    try:
        return list(column.to_pylist())
    except (OverflowError, ValueError) as error:
        raise QueryFailed(
            "the answer: found a date or time that it cannot show, expected years 1 to 9999 and whole microseconds; "
            "make it text, as in CAST(... AS VARCHAR)"
        ) from error


def _float_texts(column: pa.Array) -> pa.Array:
    """Return floats as JSON, which has no infinity: it is `null`, as is NaN."""
    if not len(column):
        return pa.array([], pa.string())
    return pa.array(msgspec.json.encode(column.to_pylist())[1:-1].decode().split(","), pa.string())


def _float_fields(column: pa.Array) -> pa.Array:
    """Return floats as Python writes them."""
    size = pc.abs(column)
    is_alike = pc.or_kleene(pc.equal(size, 0.0), pc.and_kleene(pc.greater_equal(size, _LEAST), pc.less(size, _MOST)))
    texts = _replaced(_float_texts(column), pc.invert(is_alike), column, repr)
    return pc.if_else(column.is_valid(), texts, "")


def _list_texts(column: pa.Array, before: str, after: str = "", *, in_ascii: bool) -> pa.Array:
    """Return lists as JSON, with `before` each item and `after` the last."""
    offsets = pa.array(column.offsets.to_numpy() - (column.offsets[0].as_py() if len(column) else 0), pa.int32())
    items = json_texts(column.flatten() if not column.null_count else _items(column), in_ascii=in_ascii)
    inner = pc.binary_join(pa.ListArray.from_arrays(offsets, items), f",{before}")
    full = pc.binary_join_element_wise(f"[{before}", inner, f"{after}]", "")
    return pc.if_else(pc.equal(pc.list_value_length(pa.ListArray.from_arrays(offsets, items)), 0), "[]", full)


def _items(column: pa.Array) -> pa.Array:
    """Return all items that the offsets span, those of NULL too, which `flatten` leaves out."""
    first, last = column.offsets[0].as_py(), column.offsets[-1].as_py()
    return column.values.slice(first, last - first)


def _is_simple(kind: pa.DataType) -> bool:
    return any(is_kind(kind) for is_kind in _SIMPLE)


def _replaced(texts: pa.Array, where: pa.Array, column: pa.Array, encode: Encode) -> pa.Array:
    """Return the texts, and at these places what `encode` makes of the value; each distinct one is encoded once."""
    if not pc.any(where).as_py():
        return texts
    coded = column.filter(where).dictionary_encode()
    made = pa.array([encode(value) for value in coded.dictionary.to_pylist()], pa.string()).take(coded.indices)
    return pc.replace_with_mask(texts, where.fill_null(False), made)


def _quoted_if_needed(texts: pa.Array) -> pa.Array:
    if _is_bare(texts):
        return texts
    return pc.if_else(pc.match_substring_regex(texts, _QUOTED), _quoted(texts), texts)


def _quoted(texts: pa.Array) -> pa.Array:
    return pc.binary_join_element_wise('"', pc.replace_substring(texts, '"', '""'), '"', "")


def _is_bare(texts: pa.Array) -> bool:
    return _holds_only(texts, _CSV_BARE)


def _holds_only(texts: pa.Array, characters: bytes) -> bool:
    """Tell whether the texts hold none but these bytes; one look at all of them together."""
    return not bytes(_content(texts)).translate(None, characters)


def _content(texts: pa.Array) -> memoryview:
    """Return the bytes of all texts, one after the other."""
    _, offsets, data = texts.buffers()
    if data is None or not len(texts):
        return memoryview(b"")
    ends = memoryview(offsets).cast("i")
    return memoryview(data)[ends[texts.offset] : ends[texts.offset + len(texts)]]


def _joined(texts: pa.Array) -> str:
    return str(_content(texts), "utf-8")
