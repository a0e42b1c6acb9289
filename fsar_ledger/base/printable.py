"""Make untrusted text safe to show in a terminal, a spreadsheet or a page: each character as itself or as an escape.

Characters that have effects, are invisible, or move their neighbours are escaped: controls (C0, DEL, C1), line and
paragraph separators, bidirectional and other format characters, blanks other than the space, fillers, variation
selectors, private, unassigned and surrogate code points, letters of right-to-left scripts (a terminal reverses numbers
beside them), marks without a letter, and a third mark on one letter. Escapes are those of Python: `\\n`, `\\x1b`,
`\\u202e`, `\\U000e0001`.
"""

import re
import shlex
import unicodedata
from collections.abc import Collection, Iterable, Sequence
from pathlib import PurePath
from typing import NewType

SafeText = NewType("SafeText", str)
"""Complete lines without anything that a terminal would interpret."""

MAX_VALUE = 200
"""Characters of one value shown to people; programs get the whole value."""

MAX_LINE = 4_000
"""Characters of one line shown to people."""

MAX_MARKS = 2
"""Marks on one letter; Vietnamese needs two."""

DECIMALS = 6
"""Decimals of a number for people; for seconds that is to the microsecond."""

NAMED = 5
"""The most items named in a message, in a list or one per line; the rest are only counted."""

_SEEN = b"\n" + bytes(range(0x20, 0x7F))
# printable according to Unicode, and blank
_UNSEEN = "\u034f\u115f\u1160\u17b4\u17b5\u180b-\u180d\u180f\u2800\u3164\ufe00-\ufe0f\uffa0\U000e0100-\U000e01ef"
_RIGHT_TO_LEFT = "\u0590-\u08ff\ufb1d-\ufdff\ufe70-\ufeff\U00010800-\U00010fff\U0001e800-\U0001efff"
_MOVING = re.compile(f"[{_UNSEEN}{_RIGHT_TO_LEFT}]")
_LIKE_AN_ESCAPE = re.compile(r"\\[\\xuUntr]")
_NOT_ASCII = re.compile(r"[^\n\x20-\x7e]")
_FORMULA = re.compile(r"'*\s*[=+\-@\t\r\uff1d\uff0b\uff0d\uff20]")
_BLANKS = re.compile(r"^ | (?= )| $")


def is_shown(text: str) -> bool:
    """Return whether every character of the text is shown unescaped."""
    if text.isascii():
        return text.isprintable()
    if not text.isprintable() or _MOVING.search(text):
        return False
    return not any(map(_is_mark, set(text))) or _escaped(text, is_whole=False) == text


def escaped(text: str) -> str:
    """Return the text on one line with unsafe characters escaped; backslashes are unchanged."""
    return text if is_shown(text) else _escaped(text, is_whole=False)


def value(text: str, most: int = MAX_VALUE) -> str:
    """Return the value as shown to people, distinct from every other value, cut after `most` characters.

    Unsafe characters are escaped. If there are any, or if the value looks escaped, its own backslashes are doubled. So
    a text that is shown unchanged has no backslash before one of `\\xuUntr`, and a changed one does.
    """
    if len(text) > most:
        return f"{value(text[:most], most)}... ({len(text) - most:,} more)"
    if is_shown(text) and ("\\" not in text or not _LIKE_AN_ESCAPE.search(text)):
        return text
    return _escaped(text, is_whole=True)


def named(text: str) -> str:
    """Return the value for a sentence: as `value`, in quotes if it is blank at an end, where nobody would see it."""
    return value(text) if text and text == text.strip() else f'"{value(text)}"'


def cell(text: str, most: int = MAX_VALUE) -> str:
    """Return the value for a column of a table: as `value`, but also escape blanks that look like column space."""
    printed = value(text, most)
    return _BLANKS.sub(r"\\x20", printed) if "  " in printed or printed[:1] == " " or printed[-1:] == " " else printed


def field(text: str) -> str:
    """Return the whole value for a spreadsheet: escaped as in `value`, and not readable as a formula."""
    return _without_formula(value(text, len(text)))


def word(text: object) -> str:
    """Quote the text as one word of a shell command that people may paste; a path never looks like an option.

    If characters are unsafe it has the bash, ksh and zsh form `$'...'`, with their bytes.
    """
    plain = f"./{text}" if isinstance(text, PurePath) and str(text).startswith("-") else str(text)
    if is_shown(plain):
        return shlex.quote(plain)
    return f"$'{''.join(map(_byte, plain.encode(errors='surrogateescape')))}'"


def _byte(byte: int) -> str:
    """Return a byte in the form for use within `$'...'`."""
    character = chr(byte)
    if character in "\\'":
        return f"\\{character}"
    return character if " " <= character <= "~" else "\\n" if character == "\n" else f"\\x{byte:02x}"


def _without_formula(text: str) -> str:
    """Prefix an apostrophe to text that a spreadsheet would read as a formula, or that already has one."""
    return "'" + text if _FORMULA.match(text) else text


