"""Claims and conflicts: half-open, one conflict per action and dimension."""

import pytest

from tests.queries.histories import Row, S, answer, event, measured, run


def claim(claimant: str, time_s: int, dimension: str = "override", action_id: str = "t1/1") -> Row:
    return event("AuthorityClaimed", time_s * S, claimant=claimant, dimension=dimension, action_id=action_id)


def release(claimant: str, time_s: int, dimension: str = "override", action_id: str = "t1/1") -> Row:
    return event("AuthorityReleased", time_s * S, claimant=claimant, dimension=dimension, action_id=action_id)


def departed(robot: str, time_s: int) -> Row:
    return event("RobotDeparted", time_s * S, robot=robot, reason="announced", fence=1)


def claims(*events: Row) -> list[tuple[str, int, int | None]]:
    rows = answer("facts/claims", run(*events), columns=("seq", "claimant", "began_us", "ended_us"))
    return [(claimant, began // S, ended and ended // S) for _, claimant, began, ended in rows]


def conflicts(*events: Row) -> int:
    return measured("authority_conflicts", *events)[0]


ENDS: dict[str, tuple[tuple[Row, ...], list[tuple[str, int, int | None]]]] = {
    "at the first later release by its claimant": (
        (claim("a", 1), release("b", 2), release("a", 3), release("a", 4)),
        [("a", 1, 3)],
    ),
    "at no earlier release and none of another dimension or action": (
        (release("a", 1), claim("a", 1), release("a", 2, dimension="audit"), release("a", 3, action_id="t1/2")),
        [("a", 1, None)],
    ),
    "a second time, if it is made again after its release": (
        (claim("a", 1), release("a", 2), claim("a", 3), release("a", 4)),
        [("a", 1, 2), ("a", 3, 4)],
    ),
    "when its claimant leaves the fleet, whoever else left before": (
        (departed("a", 1), claim("a", 2), departed("b", 3), departed("a", 4), release("a", 5), claim("a", 6)),
        [("a", 2, 4), ("a", 6, None)],
    ),
}
OTHER = (
    claim("a", 1, "execution"),
    claim("b", 2, "execution"),
    claim("a", 1, action_id="t1/2"),
    claim("b", 2, action_id="t1/2"),
)
THREE = (claim("a", 1), claim("b", 2), claim("c", 3), release("a", 4), claim("a", 5), release("b", 6), release("c", 7))
CONFLICTS: dict[str, tuple[tuple[Row, ...], int]] = {
    "two principals' overlapping claims": ((claim("a", 1), claim("b", 2), release("a", 3), release("b", 4)), 1),
    "claims that touch": ((claim("a", 1), release("a", 2), claim("b", 2), release("b", 3)), 0),
    "claims that touch, of the other first": ((claim("b", 1), release("b", 2), claim("a", 2), release("a", 3)), 0),
    "logged before the release that it touches": ((claim("a", 1), claim("b", 2), release("a", 2), release("b", 3)), 0),
    "a claim that was never released and a later one": ((claim("a", 1), claim("b", 900)), 1),
    "a claim of no duration was never held": ((claim("a", 1), claim("b", 2), release("b", 2), release("a", 3)), 0),
    "the claim of one that had left the fleet": ((claim("a", 1), departed("a", 2), claim("b", 3)), 0),
    "two claims of one principal": ((claim("a", 1), claim("a", 2), release("a", 3)), 0),
    "three principals and many pairs are one": (THREE, 1),
    "dimensions and actions apart": ((claim("a", 1), claim("b", 2), *OTHER), 3),
    "one in each dimension": ((claim("a", 1, "execution"), claim("b", 2, "override"), claim("c", 2, "audit")), 0),
    "one about each action": ((claim("a", 1), claim("b", 2, action_id="t1/2")), 0),
}


@pytest.mark.parametrize("where", ENDS)
def test_a_claim_ends(where: str) -> None:
    events, expected = ENDS[where]
    assert claims(*events) == expected


@pytest.mark.parametrize("name", CONFLICTS)
def test_claims_of_two_principals_that_overlap_are_one_conflict_for_each_action_and_dimension(name: str) -> None:
    events, count = CONFLICTS[name]
    assert conflicts(*events) == count


def test_claims_of_two_runs_do_not_conflict() -> None:
    assert answer("facts/conflicts", run(claim("a", 1)), run(claim("b", 1), run_id="r2")) == []


def test_a_conflict_begins_when_the_first_overlap_begins() -> None:
    rows = answer(
        "facts/conflicts",
        run(claim("a", 1), claim("b", 7), claim("c", 5)),
        columns=("action_id", "dimension", "began_us"),
    )
    assert rows == [("t1/1", "override", 5 * S)]
