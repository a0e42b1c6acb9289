"""Conflicts are found in one sweep: the same as by comparing every pair, and without the time that takes."""

import random
import time
from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import pyarrow as pa

from fsar_ledger.metrics.database import from_table
from tests.queries.histories import Row, S, answer, event, run

FOREVER = 1 << 60


class Held(NamedTuple):
    """One claim: from which second to which, half-open; FOREVER where it is never released."""

    claimant: str
    began: int
    ended: int


def events_of(claims: Sequence[Held], action: str) -> list[tuple[int, Row]]:
    """Claims and releases with their times; each claim has a reason of its own, so that its release ends no other."""
    found: list[tuple[int, Row]] = []
    for number, held in enumerate(claims):
        fields = {
            "claimant": held.claimant,
            "action_id": action,
            "dimension": "override",
            "reason": f"{action} {number}",
        }
        found.append((held.began, event("AuthorityClaimed", held.began * S, **fields)))
        if held.ended < FOREVER:
            found.append((held.ended, event("AuthorityReleased", held.ended * S, **fields)))
    return found


def first_overlap(claims: Sequence[Held]) -> int | None:
    """When two principals first hold at once, by comparing every pair of claims that last."""
    pairs = combinations([held for held in claims if held.ended > held.began], 2)
    overlaps = [
        (max(one.began, other.began), min(one.ended, other.ended))
        for one, other in pairs
        if one.claimant != other.claimant
    ]
    return min((began for began, ended in overlaps if began < ended), default=None)


def test_the_sweep_finds_what_comparing_every_pair_finds() -> None:
    draw = random.Random(10)
    actions = {}
    for number in range(400):
        claimants = "abcd"[: draw.randint(1, 4)]
        claims = [
            Held(
                draw.choice(claimants),
                (began := draw.randint(0, 12)),
                draw.choice([FOREVER, *[began + draw.randint(0, 5)] * 5]),
            )
            for _ in range(draw.randint(1, 7))
        ]
        actions[f"a{number}"] = claims
    timed = [one for action, claims in actions.items() for one in events_of(claims, action)]
    draw.shuffle(timed)
    history = [row for _, row in sorted(timed, key=lambda one: one[0] + (one[1]["type"] == "AuthorityReleased.v1") / 2)]
    found = dict(answer("facts/conflicts", run(*history), columns=("action_id", "began_us")))
    expected = {action: first_overlap(claims) for action, claims in actions.items()}
    assert found == {action: overlap * S for action, overlap in expected.items() if overlap is not None}
    assert 100 < len(found) < 350


def test_ten_times_the_open_claims_take_no_hundred_times_as_long() -> None:
    assert taken(100_000) < 30 * taken(10_000)


def taken(claims: int) -> float:
    """Return the CPU seconds for one action on which so many principals hold open claims."""
    names = {
        "run_id": ["r"] * claims,
        "action_id": ["a"] * claims,
        "dimension": ["override"] * claims,
        "type": ["AuthorityClaimed.v1"] * claims,
    }
    numbers = list(range(claims))
    table = pa.table(
        {**names, "seq": numbers, "time_us": numbers, "claimant": [f"robot/{number}" for number in numbers]}
    )
    with from_table(table, threads=1) as database:
        began = time.process_time()
        assert database.rows("SELECT began_us FROM conflicts") == [{"began_us": 1}]
        return time.process_time() - began
