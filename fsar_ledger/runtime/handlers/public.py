"""Commands from outside: their record, the event that one becomes, and why one is rejected.

A command that cannot be executed is recorded and has no effect. Paper: sec:architecture:overview.
"""

from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from typing import Protocol, TypeVar, get_args

import msgspec

from fsar_ledger.events import Event
from fsar_ledger.events.command import CommandGiven, CommandRejected
from fsar_ledger.events.envelope import FLEET_SUPERVISOR, Principal, Robot, Supervisor, supervisor_named
from fsar_ledger.projections.context import Over
from fsar_ledger.projections.fleet import Fleet
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.registry import Registry
from fsar_ledger.projections.trust import is_within

from .commands import Command, Handlers, Scheduled, nobody

_Made = TypeVar("_Made", bound=Event)
HANDLERS = Handlers()


class PublicCommand(Command, kw_only=True, gc=False):
    """A request from outside, by a robot, an operator or a supervisor.

    A command that cannot be carried out is recorded as rejected, and changes nothing.
    """


class RejectWord(Command):
    """Reject a command that a principal gave in another's name. Paper: sec:model:invariants."""

    name: str
    reason: str
    given_by: Principal


class Work(PublicCommand, gc=False):
    """Work for a robot, which others may submit too."""

    robot: Robot


class RobotReport(PublicCommand, kw_only=True, gc=False):
    """A robot's report of itself; one that has returned to the fleet reports under its `fence`."""

    fence: int | None = None


def made_from(kind: type[_Made], *sources: object, **others: object) -> _Made:
    """Return the event with these fields; each other field comes, by its name, from the last source that has it."""
    shared = {
        name: getattr(source, name) for source in sources for name in kind.__struct_fields__ if hasattr(source, name)
    }
    return kind(**{**shared, **others})


def carried_out(
    command: Command, subject: str, refused: str | None, issued_by: Principal | None, *events: Event
) -> tuple[Event, ...]:
    """Return the events of the command, or if it is refused its rejection alone."""
    return events if refused is None else rejected(command, subject, refused, issued_by)


# See docs/decisions/rejected-commands-are-events.md.
def rejected(command: Command, subject: str, reason: str, issued_by: Principal | None = None) -> tuple[CommandRejected]:
    """Return the rejection of a command that names something unknown, over or impossible."""
    return (CommandRejected(command=type(command).__name__, subject=subject, reason=reason, issued_by=issued_by),)


# A command is in the name of the first of these fields that it has.
_SPEAKERS = ("issued_by", "robot", "supervisor", "requester", "executor", "claimant", "holder", "cache_holder")
SERVICE = "service/"
"""The prefix of principals that submit work to robots but do not report for them."""


def speaker(command: PublicCommand) -> Principal | None:
    """Return the principal in whose name the command is; None if there is none, as for a look into the registry."""
    names = (getattr(command, name, None) for name in _SPEAKERS)
    return next((supervisor_named(name) for name in names if name is not None), None)


def not_its_word(fleet: Fleet, given_by: str, command: PublicCommand) -> str | None:
    """Return why this principal may not give the command, or None: none speaks for another.

    Work may also come from a service, or from a supervisor of the robot. Both may look into the registry as any robot
    does, a robot only as itself. Paper: sec:model:invariants.
    """
    named = speaker(command)
    asker = getattr(getattr(command, "query", None), "requester", given_by)
    alone = fleet.isolated
    if alone is not None and given_by not in (alone, fleet.robots[alone].supervisor):
        return f"{given_by} is not there, expected {alone}, which is alone, or its own supervisor"
    if given_by.startswith("robot/") and asker != given_by:
        return f"{given_by} speaks for {asker}, expected its own word"
    if given_by == named or (named is None and given_by.startswith((SERVICE, "supervisor/", "robot/"))):
        return None
    if isinstance(command, Work) and command.robot in fleet.robots:
        if given_by.startswith(SERVICE):
            return None
        supervisor = supervisor_named(given_by)
        if unknown_supervisor(fleet, supervisor) is None and not_in_charge(fleet, supervisor, command.robot) is None:
            return None
    return f"{given_by} speaks for {named or 'nobody'}, expected its own word"


