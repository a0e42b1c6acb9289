"""Reads and checks a user's own scenario, fleet and constants.

They become part of a run's constants, so event 0 of every run holds them and the run can be replayed anywhere without
the files.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from math import ceil, inf, isfinite
from pathlib import Path
from typing import Any

import msgspec

from fsar_ledger.base import printable
from fsar_ledger.base.errors import InvalidExperiment, UsageError
from fsar_ledger.designs import Fleet, OutsideCommand, Scenario, registered
from fsar_ledger.designs.constants import (
    DURATIONS,
    END_US,
    LEAST,
    MOST,
    MOST_PER_S,
    NEVER_AT_0,
    SIGNED,
    Constants,
    Load,
    with_all_groups,
)
from fsar_ledger.designs.registered import Field, at_line, fault, read_design
from fsar_ledger.metrics.constant_names import names_of_constants

from .changes import Set, number_text
from .handlers.public import commands, own_fields, with_nulls
from .world.checks import Problem, problems_of_fleet, problems_of_scenario

_PART = re.compile(r'\.?([A-Za-z_]\w*)|\["([^"]+)"\]')
_EXCHANGES = "structure.watch_us"
_SHARES = ("_share", "_probability", "_reliability")


def with_own(
    constants: Constants, scenarios: Sequence[str], fleet: str | None = None, settings: Sequence[str] = ()
) -> tuple[Constants, tuple[str, ...]]:
    """Return the constants with the user's own parts, and the names of the scenarios.

    A scenario or fleet that ends in `.toml` is a file, else the name of a registered one. `settings` are `NAME=VALUE`
    and take precedence over those of the scenario.

    Raises:
        UsageError: a file cannot be read, or its content is impossible (with line and field); a name is unknown; a
            value is impossible.
    """
    own_fleet = _fleet(fleet)
    own: Scenario | None = None
    constants = with_settings(constants, settings)
    for name in scenarios:
        of_scenario = registered.scenario(name).settings if name in registered.scenarios() else ()
        if of_scenario and len(scenarios) > 1:
            raise UsageError(
                f"--scenario {name}: found {len(scenarios)} scenarios, expected this one alone, which has constants of "
                "its own; run the others separately"
            )
        constants = with_settings(constants, _others(of_scenario, settings))
    for name in scenarios:
        if not is_file(name):
            continue
        if len(scenarios) > 1:
            raise UsageError(
                f"--scenario {name}: found {len(scenarios)} scenarios, expected a file alone; run the others separately"
            )
        path = Path(name)
        design, text = read_design(path, Scenario)
        for_fleet = own_fleet or registered.fleet()
        _require(path, text, problems_of_scenario(design, for_fleet))
        _require(path, text, problems_of_commands(design, for_fleet))
        if design.name in registered.scenarios():
            _require(path, text, [_name_taken(design.name, registered.scenarios())])
        own = design
        constants = _with_settings_of(constants, design, path, text, settings)
    constants = msgspec.structs.replace(constants, scenario=own, fleet=own_fleet)
    return constants, tuple(scenarios) if own is None else (own.name,)


def _with_settings_of(
    constants: Constants, design: Scenario, path: Path, text: str, settings: Sequence[str]
) -> Constants:
    """Return the constants with the settings of the scenario in this file. Raises: UsageError, with line and field."""
    taken = _others(design.settings, settings)
    before: dict[str, str] = {}
    for number, setting in enumerate(design.settings):
        name = setting.partition("=")[0]
        where = at_line(str(path), text, ("settings", number))
        if name in before:
            raise UsageError(f"{where}: found {setting} beside {before[name]}, expected one value for each name")
        before[name] = setting
        try:
            constants = _with_each(constants, (setting,), {}) if setting in taken else constants
        except UsageError as error:
            raise UsageError(f"{where}: {error}") from error
    try:
        _require_ranges(constants, taken, {})
    except UsageError as error:
        raise UsageError(f"{at_line(str(path), text, ('settings',))}: {error}") from error
    return constants


def with_exchanges(constants: Constants, settings: Sequence[str]) -> Constants:
    """Return the constants with periodic exchanges until every task of the user's own scenario can have arrived.

    Exchanges that have ended do not begin again: a task that came then would be decided on copies as old as that. A
    value that is set, by the scenario or in `settings`, stands. Raises: InvalidExperiment if one can come too late.
    """
    scenario, world, load = constants.scenario, constants.world, constants.load or Load()
    if scenario is None:
        return constants
    work_s = [command.at_s for command in scenario.commands if command.command == "SubmitTask"]
    after_s = world.start.high_s + world.jitter.high_s + load.interval_s * (load.task_sets - 1)
    last_s = max((*work_s, *(task.offset_s + after_s for task in scenario.tasks)), default=0.0)
    if last_s > END_US / 1e6:
        raise InvalidExperiment(
            f"scenario {scenario.name}: found a task that can arrive {printable.number(last_s)} s after the beginning "
            f"of the run, expected all within its {END_US // 1_000_000:,} s; give it a smaller offset_s"
        )
    if _EXCHANGES in _set_by((*settings, *scenario.settings)):
        return constants
    watch_us = max(constants.structure.watch_us, ceil(last_s * 1e6))
    return msgspec.structs.replace(constants, structure=msgspec.structs.replace(constants.structure, watch_us=watch_us))


def _others(of_scenario: Sequence[str], settings: Sequence[str]) -> list[str]:
    """Return the settings of a scenario for constants that `settings` does not set."""
    set_already = _set_by(settings)
    return [setting for setting in of_scenario if setting.partition("=")[0] not in set_already]


def _set_by(settings: Sequence[str]) -> set[str]:
    """Return the names of the constants that these settings set."""
    return {setting.partition("=")[0] for setting in settings}


def is_file(name: str) -> bool:
    """Return whether the argument is a file rather than a registered name."""
    return name.endswith(".toml")


def _fleet(name: str | None) -> Fleet | None:
    """Return the fleet to store in event 0; None is the paper's."""
    if name is None or name == registered.PAPER_FLEET:
        return None
    if is_file(name):
        fleet, text = read_design(Path(name), Fleet)
        _require(Path(name), text, problems_of_fleet(fleet))
        if fleet.name in registered.fleets():
            _require(Path(name), text, [_name_taken(fleet.name, registered.fleets())])
        return fleet
    if name not in registered.fleets():
        names = ", ".join(registered.fleets())
        hint = printable.did_you_mean(name, registered.fleets())
        raise InvalidExperiment(
            f"unknown fleet {printable.value(name)}{hint or ';'} expected a .toml file, or one of {names}"
        )
    return registered.fleet(name)


