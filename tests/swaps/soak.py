"""Swaps every two arguments that could be mistaken for each other, at every place where an event is made: `python -m
tests.swaps.soak [PART OF A NAME ...]`.

Each mutant must die: by the type checker, by a run that records something else (`tests/swaps/histories.py`, whose
digest a test pins), or by the
tests of handlers. Exit code 1 if one survives that is not listed in `EQUIVALENT`, or if an entry there no longer
survives.
"""

import ast
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from types import CodeType, FunctionType

from fsar_ledger.events import Event
from tests.running import ran
from tests.swaps.histories import History, histories
from tests.swaps.sites import PACKAGE, Swap, calls, swapped, swaps

_BROKEN = 3
LIMIT_S = 60
"""A mutant that makes a run go on for ever is found, too."""

EQUIVALENT: dict[str, str] = {
    **dict.fromkeys(
        (
            "runtime/architectures/fsar/request.py _admitted RequestAdmitted: may_request, may_execute",
            "runtime/architectures/fsar/request.py _admitted RequestAdmitted: may_request, is_audited",
            "runtime/architectures/fsar/request.py _admitted RequestAdmitted: may_execute, is_audited",
        ),
        "what is admitted may be requested, may be executed and is audited: all three are true",
    ),
    "runtime/architectures/fsar/helpers.py peer_query recorded_by: requested_by, executed_by": (
        "the robot that failed asks for help, and it is on record as the executor"
    ),
}
"""Mutants that no test can tell from the package, and why."""


def main(parts: list[str]) -> int:
    """Try every mutant whose name holds one of these parts (all: none); return 0 if each that should die did."""
    began = time.monotonic()
    mutants = [swap for swap in swaps() if not parts or any(part in str(swap) for part in parts)]
    left = untyped(mutants)
    by_types = len(mutants) - len(left)
    print(f"{len(mutants)} mutants, {by_types} dead by types ({time.monotonic() - began:.0f} s)", flush=True)
    runs = expected(histories())
    left = [swap for swap in left if not shows(swap, runs)]
    by_runs = len(mutants) - by_types - len(left)
    print(f"{by_runs} dead by a run that records something else ({time.monotonic() - began:.0f} s)", flush=True)
    tests = sorted({test for swap in left for test in _tests_of(swap.file)})
    if tests and fails(tests, None):
        print("the tests fail even without a mutant")
        return 1
    survivors = [swap for swap in left if not fails(_tests_of(swap.file), swap)]
    names = {str(swap) for swap in survivors}
    for name in sorted(names):
        print(f"SURVIVED {name}\n    {EQUIVALENT.get(_placeless(name), 'no test fails')}")
    unlisted = [name for name in names if _placeless(name) not in EQUIVALENT]
    stale = [] if parts else [name for name in EQUIVALENT if name not in {_placeless(one) for one in names}]
    for name in stale:
        print(f"{name}\n    listed as one that no test can tell, but it was found, or is gone: take it off the list")
    by_tests = len(left) - len(survivors)
    print(
        f"{len(mutants)} mutants: {by_types} dead by types, {by_runs} by runs, {by_tests} by tests of handlers, "
        f"{len(survivors)} survived, {len(unlisted)} of them without a reason; {time.monotonic() - began:.0f} s"
    )
    return 1 if unlisted or stale or not mutants else 0


def _placeless(name: str) -> str:
    """The name without the line, which moves."""
    return re.sub(r":\d+ ", " ", name)


# --- by types ---


def untyped(mutants: list[Swap]) -> list[Swap]:
    """Return the mutants in which mypy finds nothing, one mutant for each call at a time."""
    left, found = list(mutants), set[Swap]()
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        shutil.copytree(PACKAGE, root / PACKAGE.name, ignore=shutil.ignore_patterns("__pycache__"))
        shutil.copy(PACKAGE.parent / "pyproject.toml", root)
        files = sorted({swap.file for swap in mutants})
        for file in files:
            _copy_of(root, file).write_text(ast.unparse(ast.parse(file.read_text())))
        known = _errors(root, files)
        while left:
            taken = _apart(left)
            left = [swap for swap in left if swap not in taken]
            for file in files:
                tree = ast.parse(file.read_text())
                for swap in taken:
                    if swap.file == file:
                        tree = swapped(tree, swap)
                _copy_of(root, file).write_text(ast.unparse(tree))
            wrong = _errors(root, files)
            found |= {swap for swap in taken if wrong[swap.file, swap.call] - known[swap.file, swap.call]}
    return [swap for swap in mutants if swap not in found]


def _copy_of(root: Path, file: Path) -> Path:
    return root / PACKAGE.name / file.relative_to(PACKAGE)


def _apart(mutants: list[Swap]) -> set[Swap]:
    """Mutants of which no call lies in another's."""
    taken, inside = set[Swap](), defaultdict[Path, set[int]](set)
    trees: dict[Path, list[ast.Call]] = {}
    for swap in mutants:
        all_calls = trees.setdefault(swap.file, calls(ast.parse(swap.file.read_text())))
        nodes = {number for number, call in enumerate(all_calls) if _is_around(all_calls[swap.call], call)}
        if not nodes & inside[swap.file]:
            inside[swap.file] |= nodes
            taken.add(swap)
    return taken


def _is_around(one: ast.Call, other: ast.Call) -> bool:
    """Whether either of two calls lies in the other."""
    (begin, end), (begins, ends) = _span(one), _span(other)
    return begin <= begins < end or begins <= begin < ends


def _span(call: ast.Call) -> tuple[tuple[int, int], tuple[int, int]]:
    return (call.lineno, call.col_offset), (call.end_lineno or 0, call.end_col_offset or 0)


