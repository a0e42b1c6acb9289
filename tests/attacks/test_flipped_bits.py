"""One flipped bit in a segment that the query engine does not notice: the answer changed without a word.

DuckDB ignores the checksums of pages, and data that zstd stores uncompressed has none of its own. `verify` found the
bit; no answer did.
"""

import json
import shutil
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import duckdb
import pyarrow.parquet as pq
import pytest

from fsar_ledger.ledger.compacting import compact
from tests.ledger.damage import only_problem
from tests.ledger.flips import write_runs
from tests.ledger.forgery import changed, forge_segment, segment_at, table_of

from .conftest import Attack

NUMBER = 0
"""The commit that is attacked: the runs of the first architecture."""


@pytest.fixture(scope="module")
def honest(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make a ledger of three runs of each architecture, which tests copy."""
    path = tmp_path_factory.mktemp("honest") / "ledger"
    write_runs(path)
    return path


@pytest.fixture
def ledger(honest: Path, tmp_path: Path) -> Path:
    """Provide a copy to be damaged."""
    return Path(shutil.copytree(honest, tmp_path / "ledger"))


def flip_unnoticed(segment: Path, column: str) -> None:
    """Flip the first bit in this column's pages with which DuckDB reads other values and reports no error."""
    good, before = segment.read_bytes(), read_by_duckdb(segment, column)
    for data in flipped(good, segment, column):
        segment.write_bytes(data)
        try:
            if read_by_duckdb(segment, column) != before:
                return
        except duckdb.Error:
            continue
    raise AssertionError(f"{segment}: found no bit of {column} that DuckDB does not notice")


def flipped(good: bytes, segment: Path, column: str) -> Iterator[bytes]:
    """Yield the segment with each bit of this column's pages flipped, from their end."""
    group = pq.read_metadata(segment).row_group(0)
    (chunk,) = [group.column(at) for at in range(group.num_columns) if group.column(at).path_in_schema == column]
    first = chunk.dictionary_page_offset or chunk.data_page_offset
    for at, bit in product(reversed(range(first, first + chunk.total_compressed_size)), range(8)):
        yield good[:at] + bytes([good[at] ^ 1 << bit]) + good[at + 1 :]


def read_by_duckdb(segment: Path, column: str) -> list[tuple[object, ...]]:
    with duckdb.connect() as connection:
        return connection.execute(f"SELECT {column} FROM read_parquet(?)", [str(segment)]).fetchall()


@pytest.mark.parametrize(("verb", "column"), [(("metrics",), "time_us"), (("explain",), "action_id")])
def test_no_answer_comes_from_a_segment_with_a_flipped_bit(
    command: Attack, ledger: Path, verb: tuple[str, ...], column: str
) -> None:
    flip_unnoticed(segment_at(ledger, NUMBER), column)
    assert only_problem(ledger).where == f"segments/{segment_at(ledger, NUMBER).name}"

    answer = command(verb[0], ledger, *verb[1:])

    assert (answer.code, answer.out) == (3, "")
    assert f"segments/{segment_at(ledger, NUMBER).name}" in answer.err
    assert "SHA-256" in answer.err


@pytest.mark.slow
def test_a_verification_before_the_bit_was_flipped_excuses_nothing(command: Attack, ledger: Path) -> None:
    assert command("verify", ledger).code == 0
    flip_unnoticed(segment_at(ledger, NUMBER), "scenario")

    answer = command("statistics", ledger, "--csv")

    assert (answer.code, answer.out) == (3, "")


@pytest.mark.slow
def test_no_number_stands_under_a_root_that_is_not_that_of_its_rows(command: Attack, ledger: Path) -> None:
    compact(ledger)  # so that no journal goes on from the line that is forged
    rows = table_of(ledger, NUMBER)
    # The hashes match the new bytes, the root is the old one.
    forge_segment(ledger, NUMBER, changed(rows, "architecture", 0, "dhma"))

    answer = command("metrics", ledger, "--json")
    assert answer.code != 0 or json.loads(answer.out).get("rows_verified") is False

    report = command("report", ledger, "--out", ledger.parent / "report.pdf")
    assert report.code == 3
    assert "no answer is given from rows that are not those under the root" in report.err
    assert not (ledger.parent / "report.pdf").exists()
