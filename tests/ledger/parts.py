"""A segment taken apart, to be put together differently, as a forger who knows Parquet would."""

from typing import cast

from tests.ledger.thrift import I64, Listed, Struct, field, has, put, read, write

MAGIC = b"PAR1"


class Page:
    """One page: its header and its body."""

    def __init__(self, header: Struct, body: bytes):
        self.header, self.body = header, body

    def __bytes__(self) -> bytes:
        return write(self.header) + self.body


class Parts:
    """A segment: the pages of each column, and the footer.

    `bytes` puts it together and makes nothing fit; `fit` makes the footer fit the pages.
    """

    def __init__(self, data: bytes):
        length = int.from_bytes(data[-8:-4], "little")
        self.footer, end = read(data, len(data) - 8 - length)
        assert end == len(data) - 8
        self.gaps: dict[int, bytes] = {}
        """Bytes before the column of this number; before the footer behind the last."""
        self.pages = [self._pages(data, number) for number in range(len(self.chunks()))]

    def group(self) -> Struct:
        """Return the row group."""
        return cast(Struct, cast(Listed, field(self.footer, 4)).values[0])

    def chunks(self) -> list[Struct]:
        """Return the column chunks."""
        return cast(list[Struct], cast(Listed, field(self.group(), 1)).values)

    def about(self, number: int) -> Struct:
        """Return the metadata of this column in the footer."""
        return cast(Struct, field(self.chunks()[number], 3))

    def number_of(self, name: str) -> int:
        """Return the number of the column with this name."""
        paths = [cast(Listed, field(self.about(number), 3)).values[0] for number in range(len(self.chunks()))]
        return paths.index(name.encode())

    def _pages(self, data: bytes, number: int) -> list[Page]:
        about = self.about(number)
        at = cast(int, field(about, 11) if has(about, 11) else field(about, 9))
        end = at + cast(int, field(about, 7))
        pages = []
        while at < end:
            header, body = read(data, at)
            at = body + cast(int, field(header, 3))
            pages.append(Page(header, data[body:at]))
        return pages

    def fit(self) -> "Parts":
        """Set the sizes and offsets in the footer to those of the pages."""
        at, all_unpacked, begin = len(MAGIC), 0, len(MAGIC)
        for number, pages in enumerate(self.pages):
            at += len(self.gaps.get(number, b""))
            about = self.about(number)
            places, unpacked, start = [], 0, at
            for page in pages:
                places.append(at)
                unpacked += len(write(page.header)) + cast(int, field(page.header, 2))
                at += len(bytes(page))
            put(about, 6, unpacked)
            put(about, 7, at - start)
            if has(about, 11):
                put(about, 11, (places or [at])[0])
            put(about, 9, (places or [at])[-1 if len(places) < 2 else int(has(about, 11))], I64)
            all_unpacked += unpacked
        put(self.group(), 2, all_unpacked)
        put(self.group(), 6, at - begin)
        return self

    def __bytes__(self) -> bytes:
        body = b"".join(
            self.gaps.get(number, b"") + b"".join(map(bytes, pages)) for number, pages in enumerate(self.pages)
        )
        footer = write(self.footer)
        return MAGIC + body + self.gaps.get(len(self.pages), b"") + footer + len(footer).to_bytes(4, "little") + MAGIC


def two_faced(honest: bytes, other: bytes, name: str) -> bytes:
    """Return a segment with the honest rows for readers that begin at the first data page of a column, and the other
    rows for readers that begin at its dictionary."""
    parts, others = Parts(honest), Parts(other)
    number = parts.number_of(name)
    parts.gaps[number + 1] = b"".join(map(bytes, others.pages[number]))
    parts.fit()
    about = parts.about(number)
    begin = cast(int, field(about, 11))
    put(about, 9, begin)
    put(about, 11, begin + sum(len(bytes(page)) for page in parts.pages[number]))
    put(parts.footer, 6, b"parquet-cpp-arrow version 9.9.9")
    return bytes(parts)
