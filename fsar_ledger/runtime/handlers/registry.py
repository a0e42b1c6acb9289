"""The registry outside of requests: what a robot advertises there, and queries to it or to its copies.

It is authoritative about discoverability, never about execution: the requested robot judges the request itself. A robot
governs what it shows: it advertises, withdraws, reports, deprecates, rolls out. Every command here but `FinishRollOut`
is public; `issued_by` is the robot (or None) or who is in charge of it. The search is in `candidates`.
Paper: sec:architecture:registry, sec:model:advertisement.
"""

from collections.abc import Iterable
from typing import get_args

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import (
    Availability,
    OverrideLevel,
    Principal,
    Robot,
    Subject,
    Supervisor,
    TrustScope,
    Visibility,
)
from fsar_ledger.events.registry import (
    AvailabilityChanged,
    CapabilityAdvertised,
    CapabilityDeprecated,
    CapabilityInstalled,
    CapabilityWithdrawn,
    RegistryCached,
    RegistryConsulted,
    RegistryQueried,
)
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.registry import (
    NO_ANSWER,
    Advertisement,
    Contract,
    Module,
    Registry,
    advertisement,
    surface,
)

from .attribution import recorded_by
from .candidates import Answer, Query, candidates, contradiction, is_range, version_of, weaker
from .commands import Handlers, RobotCommand, Scheduled, commanded_robot
from .fleet import in_use, not_possessed
from .public import PublicCommand, absent_robot, carried_out, made_from, not_governed, rejected

HANDLERS = Handlers()


def queried(
    state: State,
    query: Query,
    answer: Answer,
    task_id: str | None,
    action_id: str | None,
    relay: Robot | None = None,
) -> RegistryQueried:
    """Return the record of the registry's answer; the executor is the robot that the answer leads to, if any."""
    found = answer.candidates[0] if answer.candidates else None
    return made_from(
        RegistryQueried,
        answer,
        subject=Subject(task_id, action_id),
        principals=recorded_by(state, query.requester, requested_by=query.requester, executed_by=found),
        capability=query.capability,
        relay=relay,
    )


class ConsultRegistry(PublicCommand):
    """Consult the registry outside any request; with `cache_holder`, that robot's copy of it."""

    query: Query
    cache_holder: Robot | None = None


class CacheRegistry(PublicCommand):
    """Give the robot a copy of the registry as it is now."""

    holder: Principal


@HANDLERS.decide(ConsultRegistry)
def consult_registry(state: State, command: ConsultRegistry) -> tuple[Event, ...]:
    """Answer from the registry; finding no robot is an answer too."""
    query = command.query
    wrong = absent_robot(state.fleet, query.requester, command.cache_holder) or _malformed(query)
    if wrong is None and command.cache_holder is not None and command.cache_holder not in state.registry.caches:
        wrong = f"{command.cache_holder} has no copy of the registry, expected one that was taken"
    if wrong is not None:
        return rejected(command, query.capability, wrong, query.requester)
    answer = candidates(state, query, command.cache_holder)
    return (made_from(RegistryConsulted, query, answer, requested_by=query.requester),)


def _malformed(query: Query) -> str | None:
    name = query.capability.removesuffix(".*")
    if not name or "*" in name:
        return (
            f"capability {query.capability!r} is no name, expected one such as grasp.robust or a group such as grasp.*"
        )
    if not is_range(query.version):
        return f"version {query.version!r} is no range, expected nothing, 1.2.0, ^1.2 or >=1.2"
    if query.override not in get_args(OverrideLevel):
        return f"override level {query.override!r} is unknown, expected one of {', '.join(get_args(OverrideLevel))}"
    if query.limit is not None and query.limit < 1:
        return f"limit {query.limit} finds nobody, expected at least 1"
    return None


@HANDLERS.decide(CacheRegistry)
def cache_registry(state: State, command: CacheRegistry) -> tuple[Event, ...]:
    """Give the holder a copy of the registry as it is now."""
    wrong = absent_robot(state.fleet, command.holder)
    return carried_out(command, command.holder, wrong, command.holder, RegistryCached(command.holder, command.now_us))


class AdvertiseCapability(PublicCommand):
    """Advertise the capability, with the seven fields of an advertisement and who may see it.

    A part of the contract that is None is that of the installed module. Paper: eq:adv.
    """

    robot: Robot
    capability: str
    version: str
    preconditions: tuple[str, ...] | None = None
    postconditions: tuple[str, ...] | None = None
    resources: tuple[str, ...] | None = None
    trust_required: TrustScope = "capability"
    policy_required: tuple[str, ...] = ()
    override_allowed: OverrideLevel = "none"
    availability: Availability = "ready"
    embodiment: tuple[str, ...] = ()
    visibility: Visibility = "global"
    visible_to: tuple[str, ...] = ()
    issued_by: Supervisor | None = None


