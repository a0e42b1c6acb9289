"""Claims and conflicts: half-open, one conflict per action and dimension."""

from tests.queries.histories import Row, S, answer, event, measured, run


def claim(claimant: str, time_s: int, dimension: str = "override", action_id: str = "t1/1") -> Row:
    return event("AuthorityClaimed", time_s * S, claimant=claimant, dimension=dimension, action_id=action_id)


def release(claimant: str, time_s: int, dimension: str = "override", action_id: str = "t1/1") -> Row:
    return event("AuthorityReleased", time_s * S, claimant=claimant, dimension=dimension, action_id=action_id)


def claims(*events: Row) -> list[tuple[str, int, int | None]]:
    rows = answer("facts/claims", run(*events), columns=("seq", "claimant", "began_us", "ended_us"))
    return [(claimant, began // S, ended and ended // S) for _, claimant, began, ended in rows]


def conflicts(*events: Row) -> int:
    return measured("authority_conflicts", *events)[0]


def test_a_claim_ends_at_the_first_later_release_by_its_claimant() -> None:
    assert claims(claim("a", 1), release("b", 2), release("a", 3), release("a", 4)) == [("a", 1, 3)]


def test_a_claim_is_not_ended_by_an_earlier_release_or_one_of_another_dimension_or_action() -> None:
    assert claims(
        release("a", 1), claim("a", 1), release("a", 2, dimension="audit"), release("a", 3, action_id="t1/2")
    ) == [("a", 1, None)]


def test_a_second_claim_after_a_release_has_its_own_end() -> None:
    assert claims(claim("a", 1), release("a", 2), claim("a", 3), release("a", 4)) == [("a", 1, 2), ("a", 3, 4)]


def test_overlapping_claims_of_two_principals_conflict() -> None:
    assert conflicts(claim("a", 1), claim("b", 2), release("a", 3), release("b", 4)) == 1


def test_claims_that_touch_do_not_conflict() -> None:
    assert conflicts(claim("a", 1), release("a", 2), claim("b", 2), release("b", 3)) == 0
    assert conflicts(claim("b", 1), release("b", 2), claim("a", 2), release("a", 3)) == 0


def test_claims_that_touch_do_not_conflict_even_if_the_second_is_logged_before_the_release() -> None:
    assert conflicts(claim("a", 1), claim("b", 2), release("a", 2), release("b", 3)) == 0


def test_a_claim_that_was_never_released_overlaps_all_later_ones() -> None:
    assert conflicts(claim("a", 1), claim("b", 900)) == 1


def test_a_claim_of_no_duration_was_never_held() -> None:
    assert conflicts(claim("a", 1), claim("b", 2), release("b", 2), release("a", 3)) == 0


def test_two_claims_of_one_principal_do_not_conflict() -> None:
    assert conflicts(claim("a", 1), claim("a", 2), release("a", 3)) == 0


def test_three_principals_and_many_pairs_are_one_conflict() -> None:
    assert (
        conflicts(
            claim("a", 1),
            claim("b", 2),
            claim("c", 3),
            release("a", 4),
            claim("a", 5),
            release("b", 6),
            release("c", 7),
        )
        == 1
    )


def test_dimensions_and_actions_conflict_separately() -> None:
    other = [
        claim("a", 1, "execution"),
        claim("b", 2, "execution"),
        claim("a", 1, action_id="t1/2"),
        claim("b", 2, action_id="t1/2"),
    ]
    assert conflicts(claim("a", 1), claim("b", 2), *other) == 3
    assert conflicts(claim("a", 1, "execution"), claim("b", 2, "override"), claim("c", 2, "audit")) == 0
    assert conflicts(claim("a", 1), claim("b", 2, action_id="t1/2")) == 0


def test_claims_of_two_runs_do_not_conflict() -> None:
    assert answer("facts/conflicts", run(claim("a", 1)), run(claim("b", 1), run_id="r2")) == []


def test_a_conflict_begins_when_the_first_overlap_begins() -> None:
    rows = answer(
        "facts/conflicts",
        run(claim("a", 1), claim("b", 7), claim("c", 5)),
        columns=("action_id", "dimension", "began_us"),
    )
    assert rows == [("t1/1", "override", 5 * S)]
