"""A world that no fit moves, for tests that name what happens in a run: which window opens, which call is made.

Every constant that is fitted has a value of its own here. In it windows are long enough for work to meet them, and
supervisors are asked.
"""

from fsar_ledger.designs.constants import Constants
from fsar_ledger.runtime.own import with_settings

FITTED: dict[str, float] = {
    "world.context_rate_per_s": 0.0222,
    "world.context_window_share": 0.317,
    "world.window_mean_s": 7.54,
    "world.review_share": 0.119,
    "world.fleet_rule_rate_per_s": 0.0133,
    "world.obstruction_rate_per_s": 0.0112,
    "world.obstruction_mean_s": 2.71,
    "world.routine_rate_per_s": 0.196,
    "world.motion_share": 0.189,
    "world.budget_base_s": 37.1,
    "structure.sync_period_us": 6_440_000,
    "structure.service_us": 270_000,
    "structure.hop_ppm": 596_000,
    "structure.snapshot_period_us": 30_900_000,
    "structure.engagement_us": 7_510_000,
    "structure.dispute_timeout_us": 3_160_000,
    "structure.renegotiation_us": 100_000,
}
PINNED = with_settings(Constants(), [f"{name}={value}" for name, value in FITTED.items()])
