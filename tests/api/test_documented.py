"""What `import fsar_ledger` offers is what the command line does, is documented, and costs nothing until it is used."""

import ast
import inspect
import json
import os
import re
import sys
from pathlib import Path

import pytest

import fsar_ledger
from tests.quick import few
from tests.running import ran
from tests.test_documentation import COMMANDS

DOCS = Path(fsar_ledger.__file__).resolve().parent.parent / "docs"
PAGE = (DOCS / "python.md").read_text("utf-8")
NOTEBOOKS = {"tour.ipynb": ["out/tour.svg"], "auditors-hour.ipynb": ["out/denial.tlog-proof"]}
"""The notebooks, and the file that the last cells of each make."""
WITHOUT_FUNCTION = {"serve", "demo", "witness serve", "study show"}
"""A service and a demo are processes; the last prints a file that Python reads as JSON or Parquet."""
FUNCTIONS = {"import": "import_records", "calibration": "calibrate", "predictions": "predict", "comparison": "judge"}
"""The functions that have another name in Python."""


def methods() -> set[str]:
    return {name for name, _ in inspect.getmembers(fsar_ledger.Ledger) if not name.startswith("_")}


@pytest.mark.parametrize("verb", sorted(COMMANDS.keys() - WITHOUT_FUNCTION))
def test_every_verb_has_a_function_of_its_name(verb: str) -> None:
    name = verb.removeprefix("maintain ").removeprefix("study run ")
    function = FUNCTIONS.get(name, re.sub(r"[ -]", "_", name))
    assert function in set(fsar_ledger.__all__) | methods(), "make it a method of Ledger in fsar_ledger/api/ledger.py"


def test_every_public_name_is_documented() -> None:
    named = set(re.findall(r"\w+", PAGE))
    internal = {"database", "about_run", "path"}
    missing = (set(fsar_ledger.__all__) | methods()) - internal - named
    assert not missing, f"{', '.join(sorted(missing))}: run `python docs/write.py python.md`, or describe it there"


def test_every_public_name_can_be_imported_and_says_what_it_is() -> None:
    for name in fsar_ledger.__all__:
        assert inspect.getdoc(getattr(fsar_ledger, name)), name
    with pytest.raises(AttributeError, match="has no attribute 'simulat'"):
        getattr(fsar_ledger, "simulat")  # noqa: B009


def test_an_import_takes_no_library() -> None:
    code = (
        "import sys; before = set(sys.modules); import fsar_ledger; "
        "loaded = {name for name in set(sys.modules) - before if name.partition('.')[0] not in "
        "sys.stdlib_module_names}; "
        "print(*sorted(loaded))"
    )
    done = ran([sys.executable, "-S", "-c", code], env=_here(), check=True)
    assert done.stdout.split() == ["fsar_ledger"]


@pytest.mark.slow
def test_the_examples_of_the_page_run(tmp_path: Path) -> None:
    run_in_order(re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL), tmp_path)


@pytest.mark.soak  # where no kernel is installed, as the next but one runs them in
@pytest.mark.parametrize("name", NOTEBOOKS)
def test_the_cells_of_a_notebook_run(tmp_path: Path, name: str) -> None:
    run_in_order(cells(name), tmp_path)
    assert [(tmp_path / made).exists() for made in NOTEBOOKS[name]] == [True]


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_holds_no_output(name: str) -> None:
    notebook = json.loads((DOCS / name).read_text("utf-8"))
    assert [cell for cell in notebook["cells"] if cell.get("outputs") or cell.get("execution_count")] == []


@pytest.mark.parametrize("name", few(NOTEBOOKS, []))
def test_a_notebook_runs_in_a_kernel(tmp_path: Path, name: str) -> None:
    client = pytest.importorskip("nbclient", reason="the notebook extra is not installed")
    nbformat = pytest.importorskip("nbformat", reason="the notebook extra is not installed")
    pytest.importorskip("ipykernel", reason="the notebook extra is not installed")
    notebook = nbformat.read(DOCS / name, as_version=4)
    client.NotebookClient(notebook, timeout=120, resources={"metadata": {"path": str(tmp_path)}}).execute()
    assert [(tmp_path / made).exists() for made in NOTEBOOKS[name]] == [True]


def test_every_notebook_is_run() -> None:
    assert {file.name for file in DOCS.glob("*.ipynb")} == set(NOTEBOOKS)


def cells(name: str) -> list[str]:
    """Return the code of a notebook, cell by cell."""
    notebook = json.loads((DOCS / name).read_text("utf-8"))
    return ["".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == "code"]


def run_in_order(parts: list[str], folder: Path) -> None:
    """Run these texts in one process of its own, one after the other."""
    assert len(parts) > 3
    for part in parts:
        ast.parse(part)
    done = ran(
        [sys.executable, "-W", "error", "-c", "\n".join(parts)],
        cwd=folder,
        env=_here() | {"MPLBACKEND": "agg", "XDG_CACHE_HOME": str(folder / "cache"), "MPLCONFIGDIR": str(folder)},
    )
    assert done.returncode == 0, done.stderr


def _here() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(DOCS.parent)}
