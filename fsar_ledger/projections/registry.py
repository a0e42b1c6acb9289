"""The capabilities that robots possess and advertise, and to whom. Paper: eq:adv, eq:possess, eq:advertise."""

from collections.abc import Iterator
from typing import assert_never

import msgspec

from fsar_ledger.events.envelope import Availability, OverrideLevel, Principal, Robot, TrustScope, Visibility
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
    """A robot's record of one capability, with the seven fields of `eq:adv` and who may see it."""

    robot: Robot
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


class Offers(msgspec.Struct, frozen=True, gc=False):
    """The registry of one domain, which contains those of the domains below it.

    A change copies only the registries on its path. `records`: capability -> robot -> record, for the domain's own
    robots; `below`: name -> registry of that domain; `ways`: capability -> names of the domains below that offer it.
    Paper: sec:discussion:heterogeneity.
    """

    records: dict[str, dict[str, Advertisement]] = {}
    below: "dict[str, Offers]" = {}
    ways: dict[str, tuple[str, ...]] = {}


class Cache(msgspec.Struct, frozen=True, gc=False):
    """A copy of the registry. Units: `as_of_us` run time."""

    as_of_us: int
    offers: Offers


class Registry(msgspec.Struct, frozen=True, gc=False):
    """What robots possess and offer.

    `domains`: robot -> its domain; `modules`: robot -> what it possesses; `offers`: what robots advertise; `caches`:
    holder -> its copy; `silent`: robot that did not answer -> capability -> its availability before that.
    """

    domains: dict[Robot, str] = {}
    modules: dict[Robot, dict[str, Module]] = {}
    offers: Offers = Offers()
    caches: dict[Principal, Cache] = {}
    silent: dict[Robot, dict[str, Availability]] = {}


INITIAL = Registry()
NO_ANSWER = "no answer"  # the reason in `AvailabilityChanged` when a robot did not answer


def possesses(state: Registry, robot: Robot, capability: str) -> bool:
    """Return whether the robot has the capability installed. Paper: eq:possess."""
    return capability in state.modules.get(robot, ())


def advertisement(state: Registry, robot: Robot, capability: str) -> Advertisement | None:
    """Return the robot's record of the capability, or None if it does not advertise it. Paper: eq:advertise."""
    found = state.offers
    for name in path_of(state.domains.get(robot, "")):
        if name not in found.below:
            return None
        found = found.below[name]
    return found.records.get(capability, {}).get(robot)


def surface(state: Registry, robot: Robot) -> Iterator[Advertisement]:
    """Yield what the robot advertises. Paper: sec:model:robot (capability surface)."""
    for capability in state.modules.get(robot, ()):
        record = advertisement(state, robot, capability)
        if record is not None:
            yield record


def offers(found: Offers, capability: str, but: str | None = None) -> Iterator[Advertisement]:
    """Yield every record of the capability in the domain, then in each domain below it (except `but`).

    Records come in order of advertisement.
    """
    yield from found.records.get(capability, {}).values()
    for name in found.ways.get(capability, ()):
        if name != but:
            yield from offers(found.below[name], capability)


def enclosing(found: Offers, domain: str) -> Iterator[tuple[str, Offers, str | None]]:
    """Yield the registries that enclose a domain, from its own to the fleet's.

    Each comes with its path and the name of the registry below that came before it, if any.
    """
    path = path_of(domain)
    levels = [found]
    for name in path:
        if name not in levels[-1].below:
            break
        levels.append(levels[-1].below[name])
    last = len(levels) - 1
    for depth in range(last, -1, -1):
        yield "/".join(path[:depth]), levels[depth], path[depth] if depth < last else None


def path_of(domain: str) -> tuple[str, ...]:
    """Return the names on the path from the fleet's registry to the domain's; empty for the fleet's own."""
    return tuple(domain.split("/")) if domain else ()


