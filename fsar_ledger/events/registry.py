"""Possession, advertisement and discovery of capabilities (Gamma, `eq:adv`).

Contracts have one form everywhere: `preconditions` must hold before, `postconditions` hold after, `resources` are taken
meanwhile. `not ` negates a condition: `not door.closed` contradicts `door.closed`.
"""

from .envelope import (
    ActionId,
    Availability,
    Event,
    OverrideLevel,
    Parties,
    Principal,
    Robot,
    Subject,
    TaskId,
    TrustScope,
    Visibility,
)


class CapabilityInstalled(Event, frozen=True, kw_only=True):
    """The robot possesses this version of an ECM. Paper: eq:possess, sec:model:robot."""

    robot: Robot
    capability: str
    version: str
    preconditions: tuple[str, ...] = ()
    postconditions: tuple[str, ...] = ()
    resources: tuple[str, ...] = ()


class CapabilityRemoved(Event, frozen=True):
    """The robot no longer possesses or advertises the capability."""

    robot: Robot
    capability: str


class CapabilityAdvertised(Event, frozen=True, kw_only=True):
    """A robot offers a capability; a later record of the same robot and capability replaces this one. Paper: eq:adv.

    The seven fields are `version`; the contract; `trust_required`, the narrowest scope that suffices;
    `policy_required`, the contexts in which it may be requested (empty: any); `override_allowed`, the highest override
    level that a request may carry (the authority profile); `availability`; `embodiment`, the body that it needs or is.
    `visibility` says who may discover it: everyone, the robot's own domain and those below it, or the robots that it
    trusts; `visible_to` narrows that to roles (empty: all).
    """

    robot: Robot
    capability: str
    visible_to: tuple[str, ...] = ()
    version: str = "1.0.0"
    preconditions: tuple[str, ...] = ()
    postconditions: tuple[str, ...] = ()
    resources: tuple[str, ...] = ()
    trust_required: TrustScope = "capability"
    policy_required: tuple[str, ...] = ()
    override_allowed: OverrideLevel = "none"
    availability: Availability = "ready"
    embodiment: tuple[str, ...] = ()
    visibility: Visibility = "global"


class CapabilityWithdrawn(Event, frozen=True):
    """The capability is no longer on the robot's surface; the robot still possesses it.

    Paper: sec:architecture:registry.
    """

    robot: Robot
    capability: str
    reason: str


class AvailabilityChanged(Event, frozen=True, kw_only=True):
    """The registry has learned a new availability, of one capability or (None) of all that the robot advertises.

    The robot reported it, except with the reason `no answer`: then it did not answer someone and is listed as offline.

    Paper: sec:architecture:registry.
    """

    robot: Robot
    capability: str | None
    availability: Availability
    reason: str


class CapabilityDeprecated(Event, frozen=True, kw_only=True):
    """The version is being phased out: shown last, and only to queries that no other version satisfies.

    Paper: sec:discussion:continuity.
    """

    robot: Robot
    capability: str
    version: str
    successor: str | None = None


class RegistryCached(Event, frozen=True):
    """`holder` keeps a copy of the registry as it was at `as_of_us` (run time). Paper: sec:discussion:heterogeneity."""

    holder: Principal
    as_of_us: int


class RegistryConsulted(Event, frozen=True, kw_only=True):
    """Someone has consulted the registry outside any request; no exchange between robots follows from it.

    Paper: sec:architecture:registry.

    The fields are as in `RegistryQueried`.
    """

    requested_by: Principal
    capability: str
    candidates: tuple[Robot, ...]
    rejected: tuple[Robot, ...]
    rejected_by: tuple[str, ...]
    domain: str = ""
    as_of_us: int | None = None


class RegistryQueried(Event, frozen=True, kw_only=True):
    """A registry or directory has answered a query with the candidates it may show. Paper: sec:architecture:registry.

    `relay` is the doubly trusted peer through which a request must go when there is no direct trust. Each robot in
    `rejected` matched by name and was left out by the filter at the same position in `rejected_by`. `domain` is the
    registry that answered, `as_of_us` the run time of the copy that it read (None: the registry itself, as of now).
    """

    subject: Subject[TaskId | None, ActionId | None]
    principals: Parties
    capability: str
    candidates: tuple[Robot, ...]
    relay: Robot | None = None
    rejected: tuple[Robot, ...] = ()
    rejected_by: tuple[str, ...] = ()
    domain: str = ""
    as_of_us: int | None = None
