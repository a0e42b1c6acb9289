"""Compare the tiles with those that the rows give: a part of `verify`."""

from collections.abc import Mapping
from pathlib import Path

from fsar_ledger.ledger.log.hashing import HASH_BYTES
from fsar_ledger.ledger.log.tiles import HEIGHT, WIDTH, Tile, tile_named
from fsar_ledger.ledger.store import disk
from fsar_ledger.ledger.store.derived import tile_files
from fsar_ledger.ledger.store.problem import Problem

BEHIND = (
    "the tiles and the checkpoint are one commit behind, as a crash leaves them; the next writer, or fsar-ledger "
    "recover, goes on from there"
)
LEFT_OVER = (
    "partial tiles are there whose full tile is there too, as a crash leaves them; fsar-ledger recover sets them aside"
)


class TileCheck:
    """Compares the tiles with those of a tree that grows commit by commit; `finish` returns the differences."""

    def __init__(self, ledger: Path) -> None:
        self._ledger = ledger
        self._full: dict[int, int] = {}  # level -> full tiles
        self._partial: dict[Tile, bytes] = {}  # whose full tile is still to come
        self._newest: dict[Tile, bytes] = {}  # made by the newest commit
        self._outgrown: dict[Tile, bytes] = {}  # whose full tile came with the newest commit
        self._missing: list[Tile] = []
        self._problems: list[Problem] = []

    def add(self, commit: int, made: Mapping[Tile, bytes]) -> None:
        """Add the tiles that a commit made."""
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
        """Return the problems, and remarks on what only a crash may have left or lost."""
        for tile, data in self._partial.items():
            self._compare(tile, data, None)
        found = set(tile_files(self._ledger))
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
        """Return whether this is the name of a full tile of the tree."""
        tile = tile_named(name)
        return tile is not None and tile.width == WIDTH and tile.number < self._full.get(tile.level, 0)
