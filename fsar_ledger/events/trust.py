"""Trust between robots (`eq:trust`)."""

from .envelope import Event, Principal, Robot, TrustScope


class TrustSet(Event, frozen=True, kw_only=True):
    """`robot` trusts `peer` with this scope from now on. Paper: eq:trust.

    The entry applies to one `capability`, in one `context` (task), or (None) to all of them; the most specific one
    holds. `decided_by` is the operator who approved it, the federation's trust service when it follows from the record
    of performance, or None at the founding.
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

    That includes robots that join later. Both must be in the `domain` or below it; empty is the whole fleet.
    `capability`, `context` and `decided_by` are as in `TrustSet`. An entry for the pair itself takes precedence over
    every entry for their roles, and an entry for a smaller domain over one for a larger domain.

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


class InitialTrustSet(Event, frozen=True, kw_only=True):
    """A robot that joined the running fleet trusts every other robot with this scope, or is trusted by it.

    `is_trusting` says which. It applies where no entry for the pair or their roles does, also to robots that join
    later. Paper: sec:discussion:heterogeneity.
    """

    robot: Robot
    scope: TrustScope
    is_trusting: bool
    decided_by: Principal | None


class TrustThresholdsSet(Event, frozen=True):
    """From now on trust follows the record: this many successes promote it, this many failures downgrade it.

    Successes must be consecutive; 0 means never. Paper: sec:model:trust.
    """

    promote_after: int
    downgrade_after: int
    decided_by: Principal | None
