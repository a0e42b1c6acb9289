"""Mechanisms are taken out one at a time or several at once, and what lacks several lacks each of them."""

import re
from itertools import combinations
from pathlib import Path

import pytest

from fsar_ledger.base.errors import InvalidExperiment
from fsar_ledger.designs.constants import Constants
from fsar_ledger.events.configuration import CONFIGURATIONS, FULL, MECHANISMS, is_known, removed_mechanisms, without
from fsar_ledger.ledger.rows.codec import encode
from fsar_ledger.metrics.database import from_table
from fsar_ledger.metrics.results import metric_rows
from fsar_ledger.runtime.experiment import Experiment
from fsar_ledger.runtime.experiment_arguments import experiment_of
from fsar_ledger.runtime.simulation import SCENARIOS, RunSpec, simulate_run

EVERY = [set(some) for size in range(5) for some in combinations(MECHANISMS, size)]


@pytest.mark.parametrize("mechanisms", EVERY, ids=without)
def test_a_configuration_has_one_name_and_the_name_says_what_it_lacks(mechanisms: set[str]) -> None:
    assert (
        removed_mechanisms(without(sorted(mechanisms)))
        == removed_mechanisms(without(sorted(mechanisms, reverse=True)))
        == mechanisms
    )
    assert is_known(without(mechanisms))


@pytest.mark.parametrize(
    "name",
    [
        *("", "without-", "without-luck", "without-trust-evaluation+luck"),
        *("without-shared-registry+trust-evaluation", "without-a+a", "trust-evaluation"),
    ],
)
def test_any_other_text_names_no_configuration_and_is_not_simulated(name: str) -> None:
    assert not is_known(name)
    with pytest.raises(
        InvalidExperiment, match=r"configuration: found .*, expected full, or without- and some of trust-evaluation"
    ):
        Experiment(("fsar",), SCENARIOS, 1, configurations=(name,))


def test_those_of_the_papers_table_lack_one_mechanism_each() -> None:
    assert [removed_mechanisms(one) for one in CONFIGURATIONS] == [set(), *({one} for one in MECHANISMS)]


def test_several_mechanisms_in_one_option_are_one_configuration_and_two_options_are_two() -> None:
    asked = experiment_of(
        None,
        None,
        1,
        42,
        4,
        ["shared-registry+trust-evaluation", "policy-composition", "trust-evaluation+shared-registry"],
    )
    assert asked.configurations == ("without-policy-composition", "without-trust-evaluation+shared-registry")
    assert asked.architectures == ("fsar",)


@pytest.mark.parametrize(
    ("asked", "said"), [("trust-evaluation+luck", "'luck'"), ("trust-eval", "did you mean trust-evaluation")]
)
def test_a_mechanism_that_does_not_exist_is_named(asked: str, said: str) -> None:
    with pytest.raises(InvalidExperiment, match=f"unknown mechanism .*{said}"):
        experiment_of(None, None, 1, 42, 4, [asked])


@pytest.mark.parametrize(
    "asked",
    [
        *("", "+", "trust-evaluation+", "+trust-evaluation"),
        *("trust-evaluation,shared-registry", "trust-evaluation+trust-evaluation"),
    ],
)
def test_mechanisms_that_are_joined_otherwise_are_refused_with_how_to_join_them(asked: str) -> None:
    with pytest.raises(
        InvalidExperiment, match=r"without=.*expected mechanisms, each once, with \+ between them, as in "
    ):
        experiment_of(None, None, 1, 42, 4, [asked])


def test_full_comes_first_then_one_mechanism_less_then_two() -> None:
    names = [without(some) for some in EVERY]
    assert Experiment(("fsar",), SCENARIOS, 1, configurations=tuple(reversed(names))).configurations == tuple(names)
    assert names[0] == FULL


@pytest.mark.slow
def test_without_policy_composition_and_layered_recovery_a_run_shows_what_each_of_them_takes_away() -> None:
    """Policy alone moves violations, recovery alone the calls to the supervisor; together both move, on the same
    worlds."""
    names = [
        without(some)
        for some in ((), ("policy-composition",), ("layered-recovery",), ("policy-composition", "layered-recovery"))
    ]
    runs = [
        simulate_run(RunSpec(42, "fsar", name, scenario, 4, run), Constants())
        for scenario in SCENARIOS
        for run in range(8)
        for name in names
    ]
    with from_table(encode(runs)) as database:
        mean = {(row.metric, row.configuration): row.mean or 0.0 for row in metric_rows(database)}
    violations, calls = (
        [mean[metric, name] for name in names] for metric in ("policy_violations", "human_intervention")
    )
    assert violations[1] > violations[0]
    assert calls[2] > calls[0]
    assert violations[3] > violations[2]
    assert calls[3] > calls[1]


def test_queries_read_a_name_as_handlers_do() -> None:
    found = {
        query: (Path(__file__).parents[2] / "queries" / query).read_text()
        for query in ("facts/messages.sql", "audit/query_candidates.sql")
    }
    patterns = {re.findall(r"regexp_matches\((?:runs\.)?configuration, '([^']+)'\)", sql)[0] for sql in found.values()}
    assert len(patterns) == 1
    (pattern,) = patterns
    others = [
        "with-shared-registry-cache",
        "without-shared-registry-v2",
        "shared-registry",
        "without-unshared-registry",
        "",
    ]
    for name in [*map(without, EVERY), *others]:
        assert bool(re.match(pattern, name)) == ("shared-registry" in removed_mechanisms(name)), name
