"""The tiles and the checkpoint, compared with those that the rows give: a part of `verify`."""

import os
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path

from fsar_ledger.ledger.log.merkle import HASH_BYTES
from fsar_ledger.ledger.log.tiles import HEIGHT, TILE, WIDTH, Tile
from fsar_ledger.ledger.store import disk
from fsar_ledger.ledger.store.problem import Problem

BEHIND = "the tiles and the checkpoint are one commit behind, as a crash leaves them; the next writer, or fsar-ledger recover, goes on from there"
LEFT_OVER = (
    "partial tiles are there whose full tile is there too, as a crash leaves them; fsar-ledger recover sets them aside"
)


class TileCheck:
    """Compares tiles with those of a tree that grows, commit by commit; `finish` says what does not agree."""

    def __init__(self, ledger: Path) -> None:
        self._ledger = ledger
        self._full: dict[int, int] = {}  # level -> full tiles
        self._partial: dict[Tile, bytes] = {}  # those whose full tile has not come
        self._newest: dict[Tile, bytes] = {}  # what the newest commit made
        self._outgrown: dict[Tile, bytes] = {}  # whose full tile came with the newest commit
        self._missing: list[Tile] = []
        self._problems: list[Problem] = []

    def add(self, commit: int, made: Mapping[Tile, bytes]) -> None:
        """A commit made these tiles."""
        self._newest = dict(made)
        full = {(tile.level, tile.number) for tile in made if tile.width == WIDTH}
        self._outgrown = {tile: data for tile, data in self._partial.items() if (tile.level, tile.number) in full}
        for tile in self._outgrown:
            del self._partial[tile]
        for tile, data in made.items():
            if tile.width == WIDTH:
                self._full[tile.level] = tile.number + 1
                self._compare(tile, data, commit)
            else:
                self._partial[tile] = data

    def finish(self, *, is_behind: bool) -> tuple[list[Problem], tuple[str, ...]]:
        """What does not agree, and what may be there or missing only because a crash came in between."""
        for tile, data in self._partial.items():
            self._compare(tile, data, None)
        found = set(self._files())
        excused = set(self._newest) if is_behind else set()
        self._problems += [
            Problem(tile.name, "no file", f"{tile.width} hashes; fsar-ledger recover derives them again")
            for tile in self._missing
            if tile not in excused
        ]
        left_over = [tile for tile in self._outgrown if tile.name in found]
        for tile in left_over:
            self._compare(tile, self._outgrown[tile], None)
        known = {tile.name for tile in [*self._partial, *left_over]}
        strays = sorted(name for name in found - known if not self._is_full(name))
        self._problems += [Problem(name, "a stray file", "only tiles of this tree; take it away") for name in strays]
        return self._problems, (
            *((BEHIND,) if is_behind else ()),
            *((LEFT_OVER,) if left_over and not is_behind else ()),
        )

    def _compare(self, tile: Tile, expected: bytes, commit: int | None) -> None:
        try:
            found = disk.read_document(self._ledger / tile.name)
        except FileNotFoundError:
            self._missing.append(tile)
            return
        except OSError as error:
            self._problems.append(
                Problem(tile.name, f"an unreadable file ({error.strerror})", f"{tile.width} hashes", commit=commit)
            )
            return
        if found == expected:
            return
        at = next(
            (
                at
                for at in range(0, len(expected), HASH_BYTES)
                if found[at : at + HASH_BYTES] != expected[at : at + HASH_BYTES]
            ),
            len(expected),
        )
        place = at // HASH_BYTES
        if place == tile.width:
            self._problems.append(
                Problem(tile.name, f"{len(found)} bytes", f"{len(expected)}, {tile.width} hashes", commit=commit)
            )
            return
        span = 1 << HEIGHT * tile.level
        first = (tile.number * WIDTH + place) * span
        of = f"event {first}" if span == 1 else f"events {first} to {first + span - 1}"
        hashes = [data[at : at + HASH_BYTES].hex() or "nothing" for data in (found, expected)]
        self._problems.append(Problem(tile.name, hashes[0], hashes[1], commit=commit, field=f"hash {place}, of {of}"))

    def _is_full(self, name: str) -> bool:
        """Whether this is the name of a full tile of the tree."""
        _, level, *groups = name.split("/")
        digits = "".join(groups).replace("x", "")
        if not level.isdecimal() or not digits.isdecimal():
            return False
        tile = Tile(int(level), int(digits))
        return tile.name == name and tile.number < self._full.get(tile.level, 0)

    def _files(self) -> Iterator[str]:
        """Every file under `tile/`, links and other things among them. Raises: OSError if a folder cannot be read, or they are too many."""
        folders = [self._ledger / TILE] if (self._ledger / TILE).is_dir() else []
        seen = 0
        while folders:
            found: list[os.DirEntry[str]] = []
            with suppress(FileNotFoundError):  # a writer has removed outgrown tiles in between
                found = disk.entries(folders.pop())
            seen += len(found)
            if seen > disk.MAX_NAMES:
                raise OSError(0, f"it holds more than {disk.MAX_NAMES} names", TILE)
            for entry in found:
                if entry.is_dir(follow_symlinks=False):
                    folders.append(Path(entry.path))
                else:
                    yield str(Path(entry.path).relative_to(self._ledger))
