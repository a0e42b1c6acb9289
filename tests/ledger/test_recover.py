"""Recovery mends what a crash left, finds what can be trusted, and deletes nothing."""

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from fsar_ledger.base.errors import LedgerCorrupted, NotALedger, UsageError, WriteFailed
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.paths import JOURNAL
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.ledger.verify import recover, verify
from fsar_ledger.ledger.verify.report import VerifyOptions
from fsar_ledger.ledger.verify.trusted import NO_ROWS
from tests.ledger.damage import LEDGERS, SIGNER, write_closed
from tests.ledger.forgery import segment_at, staged_at
from tests.ledger.samples import ORIGIN, append_all, contents, made_up_batches
from tests.quick import few

BATCHES = made_up_batches(4, runs=2, size=20)
DERIVED = ("nodes", "index.jsonl", "checkpoint")
Files = dict[str, bytes]


@pytest.fixture(scope="module")
def three(tmp_path_factory: pytest.TempPathFactory) -> Files:
    """Return the files of a ledger of three commits."""
    path = tmp_path_factory.mktemp("three") / "ledger"
    append_all(path, BATCHES[:3])
    return contents(path)


def write(path: Path, files: Files) -> Path:
    """Write a ledger of these files and no others."""
    shutil.rmtree(path, ignore_errors=True)
    for folder in ("segments", "staging"):
        (path / folder).mkdir(parents=True)
    for name, data in files.items():
        (path / name).parent.mkdir(parents=True, exist_ok=True)
        (path / name).write_bytes(data)
    return path


def aside(path: Path) -> Files:
    """Return what was set aside, by its name within `NNN/`, from all recoveries together."""
    folder = path.with_name(f"{path.name}.set-aside")
    return {
        f"{number.name}/{name}": data for number in sorted(folder.glob("*")) for name, data in contents(number).items()
    }


def assert_nothing_lost(before: Files, path: Path) -> None:
    """Check that each file that was there is in the ledger or set aside, except leftovers in staging."""
    now = {*contents(path).values(), *aside(path).values()}
    assert [name for name, data in before.items() if data not in now and not name.startswith("staging/")] == []


def assert_like_new(path: Path, expected: Files) -> None:
    """Check that the ledger verifies without a remark, equals that of an uninterrupted writer, and can be continued."""
    report = verify(path)
    assert (report.ok, report.problems, report.remarks) == (True, (), ())
    assert contents(path) == expected
    done = open_ledger(path).head.commits
    with Writer(path, ORIGIN) as writer:
        assert writer.append(stage(path, BATCHES[done])).commits == done + 1
    assert verify(path).ok


# --- a ledger that is whole but for what can be mended ---


def test_a_whole_ledger_is_left_as_it_is(tmp_path: Path, three: Files) -> None:
    path = write(tmp_path / "ledger", three)
    found = recover(path, workers=2)
    assert (found.outcome, found.steps) == ("whole", ())
    assert (found.head.commits, found.head.root) == (3, open_ledger(path).head.root)
    assert contents(path) == three
    assert os.listdir(tmp_path) == ["ledger"]


def test_an_empty_ledger_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "ledger"
    append_all(path, [])
    assert (recover(path).outcome, recover(path).head.commits) == ("whole", 0)
    (path / "staging" / "left").write_bytes(b"over")
    (path / "checkpoint").write_bytes(b"of nothing")
    assert [(step.did, step.file) for step in recover(path).steps] == [("set aside", "checkpoint")]
    assert verify(path).ok
    assert not os.listdir(path / "staging")


@pytest.mark.parametrize("name", ["cut short", "left open", "handed over"])
def test_what_a_crash_left_is_finished(tmp_path: Path, name: str) -> None:
    LEDGERS[name](tmp_path / "ledger")
    before = open_ledger(tmp_path / "ledger").head
    found = recover(tmp_path / "ledger")
    assert found.outcome == "mended"
    assert (found.head.commits, found.head.size, found.head.root) == (before.commits, before.size, before.root)
    assert open_ledger(tmp_path / "ledger").head == before
    assert recover(tmp_path / "ledger").outcome == "whole"


