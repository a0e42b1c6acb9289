"""An answer that is made some rows at a time is to the byte the answer that is made at once, and is shown whole or not
at all."""

from collections.abc import Iterator
from itertools import pairwise

import pytest

from fsar_ledger.api.fields import Row
from fsar_ledger.cli.output import answer_text
from fsar_ledger.cli.streaming import KEPT_BYTES, Kept, answer_pieces
from fsar_ledger.errors import UsageError
from fsar_ledger.ledger.store.read import Head
from fsar_ledger.printable import Shown

HEAD = Head(3, 1000, "ab" * 32)
COLUMNS = ["seq", 'a "name"\nof two lines', "path"]
ROWS: list[Row] = [
    {COLUMNS[0]: seq, COLUMNS[1]: f"a,b\n[]{seq}\r\n" if seq % 3 else None, COLUMNS[2]: [str(seq)] * (seq % 4)}
    for seq in range(10)
]


@pytest.mark.parametrize("kind", [{"as_json": True}, {"as_csv": True}, {}, {"limit": 3}, {"limit": 10}, {"limit": 11}])
@pytest.mark.parametrize("cuts", [[], [0, 10], [0, 3, 3, 10], [0, 1, 4, 10, 10], [0, 0], [10, 10]])
def test_the_pieces_are_the_answer(kind: dict[str, bool | int], cuts: list[int]) -> None:
    parts = [ROWS[one:other] for one, other in pairwise(cuts)]
    rows = [row for part in parts for row in part]
    options = {"as_json": False, "as_csv": False, "limit": 0, "rows_verified": False, **kind}
    assert "".join(answer_pieces(HEAD, COLUMNS, parts, **options)) == answer_text(HEAD, rows, COLUMNS, **options)  # type: ignore[arg-type]


def test_an_answer_has_one_form() -> None:
    with pytest.raises(UsageError, match="--json and --csv"):
        answer_pieces(HEAD, COLUMNS, [], rows_verified=None, as_json=True, as_csv=True)


@pytest.mark.parametrize("longest", [0, 10, KEPT_BYTES // 20])
def test_what_is_kept_comes_back_in_whole_lines(longest: int) -> None:
    lines = [f"{number} \udcff é{'x' * longest}\r\n" for number in range(30)]
    pieces = list(Kept(map(Shown, lines)))
    assert "".join(pieces) == "".join(lines)
    assert all(piece.endswith("\n") for piece in pieces)


def test_what_breaks_off_is_not_shown() -> None:
    def broken() -> Iterator[Shown]:
        yield Shown("x" * (KEPT_BYTES + 1))
        raise UsageError("enough")

    with pytest.raises(UsageError, match="enough"):
        Kept(broken())


def test_a_table_without_rows_says_so_under_its_columns() -> None:
    assert (
        answer_text(None, [], ["run_id"], rows_verified=None, as_json=False, as_csv=False)
        == "run_id\n------\n(no rows)\n"
    )
    assert answer_text(None, [], ["run_id"], rows_verified=None, as_json=False, as_csv=True) == "run_id\n"
