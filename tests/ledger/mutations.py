"""Structural mutations of a segment: what a forger who knows Parquet well may write into a footer and page headers."""

import random
from collections.abc import Callable
from typing import cast

from tests.ledger.parts import MAGIC, Page, Parts
from tests.ledger.thrift import (
    BINARY,
    I32,
    I64,
    LIST,
    STRUCT,
    TRUE,
    Field,
    Listed,
    Raw,
    Struct,
    Value,
    field,
    has,
    put,
    read,
    varint,
    write,
)

WRITERS = (
    *(b"parquet-cpp version 1.2.0", b"parquet-mr version 1.8.0"),
    *(b"parquet-cpp-arrow version 1.0.0", b"DuckDB", b"impala version 1.0"),
    *(b"", b"\xff"),
)
NUMBERS = (0, 1, 2, 3, 4, 5, 8, -1, 127, 128, 1 << 20, (1 << 31) - 1, 1 << 31, 1 << 32, (1 << 63) - 1, -(1 << 63))


class Template:
    """A segment whose structs are parsed only where a mutation touches them, so that many mutations are quick."""

    def __init__(self, data: bytes):
        self.data = data
        self.footer_at = len(data) - 8 - int.from_bytes(data[-8:-4], "little")
        parts = Parts(data)
        self.root = [one for one in parts.footer if one.number not in (2, 4)]
        self.schema = [write(cast(Struct, one)) for one in cast(Listed, field(parts.footer, 2)).values]
        self.group = [one for one in parts.group() if one.number != 1]
        self.chunks = [write(chunk) for chunk in parts.chunks()]
        self.headers: list[tuple[int, int]] = []
        """Where the headers of all pages begin and end."""
        self.numbers = sorted(
            {
                cast(int, one.value)
                for chunk in parts.chunks()
                for one in cast(Struct, field(chunk, 3))
                if one.kind == I64
            }
        )
        at = len(MAGIC)
        for page in (page for pages in parts.pages for page in pages):
            length = len(write(page.header))
            self.headers.append((at, at + length))
            at += length + len(page.body)


class Draft:
    """One mutated segment in the making: the parts of a template, to be changed."""

    def __init__(self, template: Template, draw: random.Random):
        self.template, self.draw = template, draw
        self.root, self.group = list(template.root), list(template.group)
        self.schema: list[Value] = [Raw(data) for data in template.schema]
        self.chunks: list[Value] = [Raw(data) for data in template.chunks]

    def chunk(self, at: int | None = None) -> Struct:
        """Parse and return a column chunk."""
        at = self.draw.randrange(len(self.chunks)) if at is None else at
        raw = self.chunks[at]
        if isinstance(raw, Raw):
            self.chunks[at] = read(raw.data)[0]
        return cast(Struct, self.chunks[at])

    def element(self) -> Struct:
        """Parse and return an element of the schema."""
        at = self.draw.randrange(len(self.schema))
        self.schema[at] = found = read(self.template.schema[at])[0]
        return found

    def any_struct(self) -> Struct:
        """Return some struct of the footer."""
        which = self.draw.randrange(9)
        if which == 0:
            return self.root
        if which == 1:
            return self.group
        if which == 2:
            return self.element()
        chunk = self.chunk(self.draw.randrange(3) if self.draw.random() < 0.3 else None)
        about = cast(Struct, field(chunk, 3))
        if which == 3:
            return chunk
        if which in (4, 5):
            return about
        numbers = [number for number in (12, 16) if has(about, number)]
        if which == 6 and numbers:
            return cast(Struct, field(about, self.draw.choice(numbers)))
        return cast(Struct, self.draw.choice(cast(Listed, field(about, 13)).values)) if which == 7 else about

    def number(self) -> int:
        """Return some number, often one that is in the footer already."""
        return self.draw.choice(self.template.numbers) if self.draw.random() < 0.5 else self.draw.choice(NUMBERS)

    def __bytes__(self) -> bytes:
        root, group = list(self.root), list(self.group)
        group.insert(0, Field(1, LIST, Listed(STRUCT, self.chunks)))
        root.insert(1, Field(2, LIST, Listed(STRUCT, self.schema)))
        at = next((at for at, one in enumerate(root) if one.number > 3), len(root))
        root.insert(at, Field(4, LIST, Listed(STRUCT, [group])))
        return ended(self.template.data[: self.template.footer_at] + write(root), self.template.footer_at)


def ended(data: bytes, footer_at: int) -> bytes:
    """Return the bytes as a file whose footer begins there."""
    return data + (len(data) - footer_at).to_bytes(4, "little") + MAGIC


def _pick(struct: Struct, draw: random.Random, *kinds: int) -> int | None:
    found = [at for at, one in enumerate(struct) if not kinds or one.kind in kinds]
    return draw.choice(found) if found else None


