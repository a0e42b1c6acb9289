import re
from pathlib import Path

import pyarrow as pa
import pytest

from fsar_ledger.base.errors import LedgerCorrupted
from fsar_ledger.ledger.rows import layout, segment
from fsar_ledger.ledger.rows.codec import encode
from fsar_ledger.ledger.rows.layout import Layout, check_layout, read_file, read_layout
from fsar_ledger.ledger.rows.schema import SCHEMA
from fsar_ledger.ledger.rows.segment import read_coded
from fsar_ledger.ledger.verify import segment as verify_segment
from fsar_ledger.ledger.verify import verify
from fsar_ledger.ledger.verify.report import VerifyOptions
from fsar_ledger.metrics.verified import ReadAgain
from tests.ledger.forgery import changed, forge_segment, segment_at
from tests.ledger.parts import two_faced
from tests.ledger.samples import append_all, made_up_run
from tests.sure import known

TABLE = encode([made_up_run("run-0", 60, 1), made_up_run("run-1", 40, 2)])
ASKED = VerifyOptions(second_reader=ReadAgain())


def read_again(path: str, decoded: pa.Table, is_as_written: bool) -> tuple[str, str] | None:
    reader = ReadAgain()
    return (
        reader.by_digest({path: reader.digest(decoded)}).get(path) if is_as_written else reader.by_value(path, decoded)
    )


def written(path: Path, table: pa.Table) -> str:
    path.write_bytes(bytes(segment.to_parquet(table)))
    return str(path)


@pytest.mark.parametrize("is_as_written", [True, False])
def test_the_same_rows_are_the_same_by_both_readers(tmp_path: Path, is_as_written: bool) -> None:
    path = tmp_path / "it's a segment"
    written(path, TABLE)
    data = read_file(path)
    assert read_again(str(path), TABLE, is_as_written) is None
    assert read_again(str(path), read_coded(path, data, check_layout(path, data)), is_as_written) is None


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("time_us", 5),
        ("robot", "nobody"),
        ("robot", None),
        ("achieved", ["x"]),
        ("approves", True),
        ("caused_by", None),
    ],
)
def test_one_value_that_differs_is_found_and_its_column_named(tmp_path: Path, name: str, value: object) -> None:
    row = next(row for row in range(100) if TABLE[name][row].as_py() != value)
    path = written(tmp_path / "segment", TABLE)
    found = known(read_again(path, changed(TABLE, name, row, value), False))
    assert found[0] == f"1 values of column {name} that DuckDB reads otherwise"
    is_counted = name == "time_us" or (value is None) != (TABLE[name][row].as_py() is None)
    by_digest = read_again(path, changed(TABLE, name, row, value), True)
    assert (by_digest is not None and f"column {name} by DuckDB" in by_digest[0]) == is_counted


@pytest.mark.parametrize("is_as_written", [True, False])
def test_rows_too_many_or_too_few_are_found(tmp_path: Path, is_as_written: bool) -> None:
    path = written(tmp_path / "segment", TABLE)
    for other in (TABLE.slice(0, 99), pa.concat_tables([TABLE, TABLE.slice(0, 1)])):
        found = known(read_again(path, other, is_as_written))
        assert "column run_id" in found[0]


def test_a_file_that_duckdb_cannot_read_is_found(tmp_path: Path) -> None:
    path = written(tmp_path / "segment", TABLE)
    Path(path).write_bytes(Path(path).read_bytes()[:-1])
    found = known(read_again(path, TABLE, True))
    assert "a segment that DuckDB cannot read" in found[0]


@pytest.mark.slow
def test_two_contents_are_found_even_where_the_layout_is_not_checked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "ledger"
    append_all(path, [[made_up_run("run-0", 60, 1)], [made_up_run("run-1", 40, 2)]])
    assert verify(path, asked=ASKED).ok
    assert verify(path, workers=2, asked=ASKED).ok
    honest = segment_at(path, 1).read_bytes()
    table = segment.read_table(segment_at(path, 1))
    at = SCHEMA.get_field_index("robot")
    other = table.set_column(
        at, SCHEMA.field(at), pa.array([None if robot is None else "nobody" for robot in table["robot"].to_pylist()])
    )
    forged = two_faced(honest, bytes(segment.to_parquet(other)), "robot")
    with pytest.raises(LedgerCorrupted):
        check_layout(path, forged)
    forge_segment(path, 1, forged)

    def unchecked(_: Path, data: bytes) -> Layout:
        return (
            read_layout(honest)._replace(created_by="another", statistics=()) if data == forged else read_layout(data)
        )

    monkeypatch.setattr(verify_segment, "check_layout", unchecked)
    assert verify(path).ok, "pyarrow reads the honest rows"
    [problem] = verify(path, asked=ASKED).problems
    assert (problem.where, problem.commit) == ("segments/000000000060-000000000100.parquet", 1)
    assert re.fullmatch(r"\d+ values of column robot that DuckDB reads otherwise", problem.found)
    assert layout.check_layout is check_layout


def test_of_many_segments_each_that_differs_is_named(tmp_path: Path) -> None:
    reader, good = ReadAgain(), ReadAgain().digest(TABLE)
    paths = [written(tmp_path / f"{at}.parquet", TABLE if at != 1 else TABLE.slice(0, 99)) for at in range(4)]
    assert list(reader.by_digest(dict.fromkeys(paths, good))) == [paths[1]]
    Path(paths[2]).write_bytes(b"no segment")
    found = reader.by_digest(dict.fromkeys(paths, good))
    assert list(found) == paths[1:3]
    assert "column run_id by DuckDB" in found[paths[1]][0]
    assert "a segment that DuckDB cannot read" in found[paths[2]][0]
