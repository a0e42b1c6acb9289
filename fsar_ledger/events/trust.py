"""Trust between robots (`eq:trust`)."""

from .envelope import Event, TrustScope


class TrustSet(Event, frozen=True):
    """`robot` trusts `peer` with this scope from now on. Paper: eq:trust."""

    robot: str
    peer: str
    scope: TrustScope


TrustEvent = TrustSet
