"""JADE: who is not trusted is served as anybody else.

The yellow pages show every entry to everybody, and base JADE has no permissions, so an outsider's call reaches the
agent; it is served if that agent's own policy allows. With JADE-S (dial `permissions`) it is refused. The outsider
names the agent itself, so it calls that one, without a search.
"""

from fsar_ledger.events.world import OutsiderRequestInjected
from fsar_ledger.projections.fold import State
from fsar_ledger.runtime.handlers.commands import Handlers, Scheduled

from .contract_net import CallForProposals

HANDLERS = Handlers()


@HANDLERS.react(OutsiderRequestInjected)
def _on_outsider(_state: State, event: OutsiderRequestInjected, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(CallForProposals(event.task_id)),)
