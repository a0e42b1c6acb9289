"""Authority that was claimed ends, whoever held it. Paper: sec:model:authority."""

from collections.abc import Iterable

from fsar_ledger.events.authority import AuthorityClaimed, AuthorityReleased


def released(claims: Iterable[AuthorityClaimed]) -> tuple[AuthorityReleased, ...]:
    """Each of these claims ends."""
    return tuple(AuthorityReleased(claim.task_id, claim.action_id, claim.dimension, claim.claimant, claim.reason) for claim in claims)
