"""An answer that is made some rows at a time is to the byte the answer that is made at once, and is shown whole or not
at all."""

from collections.abc import Iterator
from itertools import pairwise

import msgspec
import pyarrow as pa
import pytest

from fsar_ledger.api.answers import Row
from fsar_ledger.api.table import Rows
from fsar_ledger.api.tables import more_text, table_text
from fsar_ledger.base.errors import UsageError
from fsar_ledger.base.printable import SafeText, ascii_json
from fsar_ledger.cli.render import KEPT_BYTES, Form, Kept, answer_json
from fsar_ledger.ledger.store.record import Head
from fsar_ledger.metrics.provenance import Provenance
from tests.one_by_one import csv_text

ABOUT = Provenance(Head(3, 1000, "ab" * 32), rows_verified=False)
COLUMNS = ["seq", 'a "name"\nof two lines', "path"]
ROWS: list[Row] = [
    {COLUMNS[0]: seq, COLUMNS[1]: f"a,b\n[]{seq}\r\n" if seq % 3 else None, COLUMNS[2]: [str(seq)] * (seq % 4)}
    for seq in range(10)
]


def at_once(form: Form, rows: list[Row], columns: list[str]) -> str:
    """The answer made of all rows."""
    if form.as_json:
        nothing = answer_json(ABOUT, {"rows": []})
        lines = ",\n".join(f"    {ascii_json(msgspec.json.encode(row).decode())}" for row in rows)
        return nothing.replace("[]", f"[\n{lines}\n  ]") if rows else nothing
    if form.as_csv:
        return csv_text(rows, columns, raw=form.raw)
    shown = rows[: form.limit or None]
    return table_text(shown, columns) + (more_text(len(rows) - len(shown)) if len(shown) < len(rows) else "")


@pytest.mark.parametrize(
    "form",
    [
        Form(as_json=True),
        Form(as_csv=True),
        Form(as_csv=True, raw=True),
        Form(),
        Form(limit=3),
        Form(limit=10),
        Form(limit=11),
    ],
)
@pytest.mark.parametrize("cuts", [[], [0, 10], [0, 3, 3, 10], [0, 1, 4, 10, 10], [0, 0], [10, 10]])
def test_the_pieces_are_the_answer(form: Form, cuts: list[int]) -> None:
    whole = pa.RecordBatch.from_pylist(ROWS)
    batches = [whole[one:other] for one, other in pairwise(cuts)]
    rows = [row for batch in batches for row in batch.to_pylist()]
    assert "".join(form.pieces(Rows(ABOUT, COLUMNS, batches), form.screen())) == at_once(form, rows, COLUMNS)


def test_an_answer_has_one_form() -> None:
    with pytest.raises(UsageError, match="--json and --csv"):
        Form(as_json=True, as_csv=True)


@pytest.mark.parametrize("longest", [0, 10, KEPT_BYTES // 20])
def test_what_is_kept_comes_back_in_whole_lines(longest: int) -> None:
    lines = [f"{number} \udcff é{'x' * longest}\r\n" for number in range(30)]
    pieces = list(Kept(map(SafeText, lines)))
    assert "".join(pieces) == "".join(lines)
    assert all(piece.endswith("\n") for piece in pieces)


def test_what_breaks_off_is_not_shown() -> None:
    def broken() -> Iterator[SafeText]:
        yield SafeText("x" * (KEPT_BYTES + 1))
        raise UsageError("enough")

    with pytest.raises(UsageError, match="enough"):
        Kept(broken())


def test_a_table_without_rows_says_so_under_its_columns() -> None:
    assert "".join(Form().pieces(Rows(ABOUT, ["run_id"], []), Form().screen())) == "run_id\n------\n(no rows)\n"
    assert "".join(Form(as_csv=True).pieces(Rows(ABOUT, ["run_id"], []), Form().screen())) == "run_id\n"
    assert "".join(Form().pieces(Rows(ABOUT, [], []), Form().screen())) == "(no rows)\n"
