"""The paper's three workflows as worlds: the fleet of four, these tasks and this wear, and no other disturbance. Paper: sec:prototype:workflows.

What is scripted are facts of the world alone; what follows from them is FSAR's to decide. How long things take
is drawn by the seed, as everywhere.
"""

from typing import NamedTuple, get_args

from fsar_ledger.constants import WorldConstants
from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Workflow, robot_named
from fsar_ledger.events.world import ActuatorDegraded, Grade, TaskArrived

from .draws import Stream

FLEET_SIZE = 4
WORKFLOWS: tuple[Workflow, ...] = get_args(Workflow)
WEAR_AFTER_US = 1_000_000  # how long after the tasks' arrival an actuator degrades: while its robot is still on its first way, 2 s at least


class TaskPlan(NamedTuple):
    """A task that arrives: its owner, its steps as in `TaskArrived`, and what its owner declares about it."""

    owner: str
    steps: tuple[str, ...]
    is_time_critical: bool = False
    checkpoints: tuple[str, ...] | None = None


class Wear(NamedTuple):
    """An actuator that degrades soon after the tasks have arrived."""

    robot: str
    grade: Grade


class Script(NamedTuple):
    """One workflow: its tasks, all of the same arrival, and the wear in it."""

    tasks: tuple[TaskPlan, ...]
    wear: tuple[Wear, ...] = ()


SCRIPTS: dict[Workflow, Script] = {
    # A lacks door.open.secure on its way; B opens under its own runtime.
    "workflow-door-relay": Script(
        (TaskPlan("A", ("A navigate.indoor", "A door.open.secure B", "A navigate.indoor", "A handover.dropoff")),)
    ),
    # A's heavy transport, in which D's steps are D's own; D's gripper slips when it grips the load.
    "workflow-layered-recovery": Script(
        (TaskPlan("A", ("D navigate.indoor", "D grasp.robust", "D carry.heavy", "A handover.dropoff")),),
        (Wear("D", "slipping"),),
    ),
    # B and D need A's carry.package at once; B's delivery is time-critical.
    "workflow-human-supervision": Script(
        (
            TaskPlan("B", ("B carry.package A", "B door.open.basic"), is_time_critical=True),
            TaskPlan("D", ("D carry.package A", "D navigate.indoor")),
        )
    ),
}


def workflow_facts(world: WorldConstants, key: bytes, workflow: Workflow) -> list[tuple[int, Event]]:
    """What the world does in the workflow, in order of time. Units: microseconds of run time."""
    script = SCRIPTS[workflow]
    arrival_us = Stream(key, "start/1").within_us(world.start)
    facts: list[tuple[int, Event]] = []
    for ordinal, plan in enumerate(script.tasks, start=1):
        delegated = sum(step.count(" ") == 2 for step in plan.steps)
        budget_s = (
            world.budget_base_s
            + world.budget_delegated_s * delegated
            + world.budget_own_s * (len(plan.steps) - delegated)
        )
        budget_us = round(budget_s * 1e6)
        arrived = TaskArrived(
            task_id=f"{plan.owner}1-{ordinal}",
            robot=robot_named(plan.owner, 1),
            team=1,
            steps=plan.steps,
            budget_us=budget_us,
            due_us=arrival_us + budget_us,
            checkpoints=plan.checkpoints,
            is_time_critical=plan.is_time_critical,
        )
        facts.append((arrival_us, arrived))
    facts += [
        (arrival_us + WEAR_AFTER_US, ActuatorDegraded(robot_named(wear.robot, 1), wear.grade)) for wear in script.wear
    ]
    return facts
