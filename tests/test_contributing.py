"""Make the change of each page of docs/contributing/ in a copy of the repository, and run its commands and the checks.

`python -m tests.test_contributing event PLACE` makes one change in a copy, to look at it.
"""

import os
import re
import shlex
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from tests.reverts.soak import copy_tree
from tests.running import ran

ROOT = Path(__file__).resolve().parent.parent
FOLDER = ROOT / "docs" / "contributing"
INDEX = (FOLDER / "README.md").read_text("utf-8")
PAGE_LINES_MAX = 90
_BLOCK = re.compile(
    r"^(?:`([\w./-]+)`( \(new\))?:\n\n)?```(?:diff|python|sql|toml)\n(.*?)^```$", re.DOTALL | re.MULTILINE
)
_FILE = re.compile(r"^\+\+\+ ([\w./-]+)( \(new\))?\n", re.MULTILINE)
_COMMANDS = re.compile(r"^```console\n(.*?)^```$", re.DOTALL | re.MULTILINE)


class Change(msgspec.Struct, frozen=True):
    """A change to one file: its whole text where the file is new, else a diff."""

    path: str
    is_new: bool
    text: str


def pages() -> dict[str, str]:
    """Return the pages that hold changes, by their names without suffix."""
    texts = {path.stem: path.read_text("utf-8") for path in sorted(FOLDER.glob("*.md"))}
    return {name: text for name, text in texts.items() if changes(text)}


def changes(page: str) -> list[Change]:
    """Return the changes that the page makes, in its order.

    A block has the name of its file before it, or is a diff in which `+++ FILE` begins the part of each file.
    """
    found = []
    for path, new, text in _BLOCK.findall(page):
        if path:
            found.append(Change(path, bool(new), text))
            continue
        before, *parts = _FILE.split(text)
        assert not before, f"found a block without the name of its file:\n{text}"
        for name, is_new, part in zip(parts[::3], parts[1::3], parts[2::3], strict=True):
            whole = re.sub(r"^\+", "", part, flags=re.MULTILINE)
            found.append(Change(name, bool(is_new), whole if is_new else part))
    return found


def commands(page: str) -> list[list[str]]:
    """Return the commands at the end of the page."""
    lines = "".join(_COMMANDS.findall(page)).splitlines()
    return [shlex.split(line.removeprefix("$ ")) for line in lines]


def checks(made: list[Change]) -> Iterator[list[str]]:
    """Yield the commands of `make check`, for the package and the files that were made."""
    python = [change.path for change in made if change.path.endswith(".py") and change.path.startswith("tests/")]
    queries = [change.path for change in made if change.path.endswith(".sql")]
    yield ["ruff", "check", "."]
    yield ["ruff", "format", "--check", "."]
    yield ["mypy", "--strict", "fsar_ledger", *python]
    yield ["lint-imports"]
    if queries:
        yield ["sqlfluff", "lint", *queries]


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


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the repository for all pages, so that a type is checked and a module compiled once."""
    return copied(tmp_path_factory.mktemp("contributing"))


def copied(place: Path) -> Path:
    """Copy the repository to the place. Return the tree in it, from which `called` runs commands."""
    tree, site = place / "tree", place / "site"
    tree.mkdir()
    site.mkdir()
    copy_tree(tree)
    for name in ("queries", "reports"):
        (tree / "fsar_ledger" / name).unlink()
    (site / "sitecustomize.py").write_text(_HOMES.format(tree=str(tree)), "utf-8")
    if (known := ROOT / ".mypy_cache").is_dir():  # of files by their hashes: what a page changes is checked anew
        shutil.copytree(known, tree / known.name)
    return tree


def make(page: str, place: Path) -> list[Change]:
    """Make the page's changes in the tree at the place."""
    made = changes(page)
    for change in made:
        path = place / change.path
        assert path.exists() != change.is_new, f"{change.path}: found {'it' if change.is_new else 'no such file'}"
        path.parent.mkdir(parents=True, exist_ok=True)
        old = "" if change.is_new else path.read_text("utf-8")
        path.write_text(change.text if change.is_new else changed(change.path, old, change.text), "utf-8")
    return made


def contents(tree: Path) -> dict[Path, bytes]:
    """Return what the files of the repository hold, beside what its tools leave (`.mypy_cache`, `__pycache__`)."""
    files = (path for path in tree.rglob("*") if path.is_file() and not path.is_symlink())
    return {path: path.read_bytes() for path in files if not {".mypy_cache", "__pycache__"} & set(path.parts)}


def restore(tree: Path, before: dict[Path, bytes]) -> None:
    """Undo what a page and its commands changed."""
    for path, data in contents(tree).items():
        if path not in before:
            path.unlink()
        elif data != before[path]:
            path.write_bytes(before[path])


def called(command: list[str], place: Path) -> None:
    """Run a command of the environment in the tree, against the package there.

    Raises: AssertionError unless it ends with 0.
    """
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(place.parent / "site"), str(place)])}
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
    done = ran(words, cwd=place, env=environment)
    assert done.returncode == 0, f"{shlex.join(command)}\n{done.stdout[-6000:]}{done.stderr[-3000:]}"