def test_what_the_journal_holds_counts_whatever_else_is_mended(tmp_path: Path) -> None:
    write_closed(tmp_path / "ledger")
    head = open_ledger(tmp_path / "ledger").head
    assert (tmp_path / "ledger" / JOURNAL).exists()
    (tmp_path / "ledger" / "checkpoint").write_bytes(b"?")
    (tmp_path / "ledger" / "stray").write_bytes(b"?")
    found = recover(tmp_path / "ledger")
    assert (found.outcome, found.head.commits, found.head.root) == ("mended", head.commits, head.root)


@pytest.mark.parametrize("first", [b'{"kind":"comm\xf4t"}\n', b'{"kind":' + b"[" * 5000 + b"\n", b"\xff\n"])
def test_a_first_record_of_any_bytes_is_told_as_damage(tmp_path: Path, three: Files, first: bytes) -> None:
    path = write(tmp_path / "ledger", three)
    chain = path / "chain.jsonl"
    chain.write_bytes(first + chain.read_bytes().partition(b"\n")[2])
    found = recover(path)
    assert (found.outcome, found.head.commits, found.problems[0].where) == ("damaged", 0, "chain.jsonl")


@pytest.mark.parametrize("is_sealed", [False, True])
@pytest.mark.parametrize(
    ("altered", "later"),
    [
        ((b'"run_id":"run-0005"', b'"run_id":"run-0009"'), [NO_ROWS, NO_ROWS]),  # a row; the last frame counts as torn
        ((b'"kind":"commit","number":5', b'"kind":"commit","number":6'), []),  # a record: none after it is known
    ],
)
def test_what_the_journal_holds_before_a_damage_is_trusted_and_copied(
    tmp_path: Path, is_sealed: bool, altered: tuple[bytes, bytes], later: list[str]
) -> None:
    runs = [run for batch in BATCHES for run in batch]
    with Writer(tmp_path / "ledger", ORIGIN, SIGNER) as writer:
        for number, run in enumerate(runs):
            writer.add([run])
            if is_sealed and number == 1:
                writer.seal()
    root = open_ledger(tmp_path / "ledger").commits[4].tree_root
    journal = tmp_path / "ledger" / "journal.jsonl"
    journal.write_bytes(journal.read_bytes().replace(*altered, 1))
    asked = VerifyOptions(trusted=SIGNER.verifier)
    found = recover(tmp_path / "ledger", asked=asked)
    assert (found.outcome, found.head.commits, found.head.root) == ("damaged", 5, root)
    assert [commit.found for commit in found.later] == later
    assert recover(tmp_path / "ledger", asked=asked, into=tmp_path / "new").outcome == "continued"
    report = verify(tmp_path / "new", asked=asked)
    assert (report.ok, report.commits, report.root, report.signed) == (True, 5, root, 5)
    with Writer(tmp_path / "new", ORIGIN, SIGNER) as writer:
        assert writer.add(runs[5:6]).commits == 6
    assert verify(tmp_path / "new", asked=asked).ok


def test_a_ledger_json_of_another_origin_gives_way_to_what_the_checkpoint_vouches_for(
    tmp_path: Path, three: Files
) -> None:
    before = three | {"ledger.json": three["ledger.json"].replace(b"example", b"elsewhr")}
    path = write(tmp_path / "ledger", before)
    assert not verify(path).ok
    found = recover(path)
    assert (found.outcome, found.head.commits) == ("mended", 3)
    assert aside(path) == {"000/ledger.json": before["ledger.json"]}
    assert_like_new(path, three)


@pytest.mark.parametrize("manifest", [None, b"{}", b'{"format":"fsar-ledger","origin":"else","version":2}'])
def test_where_nothing_says_what_ledger_json_was_nothing_is_touched(
    tmp_path: Path, three: Files, manifest: bytes | None
) -> None:
    before = {name: data for name, data in three.items() if name not in ("ledger.json", "checkpoint")}
    before |= {} if manifest is None else {"ledger.json": manifest}
    path = write(tmp_path / "ledger", before | {"stray": b"?"})
    if manifest is None or manifest == b"{}":
        with pytest.raises((LedgerCorrupted, NotALedger), match=r"ledger\.json"):
            recover(path)
    else:
        assert recover(path).outcome == "damaged"
    assert contents(path) == before | {"stray": b"?"}
    assert os.listdir(tmp_path) == ["ledger"]


