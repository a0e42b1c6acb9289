"""Count how often `verify` and the independent verifier agree: `python -m tests.ledger.agreement_soak [N [FORMAT]]`
judges N ledgers (1,000), good and damaged, of each format."""

import random
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from tests.ledger import agreement_chain
from tests.ledger.agreement import KEY, Case, Outcome, bases, judged, odd_run, write
from tests.ledger.agreement_chain_damage import CHAIN_DAMAGED, CHAIN_GOOD
from tests.ledger.agreement_damage import DAMAGED
from tests.ledger.agreement_good import GOOD, as_it_is
from tests.ledger.agreement_structure import STRUCTURES


def drawn(folder: Path, count: int, *, is_large: bool) -> Iterator[Case]:
    """Yield this many ledgers, the same each time. Each is removed when the next is asked for."""
    shapes = bases(folder / "bases", is_large)
    large = shapes.pop() if is_large else None
    beside, path = folder / "beside", folder / "ledger"
    number = seed = 0
    while number < count:
        draw = random.Random(seed)
        seed += 1
        makes = draw.choices((GOOD, DAMAGED, STRUCTURES), (3, 5, 2))[0]
        make = makes[seed % len(makes)]
        beside.mkdir()
        if make is as_it_is:
            odd(path, draw)
        else:
            shutil.copytree(large if large and seed % 100 == 0 else draw.choice(shapes), path)
        case = make(path, draw, beside)
        if case is not None:
            number += 1
            yield case._replace(name=f"{case.name} (seed {seed - 1})")
        shutil.rmtree(path)
        shutil.rmtree(beside)


def drawn_of_chain(folder: Path, count: int, shapes: int) -> Iterator[Case]:
    """Yield this many ledgers of format 2, as `drawn`. A third is of a random history of its own."""
    written = agreement_chain.bases(folder / "bases", shapes)
    beside, path = folder / "beside", folder / "ledger"
    number = seed = 0
    while number < count:
        draw = random.Random(seed)
        seed += 1
        make = draw.choice(draw.choices((CHAIN_GOOD, CHAIN_DAMAGED), (4, 6))[0])
        beside.mkdir()
        if seed % 3:
            shutil.copytree(draw.choice(written), path)
        else:
            agreement_chain.History(path, draw, [KEY, None]).go_on(draw.randrange(1, 4))
        case = make(path, draw, beside)
        if case is not None:
            number += 1
            yield case._replace(name=f"{case.name} (seed {seed - 1})")
        shutil.rmtree(path)
        shutil.rmtree(beside)


def odd(path: Path, draw: random.Random) -> None:
    """Write a ledger of some commits of events whose strings are hard to write."""
    batches = [
        [odd_run(f"\u2028{commit}/{at}", draw.randrange(1, 9), draw) for at in range(draw.randrange(1, 3))]
        for commit in range(draw.randrange(1, 4))
    ]
    write(path, batches, [None] * len(batches))


def outcomes(count: int, *, is_large: bool) -> list[Outcome]:
    """Return the verdicts of both verifiers on this many ledgers."""
    with tempfile.TemporaryDirectory() as folder:
        return [judged(case) for case in drawn(Path(folder), count, is_large=is_large)]


def chain_outcomes(count: int, shapes: int = 12) -> list[Outcome]:
    """Return the verdicts of both verifiers on this many ledgers of format 2, of so many histories and others."""
    with tempfile.TemporaryDirectory() as folder:
        return [judged(case) for case in drawn_of_chain(Path(folder), count, shapes)]


def main(arguments: list[str]) -> int:
    """Print the counts; return 1 if the two differ from each other or from what was expected."""
    count, formats = [*arguments, *("1000", "12")[len(arguments) :]]
    is_agreed = True
    for version in formats:
        found = outcomes(int(count), is_large=True) if version == "1" else chain_outcomes(int(count))
        differences = [outcome.difference for outcome in found if outcome.difference]
        good = sum(outcome.is_good for outcome in found)
        stricter = sum(outcome.is_stricter for outcome in found)
        agreed = len(found) - len(differences) - stricter
        print(
            f"format {version}: ledgers {len(found)}, good {good}, damaged {len(found) - good}: agree {agreed}, "
            f"disagree {len(differences)}, verify alone stricter {stricter}",
            flush=True,
        )
        for difference in differences:
            print(f"  {difference}")
        is_agreed = is_agreed and not differences
    return 0 if is_agreed else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
