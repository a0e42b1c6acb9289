"""Rows are taken apart into the same columns in C and in Python, or not in C at all."""

import json
import sys
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsar_ledger.base.errors import LedgerCorrupted
from fsar_ledger.ledger.rows import canonical, codec, compiled, segment
from fsar_ledger.ledger.rows.codec import LedgerRun, encode_coded, encode_hashed, encode_lines
from fsar_ledger.ledger.rows.compiled import IS_COMPILED, plain_table
from fsar_ledger.ledger.rows.schema import COLUMNS, SCHEMA
from fsar_ledger.ledger.store.staging import table_of
from tests.ledger.samples import any_runs, made_up_batches, run_of_every_type
from tests.ledger.test_joining import NAMES, rows

in_c = pytest.mark.skipif(not IS_COMPILED, reason="no compiler was there")

ROW = {"caused_by": 3, "run_id": "run", "seq": 4, "time_us": -5, "type": "T"}


def lines_of(*runs: LedgerRun) -> bytes:
    return b"\n".join((*encode_lines(runs), b""))


def plain(text: str) -> str:
    """Return the text without what is left to Python."""
    return "".join(character for character in text if " " <= character <= "~")


@in_c
@pytest.mark.parametrize("seed", range(5))
def test_events_of_every_type_are_taken_apart_in_c_as_in_python(seed: int) -> None:
    run = run_of_every_type("run-1", seed)
    found, expected = plain_table(lines_of(run)), encode_coded([run])
    assert found is not None
    found.validate(full=True)
    assert found.equals(expected)
    assert segment.to_parquet(found).equals(segment.to_parquet(expected))


@in_c
@given(rows(NAMES))
def test_any_rows_are_taken_apart_in_c_as_in_python_or_not_at_all(values: list[dict[str, object]]) -> None:
    schema = pa.schema([SCHEMA.field(name).with_nullable(True) for name in dict.fromkeys([*NAMES, "time_us", "type"])])
    table = pa.Table.from_pylist([{**row, "seq": 1, "time_us": 2} for row in values], schema=schema)
    lines = b"\n".join((*canonical.from_table(table), b""))
    found = plain_table(lines)
    texts = [text for row in map(json.loads, lines.splitlines()) for text in _texts(row)]
    assert (found is not None) == all(plain(text) == text for text in texts)
    if found is not None:
        found.validate(full=True)
        assert found.select(table.column_names).cast(table.schema).equals(table)


def _texts(row: dict[str, object]) -> list[str]:
    values = [one for value in row.values() for one in (value if isinstance(value, list) else [value])]
    return [value for value in values if isinstance(value, str)]


@in_c
@given(any_runs())
def test_any_events_become_the_same_columns_and_leaves(runs: list[LedgerRun]) -> None:
    table, leaves = encode_hashed(runs)
    with patch.object(codec, "plain_rows", lambda _: None):
        expected, again = encode_hashed(runs)
    assert table.equals(expected)
    assert leaves == again


@in_c
@pytest.mark.parametrize("escaped", ['"', "\\", '\\"', '"\\', '""', "\\\\", 'a"b\\c', '\\\\"', '{"name":"value"}'])
def test_what_json_escapes_is_unescaped(escaped: str) -> None:
    found = plain_table(canonical.document(ROW | {"run_id": escaped}) + b"\n")
    assert found is not None
    assert found.column("run_id").to_pylist() == [escaped]


def row(**changed: object) -> str:
    return json.dumps(ROW | changed, separators=(",", ":"), sort_keys=True)


@in_c
@pytest.mark.parametrize(
    "line",
    [
        "",
        "{}",
        "[]",
        "{",
        row()[:-1],
        row() + " ",
        row() + "}",
        row()[1:],
        row().replace(",", ", ", 1),
        row().replace(":", ": ", 1),
        row().replace('"seq":4', '"seq":4,"seq":4'),
        row().replace('"seq":4,', ""),
        row().replace('"time_us":-5', '"time_us":-5,"run_id":"run"'),
        row().replace('"seq"', '"seQ"'),
        row().replace('"seq"', '"s\\u0065q"'),
        row().replace('"seq":4', '"seq":04'),
        row().replace('"seq":4', '"seq":-0'),
        row().replace('"seq":4', '"seq":4.0'),
        row().replace('"seq":4', '"seq":4e0'),
        row().replace('"seq":4', '"seq":+4'),
        row().replace('"seq":4', '"seq":-'),
        row().replace('"seq":4', '"seq":'),
        row().replace('"seq":4', '"seq":null'),
        row().replace('"seq":4', '"seq":"4"'),
        row().replace('"seq":4', '"seq":9007199254740992'),
        row().replace('"seq":4', '"seq":-9007199254740992'),
        row().replace('"seq":4', '"seq":99999999999999999999'),
        row().replace('"run"', "run"),
        row().replace('"run"', '"run'),
        row().replace('"run"', '"run\\"'),
        row().replace('"run"', '"r\\u0075n"'),
        row().replace('"run"', '"r\\/un"'),
        row().replace('"run"', '"r\tun"'),
        row().replace('"run"', '"r\x7fun"'),
        row().replace('"run"', '"rün"'),
        row(observes=["a"]).replace('["a"]', '["a",]'),
        row(observes=["a"]).replace('["a"]', '["a"'),
        row(observes=["a"]).replace('["a"]', "[,]"),
        row(observes=["a"]).replace('["a"]', "[1]"),
        row(observes=["a"]).replace('["a"]', '["a" ]'),
        row(observes=["a"]).replace('["a"]', "["),
        row(is_accepted=True).replace("true", "True"),
        row(is_accepted=True).replace("true", "1"),
        row(is_accepted=True).replace("true", "tru"),
        row(unknown=1),
    ],
)
def test_what_is_not_canonical_is_left_to_python(line: str) -> None:
    assert plain_table(row().encode() + b"\n") is not None
    for lines in (f"{line}\n", f"{row()}\n{line}\n", f"{line}\n{row()}\n"):
        assert plain_table(lines.encode()) is None


