"""Whatever is in the files of a ledger, they are read in time and memory that grow with their size only."""

import random
import tracemalloc
from contextlib import suppress
from pathlib import Path
from unittest.mock import patch

import pytest

from fsar_ledger.base.errors import LedgerCorrupted
from fsar_ledger.ledger.opening import open_for_answers
from fsar_ledger.ledger.rows.bounds import MAX_SEGMENT_BYTES
from fsar_ledger.ledger.rows.layout import read_file
from fsar_ledger.ledger.store import record
from fsar_ledger.ledger.store.growing import read_at
from fsar_ledger.ledger.store.paths import CHAIN, INDEX, JOURNAL, NODES, SEALING
from fsar_ledger.ledger.store.record import Commit, parse_line
from tests.ledger.damage import write_handed_over
from tests.quick import few

MIB = 1 << 20
BEGINNING = b'{"kind":"commit",'
CONTENTS = {
    "line feeds": b"\n",
    "short lines": b"x\n",
    "one line": b"x",
    "objects that begin": b'{"',
    "lines of records that begin": BEGINNING + b"\n",
}


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ledger that has all files."""
    path = tmp_path_factory.mktemp("bounds") / "ledger"
    write_handed_over(path)
    return path


def read(path: Path) -> None:
    """Read all files, damaged or not."""
    with suppress(LedgerCorrupted):
        assert open_for_answers(path).run_names.runs


@pytest.mark.parametrize("is_added", [False, True])
@pytest.mark.parametrize("content", few(CONTENTS, ["line feeds", "short lines"]))
@pytest.mark.parametrize("name", [CHAIN, JOURNAL, SEALING, INDEX, NODES])
def test_a_file_takes_little_more_memory_than_it_has_bytes(path: Path, name: str, content: str, is_added: bool) -> None:
    good = (path / name).read_bytes()
    part = CONTENTS[content]
    damaged = (good if is_added else b"") + part * (4 * MIB // len(part)) + b"\n"
    (path / name).write_bytes(damaged)
    tracemalloc.start()
    try:
        read(path)
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
        (path / name).write_bytes(good)
    assert most < 4 * len(damaged), f"{most / len(damaged):.1f} times as many"


def lines_of(path: Path) -> list[bytes]:
    """The lines of the journal, and some that look like records."""
    own = [line for name in (JOURNAL, SEALING) for line in (path / name).read_bytes().rstrip(b"\0").splitlines()]
    return [*own, BEGINNING, b'{"goes_on":["', b'{"', b'"kind":"commit"', b"", b'{"kind":"placement"}']


def has_later_frame(text: bytes, expected: int) -> bool:
    """What the format says, sought from every place of every line."""
    for line in text.split(b"\n")[:-1]:
        for at in range(len(line)):
            with suppress(ValueError):
                record = parse_line(line[at:])
                if isinstance(record, Commit) and record.number > expected:
                    return True
    return False


def test_a_later_record_is_found_wherever_it_begins_in_a_line(path: Path) -> None:
    draw, lines, found = random.Random(1), lines_of(path), [0, 0]
    for _ in range(300):
        text = b"".join(
            draw.choice(lines) + draw.choice((b"\n", b"\n", b"x", b"")) for _ in range(draw.randrange(1, 4))
        )
        text = text[draw.randrange(30) * draw.randrange(2) :]
        expected = draw.randrange(2)
        is_there = has_later_frame(text, expected)
        assert record.has_later_commit(text, 0, expected) == is_there, text
        found[is_there] += 1
    assert min(found) > 30


@pytest.mark.parametrize(
    "hostile", [b'"kind":"commit"' + b'{"' * (1 << 14), BEGINNING * 2_000, (BEGINNING + b"\n") * 2_000]
)
def test_a_later_record_is_sought_in_linear_time(hostile: bytes) -> None:
    tried = 0

    def parse(line: bytes) -> object:
        nonlocal tried
        tried += len(line)
        return parse_line(line)

    with patch.object(record, "parse_line", parse):
        assert not record.has_later_commit(hostile + b"\n", 0, 0)
    assert tried <= len(hostile)


def test_a_small_segment_takes_little_memory_to_read(path: Path) -> None:
    [file, *_] = sorted((path / "segments").iterdir())
    tracemalloc.start()
    try:
        assert read_file(file) == file.read_bytes()
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert most < 16 * MIB


def test_the_index_is_read_in_memory_for_what_there_is_of_it_whatever_the_chain_says(path: Path) -> None:
    [file, *_] = sorted((path / "segments").iterdir())
    tracemalloc.start()
    try:
        whole = read_at(file, 0, MAX_SEGMENT_BYTES)
        assert whole == file.read_bytes()
        assert [read_at(file, len(whole) + more, 5) for more in (-2, 0, 9)] == [whole[-2:], b"", b""]
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert most < 16 * MIB
