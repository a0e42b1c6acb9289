"""Who holds which dimension of authority over an action, and when (`eq:auth`)."""

from typing import Literal

from .envelope import ActionId, Dimension, Event, OverrideLevel, Principal, Robot, Subject, TaskId

RevocationReason = Literal["trust downgrade", "context expired", "human override"]


class AuthorityClaimed(Event, frozen=True, kw_only=True):
    """`claimant` holds this dimension of authority over the action from now on. Paper: eq:auth.

    `fence` is the fencing number that a returned robot was given; None: it has never departed.
    """

    subject: Subject[TaskId | None, ActionId]
    dimension: Dimension
    claimant: Principal
    reason: str
    fence: int | None = None


class AuthorityReleased(Event, frozen=True):
    """The claim of `claimant` to this dimension of authority over the action, made for this `reason`, has ended."""

    subject: Subject[TaskId | None, ActionId]
    dimension: Dimension
    claimant: Principal
    reason: str


class AuthorityGranted(Event, frozen=True, kw_only=True):
    """`requested_by` may make requests up to this override level, by its role or by a supervisor's decision.

    None as executor, capability or context means any. A grant lifts a revocation. Paper: eq:auth, eq:override.
    """

    requested_by: Robot
    executed_by: Robot | None
    capability: str | None
    context: str | None
    override: OverrideLevel
    decided_by: Principal | None


class AuthorityRevoked(Event, frozen=True, kw_only=True):
    """`requested_by` may no longer make these requests, from the next request boundary on.

    An execution under way continues. Paper: sec:model:authority.
    """

    requested_by: Robot
    executed_by: Robot | None
    capability: str | None
    context: str | None
    reason: RevocationReason
    decided_by: Principal | None
