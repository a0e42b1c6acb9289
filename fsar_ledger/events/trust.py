"""Trust between robots (`eq:trust`)."""

from .envelope import Event, TrustScope


class TrustSet(Event, frozen=True):
    """`robot` trusts `peer` with this scope from now on. Paper: eq:trust.

    For one `capability`, in one `context` (task), or (None) for all of them; the most specific entry holds.
    `decided_by` is the operator who approved it, the federation's trust service when the record of performance
    gave it, or None at the founding.
    """

    robot: str
    peer: str
    scope: TrustScope
    capability: str | None = None
    context: str | None = None
    decided_by: str | None = None
    reason: str = "founding"


class TrustThresholdsSet(Event, frozen=True):
    """From now on trust follows the record: so many successes in a row promote it, failures downgrade it; 0 is never. Paper: sec:model:trust."""

    promote_after: int
    downgrade_after: int
    decided_by: str | None


TrustEvent = TrustSet | TrustThresholdsSet
