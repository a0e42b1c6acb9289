"""What a shell offers for the word that is being typed, asked as bash asks."""

import re
from pathlib import Path

import pytest

from fsar_ledger.events.configuration import ARCHITECTURES
from tests.cli.conftest import in_a_process


def completed(*words: object) -> list[str]:
    """Return what is offered for the last word of the line."""
    line = ["fsar-ledger", *map(str, words)]
    asked = {"_FSAR_LEDGER_COMPLETE": "complete_bash", "COMP_WORDS": "\n".join(line), "COMP_CWORD": str(len(line) - 1)}
    called = in_a_process(surroundings=asked)
    assert (called.code, called.err) == (0, "")
    return called.out.split()


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        (("simulate", "out", "--scenario", "f"), ["failure-recovery-chain", "fleet-contention"]),
        pytest.param(("simulate", "out", "--workflow", "l"), ["layered-recovery"], marks=pytest.mark.slow),
        pytest.param(("simulate", "out", "--architecture", ""), list(ARCHITECTURES), marks=pytest.mark.slow),
        pytest.param(
            ("simulate", "out", "--without", "trust"), ["trust-evaluation", "trust-by-record"], marks=pytest.mark.slow
        ),
        (("simulate", "out", "--without", "trust-evaluation+policy-c"), ["trust-evaluation+policy-composition"]),
        (("simulate", "out", "--set", "world.review"), ["world.review_share="]),
        (("query", "audit/policy"), ["audit/policy_at", "audit/policy_known_at"]),
        pytest.param(("query", "policy_a"), ["policy_at"], marks=pytest.mark.slow),
        (("export", "out", "--query", "audit/ref"), ["audit/refusals"]),
        pytest.param(("audit", "out", "--invariant", "a"), ["a1", "a2", "a3", "a4", "a5"], marks=pytest.mark.slow),
        (("exp",), ["export", "explain"]),
        (("query", "policy_at", "nowhere", "--param", "r"), ["run=", "robot="]),
        (("explain", "nowhere", "--run", ""), []),
    ],
)
def test_names_are_completed_without_a_ledger(words: tuple[str, ...], offered: list[str]) -> None:
    assert completed(*words) == offered


@pytest.mark.slow
def test_runs_requests_and_values_are_those_of_the_ledger_on_the_line(ledger: Path) -> None:
    (run,) = completed("explain", ledger, "--run", "cfc.full.door-relay.n4.s7.r0001")
    assert re.fullmatch(r"cfc\.full\.door-relay\.n4\.s7\.r0001-[0-9a-f]+", run)
    assert "A1-1/2.1" in completed("explain", ledger, "--run", run, "--request", "A1-1/")
    assert completed("query", "policy_at", ledger, "--param", "robot=robot/A") == ["robot=robot/A1"]
    assert completed("query", "policy_at", ledger, "--param", f"run={run[:-3]}") == [f"run={run}"]
    assert completed("query", "policy_at", ledger, "--param", f"run={run}", "--param", "at=") == ["at=end"]


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_script_that_a_shell_needs_is_shown(shell: str) -> None:
    named = {"_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"}  # else it is for the shell that runs the tests
    called = in_a_process("--show-completion", shell, surroundings=named)
    assert (called.code, "_FSAR_LEDGER_COMPLETE" in called.out) == (0, True)
