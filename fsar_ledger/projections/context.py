"""The contexts (tasks) that are over, in which nothing may be asked, granted or trusted any more.

Paper: sec:model:authority (context expiration).
"""

from fsar_ledger.events.task import TaskAbandoned, TaskCompleted

HANDLES = TaskCompleted | TaskAbandoned

Over = frozenset[str]

INITIAL: Over = frozenset()


def evolve(state: Over, event: HANDLES) -> Over:
    """Return the contexts that are over after the event."""
    return state | {event.task_id}
