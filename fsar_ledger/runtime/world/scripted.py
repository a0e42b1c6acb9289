"""The paper's workflows as worlds: their tasks and their wear, and no other disturbance.

Paper: sec:prototype:workflows. Only facts of the world are scripted; FSAR decides what follows from them. Durations are
drawn under the seed, as everywhere.
"""

from fsar_ledger.constants import WorldConstants
from fsar_ledger.designs import Task, Workflow
from fsar_ledger.events import Event
from fsar_ledger.events.envelope import robot_named
from fsar_ledger.events.world import ActuatorDegraded, TaskArrived

from .draws import FOREVER_US, Stream

WEAR_AFTER_US = 1_000_000
"""How long after the tasks arrive an actuator degrades: while its robot is on its first way, at least 2 s long."""


def workflow_facts(world: WorldConstants, key: bytes, workflow: Workflow) -> list[tuple[int, Event]]:
    """Return the facts of the workflow in order of time. Units: microseconds of run time."""
    arrival_us = Stream(key, "start/1").within_us(world.start)
    facts: list[tuple[int, Event]] = [
        (arrival_us, arrived(world, task, 1, ordinal, arrival_us))
        for ordinal, task in enumerate(workflow.tasks, start=1)
    ]
    facts += [
        (arrival_us + WEAR_AFTER_US, ActuatorDegraded(robot_named(wear.robot, 1), wear.grade)) for wear in workflow.wear
    ]
    return facts


def arrived(world: WorldConstants, task: Task, team: int, ordinal: int, arrival_us: int) -> TaskArrived:
    """Return the arrival of a team's task, with a budget for its steps."""
    own = len(task.steps) - task.delegated
    budget_s = world.budget_base_s + world.budget_delegated_s * task.delegated + world.budget_own_s * own
    budget_us = round(min(budget_s * 1e6, FOREVER_US))
    return TaskArrived(
        task_id=f"{task.owner}{team}-{ordinal}",
        robot=robot_named(task.owner, team),
        team=team,
        steps=task.steps,
        budget_us=budget_us,
        due_us=arrival_us + budget_us,
        checkpoints=task.checkpoints,
        is_time_critical=task.is_time_critical,
    )
