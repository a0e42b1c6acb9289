"""What a disk holds after a power failure: a model that is told every change and every sync.

Of a file, what was synced remains; what was written since may remain in full, in part, as rubbish or not at all.
Bytes that a write does not change stay as they are, those beside it in a sector too ("powersafe overwrite" in SQLite).
Of a folder, the names as of its last sync remain; each change since then may remain or not, independently.
A change of two folders (a rename) is one change, as on every file system that keeps a journal.
What was written before a failed `fsync` of a file is never sure to remain, whatever is synced later, unless it is
written again.
"""

import random
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

GARBAGE = b"\xa5rubbish\x00"


@dataclass(eq=False)
class File:
    """A file. `cached` is what a process reads, `durable` what was synced.

    A sync failed while the bytes from `doomed` on were not synced; they are never sure to remain unless they are
    written again.
    """

    cached: bytes = b""
    durable: bytes = b""
    doomed: int | None = None

    @property
    def is_doomed(self) -> bool:
        return self.doomed is not None

    @property
    def is_sure(self) -> bool:
        return self.cached == self.durable and not self.is_doomed

    @property
    def unchanged(self) -> int:
        """Return how many bytes at the beginning are as they were synced, and will stay so."""
        pairs = enumerate(zip(self.cached, self.durable, strict=False))
        same = next((at for at, (one, other) in pairs if one != other), min(len(self.cached), len(self.durable)))
        return same if self.doomed is None else min(same, self.doomed)

    def rubbish(self) -> bytes:
        """Return the file with rubbish in place of the bytes that are not as they were synced.

        A byte that alone was changed is as it was: no disk writes half of it.
        """
        found, synced = bytearray(self.cached), self.durable
        changed = [at for at in range(self.unchanged, len(found)) if found[at : at + 1] != synced[at : at + 1]]
        neighbours = {at for one, other in pairwise(changed) if other == one + 1 for at in (one, other)}
        for at in changed:
            is_alone = at not in neighbours and at < len(synced)
            found[at] = synced[at] if is_alone else GARBAGE[at % len(GARBAGE)]
        return bytes(found)


@dataclass(eq=False)
class Folder:
    names: dict[str, "File | Folder"] = field(default_factory=dict)


Node = File | Folder


@dataclass(eq=False)
class Change:
    """Names that changed at once: (folder, name, what it names now or None)."""

    names: tuple[tuple[Folder, str, Node | None], ...]
    is_durable: bool = False