class WithdrawCapability(PublicCommand):
    """Withdraw the capability from the robot's surface; the robot keeps it."""

    robot: Robot
    capability: str
    reason: str
    issued_by: Supervisor | None = None


class ReportAvailability(PublicCommand):
    """Report the availability of one capability, or (None) of everything that the robot advertises."""

    robot: Robot
    capability: str | None
    availability: Availability
    reason: str
    issued_by: Supervisor | None = None


class DeprecateCapability(PublicCommand):
    """Deprecate the advertised version, in favour of the successor if there is one."""

    robot: Robot
    capability: str
    version: str
    successor: str | None = None
    issued_by: Supervisor | None = None


class UpgradeCapability(PublicCommand):
    """Roll a newer version out; parts of its contract that are None stay as they are."""

    robot: Robot
    capability: str
    version: str
    preconditions: tuple[str, ...] | None = None
    postconditions: tuple[str, ...] | None = None
    resources: tuple[str, ...] | None = None
    issued_by: Supervisor | None = None


class FinishRollOut(RobotCommand):
    """Advertise the installed version, with the availability reported for the old one."""

    capability: str
    availability: Availability = "ready"


@HANDLERS.decide(AdvertiseCapability)
def advertise_capability(state: State, command: AdvertiseCapability) -> tuple[Event, ...]:
    """Advertise what the robot possesses, in terms that its module keeps. Paper: eq:advertise."""
    robot, capability = command.robot, command.capability
    wrong = (
        not_governed(state.fleet, robot, command.issued_by)
        or not_possessed(state.registry, robot, capability)
        or _unheard_of(command)
    )
    if wrong is None:
        module = state.registry.modules[robot][capability]
        contract = _contract(command, module)
        wrong = contradiction(contract) or weaker(contract, module.contract)
        if command.version != module.version:
            wrong = f"version {command.version} is not installed, expected {module.version}"
    if wrong is not None:
        return rejected(command, capability, wrong, command.issued_by)
    return (made_from(CapabilityAdvertised, command, contract),)


@HANDLERS.decide(WithdrawCapability)
def withdraw_capability(state: State, command: WithdrawCapability) -> tuple[Event, ...]:
    """Take the capability off the robot's surface."""
    wrong = not_governed(state.fleet, command.robot, command.issued_by) or _not_advertised(
        state.registry, command.robot, command.capability
    )
    event = CapabilityWithdrawn(command.robot, command.capability, command.reason)
    return carried_out(command, command.capability, wrong, command.issued_by, event)


@HANDLERS.decide(ReportAvailability)
def report_availability(state: State, command: ReportAvailability) -> tuple[Event, ...]:
    """Record the availability that the robot reports. Paper: sec:architecture:registry."""
    robot, capability = command.robot, command.capability
    wrong = not_governed(state.fleet, robot, command.issued_by) or _unknown(
        "availability", command.availability, get_args(Availability)
    )
    if wrong is None and capability is not None:
        wrong = _not_advertised(state.registry, robot, capability)
    elif wrong is None and not any(surface(state.registry, robot)):
        wrong = f"{robot} advertises nothing, expected something whose availability can change"
    if wrong is None and command.reason == NO_ANSWER:
        wrong = f'"{NO_ANSWER}" is what others say of a silent robot, expected a reason of its own'
    event = made_from(AvailabilityChanged, command)
    return carried_out(command, capability or robot, wrong, command.issued_by, event)


@HANDLERS.decide(DeprecateCapability)
def deprecate_capability(state: State, command: DeprecateCapability) -> tuple[Event, ...]:
    """Deprecate the version: it is shown last, and to no query that another version satisfies.

    Paper: sec:discussion:continuity.
    """
    robot, capability = command.robot, command.capability
    wrong = not_governed(state.fleet, robot, command.issued_by) or _not_advertised(state.registry, robot, capability)
    if wrong is None:
        record = advertisement(state.registry, robot, capability)
        assert record is not None
        if record.version != command.version:
            wrong = f"version {command.version} is not advertised, expected {record.version}"
        elif record.is_deprecated:
            wrong = f"version {command.version} is deprecated already"
        elif command.successor is not None:
            wrong = _not_newer(command.successor, command.version)
    return carried_out(command, capability, wrong, command.issued_by, made_from(CapabilityDeprecated, command))


