"""Measures what a larger fleet costs: founding it, simulating it, and the maps of its state; prints ratios.

python benchmarks/growth.py           founding and one run under each architecture, 4 to 1,024 robots
python benchmarks/growth.py --maps    also persistent maps, where installed: pyrsistent, immutables
"""

import argparse
import sys
import timeit
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from fsar_ledger.designs.constants import Constants, Load
from fsar_ledger.events.configuration import PAPER_ARCHITECTURES
from fsar_ledger.projections.fold import fold
from fsar_ledger.runtime.simulation import RunSpec, simulate_run
from fsar_ledger.runtime.world import founding

SIZES = (4, 16, 64, 256, 1024)
SHELVES = 32


class Shelves:
    """The hand-written alternative to a persistent map: several dictionaries, of which a change copies one."""

    __slots__ = ("parts",)

    def __init__(self, parts: tuple[dict[str, int], ...] = ({},) * SHELVES) -> None:
        self.parts = parts

    def set(self, key: str, value: int) -> "Shelves":
        place = hash(key) % SHELVES
        return Shelves((*self.parts[:place], {**self.parts[place], key: value}, *self.parts[place + 1 :]))

    def get(self, key: str) -> int | None:
        return self.parts[hash(key) % SHELVES].get(key)


def best_s(work: Callable[[], object], repeats: int = 3) -> float:
    """Return the best of several times. Units: seconds."""
    return min(timeit.repeat(work, number=1, repeat=repeats))


def print_founding() -> None:
    """Print the seconds to found a fleet and fold its state, and the cost of a robot against a fleet of four."""
    of_four = best_s(lambda: fold(founding(4)), 50) / 4
    for size in SIZES:
        taken_s = best_s(lambda size=size: fold(founding(size)))  # type: ignore[misc]
        events, cost = len(founding(size)), taken_s / size / of_four
        print(
            f"founding {size:5} robots: {events:5} events in {taken_s:.3f} s, for each robot {cost:.1f} times that of 4"
        )


def print_runs() -> None:
    """Print the seconds of one run with up to four working teams, and the cost of an event against a fleet of four."""
    for architecture in PAPER_ARCHITECTURES:
        of_four = 0.0
        for size in (4, 64, 1024):
            spec, constants = (
                RunSpec(42, architecture, "full", "fleet-contention", size, 0),
                Constants(load=Load(min(4, size // 4))),
            )
            events = len(simulate_run(spec, constants).events)
            each_s = best_s(lambda spec=spec, constants=constants: simulate_run(spec, constants)) / events  # type: ignore[misc]
            of_four = of_four or each_s
            print(
                f"{architecture:4} {size:5} robots: {events:6} events in {each_s * events:.2f} s, "
                f"for each event {each_s / of_four:.1f} times that of 4"
            )


# See docs/decisions/large-mappings-share-one-dict.md.
def print_maps() -> None:
    """Print the times of one change and one look-up, against a dictionary that is copied."""
    kinds: dict[str, Callable[[dict[str, int]], Any]] = {"shelves cut by hand (0.7.0)": lambda _: Shelves()}
    for module, name in (("pyrsistent", "pmap"), ("immutables", "Map")):
        try:
            kinds[module] = getattr(import_module(module), name)
        except ImportError:
            print(f"{module} is not installed")
    for size in SIZES:
        known = {f"robot/A{number}": number for number in range(size)}
        key = f"robot/A{size // 2}"
        copied_s = best_s(lambda known=known, key=key: [{**known, key: 0} for _ in range(1000)])  # type: ignore[misc]
        found_s = best_s(lambda known=known, key=key: [known.get(key) for _ in range(1000)])  # type: ignore[misc]
        for kind, make in kinds.items():
            one = make(known)
            if kind not in ("pyrsistent", "immutables"):
                for name, number in known.items():
                    one = one.set(name, number)
            set_s = best_s(lambda one=one, key=key: [one.set(key, 0) for _ in range(1000)])  # type: ignore[misc]
            get_s = best_s(lambda one=one, key=key: [one.get(key) for _ in range(1000)])  # type: ignore[misc]
            print(
                f"{size:5} entries, {kind:16}: a change takes {set_s / copied_s:5.2f} of a copied dictionary's, "
                f"a look-up {get_s / found_s:5.2f}"
            )


def main() -> None:
    """Print the measurements."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--maps", action="store_true")
    asked = parser.parse_args()
    print_founding()
    print_runs()
    if asked.maps:
        print_maps()


if __name__ == "__main__":
    main()
