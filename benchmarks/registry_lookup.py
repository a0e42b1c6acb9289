"""Measures registry look-ups among 4 to 4,096 robots, against a scan of all records; prints ratios.

    python benchmarks/registry_lookup.py                  medians of 2,000 look-ups in each fleet
    python benchmarks/registry_lookup.py --lookups 200    a small run

Robots are in cells of four, four cells to a room, four rooms to a hall and so on. A near look-up finds what a robot of
the own cell offers; a far one what only the last robot of the fleet offers. Both sides must find the same robot.
"""

import argparse
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from fsar_ledger.designs.constants import Constants
from fsar_ledger.designs.registered import fleet
from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Robot, robot_named
from fsar_ledger.events.fleet import RobotJoined
from fsar_ledger.events.registry import AvailabilityChanged, CapabilityAdvertised, CapabilityInstalled
from fsar_ledger.events.trust import TrustSet
from fsar_ledger.projections import registry
from fsar_ledger.projections.fold import State, fold
from fsar_ledger.projections.registry import Advertisement
from fsar_ledger.runtime.handlers.attribution import nearest_first
from fsar_ledger.runtime.handlers.candidates import Query, candidates, rejecting_filter
from fsar_ledger.runtime.simulation import RunSpec, run_started

SIZES = (4, 16, 64, 256, 1024, 4096)
NEAR, FAR = "door.open.secure", "calibrate.sensor"


def cell(number: int, cells: int) -> str:
    """Return the domain of a cell: one digit of base four for each level of the hierarchy."""
    digits = []
    while cells > 1:
        digits.append(str(number % 4))
        number, cells = number // 4, cells // 4
    return "/".join(reversed(digits))


def founding(size: int) -> Iterator[Event]:
    yield run_started(RunSpec(1, "fsar", "full", "door-relay", size, 0), Constants())
    cells = size // 4
    last = robot_named("D", cells)
    for team in range(1, cells + 1):
        for one in fleet().robots:
            role, robot = one.kind, robot_named(one.name, team)
            yield RobotJoined(robot=robot, role=role, team=team, supervisor=None, domain=cell(team - 1, cells))
            for capability in (*one.capabilities, *((FAR,) if robot == last else ())):
                yield CapabilityInstalled(robot=robot, capability=capability, version="1.0.0")
                yield CapabilityAdvertised(robot=robot, capability=capability)
        yield TrustSet(robot=robot_named("B", team), peer=robot_named("A", team), scope="task")
        yield TrustSet(robot=last, peer=robot_named("A", team), scope="task")


# See docs/decisions/registry-is-a-tree.md.
def scanned(state: State, records: list[Advertisement], query: Query) -> str:
    """Scan every record of the fleet, as the alternative, and return the nearest admissible robot."""
    matching = [
        record for record in records if record.capability == query.capability and record.robot != query.requester
    ]
    admissible = [record.robot for record in matching if rejecting_filter(state, query, record) is None]
    return nearest_first(state.fleet, admissible, query.requester)[0]


def looked_up(state: State, query: Query) -> str:
    return candidates(state, query).candidates[0]


def median_us(work: Callable[[Query], str], queries: list[Query]) -> tuple[float, list[str]]:
    """Return the median time of one look-up in microseconds, and what the look-ups found."""
    spent, found = [], []
    for query in queries:
        began = time.perf_counter_ns()
        answer = work(query)
        spent.append(time.perf_counter_ns() - began)
        found.append(answer)
    return statistics.median(spent) / 1000, found


def median_update_us(state: State, robots: list[Robot]) -> float:
    spent = []
    for robot in robots:
        changed = AvailabilityChanged(robot=robot, capability=NEAR, availability="busy", reason="benchmark")
        began = time.perf_counter_ns()
        registry.evolve(state.registry, changed)
        spent.append(time.perf_counter_ns() - began)
    return statistics.median(spent) / 1000


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--lookups", type=int, default=2000)
    parser.add_argument("--scans", type=int, default=40, help="look-ups by scan, which take long in a large fleet")
    options = parser.parse_args()
    rows = []
    print("robots   near, us   far, us   update, us   scan, us")
    for size in SIZES:
        state = fold(founding(size))
        teams = [1 + number * 7919 % (size // 4) for number in range(options.lookups)]
        near, far = (
            [Query(Robot(f"robot/A{team}"), capability, "t", limit=1) for team in teams] for capability in (NEAR, FAR)
        )
        records = [record for robot in state.fleet.robots for record in registry.surface(state.registry, robot)]
        near_us, found = median_us(partial(looked_up, state), near)
        far_us, found_far = median_us(partial(looked_up, state), far)
        every = slice(None, None, max(1, 2 * options.lookups // options.scans))
        scan_us, expected = median_us(partial(scanned, state, records), [*near, *far][every])
        if expected != [*found, *found_far][every]:
            print(f"differs: {size} robots: look-up and scan find other robots", file=sys.stderr)
            return 1
        rows.append((near_us, far_us, median_update_us(state, [robot_named("B", team) for team in teams]), scan_us))
        print(f"{size:>6,} {near_us:>10.1f} {far_us:>9.1f} {rows[-1][2]:>12.1f} {scan_us:>10.1f}", flush=True)
    for name, column, goal in (
        ("near look-up", 0, "flat"),
        ("far look-up", 1, "logarithmic"),
        ("update", 2, "logarithmic"),
        ("scan", 3, "the alternative"),
    ):
        print(f"{name:<13} 4,096 robots / 4 robots {rows[-1][column] / rows[0][column]:>10.2f}   ({goal})")
    print(f"near look-up / scan, 4,096 robots   {rows[-1][0] / rows[-1][3]:>10.5f}")
    print(f"far look-up / scan, 4,096 robots    {rows[-1][1] / rows[-1][3]:>10.5f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
