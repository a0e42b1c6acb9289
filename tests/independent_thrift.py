"""Parquet's header and footer structures (parquet.thrift) in the Thrift compact protocol, read strictly.

A structure is a dict by field names. Every field must be known, of its type, once, in order, and in its shortest
encoding. What docs/ledger-format.md does not allow in a segment is left out here and therefore unknown: metadata,
encryption, indices, filters, orders, files elsewhere.
"""

from typing import Any

Grammar = dict[int, tuple[str, Any]]
"""By field number: the name, starred if the field is required; and the type: a name, a Grammar, or a list of one."""

NOTHING: Grammar = {}
STATISTICS: Grammar = {
    1: ("max", "binary"),
    2: ("min", "binary"),
    3: ("null_count", "i64"),
    5: ("max_value", "binary"),
    6: ("min_value", "binary"),
    7: ("is_max_value_exact", "bool"),
    8: ("is_min_value_exact", "bool"),
}
ELEMENT: Grammar = {
    1: ("type", "i32"),
    3: ("repetition", "i32"),
    4: ("name*", "text"),
    5: ("children", "i32"),
    6: ("converted_type", "i32"),
    10: ("logical_type", {1: ("string", NOTHING), 3: ("list", NOTHING)}),
}
ENCODING_STATS: Grammar = {1: ("page_type*", "i32"), 2: ("encoding*", "i32"), 3: ("count*", "i32")}
SIZES: Grammar = {1: ("unencoded", "i64"), 2: ("repetitions", ["i64"]), 3: ("definitions", ["i64"])}
COLUMN: Grammar = {
    1: ("type*", "i32"),
    2: ("encodings*", ["i32"]),
    3: ("path*", ["text"]),
    4: ("codec*", "i32"),
    5: ("num_values*", "i64"),
    6: ("unpacked_bytes*", "i64"),
    7: ("stored_bytes*", "i64"),
    9: ("data_offset*", "i64"),
    11: ("dictionary_offset", "i64"),
    12: ("statistics", STATISTICS),
    13: ("encoding_stats*", [ENCODING_STATS]),
    16: ("sizes", SIZES),
}
CHUNK: Grammar = {2: ("file_offset*", "i64"), 3: ("column*", COLUMN)}
GROUP: Grammar = {
    1: ("chunks*", [CHUNK]),
    2: ("unpacked_bytes*", "i64"),
    3: ("num_rows*", "i64"),
    5: ("file_offset*", "i64"),
    6: ("stored_bytes*", "i64"),
}
FOOTER: Grammar = {
    1: ("version*", "i32"),
    2: ("schema*", [ELEMENT]),
    3: ("num_rows*", "i64"),
    4: ("groups*", [GROUP]),
    6: ("created_by*", "text"),
    7: ("column_orders*", [{1: ("by_type*", NOTHING)}]),
}
DATA_PAGE: Grammar = {
    1: ("num_values*", "i32"),
    2: ("encoding*", "i32"),
    3: ("definition_encoding*", "i32"),
    4: ("repetition_encoding*", "i32"),
    5: ("statistics*", STATISTICS),
}
DICTIONARY_PAGE: Grammar = {1: ("num_values*", "i32"), 2: ("encoding*", "i32"), 3: ("is_sorted*", "bool")}
PAGE: Grammar = {
    1: ("type*", "i32"),
    2: ("unpacked_bytes*", "i32"),
    3: ("stored_bytes*", "i32"),
    4: ("crc*", "i32"),
    5: ("data", DATA_PAGE),
    7: ("dictionary", DICTIONARY_PAGE),
}

TRUE, FALSE, LIST, STRUCT = 1, 2, 9, 12
WIRES = {"i32": 5, "i64": 6, "binary": 8, "text": 8}
BITS = {"i32": 32, "i64": 64}


class Bytes:
    """A cursor over bytes."""

    def __init__(self, data: bytes, at: int = 0):
        self.data, self.at = data, at

    def take(self, count: int) -> bytes:
        found = self.data[self.at : self.at + count]
        if len(found) != count:
            raise ValueError(f"{len(found)} bytes, not {count}")
        self.at += count
        return found

    def varint(self) -> int:
        value = shift = 0
        while True:
            (byte,) = self.take(1)
            value |= (byte & 127) << shift
            if byte < 128:
                break
            if (shift := shift + 7) > 63:
                break
        if byte > 127 or value >= 1 << 64 or (byte == 0 and shift):
            raise ValueError("a number of more than 64 bits, or in more bytes than it needs")
        return value

    def signed(self) -> int:
        value = self.varint()
        return value >> 1 ^ -(value & 1)

    def struct(self, grammar: Grammar) -> dict[str, Any]:
        """Read the structure at the cursor."""
        found: dict[str, Any] = {}
        number = 0
        while head := self.take(1)[0]:
            if not head >> 4:
                raise ValueError("a field that is there twice, out of order, or far from the one before")
            number += head >> 4
            if number not in grammar:
                raise ValueError(f"field {number}, not one of {list(grammar)}")
            name, kind = grammar[number]
            found[name.rstrip("*")] = self.value(kind, head & 15)
        missing = [name for name, _ in grammar.values() if name.endswith("*") and name[:-1] not in found]
        if missing:
            raise ValueError(f"no {missing}")
        return found

    def value(self, kind: Any, wire: int) -> Any:
        if kind == "bool" and wire in (TRUE, FALSE):
            return wire == TRUE
        if wire != (LIST if isinstance(kind, list) else STRUCT if isinstance(kind, dict) else WIRES.get(kind)):
            raise ValueError(f"a field of type {wire}")
        if isinstance(kind, dict):
            return self.struct(kind)
        if isinstance(kind, list):
            return self.items(kind[0])
        if kind in BITS:
            value = self.signed()
            if not -(1 << BITS[kind] - 1) <= value < 1 << BITS[kind] - 1:
                raise ValueError(f"{value} of {BITS[kind]} bits")
            return value
        data = self.take(self.varint())
        return data.decode() if kind == "text" else data

    def items(self, kind: Any) -> list[Any]:
        size, wire = divmod(self.take(1)[0], 16)
        if size == 15 and (size := self.varint()) < 15:
            raise ValueError("a size of a list in more bytes than it needs")
        if size > len(self.data) - self.at:
            raise ValueError(f"a list of {size}")
        return [self.value(kind, wire) for _ in range(size)]
