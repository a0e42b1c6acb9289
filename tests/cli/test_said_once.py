"""What a table says of every row holds of every row of the answer, also of those that it does not show."""

import fcntl
import os
import pty
import re
import struct
import termios
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from itertools import pairwise, product

import pyarrow as pa
import pytest

from fsar_ledger.api.table import Rows
from fsar_ledger.cli.render import Form
from fsar_ledger.ledger.store.record import Head
from fsar_ledger.metrics.provenance import Provenance

ABOUT = Provenance(Head(3, 1000, "ab" * 32), rows_verified=False)
RUNS = ("fsar.full.door.n4.s42.r0001-abc", "cfc.full.relay.n4.s42.r0002-abc")
VALUES = {
    "run_id": RUNS,
    "reason": ("policy", None),
    "supervised_by": (None, "supervisor/B1"),
    "under": (
        [*"abc", "the fourth of a list, which is not shown"],
        [*"abc", "another fourth, which is not shown either"],
    ),
    "about": ({"x": 1.0}, {"x": 2.0}),
    "share": (0.12345678, 0.12345679),
}
"""Two values of each column, which are shown alike in some."""
_NAMED = re.compile(r"\b(?:{})\b".format("|".join(VALUES)))


@contextmanager
def terminal() -> Iterator[None]:
    """Make the output a terminal on which no column needs to be left out."""
    here, there = pty.openpty()
    fcntl.ioctl(there, termios.TIOCSWINSZ, struct.pack("HHHH", 40, 2000, 0, 0))
    with os.fdopen(here), os.fdopen(there, "w") as stream, redirect_stdout(stream):
        yield


def shown(limit: int, columns: Sequence[str], batches: Iterable[pa.RecordBatch]) -> str:
    with terminal():
        form = Form(limit=limit)
        return "".join(form.pieces(Rows(ABOUT, columns, batches), form.screen()))


def said_of_every_row(text: str) -> set[str]:
    return {name for line in text.splitlines() if " every row: " in line for name in _NAMED.findall(line)}


@pytest.mark.parametrize("cuts", [[0, 6], [0, 2, 6], [0, 0, 1, 4, 6]])
@pytest.mark.parametrize("limit", [0, 2, 3, 6])
def test_a_table_says_of_every_row_only_what_holds_of_all_of_them(cuts: list[int], limit: int) -> None:
    names = list(VALUES)
    for name, differing in product(names, range(6)):
        rows = [{one: pair[one == name and at == differing] for one, pair in VALUES.items()} for at in range(6)]
        whole = pa.RecordBatch.from_pylist([{"seq": at, **row} for at, row in enumerate(rows)])
        batches = [whole[begin:end] for begin, end in pairwise(cuts)]
        text = shown(limit, ["seq", *names], batches)
        assert said_of_every_row(text) == set(names) - {name}, text


def test_of_rows_that_are_all_alike_one_column_stays() -> None:
    whole = pa.RecordBatch.from_pylist([{"run_id": RUNS[0], "reason": "policy"}] * 6)
    text = shown(2, ["run_id", "reason"], [whole])
    assert said_of_every_row(text) == {"reason"}
    assert text.count(RUNS[0]) == 2
