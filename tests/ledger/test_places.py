import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import cast

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from fsar_ledger.errors import InvalidQuery, LedgerCorrupted, UsageError
from fsar_ledger.ledger.rows import segment
from fsar_ledger.ledger.store import walk
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.paths import commit_path, segment_path, staged_path
from fsar_ledger.ledger.store.read import open_ledger
from fsar_ledger.ledger.verify import segment as verify_segment
from fsar_ledger.ledger.verify.derived import BEHIND
from fsar_ledger.ledger.verify.recover import recover
from fsar_ledger.ledger.verify.segment import examine
from fsar_ledger.ledger.verify.verify import verify
from tests.ledger import thrift
from tests.ledger.damage import only_problem
from tests.ledger.forgery import forge, forge_segment, record_of, table_of
from tests.ledger.parts import Parts
from tests.ledger.samples import ORIGIN

SIZES = (130, 130, 20)
LAST = "000000000002"


# --- files and folders ---


def test_a_segment_that_is_no_file_is_said_to_be_none(path: Path) -> None:
    segment_path(path, 2).unlink()
    os.mkfifo(segment_path(path, 2))
    assert (only_problem(path).where, only_problem(path).found) == (
        f"segments/{LAST}.parquet",
        "a link or something else than a file",
    )


def test_a_staged_segment_that_is_a_link_is_a_missing_segment(path: Path, tmp_path: Path) -> None:
    staged = staged_path(path, record_of(path, 2).segment_sha256)
    segment_path(path, 2).rename(staged)
    assert verify(path).ok
    staged.rename(tmp_path / "aside")
    staged.symlink_to(tmp_path / "aside")
    assert (only_problem(path).where, only_problem(path).commit) == (f"segments/{LAST}.parquet", 2)


def test_a_segment_in_a_staging_folder_that_is_a_link_is_a_missing_segment(path: Path, tmp_path: Path) -> None:
    segment_path(path, 2).rename(staged_path(path, record_of(path, 2).segment_sha256))
    assert verify(path).ok
    shutil.move(path / "staging", tmp_path / "aside")
    (path / "staging").symlink_to(tmp_path / "aside")
    found = walk.find_segment(path, 2, record_of(path, 2))
    assert (found.status, found.problem is None) == (None, False)
    assert ("no segment", 2) in {(problem.found, problem.commit) for problem in verify(path).problems}


def as_a_link_in_staging(path: Path, aside: Path) -> None:
    shutil.move(segment_path(path, 2), aside)
    staged_path(path, record_of(path, 2).segment_sha256).symlink_to(aside)


def as_a_link_in_its_place(path: Path, aside: Path) -> None:
    shutil.move(segment_path(path, 2), aside)
    segment_path(path, 2).symlink_to(aside)


def as_nothing(path: Path, aside: Path) -> None:
    shutil.move(segment_path(path, 2), aside)


def as_half_of_it(path: Path, aside: Path) -> None:
    shutil.copyfile(segment_path(path, 2), aside)
    segment_path(path, 2).write_bytes(aside.read_bytes()[:-9])


def with_a_record_of_something_else(path: Path, aside: Path) -> None:
    shutil.copyfile(commit_path(path, 2), aside)
    commit_path(path, 2).write_bytes(b"{}")


def with_a_record_that_is_a_link(path: Path, aside: Path) -> None:
    shutil.move(commit_path(path, 2), aside)
    commit_path(path, 2).symlink_to(aside)


def with_a_folder_that_is_a_link(path: Path, aside: Path) -> None:
    shutil.move(path / "segments", aside)
    (path / "segments").symlink_to(aside)


