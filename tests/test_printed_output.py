"""The output in the pages is what their commands print."""

import runpy
import sys
from pathlib import Path

import pytest

from tests.quick import few
from tests.running import ran

ROOT = Path(__file__).resolve().parent.parent
WRITE = str(ROOT / "docs" / "write.py")


LONG = (
    *("fsar-ledger bisect out/ledger ", "fsar-ledger cause out/ledger --run 46 "),
    *("fsar-ledger simulate out/many ", "fsar-ledger verify out/many", "fsar-ledger whatif out/many "),
    "fsar-ledger study run multiverse ledger",
)
"""How commands begin that take a third of the time of all; no other reads what they made."""


@pytest.mark.parametrize("left", few([(), LONG], [], [LONG]), ids=len)
def test_the_output_in_the_pages_is_what_the_commands_print(left: tuple[str, ...]) -> None:
    done = ran([sys.executable, WRITE, "--check", *left])
    assert done.returncode == 0, done.stdout + done.stderr


def test_what_a_check_leaves_out_stands_in_a_page_and_nothing_else_is_left_out(tmp_path: Path) -> None:
    write = runpy.run_path(WRITE)
    pages = [page.read_text("utf-8") for page in write["PAGES"]]
    assert [begun for begun in LONG if not any(f"\n$ {begun}" in page for page in pages)] == []
    block = "$ echo one\nold\n$ echo two\n> # more\nold\nolder\n$ echo three\nold\n"
    found = "".join(write["answered"](block, tmp_path, ("echo two",)))
    assert found == "$ echo one\none\n$ echo two\n> # more\nold\nolder\n$ echo three\nthree\n"


def test_no_page_answers_that_a_ledger_is_missing() -> None:
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    missing = ("found no such path", "found no ledger there")
    assert not [page.name for page in pages if any(said in page.read_text("utf-8") for said in missing)]


def test_a_here_document_keeps_its_empty_lines(tmp_path: Path) -> None:
    write = runpy.run_path(WRITE)
    block = "$ cat > a << 'END'\n> one\n>\n> two\n> END\n$ wc -l < a\nold\n"
    assert "".join(write["answered"](block, tmp_path)) == block.replace("old", "3")


def test_a_plain_command_says_its_exit_code_and_goes_through_a_pipe_without_a_process(tmp_path: Path) -> None:
    write = runpy.run_path(WRITE)
    block = '$ fsar-ledger info gone; echo "exit code $?"\n$ fsar-ledger info --help | head -n 1 | cut -c 1-24\n'
    _, refused, _, helped = write["answered"](block, tmp_path)
    assert refused.startswith("fsar-ledger: gone: found no such path, ")
    assert refused.endswith("\nexit code 2\n")
    assert helped == "Usage: fsar-ledger info \n"


def test_a_page_is_out_of_date_when_a_reader_would_notice_not_when_a_digest_changes() -> None:
    noticed = runpy.run_path(WRITE)["noticed"]
    first, second, third = ("0a" * 32, "1b" * 32, "2c" * 32)
    page = "{0}: 17,289 events\nroot {1}\nroot {1}\n"
    assert noticed(page.format("r0000-67d2cf7be87f", first)) == noticed(page.format("r0000-7fe2cf7b0017", second))
    assert noticed(f"{first} {first} {second}") != noticed(f"{first} {second} {third}")
    assert noticed(page.format("r0", first)) != noticed(page.format("r0", first).replace("17,289", "17,288"))
    assert noticed("1795000000000000 event-types decade") == "1795000000000000 event-types decade"
