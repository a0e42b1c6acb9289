"""What is told to who follows a run, of events that are no longer in memory."""

import asyncio
from pathlib import Path

import pytest

pytest.importorskip("uvicorn", reason="make test-all installs it")

import fsar_ledger
from fsar_ledger.service.feed import Feed


def test_who_follows_a_run_from_its_beginning_is_told_of_each_event_once_also_over_cuts(tmp_path: Path) -> None:
    feed, told = Feed(tmp_path / "hall", "hall"), list[int]()
    with fsar_ledger.federate(tmp_path / "hall", run="hall") as hall:
        for number in range(3):
            for part in range(2):
                hall.give("ReportContext", by="robot/A1", robot="robot/A1", key=f"{number}/{part}")
            while rows := feed.recorded(len(told)):
                told += [row.seq for row in rows]
            hall.cut()
        while rows := feed.recorded(len(told)):
            told += [row.seq for row in rows]
        assert told == list(range(hall.size))


def test_who_leaves_just_when_an_event_comes_is_no_longer_told(tmp_path: Path) -> None:
    async def leave(turns: int) -> bool:
        feed = Feed(tmp_path / "hall", "hall")

        async def follow() -> None:
            seq = 0
            while True:
                seq += len(await feed.rows_from(seq, 0.01))

        following = asyncio.create_task(follow())
        await asyncio.sleep(0)
        feed.publish(0, b"{}\n")
        for _ in range(turns):
            await asyncio.sleep(0)
        following.cancel()
        await asyncio.sleep(0.03)
        has_ended = following.done()
        following.cancel()
        return has_ended

    assert [asyncio.run(leave(turns)) for turns in range(4)] == [True] * 4
