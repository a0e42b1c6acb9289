"""The capabilities that robots possess and advertise, and to whom. Paper: eq:adv, eq:possess, eq:advertise."""

from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import assert_never

import msgspec

from fsar_ledger.events.envelope import DEPARTED, Availability, OverrideLevel, Principal, Robot, TrustScope, Visibility
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

from . import put, without
from .trust import Member

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
    """What must hold before, what holds after, and the resources taken meanwhile. Paper: sec:model:robot."""

    preconditions: tuple[str, ...] = ()
    postconditions: tuple[str, ...] = ()
    resources: tuple[str, ...] = ()


class Module(msgspec.Struct, frozen=True, gc=False):
    """An ECM that a robot possesses. Paper: sec:model:robot."""

    capability: str
    version: str
    contract: Contract


class Advertisement(msgspec.Struct, frozen=True, gc=False):
    """A robot's record of one capability, with the seven fields of `eq:adv` and who may see it.

    `role` and `domain` are the robot's.
    """

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
    role: str = ""
    is_deprecated: bool = False
    successor: str | None = None


class CapabilityOffers(msgspec.Struct, frozen=True, dict=True):
    """The records of one capability in a domain: `of`: robot -> record, in order of advertisement."""

    of: Mapping[Robot, Advertisement] = {}

    @cached_property
    def alike(self) -> tuple[tuple[Advertisement, tuple[Robot, ...]], ...]:
        """One record of each kind, and the robots, sorted by name, whose records differ from it in the robot alone.

        A fleet has few kinds, so a search for candidates judges these.
        """
        kinds: dict[tuple[object, ...], list[Robot]] = {}
        for robot in sorted(self.of):
            kinds.setdefault(msgspec.structs.astuple(self.of[robot])[1:], []).append(robot)
        return tuple((self.of[robots[0]], tuple(robots)) for robots in kinds.values())


# See docs/decisions/registry-is-a-tree.md.
class Offers(msgspec.Struct, frozen=True, gc=False):
    """The registry of one domain, which contains those of the domains below it.

    A change copies only the registries on its path. `records`: capability -> what the domain's own robots offer of it;
    `below`: name -> registry of that domain; `ways`: capability -> names of the domains below that offer it.
    Paper: sec:discussion:heterogeneity.
    """

    records: Mapping[str, CapabilityOffers] = {}
    below: "Mapping[str, Offers]" = {}
    ways: Mapping[str, tuple[str, ...]] = {}


class Cache(msgspec.Struct, frozen=True, gc=False):
    """A copy of the registry. Units: `as_of_us` run time."""

    as_of_us: int
    offers: Offers


class Registry(msgspec.Struct, frozen=True, gc=False):
    """What robots possess and offer.

    `members`: robot -> its role and domain; `modules`: robot -> what it possesses; `offers`: what robots advertise;
    `caches`: holder -> its copy; `silent`: robot that did not answer, or has left the fleet -> capability -> its
    availability before that.
    """

    members: Mapping[Robot, Member] = {}
    modules: Mapping[Robot, dict[str, Module]] = {}
    offers: Offers = Offers()
    caches: Mapping[Principal, Cache] = {}
    silent: Mapping[Robot, dict[str, Availability]] = {}


INITIAL = Registry()
NOTHING = CapabilityOffers()
NO_ANSWER = "no answer"  # the reason in `AvailabilityChanged` when a robot did not answer
AWAY = (NO_ANSWER, DEPARTED)
"""The reasons for which a robot is listed as offline until it is back, with the availability from before."""


def domain_of(state: Registry, robot: Robot) -> str:
    """Return the robot's domain; that of the fleet for a robot that has not joined."""
    return state.members.get(robot, ("", ""))[1]


def possesses(state: Registry, robot: Robot, capability: str) -> bool:
    """Return whether the robot has the capability installed. Paper: eq:possess."""
    return capability in state.modules.get(robot, ())


