import shutil
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest

from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows import canonical
from fsar_ledger.ledger.store.manifest import Manifest
from fsar_ledger.ledger.store.paths import segment_name
from fsar_ledger.ledger.store.problem import Problem
from fsar_ledger.ledger.verify import verify
from fsar_ledger.ledger.verify.report import MAX_PROBLEMS, VerifyOptions
from fsar_ledger.ledger.verify.segment import examine_all
from tests.ledger.damage import SIGNER
from tests.ledger.forgery import changed, forge, forge_segment, segment_at, table_of
from tests.ledger.hostile import append_again
from tests.ledger.samples import ORIGIN, append_all, made_up_batches, made_up_run

BATCHES = COMMITTED = made_up_batches(3)


def first_problem(path: Path) -> Problem:
    report = verify(path)
    assert not report.ok
    assert report.root is None
    assert str(report.problems[0]).startswith(report.problems[0].where)
    return report.problems[0]


# --- a ledger as it should be ---


def test_an_intact_ledger_verifies_and_is_counted(path: Path) -> None:
    report = verify(path)
    assert (report.ok, report.problems, report.signature) == (True, (), "unsigned")
    assert (report.commits, report.events, report.runs) == (3, 72, 6)
    assert report.root == open_ledger(path).head.root


@pytest.mark.slow
def test_workers_find_the_same_and_progress_is_told(intact: Path, tmp_path: Path) -> None:
    path = Path(shutil.copytree(intact, tmp_path / "ledger"))
    told: list[tuple[int, int]] = []
    assert verify(path, workers=2, progress=lambda done, total: told.append((done, total))) == verify(path)
    assert told == [(1, 3), (2, 3), (3, 3)]
    forge_segment(path, 1, changed(table_of(path, 1), "time_us", 3, 1))
    assert verify(path, workers=2) == verify(path)


def test_verify_looks_again_where_a_writer_has_changed_the_ledger_meanwhile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "ledger"
    append_all(path, BATCHES[:2])

    def then_another_is_made(*given: Any, **options: Any) -> object:
        found = examine_all(*given, **options)
        monkeypatch.undo()
        append_all(path, BATCHES[2:])
        return found

    monkeypatch.setattr("fsar_ledger.ledger.verify.chain.examine_all", then_another_is_made)
    report = verify(path)
    assert (report.problems, report.commits) == ((), 3)


# --- files ---


@pytest.mark.parametrize(
    "name",
    [
        *("notes.txt", "tile", "chain.jsonl~", "segments/000000000072-000000000096.parquet"),
        "segments/000000000000-000000000048.parquet",
        *("segments/+00000000000-000000000024.parquet", "segments/x"),
    ],
)
def test_an_unknown_file_is_named(path: Path, name: str) -> None:
    (path / name).write_bytes(b"x")
    assert name in {problem.where for problem in verify(path).problems}


def test_what_lies_in_staging_is_harmless(path: Path) -> None:
    (path / "staging" / "x.tmp").write_bytes(b"half")
    assert verify(path).ok
    shutil.rmtree(path / "staging")
    assert verify(path).ok


# --- records ---


def test_json_that_means_the_same_in_other_bytes_is_found(path: Path) -> None:
    for name in ("ledger.json", "chain.jsonl"):
        data = (path / name).read_bytes()
        (path / name).write_bytes(data.replace(b",", b", ", 1))
        assert first_problem(path).where == name
        (path / name).write_bytes(data)


def test_another_origin_is_found(path: Path) -> None:
    (path / "ledger.json").write_bytes(canonical.document(Manifest("fsar-ledger", "other.org/x", 2)))
    problem = first_problem(path)
    assert (problem.commit, problem.field) == (0, "previous_sha256")
    assert "ledger.json" in problem.expected
    forge(path, "commit", 0)
    assert first_problem(path).where == "checkpoint"


@pytest.mark.parametrize(
    "manifest",
    [Manifest("fsar-ledger", ORIGIN, 3), Manifest("photos", ORIGIN, 2), Manifest("fsar-ledger", "two words", 2)],
)
def test_another_format_is_found(path: Path, manifest: Manifest) -> None:
    (path / "ledger.json").write_bytes(canonical.document(manifest))
    assert first_problem(path).where == "ledger.json"