def once(listed: list[list[str]]) -> list[list[str]]:
    """Return these commands, each once, and their tests after the others, as one call."""
    others = [command for command in listed if command[0] != "pytest"]
    tests = [name for program, *names in listed if program == "pytest" for name in names]
    kept = sorted({name for name in tests if not any(name.startswith(f"{other}/") for other in tests)})
    return [*(list(command) for command in dict.fromkeys(map(tuple, others))), ["pytest", *kept]]


UNTOUCHED = (
    "test_every_quick_example_runs",
    "test_rows_are_the_same_in_every_form",
    "test_a_notebook_runs_in_a_kernel",
    "test_sql_reads_this_ledger_and_nothing_else",
    "test_every_event_type_survives_arrow_and_parquet",
    "test_the_ledger_is_the_same_whatever_the_surroundings",
    "test_a_command_answers_without_pandas_which_pyarrow_would_load",
    "test_export_writes_every_event",
    "test_events_are_the_same_as_objects_and_as_a_table",
    "test_paired_t_cohens_d_and_d_z_agree_with_scipy",
    "test_a_registered_scenario_or_workflow_that_cannot_happen_is_refused_with_its_line_and_field",
)
"""Tests that take a third of the time of all, and that no change of a page is about: left to the soak, page by page."""


@pytest.mark.slow
def test_all_pages_followed_to_the_letter_in_one_copy_pass_their_checks(tree: Path) -> None:
    before = contents(tree)
    try:
        made = [change for page in pages().values() for change in make(page, tree)]
        *others, tests = once([command for page in pages().values() for command in commands(page)])
        for command in (*others, [*tests, "-k", f"not ({' or '.join(UNTOUCHED)})"], *checks(made)):
            called(command, tree)
    finally:
        restore(tree, before)


@pytest.mark.soak
@pytest.mark.parametrize("name", pages())
def test_a_page_followed_to_the_letter_by_itself_passes_its_checks(name: str, tree: Path) -> None:
    page, before = pages()[name], contents(tree)
    try:
        made = make(page, tree)
        for command in (*commands(page), *checks(made)):
            called(command, tree)
    finally:
        restore(tree, before)


@pytest.mark.parametrize("name", pages())
def test_every_page_fits_the_code_as_it_is(name: str) -> None:
    for change in changes(pages()[name]):
        path = ROOT / change.path
        assert path.exists() != change.is_new
        if not change.is_new:
            changed(change.path, path.read_text("utf-8"), change.text)


def test_every_page_is_short() -> None:
    lengths = {path.name: len(path.read_text("utf-8").splitlines()) for path in FOLDER.iterdir()}
    assert {name: lines for name, lines in lengths.items() if lines > PAGE_LINES_MAX} == {}


def test_the_table_has_every_page_with_the_files_and_the_tests_that_it_writes() -> None:
    rows = re.findall(r"^\| \[.*?\]\(([\w-]+)\.md\).*\| (\d+) \| (\d+) \|$", INDEX, flags=re.MULTILINE)
    written = {}
    for name, page in pages().items():
        paths = {change.path for change in changes(page)}
        tests = {path for path in paths if path.startswith("tests/")}
        written[name] = (len(paths - tests), len(tests))
    assert {name: (int(files), int(tests)) for name, files, tests in rows} == written
    assert {path.name for path in FOLDER.iterdir()} - {"README.md"} <= set(re.findall(r"\]\(([\w.-]+)\)", INDEX))


def test_a_block_holds_one_file_or_names_each_of_its_files() -> None:
    block = "```diff\n+++ a.py (new)\n+x\n+\n+++ b.py\n x\n+y\n```\n"
    assert changes(block) == [Change("a.py", True, "x\n\n"), Change("b.py", False, " x\n+y\n")]
    assert changes("`c.py` (new):\n\n```python\nx\n```\n") == [Change("c.py", True, "x\n")]
    with pytest.raises(AssertionError, match="without the name of its file"):
        changes("```python\nx\n```\n")


def test_a_command_of_several_pages_is_called_once_and_a_test_of_several_too() -> None:
    listed = [["a", "x"], ["pytest", "tests/b", "tests/c.py"], ["a", "x"], ["a"], ["pytest", "tests/b/d.py"]]
    assert once(listed) == [["a", "x"], ["a"], ["pytest", "tests/b", "tests/c.py"]]


def test_a_diff_whose_place_is_missing_or_ambiguous_is_refused() -> None:
    assert changed("x", "a\nb\nc\n", " a\n-b\n+B\n@@\n c\n+d\n") == "a\nB\nc\nd\n"
    for text in ("a\n", "b\nb\n"):
        with pytest.raises(AssertionError, match="expected once"):
            changed("x", text, "-b\n+B\n")


if __name__ == "__main__":
    _, name, where = sys.argv
    make(pages()[name], copied(Path(where).resolve()))
