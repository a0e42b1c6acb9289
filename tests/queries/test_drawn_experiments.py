"""Experiments of the paper's size are drawn from the runs that are there: world by world, scenario by scenario, the
same ones each time."""

from typing import Any

import numpy as np
import polars as pl
import pyarrow as pa
import pytest

from fsar_ledger.metrics.database import from_rows
from fsar_ledger.metrics.registration import registration

SCENARIOS = ("door-relay", "fleet-contention")
RUNS = 30


def run(architecture: str, scenario: str, number: int, **more: Any) -> dict[str, Any]:
    """A row of `run_metrics`: success is the run's number for every architecture, failures none or two."""
    same = {
        "kind": "simulated",
        "configuration": "full",
        "fleet_size": 4,
        "seed": 42,
        "setting": "a",
        "constants": None,
        "source": None,
        "model_version": "2",
    }
    named = {
        "run_id": f"{architecture}/{scenario}/{number}",
        "architecture": architecture,
        "scenario": scenario,
        "run": number,
    }
    return {
        **same,
        **named,
        "position": 1,
        "metric": "coordination_success",
        "value": float(number),
        "numerator": number,
        "denominator": 1,
        **more,
    }


def held(rows: list[dict[str, Any]]) -> pa.Table:
    text = ("source", "constants", "not_observed")
    return pa.table(
        pl.DataFrame(
            [{"not_observed": None, **row} for row in rows], schema_overrides=dict.fromkeys(text, pl.String)
        ).to_arrow()
    )


def drawn(rows: list[dict[str, Any]]) -> pl.DataFrame:
    with from_rows([]) as database:
        database.hold("run_metrics", held(rows))
        return pl.DataFrame(database.table("SELECT * FROM drawn_experiments ORDER BY ALL"))


@pytest.fixture(scope="module")
def experiments() -> pl.DataFrame:
    rows = [
        run(architecture, scenario, number)
        for architecture in ("fsar", "cfc")
        for scenario in SCENARIOS
        for number in range(RUNS)
    ]
    failures = [
        run(
            "fsar",
            scenario,
            number,
            metric="recovery_containment",
            value=None,
            numerator=number % 2,
            denominator=2 * (number % 2),
        )
        for scenario in SCENARIOS
        for number in range(RUNS)
    ]
    return drawn(rows + failures)


def test_as_many_are_drawn_as_were_registered(experiments: pl.DataFrame) -> None:
    assert experiments["draw"].n_unique() == registration().verdicts.draws


def test_what_is_drawn_varies_as_experiments_of_twenty_runs_a_scenario_do(experiments: pl.DataFrame) -> None:
    means = experiments.filter(pl.col("architecture") == "fsar", pl.col("metric") == "coordination_success")[
        "value"
    ].to_numpy()
    assert means.mean() == pytest.approx((RUNS - 1) / 2, abs=0.1)
    assert means.std() == pytest.approx(np.arange(RUNS).std() / np.sqrt(40), rel=0.05)


def test_a_world_is_drawn_for_all_architectures_together(experiments: pl.DataFrame) -> None:
    wide = experiments.filter(pl.col("metric") == "coordination_success").pivot(
        "architecture", index="draw", values="value"
    )
    assert (wide["fsar"] == wide["cfc"]).all()


def test_failures_are_pooled_over_the_drawn_runs(experiments: pl.DataFrame) -> None:
    assert set(experiments.filter(pl.col("metric") == "recovery_containment")["value"]) == {0.5}


def test_an_experiment_without_failures_has_no_containment_and_what_is_not_observed_is_not_drawn() -> None:
    none = [
        run("fsar", "door-relay", number, metric="recovery_containment", value=None, numerator=0, denominator=0)
        for number in range(3)
    ]
    assert drawn(none)["value"].is_null().all()
    blind = [run("fsar", "door-relay", 0), run("fsar", "door-relay", 1, not_observed="tasks", value=None)]
    assert set(drawn(blind)["value"]) == {0.0}


def test_runs_made_otherwise_are_never_in_one_experiment() -> None:
    rows = [
        run("fsar", "door-relay", number, seed=seed, setting=str(apart), value=float(number + apart))
        for seed in (1, 2)
        for apart in (0, 100)
        for number in range(2)
    ]
    found = drawn(rows)
    assert len(found) == 4 * registration().verdicts.draws
    assert set(found["value"].floor()) <= {0.0, 1.0, 100.0, 101.0}


def test_an_experiment_is_made_of_the_runs_that_were_drawn_of_each_scenario() -> None:
    rows = [run("fsar", scenario, number) for scenario in SCENARIOS for number in range(RUNS)]
    with from_rows([]) as database:
        database.hold("run_metrics", held(rows))
        parts = pl.DataFrame(
            database.table(
                "SELECT draw, avg(value) AS value, count(*) AS scenarios FROM drawn_scenarios GROUP BY draw "
                "ORDER BY draw"
            )
        )
        whole = pl.DataFrame(database.table("SELECT draw, value FROM drawn_experiments ORDER BY draw"))
    assert set(parts["scenarios"]) == {len(SCENARIOS)}
    assert np.allclose(parts["value"].to_numpy(), whole["value"].to_numpy())
