"""The same events, however they are cut, sealed, compacted or upgraded."""

import shutil
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fsar_ledger.api.ledger import Ledger
from fsar_ledger.base.errors import InvalidRun, LedgerCorrupted
from fsar_ledger.ledger.log import pack
from fsar_ledger.ledger.log.hashing import HASH_BYTES
from fsar_ledger.ledger.log.merkle import Frontier, inclusion_proof, leaf_hash, root_of_inclusion
from fsar_ledger.ledger.log.note import Signer
from fsar_ledger.ledger.opening import open_for_answers, open_ledger
from fsar_ledger.ledger.rows import canonical
from fsar_ledger.ledger.rows.runs import LedgerRun, piece
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.derived import RunNames
from fsar_ledger.ledger.store.locations import place_of
from fsar_ledger.ledger.store.paths import CHAIN, INDEX, JOURNAL, NODES
from fsar_ledger.ledger.store.proof import check_proof, prove
from fsar_ledger.ledger.store.read import View
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.ledger.verify import recover, verify
from fsar_ledger.ledger.verify.report import VerifyOptions, read_anchor
from tests.ledger.samples import ORIGIN, append_all, contents, made_up_run
from tests.ledger.test_plan_rows import PLAN, of

RUNS = [made_up_run(f"run-{number}", 30, number) for number in range(4)]
SIGNER = Signer(ORIGIN, b"k" * 32)


