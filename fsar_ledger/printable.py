"""What a terminal, a spreadsheet or a page shows of text that others wrote: every character as itself, or as an escape that is plain ASCII.

Escaped are the characters that do something instead of being seen, or that move what stands beside them: controls (C0, DEL, C1), line and
paragraph separators, bidirectional and other format characters, blanks that are not the space, fillers, variation selectors, private, unassigned
and surrogate code points, letters of right-to-left scripts (beside them a terminal turns numbers round), and marks that no letter carries or
that are more than two on one. Escapes are those of Python: `\\n`, `\\x1b`, `\\u202e`, `\\U000e0001`.
"""

import re
import shlex
import unicodedata
from collections.abc import Iterable
from typing import NewType

Shown = NewType("Shown", str)
"""Lines, each with its end, in which nothing is left that a terminal obeys."""

MAX_VALUE = 200
"""Characters of one value that people are shown; programs are given all."""

MAX_LINE = 4_000
"""Characters of one line that people are shown."""

MAX_MARKS = 2
"""Marks on one letter; Vietnamese needs two."""

NAMED = 5
"""So many things are named in a sentence, or a line each; the rest are counted."""

_UNSEEN = "\u034f\u115f\u1160\u17b4\u17b5\u180b-\u180d\u180f\u2800\u3164\ufe00-\ufe0f\uffa0\U000e0100-\U000e01ef"  # printable, Unicode says, and blank
_RIGHT_TO_LEFT = "\u0590-\u08ff\ufb1d-\ufdff\ufe70-\ufeff\U00010800-\U00010fff\U0001e800-\U0001efff"
_MOVING = re.compile(f"[{_UNSEEN}{_RIGHT_TO_LEFT}]")
_LIKE_AN_ESCAPE = re.compile(r"\\[\\xuUntr]")
_NOT_ASCII = re.compile(r"[^\n\x20-\x7e]")
_FORMULA = re.compile(r"'*\s*[=+\-@\t\r\uff1d\uff0b\uff0d\uff20]")
_BLANKS = re.compile(r"^ | (?= )| $")


def is_shown(text: str) -> bool:
    """Whether every character of the text is shown as itself."""
    if text.isascii():
        return text.isprintable()
    if not text.isprintable() or _MOVING.search(text):
        return False
    return not any(map(_is_mark, set(text))) or _escaped(text, is_whole=False) == text


def escaped(text: str) -> str:
    """The text on one line, with what is not shown as itself escaped; backslashes stay as they are."""
    return text if is_shown(text) else _escaped(text, is_whole=False)


def value(text: str, most: int = MAX_VALUE) -> str:
    """The value as people see it, told from every other: with escapes, its own backslashes doubled if it has some or looks so, cut after `most` characters.

    A text that is shown as it is holds no backslash before one of `\\xuUntr`; one that is not holds one.
    """
    if len(text) > most:
        return f"{value(text[:most], most)}... ({len(text) - most:,} more)"
    if is_shown(text) and ("\\" not in text or not _LIKE_AN_ESCAPE.search(text)):
        return text
    return _escaped(text, is_whole=True)


def cell(text: str, most: int = MAX_VALUE) -> str:
    """As `value`, for a column of a table: blanks that would look like the space between columns are escaped, too."""
    shown = value(text, most)
    return _BLANKS.sub(r"\\x20", shown) if "  " in shown or shown[:1] == " " or shown[-1:] == " " else shown


def field(text: str) -> str:
    """The value, whole, as a spreadsheet may read it: with escapes as in `value`, and no formula."""
    return unformulated(value(text, len(text)))


def word(text: object) -> str:
    """The text as one word of a command that is shown to be copied: in a shell it does nothing but name itself."""
    return shlex.quote(value(str(text), len(str(text))))


def unformulated(text: str) -> str:
    """The text with an apostrophe before it if a spreadsheet would read it as a formula, and if it is such a text already."""
    return "'" + text if _FORMULA.match(text) else text


def line(text: str, most: int = MAX_LINE) -> Shown:
    """One line that people are shown, cut after `most` characters. A line feed in it is none of ours: it is escaped."""
    cut = text if len(text) <= most else f"{text[:most]}... ({len(text) - most:,} more)"
    return Shown(escaped(cut) + "\n")


def lines(*texts: str) -> Shown:
    """As many lines, each as `line` makes it."""
    return Shown("".join(map(line, texts)))


def joined(*parts: Shown) -> Shown:
    """One after the other."""
    return Shown("".join(parts))


def ascii_json(text: str) -> Shown:
    """The JSON text in ASCII, which means the same: every other character is in a string, and there `\\u` says it."""
    return Shown(text if text.isascii() and "\x7f" not in text else _NOT_ASCII.sub(_in_json, text))


def net(text: str) -> str:
    """The lines, with whatever is left in them that is not shown as itself escaped; nothing, if all of them are `Shown`."""
    return text if is_shown(text.replace("\n", "")) else "\n".join(map(escaped, text.split("\n")))


def _in_json(match: re.Match[str]) -> str:
    units = match.group().encode("utf-16-be", "surrogatepass")
    return "".join(f"\\u{units[at : at + 2].hex()}" for at in range(0, len(units), 2))


def _is_mark(character: str) -> bool:
    return unicodedata.category(character) in ("Mn", "Me")


def _escaped(text: str, *, is_whole: bool) -> str:
    """The escaped text; with its own backslashes doubled if `is_whole`."""
    found: list[str] = []
    carried = MAX_MARKS  # marks on the last letter; as many as there may be where there is no letter
    for character in text:
        is_mark = _is_mark(character)
        is_plain = character.isprintable() and not _MOVING.match(character) and not (is_mark and carried >= MAX_MARKS)
        carried = carried + 1 if is_mark else 0 if is_plain and character.isalpha() else MAX_MARKS
        if not is_plain or (is_whole and character == "\\"):
            character = character.encode("unicode_escape", "surrogatepass").decode("ascii")
        found.append(character)
    return "".join(found)


def counted(count: int, what: str) -> str:
    """So many of them, in words: 1 run, 2 runs."""
    return f"{count:,} {what}{'' if count == 1 else 's'}"


def some(parts: Iterable[str], what: str = "more") -> str:
    """The first few of them, and how many more there are, in words: a, b, c, d, e and 3 more."""
    named = list(parts)
    more = len(named) - NAMED
    return ", ".join(named[:NAMED]) + (f" and {more:,} {what}" if more > 0 else "")