@pytest.mark.parametrize(
    "damage",
    [
        as_a_link_in_staging,
        as_a_link_in_its_place,
        as_nothing,
        as_half_of_it,
        with_a_record_of_something_else,
        with_a_record_that_is_a_link,
        with_a_folder_that_is_a_link,
    ],
)
def test_verify_recover_readers_and_writers_say_the_same_of_the_same_damage(
    path: Path, tmp_path: Path, damage: Callable[[Path, Path], None]
) -> None:
    damage(path, tmp_path / "aside")
    said = str(verify(path).problems[0])
    assert [str(problem) for problem in recover(path).problems] == [said]
    with pytest.raises(LedgerCorrupted) as reader:
        open_ledger(path).segments()
    with pytest.raises(LedgerCorrupted) as writer:
        Writer(path, ORIGIN)
    assert str(reader.value) == str(writer.value)
    assert str(reader.value).startswith(f"{path}/{said}; restore ")


def test_a_segment_that_its_writer_moves_meanwhile_is_examined_where_it_is_now(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record, place = record_of(path, 2), segment_path(path, 2)
    staged = staged_path(path, record.segment_sha256)
    place.rename(staged)
    read = walk.read_segment

    def moved(ledger: Path, file: str, *rest: object, **named: object) -> object:
        if staged.exists():
            staged.rename(place)
        return read(ledger, file, *rest, **named)  # type: ignore[arg-type]

    monkeypatch.setattr(verify_segment, "read_segment", moved)
    facts = examine(str(path), 2, record)
    assert (facts.problems, facts.file, facts.rows) == ((), f"segments/{LAST}.parquet", SIZES[2])


def test_a_segment_that_is_gone_whenever_it_is_read_is_a_problem(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def gone(*_: object, **__: object) -> None:
        raise FileNotFoundError(2, "No such file or directory")

    monkeypatch.setattr(verify_segment, "read_segment", gone)
    facts = examine(str(path), 2, record_of(path, 2))
    assert [problem.where for problem in facts.problems] == [f"segments/{LAST}.parquet"]
    assert "FileNotFoundError" in facts.problems[0].found


def test_a_missing_segment_of_an_unreadable_record_is_the_records_problem(path: Path) -> None:
    commit_path(path, 2).write_bytes(b"{}")
    segment_path(path, 2).unlink()
    assert only_problem(path).where == f"commits/{LAST}.json"


def test_a_missing_folder_is_missing_and_no_accident(path: Path) -> None:
    shutil.rmtree(path / "segments")
    problems = verify(path).problems
    assert {problem.where.partition("/")[0] for problem in problems} == {"segments"}


def test_nothing_behind_a_link_is_read(path: Path, tmp_path: Path) -> None:
    (path / "segments").rename(tmp_path / "aside")
    (path / "segments").symlink_to(tmp_path / "aside")
    (tmp_path / "aside" / "stray").write_bytes(b"")
    assert "segments/stray" not in {problem.where for problem in verify(path).problems}


def test_a_longer_tile_is_said_to_be_longer(path: Path) -> None:
    (path / "tile/0/000").write_bytes((path / "tile/0/000").read_bytes() + b"\0")
    assert (only_problem(path).where, only_problem(path).found) == ("tile/0/000", "8193 bytes")


def test_outgrown_tiles_behind_a_checkpoint_that_is_behind_are_one_remark(snapshots: Path, tmp_path: Path) -> None:
    path = Path(shutil.copytree(snapshots / "2", tmp_path / "two"))
    shutil.copytree(snapshots / "1" / "tile/0/000.p", path / "tile/0/000.p")
    shutil.copyfile(snapshots / "1" / "checkpoint", path / "checkpoint")
    assert (verify(path).ok, verify(path).remarks) == (True, (BEHIND,))


# --- records ---


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.upper(),
        lambda text: text[:30] + "  " + text[30:],
        lambda text: text[:-1],
        lambda text: text[:-1] + "g",
    ],
)
@pytest.mark.parametrize("field", ["frontier", "segment_sha256"])
def test_a_hash_in_other_letters_is_found_in_its_record(path: Path, field: str, change) -> None:  # type: ignore[no-untyped-def]
    value = getattr(record_of(path, 2), field)
    forge(path, 2, **{field: tuple(map(change, value)) if field == "frontier" else change(value)})
    assert only_problem(path).where == f"commits/{LAST}.json"
    assert f"field {field}" in only_problem(path).found