def _require(path: Path, text: str, problems: Iterator[Problem] | list[Problem]) -> None:
    for problem in problems:
        raise UsageError(
            f"{at_line(str(path), text, problem.field)}: found {problem.found}, expected {problem.expected}"
        )


def problems_of_commands(scenario: Scenario, fleet: Fleet) -> Iterator[Problem]:
    """Yield the problems of a scenario's commands, in the order of its fields.

    Whether a command can be carried out is decided, and recorded, when it is given.
    """
    for number, command in enumerate(scenario.commands):
        about: Field = ("commands", number)
        end_s = END_US / 1e6
        if not 0 <= command.at_s <= end_s:
            yield Problem((*about, "at_s"), printable.number(command.at_s), f"seconds from 0 to {end_s:g}")
        if not (re.fullmatch(r"(robot|supervisor|service)/\S+", command.by) and command.by.isprintable()):
            yield Problem((*about, "by"), printable.value(command.by), "who gives it, as robot/A1 or supervisor/fleet")
        if command.command not in commands():
            hint = printable.did_you_mean(command.command, commands()) or ";"
            names = ", ".join(sorted(commands()))
            yield Problem(
                (*about, "command"), printable.value(command.command), f"a command that exists{hint} known are {names}"
            )
        else:
            yield from _problems_of_fields(about, command, fleet)


