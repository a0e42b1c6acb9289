"""What a whole look found right is remembered: by hashes, for this user, never in the ledger, and never for anything
else."""

import os
import shutil
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

import pytest

from fsar_ledger.base.errors import LedgerCorrupted, SequenceConflict
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows.layout import Layout, check_layout
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.ledger.verify import verify
from fsar_ledger.ledger.verify.report import VerifyOptions
from fsar_ledger.metrics import verified
from fsar_ledger.metrics.database import connect, from_rows
from fsar_ledger.metrics.verified import ensure_verified, full_verify, is_remembered
from tests.ledger.damage import files_of
from tests.ledger.forgery import changed, forge_segment, table_of
from tests.quick import few

from .conftest import record


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The user's cache of this program: nothing is remembered yet."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "fsar-ledger"


def known(ledger: Path) -> bool | None:
    """Whether an answer of this ledger says that its rows were compared with the root."""
    with connect(ledger) as database:
        return database.rows_verified


def test_rows_are_verified_after_a_whole_look_and_not_before(ledger: Path) -> None:
    assert not known(ledger)
    assert full_verify(ledger).ok
    assert known(ledger)


def test_a_whole_look_is_a_look_at_the_layout_of_every_segment(ledger: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    looked: list[Path] = []

    def look(path: Path, data: bytes) -> Layout:
        looked.append(path)
        return check_layout(path, data)

    monkeypatch.setattr("fsar_ledger.ledger.store.read.check_layout", look)
    connect(ledger).close()
    assert looked
    full_verify(ledger)
    looked.clear()
    connect(ledger).close()
    assert not looked


def test_a_quick_look_is_not_remembered(ledger: Path) -> None:
    assert full_verify(ledger, asked=VerifyOptions(is_quick=True)).ok
    assert not known(ledger)


def test_a_look_that_doubts_something_is_not_remembered(ledger: Path) -> None:
    rows = table_of(ledger, 1)
    forge_segment(ledger, 1, changed(rows, "time_us", 1, 4))
    assert not full_verify(ledger).ok
    assert not known(ledger)
    with pytest.raises(
        LedgerCorrupted, match=r"commit 1, field tree_root: found Merkle root .* run fsar-ledger verify"
    ):
        ensure_verified(ledger)


def test_a_ledger_that_was_looked_at_and_grew_is_to_be_looked_at_again(ledger: Path) -> None:
    looked = ensure_verified(ledger)
    with Writer(ledger, "test") as writer:
        writer.append(stage(ledger, [record("fsar", 7)]))
    assert not known(ledger)
    with pytest.raises(SequenceConflict, match="found another newest commit than a moment ago"):
        connect(ledger, demanded=looked)


def test_a_copy_is_the_same_ledger_and_one_with_other_segments_is_none(ledger: Path, tmp_path: Path) -> None:
    full_verify(ledger)
    copy = Path(shutil.copytree(ledger, tmp_path / "copy"))
    assert known(copy)
    segment = open_ledger(copy).segment(0)
    segment.write_bytes(bytes([segment.read_bytes()[0] ^ 1]) + segment.read_bytes()[1:])
    with pytest.raises(LedgerCorrupted, match="found SHA-256"):
        connect(copy)


def test_the_look_leaves_the_ledger_as_it_is(ledger: Path, cache: Path) -> None:
    before = {name: (ledger / name).read_bytes() for name in files_of(ledger)}
    full_verify(ledger)
    assert {name: (ledger / name).read_bytes() for name in files_of(ledger)} == before
    assert len(list(cache.iterdir())) == 1


def test_nothing_is_remembered_inside_a_ledger(ledger: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(ledger))
    assert full_verify(ledger).ok
    assert not (ledger / "fsar-ledger").exists()
    assert verify(ledger).ok


@pytest.mark.parametrize("name", ["fsar-ledger", "pyarrow", "duckdb"])
def test_another_version_looks_again(ledger: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    full_verify(ledger)
    if name == "fsar-ledger":
        monkeypatch.setattr(verified, "__version__", "9.9.9")
    else:
        monkeypatch.setattr(
            "fsar_ledger.metrics.verified.version", lambda package: "9.9.9" if package == name else version(package)
        )
    assert not known(ledger)


def a_folder_others_can_write(cache: Path) -> None:
    cache.chmod(0o777)


def a_file_others_can_write(cache: Path) -> None:
    next(cache.iterdir()).chmod(0o620)


def a_link_to_the_folder(cache: Path) -> None:
    cache.rename(cache.parent / "elsewhere")
    cache.symlink_to(cache.parent / "elsewhere")


def a_link_to_the_file(cache: Path) -> None:
    (file,) = cache.iterdir()
    file.rename(cache.parent / "elsewhere")
    file.symlink_to(cache.parent / "elsewhere")


def half_a_file(cache: Path) -> None:
    (file,) = cache.iterdir()
    file.write_bytes(file.read_bytes()[:32])


def a_file_of_another_head(cache: Path) -> None:
    next(cache.iterdir()).write_text(f"{'0' * 64}\n")


def a_folder_in_its_place(cache: Path) -> None:
    (file,) = cache.iterdir()
    file.unlink()
    file.mkdir()


def a_pipe_in_its_place(cache: Path) -> None:
    (file,) = cache.iterdir()
    file.unlink()
    os.mkfifo(file)


def a_file_in_place_of_the_folder(cache: Path) -> None:
    shutil.rmtree(cache)
    cache.write_text("")


@pytest.mark.parametrize(
    "spoil",
    few(
        [
            *(a_folder_others_can_write, a_file_others_can_write, a_link_to_the_folder),
            *(a_link_to_the_file, half_a_file, a_file_of_another_head, a_folder_in_its_place),
            *(a_pipe_in_its_place, a_file_in_place_of_the_folder),
        ],
        [a_folder_others_can_write, a_link_to_the_file, a_file_of_another_head, a_pipe_in_its_place],
    ),
)
def test_a_cache_that_others_may_have_written_is_not_believed(
    ledger: Path, cache: Path, spoil: Callable[[Path], None]
) -> None:
    full_verify(ledger)
    assert known(ledger)
    spoil(cache)
    assert not known(ledger)
    assert full_verify(ledger).ok  # to remember nothing is no error


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files away")
def test_a_cache_of_another_user_is_not_believed(ledger: Path, cache: Path) -> None:
    full_verify(ledger)
    os.chown(next(cache.iterdir()), 12345, 12345)
    assert not known(ledger)
    os.chown(next(cache.iterdir()), 0, 0)
    os.chown(cache, 12345, 12345)
    assert not known(ledger)


def test_a_cache_that_cannot_be_written_is_no_error(ledger: Path, tmp_path: Path, cache: Path) -> None:
    cache.parent.write_text("a file where the folder would be")
    report = full_verify(ledger)
    assert report.ok
    assert not known(ledger)
    with connect(ledger, demanded=report.record_sha256) as database:  # who looked a moment ago knows without memory
        assert database.rows_verified


def test_the_cache_is_for_this_user_alone(ledger: Path, cache: Path) -> None:
    before = os.umask(0)
    try:
        full_verify(ledger)
    finally:
        os.umask(before)
    assert cache.stat().st_mode & 0o777 == 0o700
    assert next(cache.iterdir()).stat().st_mode & 0o777 == 0o600


def test_without_a_home_nothing_is_remembered(ledger: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    full_verify(ledger)
    assert known(ledger)
    assert len(list((tmp_path / "home" / ".cache" / "fsar-ledger").iterdir())) == 1
    monkeypatch.setattr(Path, "home", no_home)
    assert not known(ledger)
    assert full_verify(ledger).ok


def no_home() -> Path:
    raise RuntimeError("Could not determine home directory.")


def test_an_empty_ledger_has_no_rows_to_doubt_and_rows_in_memory_have_no_root(empty_ledger: Path) -> None:
    assert known(empty_ledger)
    assert not is_remembered(open_ledger(empty_ledger).record_sha256)
    with from_rows([]) as database:
        assert (database.head, database.rows_verified) == (None, None)