def line(text: str) -> SafeText:
    """Return one line for people, cut after `MAX_LINE` characters; line feeds in it are escaped."""
    cut = text if len(text) <= MAX_LINE else f"{text[:MAX_LINE]}... ({len(text) - MAX_LINE:,} more)"
    return SafeText(escaped(cut) + "\n")


def lines(*texts: str) -> SafeText:
    """Return the `line` of each text, concatenated."""
    return SafeText("".join(map(line, texts)))


def joined(*parts: SafeText) -> SafeText:
    """Concatenate the parts."""
    return SafeText("".join(parts))


def ascii_json(text: str) -> SafeText:
    """Return equivalent JSON text in ASCII: other characters only occur in strings and become `\\u`."""
    return SafeText(text if text.isascii() and "\x7f" not in text else _NOT_ASCII.sub(_in_json, text))


def columns_of(character: str) -> int:
    """Return the width of this character on a terminal."""
    if character.isascii():
        return 1
    return 0 if _is_mark(character) else 2 if unicodedata.east_asian_width(character) in "WF" else 1


def sanitized(text: str) -> str:
    """Escape everything unsafe in these lines; `SafeText` is unchanged."""
    if text.isascii() and not text.encode().translate(None, _SEEN):  # as `is_shown`, but fast for megabytes
        return text
    return text if is_shown(text.replace("\n", "")) else "\n".join(map(escaped, text.split("\n")))


def _in_json(match: re.Match[str]) -> str:
    units = match.group().encode("utf-16-be", "surrogatepass")
    return "".join(f"\\u{units[i : i + 2].hex()}" for i in range(0, len(units), 2))


def _is_mark(character: str) -> bool:
    return unicodedata.category(character) in ("Mn", "Me")


def _escaped(text: str, *, is_whole: bool) -> str:
    """Escape the text; double its own backslashes if `is_whole`."""
    pieces: list[str] = []
    carried = MAX_MARKS  # marks on the last letter; the maximum if there is no letter, so that none may follow
    for character in text:
        is_mark = _is_mark(character)
        is_plain = character.isprintable() and not _MOVING.match(character) and not (is_mark and carried >= MAX_MARKS)
        carried = carried + 1 if is_mark else 0 if is_plain and character.isalpha() else MAX_MARKS
        if not is_plain or (is_whole and character == "\\"):
            character = character.encode("unicode_escape", "surrogatepass").decode("ascii")
        pieces.append(character)
    return "".join(pieces)


def number(value: float) -> str:
    """Return a float for people: from 1 on with at most six decimals, below that with six significant digits.

    So two times in seconds look equal only within a microsecond, no count is rounded, and a mean or a p-value is short.
    """
    return repr(round(value, DECIMALS)).removesuffix(".0") if abs(value) >= 1 else f"{value:.6g}"


def counted(count: int, what: str) -> str:
    """Return the count with its noun: 1 run, 2 runs."""
    return f"{count:,} {what}{'' if count == 1 else 's'}"


def list_few(parts: Iterable[str], what: str = "more") -> str:
    """List the first few parts and how many more there are: a, b, c, d, e and 3 more."""
    named = list(parts)
    more = len(named) - NAMED
    return ", ".join(named[:NAMED]) + (f" and {more:,} {what}" if more > 0 else "")


def every(parts: Sequence[str], nothing: str = "none") -> str:
    """List all parts: a, b and c."""
    return " and ".join(filter(None, (", ".join(parts[:-1]), *parts[-1:]))) or nothing


def ranges(numbers: Sequence[int]) -> str:
    """Return numbers in ascending order as ranges: `1-100`, `2-299 by 3`, `7, 9`."""
    parts, start = [], 0
    while start < len(numbers):
        step = numbers[start + 1] - numbers[start] if start + 1 < len(numbers) else 1
        end = start
        while end + 1 < len(numbers) and numbers[end + 1] - numbers[end] == step:
            end += 1
        if end - start < 2 and step != 1:  # two numbers apart are not a range, and the second may begin one
            end = start
        first, last = numbers[start], numbers[end]
        parts.append(str(first) if first == last else f"{first}-{last}" + (f" by {step}" if step > 1 else ""))
        start = end + 1
    return ", ".join(parts)


def did_you_mean(asked: str, names: Collection[str]) -> str:
    """Return `; did you mean NAME?` for the nearest name, or "" if none is near."""
    near = nearest(asked, names)
    return "" if near is None else f"; did you mean {value(near)}?"


def nearest(asked: str, names: Collection[str]) -> str | None:
    """Return the name that is probably meant, None if none is near.

    It is the same name in other case, else the first that begins with `asked`, else the most similar one, else the
    first with the most similar beginning. At least half of the letters must agree.
    """
    from difflib import get_close_matches

    ordered = sorted(names)
    candidates = (
        [name for name in ordered if name.casefold() == asked.casefold()]
        or [name for name in ordered if name.startswith(asked)]
        or get_close_matches(asked, ordered, 1, 0.5)
        or [
            name
            for beginning in get_close_matches(asked, [name[: len(asked)] for name in ordered], 1, 0.5)
            for name in ordered
            if name.startswith(beginning)
        ]
    )
    return candidates[0] if asked and candidates else None
