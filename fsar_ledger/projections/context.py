"""The contexts (tasks) that are over, in which nothing may be requested, granted or trusted any more.

Paper: sec:model:authority (context expiration).
"""

from collections.abc import Mapping

from fsar_ledger.events.task import TaskAbandoned, TaskCompleted

from . import put

HANDLES = TaskCompleted | TaskAbandoned

Over = Mapping[str, bool]
"""Whether the task was completed, by its name, in the order of their ends; a live run keeps the last 65,536.

A set would be copied with every task of a long run.
"""

INITIAL: Over = {}


def evolve(state: Over, event: HANDLES) -> Over:
    """Return the contexts that are over after the event."""
    return put(state, event.task_id, isinstance(event, TaskCompleted))
