"""Whole FSAR runs in which supervisors intervene: their decisions are put among the world's facts."""

from fsar_ledger.designs.constants import Constants
from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Scenario, Supervisor
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.runtime.architectures import HandlerTable
from fsar_ledger.runtime.architectures.fsar import FSAR
from fsar_ledger.runtime.kernel import Kernel
from fsar_ledger.runtime.simulation import RunSpec, run_id, run_started
from fsar_ledger.runtime.world import Draws, SimulatedEnvironment, founding, run_key
from fsar_ledger.runtime.world.schedule import schedule

H_F = Supervisor("supervisor/fleet")


def governed(
    scenario: Scenario,
    *interventions: tuple[int, Event],
    run: int = 0,
    structure: HandlerTable = FSAR,
    constants: Constants = Constants(),  # noqa: B008
) -> Kernel:
    """The finished run of four robots, with these events at these times (microseconds)."""
    spec = RunSpec(42, "fsar", "full", scenario, 4, run)
    facts = sorted([*schedule(constants, 42, scenario, run, 4), *interventions], key=lambda fact: fact[0])
    one = Kernel(
        structure,
        SimulatedEnvironment(facts, Draws(run_key(42, scenario, run), constants.world)),
        (run_started(spec, constants), *founding(4)),
    )
    one.run()
    return one


def record(one: Kernel) -> LedgerRun:
    """The run as it is stored."""
    started = one.events[0]
    return LedgerRun(run_id(started), one.times_us, one.caused_by, one.events)  # type: ignore[arg-type]
