"""Commits that are packed are those that were added."""

import os
from collections.abc import Iterator
from pathlib import Path
from unittest.mock import patch

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsar_ledger.base.errors import LedgerCorrupted
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows.runs import piece
from fsar_ledger.ledger.store import record as module
from fsar_ledger.ledger.store import snapshot
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.links import Chain, Followed, follow
from fsar_ledger.ledger.store.paths import CHAIN
from fsar_ledger.ledger.store.read import View
from fsar_ledger.ledger.store.record import Commit, Commits
from tests.ledger.samples import ORIGIN, made_up_run

STEPS = st.lists(
    st.tuples(st.sampled_from(["extend", "extend", "pack", "cut", "let_go"]), st.integers(0, 20)), max_size=12
)


@given(STEPS, st.integers(-25, 25), st.integers(-25, 25))
def test_whatever_is_added_packed_and_forgotten_they_are_a_list(
    steps: list[tuple[str, int]], first: int, end: int
) -> None:
    packed, plain = Commits(), list[Commit]()
    with patch.object(module, "_PACKED", 3):
        for name, count in steps:
            match name:
                case "extend":
                    size = plain[-1].tree_size if plain else 0
                    added = [Commit(at, "a" * 64, "0.14.0", 2, size + 2 * at, "b" * 64) for at in range(1, count + 1)]
                    packed.extend(added)
                    plain += added
                case "pack":
                    packed.pack(min(count, len(plain)))
                case "cut":
                    packed.cut(min(count, len(plain)))
                    plain = plain[:count]
                case "let_go":
                    packed.let_go(min(count, len(plain)))
                    plain = plain[count:]
        sizes = [commit.tree_size for commit in plain]
        assert [*packed] == plain
        assert [*reversed(packed)] == plain[::-1]
        assert (len(packed), [*packed.sizes]) == (len(plain), sizes)
        assert packed[first:end] == plain[first:end]
        assert [packed[at] for at in range(-len(plain), len(plain))] == plain + plain
        assert packed.within(first, end) == [one for one in plain if first < one.tree_size <= end]
        assert packed.ending_at(end) == next((one for one in plain if one.tree_size == end), None)
        with pytest.raises(IndexError):
            packed[len(plain)]


def growing(path: Path, *, sealed_every: int = 17) -> Iterator[int]:
    """Write a ledger of 60 events, each a commit of its own; yield the number of each as it is there."""
    run = made_up_run("long", 60, 3)
    with Writer(path, ORIGIN) as writer:
        for at in range(60):
            writer.add([piece(run, at, at + 1)])
            if at % sealed_every == sealed_every - 1:
                writer.seal()
            yield at


def test_a_ledger_of_many_commits_is_read_in_parts_and_its_commits_are_packed(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    path = tmp_path_factory.mktemp("packed") / "ledger"
    assert len([*growing(path)]) == 60
    whole = open_ledger(path)
    with patch.object(module, "_PACKED", 4), patch.object(snapshot, "PART_BYTES", 3_000):
        view = open_ledger(path)
        assert view.commits._packs
        assert [*view.commits] == [*whole.commits]
        assert (view.head, view.record_sha256, view.followed.end) == (
            whole.head,
            whole.record_sha256,
            whole.followed.end,
        )
        with Writer(path, ORIGIN) as writer:
            assert writer.head == whole.head
            assert not writer._view.commits._packs


@pytest.fixture
def remembers(monkeypatch: pytest.MonkeyPatch) -> dict[tuple[Path, str], snapshot.Known]:
    """Every chain is long enough to be remembered; what is remembered, which is nothing yet."""
    found: dict[tuple[Path, str], snapshot.Known] = {}
    monkeypatch.setattr(snapshot, "LEAST_KNOWN", 1)
    monkeypatch.setattr(snapshot, "PART_BYTES", 3_000)
    monkeypatch.setattr(snapshot, "known", found)
    return found


def test_a_chain_that_this_process_knows_reads_as_one_that_it_does_not(
    tmp_path: Path, remembers: dict[tuple[Path, str], snapshot.Known]
) -> None:
    path = tmp_path / "ledger"
    views: list[tuple[View, View]] = []
    for _ in growing(path):
        one = open_ledger(path)
        with patch.object(snapshot, "known", {}):
            views.append((one, open_ledger(path)))
    assert len(remembers) == 1
    for size, (one, fresh) in enumerate(views, start=1):  # an old view has not gone on with the new ones
        assert one.head == fresh.head
        assert [*one.commits] == [*fresh.commits]
        assert (len(one.commits), one.record_sha256, one.followed) == (size, fresh.record_sha256, fresh.followed)
        assert (one.chain.placed, one.chain.going_on) == (fresh.chain.placed, fresh.chain.going_on)


def test_only_the_new_lines_of_a_known_chain_are_followed(
    tmp_path: Path, remembers: dict[tuple[Path, str], snapshot.Known], monkeypatch: pytest.MonkeyPatch
) -> None:
    path, run = tmp_path / "ledger", made_up_run("long", 60, 3)
    with Writer(path, ORIGIN) as writer:
        for at in range(50):
            writer.add([piece(run, at, at + 1)])
        writer.seal()
        open_ledger(path)
        assert remembers
        followed: list[bytes] = []

        def watched(data: bytes, chain: Chain) -> Followed:
            followed.append(data)
            return follow(data, chain)

        monkeypatch.setattr(snapshot, "follow", watched)
        open_ledger(path)
        assert b"".join(followed) == b""
        before = (path / CHAIN).stat().st_size
        writer.add([piece(run, 50, 51)])
        writer.seal()
        open_ledger(path)
        assert b"".join(followed) == (path / CHAIN).read_bytes()[before:]


@pytest.mark.parametrize("where", [0.0, 0.4])
def test_a_known_chain_that_was_altered_is_read_again(
    tmp_path: Path, remembers: dict[tuple[Path, str], snapshot.Known], where: float
) -> None:
    path = tmp_path / "ledger"
    assert len([*growing(path, sealed_every=30)]) == 60
    open_ledger(path)
    assert remembers
    data, status = bytearray((path / CHAIN).read_bytes()), (path / CHAIN).stat()
    place = data.index(b'"rows":', int(where * len(data))) + 7
    data[place] ^= 2
    (path / CHAIN).write_bytes(data)
    os.utime(path / CHAIN, ns=(status.st_atime_ns, status.st_mtime_ns))
    with pytest.raises(LedgerCorrupted, match="field rows"):
        open_ledger(path)


def test_only_the_newest_chains_are_remembered(
    tmp_path: Path, remembers: dict[tuple[Path, str], snapshot.Known]
) -> None:
    for at in range(snapshot.MOST_KNOWN + 2):
        with Writer(tmp_path / f"{at}", ORIGIN) as writer:
            writer.add([piece(made_up_run("long", 60, 3), 0, 1)])
            writer.seal()
        open_ledger(tmp_path / f"{at}")
    assert [place for place, _ in remembers] == [tmp_path / f"{at}" for at in range(2, snapshot.MOST_KNOWN + 2)]