@in_c
def test_a_last_line_without_end_is_left_to_python() -> None:
    assert plain_table(row().encode()) is None
    assert plain_table(f"{row()}\n{row()}".encode()) is None


@in_c
@given(st.binary(max_size=60), st.integers(0, 200))
def test_rubbish_is_left_to_python(rubbish: bytes, at: int) -> None:
    good = row().encode() + b"\n"
    changed = good[: at % len(good)] + rubbish + good[at % len(good) :]
    found = plain_table(changed)
    if found is not None:
        assert canonical.from_table(found) == changed.splitlines()


@pytest.mark.parametrize("batch", made_up_batches(3, size=300))
def test_a_journal_has_the_same_rows_without_the_compiled_function(batch: list[LedgerRun]) -> None:
    found = table_of(Path("journal.jsonl"), lines_of(*batch))
    with patch.object(compiled, "codec", None):
        assert table_of(Path("journal.jsonl"), lines_of(*batch)).equals(found.cast(SCHEMA))


def test_rows_that_are_no_events_are_an_error_either_way() -> None:
    for line in (row(unknown=1), row().replace(":", ": ", 1), "[]"):
        with pytest.raises(LedgerCorrupted, match=r"journal\.jsonl"):
            table_of(Path("journal.jsonl"), line.encode() + b"\n")


@in_c
def test_many_columns_and_other_things_are_errors() -> None:
    from fsar_ledger.ledger.rows._codec import read_rows

    names = tuple((b"%03d" % number, 1) for number in range(513))
    with pytest.raises(ValueError, match="512"):
        read_rows(b"", names)
    assert read_rows(b'{"000":1}\n', names[:512]) is not None
    for wrong in ((b"", [(b"a", 1)]), (b"", ((b"a",),)), ("", ((b"a", 1),))):
        with pytest.raises(TypeError):
            read_rows(*wrong)


def texts_of_one_hash() -> list[str]:
    """Some hundred texts of 16 bytes for which `hash_of` in `_read_rows.c` gives one number."""
    first = np.random.default_rng(1).integers(ord("a"), ord("z") + 1, (2_000_000, 8), np.uint8)
    mixed = (first.view(np.uint64)[:, 0] ^ np.uint64(16 * 0x9E3779B97F4A7C15 % 2**64)) * np.uint64(0xFF51AFD7ED558CCD)
    mixed ^= mixed >> np.uint64(32)
    wanted = np.frombuffer(b"a number", np.uint64)  # what the last step is given, whatever that makes of it
    second = np.ascontiguousarray(mixed ^ wanted).view(np.uint8).reshape(-1, 8)
    is_plain = ((second >= ord(" ")) & (second <= ord("~")) & (second != ord('"')) & (second != ord("\\"))).all(axis=1)
    return [bytes(text).decode() for text in np.hstack([first, second])[is_plain]]


@in_c
def test_a_few_hundred_texts_of_one_hash_are_left_to_python() -> None:
    """Whoever forges a journal cannot make it slow: looking for one text among others of its hash has a bound."""
    texts = texts_of_one_hash()
    assert len(texts) == len(set(texts)) > 300
    lines = [json.dumps(dict(sorted({**ROW, "task_id": text}.items())), separators=(",", ":")) for text in texts]
    found = plain_table("\n".join([*lines[:250], ""]).encode())
    assert found is not None
    assert found["task_id"].cast(pa.string()).to_pylist() == texts[:250]
    assert plain_table("\n".join([*lines[:300], ""]).encode()) is None
    others = [line.replace(text, text[:-1] + "~") for line, text in zip(lines, texts, strict=True)]
    assert plain_table("\n".join([*others[:300], ""]).encode()) is not None


@in_c
def test_taking_rows_apart_keeps_nothing() -> None:
    lines = lines_of(*made_up_batches(1, size=30)[0])
    before = sys.getrefcount(lines)
    for _ in range(50):
        assert plain_table(lines) is not None
        assert plain_table(lines + b"{}\n") is None
    assert sys.getrefcount(lines) == before
    assert len(COLUMNS) == plain_table(lines).num_columns  # type: ignore[union-attr]