def unknown_robot(fleet: Fleet, *robots: str | None) -> str | None:
    """Return why to reject a command that names a robot outside the fleet, or None (None names no robot)."""
    for robot in robots:
        if robot is not None and robot not in fleet.robots:
            return f"unknown robot {robot}, expected a member of the fleet"
    return None


def absent_robot(fleet: Fleet, *robots: str | None) -> str | None:
    """Return why to reject a command that needs these robots in the fleet, or None (None names no robot)."""
    refused = unknown_robot(fleet, *robots)
    gone = next(
        (f"{robot} has departed ({reason})" for robot, reason in fleet.departed.items() if robot in robots), None
    )
    return refused if refused is not None or gone is None else f"{gone}, expected that it returns by JoinFleet first"


def not_governed(fleet: Fleet, robot: Robot, issued_by: Supervisor | None) -> str | None:
    """Return why to reject a command about what the robot possesses or advertises, or None.

    It is given by the robot itself (or None) or by who is in charge of it. Paper: sec:model:supervision.
    """
    refused = absent_robot(fleet, robot)
    if refused is None and issued_by is not None and f"{issued_by}" != robot:
        refused = not_in_charge(fleet, issued_by, robot)
    return refused


def outdated(fleet: Fleet, robot: Robot, fence: int | None) -> str | None:
    """Return why to reject a report of the robot under this fencing number, or None.

    A report from before it was declared departed does not answer a question asked since it returned.
    """
    now = fleet.fences.get(robot)
    if (refused := absent_robot(fleet, robot)) is not None or fence == now:
        return refused
    return (
        f"{robot} says so under {'no fencing number' if fence is None else f'fencing number {fence}'}, "
        f"expected {'none' if now is None else f'{now}, which it was given when it returned'}"
    )


def unknown_supervisor(fleet: Fleet, supervisor: Supervisor | None) -> str | None:
    """Return why to reject a command from a supervisor unknown in this fleet, or None."""
    if supervisor == FLEET_SUPERVISOR or (
        supervisor is not None and any(supervisor == robot.supervisor for robot in fleet.robots.values())
    ):
        return None
    return f"unknown supervisor {supervisor}, expected {FLEET_SUPERVISOR} or a robot's own"


def not_in_charge(
    fleet: Fleet, supervisor: Supervisor | None, robot: Robot | None, is_fleet_matter: bool = False
) -> str | None:
    """Return why this supervisor may not give a command about this robot, or None.

    A robot of None: the command is about no robot in particular. H_F may speak for every robot; H_i for its own alone,
    and not in matters of the fleet. Paper: sec:model:supervision.
    """
    if (unknown := unknown_supervisor(fleet, supervisor)) is not None:
        return unknown
    if supervisor == FLEET_SUPERVISOR:
        return None
    if is_fleet_matter:
        return f"{supervisor} supervises one robot, expected {FLEET_SUPERVISOR} for what concerns the fleet"
    if robot is not None and fleet.robots[robot].supervisor != supervisor:
        return (
            f"{supervisor} does not supervise {robot}, "
            f"expected {fleet.robots[robot].supervisor or FLEET_SUPERVISOR} or {FLEET_SUPERVISOR}"
        )
    return None


def unknown_capability(registry: Registry, capability: str | None) -> str | None:
    """Return why to reject a command about a capability that no robot possesses, or None (None names none)."""
    if capability is None or any(capability in modules for modules in registry.modules.values()):
        return None
    return f"unknown capability {capability}, expected one that a member possesses"


def unknown_word(what: str, found: str | None, known: Iterable[str]) -> str | None:
    """Return why to reject a command with this word, or None if it is a known one."""
    known = tuple(known)
    return None if found in known else f"unknown {what} {found}, expected one of {', '.join(known)}"


def expired_context(over: Over, context: str | None) -> str | None:
    """Return why to reject a command in the context of a task that is over, or None (None is no context)."""
    return f"task {context} is over, expected a context that is not" if context in over else None


class _About(Protocol):
    capability: str | None
    context: str | None


def unknown_about(state: State, command: _About) -> str | None:
    """Return why nothing can be set about the capability and in the context that the command names, or None."""
    return unknown_capability(state.registry, command.capability) or expired_context(state.context, command.context)


