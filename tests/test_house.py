"""House rules: short files, documented modules, one-way imports, a package that works installed."""

import ast
import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from fsar_ledger.events.configuration import ARCHITECTURES
from fsar_ledger.metrics.library import generated
from tests.running import ran

ROOT = Path(__file__).resolve().parent.parent
CODE = ("fsar_ledger", "queries", "reports", "tests", "benchmarks", "docs")
FILE_LINES_MAX, FUNCTION_LINES_MAX, QUERY_LINES_MAX = 400, 60, 80
LONGER = {"tests/independent_verifier.py": 520, "tests/independent_chain.py": 590}
"""Files that may be longer: the verifier keeps the order of docs/ledger-format.md, to be read beside it as one text."""
TOP_LEVEL = {"README.md", "pyproject.toml", "fsar_ledger", "queries", "reports", "tests"}
REQUIREMENTS = {f"requirements{part}.{kind}" for part in ("", "-test", "-all") for kind in ("in", "txt")}
SUPPORT = {
    *("Makefile", "LICENSE", "CHANGELOG.md", "CITATION.cff", "codemeta.json", "benchmarks", "docs"),
    *REQUIREMENTS,
}


def code_files(root: Path, suffix: str, folders: tuple[str, ...] = CODE) -> Iterator[Path]:
    for folder in folders:
        yield from sorted(path for path in (root / folder).rglob(f"*{suffix}") if "__pycache__" not in path.parts)


def too_long(root: Path) -> list[str]:
    """Return the files, functions and queries over their limits, with their lengths."""
    found = []
    for path in [*code_files(root, ".py"), *code_files(root, ".sql")]:
        text, name = path.read_text("utf-8"), path.relative_to(root)
        limit = QUERY_LINES_MAX if path.suffix == ".sql" else LONGER.get(name.as_posix(), FILE_LINES_MAX)
        if (lines := len(text.splitlines())) > limit:
            found.append(f"{name}: {lines} lines, at most {limit}")
        found += [
            f"{name}: {function} has {lines} lines, fewer than {FUNCTION_LINES_MAX} expected"
            for function, lines in long_functions(path, text)
        ]
    return found


def long_functions(path: Path, text: str) -> Iterator[tuple[str, int]]:
    """Return names and lengths of functions that are too long, without their signatures."""
    for node in ast.walk(ast.parse(text)) if path.suffix == ".py" else ():
        if (
            isinstance(node, ast.FunctionDef)
            and (lines := (node.end_lineno or 0) - node.body[0].lineno + 1) >= FUNCTION_LINES_MAX
        ):
            yield node.name, lines


def undocumented(root: Path) -> list[str]:
    """Return the modules of the package without a docstring."""
    modules = code_files(root, ".py", ("fsar_ledger", "queries", "reports", "docs"))
    return [
        str(path.relative_to(root)) for path in modules if not ast.get_docstring(ast.parse(path.read_text("utf-8")))
    ]


PRINTING = {
    *("print", "input", "pprint.pprint", "warnings.warn", "os.system"),
    *(f"sys.{name}" for name in ("stdout", "stderr", "__stdout__", "__stderr__", "displayhook")),
    *(f"typer.{name}" for name in ("echo", "secho", "echo_via_pager", "prompt", "confirm", "progressbar", "launch")),
}
PRINTERS = {"rich", "click", "logging", "curses", "readline", "pdb", "faulthandler"}
MAY_PRINT = ("cli/terminal.py", "cli/render.py")


def prints(root: Path) -> list[str]:
    """Return where the package prints, except in the modules that may."""
    found = []
    for path in code_files(root, ".py", ("fsar_ledger", "queries", "reports")):
        name = path.relative_to(root).as_posix()
        if not name.endswith(MAY_PRINT):
            found += [
                f"{name}:{line}: {what}" for line, what in sorted(set(printing(ast.parse(path.read_text("utf-8")))))
            ]
    return found


def printing(module: ast.Module) -> Iterator[tuple[int, str]]:
    """Return the lines of a module that print, and how: by any name, or by exiting with a text."""
    for node in ast.walk(module):
        if isinstance(node, ast.Import):
            yield from (
                (node.lineno, name.name)
                for name in node.names
                if name.name.partition(".")[0] in PRINTERS or (name.asname and name.name in ("sys", "typer"))
            )
        elif isinstance(node, ast.ImportFrom):
            names = [f"{node.module}.{name.name}" for name in node.names]
            yield from (
                (node.lineno, name)
                for name in names
                if name in PRINTING or str(node.module).partition(".")[0] in PRINTERS
            )
        elif isinstance(node, ast.Attribute | ast.Name) and (name := ast.unparse(node)) in PRINTING:
            yield node.lineno, name
        elif isinstance(node, ast.Call):
            name, first = ast.unparse(node.func), node.args[0] if node.args else None
            is_text = isinstance(first, ast.JoinedStr) or (
                isinstance(first, ast.Constant) and isinstance(first.value, str)
            )
            is_stream = isinstance(first, ast.Constant) and first.value in (1, 2)
            if (name in ("sys.exit", "SystemExit", "exit", "quit") and is_text) or (
                name in ("os.write", "os.fdopen", "open") and is_stream
            ):
                yield node.lineno, name
            if name.startswith("traceback.print_"):
                yield node.lineno, name