RECORDS = [
    *(("commit", *change) for change in [("number", 5), ("release", "0.0.9"), ("release", "99.0.0"), ("rows", 25)]),
    *(("commit", *change) for change in [("tree_size", 7), ("tree_root", "0" * 64), ("continues", [["run-0000", 3]])]),
    *(("commit", *change) for change in [("goes_on", ["nobody"]), ("signature", "A" * 92)]),
    *(("placement", *change) for change in [("number", 5), ("release", "0.0.9"), ("schema_sha256", "0" * 64)]),
    *(("placement", *change) for change in [("segment_sha256", "0" * 64), ("segment_bytes", 1), ("first", 3)]),
    *(("placement", *change) for change in [("rows", 25), ("frontier", ["0" * 64]), ("index_sha256", "0" * 64)]),
    ("placement", "index_bytes", 5),
]


@pytest.mark.parametrize(("kind", "field", "value"), RECORDS)
@pytest.mark.parametrize("number", [0, 1, 2])
def test_every_field_of_a_record_is_derived_again(
    path: Path, kind: str, field: str, value: object, number: int
) -> None:
    forge(path, kind, number, **{field: value})
    report = verify(path)
    if report.ok:
        assert field == "signature"  # nothing but a key vouches for one
        report = verify(path, asked=VerifyOptions(trusted=SIGNER.verifier))
    assert not report.ok
    assert report.problems[0].where in ("chain.jsonl", "checkpoint", segment_name(24 * number, 24 * number + 24))


@pytest.mark.parametrize("field", ["index_bytes", "index_sha256"])
def test_a_placement_that_tells_half_of_its_line_of_the_index_is_damage_and_no_torn_end(path: Path, field: str) -> None:
    forge(path, "placement", 1, **{field: None})  # what follows is one append, which a crash may tear
    problem = first_problem(path)
    assert (problem.where, problem.field) == ("chain.jsonl", field)


def test_a_chain_that_is_a_link_is_named(path: Path, tmp_path: Path) -> None:
    (path / "chain.jsonl").rename(tmp_path / "aside")
    (path / "chain.jsonl").symlink_to(tmp_path / "aside")
    assert first_problem(path).where == "chain.jsonl"


# --- segments that a forger changed together with the file hash ---


def test_an_altered_row_is_found_by_the_tree(path: Path) -> None:
    forge_segment(path, 1, changed(table_of(path, 1), "time_us", 3, 1))
    problem = first_problem(path)
    assert (problem.where, problem.commit, problem.field) == (
        "segments/000000000024-000000000048.parquet",
        1,
        "tree_root",
    )


@pytest.mark.parametrize(
    ("field", "row", "value"),
    [("seq", 5, 7), ("caused_by", 14, 14), ("type", 5, "RobotFlew.v1"), ("time_us", 5, 2**60)],
)
def test_a_row_that_cannot_be_is_named(path: Path, field: str, row: int, value: object) -> None:
    forge_segment(path, 1, changed(table_of(path, 1), field, row, value))
    problem = first_problem(path)
    assert (problem.commit, problem.run, problem.field) == (1, "run-0002" if row < 12 else "run-0003", field)
    assert problem.seq == (value if field == "seq" else row % 12)


def test_a_row_too_few_or_too_many_is_found(path: Path) -> None:
    table = table_of(path, 1)
    for other in (table.slice(0, 23), pa.concat_tables([table, table.slice(0, 1)])):
        forge_segment(path, 1, other)
        assert (first_problem(path).commit, first_problem(path).field) == (1, "rows")


def test_a_run_in_two_commits_is_found(tmp_path: Path) -> None:
    again = made_up_run("run-0000", 12, seed=9)
    append_all(tmp_path / "ledger", BATCHES[:2])
    append_again(tmp_path / "ledger", [again])
    problem = first_problem(tmp_path / "ledger")
    assert (problem.commit, problem.run, problem.field) == (2, "run-0000", "run_id")


# --- very much ---


def test_more_problems_than_anyone_reads_are_cut(path: Path) -> None:
    for number in range(MAX_PROBLEMS + 5):
        (path / f"stray-{number}").write_bytes(b"")
    assert len(verify(path).problems) == MAX_PROBLEMS


# --- statistics ---

VERSION = pa.__version__.encode()
OTHER_VERSION = b"9" * len(VERSION)


def test_statistics_that_hide_rows_are_found_whoever_wrote_them(path: Path) -> None:
    data = segment_at(path, 1).read_bytes()
    honest = data.replace(VERSION, OTHER_VERSION)
    footer = len(data) - int.from_bytes(data[-8:-4], "little")
    lying = data[:footer] + data[footer:].replace(b"run-0003", b"run-0002")
    assert lying != data != honest
    forge_segment(path, 1, honest)
    assert verify(path).ok
    forge_segment(path, 1, lying)
    assert (first_problem(path).commit, first_problem(path).found) == (1, "other bytes")
    forge_segment(path, 1, lying.replace(VERSION, OTHER_VERSION))
    assert "to b'run-0003'" in first_problem(path).expected
