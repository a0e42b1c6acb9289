"""JADE: given events, what it decides and what follows; and runs of a calm world with messages of one second."""

from collections.abc import Sequence
from functools import cache, partial

import msgspec

from fsar_ledger.designs.constants import Constants, Outages, Range
from fsar_ledger.designs.dials import Jade
from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Robot, Subject
from fsar_ledger.events.knowledge import BidReceived
from fsar_ledger.projections.fold import State, fold
from fsar_ledger.runtime.architectures.jade import JADE
from fsar_ledger.runtime.architectures.jade.contract_net import EvaluateProposals, ReceiveAcceptance
from fsar_ledger.runtime.handlers.commands import Command, Scheduled
from fsar_ledger.runtime.kernel import Kernel
from fsar_ledger.runtime.ports import Fact
from fsar_ledger.runtime.simulation import RunSpec, founding_of, simulate_run
from fsar_ledger.runtime.world import Draws, SimulatedEnvironment, run_key
from tests import past
from tests.runtime import live
from tests.runtime.histories import ARRIVED, DELEGATED_STEP, started
from tests.runtime.live import of
from tests.runtime.test_silence import CALM

A, B, B2, C, D = (Robot(f"robot/{name}") for name in ("A1", "B1", "B2", "C1", "D1"))
S, DOOR, STEP, ACTION = 1_000_000, "door.open.secure", "A1-1/1.1", "A1-1/2.1"
ABOUT = Subject("A1-1", ACTION)
LISTED = (ARRIVED, DELEGATED_STEP, past.queried(ABOUT, past.parties(A), DOOR, B))
TWO_LISTED = msgspec.structs.replace(LISTED[-1], candidates=(B, C))
TASK = past.arrived("A1-1", A, (f"A {DOOR} B",), budget_us=90 * S, due_us=91 * S)

decided, play = partial(live.decided, table=JADE), partial(live.play, table=JADE)


def given(*events: Event, **dials: int) -> State:
    """The state of a fleet of four after these events, under these dials."""
    return fold((*started("jade", constants=Constants(jade=Jade(**dials))), *events))


def reactions(state: State, event: Event, now_us: int = 0) -> list[Scheduled]:
    """What follows from the event, which is the last one that the state knows."""
    return [one for react in JADE.reacts.get(type(event), ()) for one in react(state, event, now_us)]


def follows(state: State, event: Event) -> list[Command]:
    return [one.command for one in reactions(state, event)]


STEADY = msgspec.structs.replace(CALM, message=Range(1.0, 1.0))
"""A calm world in which every message takes one second."""


def ran(facts: Sequence[Fact], size: int = 8, **dials: int) -> Kernel:
    """The run of a calm world with messages of one second, in which this happens and nothing else."""
    spec, constants = RunSpec(5, "jade", "full", "door-relay", size, 0), Constants(world=STEADY, jade=Jade(**dials))
    draws = Draws(run_key(5, spec.scenario, spec.run), STEADY)
    environment = SimulatedEnvironment(sorted(facts, key=lambda fact: fact[0]), draws)
    one = Kernel(JADE, environment, *founding_of(spec, constants))
    one.run()
    return one


def times(run: Kernel, *kinds: type[Event]) -> list[int]:
    """When events of these kinds happened, in whole seconds."""
    return [time_us // S for time_us, _ in of(run, *kinds)]


@cache
def scenario(name: str, size: int, outages: Outages | None = None, run: int = 0) -> tuple[Event, ...]:
    return tuple(simulate_run(RunSpec(42, "jade", "full", name, size, run), Constants(outages=outages)).events)


def contracted(*before: Event, **dials: int) -> State:
    """B has been awarded the contract and has accepted it."""
    state = given(*LISTED, BidReceived(ABOUT, B, "allow", 0), *before, **dials)
    play(state, EvaluateProposals(ACTION, 0), ReceiveAcceptance(ACTION, 0))
    return state