def foreign_places(root: Path, files: list[Path]) -> list[str]:
    """Return the package registries and machine folders that a file names."""
    pattern = re.compile(
        r"--(?:extra-)?index-url|--trusted-host|/(?:home|Users|work|root)/\w|https?://[^\s/]*(?:pypi|artifactory|nexus)"
    )
    return [
        f"{path.relative_to(root)}: {match.group()}"
        for path in files
        for match in pattern.finditer(path.read_text("utf-8"))
    ]


def architectures_named(root: Path) -> list[str]:
    """Return the places in shared code that look at the architecture; docstrings may mention it."""
    found = []
    for path in code_files(root / "fsar_ledger", ".py", ("runtime/handlers", "projections")):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            is_name = isinstance(node, ast.Constant) and node.value in ARCHITECTURES
            is_asked = isinstance(node, ast.Attribute) and node.attr == "architecture"
            if isinstance(node, ast.Constant | ast.Attribute) and (is_name or is_asked):
                found.append(f"{path.relative_to(root)}:{node.lineno}")
    return found


VAGUE = {"Asked", "Done", "Found", "Given", "Held", "Made", "Played", "Said", "Seen", "Shown", "Told", "Written"}


def vague(root: Path) -> list[str]:
    """Return the classes of the package whose name is a participle, which says nothing to who does not know them."""
    return [
        f"{path.relative_to(root)}:{node.lineno}: {node.name}"
        for path in code_files(root, ".py", ("fsar_ledger",))
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.ClassDef) and node.name.lstrip("_") in VAGUE
    ]


def test_the_top_level_is_as_agreed() -> None:
    tracked = ran(["git", "ls-files", "--cached", "--others", "--exclude-standard"], cwd=ROOT)
    if tracked.returncode:
        pytest.skip("not a git work tree")
    found = {Path(name).parts[0] for name in tracked.stdout.splitlines()}
    assert found >= TOP_LEVEL
    assert {name for name in found if not name.startswith(".")} <= TOP_LEVEL | SUPPORT


def test_no_file_function_or_query_is_too_long() -> None:
    assert too_long(ROOT) == []


def test_a_long_file_function_or_query_is_found(tmp_path: Path) -> None:
    (tmp_path / "tests").mkdir()
    (tmp_path / "queries").mkdir()
    (tmp_path / "tests" / "long.py").write_text("def long() -> None:\n" + "    pass\n" * FILE_LINES_MAX)
    (tmp_path / "queries" / "long.sql").write_text("SELECT\n" * (QUERY_LINES_MAX + 1))
    assert too_long(tmp_path) == [
        f"tests/long.py: {FILE_LINES_MAX + 1} lines, at most {FILE_LINES_MAX}",
        f"tests/long.py: long has {FILE_LINES_MAX} lines, fewer than {FUNCTION_LINES_MAX} expected",
        f"queries/long.sql: {QUERY_LINES_MAX + 1} lines, at most {QUERY_LINES_MAX}",
    ]


def test_every_module_says_what_it_is() -> None:
    assert undocumented(ROOT) == []


def test_a_module_without_docstring_is_found(tmp_path: Path) -> None:
    (tmp_path / "fsar_ledger").mkdir()
    (tmp_path / "fsar_ledger" / "silent.py").write_text("X = 1\n")
    assert undocumented(tmp_path) == ["fsar_ledger/silent.py"]


def test_classes_are_called_by_what_they_are() -> None:
    assert vague(ROOT) == []


def test_a_class_that_is_called_by_a_participle_is_found(tmp_path: Path) -> None:
    (tmp_path / "fsar_ledger").mkdir()
    (tmp_path / "fsar_ledger" / "fixture.py").write_text("class Asked:\n    class _Held:\n        pass\n")
    assert vague(tmp_path) == ["fsar_ledger/fixture.py:1: Asked", "fsar_ledger/fixture.py:2: _Held"]


def test_only_the_terminal_prints() -> None:
    assert prints(ROOT) == []


@pytest.mark.parametrize(
    "line",
    [
        *(
            *("print(1)", "import sys; sys.stdout.write('x')", "import sys; out = sys.stderr"),
            *("from sys import stdout", "import sys as s", "import logging"),
        ),
        *(
            "import typer; typer.echo('x')",
            "from rich.console import Console",
            "import click",
            "import os; os.write(1, b'x')",
            "import sys; sys.exit('gone')",
        ),
        *(
            "raise SystemExit(f'{1}')",
            "import traceback; traceback.print_exc()",
            "import warnings; warnings.warn('x')",
            "say = print",
            "open(2, 'w')",
        ),
    ],
)
def test_printing_around_the_terminal_is_found(tmp_path: Path, line: str) -> None:
    (tmp_path / "fsar_ledger" / "cli").mkdir(parents=True)
    (tmp_path / "fsar_ledger" / "fixture.py").write_text(f"{line}\n")
    (tmp_path / "fsar_ledger" / "cli" / "terminal.py").write_text("print(1)\n")
    assert {place.partition(":")[0] for place in prints(tmp_path)} == {"fsar_ledger/fixture.py"}


