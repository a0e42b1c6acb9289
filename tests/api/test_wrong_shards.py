"""Whatever is wrong with a shard of a federation has a name, and nothing is answered or recorded."""

import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import msgspec
import pytest

import fsar_ledger
from fsar_ledger.base.errors import LedgerCorrupted, UsageError
from fsar_ledger.cli.app import run
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.store import shards
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.shards import ShardHead, heads_of, record_of_head
from tests.api.sites import append, origin, parts
from tests.cli.test_hidden_runs import doctor
from tests.ledger.hostile import stage_anything
from tests.ledger.samples import contents
from tests.quick import few


def older(path: Path, runs: Sequence[LedgerRun]) -> None:
    """Put a ledger in the place of another, with its origin and these runs."""
    name = open_ledger(path).manifest.origin
    shutil.rmtree(path)
    append(path, runs, name)


def lost(site_copy: Path, _: list[LedgerRun]) -> None:
    shutil.rmtree(site_copy / "west")


def late(site_copy: Path, runs: list[LedgerRun]) -> None:
    older(site_copy / "west", parts(runs)[1][:2])


def swapped(site_copy: Path, _: list[LedgerRun]) -> None:
    (site_copy / "west").rename(site_copy / "other")
    (site_copy / "south").rename(site_copy / "west")
    (site_copy / "other").rename(site_copy / "south")


def of_another_origin(site_copy: Path, runs: list[LedgerRun]) -> None:
    shutil.rmtree(site_copy / "west")
    append(site_copy / "west", parts(runs)[1], "example.org/elsewhere")


def of_another_history(site_copy: Path, runs: list[LedgerRun]) -> None:
    older(site_copy / "west", [*reversed(parts(runs)[1])])


def rewritten_and_shorter(site_copy: Path, runs: list[LedgerRun]) -> None:
    """Record more of a shard, and put fewer events of another history in its place."""
    append(site_copy / "west", [msgspec.structs.replace(runs[at], run_id=f"more {at}") for at in (4, 5)])
    fsar_ledger.shards(site_copy / "log")
    older(site_copy / "west", [*reversed(parts(runs)[1]), msgspec.structs.replace(runs[5], run_id="one more")])


def replayed(site_copy: Path, runs: list[LedgerRun]) -> None:
    """Record more of a shard, and put its earlier state back."""
    shutil.copytree(site_copy / "west", site_copy / "kept")
    append(site_copy / "west", [msgspec.structs.replace(runs[5], run_id="one more")])
    fsar_ledger.shards(site_copy / "log")
    shutil.rmtree(site_copy / "west")
    (site_copy / "kept").rename(site_copy / "west")


def recorded(site_copy: Path, *heads: ShardHead) -> None:
    """Put heads into the log that `shards` would refuse."""
    with Writer(site_copy / "log", "fsar-ledger/federation") as writer:
        writer.append(stage_anything(site_copy / "log", [record_of_head(head) for head in heads]))


def replayed_in_the_log(site_copy: Path, runs: list[LedgerRun]) -> None:
    """Let the log say that a shard went back."""
    head = heads_of(open_ledger(site_copy / "log"))[1]
    early = append(site_copy / "early", parts(runs)[1][:2], head.origin)
    now = open_ledger(early).head
    shutil.rmtree(early)
    recorded(site_copy, ShardHead(head.origin, head.folder, now.size, now.root, 3))


def shown_twice(site_copy: Path, runs: list[LedgerRun]) -> None:
    """Put the runs of a shard into the log once more, under another origin."""
    again = append(site_copy / "again", parts(runs)[1])
    head = open_ledger(again).head
    recorded(site_copy, ShardHead(origin("again"), "../again", head.size, head.root, 3))


def nested(site_copy: Path, _: list[LedgerRun]) -> None:
    with Writer(site_copy / "inner", "example.org/inner") as writer:
        writer.add([record_of_head(heads_of(open_ledger(site_copy / "log"))[0])])
    head = open_ledger(site_copy / "inner").head
    recorded(site_copy, ShardHead("example.org/inner", "../inner", head.size, head.root, 3))