def test_a_segment_that_was_not_moved_yet_is_moved_into_place(tmp_path: Path, three: Files) -> None:
    path = write(tmp_path / "ledger", three)
    place, staged = segment_at(path, 2), staged_at(path, 2)
    place.rename(staged)
    found = recover(path)
    assert [(step.did, step.file, step.to) for step in found.steps] == [
        ("moved into place", f"staging/{staged.name}", f"segments/{place.name}")
    ]
    assert_like_new(path, three)


@pytest.mark.parametrize("name", few([*DERIVED, "ledger.json"], ["checkpoint"]))
@pytest.mark.parametrize(
    "damage",
    [lambda data: None, lambda data: data[:-1], lambda data: bytes([data[0] ^ 1]) + data[1:], lambda data: b""],
)
def test_what_stands_beside_the_commits_is_made_again_from_them(
    tmp_path: Path, three: Files, name: str, damage: Callable[[bytes], bytes | None]
) -> None:
    altered = damage(three[name])
    before = {key: data for key, data in (three | {name: altered}).items() if data is not None}
    path = write(tmp_path / "ledger", before)
    found = recover(path)
    assert [(step.did, step.file) for step in found.steps] == [
        *([("set aside", name)] if altered is not None else []),
        ("made again", name),
    ]
    assert_nothing_lost(before, path)
    assert_like_new(path, three)


def test_all_derived_files_are_made_again(tmp_path: Path, three: Files) -> None:
    path = write(tmp_path / "ledger", {name: data for name, data in three.items() if name not in DERIVED})
    assert {step.file for step in recover(path).steps} == set(DERIVED)
    assert_like_new(path, three)


def test_what_does_not_belong_there_is_set_aside_under_its_name(tmp_path: Path, three: Files) -> None:
    strays = dict.fromkeys(["note.txt", "tile/0/000", "deep/er/file", "segments/stray"], b"?")
    path = write(tmp_path / "ledger", three | strays)
    (path / "link").symlink_to(tmp_path)
    found = recover(path)
    assert aside(path) == {f"000/{name}": data for name, data in strays.items()}
    assert (tmp_path / "ledger.set-aside" / "000" / "link").is_symlink()
    assert {step.did for step in found.steps} == {"set aside"}
    assert_like_new(path, three)


def test_each_recovery_sets_aside_under_a_number_of_its_own(tmp_path: Path, three: Files) -> None:
    path = write(tmp_path / "ledger", three)
    for data in (b"one", b"two"):
        (path / "stray").write_bytes(data)
        recover(path)
    assert aside(path) == {"000/stray": b"one", "001/stray": b"two"}


@pytest.mark.parametrize("manifest", ["as it is", None, b"{}"])
def test_a_recovery_beside_a_writer_is_refused_even_where_the_description_is_lost(
    tmp_path: Path, three: Files, manifest: str | bytes | None
) -> None:
    path = write(tmp_path / "ledger", three | {"stray": b"?"})
    with Writer(path, ORIGIN):
        if not isinstance(manifest, str):
            (path / "ledger.json").unlink()
        if isinstance(manifest, bytes):
            (path / "ledger.json").write_bytes(manifest)
        before = contents(path)
        with pytest.raises(WriteFailed, match="found another writer"):
            recover(path)
        assert contents(path) == before
    assert recover(path).outcome == "mended"


def test_what_is_no_ledger_or_holds_nothing_yet_is_said_to_be_so(tmp_path: Path) -> None:
    for place in (tmp_path, tmp_path / "nowhere"):
        with pytest.raises(NotALedger, match="found no ledger there"):
            recover(place)
    unborn = write(tmp_path / "unborn", {"staging/ledger.json.77.tmp": b"{"})
    with pytest.raises(NotALedger, match="creation was interrupted before anything was in it"):
        recover(unborn)
    append_all(unborn, BATCHES[:1])  # as the message says
    assert verify(unborn).ok
    other = write(tmp_path / "other", {"ledger.json": b'{"format":"something else"}'})
    with pytest.raises(NotALedger, match="something else"):
        recover(other)


def test_the_new_ledger_must_be_at_a_free_path_outside(tmp_path: Path, three: Files) -> None:
    path = write(tmp_path / "ledger", three)
    with pytest.raises(UsageError, match="found a file or folder"):
        recover(path, into=tmp_path)
    with pytest.raises(UsageError, match="expected one outside"):
        recover(path, into=path / "segments" / "new")
    assert recover(path, into=tmp_path / "new").outcome == "whole"
    assert os.listdir(tmp_path) == ["ledger"]
