"""Two to eight processes append and read at once; `python -m tests.ledger.crash_soak` does it for longer."""

import os
import random
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from fsar_ledger.errors import LedgerCorrupted
from fsar_ledger.ledger.store import disk, paths, prepare
from fsar_ledger.ledger.store.append import Writer, stage
from fsar_ledger.ledger.store.read import LedgerView, open_ledger
from fsar_ledger.ledger.store.walk import commit_names
from fsar_ledger.ledger.verify import verify
from tests.ledger.crash_writer import Nursery, Order
from tests.ledger.crowd import NAMES, batch_of, judge
from tests.ledger.samples import ORIGIN, append_all, contents, made_up_batches

BATCHES = made_up_batches(4)


@pytest.mark.parametrize(("writers", "batches"), [(2, 3), (8, 2)])
def test_writers_at_once_all_finish_with_one_opening_and_readers_see_whole_commits(
    nursery: Nursery, tmp_path: Path, writers: int, batches: int
) -> None:
    path = tmp_path / "ledger"
    outcome = nursery(Order(str(path), NAMES[:writers], batches, readers=2))
    assert outcome.wrong == ()
    assert outcome.acknowledged == dict.fromkeys(NAMES[:writers], batches)
    assert judge(path, outcome.acknowledged) == []
    assert open_ledger(path).head.commits == writers * batches
    assert outcome.heads >= 2


@pytest.mark.slow
def test_a_writer_killed_among_others_loses_nothing_and_stops_nobody(nursery: Nursery, tmp_path: Path) -> None:
    moments = random.Random(3)
    killed = 0
    for trial in range(3):
        path = tmp_path / str(trial)
        outcome = nursery(
            Order(str(path), NAMES[:3], 3, readers=1, kill_after_us=(moments.randrange(20_000, 200_000),))
        )
        killed += outcome.killed
        assert outcome.wrong == ()
        assert judge(path, outcome.acknowledged) == []
        assert [outcome.acknowledged[name] for name in NAMES[1:3]] == [3, 3]
    assert killed >= 1


def test_the_judge_of_the_crowd_sees_a_lost_batch_and_one_out_of_order(tmp_path: Path) -> None:
    append_all(tmp_path / "lost", [batch_of("anna", 0)])
    assert judge(tmp_path / "lost", {"anna": 2}) == ["lost: 1 of 2 acknowledged batches of anna are there"]
    append_all(tmp_path / "swapped", [batch_of("anna", 1), batch_of("anna", 0)])
    assert judge(tmp_path / "swapped", {"anna": 2})[0] == "torn: commit 0 does not hold batch 0 of anna"
    assert judge(tmp_path / "nowhere", {"anna": 1}) == ["lost: the ledger is gone"]


@pytest.mark.parametrize("moment", ["looks whether something else is there", "gives the manifest its name"])
def test_of_two_processes_that_create_a_ledger_the_slower_one_opens_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, moment: str
) -> None:
    path = tmp_path / "ledger"
    path.mkdir()

    def after_the_quicker_one(step: Callable[..., object]) -> Callable[..., object]:
        def late(*arguments: object) -> object:
            monkeypatch.undo()
            append_all(path, BATCHES[:1])
            return step(*arguments)

        return late

    if moment == "gives the manifest its name":
        monkeypatch.setattr(os, "link", after_the_quicker_one(os.link))
    else:
        monkeypatch.setattr(prepare, "is_unfinished", after_the_quicker_one(paths.is_unfinished))
    with Writer(path, ORIGIN) as writer:
        assert writer.head.commits == 1


def test_a_listing_that_lacks_a_commit_made_meanwhile_is_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "ledger"
    append_all(path, BATCHES)
    entries = disk.entries
    late = ["000000000002.json"]

    def without_one_at_first(folder: Path) -> list["os.DirEntry[str]"]:
        lacking = late.pop() if late else None
        return [entry for entry in entries(folder) if entry.name != lacking]

    monkeypatch.setattr(disk, "entries", without_one_at_first)
    assert open_ledger(path).head.commits == 4
    assert not late
    (path / "commits" / "000000000002.json").rename(tmp_path / "gone")
    with pytest.raises(
        LedgerCorrupted,
        match=r"000000000003\.json: commit 3: found number 3, expected numbers below 3, without gaps: "
        r"commits/000000000002.json is missing",
    ):
        open_ledger(path)


def test_verify_looks_again_where_a_writer_has_changed_the_ledger_meanwhile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "ledger"
    append_all(path, BATCHES[:2])

    def then_another_is_made(*arguments: Any) -> object:
        found = commit_names(*arguments)
        monkeypatch.undo()
        append_all(path, BATCHES[2:3])
        return found

    monkeypatch.setattr(verify, "commit_names", then_another_is_made)
    report = verify.verify(path)
    assert (report.problems, report.commits) == ((), 3)


def test_a_batch_staged_again_after_its_commit_is_cleaned_up(tmp_path: Path) -> None:
    path = tmp_path / "ledger"
    append_all(path, BATCHES)
    before = contents(path)
    stage(path, BATCHES[1])
    assert contents(path) != before
    Writer(path, ORIGIN).close()
    assert contents(path) == before


def test_a_later_view_begins_with_the_earlier_one(tmp_path: Path) -> None:
    path = tmp_path / "ledger"
    seen: list[LedgerView] = []
    with Writer(path, ORIGIN) as writer:
        for batch in BATCHES:
            writer.append(stage(path, batch))
            seen.append(open_ledger(path))
    for earlier, later in pairwise(seen):
        assert later.records[: len(earlier.records)] == earlier.records
        assert list(earlier.runs()) == list(later.runs())[: 2 * earlier.head.commits]