def _problems_of_fields(about: Field, one: OutsideCommand, fleet: Fleet) -> Iterator[Problem]:
    """Yield the problems of a command's fields."""
    kind = commands()[one.command]
    try:
        fields = msgspec.json.decode(one.parameters, type=dict[str, Any])
    except msgspec.MsgspecError:
        yield Problem((*about, "parameters"), printable.value(one.parameters), "the fields of the command, as JSON")
        return
    known = own_fields(kind)
    if unknown := [name for name in fields if name not in known]:
        hint = printable.did_you_mean(unknown[0], known)
        yield Problem((*about, unknown[0]), "an unknown field", f"one of {', '.join(known)}{hint}")
        return
    try:
        fields = with_nulls(kind, fields)
        msgspec.convert(fields, kind)
    except msgspec.ValidationError as error:
        field, found, expected = fault(str(error), kind, fields)
        yield Problem((*about, *field), found, expected)
    for name, text in fields.items():
        if isinstance(text, str) and not text.isprintable():
            yield Problem((*about, name), printable.value(text), "characters that can be printed")
    lengths = {*dict(DURATIONS), *(capability.name for capability in fleet.capabilities)}
    if one.command == "InstallCapability" and (name := str(fields.get("capability"))) not in lengths:
        expected = f"one whose length is known ({', '.join(sorted(lengths))}); the fleet's file says how long one takes"
        yield Problem((*about, "capability"), printable.value(name), expected)


def _name_taken(name: str, names: Sequence[str]) -> Problem:
    return Problem(("name",), name, f"a name other than the registered ones: {', '.join(names)}")


def with_settings(constants: Constants, settings: Sequence[str], said: Mapping[str, str] | None = None) -> Constants:
    """Return the constants with each `NAME=VALUE` set, by the dotted names of `info --json`.

    `said` is what an error quotes in place of `--set` and a setting. Raises: UsageError.
    """
    constants = _with_each(constants, settings, said or {})
    _require_ranges(constants, settings, said or {})
    return constants


def with_sets(constants: Constants, changes: Sequence[Set]) -> Constants:
    """Return the constants with the changes from the start, after a check of all changes. Raises: UsageError."""
    now = constants
    for from_s in sorted({change.from_s for change in changes}, key=lambda one: -1.0 if one is None else one):
        said = {
            f"{change.constant}={number_text(change.value)}": f"change {change}"
            for change in changes
            if change.from_s == from_s
        }
        now = with_settings(now, [*said], said)
        constants = now if from_s is None else constants
    return constants


def _with_each(constants: Constants, settings: Sequence[str], said: Mapping[str, str]) -> Constants:
    if not settings:
        return constants
    tree = msgspec.to_builtins(constants)
    given: dict[str, str] = {}
    for setting in settings:
        name, equals, value = setting.partition("=")
        where = said.get(setting, f"--set {setting}")
        if not equals or not name:
            raise UsageError(f"{where}: expected NAME=VALUE, as in --set world.review_share=0.5")
        if name in given:
            raise UsageError(f"{where}: {name} already has the value {given[name]}, expected one value for each name")
        if name not in names_of_constants():
            hint = printable.did_you_mean(name, names_of_constants())
            hint = hint or "; `fsar-ledger info LEDGER --json` prints all names"
            raise UsageError(f"{where}: unknown constant {printable.value(name)}{hint}")
        given[name] = value
        _put(tree, name, _number(where, name, value))
        try:
            constants = msgspec.convert(tree, Constants)
        except msgspec.ValidationError as error:
            whole = "" if _is_real(tree, name) else " whole"
            raise UsageError(f"{where}: found {printable.value(value)}, expected a{whole} number") from error
    return constants


