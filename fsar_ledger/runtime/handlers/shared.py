"""The handler modules that architectures list whole."""

from . import (
    advertising,
    authority,
    execution,
    fleet,
    policy,
    recovery,
    registry,
    request,
    supervision,
    task,
    trust,
    withdrawal,
)

COMMON = (task, execution, supervision, withdrawal)
"""What every architecture has: tasks, bodies, supervisors, and what becomes of a task that is given up."""

PUBLIC = (fleet, registry, advertising, request, authority, trust, policy, recovery)
"""Commands from outside that need the registry, trust, policy and rights of FSAR."""
