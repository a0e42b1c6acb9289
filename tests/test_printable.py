"""Text as it is shown: itself or a harmless escape, and distinct from every other text."""

import csv
import io
import json
import re
import subprocess
import unicodedata
from pathlib import PurePath

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fsar_ledger.base import printable
from fsar_ledger.cli.terminal import ON, folded
from tests.terminal import PAINT, painted

ANY = st.text(st.characters(codec="utf-8"), max_size=12)
NASTY = st.lists(
    st.sampled_from(["\\", "x", "u", "n", "1b", "\x1b", "\n", " ", "a", "\u202e", "\u0301", "\u05d0", "'", "=", "0"]),
    max_size=8,
).map("".join)
ESCAPE = re.compile(r"\\(?:([\\ntr])|x(..)|u(.{4})|U(.{8}))")


def read_back(shown: str) -> str:
    """Undo every escape of a shown text."""
    return ESCAPE.sub(
        lambda found: (
            {"\\": "\\", "n": "\n", "t": "\t", "r": "\r"}[found[1]]
            if found[1]
            else chr(int(found[2] or found[3] or found[4], 16))
        ),
        shown,
    )


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("robot/A1", "robot/A1"),
        ("Zürich, 東京, café, Việt Nam, 🤖", "Zürich, 東京, café, Việt Nam, 🤖"),
        ("e\u0301", "e\u0301"),
        ("\x1b[2J", r"\x1b[2J"),
        ("a\nb\tc\rd", r"a\nb\tc\rd"),
        ("\x7f\x85\x9b", r"\x7f\x85\x9b"),
        ("\u202eabc\u2066\u061c\u200b\ufeff\u00ad", r"\u202eabc\u2066\u061c\u200b\ufeff\xad"),
        ("\u2028\u2029\u00a0\u3000", r"\u2028\u2029\xa0\u3000"),
        ("\udcff\ue000\ufffe\U000e0041", r"\udcff\ue000\ufffe\U000e0041"),
        ("\u05d01", r"\u05d01"),
        ("\u3164\ufe0f\u115f", r"\u3164\ufe0f\u115f"),
        ("\u0301a", r"\u0301a"),
        ("0\u0338", r"0\u0338"),
        ("e\u0301\u0301\u0301", "e\u0301\u0301" + r"\u0301"),
        (r"C:\temp \d", r"C:\\temp \\d"),
        (r"\d \"quoted\"", r"\d \"quoted\""),
        ("\\ \x1b", r"\\ \x1b"),
    ],
)
def test_a_value_is_shown_as_itself_or_escaped(text: str, shown: str) -> None:
    assert printable.value(text) == shown


@settings(max_examples=40)
@given(ANY | NASTY)
def test_a_value_that_is_shown_is_safe_and_can_be_read_back(text: str) -> None:
    shown = printable.value(text)
    assert printable.is_shown(shown)
    assert not any(unicodedata.category(one) in ("Cc", "Cf", "Zl", "Zp", "Cs", "Co", "Cn") for one in shown)
    assert read_back(shown) == text


@settings(max_examples=40)
@given(st.lists(NASTY, min_size=2, max_size=2, unique=True))
def test_two_values_are_never_shown_alike(texts: list[str]) -> None:
    one, other = texts
    assert printable.value(one) != printable.value(other)
    assert printable.field(one) != printable.field(other)
    assert printable.cell(one) != printable.cell(other)


@settings(max_examples=40)
@given(ANY | NASTY)
def test_what_was_escaped_is_not_escaped_again(text: str) -> None:
    assert printable.escaped(printable.value(text)) == printable.value(text)
    assert printable.sanitized(printable.line(text)) == printable.line(text)


@settings(max_examples=40)
@given(st.dictionaries(ANY | NASTY, st.lists(ANY | NASTY), max_size=3))
def test_json_is_ascii_and_means_the_same(document: dict[str, list[str]]) -> None:
    shown = printable.ascii_json(json.dumps(document, ensure_ascii=False, indent=1))
    assert shown.isascii()
    assert printable.sanitized(shown) == shown
    assert json.loads(shown) == document


@pytest.mark.parametrize("text", PAINT.values(), ids=list(PAINT))
def test_a_line_paints_nothing(text: str) -> None:
    assert painted(printable.lines(f"run {text}, seq 1", printable.value(text))) == []


def test_the_emulator_sees_what_paints() -> None:
    for name in PAINT.keys() - {"columns", "backslash", "long", "private", "bytes", "charset"}:
        assert painted(f"run {PAINT[name]}\n"), name


def test_long_values_and_lines_are_cut() -> None:
    assert printable.value("x" * 250) == "x" * 200 + "... (50 more)"
    assert printable.value("\x1b" * 250) == r"\x1b" * 200 + "... (50 more)"
    assert printable.line("x" * 5_000) == "x" * 4_000 + "... (1,000 more)\n"
    assert printable.field("x" * 250) == "x" * 250


