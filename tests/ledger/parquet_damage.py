"""Ways to say something twice in a Parquet file, or to say what nobody reads. Each turns a segment into one that a
verifier must refuse."""

from collections.abc import Callable
from typing import cast

from tests.ledger.layout_changes import CHANGES
from tests.ledger.parts import MAGIC, Parts
from tests.ledger.thrift import BINARY, FALSE, I16, I32, I64, STRUCT, TRUE, Field, Listed, Struct, Value, field, put

SEQ, TIME, TYPE = 1, 2, 4
"""Columns of every segment, by their places."""

Damage = Callable[[bytes], bytes]
Alter = Callable[[Struct], None]


def forged(alter: Callable[[Parts], object]) -> Damage:
    """Alter the parts of the file."""

    def damage(data: bytes) -> bytes:
        parts = Parts(data)
        alter(parts)
        return bytes(parts)

    return damage


def in_footer(alter: Alter) -> Damage:
    """Alter the footer."""
    return forged(lambda parts: alter(parts.footer))


def in_column(alter: Alter, column: int = TYPE) -> Damage:
    """Alter the metadata of a column chunk."""
    return forged(lambda parts: alter(parts.about(column)))


def in_page(alter: Alter, column: int = SEQ) -> Damage:
    """Alter the header of the first page of a column, and make offsets and sizes fit."""

    def change(parts: Parts) -> None:
        alter(parts.pages[column][0].header)
        parts.fit()

    return forged(change)


def to(number: int, value: Value, kind: int | None = None) -> Alter:
    """Set the field to this value; a new field is of this kind."""
    return lambda struct: put(struct, number, value, kind)


def plus(by: int, number: int) -> Alter:
    """Increase the field by so much."""
    return lambda struct: put(struct, number, cast(int, field(struct, number)) + by)


def within(number: int, alter: Alter) -> Alter:
    """Alter the struct in this field, or the first one of the list in it."""

    def change(struct: Struct) -> None:
        inner = field(struct, number)
        alter(cast(Struct, inner.values[0] if isinstance(inner, Listed) else inner))

    return change


def without(number: int) -> Alter:
    """Leave the field out."""
    return lambda struct: struct.remove(next(one for one in struct if one.number == number))


def again(number: int, *, at_once: bool) -> Alter:
    """Write the field twice, one after the other or in another place."""

    def change(struct: Struct) -> None:
        at, one = next((at, one) for at, one in enumerate(struct) if one.number == number)
        struct.insert(at if at_once else len(struct), one)

    return change


def gap(before: int | None) -> Damage:
    """Put bytes that nobody reads before a column, or after the last."""

    def change(parts: Parts) -> None:
        parts.gaps[len(parts.pages) if before is None else before] = b"aside"
        parts.fit()

    return forged(change)


def one_less(number: int) -> Alter:
    """Shorten the list in this field."""

    def change(struct: Struct) -> None:
        cast(Listed, field(struct, number)).values.pop()

    return change


def lying(said: Struct) -> None:
    """Make both statistics say that the greatest integer is 0."""
    for number in (1, 5):
        put(said, number, ZERO)


def swapped(parts: Parts) -> None:
    """Swap two columns in the file, each where the footer says it is."""
    first, second = (cast(int, field(parts.about(column), 7)) for column in (SEQ, TIME))
    parts.pages[SEQ], parts.pages[TIME] = parts.pages[TIME], parts.pages[SEQ]
    plus(second, 9)(parts.about(SEQ))
    plus(-first, 9)(parts.about(TIME))


def longer_footer(data: bytes) -> bytes:
    """Count a byte after the fields of the footer as a part of it."""
    return data[:-8] + b"\0" + (int.from_bytes(data[-8:-4], "little") + 1).to_bytes(4, "little") + MAGIC


ZERO = bytes(8)

DAMAGED: dict[str, Damage] = {
    **{name: forged(change) for name, (change, _) in CHANGES.items()},
    "bytes before the footer": gap(None),
    "bytes between columns": gap(SEQ),
    "bytes before the first column": gap(0),
    "columns in another order in the file": forged(swapped),
    "bytes behind the fields of the footer": longer_footer,
    "no order of values": in_footer(without(7)),
    "an order of values less": in_footer(one_less(7)),
    "a field of the footer twice": in_footer(again(3, at_once=True)),
    "a number of the row group": forged(lambda parts: put(parts.group(), 7, 0, I16)),
    "an encrypted column": forged(lambda parts: put(parts.chunks()[TYPE], 9, b"secret", BINARY)),
    "more values": in_column(plus(1, 5)),
    "a field that nobody knows": in_column(to(19, 4, I64)),
    "a field twice": in_column(again(5, at_once=False)),
    "a field as another type": in_column(lambda about: put(about, 5, field(about, 5), I32)),
    "statistics that lie": in_column(within(12, lying), TIME),
    "a count of distinct values": in_column(within(12, to(4, 1, I64)), SEQ),
    "a lie about all strings": in_column(within(16, plus(1, 1))),
    "a wrong checksum": in_page(plus(1, 4)),
    "no checksum": in_page(without(4)),
    "a page that unpacks to more": in_page(plus(1, 2)),
    "a page with two kinds of header": in_page(to(7, [Field(1, I32, 1), Field(2, I32, 0), Field(3, FALSE, 0)], STRUCT)),
    "a field of a page that nobody knows": in_page(to(12, 7, I32)),
    "a page of fewer values": in_page(within(5, plus(-1, 1))),
    "a page in another encoding": in_page(within(5, to(2, 0))),
    "levels in another encoding": in_page(within(5, plus(1, 3))),
    "statistics of a page that lie": in_page(within(5, within(5, lying)), TIME),
    "a dictionary in an order": in_page(within(7, lambda header: put(header, 3, 1, TRUE)), TYPE),
}
"""By name, beside `parts.two_faced`, which needs a second file."""
