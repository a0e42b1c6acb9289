"""Advertisement and discovery of capabilities (Gamma, `eq:adv`)."""

from .envelope import Event


class CapabilityAdvertised(Event, frozen=True):
    """A robot offers a capability. `visible_to` names the roles that may discover it; empty means all. Paper: eq:adv."""

    robot: str
    capability: str
    visible_to: tuple[str, ...] = ()


class RegistryQueried(Event, frozen=True):
    """A registry or directory has answered a query with the candidates it may show. Paper: sec:architecture:registry.

    `relay` is the doubly trusted peer through which a request must go when there is no direct trust.
    """

    task_id: str | None
    action_id: str | None
    requested_by: str | None
    executed_by: str | None
    supervised_by: str | None
    capability: str
    candidates: tuple[str, ...]
    relay: str | None = None


RegistryEvent = CapabilityAdvertised | RegistryQueried
