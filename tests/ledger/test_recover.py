"""Recovery mends what a crash left, finds what can be trusted, and deletes nothing."""

import os
import random
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fsar_ledger.errors import LedgerCorrupted, NotALedger, UsageError, WriteFailed
from fsar_ledger.ledger.chain.append import Writer
from fsar_ledger.ledger.log.hashing import sha256_hex
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.ledger.verify.notes import read_anchor
from fsar_ledger.ledger.verify.recover import recover
from fsar_ledger.ledger.verify.report import Asked
from fsar_ledger.ledger.verify.trusted import FITS, NO_SEGMENT
from fsar_ledger.ledger.verify.verify import verify
from tests.ledger.damage import SIGNER
from tests.ledger.forgery import forge, segment_at, staged_at
from tests.ledger.hostile import append_again
from tests.ledger.once import decoded_once
from tests.ledger.samples import ORIGIN, append_all, contents, made_up_batches

BATCHES = made_up_batches(4, runs=2, size=20)
DERIVED = ("nodes", "index.jsonl", "checkpoint")
Files = dict[str, bytes]


@pytest.fixture(scope="module")
def intact(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    path = tmp_path_factory.mktemp("intact") / "ledger"
    append_all(path, BATCHES)
    with decoded_once():
        yield path


@pytest.fixture(scope="module")
def three(tmp_path_factory: pytest.TempPathFactory) -> Files:
    """Return the files of a ledger of three commits."""
    path = tmp_path_factory.mktemp("three") / "ledger"
    append_all(path, BATCHES[:3])
    return contents(path)


@pytest.fixture
def path(intact: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(intact, tmp_path / "ledger"))


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


def test_a_segment_that_was_not_moved_yet_is_moved_into_place(tmp_path: Path, three: Files) -> None:
    path = write(tmp_path / "ledger", three)
    place, staged = segment_at(path, 2), staged_at(path, 2)
    place.rename(staged)
    found = recover(path)
    assert [(step.did, step.file, step.to) for step in found.steps] == [
        ("moved into place", f"staging/{staged.name}", f"segments/{place.name}")
    ]
    assert_like_new(path, three)


@pytest.mark.parametrize("name", [*DERIVED, "ledger.json"])
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
    strays = dict.fromkeys(["note.txt", "tile/0/000", "deep/er/file"], b"?")
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
        with pytest.raises(WriteFailed, match="found a writer at work"):
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
    with pytest.raises(UsageError, match="found something there"):
        recover(path, into=tmp_path)
    with pytest.raises(UsageError, match="expected one outside"):
        recover(path, into=path / "segments" / "new")
    assert recover(path, into=tmp_path / "new").outcome == "whole"
    assert os.listdir(tmp_path) == ["ledger"]


# --- a damaged ledger ---


def flip(file: Path, at: int) -> None:
    data = bytearray(file.read_bytes())
    data[at % len(data)] ^= 4
    file.write_bytes(data)


def cut(path: Path) -> None:
    file = segment_at(path, 3)
    file.write_bytes(file.read_bytes()[:99])


def swap(path: Path) -> None:
    first, second = segment_at(path, 1), segment_at(path, 2)
    one, two = first.read_bytes(), second.read_bytes()
    first.write_bytes(two)
    second.write_bytes(one)


def lose_the_newest_records(path: Path) -> None:
    lines = (path / "chain.jsonl").read_bytes().splitlines(keepends=True)
    (path / "chain.jsonl").write_bytes(b"".join(lines[:6]))


TAMPERING: list[tuple[str, Callable[[Path], object], int, dict[int, str] | None]] = [
    ("a bit of a segment", lambda path: flip(segment_at(path, 2), 300), 2, {2: NO_SEGMENT, 3: FITS}),
    ("a lost segment", lambda path: segment_at(path, 1).unlink(), 1, {1: NO_SEGMENT, 2: FITS, 3: FITS}),
    ("half a segment", cut, 3, {3: NO_SEGMENT}),
    ("segments in each other's place", swap, 1, {1: NO_SEGMENT, 2: NO_SEGMENT, 3: FITS}),
    ("a forged count of rows", lambda path: forge(path, "commit", 1, rows=23), 1, None),
    ("a record that is no JSON", lambda path: flip(path / "chain.jsonl", 0), 0, None),
    ("a lost newest record", lose_the_newest_records, 3, None),
]


@pytest.mark.parametrize(("damage", "commits", "later"), [pytest.param(*case, id=name) for name, *case in TAMPERING])
def test_what_can_be_trusted_is_said_and_copied_and_the_damaged_ledger_stays(
    path: Path, tmp_path: Path, intact: Path, damage: Callable[[Path], object], commits: int, later: dict[int, str]
) -> None:
    damage(path)
    before = contents(path)
    found = recover(path)
    assert (found.outcome, found.head.commits, found.steps) == ("damaged", commits, ())
    assert later is None or {commit.number: commit.found for commit in found.later} == later
    assert found.problems
    new = tmp_path / "new"
    if not commits:
        with pytest.raises(LedgerCorrupted, match="no commit that can be trusted"):
            recover(path, into=new)
    else:
        assert recover(path, into=new).outcome == "continued"
        append_all(tmp_path / "reference", BATCHES[:commits])
        assert contents(new) == contents(tmp_path / "reference")
        assert append_all(new, BATCHES[commits:]) == open_ledger(intact).head
        assert contents(new) == contents(intact)
    assert contents(path) == before
    assert {entry.name for entry in tmp_path.iterdir()} <= {"ledger", "new", "reference"}


def test_a_lost_segment_can_be_restored_by_its_hash(path: Path) -> None:
    place, data = segment_at(path, 1), segment_at(path, 1).read_bytes()
    place.unlink()
    [lost, *others] = recover(path).later
    assert (lost.restore, lost.file) == (sha256_hex(data), f"segments/{place.name}")
    assert [other.restore for other in others] == [None, None]
    place.write_bytes(data)
    assert recover(path).outcome == "whole"


def test_a_run_in_two_commits_ends_what_can_be_trusted(tmp_path: Path) -> None:
    append_all(tmp_path / "ledger", BATCHES[:2])
    append_again(tmp_path / "ledger", BATCHES[0][:1])
    append_all(tmp_path / "ledger", BATCHES[2:])
    assert (recover(tmp_path / "ledger").head.commits, verify(tmp_path / "ledger").ok) == (2, False)


# --- anchors and keys ---


def asked(anchor: Path | None = None, *, is_signed: bool = False) -> Asked:
    return Asked(anchor=read_anchor(anchor) if anchor else None, trusted=SIGNER.verifier if is_signed else None)


def checkpoint_of(batches: int, folder: Path) -> Path:
    """Return the checkpoint of a ledger of this many commits, kept elsewhere."""
    append_all(folder / "then", BATCHES[:batches])
    return folder / "then" / "checkpoint"


def test_a_removed_tail_shows_with_an_anchor_only(tmp_path: Path) -> None:
    path = tmp_path / "ledger"
    append_all(path, BATCHES[:2])
    assert recover(path).outcome == "whole"
    before = contents(path)
    found = recover(path, asked=asked(checkpoint_of(3, tmp_path)))
    assert (found.outcome, found.head.commits, found.anchored) == ("damaged", 2, None)
    assert "the newest were removed" in str(found.problems[0])
    assert contents(path) == before


def test_an_anchor_vouches_for_what_it_knows(path: Path, tmp_path: Path) -> None:
    anchor = checkpoint_of(2, tmp_path)
    assert (recover(path, asked=asked(anchor)).outcome, recover(path, asked=asked(anchor)).anchored) == ("whole", 80)
    segment_at(path, 3).unlink()
    assert recover(path, asked=asked(anchor), into=tmp_path / "new").anchored == 80
    assert verify(tmp_path / "new", asked=asked(anchor)).ok


def test_what_an_anchor_contradicts_is_damaged(tmp_path: Path) -> None:
    append_all(tmp_path / "ledger", made_up_batches(4, size=13))
    found = recover(tmp_path / "ledger", asked=asked(checkpoint_of(1, tmp_path)))
    assert (found.outcome, found.anchored) == ("damaged", None)
    assert "history was rewritten" in str(found.problems[0])


def test_what_is_no_checkpoint_is_no_anchor(path: Path, tmp_path: Path) -> None:
    (tmp_path / "anchor").write_text("hello")
    with pytest.raises(UsageError, match="expected a checkpoint of this ledger"):
        recover(path, asked=asked(tmp_path / "anchor"))


def test_with_a_key_only_what_it_signed_can_be_trusted(tmp_path: Path) -> None:
    path = tmp_path / "ledger"
    append_all(path, BATCHES[:2], signer=SIGNER)
    assert recover(path, asked=asked(is_signed=True)).outcome == "whole"
    append_all(path, BATCHES[2:])
    assert recover(path).outcome == "whole"
    found = recover(path, asked=asked(is_signed=True), into=tmp_path / "new")
    assert (found.outcome, found.head.commits) == ("continued", 2)
    assert verify(tmp_path / "new", asked=asked(is_signed=True)).ok
    append_all(tmp_path / "unsigned", BATCHES[:1])
    assert recover(tmp_path / "unsigned", asked=asked(is_signed=True)).head.commits == 0


# --- anything at all ---


def damage_at_random(path: Path, draw: random.Random) -> None:
    """Alter, cut, remove or double one file, or replace it by another."""
    files = sorted(file for file in path.rglob("*") if file.is_file())
    file, other = draw.choice(files), draw.choice(files)
    data = file.read_bytes()
    match draw.randrange(6):
        case 0:
            flip(file, draw.randrange(max(1, len(data)))) if data else None
        case 1:
            file.write_bytes(data[: draw.randrange(max(1, len(data)))])
        case 2:
            file.unlink()
        case 3:
            file.write_bytes(data + draw.randbytes(5))
        case 4:
            file.write_bytes(other.read_bytes())
        case 5:
            file.rename(draw.choice([file.with_name("other"), path / "staging" / file.name, path / file.name]))


@pytest.mark.slow
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 1 << 32), times=st.integers(1, 3))
def test_whatever_was_done_recovery_makes_no_false_ledger_verify(
    intact: Path, tmp_path_factory: pytest.TempPathFactory, seed: int, times: int
) -> None:
    folder = tmp_path_factory.mktemp("any")
    path = Path(shutil.copytree(intact, folder / "ledger"))
    draw = random.Random(seed)
    for _ in range(times):
        damage_at_random(path, draw)
    before = contents(path)
    try:
        outcome = recover(path, into=folder / "new").outcome
    except (LedgerCorrupted, UsageError):  # nothing can be trusted
        outcome = "damaged"
    # An older note, which the chain gives, may be replaced, and a torn end of the chain be cut off.
    assert_nothing_lost({name: before[name] for name in before.keys() - {"checkpoint", "chain.jsonl"}}, path)
    if outcome != "damaged":
        trusted = folder / "new" if outcome == "continued" else path
        assert verify(trusted).ok
        runs = list(open_ledger(trusted).runs())
        assert runs == [run for batch in BATCHES for run in batch][: len(runs)]