def advertisement(state: Registry, robot: Robot, capability: str) -> Advertisement | None:
    """Return the robot's record of the capability, or None if it does not advertise it. Paper: eq:advertise."""
    level = state.offers
    for name in path_of(domain_of(state, robot)):
        if name not in level.below:
            return None
        level = level.below[name]
    return level.records.get(capability, NOTHING).of.get(robot)


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
    for offered in offered_in(found, capability, but):
        yield from offered.of.values()


def offered_in(found: Offers, capability: str, but: str | None = None) -> Iterator[CapabilityOffers]:
    """Yield what each domain's own robots offer of the capability: the domain's, then those below it (except `but`)."""
    if capability in found.records:
        yield found.records[capability]
    for name in found.ways.get(capability, ()):
        if name != but:
            yield from offered_in(found.below[name], capability)


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
            return replace(state, members=put(state.members, event.robot, (event.role, event.domain)))
        case CapabilityInstalled():
            module = Module(
                event.capability, event.version, Contract(event.preconditions, event.postconditions, event.resources)
            )
            modules = {**state.modules.get(event.robot, {}), event.capability: module}
            return replace(state, modules=put(state.modules, event.robot, modules))
        case CapabilityRemoved():
            left = {
                name: module for name, module in state.modules.get(event.robot, {}).items() if name != event.capability
            }
            return replace(
                _put(state, event.robot, event.capability, None), modules=put(state.modules, event.robot, left)
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
            advertised = advertisement(state, event.robot, event.capability)
            if advertised is None or advertised.version != event.version:
                return state
            return _put(
                state, event.robot, event.capability, replace(advertised, is_deprecated=True, successor=event.successor)
            )
        case RegistryCached():
            return replace(state, caches=put(state.caches, event.holder, Cache(event.as_of_us, state.offers)))
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
        domain_of(state, event.robot),
        state.members.get(event.robot, ("", ""))[0],
    )


def _put(state: Registry, robot: Robot, capability: str, record: Advertisement | None) -> Registry:
    changed = _changed(state.offers, path_of(domain_of(state, robot)), robot, capability, record)
    return Registry(state.members, state.modules, changed, state.caches, state.silent)


def _silent(
    state: Registry, event: AvailabilityChanged, changed: list[Advertisement]
) -> Mapping[Robot, dict[str, Availability]]:
    """Return `Registry.silent` after the event: robots that did not answer, less what they have reported since."""
    listed = state.silent.get(event.robot)
    if event.reason in AWAY and event.availability == "offline":
        availabilities = {**(listed or {}), **{record.capability: record.availability for record in changed}}
        return put(state.silent, event.robot, availabilities)
    if listed is None:
        return state.silent
    left = {capability: value for capability, value in listed.items() if event.capability not in (None, capability)}
    others = without(state.silent, event.robot)
    return put(others, event.robot, left) if left else others


def _changed(
    level: Offers, path: tuple[str, ...], robot: Robot, capability: str, record: Advertisement | None
) -> Offers:
    """Return the registry with the robot's record replaced in the domain at this path, or removed if None."""
    if path:
        name = path[0]
        old = level.below.get(name, Offers())
        new = _changed(old, path[1:], robot, capability, record)
        ways = (
            level.ways if _leads(old, capability) == _leads(new, capability) else _turned(level.ways, name, capability)
        )
        return Offers(level.records, put(level.below, name, new), ways)
    current = level.records.get(capability, NOTHING).of
    robots = without(current, robot) if record is None else put(current, robot, record)
    records = put(level.records, capability, CapabilityOffers(robots)) if robots else without(level.records, capability)
    return Offers(records, level.below, level.ways)


def _leads(level: Offers, capability: str) -> bool:
    return capability in level.records or capability in level.ways


def _turned(ways: Mapping[str, tuple[str, ...]], name: str, capability: str) -> Mapping[str, tuple[str, ...]]:
    """Return `ways` with this name added for the capability, or removed if it was there."""
    names = ways.get(capability, ())
    if name not in names:
        return put(ways, capability, (*names, name))
    left = tuple(other for other in names if other != name)
    return put(ways, capability, left) if left else without(ways, capability)
