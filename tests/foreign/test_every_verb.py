"""Whatever other systems recorded, no verb ends in a traceback."""

import random
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

from benchmarks.every_command import LEFT_OUT
from fsar_ledger.api.ledger import open_ledger
from fsar_ledger.cli.app import app
from fsar_ledger.ledger.rows.codec import LedgerRun
from tests.foreign.claims import baseless
from tests.foreign.histories import append, foreign_run
from tests.foreign.verbs import VERBS, ask, calls
from tests.quick import few

SEEDS = (1, 2, 3)


@pytest.fixture(scope="module")
def ledgers(tmp_path_factory: pytest.TempPathFactory) -> dict[int, tuple[Path, list[LedgerRun]]]:
    """Three ledgers of random records, of either format."""
    folder, found = tmp_path_factory.mktemp("foreign"), {}
    for seed in SEEDS:
        draw = random.Random(seed)
        runs = [foreign_run(f"night-{seed}-{number}", 150, draw) for number in range(4)]
        append(folder / f"ledger-{seed}", runs)
        found[seed] = folder / f"ledger-{seed}", runs
    return found


LONG = ("study", "open")
"""Verbs that the soak alone asks about each order: they show what `query` and `metrics` answer."""


@pytest.mark.parametrize(
    "verb", few(VERBS, ("info", "state", "step", "verify"), [verb for verb in VERBS if verb not in LONG])
)
@pytest.mark.parametrize("seed", few(SEEDS, (1,), ()))
def test_every_verb_answers_about_records_in_any_order(
    ledgers: dict[int, tuple[Path, list[LedgerRun]]], verb: str, seed: int, tmp_path: Path
) -> None:
    ledger, runs = ledgers[seed]
    asked = calls(verb, ledger, runs, tmp_path / "out", random.Random(seed))
    assert asked
    for words in asked:
        found = ask(*words)
        assert found.trace is None, f"{words}\n{found.trace}"
        assert found.code in VERBS[verb][0], f"{words}\n{found.code} {found.err}"


@pytest.mark.slow
def test_nothing_is_said_of_a_concern_that_the_source_does_not_record(
    ledgers: dict[int, tuple[Path, list[LedgerRun]]],
) -> None:
    for ledger, _ in ledgers.values():
        with open_ledger(ledger).database() as database:
            assert list(baseless(database)) == []


def test_every_verb_that_reads_a_ledger_is_asked() -> None:
    group: Any = get_command(app)
    commands = {name for name, one in group.commands.items() if not one.hidden} - {"maintain"}
    maintain = {f"maintain {name}" for name in group.commands["maintain"].commands}
    missing = (commands | maintain) - VERBS.keys() - LEFT_OUT.keys()
    assert not missing, f"{sorted(missing)}: give a call of each in tests/foreign/verbs.py"
    assert VERBS.keys() | LEFT_OUT.keys() == commands | maintain
    assert not VERBS.keys() & LEFT_OUT.keys()
