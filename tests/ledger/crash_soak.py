"""Try everything of which test_crash.py tries a part: `python -m tests.ledger.crash_soak [KILLS [PAIRS]]`.

Tries every kind of fault at every call of appends, the journal, sealing and compaction, each followed by power
failures; a fault at every call of the recovery from each state that a kill leaves; pairs of faults, the second during
the recovery from the first; processes killed at every call; KILLS processes (2,000) killed at random moments, two to
eight at a time on one ledger. Prints counts after each part, and the first complaints as they come; exits with 1 if
anything was lost or torn.
"""

import random
import shutil
import sys
import tempfile
import time
from pathlib import Path

from tests.ledger.agreement import Case, judged
from tests.ledger.crash_trials import Laboratory, Tally
from tests.ledger.crash_writer import Nursery, Order
from tests.ledger.crowd import NAMES, judge
from tests.ledger.faults import WRITES, Fault, FaultyOs, calls_of, faults_at
from tests.ledger.power import choices

ROUNDS = 6
"""How often the writers of one ledger are killed before a new ledger is begun."""
MAX_COMPLAINTS = 20
STEPS_A_ROUND = 3
DEFAULTS = ("2000", "2000")


def single_faults(laboratory: Laboratory, calls: list[str]) -> None:
    """Try every kind of fault at every call, with nine ways for the power to fail after it and after the recovery."""
    for number, fault in enumerate(faults_at(calls)):
        laboratory.trial([fault], choices(number, 2))


def faults_in_recovery(laboratory: Laboratory, calls: list[str]) -> None:
    """Kill at every call and, from each state that this leaves, let each call of the recovery fail in turn."""
    kinds = ("killed", "io-error", "killed-in-write", "disk-full", "io-error-after", "short-write-no-space")
    for at, name in enumerate(calls):
        for kind in ("killed", "killed-in-write")[: 1 + (name in WRITES)]:
            laboratory.trials_of_recovery(Fault(at, kind), kinds)


def pairs_of_faults(laboratory: Laboratory, calls: list[str], pairs: int) -> None:
    """Try pairs of any fault and any other during the recovery, half of them with a power failure in between."""
    draw = random.Random(11)
    faults = list(faults_at(calls))
    for number in range(pairs):
        first, second = draw.choice(faults), draw.choice(faults)
        if number % 2:
            laboratory.trial([first, Fault(draw.randrange(first.at + 30), second.kind)], choices(number, 1)[-2:])
        else:
            laboratory.trial_after_power_failure(
                first, draw.choice(choices(number, 3)), Fault(second.at // 2, second.kind)
            )


def kills_at_calls(laboratory: Laboratory, nursery: Nursery, calls: list[str]) -> None:
    """Kill a process at every call, and in the middle of every write."""
    kills = [Fault(at, "killed") for at in range(len(calls))] + [
        Fault(at, "killed-in-write") for at, name in enumerate(calls) if name in WRITES
    ]
    for fault in kills:
        root = laboratory.folder / f"{fault.kind}-{fault.at}"
        path = root / "out" / "ledger"
        root.mkdir()
        outcome = nursery(Order(str(path), fault_at=fault.at, fault_kind=fault.kind))
        laboratory.tally.kills += outcome.killed
        for complaint in outcome.wrong:
            laboratory.tally.note(complaint, fault)
        laboratory.finish(path, laboratory.judge(path, outcome.acknowledged.get("trial", 0), fault), fault)
        shutil.rmtree(root)


def kills_at_moments(folder: Path, tally: Tally, nursery: Nursery, kills: int, seed: int = 13) -> int:
    """Kill this many processes at random moments while they open, recover and append.

    Returns how many steps were acknowledged. Both verifiers judge what is there when nobody is killed any more.
    """
    draw = random.Random(seed)
    acknowledged = ledgers = 0
    until = tally.kills + kills
    while tally.kills < until:
        path = folder / f"crowd-{ledgers}"
        ledgers += 1
        writers = NAMES[: draw.randrange(2, 9)]
        known = dict.fromkeys(writers, 0)
        for again in range(1, ROUNDS + 1):
            moments = tuple(draw.randrange(1, 60_000 + 25_000 * len(writers)) for _ in writers)
            readers = int(again == ROUNDS)
            outcome = nursery(Order(str(path), writers, again * STEPS_A_ROUND, readers, moments))
            known = {name: max(count, outcome.acknowledged.get(name, 0)) for name, count in known.items()}
            tally.kills += outcome.killed
            for complaint in (*outcome.wrong, *judge(path, known)):
                tally.note(complaint, (path.name, again))
        # Nobody is killed, so that everything begun is finished.
        outcome = nursery(Order(str(path), writers, ROUNDS * STEPS_A_ROUND))
        difference = judged(Case("the end", path, True)).difference
        everything = dict.fromkeys(writers, ROUNDS * STEPS_A_ROUND)
        for complaint in (*outcome.wrong, *judge(path, everything), *filter(None, [difference])):
            tally.note(complaint, (path.name, "the end"))
        acknowledged += ROUNDS * STEPS_A_ROUND * len(writers)
        shutil.rmtree(path)
    return acknowledged


def soak(folder: Path, kills: int, pairs: int) -> Tally:
    """Run all parts, and print a line on each."""
    start = time.monotonic()

    def tell(text: str) -> None:
        print(f"{time.monotonic() - start:6.0f} s  {text}", flush=True)

    def tell_complaint(complaint: str) -> None:
        if len(tally.complaints) <= MAX_COMPLAINTS:
            tell(complaint)

    def say(text: str) -> None:
        tell(f"{text}; lost {tally.lost}, torn {tally.torn}, complaints in all {len(tally.complaints)}")

    folder.mkdir()
    laboratory = Laboratory(folder)
    tally, root = laboratory.tally, folder / "calls"
    tally.tells = tell_complaint
    root.mkdir()
    calls = calls_of(root, lambda: laboratory.append(FaultyOs(root), root / "out" / "ledger"))
    single_faults(laboratory, calls)
    say(f"{len(calls)} calls: {tally.faults:,} faults, {tally.power_failures:,} power failures after them")
    faults_in_recovery(laboratory, calls)
    say(f"every call of the recovery: {tally.faults_in_recovery:,} faults")
    pairs_of_faults(laboratory, calls, pairs)
    say(
        f"{pairs:,} pairs of faults: {tally.faults_in_recovery:,} during the recovery, "
        f"{tally.power_failures:,} power failures in all"
    )
    with Nursery() as nursery:
        kills_at_calls(laboratory, nursery, calls)
        say(f"{tally.kills:,} processes killed, one at each call")
        acknowledged = kills_at_moments(folder, tally, nursery, kills)
        say(
            f"{tally.kills:,} processes killed, with those at random moments; {acknowledged:,} steps "
            "acknowledged beside them"
        )
    return tally


def main(arguments: list[str]) -> int:
    """Print the counts. Return 0 if nothing was lost or torn, else 1."""
    kills, pairs = [*arguments, *DEFAULTS[len(arguments) :]]
    with tempfile.TemporaryDirectory() as folder:
        tally = soak(Path(folder) / "soak", int(kills), int(pairs))
    print(
        f"injected faults {tally.faults:,}, during recovery {tally.faults_in_recovery:,}, power failures "
        f"{tally.power_failures:,}, SIGKILLs {tally.kills:,}\n"
        f"acknowledged events lost: {tally.lost}, torn: {tally.torn}, other complaints: "
        f"{len(tally.complaints) - tally.lost - tally.torn}",
        flush=True,
    )
    return 0 if tally.is_clean else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
