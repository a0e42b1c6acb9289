"""Imports go one way: no circles, and the contracts of pyproject.toml hold."""

import ast
import os
import subprocess
import sys
from collections.abc import Iterable, Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

from tests.running import ran
from tests.test_house import ROOT, code_files


def imports(root: Path) -> dict[str, set[str]]:
    """Return, by module of the package, the modules that it imports when it is loaded."""
    modules = {}
    for path in code_files(root, ".py", ("fsar_ledger", "queries", "reports")):
        parts = [*path.relative_to(root).with_suffix("").parts]
        parts = parts if parts[0] == "fsar_ledger" else ["fsar_ledger", *parts]
        modules[".".join(parts).removesuffix(".__init__")] = path
    graph: dict[str, set[str]] = {}
    for module, path in modules.items():
        package = module if path.name == "__init__.py" else module.rpartition(".")[0]
        found = imported(ast.parse(path.read_text("utf-8")).body, package)
        graph[module] = {name if name in modules else name.rpartition(".")[0] for name in found} & {*modules} - {module}
    return graph


def imported(nodes: Iterable[ast.AST], package: str) -> Iterator[str]:
    """Yield what these statements import when they run: not what functions or type checkers import."""
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (name.name for name in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: 1 - node.level or None] if node.level else []
            base = ".".join([*above, *([node.module] if node.module else [])])
            yield from (f"{base}.{name.name}" for name in node.names)
        elif isinstance(node, ast.If) and ast.unparse(node.test).endswith("TYPE_CHECKING"):
            yield from imported(node.orelse, package)
        elif not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            yield from imported(ast.iter_child_nodes(node), package)


def circle(graph: dict[str, set[str]]) -> list[str]:
    """Return the modules of one circle of imports, none if there is none."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def contracts(root: Path) -> subprocess.CompletedProcess[str]:
    command = [str(Path(sys.executable).with_name("lint-imports")), "--no-cache", "--no-logo"]
    return ran(command, cwd=root, env={**os.environ, "COLUMNS": "500"})


def test_no_modules_import_each_other_in_a_circle() -> None:
    graph = imports(ROOT)
    assert {"fsar_ledger.base.errors", "fsar_ledger.ledger.store.disk"} <= graph["fsar_ledger.ledger.store.staging"]
    assert circle(graph) == []


@pytest.mark.parametrize(
    ("line", "is_found"),
    [
        ("from .staging import stage", True),
        pytest.param("from . import staging", True, marks=pytest.mark.slow),
        pytest.param("import fsar_ledger.ledger.store.staging", True, marks=pytest.mark.slow),
        ("class Lazy:\n    from fsar_ledger.ledger.store import staging", True),
        pytest.param(
            "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from .staging import stage",
            False,
            marks=pytest.mark.slow,
        ),
        ("def late() -> None:\n    from .staging import stage", False),
    ],
)
def test_a_circle_of_imports_is_found(tree: Path, line: str, is_found: bool) -> None:
    disk = tree / "fsar_ledger" / "ledger" / "store" / "disk.py"
    disk.write_text(f"{disk.read_text()}\n{line}\n")
    found = circle(imports(tree))
    assert ({"fsar_ledger.ledger.store.disk", "fsar_ledger.ledger.store.staging"} <= {*found}) == is_found


def test_imports_go_one_way(tree: Path) -> None:
    result = contracts(tree)
    assert result.returncode == 0, result.stdout


BREAKS = (
    ("runtime/architectures/fixture.py", "import random", "fsar_ledger.runtime.architectures.fixture imports random"),
    (
        "runtime/architectures/fixture.py",
        "from os import urandom",
        "fsar_ledger.runtime.architectures.fixture imports os",
    ),
    (
        "runtime/architectures/fixture.py",
        "import fsar_ledger.runtime.world",
        "fsar_ledger.runtime.architectures.fixture imports fsar_ledger.runtime.world",
    ),
    ("runtime/handlers/fixture.py", "import time", "fsar_ledger.runtime.handlers.fixture imports time"),
    (
        "runtime/handlers/fixture.py",
        "import fsar_ledger.ledger",
        "fsar_ledger.runtime.handlers.fixture imports fsar_ledger.ledger",
    ),
    ("events/fixture.py", "import numpy", "fsar_ledger.events.fixture imports numpy"),
    (
        "projections/fixture.py",
        "import fsar_ledger.ledger",
        "fsar_ledger.projections.fixture imports fsar_ledger.ledger",
    ),
    (
        "metrics/fixture.py",
        "import fsar_ledger.runtime",
        "fsar_ledger.metrics is not allowed to import fsar_ledger.runtime",
    ),
    (
        "report/fixture.py",
        "import fsar_ledger.projections",
        "fsar_ledger.report is not allowed to import fsar_ledger.projections",
    ),
    ("ledger/rows/fixture.py", "import duckdb", "fsar_ledger.ledger.rows.fixture imports duckdb"),
    (
        "ledger/rows/fixture.py",
        "import fsar_ledger.ledger.store",
        "fsar_ledger.ledger.rows is not allowed to import fsar_ledger.ledger.store",
    ),
    ("ledger/log/fixture.py", "import os", "fsar_ledger.ledger.log.fixture imports os"),
)
"""Each with the module that it stands in and what is said of it."""


def fixture_in(tree: Path, file: str, *lines: str) -> None:
    text = "\n".join(lines)
    (tree / "fsar_ledger" / file).write_text(f'"""A fixture that breaks the rule."""\n\n{text}\n')


def test_every_import_that_breaks_the_rule_is_found(tree: Path) -> None:
    for file in {file for file, _, _ in BREAKS}:
        fixture_in(tree, file, *(line for other, line, _ in BREAKS if other == file))
    result = contracts(tree)
    assert result.returncode == 1
    assert [complaint for _, _, complaint in BREAKS if complaint not in result.stdout] == []


def test_a_module_that_is_no_layer_is_found(tree: Path) -> None:
    fixture_in(tree, "fixture.py", "")
    result = contracts(tree)
    assert result.returncode == 1
    assert "The following modules are not listed as layers" in result.stdout
