"""Trust between robots (`eq:trust`)."""

from .envelope import Event, Principal, Robot, TrustScope


class TrustSet(Event, frozen=True, kw_only=True):
    """`robot` trusts `peer` with this scope from now on. Paper: eq:trust.

    For one `capability`, in one `context` (task), or (None) for all of them; the most specific entry holds.
    `decided_by` is the operator who approved it, the federation's trust service when the record of performance
    gave it, or None at the founding.
    """

    robot: Robot
    peer: Robot
    scope: TrustScope
    capability: str | None = None
    context: str | None = None
    decided_by: Principal | None = None
    reason: str = "founding"


class RoleTrustSet(Event, frozen=True, kw_only=True):
    """Every robot of `role` trusts every robot of `peer_role` with this scope from now on.

    Also those that join later. Both must be in the `domain` or below it; empty is the whole fleet. `capability`,
    `context` and `decided_by` are as in `TrustSet`. An entry about the very pair goes before every entry about their
    roles, and that of a smaller domain before that of a larger one.

    Paper: eq:trust.
    """

    role: str
    peer_role: str
    scope: TrustScope
    domain: str = ""
    capability: str | None = None
    context: str | None = None
    decided_by: Principal | None = None
    reason: str = "founding"


class TrustThresholdsSet(Event, frozen=True):
    """From now on trust follows the record: so many successes promote it, so many failures downgrade it.

    Successes count in a row; 0 is never. Paper: sec:model:trust.
    """

    promote_after: int
    downgrade_after: int
    decided_by: Principal | None


TrustEvent = TrustSet | RoleTrustSet | TrustThresholdsSet
