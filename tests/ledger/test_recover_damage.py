"""Recovery of a ledger that cannot be mended says what can be trusted, copies that, and touches nothing."""

import os
import random
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fsar_ledger.base.errors import LedgerCorrupted, UsageError
from fsar_ledger.ledger.log.hashing import sha256_hex
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.manifest import read_manifest
from fsar_ledger.ledger.store.read import open_chain
from fsar_ledger.ledger.verify import recover, verify
from fsar_ledger.ledger.verify.report import MAX_PROBLEMS, VerifyOptions, read_anchor
from fsar_ledger.ledger.verify.trusted import FITS, NO_SEGMENT
from tests.ledger.damage import SIGNER
from tests.ledger.forgery import forge, segment_at
from tests.ledger.hostile import append_again
from tests.ledger.samples import ORIGIN, append_all, contents, made_up_batches
from tests.ledger.test_recover import aside, assert_nothing_lost
from tests.quick import few

BATCHES = COMMITTED = made_up_batches(4, runs=2, size=20)


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


def keep_lines(path: Path, *kept: slice) -> None:
    lines = (path / "chain.jsonl").read_bytes().splitlines(keepends=True)
    (path / "chain.jsonl").write_bytes(b"".join(line for each in kept for line in lines[each]))


def lose_the_newest_records(path: Path) -> None:
    keep_lines(path, slice(0, 6))


def lose_the_newest_commit_but_its_hashes(path: Path) -> None:
    segment_at(path, 3).unlink()
    lose_the_newest_records(path)
    (path / "checkpoint").write_text(str(open_chain(path, read_manifest(path), is_damage_told=False).note()))


def lose_the_newest_commit_but_the_checkpoint(path: Path) -> None:
    segment_at(path, 3).unlink()
    lose_the_newest_records(path)
    append_all(path.with_name("reference"), BATCHES[:3])
    for name in ("nodes", "index.jsonl"):
        shutil.copy(path.with_name("reference") / name, path / name)
    shutil.rmtree(path.with_name("reference"))