def a_number(draft: Draft) -> None:
    struct = draft.any_struct()
    if (at := _pick(struct, draft.draw, I32, I64)) is not None:
        value = cast(int, struct[at].value)
        struct[at] = struct[at]._replace(value=draft.draw.choice((value + 1, value - 1, draft.number())))


def a_place(draft: Draft) -> None:
    about = cast(Struct, field(draft.chunk(), 3))
    number = draft.draw.choice((5, 6, 7, 9, 11))
    put(about, number, draft.draw.choice(draft.template.numbers), I64)
    if draft.draw.random() < 0.3 and has(about, 11):
        one, other = cast(int, field(about, 9)), cast(int, field(about, 11))
        put(about, 9, other)
        put(about, 11, one)


def a_field_twice(draft: Draft) -> None:
    struct = draft.any_struct()
    if (at := _pick(struct, draft.draw)) is not None:
        again = struct[at]
        if again.kind in (I32, I64):
            again = again._replace(value=draft.number())
        struct.insert(draft.draw.randrange(at + 1, len(struct) + 1), again)


def an_unknown_field(draft: Draft) -> None:
    struct = draft.any_struct()
    number, kind = draft.draw.randrange(1, 40), draft.draw.choice((I32, I64, BINARY, STRUCT, LIST, TRUE))
    values: dict[int, Value] = {
        I32: draft.number(),
        I64: draft.number(),
        BINARY: b"x",
        STRUCT: [],
        LIST: Listed(STRUCT, []),
        TRUE: 1,
    }
    struct.insert(draft.draw.randrange(len(struct) + 1), Field(number, kind, values[kind]))


def a_missing_field(draft: Draft) -> None:
    struct = draft.any_struct()
    if (at := _pick(struct, draft.draw)) is not None:
        struct.pop(at)


def another_order(draft: Draft) -> None:
    struct = draft.any_struct()
    one, other = (draft.draw.randrange(len(struct)) for _ in range(2)) if struct else (0, 0)
    if one != other:
        struct[one], struct[other] = struct[other], struct[one]


def another_kind(draft: Draft) -> None:
    struct = draft.any_struct()
    if (at := _pick(struct, draft.draw, I32, I64)) is not None:
        struct[at] = struct[at]._replace(kind=draft.draw.choice((3, 4, I32, I64, TRUE)))


def a_varint(draft: Draft) -> None:
    struct = draft.any_struct()
    if (at := _pick(struct, draft.draw, I32, I64)) is not None:
        value = cast(int, struct[at].value)
        data = varint(value << 1 if value >= 0 else ~(value << 1))
        longer = (
            data[:-1] + bytes([data[-1] | 0x80]) + b"\x80" * draft.draw.randrange(5) + draft.draw.choice((b"\0", b"\1"))
        )
        struct[at] = struct[at]._replace(value=Raw(draft.draw.choice((longer, data[:-1], b"\x80" * 12 + data))))


def a_list(draft: Draft) -> None:
    struct = draft.any_struct()
    if (at := _pick(struct, draft.draw, LIST)) is not None and isinstance(listed := struct[at].value, Listed):
        values = list(listed.values)
        way = draft.draw.randrange(4)
        if way == 0 or not values:
            values.append(draft.number() if listed.kind in (I32, I64) else b"x" if listed.kind == BINARY else [])
        elif way == 1:
            values.pop(draft.draw.randrange(len(values)))
        elif way == 2:
            values.insert(0, draft.draw.choice(values))
        elif listed.kind in (I32, I64):
            values[draft.draw.randrange(len(values))] = draft.number()
        struct[at] = struct[at]._replace(value=Listed(listed.kind, values))


def some_text(draft: Draft) -> None:
    struct = draft.any_struct()
    if (at := _pick(struct, draft.draw, BINARY)) is not None:
        text = cast(bytes, struct[at].value)
        struct[at] = struct[at]._replace(
            value=draft.draw.choice((text[:-1], text + b"x", text.upper(), b"", text[::-1]))
        )


def the_writer(draft: Draft) -> None:
    version = b"parquet-cpp-arrow version %d.%d.%d" % tuple(draft.draw.randrange(40) for _ in range(3))
    put(draft.root, 6, draft.draw.choice((version, *WRITERS)))


def the_columns(draft: Draft) -> None:
    lists = [draft.chunks, draft.schema]
    values = draft.draw.choice(lists)
    one, other = (draft.draw.randrange(len(values)) for _ in range(2))
    way = draft.draw.randrange(4)
    if way == 0:
        for each in lists if draft.draw.random() < 0.5 else [values]:
            each[one % len(each)], each[other % len(each)] = each[other % len(each)], each[one % len(each)]
    elif way == 1:
        values.pop(one)
    elif way == 2:
        values.insert(one, values[other])
    else:
        values[one] = values[other]


def the_schema(draft: Draft) -> None:
    element = draft.element()
    number = draft.draw.choice((1, 2, 3, 5, 6, 7, 8, 9))
    put(element, number, draft.draw.randrange(8), I32)


