"""How long a paired experiment takes: 500 runs of a ledger and their forks, beside the same without forks.

The change is that supervisors review more. With forks, each run is made again and compared with the ledger, its fork
is played, and both are judged, in memory. Without, the runs are simulated under the other constant into a ledger of
their own, which is then compared with the first. Give both one core: `taskset -c 0 python benchmarks/whatif.py`.
"""

import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from fsar_ledger import open_ledger
from fsar_ledger.analysis.whatif import effects, fork_pairs, runs_of
from fsar_ledger.designs.constants import Constants
from fsar_ledger.ledger.opening import open_for_answers
from fsar_ledger.runtime.change_texts import parsed
from fsar_ledger.runtime.experiment import Experiment, run_experiment
from fsar_ledger.runtime.own import with_values
from fsar_ledger.runtime.simulation import SCENARIOS

CHANGE = "world.review_share", 0.5
RUNS = 100
"""Of each of the five scenarios."""


def timed(name: str, work: Callable[[], object]) -> float:
    wall, cpu = time.perf_counter(), time.process_time()
    work()
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    print(f"{name}: {wall:.2f} s, {cpu:.2f} s of CPU")
    return wall


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        ledger, other = Path(folder) / "ledger", Path(folder) / "other"
        run_experiment(ledger, Experiment(("fsar",), SCENARIOS, RUNS, 42), 1)
        view = open_for_answers(ledger)
        runs = runs_of(view, ())
        changes = parsed([f"set {CHANGE[0]}={CHANGE[1]}"])

        def fork_and_judge() -> None:
            found, measured = effects(fork_pairs(view, runs, changes))
            assert len(found) == len(runs)
            assert measured

        def simulate_and_compare() -> None:
            constants = with_values(Constants(), dict([CHANGE]))
            run_experiment(other, Experiment(("fsar",), SCENARIOS, RUNS, 42, constants=constants), 1)
            assert open_ledger(other).compare(other=open_ledger(ledger)).rows

        forked = timed(f"forks of {len(runs)} runs, played and judged", fork_and_judge)
        beside = timed("the same simulated into a ledger, and compared with the first", simulate_and_compare)
        cores = len(os.sched_getaffinity(0))
        print(f"ratio {beside / forked:.2f}; {cores} cores, load {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
