"""Count how often `verify` and the independent verifier agree: `python -m tests.ledger.agreement_soak [N]`
judges N ledgers (1,000), good and damaged."""

import random
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from tests.ledger import agreement_chain
from tests.ledger.agreement import KEY, Case, Outcome, judged
from tests.ledger.agreement_chain_damage import DAMAGED, GOOD
from tests.ledger.agreement_segments import FORGED


def drawn(folder: Path, count: int, shapes: int) -> Iterator[Case]:
    """Yield this many ledgers, the same each time; a third is of a random history of its own.

    Each is removed when the next is asked for.
    """
    written = agreement_chain.bases(folder / "bases", shapes)
    beside, path = folder / "beside", folder / "ledger"
    number = seed = 0
    while number < count:
        draw = random.Random(seed)
        seed += 1
        make = draw.choice(draw.choices((GOOD, DAMAGED, FORGED), (4, 5, 2))[0])
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


def outcomes(count: int, shapes: int = 12) -> list[Outcome]:
    """Return the verdicts of both verifiers on this many ledgers, of so many histories and others."""
    with tempfile.TemporaryDirectory() as folder:
        return [judged(case) for case in drawn(Path(folder), count, shapes)]


def main(arguments: list[str]) -> int:
    """Print the counts; return 1 if the two differ from each other or from what was expected."""
    found = outcomes(int(arguments[0]) if arguments else 1000)
    differences = [outcome.difference for outcome in found if outcome.difference]
    good = sum(outcome.is_good for outcome in found)
    stricter = sum(outcome.is_stricter for outcome in found)
    agreed = len(found) - len(differences) - stricter
    print(
        f"ledgers {len(found)}, good {good}, damaged {len(found) - good}: agree {agreed}, disagree {len(differences)}, "
        f"verify alone stricter {stricter}"
    )
    for difference in differences:
        print(f"  {difference}")
    return 1 if differences else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
