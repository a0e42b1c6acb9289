"""Checks of the verifier that other checks could mask, each on its own: the place, the words and the number of problems
are right."""

import ast
import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

from fsar_ledger.base.errors import LedgerCorrupted, NotALedger, WorkerDied
from fsar_ledger.ledger import verify as verification
from fsar_ledger.ledger.log.hashing import HASH_BYTES
from fsar_ledger.ledger.log.merkle import Frontier
from fsar_ledger.ledger.log.note import Note, checkpoint_of
from fsar_ledger.ledger.opening import open_checked, open_ledger
from fsar_ledger.ledger.rows import canonical, layout, schema, segment
from fsar_ledger.ledger.rows.grammar import Footer
from fsar_ledger.ledger.rows.schema import SCHEMA, fingerprint
from fsar_ledger.ledger.store import disk
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.segments import names_in
from fsar_ledger.ledger.verify import segment as verify_segment
from fsar_ledger.ledger.verify import verify
from fsar_ledger.ledger.verify.chain import BEHIND
from fsar_ledger.ledger.verify.report import VerifyOptions, VerifyReport, read_anchor
from tests.ledger.agreement_chain import rewrite, tables_of
from tests.ledger.damage import SIGNER, only_problem
from tests.ledger.forgery import changed, forge, forge_segment, segment_at, staged_at, table_of
from tests.ledger.mutants import CHECKED, PACKAGE, functions_of
from tests.ledger.samples import ORIGIN, made_up_run

SIZES = (270, 20)
QUICK = VerifyOptions(is_quick=True)
NEWEST = "segments/000000000270-000000000290.parquet"


# --- the look as a whole ---


def test_every_file_and_function_of_which_the_soak_removes_checks_is_there() -> None:
    for file, functions in CHECKED.items():
        tree = ast.parse((PACKAGE / "ledger" / file).read_text("utf-8"))
        assert set(functions or ()) <= {function.name for function in functions_of(tree)}, file


