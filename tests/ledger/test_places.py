import shutil
from pathlib import Path
from typing import cast

import pyarrow as pa
import pytest

from fsar_ledger.base.errors import InvalidQuery, UsageError
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.store import segments
from fsar_ledger.ledger.store.paths import CHAIN
from fsar_ledger.ledger.store.record import segment_of
from fsar_ledger.ledger.store.segments import Names
from fsar_ledger.ledger.verify import segment as verify_segment
from fsar_ledger.ledger.verify import verify
from fsar_ledger.ledger.verify.segment import SegmentFacts, examine
from tests.ledger import thrift
from tests.ledger.damage import only_problem
from tests.ledger.forgery import forge_segment, segment_at, staged_at
from tests.ledger.parts import Parts

SIZES = (130, 130, 20)
LAST = "000000000260-000000000280"


# --- files and folders ---


def test_a_staged_segment_that_is_a_link_is_a_missing_segment(path: Path, tmp_path: Path) -> None:
    staged = staged_at(path, 2)
    segment_at(path, 2).rename(staged)
    assert verify(path).ok
    staged.rename(tmp_path / "aside")
    staged.symlink_to(tmp_path / "aside")
    assert (only_problem(path).where, only_problem(path).commit) == (f"segments/{LAST}.parquet", 2)


def examined(path: Path) -> SegmentFacts:
    """Return what the last segment holds."""
    placement = open_ledger(path).chain.placements[2]
    return examine(str(path), 2, placement, Names(segment_of(placement), CHAIN))


def test_a_segment_that_its_writer_moves_meanwhile_is_examined_where_it_is_now(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place, staged = segment_at(path, 2), staged_at(path, 2)
    place.rename(staged)
    read = segments.read_segment

    def moved(ledger: Path, file: str, *rest: object, **named: object) -> object:
        if staged.exists():
            staged.rename(place)
        return read(ledger, file, *rest, **named)  # type: ignore[arg-type]

    monkeypatch.setattr(verify_segment, "read_segment", moved)
    facts = examined(path)
    assert (facts.problems, facts.file, facts.rows) == ((), f"segments/{LAST}.parquet", SIZES[2])


def test_a_segment_that_is_gone_whenever_it_is_read_is_a_problem(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def gone(*_: object, **__: object) -> None:
        raise FileNotFoundError(2, "No such file or directory")

    monkeypatch.setattr(verify_segment, "read_segment", gone)
    facts = examined(path)
    assert [problem.where for problem in facts.problems] == [f"segments/{LAST}.parquet"]
    assert "FileNotFoundError" in facts.problems[0].found


def test_a_missing_folder_is_missing_and_no_accident(path: Path) -> None:
    shutil.rmtree(path / "segments")
    problems = verify(path).problems
    assert {problem.where.partition("/")[0] for problem in problems} == {"segments"}


def test_nothing_behind_a_link_is_read(path: Path, tmp_path: Path) -> None:
    (path / "segments").rename(tmp_path / "aside")
    (path / "segments").symlink_to(tmp_path / "aside")
    (tmp_path / "aside" / "stray").write_bytes(b"")
    assert "segments/stray" not in {problem.where for problem in verify(path).problems}


# --- a check that fails unexpectedly ---


def test_a_check_that_fails_in_a_way_nobody_thought_of_is_a_finding_in_its_place(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise ZeroDivisionError("nobody thought of this")

    for module, name, place in (
        (segments, "parse_manifest", "ledger.json"),
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
    return segment_at(path, 2).read_bytes().replace(version, b"9" * len(version))


def test_a_count_of_nulls_that_hides_rows_is_found_whoever_wrote_it(path: Path) -> None:
    data = other_version(path)
    for name in ("run_id", "seq", "time_us"):
        parts = Parts(data)
        thrift.put(cast(thrift.Struct, thrift.field(parts.about(parts.number_of(name)), 12)), 3, 1)
        forge_segment(path, 2, bytes(parts))
        assert f"column {name}" in only_problem(path).found
        assert ("other statistics" if name == "run_id" else f"the footer: column {name}") in only_problem(path).found
