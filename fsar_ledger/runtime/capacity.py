"""How many events a run may make, found out before it is made: a commit holds a batch of whole runs, and no more than `ledger.bounds` allow.

The numbers are upper bounds of what runs were seen to make, 4 to 1,024 robots, every scenario, architecture and configuration; a test compares
them with runs. They only decide what is refused before work begins: what is too much all the same is refused when the batch is staged.
"""

from collections.abc import Iterable
from typing import NamedTuple

from fsar_ledger.constants import Constants
from fsar_ledger.events.configuration import Configuration, lacks
from fsar_ledger.events.envelope import Architecture, Scenario, Workflow
from fsar_ledger.ledger.rows.bounds import MAX_LIST_VALUES, MAX_ROWS

from .world.scenarios import TASKS
from .world.schedule import arrivals_expected, teams_working
from .world.workflows import WORKFLOWS

Cell = tuple[Scenario | Workflow, Architecture, Configuration]

FACTS_PER_ARRIVAL = 1.45  # windows and obstructions end, too
FOUNDING_PER_ROBOT = 7  # one joins, with three capabilities that are installed and advertised


class Growth(NamedTuple):
    """What an architecture adds to the world's facts, in events and in elements of their lists.

    For each robot; for each set of tasks of a team; and for each delegated step in these and each team whose robot may be a candidate for it.
    """

    of_robot: float
    of_team: float
    of_candidate: float
    list_of_robot: float
    list_of_team: float
    list_of_candidate: float


GROWTH: dict[Architecture, Growth] = {
    "fsar": Growth(5, 350, 0, 3, 180, 2.0),  # the registry names every candidate in its answer
    "cfc": Growth(
        6, 350, 0, 12, 190, 0
    ),  # every candidate is matched, but the more there are, the fewer steps the coordinator comes to
    "dhma": Growth(
        17, 670, 10.2, 3, 450, 5.2
    ),  # every candidate bids, which takes three agents and a record of each word between them
}
POLLING_PER_ROBOT = 45  # without a registry each meeting is remembered


class Expected(NamedTuple):
    """At most so many, as far as one can tell."""

    events: float
    list_values: float


def expected(cell: Cell, fleet_size: int, constants: Constants) -> Expected:
    """What one run of the cell makes with such a fleet. A workflow is of four robots, and small."""
    scenario, architecture, configuration = cell
    if scenario in WORKFLOWS:
        return Expected(1_000, 10_000)
    growth, teams = GROWTH[architecture], fleet_size // 4
    load = constants.load
    sets = teams_working(fleet_size, load) * (1 if load is None else load.task_sets)
    delegated = sum(step.count(" ") == 2 for script in TASKS[scenario] for step in script.steps)  # type: ignore[index]
    asked = sets * delegated * teams
    polling = POLLING_PER_ROBOT if "shared-registry" in lacks(configuration) else 0
    facts = FACTS_PER_ARRIVAL * arrivals_expected(constants.world, fleet_size, constants.outages, load)
    return Expected(
        facts
        + (FOUNDING_PER_ROBOT + growth.of_robot + polling) * fleet_size
        + growth.of_team * sets
        + growth.of_candidate * asked,
        growth.list_of_robot * fleet_size + growth.list_of_team * sets + growth.list_of_candidate * asked,
    )


def fits(scenarios: Iterable[tuple[Cell, ...]], runs_at_once: int, fleet_size: int, constants: Constants) -> bool:
    """True when a commit holds so many runs in a row of each of these scenarios, whose cells take turns."""
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
    """The largest fleet of which a commit holds so many runs in a row; 0 if there is none."""
    cells = tuple(scenarios)
    low, high = 0, MAX_ROWS // FOUNDING_PER_ROBOT // 4 + 1  # teams
    while high - low > 1:
        middle = (low + high) // 2
        if fits(cells, runs_at_once, 4 * middle, constants):
            low = middle
        else:
            high = middle
    return 4 * low
