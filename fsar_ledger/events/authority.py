"""Who holds which dimension of authority over an action, from when to when (`eq:auth`)."""

from .envelope import Dimension, Event


class AuthorityClaimed(Event, frozen=True):
    """`claimant` holds this dimension of authority over the action from now on. Paper: eq:auth."""

    task_id: str | None
    action_id: str
    dimension: Dimension
    claimant: str
    reason: str


class AuthorityReleased(Event, frozen=True):
    """`claimant` no longer holds it."""

    task_id: str | None
    action_id: str
    dimension: Dimension
    claimant: str
    reason: str


AuthorityEvent = AuthorityClaimed | AuthorityReleased
