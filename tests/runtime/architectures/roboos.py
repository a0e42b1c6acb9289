"""Given events and dials, what RoboOS decides, and its runs of given facts."""

from typing import Any

from fsar_ledger.designs.constants import Constants, Outages
from fsar_ledger.designs.dials import Roboos
from fsar_ledger.events import Event
from fsar_ledger.events.envelope import COORDINATOR, Principal, Robot, Subject
from fsar_ledger.events.knowledge import StoreEntryWritten
from fsar_ledger.events.task import TaskPlanned
from fsar_ledger.events.world import ActuatorDegraded, ObstructionAppeared
from fsar_ledger.projections.fold import State, fold
from fsar_ledger.runtime.architectures.roboos import ROBOOS, StartChecklist
from fsar_ledger.runtime.architectures.roboos.master import SendSubtask, TakeSubtask
from fsar_ledger.runtime.handlers.commands import DetectObstruction, FinishAttempt, StartAction, TakeTurn
from fsar_ledger.runtime.kernel import Kernel
from fsar_ledger.runtime.ports import Fact
from fsar_ledger.runtime.simulation import RunSpec, run_started
from fsar_ledger.runtime.world import Draws, SimulatedEnvironment, founding, run_key
from tests import past
from tests.runtime import live
from tests.runtime.histories import happen

A, B, C, D = (Robot(f"robot/{name}1") for name in "ABCD")
B2 = Robot("robot/B2")
DOOR, S = "door.open.secure", 1_000_000
OWN_THEN_DOOR = ("A navigate.indoor", f"A {DOOR} B")
TASK = past.arrived("A1-1", A, OWN_THEN_DOOR, budget_us=600 * S, due_us=601 * S)
DOOR_TASK = past.arrived("A1-1", A, (f"A {DOOR} B",), budget_us=600 * S, due_us=601 * S)
ACTION = "A1-1/1.1"
MIXED = Outages(0.02, 8.0, 0.03, 6.0, 0.002)


def decided(state: State, command: Any) -> tuple[Event, ...]:
    return live.decided(state, command, ROBOOS)


def play(state: State, *commands: Any) -> tuple[Any, ...]:
    return live.play(state, *commands, table=ROBOOS)


def begun(fleet_size: int, dials: Roboos) -> tuple[Event, ...]:
    spec = RunSpec(1, "roboos", "full", "door-relay", fleet_size, 0)
    return (run_started(spec, Constants(roboos=dials)), *founding(fleet_size))


def given(*events: Event, fleet_size: int = 4, **dials: int) -> State:
    """The state after the founding and these events."""
    return fold((*begun(fleet_size, Roboos(**dials)), *events))


def stored(robot: Robot, availability: Any, by: Principal = COORDINATOR) -> StoreEntryWritten:
    return StoreEntryWritten(robot=robot, availability=availability, until_us=None, written_by=by)


def ran(*facts: Fact, **dials: int) -> Kernel:
    """The run of these facts and no others."""
    draws = Draws(run_key(1, "door-relay", 0), Constants().world)
    one = Kernel(ROBOOS, SimulatedEnvironment(facts, draws), begun(4, Roboos(**dials)))
    one.run()
    return one


def planned(state: State, *robots: Robot, task_id: str = "A1-1") -> None:
    happen(state, TaskPlanned(task_id=task_id, robots=robots, ready_us=2))


def sent(*before: Event, **dials: int) -> State:
    """B has been sent to open the door for A."""
    state = given(DOOR_TASK, *before, **dials)
    planned(state, B)
    happen(state, past.began(Subject("A1-1", ACTION), A, 1, DOOR, "B"))
    play(state, SendSubtask(ACTION))
    return state


def running(*before: Event, **dials: int) -> State:
    state = sent(*before, **dials)
    play(state, TakeSubtask(ACTION, "A1-1", B), TakeTurn(ACTION), StartAction(ACTION, now_us=9 * S, answer=2 * S))
    return state


def obstructed(*before: Event, **dials: int) -> State:
    state = running(*before, ObstructionAppeared(B, "o"), **dials)
    play(state, DetectObstruction(ACTION, now_us=10 * S), StartChecklist(ACTION, now_us=10 * S + 1))
    return state


def worn(*before: Event, **dials: int) -> State:
    state = running(*before, ActuatorDegraded(B), **dials)
    play(state, FinishAttempt(ACTION, 11 * S, now_us=11 * S, answer=0), StartChecklist(ACTION, now_us=11 * S + 1))
    return state