TAMPERING: list[tuple[str, Callable[[Path], object], int, dict[int, str] | None]] = [
    ("a bit of a segment", lambda path: flip(segment_at(path, 2), 300), 2, {2: NO_SEGMENT, 3: FITS}),
    ("a lost segment", lambda path: segment_at(path, 1).unlink(), 1, {1: NO_SEGMENT, 2: FITS, 3: FITS}),
    ("half a segment", cut, 3, {3: NO_SEGMENT}),
    ("segments in each other's place", swap, 1, {1: NO_SEGMENT, 2: NO_SEGMENT, 3: FITS}),
    ("a forged count of rows", lambda path: forge(path, "commit", 1, rows=23), 1, None),
    ("a record that is no JSON", lambda path: flip(path / "chain.jsonl", 0), 0, None),
    ("a bit of a record", lambda path: flip(path / "chain.jsonl", 1_800), 2, None),
    ("a lost record", lambda path: keep_lines(path, slice(0, 2), slice(3, 8)), 1, None),
    ("a lost first record", lambda path: keep_lines(path, slice(1, 8)), 0, None),
    ("a lost newest record", lose_the_newest_records, 3, None),
    ("a tail removed without its hashes", lose_the_newest_commit_but_its_hashes, 3, {}),
    ("a tail removed without the checkpoint", lose_the_newest_commit_but_the_checkpoint, 3, {}),
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


@pytest.mark.parametrize(
    "harmless",
    [
        lambda path: flip(path / "ledger.json", 20),
        lambda path: (path / "ledger.json").unlink(),
        lambda path: [(path / f"stray-{number:03d}").write_bytes(b"") for number in range(MAX_PROBLEMS + 1)],
        lambda path: (path / "segments" / "stray").write_bytes(b""),
        lambda path: (path / "checkpoint").write_bytes(b"?"),
    ],
)
def test_nothing_is_mended_beside_what_cannot_be(path: Path, harmless: Callable[[Path], object]) -> None:
    cut(path)
    harmless(path)
    before = contents(path)
    found = recover(path)
    assert (found.outcome, found.head.commits, found.steps) == ("damaged", 3, ())
    assert contents(path) == before


@pytest.mark.parametrize("name", ["segments", "staging"])
def test_a_link_in_the_place_of_a_folder_is_not_followed_and_stays(path: Path, tmp_path: Path, name: str) -> None:
    (path / name).rename(tmp_path / "elsewhere")
    (path / name).symlink_to(tmp_path / "elsewhere")
    before = contents(tmp_path / "elsewhere")
    found = recover(path)
    assert (found.outcome, found.steps) == ("damaged", ())
    assert "a link or not a folder" in f"{found.problems[0]}"
    assert (path / name).is_symlink()
    assert contents(tmp_path / "elsewhere") == before


def test_a_segment_of_no_commit_is_no_stray(tmp_path: Path, intact: Path) -> None:
    append_all(tmp_path / "ledger", BATCHES[:3])
    shutil.copy(segment_at(intact, 3), tmp_path / "ledger" / "segments")
    before = contents(tmp_path / "ledger")
    assert (recover(tmp_path / "ledger").outcome, recover(tmp_path / "ledger").head.commits) == ("damaged", 3)
    assert contents(tmp_path / "ledger") == before
    assert "; keep it: either newer commits were removed" in str(verify(tmp_path / "ledger").problems[0])


def test_an_altered_event_in_the_journal_is_not_said_to_be_removed(tmp_path: Path) -> None:
    with Writer(tmp_path / "ledger", ORIGIN, adopts=True) as writer:
        for run in BATCHES[0]:
            writer.add([run])
    journal = tmp_path / "ledger" / "journal.jsonl"
    journal.write_bytes(journal.read_bytes().replace(b"run-0000", b"run-0009", 1))
    found = recover(tmp_path / "ledger")
    assert found.outcome == "damaged"
    assert [problem.where for problem in found.problems] == ["journal.jsonl"]


@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir])
def test_a_chain_that_is_no_file_is_refused(path: Path, make: Callable[[Path], None]) -> None:
    (path / "chain.jsonl").unlink()
    make(path / "chain.jsonl")
    with pytest.raises(LedgerCorrupted, match=r"chain\.jsonl: it cannot be read"):
        recover(path)


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


def asked(anchor: Path | None = None, *, is_signed: bool = False) -> VerifyOptions:
    return VerifyOptions(anchor=read_anchor(anchor) if anchor else None, trusted=SIGNER.verifier if is_signed else None)


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


@pytest.mark.parametrize("name", ["nodes", "index.jsonl"])
@pytest.mark.parametrize(
    "put",
    [
        lambda file: file.write_bytes(file.read_bytes() + b"\n"),
        lambda file: (file.unlink(), file.mkdir()),
        lambda file: (file.unlink(), file.symlink_to("x" * 200)),
    ],
)
def test_what_no_commit_left_beyond_a_derived_file_does_not_say_that_commits_were_removed(
    path: Path, name: str, put: Callable[[Path], object]
) -> None:
    put(path / name)
    found = recover(path)
    assert (found.outcome, found.problems) == ("mended", ())
    assert ("set aside", name) in [(step.did, step.file) for step in found.steps]


def test_nothing_of_a_ledger_that_an_anchor_contradicts_is_trusted_or_copied(tmp_path: Path) -> None:
    path, anchor = tmp_path / "ledger", checkpoint_of(1, tmp_path)
    append_all(path, made_up_batches(4, size=13))
    found = recover(path, asked=asked(anchor))
    assert (found.head.commits, found.head.size, len(found.later)) == (0, 0, 4)
    with pytest.raises(LedgerCorrupted, match=r"history was rewritten(.|\n)*no commit that can be trusted"):
        recover(path, asked=asked(anchor), into=tmp_path / "new")
    assert not (tmp_path / "new").exists()
    segment_at(path, 3).unlink()
    assert recover(path, asked=asked(anchor)).head.commits == 0, "also where something else is damaged"
    assert recover(path).head.commits == 3


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


