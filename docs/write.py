"""Writes the parts of these pages that are real output, or (--check) says which of them are out of date.

    python docs/write.py            docs/queries.md, and the output in every ```console block
    python docs/write.py --check    exit code 1 and a diff where a page would change

Within a ```console block, lines after `$ ` (and `> ` for more of the same) are commands; they run in order, in an empty folder for each page.
"""

import difflib
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from fsar_ledger.metrics.library import Query, library

DOCS = Path(__file__).resolve().parent
PAGES = (DOCS / "audit-example.md",)
FOLDERS = {
    "staging": "Staging: one view for each event type, and the runs",
    "facts": "Facts: what the events mean",
    "metrics": "Metrics: the judging rules",
    "statistics": "Statistics: architectures compared over paired runs",
    "tables": "Tables: the paper's two tables of marks, and what each mark rests on",
}


def with_output(page: str) -> str:
    """The page with the output of every command as it is now."""
    with tempfile.TemporaryDirectory() as folder:
        return re.sub(r"```console\n(.*?)```", lambda block: "```console\n" + "".join(answered(block[1], Path(folder))) + "```", page, flags=re.DOTALL)


def answered(block: str, folder: Path) -> Iterator[str]:
    """Each command of the block, followed by what it prints."""
    for command in re.findall(r"^\$ .*\n(?:> .*\n)*", block, flags=re.MULTILINE):
        yield command
        text = "\n".join(line[2:] for line in command.splitlines())
        path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        done = subprocess.run(
            ["sh", "-c", text], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False, env={**os.environ, "PATH": path}
        )
        yield done.stdout


def queries_page() -> str:
    """Every query by folder, from the headers of the files."""
    lines = [
        "# All queries",
        "",
        "`fsar-ledger query NAME LEDGER` answers each; the last part of a name is enough. In `sql` the last part is the name of a view.",
        "",
    ]
    lines += ["Written by `docs/write.py` from the headers of `queries/`.", ""]
    for folder in dict.fromkeys(name.partition("/")[0] for name in library().queries):
        lines += [f"## {FOLDERS.get(folder, folder.capitalize())}", "", "| query | what it yields | one row for each |", "|---|---|---|"]
        lines += [_row(query) for query in library().queries.values() if query.name.startswith(f"{folder}/")]
        lines.append("")
    return "\n".join(lines)


def _row(query: Query) -> str:
    parameters = "".join(f" `{name}={value or ''}`" for name, value in query.parameters.items())
    cells = [f"`{query.name}`{parameters}", query.header["Title"], query.header["Grain"].removeprefix("one row per ")]
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def main(arguments: list[str]) -> int:
    """The pages are written, or compared."""
    pages = {page: with_output(page.read_text("utf-8")) for page in PAGES} | {DOCS / "queries.md": queries_page()}
    stale = {page: text for page, text in pages.items() if not page.exists() or page.read_text("utf-8") != text}
    if arguments != ["--check"]:
        for page, text in stale.items():
            page.write_text(text, "utf-8")
        return 0
    for page, text in stale.items():
        old = page.read_text("utf-8") if page.exists() else ""
        print("".join(difflib.unified_diff(old.splitlines(keepends=True), text.splitlines(keepends=True), page.name, "as it is now")))
    if stale:
        print("run `make docs` to write these pages again")
    return 1 if stale else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
