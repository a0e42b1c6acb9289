"""Both verifiers agree on ledgers of random histories, good and damaged; the soak judges more."""

import pytest

from tests.ledger.agreement_soak import outcomes
from tests.quick import few


@pytest.mark.slow
def test_both_verifiers_agree_on_random_histories() -> None:
    found = outcomes(8, 2)
    assert [outcome.difference for outcome in found if outcome.difference] == []
    assert {outcome.is_good for outcome in found} == {True, False}


@pytest.mark.parametrize("ledgers", few([15, 250], [], [15]))
def test_both_verifiers_say_the_same_of_many_good_and_damaged_ledgers(ledgers: int) -> None:
    found = outcomes(ledgers)
    assert [outcome.difference for outcome in found if outcome.difference] == []
    assert sum(outcome.is_good for outcome in found) > ledgers // 6
    assert sum(not outcome.is_good and not outcome.is_stricter for outcome in found) > ledgers * 2 // 5
