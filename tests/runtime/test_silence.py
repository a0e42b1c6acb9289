"""Nobody knows that a robot is off before it has not answered, and nobody waits longer for an answer than is said, whoever governs. Reading: R44."""

from functools import cache

import msgspec
import pytest

from fsar_ledger.constants import Constants, Outages
from fsar_ledger.events import Event
from fsar_ledger.events.authority import AuthorityReleased
from fsar_ledger.events.envelope import Architecture
from fsar_ledger.events.execution import ExecutionFailed, ExecutionQueued
from fsar_ledger.events.knowledge import WorkQueued
from fsar_ledger.events.recovery import AssistanceAdmitted, AssistanceRequested, RecoveryEscalated
from fsar_ledger.events.registry import AvailabilityChanged
from fsar_ledger.events.request import AwardMade, CommandIssued, RequestIssued, RequestUnanswered
from fsar_ledger.events.task import StepCompleted, TaskAbandoned, TaskCompleted
from fsar_ledger.events.world import LinkCameUp, LinkWentDown, ObstructionAppeared, RobotCameBack, RobotWentOff, TaskArrived
from fsar_ledger.runtime.kernel import Kernel
from fsar_ledger.runtime.simulation import SCENARIOS, RunSpec, founding_of, wiring
from fsar_ledger.runtime.world.draws import Draws, run_key
from fsar_ledger.runtime.world.schedule import Fact, schedule
from tests.runtime.physics import EVERY, LAWLESS, OURS, QUIET

S = 1_000_000
ANSWER_US = round(Outages().answer_s * S)
CALM = msgspec.structs.replace(OURS, **QUIET, **LAWLESS, context_rate_per_s=0.0, routine_rate_per_s=0.0, encounter_mean_s=5.0)
A, B, B2, DOOR = "robot/A1", "robot/B1", "robot/B2", "door.open.secure"
TASK = TaskArrived("A1-1", A, 1, (f"A {DOOR} B",), 90 * S, 91 * S)


def ran(architecture: Architecture, facts: list[Fact], size: int = 8) -> Kernel:
    """The run of two teams in a calm world, in which this happens and nothing else."""
    spec, constants = RunSpec(5, architecture, "full", "door-relay", size, 0), Constants(world=CALM)
    one = Kernel(wiring(architecture), facts, Draws(run_key(5, "door-relay", 0), CALM), *founding_of(spec, constants))
    one.run()
    return one


@cache
def without(architecture: Architecture, scenario: str, robot: str, ends: type[Event]) -> Kernel:
    """The run of a scenario for two teams in a calm world, one robot off or without a link from the beginning."""
    spec, constants = RunSpec(5, architecture, "full", scenario, 8, 0), Constants(world=CALM)  # type: ignore[arg-type]
    facts = ((1, ends(robot)), *schedule(CALM, 5, spec.scenario, 0, 8))  # type: ignore[call-arg]
    one = Kernel(wiring(architecture), facts, Draws(run_key(5, spec.scenario, 0), CALM), *founding_of(spec, constants))
    one.run()
    return one


def of(run: Kernel, *kinds: type[Event]) -> list[tuple[int, Event]]:
    """The events of these kinds with their times."""
    return [(time_us, event) for time_us, event in zip(run.times_us, run.events, strict=True) if isinstance(event, kinds)]


@EVERY
@pytest.mark.parametrize("ends", [RobotWentOff, LinkWentDown])
def test_where_another_robot_could_serve_nobody_waits_for_ever_for_one_that_is_silent(architecture: Architecture, ends: type[Event]) -> None:
    """Each robot in its turn; a task in which the silent one acts itself can only be given up."""
    tasks = 0
    for scenario in SCENARIOS:
        for robot in ("robot/A1", "robot/B1", "robot/C1", "robot/D1"):
            run = without(architecture, scenario, robot, ends)
            done = {event.task_id for _, event in of(run, TaskCompleted) if isinstance(event, TaskCompleted)}
            for _, event in of(run, TaskArrived):
                assert isinstance(event, TaskArrived)
                if all(f"robot/{step.partition(' ')[0]}{event.team}" != robot for step in event.steps):
                    tasks += 1
                    assert event.task_id in done, (scenario, robot, event.task_id, event.steps)
    assert tasks
