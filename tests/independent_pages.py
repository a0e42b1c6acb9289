"""The values in a Parquet page, to the last byte, in the encodings that docs/ledger-format.md allows.

The encodings are those of parquet-format, Encodings.md.
"""

from collections.abc import Callable
from typing import Any

from independent_thrift import Bytes  # type: ignore[import-not-found]

BOOLEAN, INT64, BYTE_ARRAY = 0, 2, 6
PLAIN, RLE, DELTA, RLE_DICTIONARY = 0, 3, 5, 8
Values = list[Any]


def unpacked(data: bytes, width: int) -> list[int]:
    """Return all integers of this many bits, packed from the lowest bit on."""
    bits, mask = int.from_bytes(data, "little"), (1 << width) - 1
    return [bits >> at & mask for at in range(0, 8 * len(data) - width + 1, width)] if width else []


def hybrid(data: Any, width: int, count: int) -> list[int]:
    """Return this many integers, stored in runs or packed by eight."""
    found: list[int] = []
    while len(found) < count:
        head = data.varint()
        if head & 1:
            groups = head >> 1
            for _ in range(groups):
                found += unpacked(data.take(width), width) if width else [0] * 8
                if len(found) >= count + 8:
                    raise ValueError("more values than there are")
        else:
            if head >> 1 > count - len(found):
                raise ValueError("a run of more values than there are")
            found += [int.from_bytes(data.take((width + 7) // 8), "little")] * (head >> 1)
        if not head >> 1:
            raise ValueError("a run of nothing")
    if any(found[count:]):
        raise ValueError("something in what only fills up")
    return found[:count]


def levels(data: Any, most: int, count: int) -> list[int]:
    """Return this many levels from 0 to the highest."""
    if not most:
        return [0] * count
    own = Bytes(data.take(int.from_bytes(data.take(4), "little")))
    found = hybrid(own, most.bit_length(), count)
    ended(own)
    if max(found, default=0) > most:
        raise ValueError(f"a level above {most}")
    return found


def ended(data: Any) -> None:
    if data.at != len(data.data):
        raise ValueError(f"{len(data.data) - data.at} bytes that nobody reads")


def plain_strings(data: Any, count: int) -> Values:
    return [data.take(int.from_bytes(data.take(4), "little")).decode() for _ in range(count)]


def plain_booleans(data: Any, count: int) -> Values:
    found = unpacked(data.take((count + 7) // 8), 1)
    if any(found[count:]):
        raise ValueError("something in what only fills up")
    return [bool(bit) for bit in found[:count]]


def differences(data: Any, count: int) -> Values:
    """Decode DELTA_BINARY_PACKED."""
    block, minis, total, value = data.varint(), data.varint(), data.varint(), data.signed()
    if total != count or not minis or block % minis or block // minis % 32 or not block:
        raise ValueError(f"{total} values in blocks of {block} by {minis}, not {count}")
    found = [value] if count else []
    while len(found) < count:
        least, widths = data.signed(), data.take(minis)
        for width in widths:
            if len(found) == count:
                break
            if width > 64:
                raise ValueError(f"integers of {width} bits")
            deltas = unpacked(data.take(block // minis * width // 8), width) or [0] * (block // minis)
            for delta in deltas[: count - len(found)]:
                value = (value + least + delta + 2**63) % 2**64 - 2**63
                found.append(value)
    return found


ENCODINGS: dict[tuple[int, int], Callable[[Any, int], Values]] = {
    (BYTE_ARRAY, PLAIN): plain_strings,
    (INT64, DELTA): differences,
    (BOOLEAN, PLAIN): plain_booleans,
}
"""By type and encoding; strings are also codes into a dictionary."""


def read_values(data: Any, kind: int, encoding: int, count: int, dictionary: Values | None) -> Values:
    """Return this many values, and check that nothing follows."""
    if encoding == RLE_DICTIONARY and dictionary is not None:
        (width,) = data.take(1)
        codes = hybrid(data, width, count) if width <= 32 else [len(dictionary)]
        if max(codes, default=-1) >= len(dictionary):
            raise ValueError("a code that is not in the dictionary")
        found = [dictionary[code] for code in codes]
    elif (kind, encoding) in ENCODINGS:
        found = ENCODINGS[kind, encoding](data, count)
    else:
        raise ValueError(f"encoding {encoding} of type {kind}")
    ended(data)
    return found


def assembled(values: Values, repetitions: list[int], definitions: list[int], most: int) -> Values:
    """Return a value, a list or None for each row. Below the highest level a row is None (0) or an empty list (1)."""
    rest = iter(values)
    if most < 2:
        return [next(rest) if level == most else None for level in definitions]
    found: Values = []
    for again, level in zip(repetitions, definitions, strict=True):
        if again:
            if not found or not found[-1] or level != most:
                raise ValueError("an element of no list")
            found[-1].append(next(rest))
        else:
            found.append(None if level == 0 else [] if level == 1 else [next(rest)])
    return found
