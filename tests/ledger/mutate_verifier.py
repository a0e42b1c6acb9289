"""Remove each check from the verifier in turn, and demand that a test fails: `python -m tests.ledger.mutate_verifier
[PART OF A NAME ...]`.

Every mutant is tried in a process of its own, forked after the libraries were imported and before the package is: first
with the quick tests, then, if it survives those, with the slow ones, last with those that only `make test-all` runs.
Exits with 1 if a survivor is not listed in `EQUIVALENT`, or if an entry there no longer stands for a survivor.
"""

import ast
import os
import signal
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import CodeType

TESTS = tuple(
    f"tests/ledger/{name}.py"
    for name in (
        *("test_verify", "test_verify_checks", "test_damage", "test_hostile", "test_places"),
        *("test_bounds", "test_independent_parquet", "test_layout", "test_codec", "test_verify_notes", "test_proof"),
        *("test_note", "test_weak_keys", "test_agreement_segments", "test_append"),
        *("test_append_refused", "test_evolution", "test_read", "test_recover", "test_recover_again"),
        *("test_refused_runs", "test_refused_commits", "test_unprintable", "test_chain_torn"),
        *("test_agreement_chain", "test_agreement_soak", "test_chain"),
        *("test_chain_links", "test_upgrade"),
    )
)
SLOW = (
    "every_byte or even_where_a_forger or anything_in_a_field or workers_find or any_json or bomb or readers_would "
    "or killed or of_two_writers or however_runs_are_cut or of_each_release"
)
PARALLEL = len(os.sched_getaffinity(0))
LIMIT_S = 600

_EMPTY = "without a second reader there are no digests, and of no digests it finds nothing"
_MEMORY = "it bounds how many rows are read at once, not what is found in them"
_BOTH = "a file that is compared by its values and by a digest of them is compared no worse"
EQUIVALENT: dict[str, str] = {
    "rows/check.py, _envelope: columns[name].null_count < len(columns[name]) "
    "(in COLUMNS[name] == 'integer' and columns[name].null_count < len(columns[name]))": (
        "it saves the look at columns that are all NULL, where no integer is too large"
    ),
    "rows/bounds.py, has_more_text_than: longest > most (in longest > most and text_bytes(table) > most)": (
        "it saves adding up the lengths where not even the longest texts would exceed the bound"
    ),
    "verify/segment.py, examine_some: second_reader is not None (in second_reader is not None and digests)": _EMPTY,
    "verify/segment.py, examine_some: digests (in second_reader is not None and digests)": _EMPTY,
    "verify/segment.py, _together: if part and (len(part) == most or rows > _MOST_ROWS)": _MEMORY,
    "verify/segment.py, _together: part (in part and (len(part) == most or rows > _MOST_ROWS))": _MEMORY,
    "verify/segment.py, _together: len(part) == most or rows > _MOST_ROWS "
    "(in part and (len(part) == most or rows > _MOST_ROWS))": _MEMORY,
    "verify/segment.py, _together: len(part) == most (in len(part) == most or rows > _MOST_ROWS)": _MEMORY,
    "verify/segment.py, _together: rows > _MOST_ROWS (in len(part) == most or rows > _MOST_ROWS)": _MEMORY,
    "verify/segment.py, _examine: not is_as_written (in second_reader is not None and (not is_as_written))": _BOTH,
    "verify/segment.py, _examine: is_as_written (in second_reader is not None and is_as_written)": _BOTH,
}
"""Mutants that no test can tell from the verifier, and why."""