def with_a_past_that_never_was(site_copy: Path, _: list[LedgerRun]) -> None:
    """Let the log have a head between the true ones, of a root that the shard never had."""
    head = heads_of(open_ledger(site_copy / "log"))[1]
    with Writer(site_copy / "false", "fsar-ledger/federation") as writer:
        writer.add([record_of_head(msgspec.structs.replace(head, shard_events=7, shard_root="7" * 64, index=0))])
        writer.add([record_of_head(msgspec.structs.replace(head, index=1))])
    shutil.rmtree(site_copy / "log")
    (site_copy / "false").rename(site_copy / "log")


CLASSES: dict[Callable[[Path, list[LedgerRun]], None], str] = {
    lost: shards.MISSING,
    late: shards.LATE,
    swapped: shards.SWAPPED,
    of_another_origin: shards.OTHER_ORIGIN,
    of_another_history: shards.OTHER_HISTORY,
    rewritten_and_shorter: shards.OTHER_HISTORY,
    replayed: shards.REPLAYED,
    replayed_in_the_log: shards.REPLAYED,
    shown_twice: shards.TWICE,
    nested: shards.NESTED,
}


@pytest.mark.parametrize("harm", few(CLASSES, [lost, swapped, rewritten_and_shorter]))
def test_what_is_wrong_with_a_shard_is_named_and_nothing_is_answered(
    site_copy: Path, runs: list[LedgerRun], harm: Callable[[Path, list[LedgerRun]], None]
) -> None:
    federation = fsar_ledger.open_ledger(site_copy / "log")
    harm(site_copy, runs)
    found = federation.verify()
    assert not found.ok
    assert found.root is None
    first = found.problems[0]
    assert first.found.startswith(f"{CLASSES[harm]}: ")
    assert (first.where, first.expected) != ("", "")
    with pytest.raises(LedgerCorrupted, match=f"found {CLASSES[harm]}: .*run fsar-ledger verify"):
        federation.metrics()
    assert run(["verify", str(site_copy / "log")]) == 3


@pytest.mark.parametrize("harm", [lost, late, swapped, of_another_origin, of_another_history, replayed])
def test_nothing_is_recorded_of_a_shard_that_does_not_go_on_from_its_head(
    site_copy: Path, runs: list[LedgerRun], harm: Callable[[Path, list[LedgerRun]], None]
) -> None:
    harm(site_copy, runs)
    size = open_ledger(site_copy / "log").head.size
    with pytest.raises(LedgerCorrupted, match=f"found {CLASSES[harm]}: .*; nothing was recorded"):
        fsar_ledger.shards(site_copy / "log")
    assert open_ledger(site_copy / "log").head.size == size


def test_a_ledger_is_recorded_once_under_one_origin(site_copy: Path, runs: list[LedgerRun]) -> None:
    shutil.copytree(site_copy / "west", site_copy / "twin")
    with pytest.raises(UsageError, match=r"shown twice: found a ledger of origin example\.org/west"):
        fsar_ledger.shards(site_copy / "log", [site_copy / "twin"])
    append(site_copy / "again", parts(runs)[1])
    with pytest.raises(UsageError, match=r"shown twice: run .* which shard example\.org/west also holds"):
        fsar_ledger.shards(site_copy / "log", [site_copy / "again"])
    with pytest.raises(UsageError, match="a federation itself"):
        fsar_ledger.shards(site_copy / "log", [site_copy / "log"])
    with pytest.raises(UsageError, match="expected at least one LEDGER"):
        fsar_ledger.shards(site_copy / "new")
    assert open_ledger(site_copy / "log").head.size == 3


