"""Both verifiers agree on ledgers of random histories, good and damaged; the soak judges more."""

import pytest

from tests.ledger.agreement_soak import outcomes


def test_both_verifiers_agree_on_random_histories() -> None:
    found = outcomes(8, 2)
    assert [outcome.difference for outcome in found if outcome.difference] == []
    assert {outcome.is_good for outcome in found} == {True, False}


@pytest.mark.slow
def test_both_verifiers_say_the_same_of_many_good_and_damaged_ledgers() -> None:
    found = outcomes(250)
    assert [outcome.difference for outcome in found if outcome.difference] == []
    assert sum(outcome.is_good for outcome in found) > 40
    assert sum(not outcome.is_good and not outcome.is_stricter for outcome in found) > 100
