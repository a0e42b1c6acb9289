import random
import shutil
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from fsar_ledger.ledger.store.paths import segment_path
from fsar_ledger.ledger.verify.derived import BEHIND, LEFT_OVER
from fsar_ledger.ledger.verify.notes import read_anchor
from fsar_ledger.ledger.verify.report import Asked
from fsar_ledger.ledger.verify.verify import verify
from tests.ledger.damage import SIGNER, cases, files_of, is_placed, kind_of, write_ledger
from tests.ledger.forgery import examined_once, forge_segment
from tests.ledger.samples import append_all, contents, made_up_batches

SIZES = (130, 130, 20, 20)
FLIPS = 2000


def restored(path: Path, snapshots: Path, number: int) -> Path:
    """Return the whole ledger, with all its files, as it was after this many commits."""
    shutil.rmtree(path)
    return Path(shutil.copytree(snapshots / str(number), path))


# --- bytes ---


def test_the_ledger_has_files_of_every_kind(path: Path) -> None:
    assert {kind_of(name) for name in files_of(path)} == {
        "ledger.json",
        "checkpoint",
        "records",
        "segments",
        "full tiles",
        "partial tiles",
    }
    assert verify(path).ok


@pytest.mark.parametrize(
    "name",
    [
        "ledger.json",
        "checkpoint",
        pytest.param("commits/000000000000.json", marks=pytest.mark.slow),
        "commits/000000000001.json",
    ],
)
def test_a_flip_in_every_byte_of_json_and_notes_is_found_and_placed(tmp_path: Path, name: str) -> None:
    path = tmp_path / "ledger"
    write_ledger(path, (3, 3))
    bits, data = random.Random(5), (path / name).read_bytes()
    with examined_once(path):
        for at in range(len(data)):
            flipped = bytearray(data)
            flipped[at] ^= 1 << bits.randrange(8)
            (path / name).write_bytes(flipped)
            report = verify(path)
            assert is_placed(report, {name}), (at, report.problems)
        (path / name).write_bytes(data)
        assert verify(path).ok