def _require_ranges(constants: Constants, settings: Sequence[str], said: Mapping[str, str]) -> None:
    """Check that no range that these settings change ends before it begins. Raises: UsageError."""
    given = {setting.partition("=")[0]: setting for setting in settings}
    for name, ends, low_s, high_s in _ranges("", msgspec.to_builtins(constants)):
        own = [given[f"{name}{end}"] for end in ends if f"{name}{end}" in given]
        if low_s > high_s and own:
            raise UsageError(
                f"{said.get(own[0], '--set')}: found {name} from {printable.number(low_s)} to "
                f"{printable.number(high_s)} s, expected the smaller first; set both"
            )


def _is_real(tree: dict[str, Any], name: str) -> bool:
    """Return whether the constant of this name need not be a whole number."""
    _put(tree, name, 0.5)
    try:
        msgspec.convert(tree, Constants)
    except msgspec.ValidationError:
        return False
    return True


def with_values(constants: Constants, values: Mapping[str, float | int | None]) -> Constants:
    """Return the constants with these values, by the dotted names of `info --json`, unchecked."""
    if not values:
        return constants
    tree = msgspec.to_builtins(constants)
    for name, value in values.items():
        _put(tree, name, value)
    return msgspec.convert(tree, Constants)


def _number(where: str, name: str, value: str) -> float | int:
    """Return the value of a setting. Raises: UsageError if the constant cannot have it."""
    try:
        number = msgspec.json.decode(value)
    except msgspec.DecodeError:
        number = None
    if isinstance(number, bool) or not isinstance(number, int | float) or not isfinite(number) or abs(number) >= 2**53:
        raise UsageError(f"{where}: found {printable.value(value)}, expected a number")
    if number < 0 and name not in SIGNED:
        raise UsageError(f"{where}: found {value}, expected 0 or more")
    least, most = LEAST.get(name, -inf), MOST_PER_S if name.endswith("_rate_per_s") else MOST.get(name, inf)
    if not (least <= number <= most or (not number and name in NEVER_AT_0)):
        bound = f"{least:,} or more" if number < least else f"at most {most:,}"
        raise UsageError(f"{where}: found {value}, expected {bound}: the run would hardly ever end")
    if number < 1 and name == "structure.human_calls":
        raise UsageError(f"{where}: found {value}, expected 1 or more: what nobody else resolved must reach a human")
    if number > 1 and name.endswith(_SHARES):
        raise UsageError(f"{where}: found {value}, expected a share, 0 to 1")
    return number


def _put(tree: dict[str, Any], name: str, value: float | int | None) -> None:
    """Set the value at the dotted name; an absent group is created."""
    parts = [plain or bracketed for plain, bracketed in _PART.findall(name)]
    branch: Any = tree
    for depth, part in enumerate(parts[:-1]):
        if isinstance(branch, dict):
            if branch.get(part) is None:
                assert depth == 0
                branch[part] = msgspec.to_builtins(getattr(with_all_groups(Constants()), part))
            branch = branch[part]
        else:
            branch = next(law for key, law in branch if key == part)
    branch[parts[-1]] = value


def _ranges(name: str, value: Any) -> Iterator[tuple[str, tuple[str, str], float, float]]:
    """Yield the name of each range, the endings of its two constants' names, and their values."""
    if isinstance(value, dict):
        if "absence_from_s" in value:
            yield f"{name}.absence", ("_from_s", "_to_s"), value["absence_from_s"], value["absence_to_s"]
        if value.keys() == {"low_s", "high_s"}:
            yield name, (".low_s", ".high_s"), value["low_s"], value["high_s"]
        for key, part in value.items():
            yield from _ranges(f"{name}.{key}" if name else key, part)
    elif isinstance(value, list | tuple):
        for part in value:
            if isinstance(part, list | tuple) and len(part) == 2 and isinstance(part[0], str):
                yield from _ranges(f'{name}["{part[0]}"]', part[1])