def not_for_roles(state: State, supervisor: Supervisor, domain: str, *roles: str) -> str | None:
    """Return why this supervisor may not set anything for robots of these roles in the domain, or None."""
    inside = [robot for robot in state.fleet.robots.values() if is_within(robot.domain, domain)]
    refused = not_in_charge(state.fleet, supervisor, None, is_fleet_matter=True)
    if refused is None and not inside:
        refused = f"unknown domain {domain}, expected one that a member is in"
    for role in roles:
        refused = refused or unknown_word("role", role, sorted({robot.role for robot in inside}))
    return refused


@HANDLERS.react(CommandGiven)
def _on_command(state: State, event: CommandGiven, _now_us: int) -> tuple[Scheduled, ...]:
    """Decide the command in the next microsecond; nothing if the record holds no readable command."""
    kind = commands().get(event.command)
    if kind is None:
        return ()
    try:
        command = read(kind, event.parameters)
    except msgspec.ValidationError:
        return ()
    if (refused := not_its_word(state.fleet, event.issued_by, command)) is not None:
        return (Scheduled(RejectWord(name=event.command, reason=refused, given_by=event.issued_by)),)
    return (Scheduled(command),)


@HANDLERS.decide(RejectWord, nobody)
def reject_word(_state: State, command: RejectWord) -> tuple[Event, ...]:
    """Record that a command in another's name was rejected."""
    return (
        CommandRejected(
            command=command.name, subject=command.given_by, reason=command.reason, issued_by=command.given_by
        ),
    )


def command_record(command: PublicCommand, issued_by: str, **about: object) -> CommandGiven:
    """Return the record of a command that was given; `about` are its other columns."""
    fields = {name: getattr(command, name) for name in own_fields(type(command))}
    fields = {name: value for name, value in fields.items() if value is not None or name not in _ADDED}
    parameters = msgspec.json.encode(fields).decode()
    return msgspec.convert(
        {
            "type": CommandGiven.__struct_config__.tag,
            "command": type(command).__name__,
            "issued_by": issued_by,
            "parameters": parameters,
            **about,
        },
        CommandGiven,
    )


def texts_of(parameters: str) -> Iterator[str]:
    """Yield the texts in the fields of a command on record, also those within lists and within other fields."""
    fields: list[object] = [msgspec.json.decode(parameters)]
    for value in fields:
        if isinstance(value, str):
            yield value
        elif isinstance(value, list | dict):
            fields += value.values() if isinstance(value, dict) else value


_ADDED = ("fence", "public_key")
"""Fields that are omitted when None, as in records older than these fields."""


def own_fields(kind: type[PublicCommand]) -> list[str]:
    """Return the fields of a command of this kind, without those that the run stamps."""
    return [name for name in kind.__struct_fields__ if name not in Command.__struct_fields__]


def read(kind: type[PublicCommand], parameters: str) -> PublicCommand:
    """Return the command with these fields, as JSON. Raises: msgspec.ValidationError for invalid fields."""
    fields = msgspec.json.decode(parameters, type=dict[str, object])
    allowed = own_fields(kind)
    if unknown := sorted(fields.keys() - set(allowed)):
        raise msgspec.ValidationError(f"found {unknown[0]!s:.80}, expected some of {', '.join(allowed)}")
    return msgspec.convert(fields, kind)


def with_nulls(kind: type[PublicCommand], fields: Mapping[str, object]) -> dict[str, object]:
    """Return the fields of a command in a file, which has no null: omitted fields that may be null are null."""
    nulls = (item.name for item in msgspec.structs.fields(kind) if item.required and type(None) in get_args(item.type))
    return dict.fromkeys(nulls) | dict(fields)


def given_in_file(command: str, by: str, parameters: str) -> CommandGiven:
    """Return the record of a command that a scenario's file gives. Raises: KeyError, msgspec.MsgspecError for none."""
    kind = commands()[command]
    fields = with_nulls(kind, msgspec.json.decode(parameters, type=dict[str, object]))
    return command_record(read(kind, msgspec.json.encode(fields).decode()), by)


@cache
def commands() -> dict[str, type[PublicCommand]]:
    """Return the commands that can be given, by name: all that FSAR decides."""
    from fsar_ledger.runtime.architectures.fsar import FSAR

    return {command.__name__: command for command in FSAR.decides if issubclass(command, PublicCommand)}
