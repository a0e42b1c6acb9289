"""Constants under which a run would hardly ever end are refused; at their bounds it ends."""

import pytest

from fsar_ledger.base.errors import UsageError
from fsar_ledger.designs.constants import END_US, Constants
from fsar_ledger.runtime.own import with_settings
from fsar_ledger.runtime.simulation import RunSpec, simulate_run


@pytest.mark.parametrize(
    ("name", "value", "bound"),
    [
        ("structure.poll_us", "0", "1,000 or more"),
        ("structure.poll_us", "999", "1,000 or more"),
        ("alliance.broadcast_us", "1", "1,000 or more"),
        ("world.encounter_mean_s", "0.0", "0.001 or more"),
        ("world.encounter_mean_s", "1e-9", "0.001 or more"),
        ("world.routine_rate_per_s", "1e9", "at most 100"),
        ("outages.off_rate_per_s", "101", "at most 100"),
        ("world.horizon_s", "1e9", "at most 100,000"),
        ("structure.watch_us", "1000000000000", "at most 1,800,000,000"),
    ],
)
def test_a_constant_beyond_its_bound_is_refused_with_the_bound(name: str, value: str, bound: str) -> None:
    with pytest.raises(UsageError) as refused:
        with_settings(Constants(), [f"{name}={value}"])
    expected = f"--set {name}={value}: found {value}, expected {bound}: the run would hardly ever end"
    assert str(refused.value) == expected


@pytest.mark.parametrize(
    "settings",
    [
        ("world.routine_rate_per_s=100", "world.crowding_rate_per_s=0"),
        ("world.encounter_mean_s=0.01", "structure.poll_us=1000"),
        ("structure.sync_period_us=1000", "structure.snapshot_period_us=1000"),
        ("world.horizon_s=100000", "structure.watch_us=1800000000"),
        ("alliance.broadcast_us=0",),
    ],
)
def test_a_run_at_the_bound_of_a_constant_ends(settings: tuple[str, ...]) -> None:
    constants = with_settings(Constants(), settings)
    architecture = "alliance" if settings[0].startswith("alliance") else "cfc"
    record = simulate_run(RunSpec(42, architecture, "full", "door-relay", 4, 0), constants)
    assert record.times_us[-1] < 2 * END_US
