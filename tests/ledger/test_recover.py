import json
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from fsar_ledger.errors import NotALedger, UsageError, WriteFailed
from fsar_ledger.ledger.store.append import Writer, stage
from fsar_ledger.ledger.store.paths import commit_path, segment_path
from fsar_ledger.ledger.store.read import open_ledger
from fsar_ledger.ledger.store.record import sha256_hex
from fsar_ledger.ledger.verify.recover import recover
from fsar_ledger.ledger.verify.verify import verify
from tests.ledger.forgery import examined_once
from tests.ledger.samples import ORIGIN, append_all, contents, made_up_batches

BATCHES = made_up_batches(4, runs=2, size=60)  # 120 events a commit: the third outgrows the first partial tiles
Files = dict[str, bytes]


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> Files:
    """Return the files of a ledger with two commits."""
    path = tmp_path_factory.mktemp("two") / "ledger"
    append_all(path, BATCHES[:2])
    return contents(path)


@pytest.fixture(scope="module")
def three(tmp_path_factory: pytest.TempPathFactory) -> Files:
    """Return the files of the same ledger with a third commit."""
    path = tmp_path_factory.mktemp("three") / "ledger"
    append_all(path, BATCHES[:3])
    return contents(path)


@pytest.fixture(scope="module", autouse=True)
def decoded_once(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    path = tmp_path_factory.mktemp("all") / "ledger"
    append_all(path, BATCHES)
    with examined_once(path):
        yield


def write(path: Path, files: Files) -> Path:
    """Write a ledger of these files and no others."""
    shutil.rmtree(path, ignore_errors=True)
    for folder in ("commits", "segments", "staging"):
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
    """Check that each file that was there is in the ledger or set aside, unless it is a note that a record holds."""
    now = {*contents(path).values(), *aside(path).values()}
    notes = {json.loads(data)["note"].encode() for name, data in contents(path).items() if name.startswith("commits/")}
    assert [name for name, data in before.items() if data not in now | notes] == []


def assert_like_new(path: Path, expected: Files) -> None:
    """Check that the ledger verifies without a remark, equals that of an uninterrupted writer, and can be continued."""
    report = verify(path)
    assert (report.ok, report.problems, report.remarks) == (True, (), ())
    assert contents(path) == expected
    done = open_ledger(path).head.commits
    with Writer(path, ORIGIN) as writer:
        assert writer.append(stage(path, BATCHES[done])).commits == done + 1
    assert verify(path).ok


SEGMENT, RECORD = "segments/000000000002.parquet", "commits/000000000002.json"


def staged(three: Files) -> str:
    return f"staging/{sha256_hex(three[SEGMENT])}.parquet"


def tiles(three: Files) -> Files:
    return {name: data for name, data in three.items() if name.startswith("tile/")}


def with_segment_staged(two: Files, three: Files) -> Files:
    return two | {staged(three): three[SEGMENT]}


def with_half_a_segment(two: Files, three: Files) -> Files:
    return two | {f"{staged(three)}.77.tmp": three[SEGMENT][:100]}


def with_record_written(two: Files, three: Files) -> Files:
    return with_segment_staged(two, three) | {"staging/000000000002.json.77.tmp": three[RECORD]}


def with_record_linked(two: Files, three: Files) -> Files:
    return with_record_written(two, three) | {RECORD: three[RECORD]}


def with_record_in_place(two: Files, three: Files) -> Files:
    return with_segment_staged(two, three) | {RECORD: three[RECORD]}


def with_segment_in_place(two: Files, three: Files) -> Files:
    return two | {RECORD: three[RECORD], SEGMENT: three[SEGMENT]}


def with_one_tile(two: Files, three: Files) -> Files:
    return with_segment_in_place(two, three) | {"tile/0/000": three["tile/0/000"], "staging/file.77.tmp": b"half"}


def with_all_tiles(two: Files, three: Files) -> Files:
    return with_segment_in_place(two, three) | tiles(three)


def with_checkpoint(two: Files, three: Files) -> Files:
    return with_all_tiles(two, three) | {"checkpoint": three["checkpoint"]}


BEFORE_THE_COMMIT = [with_segment_staged, with_half_a_segment, with_record_written]
AFTER_THE_COMMIT = [
    with_record_linked,
    with_record_in_place,
    with_segment_in_place,
    with_one_tile,
    with_all_tiles,
    with_checkpoint,
]


@pytest.mark.parametrize("state", BEFORE_THE_COMMIT)
def test_what_was_not_committed_is_set_aside(
    tmp_path: Path, two: Files, three: Files, state: Callable[[Files, Files], Files]
) -> None:
    before = state(two, three)
    path = write(tmp_path / "ledger", before)
    found = recover(path)
    assert (found.outcome, found.head.commits) == ("mended", 2)
    left = before.keys() - two.keys()
    assert {step.file: (step.did, step.to) for step in found.steps} == {
        name: ("set aside", f"{path}.set-aside/000/{name}") for name in left
    }
    assert aside(path) == {f"000/{name}": before[name] for name in left}
    assert_like_new(path, two)


@pytest.mark.parametrize("state", AFTER_THE_COMMIT)
def test_what_was_committed_is_finished(
    tmp_path: Path, two: Files, three: Files, state: Callable[[Files, Files], Files]
) -> None:
    before = state(two, three)
    path = write(tmp_path / "ledger", before)
    found = recover(path)
    assert (found.outcome, found.head.commits, found.problems) == ("mended", 3, ())
    moved = {(step.file, step.to) for step in found.steps if step.did == "moved into place"}
    assert moved == ({(staged(three), SEGMENT)} if SEGMENT not in before else set())
    assert {step.file for step in found.steps if step.did == "made again"} == {
        name for name in tiles(three) | {"checkpoint": b""} if before.get(name) != three[name]
    }
    assert_nothing_lost(before, path)
    assert_like_new(path, three)


@pytest.mark.slow
def test_a_whole_ledger_is_left_as_it_is(tmp_path: Path, three: Files) -> None:
    path = write(tmp_path / "ledger", three)
    found = recover(path, workers=2)
    assert (found.outcome, found.steps, found.head) == ("whole", (), open_ledger(path).head)
    assert contents(path) == three
    assert os.listdir(tmp_path) == ["ledger"]


def test_an_empty_ledger_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "ledger"
    append_all(path, [])
    assert (recover(path).outcome, recover(path).head.commits) == ("whole", 0)
    (path / "staging" / "left").write_bytes(b"over")
    (path / "checkpoint").write_bytes(b"of nothing")
    assert {step.file for step in recover(path).steps} == {"staging/left", "checkpoint"}
    assert verify(path).ok


@pytest.mark.parametrize("name", ["checkpoint", "tile/0/000", "tile/0/001.p/104", "tile/1/000.p/1", "ledger.json"])
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


def test_all_tiles_and_the_checkpoint_are_made_again(tmp_path: Path, three: Files) -> None:
    path = write(
        tmp_path / "ledger",
        {name: data for name, data in three.items() if name.startswith(("ledger", "commits", "segments"))},
    )
    assert {step.file for step in recover(path).steps} == {*tiles(three), "checkpoint"}
    assert_like_new(path, three)


def test_a_ledger_json_of_another_origin_gives_way_to_what_the_records_vouch_for(tmp_path: Path, three: Files) -> None:
    before = three | {"ledger.json": three["ledger.json"].replace(b"example", b"elsewhr")}
    path = write(tmp_path / "ledger", before)
    assert not verify(path).ok
    assert recover(path).outcome == "mended"
    assert aside(path) == {"000/ledger.json": before["ledger.json"]}
    assert_like_new(path, three)


def test_what_does_not_belong_there_is_set_aside_under_its_name(tmp_path: Path, three: Files) -> None:
    strays = dict.fromkeys(
        [
            "note.txt",
            "commits/old.json",
            "segments/copy.parquet",
            "tile/0/x",
            "tile/0/000.p/7",
            "staging/a/b",
            "deep/er/file",
        ],
        b"?",
    )
    path = write(tmp_path / "ledger", three | strays)
    (path / "link").symlink_to(tmp_path)
    found = recover(path)
    assert aside(path) == {f"000/{name}": data for name, data in strays.items()}
    assert (tmp_path / "ledger.set-aside" / "000" / "link").is_symlink()
    assert {step.did for step in found.steps} == {"set aside"}
    assert_like_new(path, three)


def test_links_and_files_in_the_place_of_folders_are_set_aside_and_not_followed(tmp_path: Path, three: Files) -> None:
    path = write(tmp_path / "ledger", three)
    shutil.move(path / "tile", tmp_path / "elsewhere")
    (path / "tile").symlink_to(tmp_path / "elsewhere")
    (path / "staging").rmdir()
    (path / "staging").write_bytes(b"no folder")
    there = contents(tmp_path / "elsewhere")
    recover(path)
    assert contents(tmp_path / "elsewhere") == there
    assert_like_new(path, three)


def test_a_folder_in_the_place_of_a_tile_makes_room(tmp_path: Path, three: Files) -> None:
    before = {name: data for name, data in three.items() if name != "tile/0/000"} | {"tile/0/000/inner": b"?"}
    path = write(tmp_path / "ledger", before)
    recover(path)
    assert_nothing_lost(before, path)
    assert_like_new(path, three)


def test_each_recovery_sets_aside_under_a_number_of_its_own(tmp_path: Path, three: Files) -> None:
    path = write(tmp_path / "ledger", three)
    for data in (b"one", b"two"):
        (path / "stray").write_bytes(data)
        recover(path)
    assert aside(path) == {"000/stray": b"one", "001/stray": b"two"}


def test_a_recovery_beside_a_writer_is_refused(tmp_path: Path, three: Files) -> None:
    path = write(tmp_path / "ledger", three | {"stray": b"?"})
    before = contents(path)
    with Writer(path, ORIGIN), pytest.raises(WriteFailed, match="found a writer at work"):
        recover(path)
    assert contents(path) == before
    assert recover(path).outcome == "mended"


def test_what_is_no_ledger_or_holds_nothing_yet_is_said_to_be_so(tmp_path: Path) -> None:
    with pytest.raises(NotALedger, match="found no ledger there"):
        recover(tmp_path)
    with pytest.raises(NotALedger, match="found no ledger there"):
        recover(tmp_path / "nowhere")
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
    with pytest.raises(UsageError, match="found something there"):
        recover(path, into=tmp_path)
    with pytest.raises(UsageError, match="expected one outside"):
        recover(path, into=path / "segments" / "new")
    assert recover(path, into=tmp_path / "new").outcome == "whole"
    assert os.listdir(tmp_path) == ["ledger"]


def test_segments_and_records_have_the_paths_that_these_tests_say() -> None:
    assert (str(segment_path(Path(), 2)), str(commit_path(Path(), 2))) == (SEGMENT, RECORD)
