"""A federation answers as one ledger with the events of its shards; whatever is wrong with a shard is named."""

import os
import re
import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import msgspec
import pytest

import fsar_ledger
from fsar_ledger.base.errors import FsarLedgerError, InvalidRun, LedgerCorrupted, UsageError
from fsar_ledger.cli.app import run
from fsar_ledger.ledger.log.merkle import leaf_hash
from fsar_ledger.ledger.log.note import Checkpoint, Note, Signer
from fsar_ledger.ledger.opening import open_checked, open_for_answers, open_ledger
from fsar_ledger.ledger.rows import canonical
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.store import shards
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.proof import Proof, check_proof, parse_proof, prove
from fsar_ledger.ledger.store.shards import ShardHead, heads_of, record_of_head
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.metrics import slices
from fsar_ledger.metrics.database import Database, connect
from fsar_ledger.metrics.library import library
from fsar_ledger.metrics.slices import Slice, Slices
from fsar_ledger.runtime.experiment import Experiment, run_experiment
from tests.ledger.agreement import independent
from tests.quick import few
from tests.runtime.test_isolation import DRIVE, A, Site

WHOLE = Experiment(("fsar", "cfc", "dhma"), ("door-relay", "fleet-contention"), 2, 7)
NAMES = ("north", "west", "south")


def origin(name: str) -> str:
    return f"example.org/{name}"


def append(path: Path, runs: Sequence[LedgerRun], name: str | None = None) -> Path:
    with Writer(path, name or origin(path.name)) as writer:
        for run in runs:
            writer.append(stage(path, [run]))
    return path


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> list[LedgerRun]:
    """A plan and twelve runs, in the order in which the one ledger has them."""
    path = tmp_path_factory.mktemp("runs") / "ledger"
    run_experiment(path, WHOLE, 1)
    return list(open_ledger(path).runs())


def parts(runs: Sequence[LedgerRun]) -> list[Sequence[LedgerRun]]:
    return [runs[:5], runs[5:9], runs[9:]]


