"""Both verifiers agree on ledgers of format 2 of random histories, good and damaged; the soak judges more."""

from tests.ledger.agreement_soak import chain_outcomes


def test_both_verifiers_agree_on_random_histories_of_format_2() -> None:
    found = chain_outcomes(8, 2)
    assert [outcome.difference for outcome in found if outcome.difference] == []
    assert {outcome.is_good for outcome in found} == {True, False}