def test_nothing_names_a_registry_or_a_machine() -> None:
    files = [
        path
        for suffix in (".py", ".sql", ".md", ".json")
        for path in code_files(ROOT, suffix)
        if path != Path(__file__).resolve()
    ]
    files += [
        ROOT / name
        for name in ("Makefile", "pyproject.toml", *sorted(REQUIREMENTS), "README.md", "CHANGELOG.md", ".ci/run")
    ]
    assert foreign_places(ROOT, files) == []


def test_a_named_registry_is_found(tmp_path: Path) -> None:
    (tmp_path / "requirements.txt").write_text("--index-url https://pypi.example/simple\n")
    found = foreign_places(tmp_path, [tmp_path / "requirements.txt"])
    assert found == ["requirements.txt: --index-url", "requirements.txt: https://pypi"]


def test_shared_handlers_and_projections_do_not_know_which_architecture_it_is() -> None:
    assert architectures_named(ROOT) == []


def test_a_shared_handler_that_asks_for_the_architecture_is_found(tmp_path: Path) -> None:
    (tmp_path / "fsar_ledger" / "projections").mkdir(parents=True)
    (tmp_path / "fsar_ledger" / "projections" / "curious.py").write_text(
        '"""It is CFC."""\nX = "cfc"\nY = state.fleet.architecture\n'
    )
    found = architectures_named(tmp_path)
    assert found == ["fsar_ledger/projections/curious.py:2", "fsar_ledger/projections/curious.py:3"]


def test_every_folder_with_modules_is_listed_among_the_packages() -> None:
    listed = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["setuptools"]["packages"]
    folders = {path.parent.relative_to(ROOT) for path in (ROOT / "fsar_ledger").rglob("*.py")}
    own = {".".join(folder.parts) for folder in folders}
    missing = own - {*listed}
    assert not missing, f"list {', '.join(sorted(missing))} under `packages` in pyproject.toml"
    assert sorted(listed) == sorted(own | {"fsar_ledger.queries", "fsar_ledger.reports"})


@pytest.mark.slow  # builds and installs a wheel
def test_the_wheel_has_every_module_query_and_report(tree: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    place = tmp_path_factory.mktemp("installed")
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet"]
    subprocess.run(
        [*pip, "wheel", "--no-index", "--no-build-isolation", "--no-deps", "--wheel-dir", str(place / "wheel"), "."],
        cwd=tree,
        check=True,
        capture_output=True,
    )
    (wheel,) = (place / "wheel").glob("fsar_ledger-*.whl")
    subprocess.run(
        [*pip, "install", "--no-index", "--no-deps", "--target", str(place / "site"), str(wheel)],
        check=True,
        capture_output=True,
    )
    packaged = {
        path.relative_to(place / "site").as_posix()
        for path in (place / "site" / "fsar_ledger").rglob("*")
        if "__pycache__" not in path.parts and path.is_file()
    }
    expected = {path.relative_to(tree).as_posix() for path in (tree / "fsar_ledger").rglob("*") if path.is_file()}
    for compiled in ("ledger/log/_hashing", "ledger/rows/_codec"):  # what a machine without a compiler leaves out
        for built in (".abi3.so", sysconfig.get_config_var("EXT_SUFFIX")):
            expected.discard(f"fsar_ledger/{compiled}{built}")
            packaged.discard(f"fsar_ledger/{compiled}{built}")
    expected = {name for name in expected if not name.endswith((".c", ".h"))}
    expected = {
        name for name in expected if not name.startswith("fsar_ledger/view/src/")
    }  # what is built from it is in
    for folder in ("queries", "reports"):
        expected |= {
            f"fsar_ledger/{path.relative_to(tree).as_posix()}" for path in (tree / folder).rglob("*") if path.is_file()
        }
    assert sorted(packaged) == sorted(expected)
    shutil.rmtree(tree)
    assert installed_queries(place) == {
        str(path.relative_to(ROOT / "queries").with_suffix("")) for path in (ROOT / "queries").rglob("*.sql")
    }


def installed_queries(place: Path) -> set[str]:
    """Return the names of the query files in the package in `place/site`, hiding the work tree's editable install."""
    code = (
        "import sys; "
        "sys.meta_path[:] = [one for one in sys.meta_path if 'Editable' not in getattr(one, '__name__', '')]; "
        "import fsar_ledger; from fsar_ledger.cli.app import run; print(fsar_ledger.__file__); "
        "sys.exit(run(['query', '--list', '--json']))"
    )
    environment = {**os.environ, "PYTHONPATH": str(place / "site")}
    done = ran([sys.executable, "-c", code], cwd=place, env=environment, check=True)
    file, _, answer = done.stdout.partition("\n")
    assert file.startswith(str(place / "site"))
    return {query["name"] for query in json.loads(answer)["queries"]} - {query.name for query in generated()}
