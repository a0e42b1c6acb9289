"""Runs to draw, and their pages."""

from collections.abc import Sequence

import pytest

from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.runtime.simulation import RunSpec, simulate_run
from fsar_ledger.view import PageOptions, Words, draw_run
from tests.runtime.pinned import PINNED

ARCHITECTURES = ("fsar", "cfc", "dhma")


def a_run(architecture: str, scenario: str = "failure-recovery-chain", size: int = 4, number: int = 0) -> LedgerRun:
    return simulate_run(RunSpec(7, architecture, "full", scenario, size, number), PINNED)


def plain_words(run: LedgerRun) -> Sequence[Words]:
    """Words that say nothing, where a test is not about them."""
    return [Words(None, None, "", None, None)] * len(run.events)


def shown(run: LedgerRun, words: Sequence[Words] | None = None) -> PageOptions:
    picture = draw_run(run, "1", plain_words(run) if words is None else words)
    return PageOptions(picture, "out/ledger", len(run.events), "0" * 64, True, ())


@pytest.fixture(scope="session")
def runs() -> dict[str, LedgerRun]:
    """A run of each architecture in the same world; for reading only."""
    return {architecture: a_run(architecture) for architecture in ARCHITECTURES}
