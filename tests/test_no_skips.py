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


def test_what_a_session_left_out_is_run_by_the_next_one_that_is_asked_to(pytester: pytest.Pytester) -> None:
    shutil.copy(Path(__file__).parent / "conftest.py", pytester.path / "conftest.py")
    slow = "\n@pytest.mark.slow\ndef test_slow(): pass\n"
    pytester.makeini("[pytest]\nmarkers = slow: takes long")
    pytester.makepyfile(test_one=SKIPPED + slow, test_two=MODULE)
    assert pytester.runpytest_subprocess("--left-out").parseoutcomes()["passed"] == 2  # nothing ran before
    pytester.runpytest_subprocess("-m", "not slow")
    pytester.makepyfile(test_two="def test_a(): pass\ndef test_b(): pass\n")  # the extra is there now
    found = pytester.runpytest_subprocess("--left-out").parseoutcomes()
    assert (found["passed"], found["skipped"], found.get("xfailed")) == (3, 1, None)


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
