"""Flip single bits in all files of a ledger and run every command that answers from it: `python -m
tests.ledger.flips_soak [COUNT]` (2,000).

A command must refuse to answer, or give the answer of the undamaged ledger. Prints counts by kind of file and by
command; exits with 1 if any answer is wrong.
"""

import os
import shutil
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from itertools import repeat
from multiprocessing import get_context
from pathlib import Path
from unittest.mock import patch

import typer

from tests.ledger.damage import kind_of
from tests.ledger.flips import KINDS, VERBS, Flip, chosen, outcomes, undamaged, write_runs

PARTS = 4
"""Each part is tried on its own copy of the ledger."""

OUTCOMES = ("refused", "same", "wrong")
Tally = Counter[tuple[str, str]]
"""How often a kind of file, or a command, had this outcome."""


def try_part(ledger: Path, flips: list[Flip]) -> tuple[Tally, list[str]]:
    """Return the outcomes of these flips, and each wrong answer."""
    tally: Tally = Counter()
    wrong: list[str] = []
    with tempfile.TemporaryDirectory(dir=ledger.parent) as folder:
        path, out = Path(shutil.copytree(ledger, Path(folder) / "ledger")), Path(folder) / "out"
        out.mkdir()
        good = undamaged(path, out)
        with patch.object(
            typer.main, "get_command", cache(typer.main.get_command)
        ):  # half the time of a refusal is to put the commands together
            for flip in flips:
                for verb, outcome in outcomes(path, out, flip, good).items():
                    tally.update([(kind_of(flip.name), outcome), (verb, outcome)])
                    wrong += [f"{verb}: {flip}"] if outcome == "wrong" else []
    return tally, wrong


def soak(count: int) -> bool:
    """Try this many flips, and print the counts; return whether no answer was wrong."""
    began = time.monotonic()
    tally: Tally = Counter()
    wrong: list[str] = []
    with tempfile.TemporaryDirectory() as folder:
        os.environ["XDG_CACHE_HOME"] = f"{folder}/cache"
        ledger = Path(folder) / "ledger"
        write_runs(ledger)
        flips = list(chosen(ledger, count, 1))
        parts = [flips[part::PARTS] for part in range(PARTS)]
        with ProcessPoolExecutor(os.cpu_count(), mp_context=get_context("spawn")) as pool:
            for counted, named in pool.map(try_part, repeat(ledger), parts):
                tally += counted
                wrong += named
                print(
                    f"{sum(tally[kind, outcome] for kind in KINDS for outcome in OUTCOMES):,} answers, "
                    f"{len(wrong):,} wrong",
                    flush=True,
                )
    for name in (*KINDS, *VERBS):
        print(f"{name:20}" + "".join(f"{tally[name, outcome]:9,} {outcome}" for outcome in OUTCOMES))
    print(*wrong, sep="\n", end="\n" if wrong else "")
    answers = sum(tally[verb, outcome] for verb in VERBS for outcome in OUTCOMES)
    print(
        f"{len(flips):,} flips, {answers:,} answers, {len(wrong):,} wrong, {time.monotonic() - began:.0f} s", flush=True
    )
    return not wrong and answers > 0


def main(arguments: list[str]) -> int:
    """Return 0 if no answer was wrong, else 1."""
    return 0 if soak(int(arguments[0]) if arguments else 2000) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
