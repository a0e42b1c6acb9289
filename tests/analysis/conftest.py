"""Runs of all architectures, for reading only."""

import pytest

from fsar_ledger.designs.constants import Constants, Outages
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.runtime.simulation import RunSpec, simulate_run

OUTAGES = Constants(outages=Outages(off_rate_per_s=0.01, link_rate_per_s=0.01))


def simulated(
    architecture: str, run: int = 0, constants: Constants | None = None, scenario: str = "door-relay"
) -> LedgerRun:
    """One run of the paper's experiment."""
    return simulate_run(RunSpec(42, architecture, "full", scenario, 4, run), constants or Constants())


@pytest.fixture(scope="session")
def runs() -> list[LedgerRun]:
    """A run of each architecture, and one of each with outages."""
    return [
        simulated(architecture, constants=constants)
        for architecture in ("fsar", "cfc", "dhma")
        for constants in (Constants(), OUTAGES)
    ]
