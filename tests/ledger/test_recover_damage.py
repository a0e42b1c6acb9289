import random
import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fsar_ledger.errors import LedgerCorrupted, UsageError
from fsar_ledger.ledger.log.note import Signer
from fsar_ledger.ledger.rows import canonical
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.store.append import Writer, stage
from fsar_ledger.ledger.store.paths import commit_path, segment_path
from fsar_ledger.ledger.store.read import open_ledger
from fsar_ledger.ledger.store.record import CommitRecord, sha256_hex
from fsar_ledger.ledger.store.view import EMPTY_HEAD
from fsar_ledger.ledger.verify.notes import read_anchor
from fsar_ledger.ledger.verify.recover import Recovery, recover
from fsar_ledger.ledger.verify.report import Asked
from fsar_ledger.ledger.verify.trusted_prefix import FITS, NO_RECORD, NO_SEGMENT
from fsar_ledger.ledger.verify.verify import verify
from tests.ledger.forgery import examined_once
from tests.ledger.hostile import append_again
from tests.ledger.samples import ORIGIN, append_all, contents, made_up_batches
from tests.ledger.test_recover import aside

BATCHES = made_up_batches(4)
SIGNER = Signer(ORIGIN, bytes(range(32)))


@pytest.fixture(scope="module")
def intact(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    path = tmp_path_factory.mktemp("intact") / "ledger"
    append_all(path, BATCHES)
    with examined_once(path):
        yield path


@pytest.fixture
def path(intact: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(intact, tmp_path / "ledger"))


def append_signed(path: Path, batches: Sequence[Sequence[LedgerRun]]) -> None:
    with Writer(path, ORIGIN, SIGNER) as writer:
        for batch in batches:
            writer.append(stage(path, batch))


def flip(file: Path, at: int) -> None:
    data = bytearray(file.read_bytes())
    data[at % len(data)] ^= 4
    file.write_bytes(data)


def forge(path: Path, number: int, **changes: object) -> None:
    """Change the record and chain all later records to it again."""
    for at in range(number, len(open_ledger(path).records)):
        record = msgspec.json.decode(commit_path(path, at).read_bytes(), type=CommitRecord)
        previous = sha256_hex((commit_path(path, at - 1) if at else path / "ledger.json").read_bytes())
        own = changes if at == number else {}
        commit_path(path, at).write_bytes(
            canonical.document(msgspec.structs.replace(record, **{"previous_sha256": previous, **own}))
        )


def swap(path: Path) -> None:
    one, two = segment_path(path, 1).read_bytes(), segment_path(path, 2).read_bytes()
    segment_path(path, 1).write_bytes(two)
    segment_path(path, 2).write_bytes(one)


def lose_the_newest_record(path: Path) -> None:
    commit_path(path, 3).unlink()


def lose_the_newest_commit_but_its_tiles(path: Path) -> None:
    lose_the_newest_record(path)
    segment_path(path, 3).unlink()
    (path / "checkpoint").write_text(open_ledger(path).records[-1].note)


def lose_the_newest_commit_but_the_checkpoint(path: Path) -> None:
    lose_the_newest_record(path)
    segment_path(path, 3).unlink()
    (path / "tile/0/000.p/96").unlink()


TAMPERING: list[tuple[str, Callable[[Path], object], int, dict[int, str]]] = [
    ("a bit of a segment", lambda path: flip(segment_path(path, 2), 300), 2, {2: NO_SEGMENT, 3: FITS}),
    ("a lost segment", lambda path: segment_path(path, 1).unlink(), 1, {1: NO_SEGMENT, 2: FITS, 3: FITS}),
    (
        "half a segment",
        lambda path: segment_path(path, 3).write_bytes(segment_path(path, 3).read_bytes()[:99]),
        3,
        {3: NO_SEGMENT},
    ),
    ("segments in each other's place", swap, 1, {1: NO_SEGMENT, 2: NO_SEGMENT, 3: FITS}),
    ("a bit of a record", lambda path: flip(commit_path(path, 1), 20), 1, {1: FITS, 2: FITS, 3: FITS}),
    ("a record that is no JSON", lambda path: commit_path(path, 2).write_bytes(b"{"), 2, {2: NO_RECORD, 3: FITS}),
    ("a lost record", lambda path: commit_path(path, 1).unlink(), 1, {1: NO_RECORD, 2: FITS, 3: FITS}),
    ("a lost first record", lambda path: commit_path(path, 0).unlink(), 0, {0: NO_RECORD, 1: FITS, 2: FITS, 3: FITS}),
    ("a lost newest record", lose_the_newest_record, 3, {3: NO_RECORD}),
    ("a tail removed without its tiles", lose_the_newest_commit_but_its_tiles, 3, {}),
    ("a tail removed without the checkpoint", lose_the_newest_commit_but_the_checkpoint, 3, {}),
    ("a forged first run", lambda path: forge(path, 2, first_run="run-9999"), 2, {2: FITS, 3: FITS}),
    ("a forged count of rows", lambda path: forge(path, 1, rows=23), 1, {1: FITS, 2: FITS, 3: FITS}),
    ("commits in a place that is no folder", lambda path: (path / "commits").rename(path / "elsewhere"), 0, {}),
]
OFTEN = (
    "a bit of a segment",
    "a lost segment",
    "a record that is no JSON",
    "a lost newest record",
    "a forged first run",
    "commits in a place that is no folder",
)
"""What is tried each time; the others with `make test-all`."""


@pytest.mark.parametrize(
    ("damage", "commits", "later"),
    [pytest.param(*case, id=name, marks=[] if name in OFTEN else pytest.mark.slow) for name, *case in TAMPERING],
)
def test_what_can_be_trusted_is_said_and_copied_and_the_damaged_ledger_stays(
    path: Path, tmp_path: Path, intact: Path, damage: Callable[[Path], object], commits: int, later: dict[int, str]
) -> None:
    damage(path)
    before = contents(path)
    found = recover(path)
    assert (found.outcome, found.head.commits, found.steps) == ("damaged", commits, ())
    assert {commit.number: commit.found for commit in found.later} == later or commits == 0
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
    data = segment_path(path, 1).read_bytes()
    segment_path(path, 1).unlink()
    assert [commit.restore for commit in recover(path).later] == [sha256_hex(data), None, None]
    segment_path(path, 1).write_bytes(data)
    assert recover(path).outcome == "whole"


def test_an_altered_record_gives_no_hash_to_restore_by(path: Path) -> None:
    forge(path, 1, rows=23)
    segment_path(path, 1).unlink()
    assert {commit.restore for commit in recover(path).later} == {None}


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
    assert (recover(path, asked=asked(anchor)).outcome, recover(path, asked=asked(anchor)).anchored) == ("whole", 48)
    segment_path(path, 3).unlink()
    assert recover(path, asked=asked(anchor), into=tmp_path / "new").anchored == 48
    assert verify(tmp_path / "new", asked=asked(anchor)).ok


def test_an_anchor_of_more_than_can_be_read_vouches_where_the_tiles_prove_it(path: Path, tmp_path: Path) -> None:
    anchor = checkpoint_of(2, tmp_path)
    segment_path(path, 1).unlink()
    beyond = recover(path, asked=asked(anchor), into=tmp_path / "new")
    assert (beyond.outcome, beyond.head.commits, beyond.anchored) == ("continued", 1, 24)
    flip(path / "tile/0/000.p/48", 32 * 30)
    assert recover(path, asked=asked(anchor)).anchored is None
    append_all(tmp_path / "other", made_up_batches(4, size=13))
    segment_path(tmp_path / "other", 1).unlink()
    assert recover(tmp_path / "other", asked=asked(anchor)).anchored is None


def test_nothing_can_be_trusted_that_an_anchor_contradicts(tmp_path: Path) -> None:
    append_all(tmp_path / "ledger", made_up_batches(4, size=13))
    found = recover(tmp_path / "ledger", asked=asked(checkpoint_of(1, tmp_path)))
    assert (found.outcome, found.head.commits, found.anchored) == ("damaged", 0, None)
    assert "history was rewritten" in str(found.problems[0])


def test_what_is_no_checkpoint_is_no_anchor(path: Path, tmp_path: Path) -> None:
    (tmp_path / "anchor").write_text("hello")
    with pytest.raises(UsageError, match="expected a checkpoint of this ledger"):
        recover(path, asked=asked(tmp_path / "anchor"))


def test_with_a_key_only_what_it_signed_can_be_trusted(tmp_path: Path) -> None:
    path = tmp_path / "ledger"
    append_signed(path, BATCHES[:2])
    assert recover(path, asked=asked(is_signed=True)).outcome == "whole"
    append_all(path, BATCHES[2:])
    assert recover(path).outcome == "whole"
    found = recover(path, asked=asked(is_signed=True), into=tmp_path / "new")
    assert (found.outcome, found.head.commits, str(found.problems[0].commit)) == ("continued", 2, "2")
    assert verify(tmp_path / "new", asked=asked(is_signed=True)).ok
    append_all(tmp_path / "unsigned", BATCHES[:1])
    assert recover(tmp_path / "unsigned", asked=asked(is_signed=True)).head.commits == 0


def test_a_checkpoint_that_the_key_signed_tells_of_a_rewritten_history(tmp_path: Path) -> None:
    append_signed(tmp_path / "then", made_up_batches(2, size=13))
    path = tmp_path / "ledger"
    append_signed(path, BATCHES)
    shutil.copy(tmp_path / "then" / "checkpoint", path / "checkpoint")
    before = contents(path)
    found = recover(path, asked=asked(is_signed=True))
    assert (found.outcome, found.head.commits) == ("damaged", 0)
    assert contents(path) == before
    assert recover(path).outcome == "mended"  # without the key it is only a file that must be made again, and is kept
    assert aside(path) == {"000/checkpoint": before["checkpoint"]}


# --- anything at all ---


def damage_at_random(path: Path, draw: random.Random) -> None:
    """Alter, cut, remove or double one file, or replace it by another."""
    files = sorted(file for file in path.rglob("*") if file.is_file())
    file, other = draw.choice(files), draw.choice(files)
    data = file.read_bytes()
    match draw.randrange(6):
        case 0:
            flip(file, draw.randrange(len(data)))
        case 1:
            file.write_bytes(data[: draw.randrange(len(data))])
        case 2:
            file.unlink()
        case 3:
            file.write_bytes(data + draw.randbytes(5))
        case 4:
            file.write_bytes(other.read_bytes())
        case 5:
            file.rename(draw.choice([file.with_name("other"), path / "staging" / file.name, path / file.name]))


def assert_honest(found: Recovery, path: Path, before: dict[str, bytes]) -> None:
    """Check that a ledger that verifies afterwards kept every file, in it or beside it, and that a damaged one is
    unchanged."""
    if found.outcome in ("damaged", "continued"):
        assert contents(path) == before
        return
    assert verify(path).ok
    notes = {record.note.encode() for record in open_ledger(path).records}
    assert [
        name for name, data in before.items() if data not in {*contents(path).values(), *aside(path).values()} | notes
    ] == []


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
    trusted = path
    try:
        found = recover(path, into=folder / "new")
    except (
        LedgerCorrupted,
        UsageError,
    ):  # nothing can be trusted, or ledger.json is of something else and so is the first record
        found = Recovery("damaged", EMPTY_HEAD)
    assert_honest(found, path, before)
    if found.outcome == "continued":
        trusted = folder / "new"
        assert verify(trusted).ok
    if found.outcome != "damaged":
        runs = list(open_ledger(trusted).runs())
        assert runs == list(open_ledger(intact).runs())[: len(runs)]
        assert len(runs) == 2 * found.head.commits