def test_a_worker_that_was_ended_from_outside_says_nothing_of_the_ledger(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def ended(*_: object) -> None:
        raise WorkerDied("a worker was ended")

    monkeypatch.setattr(verify_segment, "examine", ended)
    with pytest.raises(WorkerDied):
        verify(path)


@pytest.mark.parametrize("is_good", [True, False])
def test_only_a_look_that_found_something_is_made_again_where_a_writer_was_at_work(
    path: Path, monkeypatch: pytest.MonkeyPatch, is_good: bool
) -> None:
    looks: list[Path] = []
    look = verification._look

    def counted(path: Path, workers: int, progress: None, asked: VerifyOptions) -> VerifyReport:
        looks.append(path)
        return look(path, workers, progress, asked)

    monkeypatch.setattr(verification, "_look", counted)
    monkeypatch.setattr(verification, "_moment", lambda path: len(looks))
    if not is_good:
        (path / "checkpoint").write_text("")
    assert verify(path).ok == is_good
    assert len(looks) == (1 if is_good else 2)


def test_a_quick_look_that_found_something_makes_no_remark(path: Path) -> None:
    assert verify(path, asked=QUICK).remarks != ()
    (path / "checkpoint").write_text("")
    report = verify(path, asked=QUICK)
    assert (report.ok, report.remarks) == (False, ())


# --- files that cannot be read ---


def test_a_file_that_is_missing_is_named_with_the_words_of_the_system(path: Path) -> None:
    (path / "ledger.json").unlink()
    assert [(problem.where, problem.found) for problem in verify(path).problems] == [("ledger.json", "nothing")]


def test_a_ledger_that_lacks_its_description_alone_is_damaged_to_whoever_reads_or_writes_it(path: Path) -> None:
    (path / "ledger.json").unlink()
    for use in (open_ledger, lambda ledger: Writer(ledger, ORIGIN)):
        with pytest.raises(LedgerCorrupted, match=r"ledger\.json: found nothing beside chain\.jsonl"):
            use(path)
    (path / "chain.jsonl").unlink()
    with pytest.raises(NotALedger):
        open_ledger(path)


@pytest.mark.parametrize(
    ("altered", "told"),
    [
        ((b'"format"', b'"fo2mat"'), "found format None, expected 'fsar-ledger', beside chain.jsonl; restore it"),
        ((b"fsar-ledger", b"fsar-led'er"), "found format \"fsar-led'er\", expected 'fsar-ledger', beside chain.jsonl"),
        ((b'"version"', b'"verskon"'), "found other JSON than expected"),
    ],
)
def test_a_description_with_a_flipped_bit_is_damage_and_not_of_another_program_or_version(
    path: Path, altered: tuple[bytes, bytes], told: str
) -> None:
    (path / "ledger.json").write_bytes((path / "ledger.json").read_bytes().replace(*altered))
    with pytest.raises(LedgerCorrupted, match=re.escape(f"ledger.json: {told}")):
        open_checked(path)


def test_a_ledger_that_lacks_its_segments_is_damaged_to_whoever_reads_or_writes_it(path: Path) -> None:
    shutil.rmtree(path / "segments")
    (path / "checkpoint").unlink()
    for use in (open_checked, lambda ledger: Writer(ledger, ORIGIN)):
        with pytest.raises(LedgerCorrupted, match=r"segments: it cannot be read \(No such file or directory\); permit"):
            use(path)
    assert not verify(path).ok


def test_a_file_that_is_a_link_is_said_to_be_one_and_not_many(path: Path, tmp_path: Path) -> None:
    for name in ("chain.jsonl", "ledger.json"):
        (path / name).rename(tmp_path / "aside")
        (path / name).symlink_to(tmp_path / "aside")
        with pytest.raises(LedgerCorrupted, match=rf"{name}: it cannot be read \(it is a link\); permit"):
            open_checked(path)
        (path / name).unlink()
        (tmp_path / "aside").rename(path / name)


def test_what_cannot_be_read_is_told_once_in_words_and_not_by_the_name_of_an_exception(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (path / "nodes").unlink()
    (path / "nodes").mkdir()
    assert [problem.where for problem in verify(path).problems] == ["nodes", "nodes"]  # what it is; that it is unread
    (path / "chain.jsonl").unlink()
    (path / "chain.jsonl").mkdir()
    *_, last = verify(path).problems
    assert last.found.startswith(f"{path}/chain.jsonl: it cannot be read (it is not a regular file); permit")
    monkeypatch.setattr(disk, "MAX_NAMES", 1)
    with pytest.raises(LedgerCorrupted, match=r"segments: it cannot be read \(it holds more than 1 names\)"):
        names_in(path / "segments")


def test_a_segment_that_is_missing_is_named_with_the_words_of_the_system(path: Path) -> None:
    (path / NEWEST).unlink()
    problem = only_problem(path)
    assert (problem.where, problem.found, problem.field) == (NEWEST, "no segment", "segment_sha256")


def test_of_rows_of_the_journal_that_break_a_rule_the_first_is_told_and_a_quick_look_reads_none(path: Path) -> None:
    with Writer(path, ORIGIN, adopts=True) as writer:
        for number in range(3):
            writer.add([made_up_run(f"small-{number}", 4, number)])
    *segments, journal = tables_of(path)
    rewrite(path, [*segments, changed(changed(journal, "caused_by", 6, 9), "caused_by", 10, 9)])
    problem = only_problem(path)
    assert (problem.where, problem.commit, problem.seq, problem.field) == ("journal.jsonl", 3, 2, "caused_by")
    assert verify(path, asked=QUICK).ok


def test_a_right_copy_in_staging_excuses_no_damaged_segment_in_its_place(path: Path) -> None:
    shutil.copyfile(path / NEWEST, staged_at(path, 1))
    assert verify(path).ok
    (path / NEWEST).write_bytes((path / NEWEST).read_bytes()[:-1])
    assert only_problem(path).where == NEWEST


def test_readers_take_a_segment_in_its_place_whatever_else_is_staged(path: Path) -> None:
    staged_at(path, 1).write_bytes(b"half")
    assert open_ledger(path).segment(1) == path / NEWEST


def test_readers_find_a_segment_that_a_writer_moves_into_its_place_meanwhile(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place, staged, lstat = path / NEWEST, staged_at(path, 1), os.lstat
    place.rename(staged)

    def moved_just_before(looked_at: str) -> os.stat_result:
        if looked_at == str(staged) and staged.exists():
            staged.rename(place)
        return lstat(looked_at)

    monkeypatch.setattr(os, "lstat", moved_just_before)
    assert open_ledger(path).segment(1) == place


def test_half_a_footer_is_refused(path: Path) -> None:
    data = segment_at(path, 1).read_bytes()
    length = int.from_bytes(data[-8:-4], "little")
    for left in range(length // 2, length // 2 + 40):  # in the middle of a list, of a text, between fields
        footer = data[-8 - length : -8][:left]
        (path / NEWEST).write_bytes(data[: -8 - length] + footer + len(footer).to_bytes(4, "little") + b"PAR1")
        with pytest.raises(LedgerCorrupted, match="the segment cannot be read: found the footer: "):
            layout.check_layout(path / NEWEST, layout.read_file(path / NEWEST))


def test_a_document_is_a_regular_file_and_not_too_long(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "file").write_bytes(bytes(100))
    with pytest.raises(OSError, match="it is not a regular file"):
        disk.read_document(tmp_path / "pipe")
    monkeypatch.setattr(disk, "MAX_DOCUMENT_BYTES", 99)
    with pytest.raises(OSError, match="it is larger than 99 bytes"):
        disk.read_document(tmp_path / "file")
    monkeypatch.setattr(disk, "MAX_DOCUMENT_BYTES", 100)
    assert disk.read_document(tmp_path / "file") == bytes(100)


def test_columns_of_another_release_than_the_records_are_found(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    table = table_of(path, 1)
    fewer = table.drop_columns(
        [next(name for name in reversed(table.column_names) if table[name].null_count == len(table))]
    )
    monkeypatch.setitem(schema.FINGERPRINTS, "0.0.9", fingerprint(fewer.schema))
    monkeypatch.setattr(layout, "_footers", lambda: tuple(map(Footer, (fewer.schema, SCHEMA))))
    forge_segment(path, 1, fewer)
    problem = verify(path).problems[0]
    assert (problem.where, problem.field, problem.found) == (NEWEST, "schema_sha256", fingerprint(fewer.schema))
    forge(path, "placement", 1, release="0.0.9", schema_sha256=fingerprint(fewer.schema))
    assert "schema_sha256" not in {problem.field for problem in verify(path).problems}


# --- what a file holds beside its rows ---


def with_dictionary(table: pa.Table, change: Callable[[pa.DictionaryArray], pa.DictionaryArray]) -> bytes:
    """Return the segment of these rows, written by us except for the dictionary of their types."""
    table = segment.coded(table)
    column = change(table["type"].combine_chunks())
    at = table.schema.get_field_index("type")
    return bytes(segment.to_parquet(table.set_column(at, table.schema.field(at), column)))


def backwards(column: pa.DictionaryArray) -> pa.DictionaryArray:
    last = len(column.dictionary) - 1
    return pa.DictionaryArray.from_arrays(pc.subtract(last, column.indices).cast(pa.int32()), column.dictionary[::-1])


def with_one_more(column: pa.DictionaryArray) -> pa.DictionaryArray:
    return pa.DictionaryArray.from_arrays(column.indices, pa.concat_arrays([column.dictionary, pa.array(["Zzz.v1"])]))


@pytest.mark.parametrize("change", [backwards, with_one_more])
def test_a_dictionary_that_we_would_not_have_written_is_found(
    path: Path, change: Callable[[pa.DictionaryArray], pa.DictionaryArray]
) -> None:
    data = with_dictionary(table_of(path, 1), change)
    forge_segment(path, 1, data)
    assert pq.read_table(pa.BufferReader(data)).equals(
        pq.read_table(pa.BufferReader(segment.to_parquet(table_of(path, 1))))
    )
    assert only_problem(path).found == "other bytes"


@pytest.mark.parametrize(("name", "said"), [("least", 0), ("most", 1)])
def test_a_bound_that_hides_rows_is_found_whoever_wrote_it(path: Path, name: str, said: int) -> None:
    version = pa.__version__.encode()
    data = segment_at(path, 1).read_bytes().replace(version, b"9" * len(version))
    times = table_of(path, 1)["time_us"].to_pylist()
    bound = (min(times), max(times))[said].to_bytes(8, "little", signed=True)
    first = len(data) - 8 - int.from_bytes(data[-8:-4], "little")
    assert bound in data[first:]
    forge_segment(path, 1, data[:first] + data[first:].replace(bound, (7).to_bytes(8, "little")))
    assert "of column " in only_problem(path).found


# --- anchors ---


def test_an_anchor_within_the_newest_commit_is_proved_by_the_rows_where_its_hashes_are_not_there_yet(
    path: Path, snapshots: Path, tmp_path: Path
) -> None:
    view = open_ledger(path)
    leaves = canonical.leaves(view.table(0)) + canonical.leaves(view.table(1))
    tree = checkpoint_of(ORIGIN, Frontier().extend(leaves[: 280 * HASH_BYTES]))
    (tmp_path / "anchor").write_text(str(Note(tree, (SIGNER.sign(tree),))))
    for name in ("checkpoint", "nodes", "index.jsonl"):
        shutil.copyfile(snapshots / "1" / name, path / name)
    report = verify(path, asked=VerifyOptions(trusted=SIGNER.verifier, anchor=read_anchor(tmp_path / "anchor")))
    assert (report.ok, report.anchored, report.remarks) == (True, 280, (BEHIND,))