def evolve(state: Registry, event: HANDLES) -> Registry:
    """Return the registry after the event."""
    replace = msgspec.structs.replace
    match event:
        case RobotJoined():
            return replace(state, domains={**state.domains, event.robot: event.domain})
        case CapabilityInstalled():
            module = Module(
                event.capability, event.version, Contract(event.preconditions, event.postconditions, event.resources)
            )
            return replace(
                state,
                modules={
                    **state.modules,
                    event.robot: {**state.modules.get(event.robot, {}), event.capability: module},
                },
            )
        case CapabilityRemoved():
            left = {
                name: module for name, module in state.modules.get(event.robot, {}).items() if name != event.capability
            }
            return replace(
                _put(state, event.robot, event.capability, None), modules={**state.modules, event.robot: left}
            )
        case CapabilityAdvertised():
            return _put(state, event.robot, event.capability, _record(state, event))
        case CapabilityWithdrawn():
            return _put(state, event.robot, event.capability, None)
        case AvailabilityChanged():
            changed = [
                record for record in surface(state, event.robot) if event.capability in (None, record.capability)
            ]
            silent = _silent(state, event, changed)
            for record in changed:
                state = _put(state, event.robot, record.capability, replace(record, availability=event.availability))
            return state if silent is state.silent else replace(state, silent=silent)
        case CapabilityDeprecated():
            known = advertisement(state, event.robot, event.capability)
            if known is None or known.version != event.version:
                return state
            return _put(
                state, event.robot, event.capability, replace(known, is_deprecated=True, successor=event.successor)
            )
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


def _put(state: Registry, robot: Robot, capability: str, record: Advertisement | None) -> Registry:
    changed = _changed(state.offers, path_of(state.domains.get(robot, "")), robot, capability, record)
    return Registry(state.domains, state.modules, changed, state.caches, state.silent)


def _silent(
    state: Registry, event: AvailabilityChanged, changed: list[Advertisement]
) -> dict[Robot, dict[str, Availability]]:
    """Return `Registry.silent` after the event: robots that did not answer, less what they have reported since."""
    known = state.silent.get(event.robot)
    if event.reason == NO_ANSWER and event.availability == "offline":
        return {
            **state.silent,
            event.robot: {**(known or {}), **{record.capability: record.availability for record in changed}},
        }
    if known is None:
        return state.silent
    others = {robot: before for robot, before in state.silent.items() if robot != event.robot}
    left = {capability: before for capability, before in known.items() if event.capability not in (None, capability)}
    return {**others, event.robot: left} if left else others


def _changed(
    found: Offers, path: tuple[str, ...], robot: Robot, capability: str, record: Advertisement | None
) -> Offers:
    """Return the registry with the robot's record replaced in the domain at this path, or removed if None."""
    if path:
        name = path[0]
        before = found.below.get(name, Offers())
        after = _changed(before, path[1:], robot, capability, record)
        ways = (
            found.ways
            if _leads(before, capability) == _leads(after, capability)
            else _turned(found.ways, name, capability)
        )
        return Offers(found.records, {**found.below, name: after}, ways)
    known = found.records.get(capability, {})
    if record is not None:
        return Offers({**found.records, capability: {**known, robot: record}}, found.below, found.ways)
    robots = {name: other for name, other in known.items() if name != robot}
    records = {**found.records, capability: robots}
    if not robots:
        del records[capability]
    return Offers(records, found.below, found.ways)


def _leads(found: Offers, capability: str) -> bool:
    return capability in found.records or capability in found.ways


def _turned(ways: dict[str, tuple[str, ...]], name: str, capability: str) -> dict[str, tuple[str, ...]]:
    """Return `ways` with this name added for the capability, or removed if it was there."""
    names = ways.get(capability, ())
    if name not in names:
        return {**ways, capability: (*names, name)}
    left = {**ways, capability: tuple(other for other in names if other != name)}
    if not left[capability]:
        del left[capability]
    return left
