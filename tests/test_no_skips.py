"""With `--no-skips` a test that is skipped fails: `make test-all` shows that everything has run."""

import shutil
from pathlib import Path

import pytest

pytest_plugins = ("pytester",)

SKIPPED = """
import pytest

def test_runs(): pass
@pytest.mark.skipif(True, reason="no browser here")
def test_waits(): pass
@pytest.mark.xfail
def test_fails_as_expected(): assert False
"""
MODULE = 'import pytest\npytest.importorskip("no_such_extra", reason="make test-all installs it")\ndef test_a(): pass\n'


@pytest.mark.parametrize(
    ("options", "outcomes"),
    [((), {"passed": 1, "skipped": 2, "xfailed": 1}), (("--no-skips",), {"passed": 1, "errors": 2, "xfailed": 1})],
    ids=["make test", "make test-all"],
)
def test_a_skip_is_a_failure_only_where_everything_is_set_up(
    pytester: pytest.Pytester, options: tuple[str, ...], outcomes: dict[str, int]
) -> None:
    shutil.copy(Path(__file__).parent / "conftest.py", pytester.path / "conftest.py")
    pytester.makepyfile(test_one=SKIPPED, test_two=MODULE)
    done = pytester.runpytest_subprocess("-rs", "--continue-on-collection-errors", *options)
    found = done.parseoutcomes()
    assert {name: count for name, count in found.items() if name in outcomes} == outcomes
    assert ("skipped" in found) is (not options)
    done.stdout.fnmatch_lines(["*make test-all installs it*"])
    done.stdout.fnmatch_lines(["*no browser here*"])
