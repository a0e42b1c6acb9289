"""The table with which `make bench` ends: what each benchmark notes of itself, beside a peer and beside what is wanted.

    python benchmarks/table.py FILE    print the rows that are noted in FILE

A benchmark notes its rows in the file that the variable FSAR_LEDGER_BENCH names, if it is set.
"""

import os
import sys
from pathlib import Path

import msgspec

FILE = "FSAR_LEDGER_BENCH"


class Row(msgspec.Struct, frozen=True):
    """One line of the table. `load` is that of the machine when it was measured."""

    work: str
    found: str
    beside: str
    wanted: str
    load: float


def note(work: str, found: str, beside: str, wanted: str) -> None:
    """Add a row to the table, if one is kept."""
    if (name := os.environ.get(FILE)) is not None:
        row = Row(work, found, beside, wanted, round(os.getloadavg()[0], 1))
        with Path(name).open("ab") as file:
            file.write(msgspec.json.encode(row) + b"\n")


def main() -> int:
    """Print the table as Markdown."""
    if len(sys.argv) != 2:
        print((__doc__ or "").strip(), file=sys.stderr)
        return 2
    print("| work | found | beside, in the same run | wanted | load |")
    print("|---|---|---|---|---|")
    for line in Path(sys.argv[1]).read_bytes().splitlines():
        row = msgspec.json.decode(line, type=Row)
        print(f"| {row.work} | {row.found} | {row.beside} | {row.wanted} | {row.load} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
