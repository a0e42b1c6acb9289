"""Rows as text: the values of Arrow columns in CSV and JSON, a column at a time.

Text from a ledger is escaped as it becomes a field of CSV (`printable`), unless raw.

A column whose text needs no change is used as it is; of others, each distinct value is converted once by the function
for a single value (`field_text`, `printable`). So the text of a column is byte for byte that of its values.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from functools import reduce
from typing import Any, TypeAlias, TypeVar

import msgspec
import pyarrow as pa
import pyarrow.compute as pc

from fsar_ledger.base import printable
from fsar_ledger.base.errors import QueryFailed

_SEEN = bytes(range(0x20, 0x7F))
_JSON_PLAIN = bytes(set(_SEEN) - set(b'"\\'))
_CSV_PLAIN = bytes(set(_SEEN) - set(b"\\"))
_FORMULA = r"^'*[ ]*[=+\-@]"
"""What may be a formula in text of visible ASCII."""
_NOT_CSV_PLAIN = r"[^ -\[\]-~]"
_QUOTED = (",", '"', "\r", "\n")
_SIMPLE = (pa.types.is_string, pa.types.is_integer, pa.types.is_boolean, pa.types.is_floating)
_LEAST, _MOST = 1e-4, 1e16
"""Numbers from the first and below the second have no exponent in CSV, nor in JSON."""

AT_ONCE = 2
"""Batches that are converted at once; each takes several times its bytes."""

Converted = TypeVar("Converted")
Encode = Callable[[Any], str]
Texts: TypeAlias = "pa.Array | str"
"""The text of each row, or the one that all rows have."""


def in_turn(convert: Callable[[pa.RecordBatch], Converted], batches: Iterable[pa.RecordBatch]) -> Iterator[Converted]:
    """Yield each batch converted, in order; the next one is converted meanwhile.

    Raises: As `convert`, and as `batches`.
    """
    with ThreadPoolExecutor(AT_ONCE) as pool:  # Arrow's kernels release the interpreter lock
        waiting: deque[Future[Converted]] = deque()
        for batch in batches:
            waiting.append(pool.submit(convert, batch))
            if len(waiting) > AT_ONCE:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()


def csv_header(columns: Sequence[str], *, raw: bool = False) -> str:
    """Return the line of CSV that names the columns."""
    return csv_lines(pa.RecordBatch.from_pydict({f"{index}": [name] for index, name in enumerate(columns)}), raw=raw)


def csv_lines(batch: pa.RecordBatch, *, raw: bool = False) -> str:
    """Return the rows as lines of comma-separated values, as `csv_texts` makes them. Raises: as `json_lines`."""
    if not batch.num_columns:
        return "\n" * int(batch.num_rows)
    lines = _side_by_side([_csv_field(column, raw=raw) for column in batch.columns], ",", len(batch))
    if batch.num_columns == 1:
        lines = pc.if_else(pc.equal(lines, ""), '""', lines)
    if raw and pc.any(broken := pc.match_substring(lines, "\r")).as_py():
        # A bare CR ends a row for some readers.
        quoted = [_quoted(csv_texts(column, raw=raw)) for column in batch.columns]
        lines = pc.if_else(broken, _side_by_side(quoted, ",", len(batch)), lines)
    return _joined(pc.binary_join_element_wise(lines, "", "\n"))


def json_lines(batch: pa.RecordBatch, before: str = "", after: str = "\n") -> str:
    """Return a JSON object for each row, in ASCII; each has no line feed in it, and lies between `before` and `after`.

    Raises:
        QueryFailed: Python cannot hold a date or time.
    """
    parts: list[Texts] = []
    for name, column in zip(batch.schema.names, batch.columns, strict=True):
        quoted = printable.ascii_json(msgspec.json.encode(name).decode())
        parts += [
            f"{',' if parts else before + '{'}{quoted}:",
            "null" if column.null_count == len(column) else json_texts(column),
        ]
    parts += ["}" + after] if parts else [before + "{}" + after]
    return _joined(_side_by_side(parts, "", len(batch)))


def csv_texts(column: pa.Array, *, raw: bool) -> pa.Array:
    """Return each value as `field_text` gives it, not yet quoted; NULL is the empty text."""
    kind = column.type
    if pa.types.is_string(kind):
        return (column if raw else harmless(column)).fill_null("")
    if pa.types.is_floating(kind):
        return _float_fields(column)
    if _is_simple_list(kind):
        return pc.if_else(column.is_valid(), json_texts(column, in_ascii=not raw), "")
    return _texts(column, lambda value: field_text(value, raw=raw), "")


def harmless(column: pa.Array) -> pa.Array:
    """Return each text as `printable.field` makes it."""
    pattern = _FORMULA if _holds_only(column, _CSV_PLAIN) else f"{_NOT_CSV_PLAIN}|{_FORMULA}"
    return _replaced(column, pc.match_substring_regex(column, pattern), column, printable.field)


def json_texts(column: pa.Array, *, in_ascii: bool = True, quote: str = '"') -> pa.Array:
    """Return each value as JSON; NULL is `null`. `quote` replaces each quotation mark of the JSON."""

    def encode(value: object) -> str:
        text = msgspec.json.encode(encodable(msgspec.to_builtins(value))).decode()
        return (printable.ascii_json(text) if in_ascii else text).replace('"', quote)

    kind = column.type
    if pa.types.is_string(kind):
        plain = pc.binary_join_element_wise(quote, column, quote, "")
        if not _holds_only(column, _JSON_PLAIN):
            plain = _replaced(plain, pc.match_substring_regex(column, r"[^ !#-\[\]-~]"), column, encode)
        return plain.fill_null("null")
    if pa.types.is_floating(kind):
        return _float_texts(column)
    if _is_simple_list(kind):
        texts = pc.binary_join_element_wise("[", _items(column, in_ascii=in_ascii, quote=quote), "]", "")
        return pc.if_else(column.is_valid(), texts, "null") if column.null_count else texts
    return _texts(column, encode, "null")


def _csv_field(column: pa.Array, *, raw: bool) -> Texts:
    """Return each value as a field, quoted where that is needed."""
    if column.null_count == len(column):
        return ""
    if not _is_simple_list(column.type):
        return _quoted_if_needed(csv_texts(column, raw=raw))
    items = _items(column, in_ascii=not raw, quote='""')
    needed = _is_any_in(items, (",", '"'))
    texts = pc.binary_join_element_wise('"[', items, ']"', "")
    if not pc.all(needed).as_py():
        texts = pc.if_else(needed, texts, pc.binary_join_element_wise("[", items, "]", ""))
    return pc.if_else(column.is_valid(), texts, "") if column.null_count else texts


def _side_by_side(parts: Sequence[Texts], between: str, count: int) -> pa.Array:
    """Return the parts of each of `count` rows, joined by `between`; parts that all rows share are joined once."""
    joined: list[Texts] = []
    for part in parts:
        if joined and isinstance(part, str) and isinstance(joined[-1], str):
            joined[-1] += between + part
        else:
            joined.append(part)
    if len(joined) == 1 and isinstance(joined[0], str):
        return pa.repeat(joined[0], count)
    return pc.binary_join_element_wise(*joined, between)


def _texts(column: pa.Array, encode: Encode, null: str) -> pa.Array:
    kind = column.type
    if pa.types.is_integer(kind) or pa.types.is_boolean(kind):
        return pc.cast(column, pa.string()).fill_null(null)
    if pa.types.is_decimal(kind) and kind.scale == 0:
        return pa.array([null if value is None else str(int(value)) for value in _values(column)], pa.string())
    if pa.types.is_nested(kind) or pa.types.is_interval(kind) or pa.types.is_null(kind):
        return pa.array([null if value is None else encode(value) for value in _values(column)], pa.string())
    coded = column.dictionary_encode()
    texts = [null if value is None else encode(value) for value in _values(coded.dictionary)]
    return pa.array(texts, pa.string()).take(coded.indices).fill_null(null)


def _values(column: pa.Array) -> list[Any]:
    with as_python():
        return list(column.to_pylist())


def _float_texts(column: pa.Array) -> pa.Array:
    """Return floats as JSON, which has no infinity: it is `null`, as is NaN."""
    if not len(column):
        return pa.array([], pa.string())
    return pa.array(msgspec.json.encode(column.to_pylist())[1:-1].decode().split(","), pa.string())


def _float_fields(column: pa.Array) -> pa.Array:
    size = pc.abs(column)
    is_alike = pc.or_kleene(pc.equal(size, 0.0), pc.and_kleene(pc.greater_equal(size, _LEAST), pc.less(size, _MOST)))
    texts = _replaced(_float_texts(column), pc.invert(is_alike), column, repr)
    return pc.if_else(column.is_valid(), texts, "")


def _items(column: pa.Array, *, in_ascii: bool = True, quote: str = '"') -> pa.Array:
    """Return the items of each list as JSON, with commas between them."""
    first, last = (column.offsets[index].as_py() for index in (0, -1)) if len(column) else (0, 0)
    # `flatten` would leave out those that a NULL spans.
    texts = json_texts(column.values.slice(first, last - first), in_ascii=in_ascii, quote=quote)
    offsets = pa.array(column.offsets.to_numpy() - first, pa.int32())
    return pc.binary_join(pa.ListArray.from_arrays(offsets, texts), ",")


def _is_simple_list(kind: pa.DataType) -> bool:
    return pa.types.is_list(kind) and any(is_kind(kind.value_type) for is_kind in _SIMPLE)


def _replaced(texts: pa.Array, where: pa.Array, column: pa.Array, encode: Encode) -> pa.Array:
    """Return the texts, and where `where` is true the encoded value; each distinct one is encoded once."""
    if not pc.any(where).as_py():
        return texts
    coded = column.filter(where).dictionary_encode()
    encoded = pa.array([encode(value) for value in coded.dictionary.to_pylist()], pa.string()).take(coded.indices)
    return pc.replace_with_mask(texts, where.fill_null(False), encoded)


def _quoted_if_needed(texts: pa.Array) -> pa.Array:
    needed = _is_any_in(texts, _QUOTED)
    return pc.if_else(needed, _quoted(texts), texts) if pc.any(needed).as_py() else texts


def _quoted(texts: pa.Array) -> pa.Array:
    return pc.binary_join_element_wise('"', pc.replace_substring(texts, '"', '""'), '"', "")


def _is_any_in(texts: pa.Array, characters: Sequence[str]) -> pa.Array:
    """Return for each text whether it contains any of these."""
    content = bytes(_content(texts))
    matches = [pc.match_substring(texts, character) for character in characters if character.encode() in content]
    return reduce(pc.or_, matches, pa.repeat(False, len(texts)))


def _holds_only(texts: pa.Array, characters: bytes) -> bool:
    """Return whether the texts contain only these bytes, in one pass over all of them."""
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


@contextmanager
def as_python() -> Iterator[None]:
    """Explain how to handle an Arrow value that Python cannot hold. Raises: QueryFailed for a date or time."""
    try:
        yield
    except (OverflowError, ValueError) as error:
        raise QueryFailed(
            "the answer: found a date or time that Python cannot hold, expected years 1 to 9999 and whole "
            "microseconds; make it text, as in CAST(... AS VARCHAR), or take it in Python with arrow()"
        ) from error


def json_bytes(document: object) -> bytes:
    """Return the document as JSON; bytes of file names that are not UTF-8 are escaped, `\\udcff` for ff."""
    try:
        return msgspec.json.encode(document)
    except UnicodeEncodeError:  # rare, and checking every value for it takes most of the time
        return msgspec.json.encode(encodable(document))


def encodable(value: object) -> object:
    """Return the value with bytes of file names that are not UTF-8 escaped: `\\udcff` for ff."""
    if isinstance(value, str):
        return value if value.isascii() else value.encode("utf-8", "backslashreplace").decode()
    if isinstance(value, dict):
        return {encodable(name): encodable(item) for name, item in value.items()}
    return [encodable(item) for item in value] if isinstance(value, list | tuple) else value


def field_text(value: object, *, raw: bool) -> str:
    """Return the value as a field of CSV."""
    if isinstance(value, str):
        return value if raw else printable.field(value)
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list | tuple | dict):
        text = json_bytes(value).decode()
        return text if raw else printable.ascii_json(text)
    return repr(value) if isinstance(value, float) else str(value)
