"""A federation answers as one ledger with the events of its shards; what has grown is recorded again."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import msgspec
import pytest

import fsar_ledger
from fsar_ledger.api.verbs import stored
from fsar_ledger.base.errors import InvalidRun, SequenceConflict, UsageError
from fsar_ledger.ledger import opening
from fsar_ledger.ledger.opening import open_for_answers, open_ledger
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.store import shards
from fsar_ledger.ledger.store.paths import segment_bytes
from fsar_ledger.ledger.store.shards import heads_of, record_of_head
from fsar_ledger.metrics import database, slices
from fsar_ledger.metrics.database import Database, Slices, connect
from fsar_ledger.metrics.library import library
from fsar_ledger.metrics.slices import Slice
from tests.api.sites import NAMES, append, origin, parts
from tests.quick import few
from tests.runtime.test_cuts import Day, commands_of
from tests.runtime.test_isolation import DRIVE, A, Site


def without_head(answer: Any) -> dict[str, Any]:
    return {name: value for name, value in msgspec.structs.asdict(answer).items() if name != "provenance"}


def judged(path: Path) -> dict[str, Any]:
    """Return what verbs answer that judge all runs, in slices where the ledger has any."""
    of = fsar_ledger.open_ledger(path)
    return {
        "metrics": of.metrics().rows(),
        "by scenario": of.metrics(by="scenario", pool="seeds").rows(),
        "statistics": of.statistics().table().rows(),
        "audit": of.audit().table().rows(),
        "compare": of.compare("fsar", "cfc").table().rows(),
        "multiverse": of.multiverse(metric=["policy_violations"]).table().rows(),
    }


def shown(path: Path) -> dict[str, Any]:
    """Return what other verbs answer about all runs, without the head."""
    of = fsar_ledger.open_ledger(path)
    found: dict[str, Any] = {
        "runs": of.runs().rows(),
        "numbers": of.numbers(),
        "query": of.query("audit/denials", run=7).rows(),
        "sql": of.sql("SELECT type, count(*) AS n FROM events GROUP BY type ORDER BY ALL").rows(),
        "log": [of.log(run=run).rows() for run in (2, 7, 12)],
        "events": of.events(run=9).table().rows(),
        "requests": of.requests(run=9).rows(),
        "state": [without_head(of.state(run=9, at=30, by_commit=commit)) for commit in (None, 12)],
        "record": msgspec.structs.asdict(of.record(6)),
    }
    info = of.info()
    return found | {"info": (info.groups, info.models, info.plans, info.missing, info.not_observed)}


@pytest.fixture
def cached(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


@pytest.fixture(scope="module")
def expected(whole: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    return judged(whole), shown(whole)


@pytest.mark.usefixtures("cached")
@pytest.mark.parametrize("most", few([1 << 30, 2_500], [], [2_500]))
def test_a_federation_answers_as_the_one_ledger(
    expected: tuple[dict[str, Any], dict[str, Any]], whole: Path, site: Path, most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(database, "SLICE_EVENTS", most)
    assert (judged(site / "log"), shown(site / "log")) == expected
    if most == 1 << 30:  # a line for each event of all runs takes seconds, and knows nothing of slices
        one, federation = (fsar_ledger.open_ledger(path) for path in (whole, site / "log"))
        lines = [[row for table in of.stream_log() for row in table.rows()] for of in (one, federation)]
        assert lines[0] == lines[1] != []
    assert judged(site / "log") == expected[0]  # from the cache, where there is one
    of_shards = [len(Slices(open_for_answers(site / name))) for name in NAMES]
    assert len(Slices(open_for_answers(site / "log"))) == sum(of_shards)
    assert all(of_shards) is (most == 2_500)


@pytest.fixture(scope="module")
def both(whole: Path, site: Path) -> Iterator[tuple[Database, Database]]:
    with connect(whole) as one, connect(site / "log") as federation:
        yield one, federation


NAMES_OF_QUERIES = [name for name, query in library().queries.items() if not query.parameters]
SAMPLE = ("staging/runs", "facts/decisions", "metrics/run_metrics", "invariants/i3_jointly_composed_policy")


@pytest.mark.parametrize("name", few(NAMES_OF_QUERIES, SAMPLE, NAMES_OF_QUERIES[::4]))
def test_every_query_answers_as_of_the_one_ledger(name: str, both: tuple[Database, Database]) -> None:
    one, federation = both
    assert federation.query(name).equals(one.query(name))


@pytest.mark.slow
@pytest.mark.usefixtures("cached")
def test_what_is_known_of_a_shard_alone_is_known_of_it_in_the_federation(
    site: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(database, "SLICE_EVENTS", 1_500)
    seen: list[Path] = []
    fill = slices.fill

    def looked(database: Database, one: Slice, *args: Any) -> None:
        seen.append(one.view.path)
        fill(database, one, *args)

    monkeypatch.setattr(slices, "fill", looked)
    for name in ("north", "south"):
        fsar_ledger.open_ledger(site / name).metrics()
    assert {path.name for path in seen} == {"north", "south"}
    seen.clear()
    fsar_ledger.open_ledger(site / "log").metrics()
    assert {path.name for path in seen} == {"west"}


@pytest.mark.slow
def test_each_answer_names_the_head_of_the_log(site: Path) -> None:
    federation, log = fsar_ledger.open_ledger(site / "log"), open_ledger(site / "log")
    assert (log.head.size, log.head.commits) == (3, 1)
    for provenance in (federation.metrics().provenance, federation.sql("SELECT 1 AS one").provenance):
        assert provenance.head is not None
        assert (provenance.head.size, provenance.head.root) == (3, log.head.root)
        assert provenance.head.events == sum(open_ledger(site / name).head.size for name in NAMES)


@pytest.mark.slow
@pytest.mark.usefixtures("cached")
def test_rows_are_verified_once_verify_has_looked_at_every_shard(site_copy: Path) -> None:
    federation = fsar_ledger.open_ledger(site_copy / "log")
    assert federation.metrics().provenance.rows_verified is False
    assert federation.verify().ok
    assert federation.metrics().provenance.rows_verified is True
    assert fsar_ledger.open_ledger(site_copy / "log", verified=True).audit().provenance.rows_verified is True
    fsar_ledger.open_ledger(site_copy / "west").compact()
    assert federation.metrics().provenance.rows_verified is False


@pytest.mark.slow
def test_every_run_of_every_shard_is_played_again(site: Path) -> None:
    found = fsar_ledger.open_ledger(site / "log").verify(replay=True)
    assert found.replay is not None
    assert (found.ok, found.replay.runs, found.report.shards, found.report.runs) == (True, 12, 3, 12)


def test_a_robot_alone_is_a_shard_beside_its_fleet(tmp_path: Path) -> None:
    site = Site(tmp_path)
    site.hall.close()
    hall = fsar_ledger.federate(
        tmp_path / "fleet", run="morning", clock=lambda: site.now * 10**9, origin="example.org/hall"
    )
    site.task(hall, DRIVE)
    given = {"isolated": A, "of": tmp_path / "fleet", "origin": "example.org/a1"}
    with site.opened("a1", "A1", **given) as own:
        site.does(own, "t1/1.1")
        fields = fsar_ledger.open_ledger(tmp_path / "a1").hand_over()
    site.tell(hall, A, "HandOver", **fields)
    hall.close()
    fsar_ledger.shards(tmp_path / "log", [tmp_path / "fleet", tmp_path / "a1"])
    federation = fsar_ledger.open_ledger(tmp_path / "log")
    assert federation.verify(replay=True).ok
    assert [*federation.numbers()] == ["morning", "A1"]
    assert federation.log(run="A1").rows() == fsar_ledger.open_ledger(tmp_path / "a1").log(run="A1").rows()
    assert federation.prove("A1:1").log is not None


# --- recording ---


@pytest.mark.slow
def test_recording_again_changes_nothing_until_a_shard_has_grown(site_copy: Path, runs: list[LedgerRun]) -> None:
    before = fsar_ledger.shards(site_copy / "log")
    assert (before.recorded, before.head.size) == ((), 3)
    more = msgspec.structs.replace(runs[5], run_id="one more")
    append(site_copy / "west", [more])
    federation = fsar_ledger.open_ledger(site_copy / "log")
    with pytest.raises(UsageError, match=r"it has grown: run fsar-ledger shards .*log to record it"):
        federation.metrics()
    found = federation.verify()
    assert found.ok
    new = len(more.events)
    events = sum(len(run.events) for run in parts(runs)[1]) + new
    told = f"{events:,} events of 5 runs, model version 3; {events - new:,} of them are recorded, run fsar-ledger"
    assert any(told in remark for remark in found.report.remarks)
    after = fsar_ledger.shards(site_copy / "log")
    assert (after.recorded, after.head.size) == ((origin("west"),), 4)
    assert "one more" in federation.numbers()
    assert federation.verify(anchor=None).ok


def test_a_log_keeps_its_origin(site_copy: Path) -> None:
    with pytest.raises(UsageError, match=r"found a ledger of origin .*, expected 'example.org/other'"):
        fsar_ledger.shards(site_copy / "log", origin="example.org/other")


def test_a_shard_may_be_moved(site_copy: Path) -> None:
    (site_copy / "west").rename(site_copy / "moved")
    fsar_ledger.shards(site_copy / "log", [site_copy / "moved"])
    assert heads_of(open_ledger(site_copy / "log"))[-1].folder == "../moved"
    assert fsar_ledger.open_ledger(site_copy / "log").verify().ok


def test_a_ledger_holds_heads_or_runs_and_never_both(site_copy: Path, runs: list[LedgerRun]) -> None:
    with pytest.raises(InvalidRun, match=r"heads of shards alone, .*; name the ledger of a shard"):
        append(site_copy / "log", [runs[0]], "fsar-ledger/federation")
    head = heads_of(open_ledger(site_copy / "log"))[0]
    with pytest.raises(InvalidRun, match="found the head of a shard, expected runs and plans alone"):
        append(site_copy / "west", [record_of_head(head)])


def test_of_two_who_record_at_once_one_is_told_to_look_again(
    site_copy: Path, runs: list[LedgerRun], monkeypatch: pytest.MonkeyPatch
) -> None:
    append(site_copy / "west", [msgspec.structs.replace(runs[5], run_id="one more")])
    found = opening.present

    def late(log: Path, heads: Sequence[shards.ShardHead], places: Sequence[Path]) -> opening.Present:
        mine = found(log, heads, places)
        monkeypatch.setattr(opening, "present", found)
        append(site_copy / "west", [msgspec.structs.replace(runs[5], run_id="and more")])
        fsar_ledger.shards(site_copy / "log")
        return mine

    monkeypatch.setattr(opening, "present", late)
    with pytest.raises(SequenceConflict, match="the log has meanwhile grown"):
        fsar_ledger.shards(site_copy / "log")
    assert open_ledger(site_copy / "log").head.size == 4
    assert "and more" in fsar_ledger.open_ledger(site_copy / "log").numbers()


def test_a_ledger_of_runs_is_no_log(site_copy: Path) -> None:
    with pytest.raises(UsageError, match="found a ledger of runs, expected a new folder"):
        fsar_ledger.shards(site_copy / "west", [site_copy / "south"])


def test_what_follows_a_growing_ledger_does_not_follow_a_federation(site: Path) -> None:
    with pytest.raises(UsageError, match="found a federation, expected one ledger to follow"):
        [*fsar_ledger.open_ledger(site / "log").stream_log(pause=lambda: None)]


def test_memory_and_workers_are_those_that_the_shards_are_worth(site: Path) -> None:
    assert stored(site / "log") == sum(segment_bytes(site / name) for name in ("log", *NAMES))


@pytest.mark.slow
def test_runs_that_continue_each_other_in_two_shards_are_one(
    runs: list[LedgerRun], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    commands, ends_us = commands_of(2)
    cut = list(open_ledger(Day(tmp_path / "parts").plays(commands, (20, 50), ends_us).ledger).runs())
    append(tmp_path / "whole", [*runs[:2], *cut, runs[2]])
    append(tmp_path / "first", [*runs[:2], cut[0]])
    append(tmp_path / "second", [*cut[1:], runs[2]])
    fsar_ledger.shards(tmp_path / "log", [tmp_path / "first", tmp_path / "second"])
    whole, federation = (fsar_ledger.Ledger(tmp_path / name) for name in ("whole", "log"))
    assert federation.numbers() == whole.numbers()
    assert federation.log(run="hall").rows() == whole.log(run="hall").rows()
    assert msgspec.structs.asdict(federation.record("hall.3")) == msgspec.structs.asdict(whole.record("hall.3"))
    found = (whole.metrics().rows(), whole.audit().table().rows())
    assert (federation.metrics().rows(), federation.audit().table().rows()) == found
    monkeypatch.setattr(database, "SLICE_EVENTS", 1_500)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert (federation.metrics().rows(), federation.audit().table().rows()) == found
    apart = [one for one in Slices(open_for_answers(tmp_path / "log"))._slices if one.digest is None]
    assert [run.run for one in apart for run in one.runs] == ["hall", "hall.2", "hall.3"]