def test_blanks_in_a_cell_do_not_look_like_columns() -> None:
    assert printable.cell("a  b") == r"a\x20 b"
    assert printable.cell(" a ") == r"\x20a\x20"
    assert printable.cell("a b") == "a b"


@pytest.mark.parametrize(
    "text", ["=1+1", "+1", "-1", "@x", " =1", "\uff1d1", "\uff0b1", "\uff0d1", "\uff201", "'=1", "''@1", "\t=1", "\r=1"]
)
def test_no_field_is_a_formula(text: str) -> None:
    shown = printable.field(text)
    assert shown[0] in "'\\"
    sheet = io.StringIO()
    csv.writer(sheet).writerow([shown, "robot/A1"])
    assert next(csv.reader(io.StringIO(sheet.getvalue()))) == [shown, "robot/A1"]


PASTED = [
    *"\\'\"!$`~-#*?[]{}()<>|&; \n\t\r\x01\x7f\u202e\u0301\u05d0\ufeffän",
    *("\\n", "a\\'", "$'\\n'", "-a", "~/a", "\udcff"),
]


@given(st.lists(st.lists(st.sampled_from(PASTED), min_size=1, max_size=6).map("".join), min_size=1, max_size=20))
@settings(max_examples=20)
def test_a_word_is_read_by_a_shell_as_it_was_and_shown_as_it_is(texts: list[str]) -> None:
    words = [*map(printable.word, texts), *(printable.word(PurePath(text)) for text in texts)]
    assert all(printable.is_shown(word) for word in words)
    script = f"printf '%s\\0' {' '.join(words)}"
    read = subprocess.run(["bash", "-c", script], capture_output=True, check=True, env={"LC_ALL": "C"}).stdout
    *found, _ = read.decode(errors="surrogateescape").split("\0")
    assert found[: len(texts)] == texts
    paths = found[len(texts) :]
    assert [PurePath(path) for path in paths] == list(map(PurePath, texts))
    assert not any(path.startswith("-") for path in paths)


def test_a_line_goes_on_behind_a_mark_on_a_narrow_terminal() -> None:
    assert folded("x" * 25, 20) == "x" * 20 + f"\n{ON}" + "x" * 5
    assert folded("東" * 11, 20) == "東" * 10 + f"\n{ON}東"
    assert folded("x" * 20, 20) == "x" * 20
    for line in folded("a" * 500, 40).split("\n"):
        assert len(line) <= 40


@pytest.mark.parametrize(
    ("count", "said"),
    [
        (0, ""),
        (2, "0, 1"),
        (5, "0, 1, 2, 3, 4"),
        (6, "0, 1, 2, 3, 4 and 1 more"),
        (2_005, "0, 1, 2, 3, 4 and 2,000 more"),
    ],
)
def test_the_first_five_are_named_and_the_others_counted(count: int, said: str) -> None:
    assert printable.list_few(map(str, range(count))) == said


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ("door", "; did you mean door-relay?"),
        ("realy", "; did you mean relay?"),
        ("door-realy.with.much.behind.it", "; did you mean door-relay.with.much.behind.it.and.more?"),
        ("dorr", "; did you mean door-relay?"),
        ("zzz", ""),
        ("", ""),
    ],
)
def test_the_nearest_name_begins_so_or_is_alike_or_begins_alike(asked: str, said: str) -> None:
    names = ["relay", "door-relay", "door-relay.with.much.behind.it.and.more"]
    assert printable.did_you_mean(asked, names) == said


@given(st.integers(0, 10**15), st.integers(-999, 999))
def test_times_a_microsecond_apart_and_all_counts_are_told_apart(time_us: int, apart_us: int) -> None:
    one, other = (us / 1_000_000 for us in (time_us + 10**6, max(time_us + apart_us, 0) + 10**6))
    assert (printable.number(one) == printable.number(other)) == (one == other)
    assert printable.number(float(time_us)) == str(time_us)


@given(st.floats())
def test_a_number_is_shown_to_six_decimals_or_below_one_to_six_digits(value: float) -> None:
    most = {"rel": 0, "abs": 0.51e-6} if abs(value) >= 1 else {"rel": 0.51e-5, "abs": 0}
    assert float(printable.number(value)) == pytest.approx(value, nan_ok=True, **most)


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (100000.123, "100000.123"),
        (100000.456, "100000.456"),
        (1767225600.5, "1767225600.5"),
        (1234567.0, "1234567"),
        (184 + 1 / 3, "184.333333"),
        (2 / 3, "0.666667"),
        (1.25e-10, "1.25e-10"),
        (0.0, "0"),
    ],
)
def test_numbers_for_people(value: float, shown: str) -> None:
    assert printable.number(value) == shown


def test_a_suggested_name_is_shown_escaped() -> None:
    assert printable.did_you_mean("a", ["a\x1b"]) == "; did you mean a\\x1b?"