@HANDLERS.decide(UpgradeCapability)
def upgrade_capability(state: State, command: UpgradeCapability) -> tuple[Event, ...]:
    """Install the newer version; while it is rolled out, restrict what is advertised.

    Paper: sec:architecture:registry.
    """
    robot, capability = command.robot, command.capability
    wrong = not_governed(state.fleet, robot, command.issued_by) or not_possessed(state.registry, robot, capability)
    if wrong is None:
        module = state.registry.modules[robot][capability]
        contract = _contract(command, module)
        wrong = (
            _not_newer(command.version, module.version)
            or contradiction(contract)
            or in_use(state.execution, robot, capability)
        )
    record = advertisement(state.registry, robot, capability)
    if wrong is None and record is not None and record.availability in ("restricted", "offline"):
        wrong = f"{capability} is {record.availability} at {robot}, expected it to be in reach and in no other roll-out"
    if wrong is not None:
        return rejected(command, capability, wrong, command.issued_by)
    installed = made_from(CapabilityInstalled, command, contract)
    if record is None:
        return (installed,)
    return (
        installed,
        AvailabilityChanged(
            robot=robot, capability=capability, availability="restricted", reason=f"roll-out of {command.version}"
        ),
    )


@HANDLERS.decide(FinishRollOut, commanded_robot)
def finish_roll_out(state: State, command: FinishRollOut) -> tuple[Event, ...]:
    """Advertise the new version on the terms of the old one, unless that was withdrawn or replaced.

    The availability that the robot has reported meanwhile is kept. A robot that has left does not finish it.
    """
    record = _rolling_out(state.registry, command.robot, command.capability)
    if record is None or command.robot in state.fleet.departed:
        return ()
    module = state.registry.modules[command.robot][command.capability]
    availability = command.availability if record.availability == "restricted" else record.availability
    return (made_from(CapabilityAdvertised, record, module, module.contract, availability=availability),)


def _rolling_out(registry: Registry, robot: Robot, capability: str) -> Advertisement | None:
    """Return the record of another version than the installed one, if there is one."""
    module = registry.modules.get(robot, {}).get(capability)
    record = advertisement(registry, robot, capability)
    return None if module is None or record is None or record.version == module.version else record


def _contract(command: AdvertiseCapability | UpgradeCapability, module: Module) -> Contract:
    installed = module.contract
    return Contract(
        installed.preconditions if command.preconditions is None else command.preconditions,
        installed.postconditions if command.postconditions is None else command.postconditions,
        installed.resources if command.resources is None else command.resources,
    )


def _unheard_of(command: AdvertiseCapability) -> str | None:
    """Return why a value of the advertisement is unknown to the model, or None; constructors do not check."""
    for name, value, allowed in (
        ("trust scope", command.trust_required, get_args(TrustScope)),
        ("override level", command.override_allowed, get_args(OverrideLevel)),
        ("availability", command.availability, get_args(Availability)),
        ("visibility", command.visibility, get_args(Visibility)),
    ):
        if (wrong := _unknown(name, value, allowed)) is not None:
            return wrong
    names = (*command.policy_required, *command.embodiment, *command.visible_to)
    return None if all(names) else "an empty name, expected contexts, embodiments and roles with names"


def _unknown(name: str, value: str, allowed: Iterable[str]) -> str | None:
    return None if value in allowed else f"{name} {value!r} is unknown, expected one of {', '.join(allowed)}"


def _not_advertised(registry: Registry, robot: Robot, capability: str) -> str | None:
    return (
        None if advertisement(registry, robot, capability) is not None else f"{robot} does not advertise {capability}"
    )


def _not_newer(version: str, current: str) -> str | None:
    new, old = version_of(version), version_of(current)
    if new is None:
        return f"{version!r} is no version, expected one such as 1.2.0"
    return f"version {version} is not newer than {current}" if old is not None and new <= old else None


@HANDLERS.react(CapabilityInstalled)
def _on_installation(state: State, event: CapabilityInstalled, _now_us: int) -> tuple[Scheduled, ...]:
    """Roll out what is advertised in another version.

    The availability is the one from before the record was restricted.
    """
    record = _rolling_out(state.registry, event.robot, event.capability)
    return () if record is None else (Scheduled(FinishRollOut(event.robot, event.capability, record.availability)),)