def events_of(view: View) -> list[bytes]:
    """Return the canonical bytes of all events; each is found by its place, too."""
    found = [row for table in view.tables() for row in canonical.from_table(table.combine_chunks())]
    assert all(view.event(index) == found[index] for index in {0, 30, view.head.size // 2, view.head.size - 1})
    return found


def write(path: Path) -> Path:
    """Write a ledger with two segments, of which the second ends within a run, and two commits in its journal."""
    with Writer(path, ORIGIN, SIGNER) as writer:
        writer.append(stage(path, RUNS[:1]))
        writer.append(stage(path, [piece(RUNS[1], 0, 20)]))
        writer.add([piece(RUNS[1], 20, 25), piece(RUNS[2], 0, 5)])
        writer.add([piece(RUNS[2], 5, 30)])
    return path


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return write(tmp_path / "ledger")


# --- the same events ---


@settings(max_examples=4, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_however_runs_are_cut_sealed_and_compacted_rows_root_and_runs_are_the_same(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    path = tmp_path_factory.mktemp("cut") / "ledger"
    rows: list[LedgerRun] = []
    with Writer(path, ORIGIN) as writer:
        for run in RUNS[:2]:
            at = 0
            while at < len(run.events):
                end = min(len(run.events), at + data.draw(st.integers(1, 30)))
                how = data.draw(st.sampled_from(["add", "append", "seal", "compact"]))
                one = piece(run, at, end)
                writer.append(stage(path, [one])) if how == "append" else writer.add([one])
                rows.append(one)
                at = end
                if how == "seal":
                    writer.seal()
                elif how == "compact":
                    writer.compact()
    append_all(path.with_name("whole"), [RUNS[:2]])
    found, expected = open_for_answers(path), open_for_answers(path.with_name("whole"))
    assert (found.head.size, found.head.root) == (expected.head.size, expected.head.root)
    assert events_of(found) == events_of(expected)
    assert list(found.runs()) == list(expected.runs()) == RUNS[:2]
    assert found.run_names == expected.run_names == RunNames(("run-0", "run-1"))
    assert [found.ordinal_of(run) for run in ("run-0", "run-1", "run-2")] == [1, 2, 0]
    events = [msgspec.json.decode(event) for event in events_of(found)]
    for index in range(0, len(events), 11):
        assert place_of(found, events[index]["run_id"], events[index]["seq"]) == index
    assert isinstance(found, View)
    assert all(found.chain.index_lines((path / INDEX).read_bytes() if found.chain.placed else b""))
    report = verify(path)
    assert (report.ok, report.problems, report.remarks, report.runs) == (True, (), (), 2)
    assert report.commits == len(rows)


@given(st.lists(st.integers(1, 300), min_size=1, max_size=8))
def test_the_pack_gives_every_proof_of_every_tree_that_it_grew_through(sizes: list[int]) -> None:
    leaves = [leaf_hash(b"%d" % number) for number in range(sum(sizes))]
    tree, held = Frontier(), b""
    for size in sizes:
        tree, more = pack.grow(tree, b"".join(leaves[tree.size : tree.size + size]))
        held += more
        assert len(held) == pack.count(tree.size) * HASH_BYTES
        assert tree == Frontier().extend(b"".join(leaves[: tree.size]))

    def read(place: int) -> bytes:
        return held[place * HASH_BYTES : (place + 1) * HASH_BYTES]

    node = pack.node_of(read, lambda first, end: b"".join(leaves[first:end]))
    for index in {0, tree.size // 2, tree.size - 1}:
        proof = inclusion_proof(node, index, tree.size)
        assert root_of_inclusion(leaves[index], index, tree.size, proof) == tree.root()


@pytest.mark.slow
def test_proofs_and_anchors_that_were_given_still_hold_after_sealing_and_compaction(path: Path) -> None:
    view = open_for_answers(path)
    proofs = [prove(view, index) for index in range(0, view.head.size, 7)]
    shutil.copy(path / "checkpoint", path.with_name("anchor"))
    with Writer(path, ORIGIN, SIGNER) as writer:
        assert writer.compact() == 3
        writer.add([piece(RUNS[1], 25, 30)])
    assert [file.name for file in (path / "segments").iterdir()] == ["000000000000-000000000085.parquet"]
    for number, proof in enumerate(proofs):
        assert check_proof("a proof", proof, SIGNER.verifier).event["seq"] is not None
        again = prove(open_for_answers(path), number * 7)
        assert again.event == proof.event
    for quick in (False, True):
        asked = VerifyOptions(is_quick=quick, anchor=read_anchor(path.with_name("anchor")), trusted=SIGNER.verifier)
        report = verify(path, asked=asked)
        assert (report.ok, report.anchored, report.signature) == (True, 85, "signed"), report.problems


# --- the index ---


CHANGES: dict[str, Callable[[bytes], bytes]] = {
    "gone": lambda data: b"",
    "cut": lambda data: data[: len(data) // 2],
    "renamed": lambda data: data.replace(b"run-1", b"run-9"),
    "swapped": lambda data: b"".join(reversed(data.splitlines(keepends=True))),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_whatever_the_index_holds_a_reader_finds_each_run_and_recover_makes_it_again(
    path: Path, change: Callable[[bytes], bytes]
) -> None:
    before = open_for_answers(path)
    names, parts = before.run_names, [before.parts(run.run_id) for run in RUNS]
    data = (path / INDEX).read_bytes()
    (path / INDEX).write_bytes(change(data))
    after = open_for_answers(path)
    assert after.run_names == names == RunNames(("run-0", "run-1", "run-2"))
    assert [after.parts(run.run_id) for run in RUNS] == parts
    assert [sum(part.block.rows for part in one) for one in parts] == [30, 25, 30, 0]
    report = verify(path)
    assert [problem.where for problem in report.problems] == [INDEX]
    recover(path)
    assert (path / INDEX).read_bytes() == data
    assert verify(path).problems == ()


def test_a_run_has_its_number_among_runs_and_a_plan_has_none(tmp_path: Path) -> None:
    names = ["run", 'run"first":0,', '{"first":0,"first_us":1', "run\\", '"is_alone":true,']
    runs = [made_up_run(name, 12, number) for number, name in enumerate(names)]
    plan = of("a plan", PLAN)
    path = tmp_path / "ledger"
    with Writer(path, ORIGIN) as writer:
        writer.append(stage(path, [piece(runs[0], 0, 6), piece(runs[1], 0, 6)]))
        writer.append(stage(path, [plan, piece(runs[0], 6, 12), runs[2]]))
        writer.add([piece(runs[1], 6, 12), runs[3]])
        writer.add([runs[4]])
    view = open_for_answers(path)
    assert view.run_names == RunNames(tuple(names), ("a plan",))
    assert [view.ordinal_of(name) for name in (*names, "a plan", "ru", "run-0")] == [1, 2, 3, 4, 5, 0, 0, 0]


def test_a_placement_with_another_line_of_the_index_than_the_rows_have_is_found(tmp_path: Path) -> None:
    path = tmp_path / "ledger"
    with Writer(path, ORIGIN) as writer:
        staged = stage(path, RUNS[:2])
        first, second = staged.blocks
        writer.append(msgspec.structs.replace(staged, blocks=(first, msgspec.structs.replace(second, rows=29))))
    report = verify(path)
    assert [(problem.where, problem.field) for problem in report.problems] == [(CHAIN, "index_sha256")]


@pytest.mark.slow
def test_a_question_about_one_run_reads_only_the_segments_that_hold_it(path: Path) -> None:
    ledger = Ledger(path)
    told = [ledger.prove("run-1:3").event, ledger.record("run-1"), ledger.log("run-1").rows()]
    first, _ = sorted((path / "segments").iterdir())
    first.write_bytes(b"damaged".ljust(first.stat().st_size, b"."))
    assert [ledger.prove("run-1:3").event, ledger.record("run-1"), ledger.log("run-1").rows()] == told
    for asked in (lambda: ledger.record("run-0"), lambda: ledger.log("all"), lambda: ledger.prove("run-0:3")):
        with pytest.raises(LedgerCorrupted, match=first.name):
            asked()


# --- several writers ---


def test_writers_take_turns_and_each_goes_on_from_what_the_other_added(tmp_path: Path) -> None:
    path = tmp_path / "ledger"
    with Writer(path, ORIGIN) as one, Writer(path, ORIGIN) as other:
        for at in range(0, 30, 10):
            one.add([piece(RUNS[0], at, at + 10)])
            other.append(stage(path, [piece(RUNS[1], at, at + 10)]))
            one.seal()
        assert other.compact() > 0
        one.add([RUNS[2]])
    assert sorted(run.run_id for run in open_for_answers(path).runs()) == ["run-0", "run-1", "run-2"]
    assert verify(path).ok


# --- what is refused ---


@pytest.mark.parametrize(
    ("pieces", "found"),
    [
        ([made_up_run("run-0", 12, 9)], "run run-0, seq 0, field run_id: found run run-0 once more"),
        ([piece(RUNS[1], 24, 28)], "run run-1, seq 24, field seq: found 24, expected 25"),
        ([piece(RUNS[1], 26, 28)], "run run-1, seq 26, field seq: found 26, expected 25"),
        ([piece(RUNS[3], 5, 28)], "run run-3, seq 5, field seq: found 5, expected 0"),
        ([piece(RUNS[3], 0, 5), piece(RUNS[3], 5, 9)], "the run twice in one batch"),
        (
            [msgspec.structs.replace(piece(RUNS[1], 25, 27), times_us=[0, 1])],
            "run run-1, seq 25, field time_us: found 0, expected no less than at the event before",
        ),
    ],
)
def test_events_that_do_not_continue_their_run_are_refused_and_nothing_changes(
    path: Path, pieces: Sequence[LedgerRun], found: str
) -> None:
    before = contents(path)
    with Writer(path, ORIGIN, SIGNER) as writer:
        with pytest.raises(InvalidRun) as refused:
            writer.add(pieces)
        assert found in str(refused.value)
        if len(pieces) == 1:
            with pytest.raises(InvalidRun) as refused:
                writer.append(stage(path, pieces))
            assert found in str(refused.value)
    assert contents(path) == before


def test_a_run_that_has_ended_is_never_continued(path: Path) -> None:
    longer = made_up_run("run-2", 40, 2)
    more = LedgerRun("run-2", longer.times_us[30:], longer.caused_by[30:], longer.events[30:], 30)
    later = msgspec.structs.replace(more, times_us=[60_000_000] * 10)
    with Writer(path, ORIGIN, SIGNER) as writer, pytest.raises(InvalidRun, match="a run that has ended"):
        writer.add([later])


# --- torn ends and damage ---


def test_a_torn_end_of_the_journal_is_no_commit_and_the_next_writer_removes_it(path: Path) -> None:
    whole = open_for_answers(path)
    data = (path / JOURNAL).read_bytes()
    (path / "checkpoint").write_text(str(whole.commits[2].note(ORIGIN)))
    for cut in range(len(data) - 1, len(data) - 600, -97):
        (path / JOURNAL).write_bytes(data[:cut])
        view = open_for_answers(path)
        assert (view.head.commits, view.head.size) == (3, 60)
        assert verify(path).ok
    with Writer(path, ORIGIN, SIGNER) as writer:
        assert writer.head.size == 60
        writer.add([piece(RUNS[2], 5, 30)])
    assert open_for_answers(path).head.root == whole.head.root
    assert verify(path).remarks == ()


def test_a_reader_refuses_a_ledger_whose_chain_was_cut(path: Path) -> None:
    lines = (path / CHAIN).read_bytes().splitlines(keepends=True)
    (path / CHAIN).write_bytes(b"".join(lines[:2]))
    with pytest.raises(LedgerCorrupted):
        open_for_answers(path)
    assert not verify(path).ok


@pytest.mark.slow
def test_a_reader_proves_any_event_while_the_pack_lacks_what_an_interrupted_append_leaves_out(path: Path) -> None:
    with Writer(path, ORIGIN, SIGNER) as writer:
        writer.seal()
        before = (path / NODES).read_bytes()
        writer.append(stage(path, RUNS[3:]))
        writer.add([made_up_run("run-4", 10, 4)])
    (path / NODES).write_bytes(before)
    view = open_ledger(path)
    ends = {commit.tree_size for commit in view.commits}
    some = {*range(0, view.head.size, 7), *ends, *(end - 1 for end in ends)} - {view.head.size}
    for index in sorted(some):
        assert check_proof("a proof", prove(view, index), SIGNER.verifier).index == index
    (path / NODES).write_bytes(before[:-HASH_BYTES])
    with pytest.raises(LedgerCorrupted, match="recover, which derives it again"):
        list(map(partial(prove, open_ledger(path)), sorted(some)))