def test_a_damaged_shard_is_found_by_its_own_verification(site_copy: Path) -> None:
    segment = next((site_copy / "west" / "segments").iterdir())
    data = bytearray(segment.read_bytes())
    data[len(data) // 2] ^= 1
    segment.write_bytes(data)
    [problem, *_] = fsar_ledger.open_ledger(site_copy / "log").verify().problems
    assert str(problem).startswith(f"{site_copy / 'west'}/segments/")


@pytest.mark.slow
def test_another_model_version_is_named_and_never_pooled(site_copy: Path, runs: list[LedgerRun]) -> None:
    started = msgspec.structs.replace(runs[5].events[0], model_version="2")
    other = msgspec.structs.replace(runs[5], run_id="older model", events=[started, *runs[5].events[1:]])
    append(site_copy / "old", [other])
    told = fsar_ledger.shards(site_copy / "log", [site_copy / "old"])
    assert told.models[origin("old")] == ["2"]
    federation = fsar_ledger.open_ledger(site_copy / "log")
    found = federation.verify()
    assert found.ok
    assert found.report.remarks[-1] == "shards of model versions 2, 3: no answer pools them"
    pooled = {(row["model_version"], row["metric"]): row["n"] for row in federation.metrics(pool="seeds").rows()}
    assert pooled["2", "coordination_success"] == 1
    assert {version for version, _ in pooled} == {"2", "3"}


def test_a_past_that_the_shard_never_had_is_found_by_verify(site_copy: Path, runs: list[LedgerRun]) -> None:
    with_a_past_that_never_was(site_copy, runs)
    [problem] = fsar_ledger.open_ledger(site_copy / "log").verify().problems
    assert problem.found == f"{shards.OTHER_HISTORY}: it never had the root {'7' * 64} of 7 events"


@pytest.mark.parametrize(
    "change",
    [{"shard_root": "no root"}, {"shard_events": -1}, {"origin": "two words"}, {"folder": "a\0b"}, {"origin": ""}],
)
def test_a_head_that_cannot_be_is_refused(site_copy: Path, change: dict[str, Any]) -> None:
    head = heads_of(open_ledger(site_copy / "log"))[1]
    recorded(site_copy, msgspec.structs.replace(head, index=3, **change))
    federation = fsar_ledger.Ledger(site_copy / "log")
    for ask in (federation.metrics, lambda: fsar_ledger.shards(site_copy / "log")):
        with pytest.raises(LedgerCorrupted, match=r"found event 3, .*expected a head with an origin"):
            ask()
    [problem] = federation.verify().problems
    assert "expected a head with an origin" in problem.found


@pytest.mark.slow
def test_a_shard_whose_writer_was_interrupted_is_named_where_its_log_is_recovered(
    site_copy: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, west = site_copy / "log", site_copy / "west"
    assert fsar_ledger.open_ledger(log).recover().shards == ()
    (west / "checkpoint").unlink()
    before = contents(west)
    [problem] = fsar_ledger.Ledger(log).recover().shards
    assert Path(problem.where) == west
    assert contents(west) == before
    assert run(["maintain", "recover", str(log)]) == 3
    assert str(west) in capsys.readouterr().out
    assert run(["maintain", "recover", str(west)]) == 0
    assert run(["maintain", "recover", str(log)]) == 0


@pytest.mark.parametrize("harm", [lost, late, swapped, of_another_history])
def test_a_shard_that_is_not_as_recorded_is_named_where_its_log_is_recovered(
    site_copy: Path, runs: list[LedgerRun], harm: Callable[[Path, list[LedgerRun]], None]
) -> None:
    harm(site_copy, runs)
    found = fsar_ledger.Ledger(site_copy / "log").recover()
    assert found.outcome == "whole"
    assert any(one.where.startswith(str(site_copy / "west")) for one in found.shards)


def test_a_shard_whose_writer_is_at_work_is_not_called_whole(site_copy: Path) -> None:
    with Writer(site_copy / "west", origin("west")):
        [problem] = fsar_ledger.Ledger(site_copy / "log").recover().shards
    assert "another writer" in problem.found


@pytest.mark.parametrize("verb", ["metrics", "info", "log", "audit", "verify"])
def test_an_index_that_says_that_a_log_has_runs_is_refused(
    site_copy: Path, capsys: pytest.CaptureFixture[str], verb: str
) -> None:
    log = site_copy / "log"
    fsar_ledger.open_ledger(log).compact()

    def rename(lines: list[Any]) -> None:
        lines[0]["blocks"][0]["run"] = "morning"

    doctor(log, rename)
    assert run([verb, str(log)]) == 3
    told = capsys.readouterr()
    assert (told.out, str(log) in told.err) == ("", True)