def main(parts: list[str]) -> int:
    """Try every mutant whose name contains one of these parts (no parts: all); return 0 if each that should die did."""
    import hypothesis  # noqa: F401
    import numpy  # noqa: F401
    import pyarrow.parquet  # noqa: F401
    import pytest  # noqa: F401

    began = time.monotonic()
    sources = _sources()
    names = [name for name in sources if not parts or any(part in name for part in parts)]
    if _survives(None):
        print(f"{len(names)} checks of the verifier are taken out, {PARALLEL} at a time", flush=True)
    else:
        print("the tests fail even with every check in place")
        return 1
    survivors = []
    with ThreadPoolExecutor(PARALLEL) as pool:
        for name, survives in zip(names, pool.map(lambda name: _survives(sources[name]), names), strict=True):
            print(f"{'SURVIVED' if survives else 'found   '}  {name:.150}", flush=True)
            survivors += [name] if survives else []
    unlisted = [name for name in survivors if name not in EQUIVALENT]
    stale = [name for name in EQUIVALENT if name in names and name not in survivors]
    stale += [name for name in EQUIVALENT if name not in sources]
    for name in survivors:
        print(f"\n{name}\n    {EQUIVALENT.get(name, 'no test fails without this check')}")
    for name in stale:
        print(f"\n{name}\n    listed as one that no test can tell, but it was found, or is gone: take it off the list")
    counts = (
        f"{len(names)} checks taken out, {len(names) - len(survivors)} found, {len(survivors)} survived, "
        f"{len(unlisted)} of them without a reason"
    )
    print(f"\n{counts}; {time.monotonic() - began:.0f} s")
    return 1 if unlisted or stale else 0


def _sources() -> dict[str, tuple[Path, ast.Module]]:
    """Return every mutant by name. A process of its own makes them, so that nothing of the package is imported here."""
    reading, writing = os.pipe()
    if not os.fork():
        from tests.ledger.mutants import mutants

        with open(writing, "wb") as pipe:
            for mutant in mutants():
                text = ast.unparse(mutant.tree)
                pipe.write(repr((mutant.name, str(mutant.path), text)).encode() + b"\n")
        os._exit(0)
    os.close(writing)
    found: dict[str, tuple[Path, ast.Module]] = {}
    with open(reading, "rb") as pipe:
        for line in pipe:
            name, path, text = ast.literal_eval(line.decode())
            again = sum(other.partition(" #")[0] == name for other in found)
            found[f"{name} #{again + 1}" if again else name] = Path(path), ast.parse(text)
    os.wait()
    return found


def _survives(mutant: tuple[Path, ast.Module] | None) -> bool:
    """Return whether no test fails with this module in place of the package's own; None: with the package as it is."""
    return _passes(mutant, "-k", f"not ({SLOW})") and _passes(mutant, "-k", SLOW) and _passes(mutant, "-m", "slow")


def _passes(mutant: tuple[Path, ast.Module] | None, *which: str) -> bool:
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        return _pass_in(folder, mutant, which)


def _pass_in(folder: str, mutant: tuple[Path, ast.Module] | None, which: Sequence[str]) -> bool:
    child = os.fork()
    if not child:
        try:
            _run_tests(folder, mutant, which)
        finally:
            os._exit(70)
    deadline = time.monotonic() + LIMIT_S
    while True:
        pid, status = os.waitpid(child, os.WNOHANG)
        if pid:
            code = os.waitstatus_to_exitcode(status)
            if code not in (0, 1, 5):  # 5: none of the tests is among these
                raise RuntimeError(f"the tests ended with {code}: the mutant cannot be tried")
            return code != 1
        if time.monotonic() > deadline:  # it hangs without the check: found
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return False
        time.sleep(0.05)


def _run_tests(folder: str, mutant: tuple[Path, ast.Module] | None, which: Sequence[str]) -> None:
    """Run the tests and end the process with the exit code of pytest. Never returns."""
    import pyarrow
    import pytest

    silent = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(silent, stream)
    os.setpgid(0, 0)
    pyarrow.set_cpu_count(1)
    if mutant is not None:
        path, tree = mutant
        code = compile(tree, str(path), "exec")
        own = SourceFileLoader.get_code

        def get_code(loader: SourceFileLoader, fullname: str) -> CodeType | None:
            return code if loader.path == str(path) else own(loader, fullname)

        SourceFileLoader.get_code = get_code  # type: ignore[method-assign, assignment]
    files = [test for test in TESTS if Path(test).exists()]
    options = ["-x", "-q", "-W", "error", "-p", "no:cacheprovider", "--assert=plain", f"--basetemp={folder}/tests"]
    os._exit(int(pytest.main([*options, *which, *files])))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
