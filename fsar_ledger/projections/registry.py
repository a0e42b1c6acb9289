"""What robots possess, and what they advertise to whom. Paper: eq:adv, eq:possess, eq:advertise."""

from collections.abc import Iterator
from typing import assert_never

import msgspec

from fsar_ledger.events.envelope import Availability, OverrideLevel, TrustScope, Visibility
from fsar_ledger.events.fleet import RobotJoined
from fsar_ledger.events.registry import (
    AvailabilityChanged,
    CapabilityAdvertised,
    CapabilityDeprecated,
    CapabilityInstalled,
    CapabilityRemoved,
    CapabilityWithdrawn,
    RegistryCached,
)

HANDLES = (
    RobotJoined
    | CapabilityInstalled
    | CapabilityRemoved
    | CapabilityAdvertised
    | CapabilityWithdrawn
    | AvailabilityChanged
    | CapabilityDeprecated
    | RegistryCached
)


class Contract(msgspec.Struct, frozen=True, gc=False):
    """What must hold before, what holds after, and what is taken meanwhile. Paper: sec:model:robot."""

    preconditions: tuple[str, ...] = ()
    postconditions: tuple[str, ...] = ()
    resources: tuple[str, ...] = ()


class Module(msgspec.Struct, frozen=True, gc=False):
    """An ECM that a robot possesses. Paper: sec:model:robot."""

    capability: str
    version: str
    contract: Contract


class Advertisement(msgspec.Struct, frozen=True, gc=False):
    """The record of one capability of one robot, with the seven fields of `eq:adv` and who may see it."""

    robot: str
    capability: str
    version: str
    contract: Contract
    trust_required: TrustScope
    policy_required: tuple[str, ...]
    override_allowed: OverrideLevel
    availability: Availability
    embodiment: tuple[str, ...]
    visibility: Visibility
    visible_to: tuple[str, ...]
    domain: str
    is_deprecated: bool = False
    successor: str | None = None


Offers = dict[str, dict[str, dict[str, Advertisement]]]  # capability -> domain -> robot -> record


class Cache(msgspec.Struct, frozen=True, gc=False):
    """A copy of the registry. Units: `as_of_us` run time."""

    as_of_us: int
    offers: Offers


class Registry(msgspec.Struct, frozen=True, gc=False):
    """`modules`: robot -> what it possesses; `offers`: what is on robots' surfaces; `caches`: holder -> its copy."""

    domains: dict[str, str] = {}
    modules: dict[str, dict[str, Module]] = {}
    offers: Offers = {}
    caches: dict[str, Cache] = {}


INITIAL = Registry()


def possesses(state: Registry, robot: str, capability: str) -> bool:
    """True when the robot has the capability installed. Paper: eq:possess."""
    return capability in state.modules.get(robot, ())


def advertisement(state: Registry, robot: str, capability: str) -> Advertisement | None:
    """The robot's record of the capability, or None while it does not advertise it. Paper: eq:advertise."""
    return state.offers.get(capability, {}).get(state.domains.get(robot, ""), {}).get(robot)


def surface(state: Registry, robot: str) -> Iterator[Advertisement]:
    """What the robot advertises. Paper: sec:model:robot (capability surface)."""
    for capability in state.modules.get(robot, ()):
        record = advertisement(state, robot, capability)
        if record is not None:
            yield record


def offers(found: Offers, capability: str) -> Iterator[Advertisement]:
    """Every record of the capability, in order of advertisement within each domain."""
    for robots in found.get(capability, {}).values():
        yield from robots.values()


def evolve(state: Registry, event: HANDLES) -> Registry:
    """The registry after the event."""
    replace = msgspec.structs.replace
    match event:
        case RobotJoined():
            return replace(state, domains={**state.domains, event.robot: event.domain})
        case CapabilityInstalled():
            module = Module(event.capability, event.version, Contract(event.preconditions, event.postconditions, event.resources))
            return replace(state, modules={**state.modules, event.robot: {**state.modules.get(event.robot, {}), event.capability: module}})
        case CapabilityRemoved():
            left = {name: module for name, module in state.modules.get(event.robot, {}).items() if name != event.capability}
            return replace(_without(state, event.robot, event.capability), modules={**state.modules, event.robot: left})
        case CapabilityAdvertised():
            return _with(state, _record(state, event))
        case CapabilityWithdrawn():
            return _without(state, event.robot, event.capability)
        case AvailabilityChanged():
            for record in tuple(surface(state, event.robot)):
                if event.capability in (None, record.capability):
                    state = _with(state, replace(record, availability=event.availability))
            return state
        case CapabilityDeprecated():
            known = advertisement(state, event.robot, event.capability)
            if known is None or known.version != event.version:
                return state
            return _with(state, replace(known, is_deprecated=True, successor=event.successor))
        case RegistryCached():
            return replace(state, caches={**state.caches, event.holder: Cache(event.as_of_us, state.offers)})
        case _:
            assert_never(event)


def _record(state: Registry, event: CapabilityAdvertised) -> Advertisement:
    return Advertisement(
        event.robot,
        event.capability,
        event.version,
        Contract(event.preconditions, event.postconditions, event.resources),
        event.trust_required,
        event.policy_required,
        event.override_allowed,
        event.availability,
        event.embodiment,
        event.visibility,
        event.visible_to,
        state.domains.get(event.robot, ""),
    )


def _with(state: Registry, record: Advertisement) -> Registry:
    domains = state.offers.get(record.capability, {})
    robots = {**domains.get(record.domain, {}), record.robot: record}
    return Registry(state.domains, state.modules, {**state.offers, record.capability: {**domains, record.domain: robots}}, state.caches)


def _without(state: Registry, robot: str, capability: str) -> Registry:
    domain = state.domains.get(robot, "")
    domains = state.offers.get(capability, {})
    robots = {name: record for name, record in domains.get(domain, {}).items() if name != robot}
    return Registry(state.domains, state.modules, {**state.offers, capability: {**domains, domain: robots}}, state.caches)
