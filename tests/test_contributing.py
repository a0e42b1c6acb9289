"""Make the change of each section of docs/contributing.md in a copy of the repository, and run the checks at its end.

`python -m tests.test_contributing "An event" PLACE` makes one change in a copy, to look at it.
"""

import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from tests.reverts.soak import copy_tree

ROOT = Path(__file__).resolve().parent.parent
PAGE = (ROOT / "docs" / "contributing.md").read_text("utf-8")
_BLOCK = re.compile(r"^`([\w./-]+)`( \(new\))?:\n\n```(\w+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
_COMMANDS = re.compile(r"^```console\n(.*?)^```$", re.DOTALL | re.MULTILINE)


class Change(msgspec.Struct, frozen=True):
    """A change to one file: its whole text where the file is new, else a diff."""

    path: str
    is_new: bool
    text: str


def sections() -> dict[str, str]:
    """Return the sections that hold changes, by their titles."""
    parts = re.split(r"^## (.+)\n", PAGE, flags=re.MULTILINE)[1:]
    return {title: text for title, text in zip(parts[::2], parts[1::2], strict=True) if _BLOCK.search(text)}


def changes(section: str) -> list[Change]:
    """Return the changes that the section makes, in its order."""
    return [Change(path, bool(new), text) for path, new, _, text in _BLOCK.findall(section)]


def commands(section: str) -> list[list[str]]:
    """Return the commands at the end of the section."""
    lines = "".join(_COMMANDS.findall(section)).splitlines()
    return [shlex.split(line.removeprefix("$ ")) for line in lines]


def hunks(diff: str) -> Iterator[tuple[str, str]]:
    """Yield the old and the new text of each part between lines of `@@`; an empty line belongs to both."""
    for part in re.split(r"^@@\n", diff, flags=re.MULTILINE):
        lines = [line or " " for line in part.splitlines()]
        before, after = ("".join(f"{line[1:]}\n" for line in lines if line[0] in kept) for kept in (" -", " +"))
        yield before, after


def changed(path: str, text: str, diff: str) -> str:
    """Return the text after the diff. Raises: AssertionError where the text does not hold an old part exactly once."""
    for before, after in hunks(diff):
        assert text.count(before) == 1, f"{path}: found {text.count(before)} times, expected once:\n{before}"
        text = text.replace(before, after)
    return text


_HOMES = """
import sys
from importlib.machinery import ModuleSpec
from importlib.util import spec_from_file_location
from pathlib import Path

HOMES = {{f"fsar_ledger.{{name}}": Path({tree!r}, name) for name in ("queries", "reports")}}


class Finder:
    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        home = HOMES.get(name)
        return home and spec_from_file_location(name, home / "__init__.py", submodule_search_locations=[str(home)])


sys.meta_path.insert(0, Finder)
"""
"""Code that makes a process read the queries and reports of the copy, which are beside the package there."""


def copied(place: Path) -> Path:
    """Copy the repository to the place. Return the tree in it, from which `called` runs commands."""
    tree, site = place / "tree", place / "site"
    tree.mkdir()
    site.mkdir()
    copy_tree(tree)
    for name in ("queries", "reports"):
        (tree / "fsar_ledger" / name).unlink()
    (site / "sitecustomize.py").write_text(_HOMES.format(tree=str(tree)), "utf-8")
    return tree


def make(section: str, place: Path) -> list[Change]:
    """Make the section's changes in the tree at the place."""
    made = changes(section)
    for change in made:
        path = place / change.path
        assert path.exists() != change.is_new, f"{change.path}: found {'it' if change.is_new else 'no such file'}"
        path.parent.mkdir(parents=True, exist_ok=True)
        old = "" if change.is_new else path.read_text("utf-8")
        path.write_text(change.text if change.is_new else changed(change.path, old, change.text), "utf-8")
    return made


def called(command: list[str], place: Path) -> None:
    """Run a command of the environment in the tree, against the package there.

    Raises: AssertionError unless it ends with 0.
    """
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(place.parent / "site"), str(place)]),
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    modules = {
        "ruff": ["ruff"],
        "mypy": ["mypy"],
        "sqlfluff": ["sqlfluff"],
        "pytest": ["pytest", "-p", "no:cacheprovider"],
    }
    program, *arguments = command
    if program == "python":
        words = [sys.executable, *arguments]
    elif program in modules:
        words = [sys.executable, "-m", *modules[program], *arguments]
    else:
        words = [str(Path(sys.executable).with_name(program)), *arguments]
    done = subprocess.run(words, cwd=place, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{shlex.join(command)}\n{done.stdout[-6000:]}{done.stderr[-3000:]}"


@pytest.mark.slow
@pytest.mark.parametrize("title", sections())
def test_a_section_followed_to_the_letter_passes_its_checks(title: str, tmp_path: Path) -> None:
    tree = copied(tmp_path)
    make(sections()[title], tree)
    for command in commands(sections()[title]):
        called(command, tree)


@pytest.mark.parametrize("title", sections())
def test_every_section_fits_the_code_as_it_is(title: str) -> None:
    for change in changes(sections()[title]):
        path = ROOT / change.path
        assert path.exists() != change.is_new
        if not change.is_new:
            changed(change.path, path.read_text("utf-8"), change.text)


def test_the_table_counts_the_files_and_the_tests_that_each_section_writes() -> None:
    rows = re.findall(r"^\| \[.*?\]\(#([\w-]+)\).*\| (\d+) \| (\d+) \|$", PAGE, flags=re.MULTILINE)
    written = {}
    for title, text in sections().items():
        paths = {change.path for change in changes(text)}
        tests = {path for path in paths if path.startswith("tests/")}
        written[title.lower().replace(" ", "-")] = (len(paths - tests), len(tests))
    assert {name: (int(files), int(tests)) for name, files, tests in rows} == written


def test_a_diff_whose_place_is_missing_or_ambiguous_is_refused() -> None:
    assert changed("x", "a\nb\nc\n", " a\n-b\n+B\n@@\n c\n+d\n") == "a\nB\nc\nd\n"
    for text in ("a\n", "b\nb\n"):
        with pytest.raises(AssertionError, match="expected once"):
            changed("x", text, "-b\n+B\n")


if __name__ == "__main__":
    _, name, where = sys.argv
    make(sections()[name], copied(Path(where)))
