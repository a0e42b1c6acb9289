"""Readers beside writers that are killed and refused: `python -m tests.ledger.readers_beside_soak [KILLS [REFUSALS]]`.

Four to eight writers add, append, seal and compact at once. In turns, they are killed at random moments, and the disk
refuses each of them something now and then. Two readers open the ledger all the time. Each must see whole commits, all
that was acknowledged before it looked, each once, and for ever what it has seen once; and no reader may be told of
damage. Prints counts; exits with 1 if anything was wrong.
"""

import random
import shutil
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

from fsar_ledger.ledger.opening import open_for_answers
from tests.ledger.crash_writer import Nursery, Order
from tests.ledger.crowd import NAMES, judge

ROUNDS, STEPS, REFUSALS = 8, 3, 4
"""How often the writers of one ledger begin, how many steps further each time, and what the disk refuses each."""


class Tally(NamedTuple):
    """What was tried, and what was wrong."""

    kills: int = 0
    refusals: int = 0
    acknowledged: int = 0
    seen: int = 0
    wrong: tuple[str, ...] = ()

    def plus(self, other: "Tally") -> "Tally":
        return Tally(
            self.kills + other.kills,
            self.refusals + other.refusals,
            self.acknowledged + other.acknowledged,
            self.seen + other.seen,
            self.wrong + other.wrong,
        )


def trial(nursery: Nursery, path: Path, draw: random.Random, rounds: int = ROUNDS) -> Tally:
    """Let writers of one ledger be killed and refused in some rounds, and then finish; judge what readers saw."""
    tally = Tally()
    writers = NAMES[: draw.randrange(4, 9)]
    known = dict.fromkeys(writers, 0)
    seen: set[str] = set()
    for again in range(1, rounds + 2):
        refusals = REFUSALS if again % 4 == 2 else 0
        moments = tuple(draw.randrange(1, 250_000) for _ in writers) if again <= rounds and not refusals else ()
        order = Order(str(path), writers, again * STEPS, 2, moments, refusals=refusals)
        outcome = nursery(order)
        known = {name: max(count, outcome.acknowledged.get(name, 0)) for name, count in known.items()}
        seen |= set(outcome.seen)
        tally = tally.plus(Tally(outcome.killed, outcome.refused, 0, 0, (*outcome.wrong, *judge(path, known))))
    held = {f"{commit.tree_size} {commit.tree_root}" for commit in open_for_answers(path).commits}
    gone = seen - held - {f"0 {'e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855'}"}
    wrong = (f"{len(gone)} heads that readers saw are not in the ledger",) if gone else ()
    missing = tuple(f"{name} finished {count} steps" for name, count in known.items() if count != (rounds + 1) * STEPS)
    return tally.plus(Tally(0, 0, sum(known.values()), len(seen), (*wrong, *missing)))


def main(kills: int = 500, refusals: int = 500) -> int:
    """Return the exit code: 0 if nothing was wrong in trials with so many kills and refusals."""
    draw, tally, ledgers, start = random.Random(17), Tally(), 0, time.monotonic()
    with tempfile.TemporaryDirectory() as folder, Nursery() as nursery:
        while tally.kills < kills or tally.refusals < refusals:
            path = Path(folder) / f"ledger-{ledgers}"
            found = trial(nursery, path, draw)
            tally, ledgers = tally.plus(found), ledgers + 1
            for wrong in found.wrong[:5]:
                print(f"{path.name}: {wrong}", flush=True)
            shutil.rmtree(path)
            print(
                f"{time.monotonic() - start:6.0f} s  {ledgers} ledgers: {tally.kills} writers killed, {tally.refusals} "
                f"refusals, {tally.acknowledged} commits acknowledged, {tally.seen} heads seen, {len(tally.wrong)} "
                "complaints",
                flush=True,
            )
    return 1 if tally.wrong else 0


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))