def test_what_the_key_did_not_sign_is_mended_no_more_than_what_is_altered(tmp_path: Path) -> None:
    path = tmp_path / "ledger"
    append_all(path, BATCHES[:2], signer=SIGNER)
    append_all(path, BATCHES[2:])
    (path / "stray").write_bytes(b"?")
    found = recover(path, asked=asked(is_signed=True))
    assert (found.outcome, found.head.commits, found.steps) == ("damaged", 2, ())
    assert recover(path).outcome == "mended"


def test_a_checkpoint_that_the_key_signed_tells_of_a_rewritten_history(tmp_path: Path) -> None:
    append_all(tmp_path / "then", made_up_batches(2, size=13), signer=SIGNER)
    path = tmp_path / "ledger"
    append_all(path, BATCHES, signer=SIGNER)
    shutil.copy(tmp_path / "then" / "checkpoint", path / "checkpoint")
    before = contents(path)
    found = recover(path, asked=asked(is_signed=True))
    assert (found.outcome, found.steps) == ("damaged", ())
    assert "history was rewritten" in str(found.problems[0])
    assert contents(path) == before
    assert recover(path).outcome == "mended"  # without the key it is only a file that must be made again, and is kept
    assert aside(path) == {"000/checkpoint": before["checkpoint"]}


def test_an_anchor_of_more_than_can_be_read_vouches_where_the_hashes_prove_it(tmp_path: Path) -> None:
    """Commits have 32 events, so that the hashes that are kept, of 16 events and more, prove it without rows."""
    batches, path = made_up_batches(4, runs=2, size=16), tmp_path / "ledger"
    append_all(path, batches)
    append_all(tmp_path / "then", batches[:2])
    anchor = tmp_path / "then" / "checkpoint"
    segment_at(path, 1).unlink()
    beyond = recover(path, asked=asked(anchor), into=tmp_path / "new")
    assert (beyond.outcome, beyond.head.commits, beyond.anchored) == ("continued", 1, 32)
    (path / "nodes").write_bytes(b"")
    assert recover(path, asked=asked(anchor)).anchored is None
    append_all(tmp_path / "other", made_up_batches(4, size=13))
    segment_at(tmp_path / "other", 1).unlink()
    assert recover(tmp_path / "other", asked=asked(anchor)).anchored is None


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


@pytest.mark.parametrize("damages", few([20, 200], [], [20]))
def test_whatever_was_done_recovery_makes_no_false_ledger_verify(
    intact: Path, tmp_path_factory: pytest.TempPathFactory, damages: int
) -> None:
    @settings(max_examples=damages, deadline=None)
    @given(seed=st.integers(0, 1 << 32), times=st.integers(1, 3))
    def tried(seed: int, times: int) -> None:
        recover_after_any_damage(intact, tmp_path_factory.mktemp("any"), seed, times)

    tried()


def recover_after_any_damage(intact: Path, folder: Path, seed: int, times: int) -> None:
    """Damage a copy of the ledger in the folder, recover it, and check that what then verifies is of its history."""
    path = Path(shutil.copytree(intact, folder / "ledger"))
    draw = random.Random(seed)
    for _ in range(times):
        damage_at_random(path, draw)
    before = contents(path)
    try:
        outcome = recover(path, into=folder / "new").outcome
    except (LedgerCorrupted, UsageError):  # nothing can be trusted
        outcome = "damaged"
    if outcome in ("damaged", "continued"):
        assert contents(path) == before
    # An older note, which the chain gives, may be replaced, and a torn end of the chain be cut off.
    assert_nothing_lost({name: before[name] for name in before.keys() - {"checkpoint", "chain.jsonl"}}, path)
    if outcome != "damaged":
        trusted = folder / "new" if outcome == "continued" else path
        assert verify(trusted).ok
        runs = list(open_ledger(trusted).runs())
        assert runs == [run for batch in BATCHES for run in batch][: len(runs)]