class Disk:
    """The folder `root` and everything below it; what is there at first is durable."""

    def __init__(self, root: Path):
        self.root = root
        self._folders: list[Folder] = []
        self._first: list[tuple[Folder, dict[str, Node]]] = []
        self._changes: list[Change] = []
        self._top = self._load(root)

    def _load(self, path: Path) -> Folder:
        folder = Folder()
        for entry in sorted(path.iterdir()):
            data = None if entry.is_dir() else entry.read_bytes()
            folder.names[entry.name] = self._load(entry) if data is None else File(data, data)
        self._first.append((folder, dict(folder.names)))
        return folder

    def find(self, path: Path) -> Node | None:
        """Return what this path names now; None if it is outside the root or names nothing."""
        if not path.is_relative_to(self.root):
            return None
        node: Node | None = self._top
        for name in path.relative_to(self.root).parts:
            node = node.names.get(name) if isinstance(node, Folder) else None
        return node

    def _folder_of(self, path: Path) -> Folder | None:
        folder = self.find(path.parent)
        return folder if isinstance(folder, Folder) else None

    def _change(self, *names: tuple[Path, Node | None]) -> None:
        known = [(folder, path.name, node) for path, node in names if (folder := self._folder_of(path)) is not None]
        for folder, name, node in known:
            folder.names.pop(name, None)
            if node is not None:
                folder.names[name] = node
        self._changes.append(Change(tuple(known)))

    def opened(self, path: Path, is_created: bool, is_emptied: bool) -> Node | None:
        """Record that a file was opened, perhaps created or emptied; return what it is, whatever its name becomes."""
        if is_created and self.find(path) is None:
            self._change((path, File()))
        node = self.find(path)
        if is_emptied and isinstance(node, File):
            node.cached = b""
        return node

    def written(self, node: Node | None, data: bytes, place: int | None = None) -> None:
        """Record that the bytes were appended, or written at this place."""
        if isinstance(node, File):
            place = len(node.cached) if place is None else place
            room = b"\0" * (place - len(node.cached))
            node.cached = node.cached[:place] + room + data + node.cached[place + len(data) :]
            if node.doomed is not None and place <= node.doomed and place + len(data) >= len(node.cached):
                node.doomed = None

    def cut(self, node: Node | None, size: int) -> None:
        """Record that the file has this size now."""
        if isinstance(node, File):
            node.cached = node.cached[:size] + b"\0" * (size - len(node.cached))
            if node.doomed is not None and size <= node.doomed:
                node.doomed = None

    def synced(self, node: Node | None) -> None:
        """Record that what the file holds, or the folder names, is durable."""
        if isinstance(node, File):
            assert not node.is_doomed, "a file was synced again after that had failed; it must be given up"
            node.durable = node.cached
        for change in self._changes:
            change.is_durable = change.is_durable or any(folder is node for folder, _, _ in change.names)

    def sync_failed(self, node: Node | None) -> None:
        """Record that what was written to the file may be lost, for good."""
        if isinstance(node, File) and not node.is_sure:
            node.doomed = node.unchanged

    def made(self, path: Path) -> None:
        """Record that a folder was made."""
        self._change((path, Folder()))

    def linked(self, source: Path, path: Path) -> None:
        """Record that the file has a second name."""
        self._change((path, self.find(source)))

    def renamed(self, source: Path, path: Path) -> None:
        """Record that the file has another name."""
        self._change((path, self.find(source)), (source, None))

    def unlinked(self, path: Path) -> None:
        """Record that the name is gone."""
        self._change((path, None))

    def after_power_failure(self, choice: "Choice", path: Path) -> None:
        """Write to the new folder `path` what the root would hold after a power failure now, with this choice of what
        survives."""
        names = {id(folder): dict(first) for folder, first in self._first}
        for change in self._changes:
            if change.is_durable or choice.keeps_change():
                for folder, name, node in change.names:
                    there = names.setdefault(id(folder), {})
                    there.pop(name, None)
                    if node is not None:
                        there[name] = node
        self._write(self._top, names, choice, path, {})

    def _write(
        self, folder: Folder, names: dict[int, dict[str, Node]], choice: "Choice", path: Path, chosen: dict[int, bytes]
    ) -> None:
        path.mkdir()
        for name, node in names.get(id(folder), {}).items():
            if isinstance(node, Folder):
                self._write(node, names, choice, path / name, chosen)
            else:
                data = chosen.setdefault(id(node), node.durable if node.is_sure else choice.content(node))
                (path / name).write_bytes(data)


@dataclass
class Choice:
    """What a power failure leaves of what was not synced: changes of names (all, none or some) and contents."""

    names: str
    contents: str
    draw: random.Random

    def keeps_change(self) -> bool:
        return self.names == "kept" or (self.names == "some" and self.draw.random() < 0.5)

    def content(self, file: File) -> bytes:
        kind = self.draw.choice(("kept", "lost", "rubbish", "part")) if self.contents == "some" else self.contents
        match kind:
            case "kept":
                return file.cached
            case "rubbish":
                return file.rubbish()
            case "part":
                end = self.draw.randrange(file.unchanged, len(file.cached) + 1)
                return file.cached[:end] + file.durable[end:]
            case _:
                return file.durable


def choices(seed: int, random_count: int) -> list[Choice]:
    """Return choices: all lost; all names kept with contents lost, rubbish or kept; and this many random ones."""
    draw = random.Random(seed)
    plain = [("lost", "lost"), ("kept", "lost"), ("kept", "rubbish"), ("kept", "kept")]
    return [Choice(names, contents, draw) for names, contents in [*plain, *[("some", "some")] * random_count]]
