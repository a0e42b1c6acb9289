"""Estimates how many events a run will make, before it is simulated.

A commit holds a batch of whole runs, within the limits of `ledger.rows.bounds`. The estimates are upper bounds of what
runs were observed to make with 4 to 1,024 robots, in every scenario, architecture and configuration; a test compares
them with runs. They only decide what is refused before work begins; a batch that is too large nevertheless is refused
when it is staged.
"""

from collections.abc import Iterable
from functools import lru_cache
from importlib import import_module
from math import ceil
from typing import NamedTuple

from fsar_ledger.constants import Constants
from fsar_ledger.designs import Fleet, Workflow, registered
from fsar_ledger.events.configuration import Configuration, removed_mechanisms
from fsar_ledger.ledger.rows.bounds import MAX_LIST_VALUES, MAX_ROWS

from .architectures.handler_table import Growth
from .world.founding import team_size
from .world.schedule import arrivals_expected, happening, teams_working

Cell = tuple[str, str, Configuration]  # scenario (or workflow), architecture, configuration

FACTS_PER_ARRIVAL = 1.45  # windows and obstructions also end
USUAL_STEPS = 8  # steps of one set of tasks, own and delegated, that `Growth.of_team` allows for
POLLING_PER_ROBOT = 45  # without a registry each encounter is remembered


class Expected(NamedTuple):
    """Estimated upper bounds of what a run makes."""

    events: float
    list_values: float


def expected(cell: Cell, fleet_size: int, constants: Constants) -> Expected:
    """Return the bounds of one run of the cell with this fleet; a workflow is small and has four robots."""
    name, architecture, configuration = cell
    scenario = happening(constants, name)
    if isinstance(scenario, Workflow):
        return Expected(1_000, 10_000)
    growth, of_team = growth_of(architecture), team_size(constants.fleet)
    load = constants.load
    sets = teams_working(constants, fleet_size) * (1 if load is None else load.task_sets)
    if constants.scenario is not None:  # `Growth` is measured on the paper's scenarios
        sets *= max(1, ceil(sum(len(task.steps) + task.delegated for task in scenario.tasks) / USUAL_STEPS))
    asked = sets * sum(task.delegated for task in scenario.tasks) * (fleet_size // of_team)
    polling = POLLING_PER_ROBOT if "shared-registry" in removed_mechanisms(configuration) else 0
    facts = FACTS_PER_ARRIVAL * arrivals_expected(constants, fleet_size)
    return Expected(
        facts
        + (_founding_of_robot(constants.fleet) + growth.of_robot + polling) * fleet_size
        + growth.of_team * sets
        + growth.of_candidate * asked,
        growth.list_of_robot * fleet_size + growth.list_of_team * sets + growth.list_of_candidate * asked,
    )


@lru_cache(maxsize=4)
def _founding_of_robot(fleet: Fleet | None) -> int:
    """Return the most events that found one robot: it joins, and each capability is installed and advertised."""
    return 1 + 2 * max(len(robot.capabilities) for robot in (fleet or registered.fleet()).robots)


def growth_of(architecture: str) -> Growth:
    """Return how many events a registered architecture adds to the world's facts."""
    found: Growth = import_module(f".architectures.{architecture}", __package__).GROWTH
    return found


def fits(scenarios: Iterable[tuple[Cell, ...]], runs_at_once: int, fleet_size: int, constants: Constants) -> bool:
    """Return whether one commit can hold this many consecutive runs of each scenario, whose cells take turns."""
    for cells in scenarios:
        rounds, rest = divmod(runs_at_once, len(cells))
        found = [expected(cell, fleet_size, constants) for cell in cells]
        for each, most in (
            ([one.events for one in found], MAX_ROWS),
            ([one.list_values for one in found], MAX_LIST_VALUES),
        ):
            if not rounds * sum(each) + sum(sorted(each, reverse=True)[:rest]) <= most:
                return False
    return True


def largest_fleet(scenarios: Iterable[tuple[Cell, ...]], runs_at_once: int, constants: Constants) -> int:
    """Return the size of the largest fleet of which a commit holds this many consecutive runs; 0 if there is none."""
    cells = tuple(scenarios)
    of_team = team_size(constants.fleet)
    low, high = 0, MAX_ROWS // of_team + 1  # teams
    while high - low > 1:
        middle = (low + high) // 2
        if fits(cells, runs_at_once, of_team * middle, constants):
            low = middle
        else:
            high = middle
    return of_team * low
