"""What supervisors have approved. Paper: eq:supervision."""

from fsar_ledger.events.supervision import SupervisorResponded

HANDLES = SupervisorResponded

Supervision = frozenset[str]  # actions whose review was approved

INITIAL: Supervision = frozenset()


def evolve(state: Supervision, event: HANDLES) -> Supervision:
    """The approved actions after the event."""
    return state | {event.action_id} if event.purpose == "review" else state
