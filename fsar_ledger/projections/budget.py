"""The recovery budgets Q_i of each robot and level, where they differ from those of the fleet's structure.

Paper: app:foundations.
"""

from collections.abc import Mapping
from typing import NamedTuple

from fsar_ledger.events.envelope import RecoveryLevel, Robot
from fsar_ledger.events.recovery import RecoveryBudgetSet

from . import put

HANDLES = RecoveryBudgetSet


class Budget(NamedTuple):
    """(t_max, n_max) of one level. Units: `t_max_us` microseconds. Paper: app:foundations."""

    t_max_us: int
    n_max: int


Budgets = Mapping[tuple[Robot, RecoveryLevel], Budget]  # robot, level

INITIAL: Budgets = {}


def evolve(state: Budgets, event: HANDLES) -> Budgets:
    """Return the budgets after the event."""
    return put(state, (event.robot, event.level), Budget(event.t_max_us, event.n_max))
