"""Who holds which dimension of authority over an action, from when to when (`eq:auth`)."""

from typing import Literal

from .envelope import Dimension, Event, OverrideLevel

RevocationReason = Literal["trust downgrade", "context expired", "human override"]


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


class AuthorityGranted(Event, frozen=True):
    """`requested_by` may ask (of None: anyone) up to this override level, by role or a supervisor's word; lifts a revocation. Paper: eq:auth, eq:override."""

    requested_by: str
    executed_by: str | None
    capability: str | None
    context: str | None
    override: OverrideLevel
    decided_by: str | None


class AuthorityRevoked(Event, frozen=True):
    """`requested_by` may no longer ask this, from the next request boundary on: what executes already goes on. Paper: sec:model:authority."""

    requested_by: str
    executed_by: str | None
    capability: str | None
    context: str | None
    reason: RevocationReason
    decided_by: str | None


AuthorityEvent = AuthorityClaimed | AuthorityReleased | AuthorityGranted | AuthorityRevoked