def key_values(draft: Draft) -> None:
    pairs = Listed(
        STRUCT,
        [
            [
                Field(1, BINARY, draft.draw.choice((b"ARROW:schema", b"pandas", b"x"))),
                Field(2, BINARY, b"x" * draft.draw.randrange(9)),
            ]
        ],
    )
    put(draft.root, 5, pairs, LIST)


def statistics(draft: Draft) -> None:
    about = cast(Struct, field(draft.chunk(draft.draw.randrange(3)), 3))
    if has(about, 12):
        stated = cast(Struct, field(about, 12))
        at = draft.draw.randrange(len(stated))
        one = stated[at]
        if one.kind == BINARY:
            data = bytearray(cast(bytes, one.value))
            data[draft.draw.randrange(len(data))] ^= 1 << draft.draw.randrange(8)
            for twin in range(len(stated)):  # said twice, the same
                if stated[twin].value == one.value:
                    stated[twin] = stated[twin]._replace(value=bytes(data))
        else:
            stated.pop(at)


def bytes_of_the_footer(draft: Draft) -> bytes:
    data, at = bytearray(bytes(draft)), draft.template.footer_at
    for _ in range(draft.draw.randrange(1, 4)):
        data[draft.draw.randrange(at, len(data))] = draft.draw.randrange(256)
    return bytes(data)


def the_length_of_the_footer(draft: Draft) -> bytes:
    data, at = draft.template.data, draft.template.footer_at
    cut = draft.draw.randrange(1, 60)
    footer = data[at:-8]
    ways = (footer[:-cut], footer + bytes(cut), footer + footer, footer[cut:], b"\0" * cut + footer)
    chosen = draft.draw.choice(ways)
    return ended(data[:at] + chosen, at + draft.draw.choice((0, 0, cut, -1)))


def the_header_of_a_page(draft: Draft) -> bytes:
    """Change a page header without changing its length, so that nothing else moves."""
    data, draw = draft.template.data, draft.draw
    begin, end = draw.choice(draft.template.headers)
    header = read(data, begin)[0]
    struct = header if draw.random() < 0.5 or not isinstance(header[-1].value, list) else header[-1].value
    mutant = bytearray(data[begin:end])
    if (at := _pick(struct, draw, I32)) is not None and draw.random() < 0.7:
        struct[at] = struct[at]._replace(value=cast(int, struct[at].value) ^ 1 << draw.randrange(6))
        changed = write(header)
        if len(changed) == end - begin:
            mutant = bytearray(changed)
    if bytes(mutant) == data[begin:end]:
        mutant[draw.randrange(len(mutant))] ^= 1 << draw.randrange(8)
    return data[:begin] + bytes(mutant) + data[end:]


def moved_pages(draft: Draft) -> bytes:
    """Move, repeat, remove or hide pages, with or without matching sizes and a second beginning."""
    parts, draw = Parts(draft.template.data), draft.draw
    one, other = (draw.randrange(len(parts.pages)) for _ in range(2))
    way = draw.randrange(7)
    pages, source = parts.pages[one], parts.pages[other][:]
    if way == 0:
        pages.append(draw.choice(source))
    elif way == 1:
        pages.reverse()
    elif way == 2:
        pages.pop(draw.randrange(len(pages)))
    elif way == 3:
        parts.gaps[one] = b"".join(map(bytes, source)) or b"x"
    elif way == 4:
        parts.pages[one], parts.pages[other] = source, pages
    elif way == 5:
        page = draw.choice(pages)
        at = _pick(page.header, draw, I32)
        if at is not None:
            page.header[at] = page.header[at]._replace(
                value=max(0, cast(int, page.header[at].value) + draw.choice((1, -1, 9)))
            )
    else:
        page = pages[-1]
        pages[-1] = Page(page.header, page.body[:-1] + bytes([draw.randrange(256)]))
    if draw.random() < 0.7:
        parts.fit()
    about = parts.about(one)
    if draw.random() < 0.4 and has(about, 11):
        begin = cast(int, field(about, 11))
        put(about, 9, begin)
        put(about, 11, begin + sum(len(bytes(page)) for page in parts.pages[one][: draw.randrange(1, 4)]))
    return bytes(parts)


KINDS: dict[str, Callable[[Draft], bytes | None]] = {
    make.__name__.replace("_", " "): make
    for make in (
        *(a_number, a_place, a_field_twice, an_unknown_field, a_missing_field, another_order),
        *(another_kind, a_varint, a_list, some_text, the_writer, the_columns, the_schema, key_values),
        *(statistics, bytes_of_the_footer, the_length_of_the_footer, the_header_of_a_page, moved_pages),
    )
}


def mutated(template: Template, kind: str, draw: random.Random) -> bytes:
    """Return the segment with one mutation of this kind."""
    draft = Draft(template, draw)
    return KINDS[kind](draft) or bytes(draft)