@pytest.fixture(scope="module")
def whole(runs: list[LedgerRun], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return append(tmp_path_factory.mktemp("whole") / "ledger", runs)


@pytest.fixture(scope="module")
def site(runs: list[LedgerRun], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of three ledgers with a third of the runs each, and of the log of their federation."""
    path = tmp_path_factory.mktemp("site")
    for name, part in zip(NAMES, parts(runs), strict=True):
        append(path / name, part)
    fsar_ledger.record_shards(path / "log", [path / name for name in NAMES])
    return path


@pytest.fixture
def copy(site: Path, tmp_path: Path) -> Path:
    """The same folder, to be changed."""
    return Path(shutil.copytree(site, tmp_path / "site"))


# --- as one ledger ---


def answers(path: Path) -> dict[str, Any]:
    """Return what verbs answer that are about all runs, without the head."""
    of = fsar_ledger.open_ledger(path)
    found: dict[str, Any] = {
        "metrics": of.metrics().rows(),
        "by scenario": of.metrics(by="scenario", pool="seeds").rows(),
        "statistics": of.statistics().table().rows(),
        "audit": of.audit().table().rows(),
        "compare": of.compare("fsar", "cfc").table().rows(),
        "multiverse": of.multiverse(metric=["policy_violations"]).table().rows(),
        "runs": of.runs().rows(),
        "numbers": of.numbers(),
        "query": of.query("audit/denials", run=7).rows(),
        "sql": of.sql("SELECT type, count(*) AS n FROM events GROUP BY type ORDER BY ALL").rows(),
        "log": [row for table in of.stream_log() for row in table.rows()],
        "events": of.events(run=9).table().rows(),
        "requests": of.requests(run=9).rows(),
        "record": msgspec.structs.asdict(of.record(6)),
    }
    info = of.info()
    return found | {"info": (info.groups, info.models, info.plans, info.missing, info.not_observed)}


@pytest.fixture
def cached(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


@pytest.mark.usefixtures("cached")
@pytest.mark.parametrize("most", [1 << 30, 1_500])
def test_a_federation_answers_as_the_one_ledger(
    whole: Path, site: Path, most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = answers(whole)
    monkeypatch.setattr(slices, "SLICE_EVENTS", most)
    assert answers(site / "log") == expected
    assert answers(site / "log") == expected  # from the cache, where there is one
    of_shards = [len(Slices(open_for_answers(site / name))) for name in NAMES]
    assert len(Slices(open_for_answers(site / "log"))) == sum(of_shards)
    assert all(of_shards) is (most == 1_500)


@pytest.fixture(scope="module")
def both(whole: Path, site: Path) -> Iterator[tuple[Database, Database]]:
    with connect(whole) as one, connect(site / "log") as federation:
        yield one, federation


SAMPLE = ("staging/runs", "facts/decisions", "metrics/run_metrics", "invariants/i3_jointly_composed_policy")


@pytest.mark.parametrize(
    "name", few([name for name, query in library().queries.items() if not query.parameters], SAMPLE)
)
def test_every_query_answers_as_of_the_one_ledger(name: str, both: tuple[Database, Database]) -> None:
    one, federation = both
    assert federation.query(name).equals(one.query(name))


@pytest.mark.usefixtures("cached")
def test_what_is_known_of_a_shard_alone_is_known_of_it_in_the_federation(
    site: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(slices, "SLICE_EVENTS", 1_500)
    seen: list[Path] = []
    connect_slice = Slices._connect

    def looked(self: Slices, one: Slice) -> Database:
        seen.append(one.view.path)
        return connect_slice(self, one)

    monkeypatch.setattr(Slices, "_connect", looked)
    for name in ("north", "south"):
        fsar_ledger.open_ledger(site / name).metrics()
    assert {path.name for path in seen} == {"north", "south"}
    seen.clear()
    fsar_ledger.open_ledger(site / "log").metrics()
    assert {path.name for path in seen} == {"west"}


def test_each_answer_names_the_head_of_the_log(site: Path) -> None:
    federation, log = fsar_ledger.open_ledger(site / "log"), open_ledger(site / "log")
    assert (log.head.size, log.head.commits) == (3, 1)
    for provenance in (federation.metrics().provenance, federation.sql("SELECT 1 AS one").provenance):
        assert provenance.head is not None
        assert (provenance.head.size, provenance.head.root) == (3, log.head.root)
        assert provenance.head.events == sum(open_ledger(site / name).head.size for name in NAMES)


@pytest.mark.usefixtures("cached")
def test_rows_are_verified_once_verify_has_looked_at_every_shard(copy: Path) -> None:
    federation = fsar_ledger.open_ledger(copy / "log")
    assert federation.metrics().provenance.rows_verified is False
    assert federation.verify().ok
    assert federation.metrics().provenance.rows_verified is True
    assert fsar_ledger.open_ledger(copy / "log", verified=True).audit().provenance.rows_verified is True
    fsar_ledger.open_ledger(copy / "west").compact()
    assert federation.metrics().provenance.rows_verified is False


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
    fsar_ledger.record_shards(tmp_path / "log", [tmp_path / "fleet", tmp_path / "a1"])
    federation = fsar_ledger.open_ledger(tmp_path / "log")
    assert federation.verify(replay=True).ok
    assert [*federation.numbers()] == ["morning", "A1"]
    assert federation.log(run="A1").rows() == fsar_ledger.open_ledger(tmp_path / "a1").log(run="A1").rows()
    assert federation.prove("A1:1").log is not None


# --- recording ---


def test_recording_again_changes_nothing_until_a_shard_has_grown(copy: Path, runs: list[LedgerRun]) -> None:
    before = fsar_ledger.record_shards(copy / "log")
    assert (before.recorded, before.head.size) == ((), 3)
    more = msgspec.structs.replace(runs[5], run_id="one more")
    append(copy / "west", [more])
    federation = fsar_ledger.open_ledger(copy / "log")
    with pytest.raises(UsageError, match=r"it has grown: run fsar-ledger shards .*log, which records it"):
        federation.metrics()
    found = federation.verify()
    assert found.ok
    assert any("more since, run fsar-ledger shards" in remark for remark in found.report.remarks)
    after = fsar_ledger.record_shards(copy / "log")
    assert (after.recorded, after.head.size) == ((origin("west"),), 4)
    assert "one more" in federation.numbers()
    assert federation.verify(anchor=None).ok


def test_a_shard_may_be_moved(copy: Path) -> None:
    (copy / "west").rename(copy / "moved")
    fsar_ledger.record_shards(copy / "log", [copy / "moved"])
    assert heads_of(open_ledger(copy / "log"))[-1].folder == "../moved"
    assert fsar_ledger.open_ledger(copy / "log").verify().ok


def test_a_ledger_holds_heads_or_runs_and_never_both(copy: Path, runs: list[LedgerRun]) -> None:
    with pytest.raises(InvalidRun, match="found a run, expected heads of shards alone"):
        append(copy / "log", [runs[0]], "fsar-ledger/federation")
    head = heads_of(open_ledger(copy / "log"))[0]
    with pytest.raises(InvalidRun, match="found the head of a shard, expected runs and plans alone"):
        append(copy / "west", [record_of_head(head)])


def test_what_follows_a_growing_ledger_does_not_follow_a_federation(site: Path) -> None:
    with pytest.raises(UsageError, match="found a federation, expected one ledger to follow"):
        [*fsar_ledger.open_ledger(site / "log").stream_log(pause=lambda: None)]


# --- what may be wrong with a shard ---


def older(path: Path, runs: Sequence[LedgerRun]) -> None:
    """Put a ledger in the place of another, with its origin and these runs."""
    name = open_ledger(path).manifest.origin
    shutil.rmtree(path)
    append(path, runs, name)


def lost(copy: Path, _: list[LedgerRun]) -> None:
    shutil.rmtree(copy / "west")


def late(copy: Path, runs: list[LedgerRun]) -> None:
    older(copy / "west", parts(runs)[1][:2])


def swapped(copy: Path, _: list[LedgerRun]) -> None:
    (copy / "west").rename(copy / "other")
    (copy / "south").rename(copy / "west")
    (copy / "other").rename(copy / "south")


def of_another_origin(copy: Path, runs: list[LedgerRun]) -> None:
    shutil.rmtree(copy / "west")
    append(copy / "west", parts(runs)[1], "example.org/elsewhere")


def of_another_history(copy: Path, runs: list[LedgerRun]) -> None:
    older(copy / "west", [*reversed(parts(runs)[1])])


def replayed(copy: Path, runs: list[LedgerRun]) -> None:
    """Record more of a shard, and put its earlier state back."""
    shutil.copytree(copy / "west", copy / "kept")
    append(copy / "west", [msgspec.structs.replace(runs[5], run_id="one more")])
    fsar_ledger.record_shards(copy / "log")
    shutil.rmtree(copy / "west")
    (copy / "kept").rename(copy / "west")


def recorded(copy: Path, *heads: ShardHead) -> None:
    """Put heads into the log that `record_shards` would refuse."""
    with Writer(copy / "log", "fsar-ledger/federation") as writer:
        writer.add([record_of_head(head) for head in heads])


def replayed_in_the_log(copy: Path, runs: list[LedgerRun]) -> None:
    """Let the log say that a shard went back."""
    head = heads_of(open_ledger(copy / "log"))[1]
    early = append(copy / "early", parts(runs)[1][:2], head.origin)
    now = open_ledger(early).head
    shutil.rmtree(early)
    recorded(copy, ShardHead(head.origin, head.folder, now.size, now.root, 3))


def shown_twice(copy: Path, runs: list[LedgerRun]) -> None:
    """Put the runs of a shard into the log once more, under another origin."""
    again = append(copy / "again", parts(runs)[1])
    head = open_ledger(again).head
    recorded(copy, ShardHead(origin("again"), "../again", head.size, head.root, 3))


def nested(copy: Path, _: list[LedgerRun]) -> None:
    with Writer(copy / "inner", "example.org/inner") as writer:
        writer.add([record_of_head(heads_of(open_ledger(copy / "log"))[0])])
    head = open_ledger(copy / "inner").head
    recorded(copy, ShardHead("example.org/inner", "../inner", head.size, head.root, 3))


CLASSES: dict[Callable[[Path, list[LedgerRun]], None], str] = {
    lost: shards.MISSING,
    late: shards.LATE,
    swapped: shards.SWAPPED,
    of_another_origin: shards.OTHER_ORIGIN,
    of_another_history: shards.OTHER_HISTORY,
    replayed: shards.REPLAYED,
    replayed_in_the_log: shards.REPLAYED,
    shown_twice: shards.TWICE,
    nested: shards.NESTED,
}


@pytest.mark.parametrize(("harm", "named"), CLASSES.items())
def test_what_is_wrong_with_a_shard_is_named_and_nothing_is_answered(
    copy: Path, runs: list[LedgerRun], harm: Callable[[Path, list[LedgerRun]], None], named: str
) -> None:
    federation = fsar_ledger.open_ledger(copy / "log")
    harm(copy, runs)
    found = federation.verify()
    assert not found.ok
    assert found.root is None
    first = found.problems[0]
    assert first.found.startswith(f"{named}: ")
    assert (first.where, first.expected) != ("", "")
    with pytest.raises(LedgerCorrupted, match=f"found {named}: .*run fsar-ledger verify"):
        federation.metrics()
    assert run(["verify", str(copy / "log")]) == 3


@pytest.mark.parametrize("harm", [lost, late, swapped, of_another_origin, of_another_history, replayed])
def test_nothing_is_recorded_of_a_shard_that_does_not_go_on_from_its_head(
    copy: Path, runs: list[LedgerRun], harm: Callable[[Path, list[LedgerRun]], None]
) -> None:
    harm(copy, runs)
    size = open_ledger(copy / "log").head.size
    with pytest.raises(FsarLedgerError):
        fsar_ledger.record_shards(copy / "log")
    assert open_ledger(copy / "log").head.size == size


def test_a_ledger_is_recorded_once_under_one_origin(copy: Path, runs: list[LedgerRun]) -> None:
    shutil.copytree(copy / "west", copy / "twin")
    with pytest.raises(UsageError, match=r"shown twice: found a ledger of origin example\.org/west"):
        fsar_ledger.record_shards(copy / "log", [copy / "twin"])
    append(copy / "again", parts(runs)[1])
    with pytest.raises(UsageError, match=r"shown twice: run .* which shard example\.org/west holds, too"):
        fsar_ledger.record_shards(copy / "log", [copy / "again"])
    with pytest.raises(UsageError, match="a federation itself"):
        fsar_ledger.record_shards(copy / "log", [copy / "log"])
    with pytest.raises(UsageError, match="expected at least one LEDGER"):
        fsar_ledger.record_shards(copy / "new")
    assert open_ledger(copy / "log").head.size == 3


def test_a_damaged_shard_is_found_by_its_own_verification(copy: Path) -> None:
    segment = next((copy / "west" / "segments").iterdir())
    data = bytearray(segment.read_bytes())
    data[len(data) // 2] ^= 1
    segment.write_bytes(data)
    [problem, *_] = fsar_ledger.open_ledger(copy / "log").verify().problems
    assert str(problem).startswith(f"{copy / 'west'}/segments/")


def test_another_model_version_is_named_and_never_pooled(copy: Path, runs: list[LedgerRun]) -> None:
    started = msgspec.structs.replace(runs[5].events[0], model_version="2")  # type: ignore[arg-type]
    other = msgspec.structs.replace(runs[5], run_id="older model", events=[started, *runs[5].events[1:]])
    append(copy / "old", [other])
    told = fsar_ledger.record_shards(copy / "log", [copy / "old"])
    assert told.models[origin("old")] == ["2"]
    federation = fsar_ledger.open_ledger(copy / "log")
    found = federation.verify()
    assert found.ok
    assert found.report.remarks[-1] == "shards of model versions 2, 3: no answer pools them"
    pooled = {(row["model_version"], row["metric"]): row["n"] for row in federation.metrics(pool="seeds").rows()}
    assert pooled["2", "coordination_success"] == 1
    assert {version for version, _ in pooled} == {"2", "3"}


# --- proofs in two steps ---


def test_the_same_is_proven_of_an_event_as_in_its_shard(site: Path) -> None:
    federation, south = fsar_ledger.open_ledger(site / "log"), fsar_ledger.open_ledger(site / "south")
    found, own = federation.prove("12:5"), south.prove("4:5")
    assert found.log is not None
    assert msgspec.structs.replace(found, log=None) == own
    assert found.log.note == open_checked(site / "log").note()


KEY = Signer("example.org/federation", b"f" * 32)


@pytest.fixture(scope="module")
def proof(site: Path, tmp_path_factory: pytest.TempPathFactory) -> Proof:
    """An event of the shard in the south, in a log that is signed."""
    log = tmp_path_factory.mktemp("signed") / "log"
    with Writer(log, KEY.verifier.name, KEY) as writer:
        for head in heads_of(open_ledger(site / "log")):
            folder = os.path.relpath(site / "log" / head.folder, log)
            writer.add([record_of_head(msgspec.structs.replace(head, folder=folder))])
    return prove(open_for_answers(log), 8_000)


def judged(proof: Proof) -> str:
    """Return what is wrong with a proof, after the independent verifier has found something, too; or nothing."""
    by_another: str | None = None
    text = str(proof)
    try:
        independent("independent_proof").verify(text, str(KEY.verifier))
    except ValueError as error:
        by_another = str(error)
    try:
        check_proof("it", parse_proof("it", text), KEY.verifier)
    except LedgerCorrupted as error:
        assert by_another
        return str(error)
    assert by_another is None
    return ""


def test_both_steps_are_proven_and_told(proof: Proof, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert judged(proof) == ""
    proven = check_proof("it", parse_proof("it", str(proof)), KEY.verifier)
    assert (proven.origin, proven.signature) == (origin("south"), "unsigned")
    assert proven.log is not None
    assert (proven.log.origin, proven.log.signature, proven.log.index) == (KEY.verifier.name, "signed", 2)
    (tmp_path / "proof").write_text(str(proof))
    assert run(["verify-proof", str(tmp_path / "proof"), "--root", proven.log.root]) == 0
    told = capsys.readouterr().out
    assert "proven in two steps" in told
    assert f"2: this root is head 2 of 3 in the log of {KEY.verifier.name}" in told
    assert run(["verify-proof", str(tmp_path / "proof"), "--root", proven.root]) == 3


def other_leaf(proof: Proof) -> Proof:
    return msgspec.structs.replace(proof, event=proof.event.replace(b'"seq":', b'"seq":1'))


def of_other(proof: Proof, **changes: Any) -> Proof:
    """Let the first step be about a tree of one event with another origin, size or root, in which it is right."""
    tree = msgspec.structs.replace(Checkpoint(origin("south"), 1, leaf_hash(proof.event)), **changes)
    return msgspec.structs.replace(proof, index=0, hashes=(), note=Note(tree))


def in_log(proof: Proof, event: bytes) -> Proof:
    """Let the second step be about this event, alone in a log that the key signed."""
    tree = Checkpoint(KEY.verifier.name, 1, leaf_hash(event))
    return msgspec.structs.replace(proof, log=Proof(event, 0, (), Note(tree, (KEY.sign(tree),))))


def head_with(proof: Proof, **changes: object) -> bytes:
    assert proof.log is not None
    return canonical.document(msgspec.json.decode(proof.log.event) | changes)


FAILING: dict[str, tuple[Callable[[Proof], Proof], str]] = {
    "another event": (other_leaf, "step 1 .*expected one to"),
    "another place": (lambda one: msgspec.structs.replace(one, index=one.index - 1), "step 1 .*expected one to"),
    "another tree of the shard": (of_other, "found step 1 in a tree of shard_events 1, expected"),
    "another place in the log": (
        lambda one: msgspec.structs.replace(one, log=msgspec.structs.replace(one.log, index=1)),
        "step 2 .*expected one to",
    ),
    "an event that is no head": (lambda one: in_log(one, one.event), "step 2 .*expected the head of a shard"),
    "another root of the shard": (
        lambda one: in_log(one, head_with(one, shard_root="0" * 64)),
        "found step 1 in a tree of shard_root .*, expected 0000",
    ),
    "another size of the shard": (
        lambda one: in_log(one, head_with(one, shard_events=7)),
        "found step 1 in a tree of shard_events .*, expected 7",
    ),
    "the head of another shard": (
        lambda one: in_log(one, head_with(one, origin=origin("west"))),
        r"found step 1 in a tree of origin example\.org/south, expected example\.org/west",
    ),
    "a log that the key did not sign": (
        lambda one: msgspec.structs.replace(
            one,
            log=msgspec.structs.replace(one.log, note=Note(one.log.note.checkpoint)),  # type: ignore[union-attr]
        ),
        "step 2 .*found no signature",
    ),
}


@pytest.mark.parametrize("name", FAILING)
def test_a_step_that_fails_is_named_and_the_independent_verifier_agrees(proof: Proof, name: str) -> None:
    change, expected = FAILING[name]
    assert re.search(expected, judged(change(proof)))


def test_the_right_head_alone_in_a_log_is_proven_too(proof: Proof) -> None:
    assert judged(in_log(proof, head_with(proof))) == ""


def test_a_third_step_is_refused(proof: Proof) -> None:
    assert proof.log is not None
    three = msgspec.structs.replace(proof, log=msgspec.structs.replace(proof.log, log=proof.log))
    assert "no third step" in judged(three)


def test_an_event_of_another_shard_does_not_lead_to_this_one(proof: Proof, site: Path) -> None:
    west = prove(open_for_answers(site / "west"), 3)
    assert "found step 1 in a tree of origin" in judged(msgspec.structs.replace(west, log=proof.log))


def test_a_receipt_has_one_step(site: Path, tmp_path: Path) -> None:
    assert run(["key", "new", str(tmp_path / "key"), "--name", "fsar-ledger/federation"]) == 0
    with pytest.raises(UsageError, match="a receipt has one step"):
        fsar_ledger.open_ledger(site / "log").prove(3, tmp_path / "proof.cose", format="cose", key=tmp_path / "key")