@pytest.mark.slow
def test_two_thousand_flips_in_segments_and_tiles_are_found_and_placed(path: Path) -> None:
    draw, originals = random.Random(11), contents(path)
    for kind in ("segments", "tile"):
        names = [name for name in originals if name.startswith(kind)]
        for _ in range(FLIPS // 2 // len(names) + 1):  # one bit in each file: each is judged on its own
            for name in names:
                flipped = bytearray(originals[name])
                flipped[draw.randrange(len(flipped))] ^= 1 << draw.randrange(8)
                (path / name).write_bytes(flipped)
            problems = verify(path).problems
            assert sorted(problem.where for problem in problems) == sorted(names)
            assert all(
                problem.field == "segment_sha256" if kind == "segments" else str(problem.field).startswith("hash ")
                for problem in problems
            )
        for name in names:
            (path / name).write_bytes(originals[name])
    assert verify(path).ok


def test_a_flip_in_a_tile_names_the_event(path: Path) -> None:
    for name, at, event in (
        ("tile/0/000", 255 * 32 + 31, "event 255"),
        ("tile/0/001.p/44", 43 * 32, "event 299"),
        ("tile/1/000.p/1", 0, "events 0 to 255"),
    ):
        data = bytearray((path / name).read_bytes())
        data[at] ^= 1
        (path / name).write_bytes(data)
        (problem,) = verify(path).problems
        assert (problem.where, str(problem.field).partition("of ")[2]) == (name, event)
        data[at] ^= 1
        (path / name).write_bytes(data)
    assert verify(path).ok


def test_a_forged_signature_on_the_newest_record_is_placed_by_the_trusted_key(path: Path) -> None:
    for name in ("commits/000000000003.json", "checkpoint"):
        file, data = path / name, (path / name).read_bytes()
        at = data.rindex(b"=") - 20
        file.write_bytes(data[:at] + (b"A" if data[at : at + 1] != b"A" else b"B") + data[at + 1 :])
        assert is_placed(verify(path), {name})
        (problem, *_) = verify(path, asked=Asked(trusted=SIGNER.verifier)).problems
        assert problem.where == name
        file.write_bytes(data)
    assert verify(path, asked=Asked(trusted=SIGNER.verifier)).signature == "signed"


@pytest.mark.slow
def test_flips_in_a_segment_are_found_even_where_a_forger_made_the_file_hash_fit(tmp_path: Path) -> None:
    path = tmp_path / "ledger"
    append_all(path, made_up_batches(1, runs=1, size=40))
    data = segment_path(path, 0).read_bytes()
    writer = pq.read_metadata(segment_path(path, 0)).created_by
    draw = random.Random(13)
    for _ in range(300):
        at = draw.randrange(len(data))
        forge_segment(path, 0, data[:at] + bytes([data[at] ^ 1 << draw.randrange(8)]) + data[at + 1 :])
        report = verify(path)
        if report.ok:  # a forger may only claim that another version of pyarrow wrote the same rows
            assert pq.read_metadata(segment_path(path, 0)).created_by != writer
        else:
            assert report.problems[0].commit == 0


# --- files ---


@pytest.mark.slow
def test_every_file_removed_replaced_exchanged_or_added_is_found_and_placed(path: Path, snapshots: Path) -> None:
    found: dict[str, bool] = {}
    for case in list(cases(path)):
        case.do()
        report = verify(path)
        found[case.name] = is_placed(report, case.places)
        assert found[case.name], (case.name, report.problems)
        restored_from(path, snapshots / "whole")
    assert len(found) > 150
    assert verify(path).ok


def test_tiles_of_another_tree_are_found(path: Path, tmp_path: Path) -> None:
    write_ledger(tmp_path / "other", (131, 130, 20, 20))
    shutil.rmtree(path / "tile")
    shutil.copytree(tmp_path / "other" / "tile", path / "tile")
    assert {"tile/0/000", "tile/0/001.p/44", "tile/0/001.p/45", "tile/1/000.p/1"} <= {
        problem.where for problem in verify(path).problems
    }


def test_a_commit_of_another_ledger_is_found(path: Path, tmp_path: Path) -> None:
    write_ledger(tmp_path / "other", (130, 131, 20, 20))
    for name in ("commits/000000000001.json", "segments/000000000001.parquet"):
        shutil.copyfile(tmp_path / "other" / name, path / name)
    assert is_placed(verify(path), {"commits/000000000002.json"})


# --- what a crash leaves, and what a crash does not leave ---


def test_a_checkpoint_one_commit_behind_is_accepted_and_said(path: Path, snapshots: Path) -> None:
    shutil.copyfile(snapshots / "3" / "checkpoint", path / "checkpoint")
    report = verify(path)
    assert (report.ok, report.remarks) == (True, (BEHIND,))
    (path / "tile/0/001.p/44").unlink()
    assert verify(path).remarks == (BEHIND,)
    (path / "tile/0/001.p/24").unlink()
    assert is_placed(verify(path), {"tile/0/001.p/24"})


def test_a_checkpoint_two_commits_behind_is_found(path: Path, snapshots: Path) -> None:
    shutil.copyfile(snapshots / "2" / "checkpoint", path / "checkpoint")
    assert is_placed(verify(path), {"checkpoint"})
    (path / "checkpoint").unlink()
    assert is_placed(verify(path), {"checkpoint"})


def test_a_missing_checkpoint_is_accepted_beside_one_commit_only(tmp_path: Path) -> None:
    write_ledger(tmp_path / "ledger", (3,))
    (tmp_path / "ledger" / "checkpoint").unlink()
    assert (verify(tmp_path / "ledger").ok, verify(tmp_path / "ledger").remarks) == (True, (BEHIND,))


def test_partial_tiles_whose_full_tile_came_with_the_newest_commit_are_accepted_and_said(
    snapshots: Path, tmp_path: Path
) -> None:
    path = Path(shutil.copytree(snapshots / "2", tmp_path / "two"))
    shutil.copytree(snapshots / "1" / "tile/0/000.p", path / "tile/0/000.p")
    assert (verify(path).ok, verify(path).remarks) == (True, (LEFT_OVER,))
    (path / "tile/0/000.p/130").write_bytes(bytes(130 * 32))
    assert is_placed(verify(path), {"tile/0/000.p/130"})


def test_partial_tiles_whose_full_tile_came_earlier_are_found(path: Path, snapshots: Path) -> None:
    shutil.copytree(snapshots / "1" / "tile/0/000.p", path / "tile/0/000.p")
    assert is_placed(verify(path), {"tile/0/000.p/130"})


# --- dropped tails ---


@pytest.mark.parametrize("kept", [1, 2, 3])
def test_dropped_commits_are_found_unless_every_file_is_rolled_back(path: Path, snapshots: Path, kept: int) -> None:
    for number in range(kept, len(SIZES)):
        (path / f"commits/{number:012d}.json").unlink()
    assert is_placed(verify(path), {f"segments/{kept:012d}.parquet"})
    for number in range(kept, len(SIZES)):
        (path / f"segments/{number:012d}.parquet").unlink()
    assert is_placed(verify(path), {"checkpoint"})
    shutil.copyfile(snapshots / str(kept) / "checkpoint", path / "checkpoint")
    newest = "tile/0/000" if kept == 1 else f"tile/0/001.p/{sum(SIZES[: kept + 1]) - 256}"
    assert is_placed(verify(path), {newest})


@pytest.mark.parametrize("kept", [1, 2, 3])
@pytest.mark.parametrize("is_quick", [False, True])
def test_a_rollback_of_all_files_is_caught_by_an_anchor_and_by_nothing_else(
    path: Path, snapshots: Path, kept: int, is_quick: bool
) -> None:
    assert verify(restored(path, snapshots, kept)).ok
    for number in range(1, len(SIZES) + 1):
        anchor = read_anchor(snapshots / str(number) / "checkpoint")
        report = verify(path, asked=Asked(is_quick, SIGNER.verifier, anchor))
        assert (report.ok, report.anchored) == ((True, sum(SIZES[:number])) if number <= kept else (False, None))
        if number > kept:
            assert "the newest were removed" in report.problems[0].expected


@pytest.mark.parametrize("is_quick", [False, True])
def test_history_written_again_is_caught_by_an_anchor(snapshots: Path, tmp_path: Path, is_quick: bool) -> None:
    path = tmp_path / "other"
    write_ledger(path, (129, 131, 20, 20))
    assert verify(path).ok
    for number in range(1, len(SIZES) + 1):
        asked = Asked(is_quick, SIGNER.verifier, read_anchor(snapshots / str(number) / "checkpoint"))
        assert "history was rewritten" in str(verify(path, asked=asked).problems[0])


def restored_from(path: Path, original: Path) -> None:
    """Restore the files of the original."""
    for entry in (path, path.parent / "aside"):
        if entry.is_dir() and not entry.is_symlink():
            shutil.rmtree(entry)
        else:
            entry.unlink(missing_ok=True)
    shutil.copytree(original, path)


def test_a_checkpoint_beside_no_commit_is_found(tmp_path: Path) -> None:
    path = tmp_path / "ledger"
    append_all(path, [])
    assert verify(path).ok
    (path / "checkpoint").write_text("example.org/fsar-test\n0\n47DEQpj8HBSa+/TImW+5JCeuQeRkm5NMpJWZG3hSuFU=\n\n")
    (problem,) = verify(path).problems
    assert (problem.where, problem.expected) == ("checkpoint", "no note, as there is no commit")
