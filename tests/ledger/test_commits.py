"""Commits that are packed are those that were added."""

from unittest.mock import patch

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows.runs import piece
from fsar_ledger.ledger.store import record as module
from fsar_ledger.ledger.store import snapshot
from fsar_ledger.ledger.store.append import Writer
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


def test_a_ledger_of_many_commits_is_read_in_parts_and_its_commits_are_packed(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    path, run = tmp_path_factory.mktemp("packed") / "ledger", made_up_run("long", 60, 3)
    with Writer(path, ORIGIN) as writer:
        for at in range(60):
            writer.add([piece(run, at, at + 1)])
            if at % 17 == 16:
                writer.seal()
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
