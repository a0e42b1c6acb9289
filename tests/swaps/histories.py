"""Runs that between them take every decision that the architectures know; a swap in a handler shows in one of them."""

from collections.abc import Callable, Iterator
from hashlib import sha256

import msgspec

from fsar_ledger.constants import Constants, Outages
from fsar_ledger.events import Event
from fsar_ledger.events.configuration import FULL, MECHANISMS_OF, without
from fsar_ledger.events.envelope import Scenario, Workflow, flat
from fsar_ledger.runtime.simulation import RunSpec, simulate_run
from tests.runtime.commanded import commanded

History = Callable[[], list[Event]]

SCENARIOS: tuple[Scenario | Workflow, ...] = (
    "door-relay",
    "mixed-trust-inspection",
    "failure-recovery-chain",
    "fleet-contention",
    "collaborative-delivery",
    "workflow-layered-recovery",
    "workflow-human-supervision",
)


def _simulated(spec: RunSpec, constants: Constants) -> History:
    return lambda: list(simulate_run(spec, constants).events)


def histories() -> Iterator[History]:
    """Yield each run, those that show most first."""
    yield lambda: list(commanded().events)
    plain, silent = Constants(), Constants(outages=Outages(off_rate_per_s=0.01, link_rate_per_s=0.02))
    for run in range(2):
        for scenario in SCENARIOS:
            for architecture in MECHANISMS_OF:
                yield _simulated(RunSpec(42, architecture, FULL, scenario, 8, run), plain)
    for architecture, mechanisms in MECHANISMS_OF.items():
        for mechanism in mechanisms:
            for scenario in SCENARIOS[1:4]:
                yield _simulated(RunSpec(42, architecture, without([mechanism]), scenario, 4, 0), plain)
    for scenario in SCENARIOS[:5]:
        for architecture in MECHANISMS_OF:
            yield _simulated(RunSpec(43, architecture, FULL, scenario, 8, 0), silent)


def digest() -> str:
    """Return the SHA-256, in hex, of everything that the runs record."""
    found = sha256()
    for history in histories():
        for event in history():
            found.update(msgspec.json.encode([type(event).__name__, flat(event)]))
    return found.hexdigest()