def _errors(root: Path, files: list[Path]) -> dict[tuple[Path, int], set[str]]:
    """The errors of the type checker by file and call; one inside several calls is one of each."""
    command = [sys.executable, "-m", "mypy", "--strict", "--show-column-numbers", "--no-error-summary", PACKAGE.name]
    done = ran(command, cwd=root)
    if done.returncode not in (0, 1) or done.stderr:
        raise RuntimeError(f"mypy: found exit code {done.returncode}, expected 0 or 1: {done.stdout}{done.stderr}")
    errors = defaultdict[tuple[Path, int], set[str]](set)
    spans = {
        str(_copy_of(root, file).relative_to(root)): (file, calls(ast.parse(_copy_of(root, file).read_text())))
        for file in files
    }
    for name, line, column, error in re.findall(r"^(\S+?):(\d+):(\d+): error: (.*)$", done.stdout, re.M):
        if name not in spans or "unused-ignore" in error:
            continue
        file, made = spans[name]
        for number, call in enumerate(made):
            begin, end = _span(call)
            if begin <= (int(line), int(column) - 1) < end:
                errors[file, number].add(error)
    return errors


# --- by runs ---


Expected = Sequence[tuple[History, list[Event]]]


def expected(runs: Iterable[History]) -> Expected:
    """Return the runs with what each records, without a mutant."""
    return [(history, history()) for history in runs]


def shows(swap: Swap, runs: Expected) -> bool:
    """Tell whether a run records something else, ends in an error, or does not end, with the mutant in the place of its
    function."""
    child = os.fork()
    if child == 0:
        code = _BROKEN
        try:
            code = _differs(runs) if replaced(swap) else 0
        finally:
            os._exit(code)
    until = time.monotonic() + LIMIT_S
    while time.monotonic() < until:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            code = os.waitstatus_to_exitcode(status)
            if code == _BROKEN:
                raise RuntimeError(f"{swap}: found that it cannot be put in place, expected a function to change")
            return code != 0
        time.sleep(0.005)
    os.kill(child, 9)
    os.waitpid(child, 0)
    return True


def _differs(runs: Expected) -> int:
    """1 if a run is another one, or ends in an error, else 0."""
    try:
        return int(any(history() != events for history, events in runs))
    except Exception:
        return 1


def replaced(swap: Swap) -> bool:
    """Put the mutant in the place of every function that its file holds; return whether there was one that it
    changes."""
    name = str(swap.file)
    before = _functions(compile(ast.parse(swap.file.read_text()), name, "exec"))
    after = _functions(
        compile(ast.fix_missing_locations(swapped(ast.parse(swap.file.read_text()), swap)), name, "exec")
    )
    changed = {place: code for place, code in after.items() if code != before[place]}
    patched = False
    module = import_module(_module(swap.file))
    for function in [one for one in _held(vars(module)) if isinstance(one, FunctionType)]:
        code = changed.get((function.__code__.co_qualname, function.__code__.co_firstlineno))
        if code is not None and function.__code__.co_filename == name:
            function.__code__ = code
            patched = True
    return patched


def _held(names: Mapping[str, object]) -> Iterator[object]:
    """The objects of a module, and those inside its classes and behind its caches."""
    for one in names.values():
        yield getattr(one, "__wrapped__", one)
        if isinstance(one, type):
            yield from vars(one).values()


def _module(file: Path) -> str:
    """The name under which others import this file: a package by its own, since `__init__` would be a second copy."""
    return ".".join(file.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__")


def _functions(code: CodeType) -> dict[tuple[str, int], CodeType]:
    """Every function in the code, by its name and line."""
    found = {(code.co_qualname, code.co_firstlineno): code}
    for one in code.co_consts:
        if isinstance(one, CodeType):
            found |= _functions(one)
    return found


# --- by tests ---


def fails(tests: list[str], swap: Swap | None) -> bool:
    """Tell whether one of these tests fails in a copy of the tree with this mutant in it; no tests do not."""
    if not tests:
        return False
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        for name in ("fsar_ledger", "tests", "queries", "docs", "pyproject.toml"):
            whole = PACKAGE.parent / name
            if whole.is_dir():
                shutil.copytree(whole, root / name, ignore=shutil.ignore_patterns("__pycache__", "ledgers"))
            else:
                shutil.copy(whole, root)
        if swap is not None:
            tree = swapped(ast.parse(swap.file.read_text()), swap)
            _copy_of(root, swap.file).write_text(ast.unparse(tree))
        pytest = [sys.executable, "-m", "pytest", "-q", "-x", "-m", "not soak", "-p", "no:cacheprovider"]
        done = subprocess.run(
            [*pytest, *tests], cwd=root, env={**os.environ, "PYTHONPATH": str(root)}, capture_output=True
        )
        return done.returncode != 0


def _tests_of(file: Path) -> list[str]:
    """The files of tests that import this module, or are named after it or its package: those in its room of the tests,
    or in every room if its own has none."""
    root = PACKAGE.parent / "tests"
    package, _, module = _module(file).rpartition(".")
    names = f"test_{file.stem}", f"test_{file.parent.name}"
    imports = re.compile(rf"^from {package}(\.{module} import| import .*\b{module}\b)", re.M)

    def among(room: Path) -> list[str]:
        tests = sorted(room.rglob("test_*.py"))
        found = [one for one in tests if one.stem.startswith(names) or imports.search(one.read_text())]
        return [str(one.relative_to(PACKAGE.parent)) for one in found]

    return among(root / file.relative_to(PACKAGE).parts[0]) or among(root)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
