"""Effect sizes of drawn experiments are those of the pairs that were drawn, of all comparisons together."""

from collections.abc import Iterator

import numpy as np
import polars as pl
import pytest

from fsar_ledger.designs.constants import Constants
from fsar_ledger.events.configuration import FULL, PAPER_ARCHITECTURES
from fsar_ledger.ledger.rows.codec import encode
from fsar_ledger.metrics.database import Database, from_table
from fsar_ledger.metrics.definitions import printed_tests
from fsar_ledger.metrics.registration import registration
from fsar_ledger.metrics.results import drawn_effects, setting_of, statistic_rows
from fsar_ledger.metrics.verdicts import compare_effects
from fsar_ledger.runtime.simulation import SCENARIOS, RunSpec, simulate_run
from tests.sure import known

RUNS = 3


@pytest.fixture(scope="module")
def database() -> Iterator[Database]:
    records = [
        simulate_run(RunSpec(1, architecture, FULL, scenario, 4, run), Constants())
        for scenario in SCENARIOS
        for run in range(RUNS)
        for architecture in PAPER_ARCHITECTURES
    ]
    with from_table(encode(records), threads=1) as opened:
        yield opened


@pytest.mark.slow
def test_an_effect_is_that_of_the_pairs_that_were_drawn(database: Database) -> None:
    pairs = pl.DataFrame(
        database.table(
            "SELECT scenario, run, first_value, second_value FROM paired_differences "
            "INNER JOIN paired_tests USING (test_id) WHERE basis = 'published' "
            "AND NOT pools_seeds AND metric = 'governance_locality' AND comparison = 'fsar-dhma'"
        )
    )
    places = pl.DataFrame(
        database.table("SELECT scenario, place::BIGINT AS place, times FROM drawn_places WHERE draw = 17")
    )
    drawn = pairs.join(places, left_on=["scenario", "run"], right_on=["scenario", "place"])
    first, second = (
        np.repeat(drawn[column].to_numpy(), drawn["times"].to_numpy()) for column in ("first_value", "second_value")
    )
    assert len(first) == 100
    expected = (first.mean() - second.mean()) / np.sqrt((first.var(ddof=1) + second.var(ddof=1)) / 2)
    [row] = database.rows(
        "SELECT n, cohens_d FROM drawn_effects WHERE draw = 17 AND metric = 'governance_locality' "
        "AND comparison = 'fsar-dhma'"
    )
    assert row["n"] == 100
    assert row["cohens_d"] == pytest.approx(expected, rel=1e-6)


def test_each_printed_test_has_a_share_of_drawn_experiments(database: Database) -> None:
    setting = setting_of(statistic_rows(database)[0])
    drawn = drawn_effects(database, setting)
    assert drawn.keys() == printed_tests().keys()
    assert {len(numbers) for numbers in drawn.values()} == {registration().verdicts.draws}
    found = compare_effects(statistic_rows(database), drawn)
    assert [(one.metric, one.comparison) for one in found] == list(printed_tests())
    for one in found:
        assert one.could == ("no" if known(one.share) < 0.05 else "yes")
        numbers = [number for number in drawn[one.metric, one.comparison] if number is not None]
        assert min(numbers) < known(one.ours) < max(numbers)
        assert (one.share == 0) == (not min(numbers) < one.paper < max(numbers))
    assert {one.could for one in compare_effects(statistic_rows(database), {})} == {None}
    assert drawn_effects(database, (*setting[:-1], "other constants")) == {}


def test_a_printed_d_has_the_sign_of_its_t_which_the_table_leaves_out() -> None:
    assert len(printed_tests()) == 24
    assert printed_tests()["authority_conflicts", "fsar-cfc"].d == pytest.approx((-4.12, 0.01))
    assert printed_tests()["coordination_success", "fsar-dhma"].t == 2.88
    assert {test.d.value > 0 for test in printed_tests().values() if test.t > 0} == {True}