@pytest.mark.parametrize(
    "signatures", ["", "\N{EM DASH} other.org/x {data}\n", "\N{EM DASH} example.org/fsar-test AAAAAAAA\n", "{own}{own}"]
)
def test_a_note_of_a_record_is_signed_by_the_ledgers_own_key_or_by_nobody(path: Path, signatures: str) -> None:
    body, _, own = record_of(path, 2).note.rpartition("\n\n")
    note = f"{body}\n\n" + signatures.format(own=own, data=own.split(" ")[2].strip())
    forge(path, 2, note=note)
    (path / "checkpoint").write_text(note)
    report = verify(path)
    assert report.ok == (signatures == "")
    assert report.ok or (report.problems[0].where, report.problems[0].field) == (f"commits/{LAST}.json", "note")


# --- a check that fails unexpectedly ---


def test_a_check_that_fails_in_a_way_nobody_thought_of_is_a_finding_in_its_place(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise ZeroDivisionError("nobody thought of this")

    for module, name, place in (
        (walk, "parse_manifest", "ledger.json"),
        (walk, "parse_record", f"commits/{LAST}.json"),
        (verify_segment, "first_flaw", f"segments/{LAST}.parquet"),
        (verify_segment, "check_layout", f"segments/{LAST}.parquet"),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(module, name, fail)
            patch.setattr(verify_segment, "examine", examine)  # each segment is decoded
            assert place in {problem.where for problem in verify(path).problems if "ZeroDivisionError" in problem.found}


@pytest.mark.parametrize(
    "error",
    [
        ModuleNotFoundError("No module named 'fsar_ledger.queries'"),
        InvalidQuery("queries/staging/x.sql:1: found no title"),
        UsageError("reports/metrics.toml:7: found an unknown field"),
        MemoryError(),
    ],
    ids=lambda error: type(error).__name__,
)
def test_what_is_wrong_with_the_installation_is_no_problem_of_the_ledger(
    path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(verify_segment, "first_flaw", fail)
    monkeypatch.setattr(verify_segment, "examine", examine)  # each segment is decoded
    with pytest.raises(type(error)):
        verify(path)


# --- what a Parquet footer says of rows ---


def other_version(path: Path) -> bytes:
    """Return the segment as another version of pyarrow may have written it."""
    version = pa.__version__.encode()
    return segment_path(path, 2).read_bytes().replace(version, b"9" * len(version))


def test_a_count_of_nulls_that_hides_rows_is_found_whoever_wrote_it(path: Path) -> None:
    data = other_version(path)
    for name in ("run_id", "seq", "time_us"):
        parts = Parts(data)
        thrift.put(cast(thrift.Struct, thrift.field(parts.about(parts.number_of(name)), 12)), 3, 1)
        forge_segment(path, 2, bytes(parts))
        assert f"column {name}" in only_problem(path).found
        assert (
            "other statistics" if name == "run_id" else f"statistics that say 1 NULL of column {name}"
        ) in only_problem(path).found


def test_a_footer_that_contradicts_itself_does_not_end_the_process(path: Path) -> None:
    data = other_version(path)
    for number in (1, 2, 3, 20, 120):
        parts = Parts(data)
        thrift.put(parts.about(number), 1, 3)  # pyarrow would end it
        forge_segment(path, 2, bytes(parts))
        assert "'INT96'), expected" in only_problem(path).found


def test_a_page_index_is_found_whoever_wrote_it(path: Path) -> None:
    sink = pa.BufferOutputStream()
    pq.write_table(
        segment.coded(table_of(path, 2)),
        sink,
        store_schema=False,
        compression="zstd",
        write_page_index=True,
        write_page_checksum=True,
    )
    version = pa.__version__.encode()
    forge_segment(path, 2, bytes(sink.getvalue()).replace(version, b"9" * len(version)))
    assert "an index or a Bloom filter" in only_problem(path).found
