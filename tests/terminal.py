"""Text as a terminal emulator renders it, and texts that try to paint there."""

import unicodedata

import pyte

CLAIM = "consistent, signed by example.org/fleet"
"""What an attacker would like a line of the screen to say."""

ESC, CSI, BELL = "\x1b", "\x9b", "\x07"
PAINT = {
    "cursor": f"{ESC}[2J{ESC}[H{CLAIM}{ESC}[0m",
    "C1": f"{CSI}2J{CSI}1;1H{CLAIM}",
    "title": f"{ESC}]0;{CLAIM}{BELL}",
    "colour": f"{ESC}[8m hidden {ESC}[32m{CLAIM}",
    "return": f"\r{CLAIM}{ESC}[K",
    "line": f"\n{CLAIM}\nfsar-ledger: {CLAIM}\n",
    "separators": f"\u2028{CLAIM}\u2029{CLAIM}\x85{CLAIM}\x0b{CLAIM}\x0c{CLAIM}",
    "back": "\b" * 80 + CLAIM,
    "bidirectional": f"\u202e{CLAIM[::-1]}\u202c \u2066x\u2069 \u061c \u200f",
    "Hebrew": "\u05d0 1 2 3 \u05d1",
    "width": "a\u200bb\u2060c\ufeffd\u00ade\u3164f\ufe0fg\U000e0041",
    "marks": "e" + "\u0301" * 60 + "\u20dd\u0338",
    "private": "\ue000\U000f0000\ufffe\u0378",
    "columns": f"x   0   {CLAIM}   0",
    "bytes": "\x00\x01\x7f",
    "charset": f"{ESC}(0lqqqk{ESC})B\x0e",
    "backslash": r"\x1b[2J\n" + CLAIM,
    "long": "w" * 5_000 + CLAIM,
}
POISON = "".join(PAINT.values())
MOVING = {"R", "AL", "AN", "RLE", "LRE", "RLO", "LRO", "PDF", "RLI", "LRI", "FSI", "PDI", "BN", "B"}


def screen_of(stream: str, columns: int | None = None) -> pyte.Screen:
    """Return the screen after this stream, as wide as its longest line unless told otherwise."""
    lines = stream.split("\n")
    screen = pyte.Screen(
        columns or 2 * max(map(len, lines)) + 2,
        len(lines) + sum(len(line) // (columns or len(line) + 1) for line in lines),
    )
    screen.set_mode(pyte.modes.LNM)  # as a terminal's driver treats a program's line feed
    pyte.Stream(screen).feed(stream)
    return screen


def painted(stream: str) -> list[str]:
    """Return what a terminal shows of the stream beyond its printable text, line by line; it should be nothing."""
    if not stream:
        return []
    lines = stream.removesuffix("\n").split("\n")
    screen = screen_of(stream)
    rows = [screen.buffer[number] for number in range(screen.lines)]
    shown = ["".join(row[at].data for at in range(max(row, default=-1) + 1)).rstrip() for row in rows]
    found = [
        f"{line!r} is shown as {there!r}"
        for line, there in zip(lines, shown, strict=False)
        if unicodedata.normalize("NFC", line.rstrip()) != there
    ]
    found += [f"below: {line!r}" for line in shown[len(lines) :] if line]
    found += [f"title {screen.title!r}"] if screen.title or screen.icon_name else []
    plain = pyte.screens.Char(" ")._replace(data="")
    found += [
        f"{char!r} has a style"
        for row in screen.buffer.values()
        for char in row.values()
        if char._replace(data="") != plain
    ]
    found += [
        f"{line!r:.80} begins with a claim"
        for line in shown
        if line.removeprefix("fsar-ledger: ").lstrip().startswith(CLAIM)
    ]
    return found + [
        f"{one!r} moves or hides"
        for one in sorted(set(stream))
        if not one.isascii() and unicodedata.bidirectional(one) in MOVING
    ]
