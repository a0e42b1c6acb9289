"""Memory in large pages holds what Python puts there, and a run does not depend on it."""

import subprocess
import sys

import pytest

from fsar_ledger.runtime import arenas

OBJECTS = """
from fsar_ledger.runtime import arenas
early = [str(number) * 3 for number in range(100_000)]
arenas.prepare_for({robots})
one = [{{"a": number, "b": str(number)}} for number in range(400_000)]
del early
other = [(number, str(number)) for number in range(200_000)]
assert one[777] == {{"a": 777, "b": "777"}}
del one
again = [str(number) for number in range(900_000)]
assert all(int(text) == number for number, text in enumerate(again))
assert all(text == str(number) for number, text in other)
arenas.prepare_for({robots})
del again, other
print([str(number) for number in range(300_000)][-1])
"""


@pytest.mark.parametrize("robots", [4, arenas.LARGE_FLEET, 4096])
def test_objects_made_before_and_after_stay_what_they_are(robots: int) -> None:
    done = subprocess.run(
        [sys.executable, "-c", OBJECTS.format(robots=robots)], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "299999\n", "")


def test_without_the_compiled_function_nothing_happens(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(arenas, "_compiled", lambda: None)
    arenas.prepare_for(4096)
