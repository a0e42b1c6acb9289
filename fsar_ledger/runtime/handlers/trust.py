"""Whether one robot lets another ask something of it. Paper: eq:trust, eq:delegable."""

from fsar_ledger.events.envelope import TrustScope
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.registry import advertisement
from fsar_ledger.projections.trust import covers, scope_of


def trusts(state: State, executor: str, requester: str, capability: str, context: str | None = None) -> bool:
    """TrustOK: the executor's trust in the requester covers what the capability's advertisement requires. Paper: eq:delegable."""
    if state.fleet.configuration == "without-trust-evaluation":
        return True
    record = advertisement(state.registry, executor, capability)
    required: TrustScope = "capability" if record is None else record.trust_required
    return covers(scope_of(state.trust, executor, requester, capability, context), required)
